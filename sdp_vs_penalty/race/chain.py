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
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Annotated, Any, Literal, get_type_hints

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array

Order = tuple[int, ...]
Numbers = tuple[float, ...]
#: Least limit of an amplifier: a channel is divided by it.
_TINY = 1e-300
#: An amplifier's curve is inverted up to this share of its limit [-].
_LARGEST_SHARE_OF_LIMIT = 0.999


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
class _Entries:
    """What a field with one number a joint says of itself, once for all that is done
    with it."""

    #: Number of a joint without a fault.
    neutral: float
    #: How two changes make one: "product", "sum", or "later" where the later one counts:
    #: what all rows have, so that a part has none of its own.
    composed: Literal["product", "sum", "later"]
    #: Whose numbers they are: those of the channels in the field "order" (positions) or
    #: "tau_order" (torques); "" for a joint's own.
    channels: Literal["order", "tau_order", ""] = ""

    def compose(self, first: float, later: float) -> float:
        """Return the number of the one change that does what ``first`` and then ``later``
        do."""
        if self.composed == "product":
            return later * first
        return later + first if self.composed == "sum" else later

    def apply_change(self, own: float, before: float, after: float) -> float:
        """Return the number ``own`` with the same change that leads from ``before`` to
        ``after``: their ratio, their difference, or the later value."""
        if self.composed == "product":
            return own * after / before
        if self.composed == "sum":
            return own + after - before
        return own if after == before else after


