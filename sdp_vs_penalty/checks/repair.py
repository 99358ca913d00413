"""What is done to a log, as one record: the net repair that every hypothesis is a value
of.

A hypothesis changes entries of this record; a composition of hypotheses is again one
record. So no joint can have two zeros, two gains or two signs, and what is reported is
what is done to the raw log:

    q_j   = scale_j q_raw[order_j] + zero_j            time  t = t_0 + rate (t_raw - t_0), or reversed
    tau_j = gain_j (tau_raw[tau_order_j] earlier by lead_j) + lag_j d(tau_j)/dt - events_j

where a channel that bends is straightened first: s artanh(tau_raw / s), s = max
|tau_raw| / bend_j.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array

Order = tuple[int, ...]
Numbers = tuple[float, ...]


@dataclass(frozen=True)
class LogEvent:
    """What one joint's torque has beside the arm's: a drift over the whole log, a step
    at a time ``at`` [s], or a law of its own motion, by name."""

    joint: int
    at: float | str | None = None

    def shape(self, t: Array) -> Array:
        """(N, 1) of which a drift or a step is a multiple, at instants t [s]."""
        assert not isinstance(self.at, str)  # laws are columns of the data
        ramp = (t - t[0]) / max(t[-1] - t[0], 1e-300)
        return np.asarray(ramp if self.at is None else (t > self.at) * 1.0)[:, None]


@dataclass(frozen=True)
class LogTransform:
    """See the module; all tuples have an entry a joint. gravity : [m/s^2] in the base
    frame; ``lacks``, the share of the arm's weight that each torque channel lacks, and
    ``longer`` [m], how much farther a joint is from the one before than the problem
    says: what a model has to assume, no change of the log; ``bend`` of a repaired file
    stays as it is."""

    order: Order
    scale: Numbers
    zero: Numbers
    tau_order: Order
    gain: Numbers
    lead: Numbers
    lag: Numbers
    gravity: tuple[float, ...]
    lacks: Numbers
    longer: Numbers
    bend: Numbers
    rate: float = 1.0
    reversed: bool = False
    events: tuple[LogEvent, ...] = ()

    @classmethod
    def unchanged(
        cls,
        n: int,
        gravity: tuple[float, ...],
    ) -> LogTransform:
        """The repair that changes nothing of n joints under a gravity [m/s^2]."""
        same = tuple(range(n))
        one = (1.0,) * n
        zero = (0.0,) * n
        return cls(
            same,
            one,
            zero,
            same,
            one,
            zero,
            zero,
            gravity,
            zero,
            zero,
            zero,
        )

    @property
    def n(self) -> int:
        """How many joints."""
        return len(self.order)

    def with_rate(self, rate: float) -> LogTransform:
        """This repair with true time running at ``rate`` times the file's."""
        return replace(self, rate=rate)

    def with_entries(
        self,
        name: str,
        joints: Sequence[int],
        value: Any,
    ) -> LogTransform:
        """Some joints' entries of one of the tuples."""
        entries: Any = tuple(
            value if j in joints else x for j, x in enumerate(getattr(self, name))
        )
        return replace(self, **{name: entries})

    def times(
        self,
        name: str,
        joints: Sequence[int],
        factor: float,
    ) -> LogTransform:
        """Some joints' entries multiplied by a factor."""
        entries: Any = tuple(
            factor * x if j in joints else x for j, x in enumerate(getattr(self, name))
        )
        return replace(self, **{name: entries})

    def with_swap(
        self,
        a: int,
        b: int,
        *names: str,
    ) -> LogTransform:
        """The channels that joints a and b take, exchanged: of ``order``, ``tau_order``
        or both."""
        places = [b if j == a else a if j == b else j for j in range(self.n)]
        swapped: dict[str, Any] = {
            x: tuple(getattr(self, x)[k] for k in places) for x in names
        }
        return replace(self, **swapped)

    def with_event(self, event: LogEvent) -> LogTransform:
        """With one more event; itself where it has it."""
        return (
            self
            if event in self.events
            else replace(self, events=(*self.events, event))
        )

    def without(self, event: LogEvent) -> LogTransform:
        """But for an event."""
        return replace(self, events=tuple(e for e in self.events if e != event))

    @cached_property
    def without_laws(self) -> LogTransform:
        """But for the laws of joints' own motions."""
        others = tuple(e for e in self.events if not isinstance(e.at, str))
        return self if others == self.events else replace(self, events=others)

    def changed(self, name: str) -> list[tuple[tuple[int, ...], float]]:
        """Joints whose entry of a tuple is not zero, and the entry: all where it is
        one."""
        values = getattr(self, name)
        if len(set(values)) == 1:
            return [(tuple(range(self.n)), values[0])] if values[0] else []
        return [((j,), x) for j, x in enumerate(values) if x]

    @cached_property
    def of_motion(self) -> LogTransform:
        """Without what is done to the torque's channels alone, and whichever way time
        runs."""
        return self.reset("tau_order", "gain", "lead", "lag", "bend", "reversed")

    @cached_property
    def of_arm(self) -> LogTransform:
        """What of it the columns depend on that joints share, with all of the arm's
        weight."""
        return self.of_motion.reset("lacks", "events")

    def reset(self, *names: str) -> LogTransform:
        """With these entries as a log has them that is right; itself where it is, as
        most hypotheses."""
        unchanged = LogTransform.unchanged(self.n, self.gravity)
        right: dict[str, Any] = {name: getattr(unchanged, name) for name in names}
        same = all(getattr(self, name) == value for name, value in right.items())
        return self if same else replace(self, **right)

    def then(self, later: LogTransform) -> LogTransform:
        """This repair of a log's channels and clock, and another one of what it makes.

        Everything but order, scale, zero, gain, delays and clock is the later one's.
        """
        order = later.order
        tau_order = later.tau_order
        scale = tuple(later.scale[j] * self.scale[k] for j, k in enumerate(order))
        zero = tuple(
            later.scale[j] * self.zero[k] + later.zero[j] for j, k in enumerate(order)
        )
        gain = tuple(later.gain[j] * self.gain[k] for j, k in enumerate(tau_order))
        return replace(
            later,
            order=tuple(self.order[k] for k in order),
            scale=scale,
            zero=zero,
            tau_order=tuple(self.tau_order[k] for k in tau_order),
            gain=gain,
            lead=tuple(later.lead[j] + self.lead[k] for j, k in enumerate(tau_order)),
            rate=later.rate * self.rate,
            reversed=later.reversed != self.reversed,
        )

    def positions(self, q: Array) -> Array:
        """(N, n) true positions from those of the log."""
        logged = q[:, list(self.order)]
        return np.asarray(logged * np.array(self.scale) + np.array(self.zero))

    def apply(self, run: Measurements) -> Measurements:
        """The log repaired; gravity, weight and events are the model's matter and are
        left alone."""
        unchanged = LogTransform.unchanged(self.n, self.gravity)
        if self.reset("lacks", "longer", "bend", "events") == unchanged:
            return run
        t = run.t
        is_inside = (t + max(self.lead) <= t[-1]) & (t + min(self.lead) >= t[0])
        dq = run.dq
        if dq is not None:
            dq = dq[:, list(self.order)] * np.array(self.scale) / self.rate
        repaired = replace(
            run,
            t=t[0] + self.rate * (t - t[0]),
            q=self.positions(run.q),
            tau=self._torques(run),
            dq=dq,
        ).rows(is_inside)
        return _in_reverse(repaired) if self.reversed else repaired

    def _torques(self, run: Measurements) -> Array:
        """(N, n) torques in the true order, scaled and in time with the motion."""
        tau = run.tau[:, list(self.tau_order)]
        for j, lead in enumerate(self.lead):
            if lead:
                tau[:, j] = np.interp(
                    run.t + lead,
                    run.t,
                    tau[:, j],
                )
        return np.asarray(tau * np.array(self.gain))


def _in_reverse(run: Measurements) -> Measurements:
    """The last row first, in as much time."""
    back = run.rows(np.arange(len(run.t))[::-1])
    dq = None if back.dq is None else -back.dq
    return replace(
        back,
        t=run.t[0] + run.t[-1] - back.t,
        dq=dq,
    )
