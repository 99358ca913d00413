"""A run as it was recorded: its rate, its gaps, which joints move and when."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise

import numpy as np
import scipy

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.store import PART, concatenate_chunks, drop_pages, iter_chunks
from sdp_vs_penalty.data.stretches.gaps import rows_behind_gaps, usual_step
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.signals.constants import SAME_PHASE

#: A joint whose position has at most this standard deviation [rad, m] may be an idle
#: one's noise.
_LARGEST_NOISE = 0.01
#: A joint whose servo holds it gives way to the other joints' motion: it moves by at most
#: this share of the joint that moves most.
_HELD = 0.02


def sample_rate(run: Measurements) -> float:
    """Return the sample rate of a run [Hz]: one over the median time step.

    :func:`~sdp_vs_penalty.data.stretches.gaps.usual_step` says what counts as a step.
    """
    return 1.0 / usual_step(run.t)


def moving_joints(run: Measurements) -> Mask:
    """Return which joints (n,) move at all, rather than flicker about one position or
    give way to the others' motion.

    A joint moves if the standard deviation of its position is large, or large compared
    with its changes from row to row and with that of the joint that moves most. A noisy
    position changes as much from row to row as it ever does (the ratio is 0.7 for white
    noise, up to 1.5 for the idle joints of a real arm), a smooth motion far less (over
    100).
    """
    # Sums over the rows of displacements, their squares, and squared steps.
    total = np.zeros(run.n)
    square = np.zeros(run.n)
    steps = np.zeros(run.n)
    for _, part in iter_chunks(run.q, overlap=1):
        q = np.ascontiguousarray(part.T)  # several times as fast as row by row
        displacement = q[:, :PART] - run.q[0][:, None]
        total = total + displacement.sum(axis=1)
        square = square + np.sum(displacement**2, axis=1)
        differences = np.diff(q, axis=1)
        steps = steps + np.sum(differences**2, axis=1)
    count = len(run.q)
    variance = square / count - (total / count) ** 2
    spread = np.sqrt(np.maximum(variance, 0.0))
    step = np.sqrt(steps / max(count - 1, 1))
    is_smooth = spread > 4.0 * step
    largest = np.max(spread, initial=0.0, where=is_smooth)
    is_free = spread > _HELD * largest
    return (is_smooth & is_free) | (spread > _LARGEST_NOISE)


class Movement:
    """Which instants belong to motion rather than standstill, from positions half a
    second apart.

    ``moves`` (N,) flags the samples at which some joint comes farther within half a
    second than a share of the farthest that it ever comes.
    """

    def __init__(self, run: Measurements, share: float) -> None:
        """Find the samples of a run at which the arm moves; a joint stands still below
        ``share`` [-] of its largest displacement in half a second."""
        self.t = run.t
        displacement = concatenate_chunks(_displacements(run))
        largest = np.max([x.max(axis=0) for _, x in iter_chunks(displacement)], axis=0)
        limits = np.where(moving_joints(run), share * largest, np.inf)
        parts = [np.any(x > limits, axis=1) for _, x in iter_chunks(displacement)]
        self.moves = np.concatenate(parts)

    def at(self, t: Array) -> Mask:
        """Return for instants t (M,) [s] whether each belongs to motion."""
        sample = np.searchsorted(self.t, t)
        drop_pages(self.t)
        inside = np.clip(sample, 0, len(self.t) - 1)
        return self.moves[inside]


def still_seconds(run: Measurements, movement: Movement) -> float:
    """Return how long the arm stands still in a run [s].

    Parameters
    ----------
    movement : Movement
        Which of its samples belong to motion.
    """
    n_still = sum(int(np.sum(~part)) for _, part in iter_chunks(movement.moves))
    return n_still / sample_rate(run) if n_still else 0.0


def _displacements(run: Measurements) -> Iterator[Array]:
    """Yield the absolute displacement of each joint over the half second around each
    sample, (N, n) chunk by chunk."""
    for _, t in iter_chunks(run.t):
        end = interpolated(t + SAME_PHASE, run.t, run.q)
        start = interpolated(t - SAME_PHASE, run.t, run.q)
        yield np.abs(end - start)


def spans(flags: Mask) -> Indices:
    """Find the stretches of consecutive True flags (N,).

    Returns
    -------
    (K, 2) array of int
        First index of each stretch, and the index behind its last.

    Examples
    --------
    >>> spans(np.array([True, True, False, True])).tolist()
    [[0, 2], [3, 4]]
    """
    padded = np.concatenate([[0], flags.astype(np.int8), [0]])
    return np.flatnonzero(np.diff(padded)).reshape(-1, 2)


@dataclass(frozen=True)
class Stretch:
    """The part of a run between two gaps of its clock.

    It is as logged (N samples), and can be resampled to the even grid t[0] + k dt.
    """

    #: (N,) instants [s].
    t: Array
    #: (N, n) positions [rad or m].
    q: Array
    #: (N, n) torque [N m or N].
    tau: Array
    #: Sample time of the even grid [s].
    dt: float
    #: (N, n) temperatures [degrees Celsius], None if not logged.
    temperature: Array | None = None
    #: (N, n) commanded positions [rad or m], None if not logged.
    qcmd: Array | None = None
    #: (N, n) integrals of the position over time [rad s or m s], None if not logged.
    sum: Array | None = None
    #: (N, n) positions of the motors [rad or m], None if not logged.
    qmot: Array | None = None

    @property
    def count(self) -> int:
        """Number of the grid's samples."""
        span = self.t[-1] - self.t[0]
        return int(span / self.dt) + 1

    def clock(self, k: Indices) -> Array:
        """Return the instants (K,) [s] of the grid's samples k (K,)."""
        return self.t[0] + self.dt * k

    @cached_property
    def integrals(self) -> tuple[Array, Array]:
        """Integrals (N, n) over time, from the begin of the stretch to each logged
        sample, of the commanded position and of the position; the latter as logged,
        where the run holds it."""
        integral = partial(
            scipy.integrate.cumulative_trapezoid, x=self.t, axis=0, initial=0.0
        )
        of_position = integral(self.q) if self.sum is None else self.sum
        return integral(self.qcmd), of_position

    def resampled(self, values: Array, start: int, stop: int) -> Array:
        """Return channels (N, n) of the stretch at the grid's samples ``start`` to
        ``stop - 1``, linearly interpolated, (stop - start, n)."""
        instants = self.clock(np.arange(start, stop))
        return interpolated(instants, self.t, values)