@dataclass(frozen=True)
class LogTransform:
    """What is done to a log, as in the module's equations, and what its model has to
    assume; one entry a joint where a field has several."""

    #: Position channel that each joint takes.
    order: Order
    #: Factor of positions, q = scale q_raw + zero [-].
    scale: Annotated[Numbers, _Entries(1.0, "product", "order")]
    #: Zero of positions, q = scale q_raw + zero [rad, m].
    zero: Annotated[Numbers, _Entries(0.0, "sum", "order")]
    #: Torque channel that each joint takes.
    tau_order: Order
    #: Factor of torques [-].
    gain: Annotated[Numbers, _Entries(1.0, "product", "tau_order")]
    #: How much later a torque is [s].
    lead: Annotated[Numbers, _Entries(0.0, "sum", "tau_order")]
    #: Time constant of a torque's low-pass [s].
    lag: Annotated[Numbers, _Entries(0.0, "sum", "tau_order")]
    #: Gravity in the base frame that the model assumes [m/s^2].
    gravity: tuple[float, ...]
    #: Share of the arm's weight that each torque lacks [-].
    missing_weight: Annotated[Numbers, _Entries(0.0, "sum")]
    #: Largest torque over an amplifier's limit [-].
    bend: Annotated[Numbers, _Entries(0.0, "later", "tau_order")]
    #: Largest torque of a drive, in the place of commands beyond it [N m, N]; 0: any.
    limit: Annotated[Numbers, _Entries(0.0, "later", "tau_order")]
    #: Gear ratio over the logger's: a factor of positions, a divisor of torques [-].
    ratio: Annotated[Numbers, _Entries(1.0, "product", "order")]
    #: How far the logged motor of a joint turns with the joint before it [-]: 1 or -1 of
    #: a parallelogram, whose motors sit on one link.
    carried: Annotated[Numbers, _Entries(0.0, "later")]
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
        """Return the transform that changes nothing of n joints under a gravity in the
        base frame [m/s^2]."""
        in_order = tuple(range(n))
        numbers: dict[str, Any] = {
            name: (entries.neutral,) * n for name, entries in ENTRIES.items()
        }
        return cls(
            in_order, tau_order=in_order, gravity=gravity, assumed=gravity, **numbers
        )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.order)

    def with_entries(
        self, name: str, joints: Sequence[int], value: Any
    ) -> LogTransform:
        """Return the transform with ``value`` as the entry of some joints (from 0) of the
        field ``name``: ``with_entries("gain", [2], 0.5)``."""
        entries: Any = tuple(
            value if joint in joints else present
            for joint, present in enumerate(getattr(self, name))
        )
        return replace(self, **{name: entries})

    def with_multiplied(
        self, name: str, joints: Sequence[int], factor: float
    ) -> LogTransform:
        """Return the transform with the entries of some joints (from 0) of the field
        ``name`` multiplied by a factor."""
        entries: Any = tuple(
            factor * present if joint in joints else present
            for joint, present in enumerate(getattr(self, name))
        )
        return replace(self, **{name: entries})

    def with_swap(self, a: int, b: int, *names: str) -> LogTransform:
        """Return the transform with the channels that joints a and b take exchanged.

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
        """Return the transform with one more event; itself where it has this event."""
        if event in self.events:
            return self
        return replace(self, events=(*self.events, event))

    def without_event(self, event: LogEvent) -> LogTransform:
        """Return the transform without an event."""
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
        """The transform with its changes of torque channels and of the direction of time
        undone, and gear ratios among the factors of positions. The columns of a fit depend
        on this part alone, and are cached by it."""
        of_torque = [x for x in ENTRIES if ENTRIES[x].channels == "tau_order"]
        motion = self.with_defaults("tau_order", *of_torque, "reversed", "ratio")
        if motion.ratio == self.ratio:
            return motion
        return replace(motion, scale=tuple(self.position_factors.tolist()))

    @cached_property
    def arm_part(self) -> LogTransform:
        """:attr:`motion_part` with events and missing weight undone as well. The
        columns of the links' parameters depend on this part alone, and are cached by
        it."""
        return self.motion_part.with_defaults("missing_weight", "events")

    def with_defaults(self, *names: str) -> LogTransform:
        """Return the transform with the named fields as in a log without a fault; itself
        where they are so already (so that caches find it)."""
        unchanged = self.unchanged(self.n, self.gravity)
        defaults: dict[str, Any] = {
            name: getattr(unchanged, name)
            for name in names
            if getattr(self, name) != getattr(unchanged, name)
        }
        return replace(self, **defaults) if defaults else self

    def followed_by(self, later: LogTransform) -> LogTransform:
        """Return the one transform that does what this one and then ``later`` do.

        Numbers are multiplied, added or replaced, as their fields say; orders and clocks
        are composed. Drifts of both are kept, steps of ``later`` alone (a step lies in one
        run). Gravity is this one's, if it differs from the problem's.

        Parameters
        ----------
        later : LogTransform
            What is done to the outcome of this one.
        """
        channels = {"order": later.order, "tau_order": later.tau_order}
        numbers: dict[str, Any] = {}
        for name, entries in ENTRIES.items():
            entries_here = getattr(self, name)
            first = [
                entries_here[k] for k in channels.get(entries.channels, range(self.n))
            ]
            if name == "zero":
                first = (later.position_factors * first).tolist()
            numbers[name] = tuple(map(entries.compose, first, getattr(later, name)))
        drifts = [event for event in self.events if event.at is None]
        return replace(
            later,
            order=tuple(self.order[k] for k in later.order),
            tau_order=tuple(self.tau_order[k] for k in later.tau_order),
            **numbers,
            gravity=later.gravity if self.gravity == self.assumed else self.gravity,
            rate=later.rate * self.rate,
            reversed=later.reversed != self.reversed,
            events=(*drifts, *later.events),
        )

    def with_change(self, before: LogTransform, after: LogTransform) -> LogTransform:
        """Return this transform with the same change that leads from ``before`` to
        ``after``: a factor, a sum or another value, as each field says."""
        changed: dict[str, Any] = {"rate": self.rate * after.rate / before.rate}
        for name, entries in ENTRIES.items():
            three = (getattr(x, name) for x in (self, before, after))
            changed[name] = tuple(map(entries.apply_change, *three))
        for name in ("order", "tau_order"):
            of_joints = zip(
                *(getattr(x, name) for x in (self, before, after)), strict=True
            )
            changed[name] = tuple(x if b == a else b for x, a, b in of_joints)
        for name in ("gravity", "reversed", "events"):
            own, old, new = (getattr(x, name) for x in (self, before, after))
            changed[name] = own if new == old else new
        return replace(self, **changed)

    @property
    def gravity_left(self) -> tuple[float, ...]:
        """Gravity vector [m/s^2] whose weight the torques hold: that of the model times 1 - s,
        if all torques lack the same share s of the weight (a controller compensates it);
        otherwise the gravity as it is."""
        share = (
            1.0 - self.missing_weight[0] if len(set(self.missing_weight)) == 1 else 1.0
        )
        return tuple(float(round(share * g, 3)) + 0.0 for g in self.gravity)

    @cached_property
    def position_factors(self) -> Array:
        """(n,) factor of each joint's logged position."""
        return np.array(self.scale) * np.array(self.ratio)

    @cached_property
    def torque_factors(self) -> Array:
        """(n,) factor of each joint's logged torque."""
        return np.array(self.gain) / np.array(self.ratio)

    @property
    def changes_shape(self) -> bool:
        """Whether :meth:`torques` needs channels at other instants, or their rates and
        largest readings: a fault of time or shape, beside factors and limits."""
        return any((*self.lead, *self.lag, *self.bend))

    def torques(
        self, channels: Array, rates: Array | None = None, largest: Array | None = None
    ) -> Array:
        """Return the torques (n, N) of motors by what their channels read:

        tau_j = gain_j / ratio_j (s(x_j) + lag_j dx_j/dt), no larger than limit_j, where s
        straightens a channel that bends towards its amplifier's limit.

        Parameters
        ----------
        channels : (n, N) array
            x_j, the channel that joint j takes, read ``lead_j`` later [N m or N].
        rates : (n, N) array
            Their time derivatives; None: bends and lags stay in the torques.
        largest : (n,) array
            Largest reading of each of the channels, for those that bend.
        """
        tau = channels
        if rates is not None and largest is not None:
            if any(self.bend):
                pairs = zip(channels, self.bend, largest.tolist(), strict=True)
                tau = np.array(
                    [_straighten(x, top / b) if b else x for x, b, top in pairs]
                )
            if any(self.lag):
                tau = tau + np.array(self.lag)[:, None] * rates
        tau = self.torque_factors[:, None] * tau
        if not any(self.limit):
            return tau
        limits = np.where(self.limit, self.limit, np.inf)[:, None]
        return np.clip(tau, -limits, limits)

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
        if self.with_defaults("missing_weight", "bend", "events") == unchanged:
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
            tau=self._torques_of_joints(run),
            dq=dq,
        ).rows(is_inside)
        return _in_reverse(repaired) if self.reversed else repaired

    def _torques_of_joints(self, run: Measurements) -> Array:
        """Return the torques (N, n) of joints as repaired [N m or N]; a channel is
        interpolated linearly between rows."""
        channels = run.tau.T[list(self.tau_order)]
        for j, lead in enumerate(self.lead):
            if lead:
                channels[j] = np.interp(run.t + lead, run.t, channels[j])
        tau = np.ascontiguousarray(self.torques(channels).T)
        a = self.joints_by_motors
        return tau if a is None else tau @ np.linalg.inv(a)


#: Fields of :class:`LogTransform` with one number a joint, each with what it says of itself.
ENTRIES: dict[str, _Entries] = {
    name: hint.__metadata__[0]
    for name, hint in get_type_hints(LogTransform, include_extras=True).items()
    if hasattr(hint, "__metadata__")
}


def _straighten(value: Array, limit: float) -> Array:
    """Return the true torque (M,) of a channel x (M,) whose amplifier saturates.

    The channel reads x = s tanh(tau / s), with the limit s > 0 in its unit; the torque
    is tau = s artanh(x / s). x / s is clipped just below 1, where artanh is infinite.
    """
    limit = max(limit, _TINY)  # a dead channel has no limit
    share = np.clip(value / limit, -_LARGEST_SHARE_OF_LIMIT, _LARGEST_SHARE_OF_LIMIT)
    return limit * np.arctanh(share)


def _in_reverse(run: Measurements) -> Measurements:
    """Return the run backwards in time: the last row first, over the same span of time;
    velocities change their sign."""
    back = run.rows(np.arange(len(run.t))[::-1])
    dq = None if back.dq is None else -back.dq
    return replace(back, t=run.t[0] + run.t[-1] - back.t, dq=dq)
