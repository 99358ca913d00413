"""What is done to a log, as one record: the net repair that every hypothesis is a value
of.

A hypothesis changes entries of this record; a composition of hypotheses is again one
record. So no joint can have two zeros, two gains or two signs, and what is reported is
what is done to the raw log:

    q_j   = ratio_j scale_j q_raw[order_j] + zero_j    time  t = t_0 + rate (t_raw - t_0), or reversed
    tau_j = gain_j / ratio_j (tau_raw[tau_order_j] earlier by lead_j) + lag_j d(tau_j)/dt - events_j

and is no larger than limit_j; a channel that bends is straightened first: s artanh(tau_raw /
s), s = max |tau_raw| / bend_j. Where the motor of joint j turns with the joint before it as well, these
are angles m and torques of motors, m_j = q_j + carried_j q_{j-1}; q = A m, and the joints'
torques are A^-T tau.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array

Order = tuple[int, ...]
Numbers = tuple[float, ...]


@dataclass(frozen=True)
class LogEvent:
    """A torque of one joint that is not the arm's."""

    #: Joint, from 0.
    joint: int
    #: None for a linear drift over the whole log; a time [s] for a step.
    at: float | None = None

    def shape(self, t: Array) -> Array:
        """Return the column (N, 1) of unit size at instants t (N,) [s]: a ramp from 0
        to 1 for a drift, 0 before a step and 1 after it."""
        if self.at is None:
            ramp = (t - t[0]) / max(t[-1] - t[0], 1e-300)
            return ramp[:, None]
        is_after = t > self.at
        return is_after.astype(float)[:, None]