def interpolated(at: Array, t: Array, values: Array) -> Array:
    """Interpolate channels (N, n), known at instants t (N,) [s], linearly at M
    ascending instants ``at`` [s].

    Returns (M, n) values; each column is contiguous in memory. Beyond the ends they are
    those of the ends.
    """
    interpolated_rows = np.empty((values.shape[1], len(at)))
    for start in range(0, len(at), PART):
        instants = at[start : start + PART]
        # Pass only the samples around: interpolation copies its arguments.
        behind = np.searchsorted(t, instants[0], "right")
        begin = int(behind) - 1
        end = int(np.searchsorted(t, instants[-1])) + 1
        samples = slice(max(begin, 0), end)
        for row, channel in zip(interpolated_rows, values[samples].T, strict=True):
            row[start : start + PART] = np.interp(instants, t[samples], channel)
        drop_pages(t)  # a search looks at instants far away
        drop_pages(values[samples])
    return interpolated_rows.T


def split_at_gaps(run: Measurements) -> Iterator[Stretch]:
    """Yield the uninterrupted stretches of a run of two samples or more.

    :func:`~sdp_vs_penalty.data.stretches.gaps.rows_behind_gaps` says what a gap is.
    """
    dt = usual_step(run.t)
    for start, stop in pairwise([0, *rows_behind_gaps(run.t), len(run.t)]):
        if stop - start < 2:
            continue
        part = run.rows(slice(start, stop))
        yield Stretch(
            part.t,
            part.q,
            part.tau,
            dt,
            temperature=part.temperature,
            qcmd=part.commanded.get("qcmd"),
            sum=part.commanded.get("isum"),
            qmot=part.commanded.get("qmot"),
        )


def no_motion(run: Measurements) -> InputError:
    """Return the error for a run in which no joint moves."""
    return InputError(
        "the robot does not move in this run", "record a motion", run.names[0]
    )
