"""From raw logs to regression rows: resampling, states, and one low-pass on both sides.

Three steps, each zero-phase and each with a finite impulse response, so that a run can be worked
through in pieces with exactly the result of the whole:

1. Jittered time stamps are resampled linearly to the median rate. Runs are split at gaps.
2. The position is convolved with a low-pass kernel and its exact first and second derivative:
   q, dq, ddq at one cut-off (``state_cutoff``). Measured velocities are not used: drives filter
   them, with a lag that would have to be known.
3. The model's columns are computed from these states, and columns AND torque pass the same second
   low-pass (``torque_cutoff``), which therefore leaves the linear relation between them intact; rows
   are decimated to four times its cut-off. Columns are computed at 30 times that cut-off (effects
   with memory: at the full rate), where the low-pass is the same to 1e-4 of the sharpest of them,
   Coulomb friction's.

The kernel (kernels.py) reaches 2 / cut-off to either side. Rows within the half lengths of both kernels
of the ends of a run would need samples from outside it, and are dropped.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import JointColumns, Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.signals.kernels import Kernel

Array = NDArray[np.float64]

#: Rows decimated to this multiple of the cut-off: the kernel's stop band starts at 1.4 cut-offs.
_OVERSAMPLING = 4.0
#: Columns are computed at this multiple of the cut-off: what they hold above half of it (reversals of
#: friction, products of states) must not fold back below the cut-off.
_COLUMN_RATE = 30.0
#: Raw samples worked on at a time: bounds the memory for the columns whatever a run's length.
_CHUNK = 4096


@dataclass(frozen=True)
class Preprocessing:
    """Settings of the filters; None is chosen from the data by :meth:`resolve`.

    state_cutoff : [Hz] of q, dq, ddq. Default: ten times the highest excitation harmonic. Higher
        lets position noise into ddq, lower bends the motion. On the slow Panda run: 5 Hz.
    torque_cutoff : [Hz] of columns and torque. Default: 1.6 times the former (Panda: 8 Hz), so that
        friction at reversals, sharper than the motion, stays visible.
    standstill : rows are dropped where no joint has moved faster than this share of its own
        maximum for half a second: they repeat one static friction state that no model of
        sliding friction explains.
    """

    state_cutoff: float | None = None
    torque_cutoff: float | None = None
    standstill: float = 2e-3

    def __post_init__(self) -> None:
        for name in ("state_cutoff", "torque_cutoff"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise InputError(f"preprocessing: {name} {value!r} is not a frequency above 0 Hz.")
        if not 0.0 <= self.standstill < 1.0:
            raise InputError(f"preprocessing: standstill {self.standstill!r} is not a share below 1.")

    def resolve(self, measurements: Measurements) -> Preprocessing:
        """The same settings with every number filled in for these measurements."""
        rate = min(_rate(run) for run in measurements.runs())
        state = self.state_cutoff
        if state is None:
            state = 10.0 * max(_highest_harmonic(run) for run in measurements.runs())
        state = min(state, rate / 10.0)
        torque = 1.6 * state if self.torque_cutoff is None else self.torque_cutoff
        return replace(self, state_cutoff=state, torque_cutoff=min(torque, rate / 5.0))


@dataclass(frozen=True)
class Rows:
    """Filtered, decimated rows of one run: motion (M, n), torque (M, n), columns joint by joint."""

    motion: Motion
    torque: Array
    columns: list[JointColumns]


def filtered_rows(run: Measurements, model: Model, settings: Preprocessing) -> Iterator[Rows]:
    """The regression rows of one run, piece by piece; ``settings`` must be resolved.

    Raises InputError where a run is shorter than the filters need.
    """
    assert settings.state_cutoff is not None
    assert settings.torque_cutoff is not None
    dt = 1.0 / _rate(run)
    state = Kernel(settings.state_cutoff, dt)
    column = Kernel(settings.torque_cutoff, dt)
    margin = state.half + column.half
    step = _decimation(settings.torque_cutoff, dt)
    moving = _Movement(run, settings.standstill)
    # What an effect with memory remembers has to be followed sample by sample, from the start.
    whole = any(effect.has_memory for effect in model.effects)
    stride = 1 if whole else _stride(settings.torque_cutoff, dt)
    coarse = column.sampled(stride)
    reach = stride * coarse.half
    found = False
    for part in _stretches(run, dt):
        outputs = np.arange(margin, part.count - margin, step)
        per_chunk = len(outputs) if whole else max(1, _CHUNK // step)
        for number in range(0, len(outputs), max(per_chunk, 1)):
            at = outputs[number : number + per_chunk]
            # From first to last: the samples whose columns the low-pass of these outputs needs.
            first, last = at[0] - reach, at[-1] + reach
            keep = moving.at(part.clock(at))
            if not keep.any():
                continue
            found = True
            around = part.resampled(part.q, first - state.half, last + 1 + state.half)
            low, velocity, acceleration = (x[::stride] for x in state.states(around))
            clock = part.clock(np.arange(first, last + 1, stride))
            motion = Motion(clock, low, velocity, acceleration)
            local = (at[keep] - first) // stride
            low_pass = coarse.decimator(len(motion.t), local)
            begin, end = at[0] - column.half, at[-1] + column.half + 1
            yield Rows(
                Motion(motion.t[local], motion.q[local], motion.dq[local], motion.ddq[local]),
                column.decimator(end - begin, at[keep] - begin) @ part.resampled(part.tau, begin, end),
                [JointColumns(c.indices, low_pass @ c.columns) for c in model.columns(motion)],
            )
    if not found:
        raise _no_rows(run, 2 * margin * dt)


def rows_per_sample(run: Measurements, settings: Preprocessing) -> float:
    """How many rows of one run hold as much of white torque noise as one independent sample.

    A row has the variance sigma^2 sum h^2 of noise low-passed by h; within the pass band, where the
    columns are, the noise keeps its density, which at one row in ``step`` samples is that of
    independent rows of variance sigma^2 / step.
    """
    assert settings.torque_cutoff is not None
    dt = 1.0 / _rate(run)
    kernel = Kernel(settings.torque_cutoff, dt).value
    return float(1.0 / (_decimation(settings.torque_cutoff, dt) * (kernel @ kernel)))


def _stride(cutoff: float, dt: float) -> int:
    """The columns of one sample in so many are computed."""
    return max(1, int(1.0 / (_COLUMN_RATE * cutoff * dt)))


def _decimation(cutoff: float, dt: float) -> int:
    """One row in so many samples."""
    stride = _stride(cutoff, dt)
    return stride * max(1, int(1.0 / (_OVERSAMPLING * cutoff * dt * stride)))


def filtered_torque(run: Measurements, model: Model, settings: Preprocessing) -> Rows:
    """All rows of a run at once."""
    pieces = list(filtered_rows(run, model, settings))

    def join(name: str) -> Array:
        return np.concatenate([getattr(p.motion, name) for p in pieces])

    columns = [
        JointColumns(parts[0].indices, np.concatenate([p.columns for p in parts]))
        for parts in zip(*(p.columns for p in pieces), strict=True)
    ]
    motion = Motion(join("t"), join("q"), join("dq"), join("ddq"))
    return Rows(motion, np.concatenate([p.torque for p in pieces]), columns)


def low_passed(run: Measurements, settings: Preprocessing, rows: int) -> tuple[Motion, Array, Array]:
    """At most so many evenly spread instants of one run: states, torque and its rate, low-passed.

    The torque passes the kernel that the position passes, and columns are computed from the states
    as they are: cheaper than :func:`filtered_rows`, and equal to it for slow motion. Enough to
    judge data, not to identify from. Stand-still is dropped. Raises InputError for short runs.
    """
    assert settings.state_cutoff is not None
    dt = 1.0 / _rate(run)
    kernel = Kernel(settings.state_cutoff, dt)
    moving = _Movement(run, settings.standstill)
    width = 2 * kernel.half + 1
    places = []
    for part in _stretches(run, dt):
        k = np.arange(kernel.half, part.count - kernel.half)
        places.append((part, k[moving.at(part.clock(k))]))
    count = sum(len(k) for _, k in places)
    if count == 0:
        raise _no_rows(run, (width - 1) * dt)
    chosen = np.unique(np.linspace(0, count - 1, min(rows, count)).round().astype(int))
    pieces, start = [], 0
    for part, k in places:
        own = k[chosen[(chosen >= start) & (chosen < start + len(k))] - start]
        start += len(k)
        # Only what the kernel reaches of a long run is looked at.
        for at in np.split(own, np.flatnonzero(np.diff(own) > width) + 1):
            if len(at):
                begin, end = at[0] - kernel.half, at[-1] + kernel.half + 1
                states = kernel.states(part.resampled(part.q, begin, end))
                smooth, slope, _ = kernel.states(part.resampled(part.tau, begin, end))
                pieces.append((part.clock(at), *(x[at - at[0]] for x in (*states, smooth, slope))))
    t, q, dq, ddq, tau, rate = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    return Motion(t, q, dq, ddq), tau, rate


def _no_rows(run: Measurements, seconds: float) -> InputError:
    """For a run of which nothing is left; ``seconds`` are what the filters need."""
    if not _moving_joints(run).any():
        return _no_motion(run)
    lasts = float(run.t[-1] - run.t[0])
    if lasts <= seconds:
        return InputError(
            f"{run.names[0]}: the run lasts {lasts:.3g} s, the filters need more than {seconds:.3g} s: "
            "record longer, or raise the cut-offs."
        )
    return InputError(
        f"{run.names[0]}: no rows are left after filtering: the robot does not move for more than the "
        f"{seconds:.3g} s on end that the filters need: record a longer motion, or raise the cut-offs."
    )


def _no_motion(run: Measurements) -> InputError:
    return InputError(f"{run.names[0]}: the robot does not move in this run: record a motion.")


class _Movement:
    """Which instants belong to motion rather than standstill, from positions half a second apart."""

    def __init__(self, run: Measurements, share: float) -> None:
        self.t = run.t
        self.moves = np.zeros(len(run.t), bool)
        parts = [slice(k, k + _PART) for k in range(0, len(run.t), _PART)]
        for j in np.flatnonzero(_moving_joints(run)).tolist():
            largest = max(_travel(run, j, part).max() for part in parts)
            for part in parts:
                self.moves[part] |= _travel(run, j, part) > share * largest

    def at(self, t: Array) -> NDArray[np.bool_]:
        return self.moves[np.clip(np.searchsorted(self.t, t), 0, len(self.t) - 1)]


#: Samples judged at a time, so that long runs cost no more memory than short ones.
_PART = 1 << 14


def _travel(run: Measurements, j: int, part: slice) -> Array:
    """How far a joint comes within half a second, at the samples of a part."""
    t = run.t[part]
    first, last = np.searchsorted(run.t, [t[0] - 0.25, t[-1] + 0.25])
    around = slice(max(int(first) - 1, 0), int(last) + 1)
    known, q = run.t[around], run.q[around, j]
    return np.abs(np.interp(t + 0.25, known, q) - np.interp(t - 0.25, known, q))


#: A joint whose position has at most this standard deviation [rad, m] may be an idle one's noise.
_LARGEST_NOISE = 0.01


def _moving_joints(run: Measurements) -> NDArray[np.bool_]:
    """(n,) which joints move at all, rather than flicker about one position.

    From row to row a noisy position changes as much as it ever does (the ratio is 0.7 for white
    noise, up to 1.5 for the idle joints of a real arm), a smooth motion far less (over 100).
    """
    spread = np.array([q.std() for q in run.q.T])
    step = np.array([np.sqrt(np.mean(np.diff(q) ** 2)) for q in run.q.T])
    return np.asarray((spread > 4.0 * step) | (spread > _LARGEST_NOISE))


def _rate(run: Measurements) -> float:
    return 1.0 / float(np.median(np.diff(run.t)))


@dataclass(frozen=True)
class _Stretch:
    """What lies between two gaps of a run's clock, resampled to t[0] + k dt where it is asked for."""

    t: Array
    q: Array
    tau: Array
    dt: float

    @property
    def count(self) -> int:
        return int((self.t[-1] - self.t[0]) / self.dt) + 1

    def clock(self, k: NDArray[np.int64]) -> Array:
        return np.asarray(self.t[0] + self.dt * k)

    def resampled(self, values: Array, start: int, stop: int) -> Array:
        """q or tau at the grid's samples start to stop - 1, (stop - start, n)."""
        grid = self.clock(np.arange(start, stop))
        # Of a long run only what lies around: interpolation copies what it is given.
        first = max(int(np.searchsorted(self.t, grid[0], "right")) - 1, 0)
        around = slice(first, int(np.searchsorted(self.t, grid[-1])) + 1)
        known = self.t[around]
        return np.column_stack([np.interp(grid, known, x) for x in values[around].T])