@dataclass(frozen=True)
class LogTransform:
    """What is done to a log, as in the module's equations, and what its model has to
    assume; one entry a joint where a field has several."""

    #: Position channel that each joint takes.
    order: Order
    #: Factor of positions, q = scale q_raw + zero [-].
    scale: Numbers
    #: Zero of positions, q = scale q_raw + zero [rad, m].
    zero: Numbers
    #: Torque channel that each joint takes.
    tau_order: Order
    #: Factor of torques [-].
    gain: Numbers
    #: How much later a torque is [s].
    lead: Numbers
    #: Time constant of a torque's low-pass [s].
    lag: Numbers
    #: Gravity in the base frame that the model assumes [m/s^2].
    gravity: tuple[float, ...]
    #: Share of the arm's weight that each torque lacks [-].
    lacks: Numbers
    #: Largest torque over an amplifier's limit [-].
    bend: Numbers
    #: Largest torque of a drive, in the place of commands beyond it [N m, N]; 0: any.
    limit: Numbers
    #: Gear ratio over the logger's: a factor of positions, a divisor of torques [-].
    ratio: Numbers
    #: How far the logged motor of a joint turns with the joint before it [-]: 1 or -1 of
    #: a parallelogram, whose motors sit on one link.
    carried: Numbers
    #: True time over the file's [-].
    rate: float = 1.0
    #: Whether the clock runs backwards.
    reversed: bool = False
    #: Torques that are not the arm's.
    events: tuple[LogEvent, ...] = ()
    #: Gravity that the problem assumes [m/s^2].
    assumed: tuple[float, ...] = field(default=(), compare=False)

    @classmethod
    @lru_cache(99)
    def unchanged(cls, n: int, gravity: tuple[float, ...]) -> LogTransform:
        """Return the repair that changes nothing of n joints under a gravity in the
        base frame [m/s^2]."""
        in_order = tuple(range(n))
        names = "zero", "lead", "lag", "lacks", "bend", "limit", "carried"
        numbers: dict[str, Any] = dict.fromkeys(names, (0.0,) * n)
        numbers |= dict.fromkeys(("scale", "gain", "ratio"), (1.0,) * n)
        numbers |= {"gravity": gravity, "assumed": gravity}
        return cls(in_order, tau_order=in_order, **numbers)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.order)

    def with_entries(
        self, name: str, joints: Sequence[int], value: Any
    ) -> LogTransform:
        """Return the repair with ``value`` as the entry of some joints (from 0) of the
        field ``name``: ``with_entries("gain", [2], 0.5)``."""
        entries: Any = tuple(
            value if joint in joints else present
            for joint, present in enumerate(getattr(self, name))
        )
        return replace(self, **{name: entries})

    def with_multiplied(
        self, name: str, joints: Sequence[int], factor: float
    ) -> LogTransform:
        """Return the repair with the entries of some joints (from 0) of the field
        ``name`` multiplied by a factor."""
        entries: Any = tuple(
            factor * present if joint in joints else present
            for joint, present in enumerate(getattr(self, name))
        )
        return replace(self, **{name: entries})

    def with_swap(self, a: int, b: int, *names: str) -> LogTransform:
        """Return the repair with the channels that joints a and b take exchanged.

        names : which channels: "order" (positions), "tau_order" (torques), or both.
        """
        places = [*range(self.n)]
        places[a] = b
        places[b] = a
        swapped: dict[str, Any] = {}
        for name in names:
            channels = getattr(self, name)
            swapped[name] = tuple(channels[place] for place in places)
        return replace(self, **swapped)

    def with_event(self, event: LogEvent) -> LogTransform:
        """Return the repair with one more event; itself where it has this event."""
        if event in self.events:
            return self
        return replace(self, events=(*self.events, event))

    def without_event(self, event: LogEvent) -> LogTransform:
        """Return the repair without an event."""
        others = tuple(other for other in self.events if other != event)
        return replace(self, events=others)

    def list_nonzero(self, name: str) -> list[tuple[tuple[int, ...], float]]:
        """List the entries of the field ``name`` that are not 0, each with its joints.

        Returns
        -------
        list of (tuple of int, float)
            Joints from 0, and their entry: all joints together where they have the same
            entry, and else one joint at a time.
        """
        values = getattr(self, name)
        if len(set(values)) == 1:
            all_joints = tuple(range(self.n))
            return [(all_joints, values[0])] if values[0] else []
        return [((joint,), value) for joint, value in enumerate(values) if value]

    @cached_property
    def motion_part(self) -> LogTransform:
        """The repair with its changes of torque channels and of the direction of time
        undone, and gear ratios among the factors of positions. The columns of a fit depend
        on this part alone, and are cached by it."""
        motion = self.with_defaults(
            "tau_order", "gain", "lead", "lag", "bend", "limit", "reversed", "ratio"
        )
        if motion.ratio == self.ratio:
            return motion
        return replace(motion, scale=tuple(self.position_factors.tolist()))

    @cached_property
    def arm_part(self) -> LogTransform:
        """:attr:`motion_part` with events and missing weight undone as well. The
        columns of the links' parameters depend on this part alone, and are cached by
        it."""
        return self.motion_part.with_defaults("lacks", "events")

    def with_defaults(self, *names: str) -> LogTransform:
        """Return the repair with the named fields as in a log without a fault; itself
        where they are so already (so that caches find it)."""
        unchanged = self.unchanged(self.n, self.gravity)
        defaults: dict[str, Any] = {
            name: getattr(unchanged, name)
            for name in names
            if getattr(self, name) != getattr(unchanged, name)
        }
        return replace(self, **defaults) if defaults else self

    def followed_by(self, later: LogTransform) -> LogTransform:
        """Return one repair that has the effect of this one followed by ``later``.

        Order, scale, zero, gain, ratio, delay, low-pass, missing weight and clock are
        composed, and drifts added (a step lies in one run by itself); gravity is this one's
        where it is not the assumed one; everything else is the later one's.

        Parameters
        ----------
        later : LogTransform
            What is done to the outcome of this one.
        """
        # Pairs (j, k): joint j of the outcome takes channel k of this repair's outcome.
        of_position = [*enumerate(later.order)]
        of_torque = [*enumerate(later.tau_order)]
        factor = later.position_factors
        zero = tuple(
            float(factor[j]) * self.zero[k] + later.zero[j] for j, k in of_position
        )
        drifts = [event for event in self.events if event.at is None]
        return replace(
            later,
            order=tuple(self.order[k] for k in later.order),
            scale=tuple(later.scale[j] * self.scale[k] for j, k in of_position),
            zero=zero,
            tau_order=tuple(self.tau_order[k] for k in later.tau_order),
            gain=tuple(later.gain[j] * self.gain[k] for j, k in of_torque),
            ratio=tuple(later.ratio[j] * self.ratio[k] for j, k in of_position),
            lead=tuple(later.lead[j] + self.lead[k] for j, k in of_torque),
            lag=tuple(later.lag[j] + self.lag[k] for j, k in of_torque),
            lacks=tuple(np.add(later.lacks, self.lacks).tolist()),
            gravity=later.gravity if self.gravity == self.assumed else self.gravity,
            rate=later.rate * self.rate,
            reversed=later.reversed != self.reversed,
            events=(*drifts, *later.events),
        )

    def changed_alike(self, before: LogTransform, after: LogTransform) -> LogTransform:
        """Return this transform with what ``after`` changes of ``before``: its factors
        multiplied, its numbers added, and else its entries."""
        changed: dict[str, Any] = {}
        for name in (entry.name for entry in fields(self) if entry.compare):
            own, old, new = (getattr(x, name) for x in (self, before, after))
            if name in ("scale", "gain", "ratio"):
                changed[name] = tuple((np.array(own) * new / old).tolist())
            elif name in ("zero", "lead"):
                changed[name] = tuple((np.array(own) + new - old).tolist())
            elif isinstance(own, tuple) and name not in ("gravity", "events"):
                of_joints = zip(own, old, new, strict=True)
                changed[name] = tuple(x if b == a else b for x, a, b in of_joints)
            else:
                changed[name] = own if new == old else new
        return replace(self, **changed)

    @property
    def gravity_left(self) -> tuple[float, ...]:
        """Gravity vector [m/s^2] whose weight the torques hold: that of the model times 1 - s,
        if all torques lack the same share s of the weight (a controller compensates it);
        otherwise the gravity as it is."""
        share = 1.0 - self.lacks[0] if len(set(self.lacks)) == 1 else 1.0
        return tuple(float(round(share * g, 3)) + 0.0 for g in self.gravity)

    @property
    def position_factors(self) -> Array:
        """(n,) factor of each joint's logged position."""
        return np.array(self.scale) * np.array(self.ratio)

    @property
    def torque_factors(self) -> Array:
        """(n,) factor of each joint's logged torque."""
        return np.array(self.gain) / np.array(self.ratio)

    def within_limits(self, tau: Array) -> Array:
        """Return torques (..., n) no larger than the drives' limits."""
        if not any(self.limit):
            return tau
        largest = np.where(self.limit, self.limit, np.inf)
        return np.clip(tau, -largest, largest)

    def positions(self, q: Array) -> Array:
        """Return the true positions: q_j = ratio_j scale_j q_logged[order_j] + zero_j, of
        motors that are carried times A.

        Parameters
        ----------
        q : (N, n) array
            Positions as logged, by channel [rad, m].

        Returns
        -------
        (N, n) array
            Positions by joint [rad, m].
        """
        logged = q[:, list(self.order)]
        motors = logged * self.position_factors + np.array(self.zero)
        return self.of_joints(motors)

    @cached_property
    def joints_by_motors(self) -> Array | None:
        """(n, n) A, q = A m of angles m of the motors; None where each joint has its
        own."""
        if not any(self.carried):
            return None
        motors = np.eye(self.n) + np.diag(self.carried[1:], -1)
        return np.asarray(np.linalg.inv(motors))

    def of_joints(self, motors: Array) -> Array:
        """Return angles, velocities or accelerations (N, n) of joints by those of
        motors."""
        a = self.joints_by_motors
        return motors if a is None else motors @ a.T

    def apply(self, run: Measurements) -> Measurements:
        """Return the log repaired: order, scale, zero, gain, limit, delay and clock.

        Gravity, missing weight, bends and events are what a model has to assume: they
        change nothing of the log. Rows at the ends for which a delay leaves no torque are
        dropped.

        Returns
        -------
        Measurements
            The run repaired; itself where nothing of the log changes.
        """
        unchanged = self.unchanged(self.n, self.gravity)
        if self.with_defaults("lacks", "bend", "events") == unchanged:
            return run
        t = run.t
        is_inside = (t + max(self.lead) <= t[-1]) & (t + min(self.lead) >= t[0])
        dq = run.dq
        if dq is not None:
            dq = dq[:, list(self.order)] * self.position_factors / self.rate
            dq = self.of_joints(dq)
        repaired = replace(
            run,
            t=t[0] + self.rate * (t - t[0]),
            q=self.positions(run.q),
            tau=self._torques(run),
            dq=dq,
        ).rows(is_inside)
        return _in_reverse(repaired) if self.reversed else repaired

    def _torques(self, run: Measurements) -> Array:
        """Return the torques (N, n) by joint, as repaired [N m or N].

        tau_j(t) = gain_j raw_k(t + lead_j), with the channel k = tau_order[j]; between
        rows it is interpolated linearly.
        """
        tau = run.tau[:, list(self.tau_order)]
        for j, lead in enumerate(self.lead):
            if lead:
                tau[:, j] = np.interp(run.t + lead, run.t, tau[:, j])
        tau = self.within_limits(tau * self.torque_factors)
        a = self.joints_by_motors
        return tau if a is None else tau @ np.linalg.inv(a)


def _in_reverse(run: Measurements) -> Measurements:
    """Return the run backwards in time: the last row first, over the same span of time;
    velocities change their sign."""
    back = run.rows(np.arange(len(run.t))[::-1])
    dq = None if back.dq is None else -back.dq
    return replace(back, t=run.t[0] + run.t[-1] - back.t, dq=dq)
