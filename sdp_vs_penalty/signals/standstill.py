"""When a joint stands still, as far as its positions can tell.

Dry friction that holds a joint is anything between minus and plus its size: no law of
sliding says more, and a torque measured meanwhile is no evidence for or against any.
Friction that yields before it slides does say more, over a travel that shows in the
positions (Dahl, AIAA Journal 1976).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.bristles import PRESLIDING_TRAVELS, dahl
from sdp_vs_penalty.effects.motion import Legs, Motion
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask, nonzero_or_one
from sdp_vs_penalty.signals.constants import SLIDING_SPEED
from sdp_vs_penalty.signals.kernels import Kernel, convolve
from sdp_vs_penalty.signals.runs import Stretch

#: Positions are alike within so many standard deviations of their own noise.
_ALIKE = 4.0
#: A row counts as standstill if more than this share of it comes from one.
STILL = 0.01
#: A row counts as slow if more than this share of it comes from a slow joint: it then
#: also shows how dry friction turns round.
SLOW = 0.1


def standstill_leakage(
    stretch: Stretch, kernels: Sequence[Kernel], rows: Indices
) -> Array:
    """Return the share (M, n) of each filtered row, at samples ``rows`` (M,) of the
    stretch, that comes from a joint's standstill [-].

    It is what the low-passes pass of 1 while the joint stands still, in absolute
    values, so that it bounds any torque at standstill. The low-pass of states counts as
    well: filtered states mistake the ends of a standstill for motion.

    Parameters
    ----------
    kernels : sequence of Kernel
        The low-passes of states and of torques.
    """
    positions = stretch.resampled(stretch.q, 0, stretch.count)
    # 1 where a joint stands still, then what each low-pass in turn makes of that.
    share = is_still(positions).astype(float)
    if not share.any():
        return share[rows]
    for kernel in kernels:
        # Beyond its ends the stretch goes on as it begins and ends.
        margin = ((kernel.half, kernel.half), (0, 0))
        padded = np.pad(share, margin, mode="edge")
        (share,) = convolve(padded, np.abs(kernel.value))
    return share[rows]


def is_still(q: Array) -> Mask:
    """Return at which samples each joint stands still.

    A joint stands where its position stays within its resolution for longer than a
    smooth motion at the same place would. Windows of growing length are tried: in three
    times the time, a smooth motion gets up to 27 times as far; a joint that got farther
    had stood.

    Parameters
    ----------
    q : (N, n) array
        Positions, sampled uniformly [rad or m].

    Returns
    -------
    (N, n) array of bool
        Whether the joint stands; false throughout for fewer than 16 samples.
    """
    still = np.zeros(q.shape[::-1], bool)  # (n, N)
    if len(q) < 16:  # too short to tell noise from motion
        return still.T
    step = resolution(q)[:, None]
    half = 1
    joints = np.arange(q.shape[1])
    positions = np.ascontiguousarray(q.T)
    # Windows of 2 half + 1 samples, each half again as long as the last.
    while half < 0.1 * len(q) and len(joints):
        quiet = _spread(positions, half) <= 2.0 * step[joints]
        # A joint without a quiet window has no longer quiet window either.
        has_quiet = quiet.any(axis=1)
        joints = joints[has_quiet]
        positions = positions[has_quiet]
        # In three times the time a moving joint comes 9 times as far where it turns
        # round, and 27 times where its velocity passes through zero. Farther: it stood.
        is_far = _displacement(positions, 3 * half) > 3**3 * step[joints]
        stood = (quiet[has_quiet] & is_far).astype(np.uint8)
        near = np.pad(stood, ((0, 0), (half, half)))
        still[joints] |= sliding(np.maximum, near, 2 * half + 1) > 0
        half = max(half + 1, 3 * half // 2)
    return still.T


def _spread(positions: Array, half: int) -> Array:
    """Return the range (largest minus smallest) of positions (n, N) within ``half``
    samples of each one, (n, N)."""
    near = np.pad(positions, ((0, 0), (half, half)), mode="symmetric")
    width = 2 * half + 1
    return sliding(np.maximum, near, width) - sliding(np.minimum, near, width)


def _displacement(positions: Array, steps: int) -> Array:
    """Return the distance (n, N) of positions (n, N) from those ``steps`` samples
    before or after, whichever is larger."""
    ends = np.pad(positions, ((0, 0), (steps, steps)), mode="edge")
    before = np.abs(ends[:, : -2 * steps] - positions)
    after = np.abs(ends[:, 2 * steps :] - positions)
    return np.maximum(before, after)


def sliding(extreme: np.ufunc, x: NDArray[Any], width: int) -> NDArray[Any]:
    """Return the largest (numpy.maximum) or smallest (numpy.minimum) of ``width``
    consecutive samples of signals x (n, N), at each place (n, N - width + 1).

    Extremes of 1, 2, 4, ... neighbours are computed one from the other; two overlapping
    ones then cover the width. (scipy.ndimage does the same; its import takes longer.)
    """
    size = 1
    while 2 * size <= width:
        x = extreme(x[:, :-size], x[:, size:])
        size *= 2
    if size == width:
        return x
    return extreme(x[:, : size - width], x[:, width - size :])


def is_sliding(velocity: Array) -> Mask:
    """Return the rows (M, n) of velocities in which a joint slides: is faster than
    SLIDING_SPEED times its root mean square."""
    return np.abs(velocity) > SLIDING_SPEED * np.sqrt(np.mean(velocity**2, axis=0))


def slides_throughout(velocity: Array, margin: int) -> Mask:
    """Return the rows (M, n) of evenly sampled velocities in which a joint slides, and
    slid ``margin`` rows before and will ``margin`` rows after."""
    slides = np.pad(is_sliding(velocity).T, ((0, 0), (margin, margin)), mode="edge")
    return sliding(np.minimum, slides, 2 * margin + 1).T


def resolution(q: Array) -> Array:
    """Estimate how far positions have to lie apart to differ for certain.

    Parameters
    ----------
    q
        (N, n) positions, sampled uniformly.

    Returns
    -------
    Array
        (n,) distances [rad or m].
    """
    # Fourth differences remove the motion. White noise has 70 times its variance in
    # them (1 + 16 + 36 + 16 + 1), and a median absolute value of 0.6745 sigma.
    fourth_differences = np.diff(q, 4, axis=0)
    median = np.median(np.abs(fourth_differences), axis=0)
    return _ALIKE * median / (0.6745 * np.sqrt(70.0))


def friction_laws(motion: Motion, joint: int) -> Array:
    """Compute the friction torque of a joint (from 0) by the usual laws, each of unit
    size.

    Parameters
    ----------
    motion : Motion
        The motion at N instants.

    Returns
    -------
    (N, k) array
        Columns: Dahl's law for each of a grid of presliding travels, Coulomb friction
        (smoothed sign of the velocity), viscous friction (the velocity), a constant.
    """
    path = Legs.along(motion.q[:, joint])
    dq = motion.dq[:, joint]
    start = float(np.sign(dq[0]))
    memory = [dahl(path, travel, start) for travel in PRESLIDING_TRAVELS]
    return np.column_stack([*memory, motion.sign(joint), dq, np.ones(len(dq))])


def unexplained_standstill_torque(
    residual: Array, laws: Array, still_share: Array
) -> tuple[float, bool]:
    """Estimate the torque at standstill that laws of friction leave unexplained.

    The laws are fitted to the residual by least squares, which leaves e. Then s^2 =
    mean(e^2) over rows that are mostly standstill, less mean(e^2) over moving rows. If
    the torque is large, all standstills may share one unknown value: s is raised by
    sqrt(sum(still_share^2)), so that together they weigh as one row.

    Parameters
    ----------
    residual : (M,) array
        Residual torque of a joint [N m or N].
    laws : (M, k) array
        Columns of friction, from :func:`friction_laws`.
    still_share : (M,) array
        Share of each row that is standstill [-].

    Returns
    -------
    float
        s [N m or N].
    bool
        Whether no law explains it: s^2 exceeds four times that of moving rows.
    """
    moves = still_share < STILL
    stands = still_share > 0.5
    if not moves.any() or not stands.any():
        return 0.0, False
    size = np.linalg.norm(laws, axis=0)
    laws = laws / nonzero_or_one(size)
    fitted = np.linalg.lstsq(laws, residual, rcond=1e-10)[0]
    squared_residual = (residual - laws @ fitted) ** 2
    usual = float(squared_residual[moves].mean())
    variance = max(float(squared_residual[stands].mean()) - usual, 0.0)
    if variance <= 4.0 * usual:  # no more than twice as far off as moving rows
        return float(np.sqrt(variance)), False
    return float(np.sqrt(variance * np.sum(still_share**2))), True