def _stretches(run: Measurements, dt: float) -> Iterator[_Stretch]:
    breaks = np.flatnonzero(np.diff(run.t) > max(20.0 * dt, 0.05)) + 1
    for start, stop in zip([0, *breaks], [*breaks, len(run.t)], strict=True):
        if stop - start >= 2:
            yield _Stretch(run.t[start:stop], run.q[start:stop], run.tau[start:stop], dt)


def _segments(run: Measurements, dt: float) -> Iterator[tuple[Array, Array, Array]]:
    """(t, q, tau) of whole stretches on a uniform grid."""
    for part in _stretches(run, dt):
        q, tau = (part.resampled(x, 0, part.count) for x in (part.q, part.tau))
        yield part.clock(np.arange(part.count)), q, tau


def _highest_harmonic(run: Measurements) -> float:
    """Highest frequency [Hz] at which some joint's position has 1 % of its largest amplitude."""
    dt = 1.0 / _rate(run)
    highest = 0.0
    moving = _moving_joints(run)
    for part in _stretches(run, dt):
        count = part.count
        if count < 16:
            continue
        for j in np.flatnonzero(moving):
            q = part.resampled(part.q[:, j : j + 1], 0, count)[:, 0]
            if np.ptp(q) == 0.0:
                continue
            amplitude = np.abs(fft.rfft(np.hanning(count) * (q - q.mean())))
            present = np.flatnonzero(amplitude > 0.01 * amplitude.max())
            highest = max(highest, int(present[-1]) / (count * dt))
    if highest == 0.0:
        if not moving.any():
            raise _no_motion(run)
        raise InputError(
            f"{run.names[0]}: {len(run.t)} samples, and never 16 without a gap in time between them: "
            "record longer."
        )
    return highest
