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

from sdp_vs_penalty.effects.bristles import PreslidingHysteresis, dahl
from sdp_vs_penalty.effects.motion import Legs, Motion
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.signals.kernels import Kernel, convolve
from sdp_vs_penalty.signals.runs import Stretch

#: Positions are alike within so many standard deviations of their own noise.
_ALIKE = 4.0
#: Share of a row that a standstill may reach before the row counts as one.
STILL = 0.01
#: Rows of which more than this comes from a slow joint show how its dry friction turns
#: round as well.
SLOW = 0.1


def standstill_leakage(
    stretch: Stretch,
    kernels: Sequence[Kernel],
    rows: NDArray[np.int64],
) -> Array:
    """Measure how much of a standstill reaches filtered rows.

    It is the share of a unit torque, whatever its sign, from when a joint stood still,
    and from when filtered states mistake that for motion.

    Parameters
    ----------
    stretch
        The log.
    kernels
        The low-passes of states and of torques.
    rows
        (M,) samples of the stretch.

    Returns
    -------
    Array
        (M, n) shares.
    """
    positions = stretch.resampled(stretch.q, 0, stretch.count)
    reaching = is_still(positions).astype(float)
    if not reaching.any():
        return np.asarray(reaching[rows])
    for kernel in kernels:
        margin = ((kernel.half, kernel.half), (0, 0))
        padded = np.pad(reaching, margin, mode="edge")
        (reaching,) = convolve(padded, np.abs(kernel.value))
    return np.asarray(reaching[rows])


def is_still(q: Array) -> NDArray[np.bool_]:
    """Tell where positions stand still.

    They do where they stay within their resolution for longer than a smooth motion at
    the same place would.

    Parameters
    ----------
    q
        (N, n) positions, sampled uniformly.

    Returns
    -------
    NDArray
        (N, n) flags.
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
        some = quiet.any(axis=1)  # the others are not quiet for longer either
        joints = joints[some]
        positions = positions[some]
        # In three times the time a moving joint comes 9 times as far where it turns
        # round, and 27 times where its velocity passes through zero. Farther: it stood.
        is_far = _displacement(positions, 3 * half) > 3**3 * step[joints]
        stood = (quiet[some] & is_far).astype(np.uint8)
        near = np.pad(stood, ((0, 0), (half, half)))
        still[joints] |= (
            sliding(
                np.maximum,
                near,
                2 * half + 1,
            )
            > 0
        )
        half = max(half + 1, 3 * half // 2)
    return still.T


def _spread(positions: Array, half: int) -> Array:
    """Return the range (largest minus smallest) of positions (n, N) within ``half``
    samples of each one, (n, N)."""
    near = np.pad(
        positions,
        ((0, 0), (half, half)),
        mode="symmetric",
    )
    width = 2 * half + 1
    return sliding(
        np.maximum,
        near,
        width,
    ) - sliding(np.minimum, near, width)


def _displacement(positions: Array, steps: int) -> Array:
    """Return the distance (n, N) of positions (n, N) from those ``steps`` samples
    before or after, whichever is larger."""
    ends = np.pad(
        positions,
        ((0, 0), (steps, steps)),
        mode="edge",
    )
    before = np.abs(ends[:, : -2 * steps] - positions)
    after = np.abs(ends[:, 2 * steps :] - positions)
    return np.maximum(before, after)


def sliding(
    extreme: np.ufunc,
    x: NDArray[Any],
    width: int,
) -> NDArray[Any]:
    """Find the largest or smallest of neighbours, from those of 1, 2, 4, ...

    SciPy's images do the same, but their import takes longer.

    Parameters
    ----------
    extreme
        numpy.maximum or numpy.minimum.
    x
        (n, N) rows.
    width
        Number of neighbours.

    Returns
    -------
    NDArray
        (n, N - width + 1) extremes.
    """
    size = 1
    while 2 * size <= width:
        x = extreme(x[:, :-size], x[:, size:])
        size *= 2
    if size == width:
        return x
    return extreme(x[:, : size - width], x[:, width - size :])


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
    # Of fourth differences motion is no part, and white noise has 70 times its variance
    # in them.
    median = np.median(
        np.abs(
            np.diff(
                q,
                4,
                axis=0,
            )
        ),
        axis=0,
    )
    return np.asarray(_ALIKE * median / (0.6745 * np.sqrt(70.0)))


def friction_laws(motion: Motion, joint: int) -> Array:
    """Compute a joint's friction of unit size by the usual laws.

    Parameters
    ----------
    motion
        The motion at N instants.
    joint
        The joint from 0.

    Returns
    -------
    Array
        (N, k) columns: Dahl's for each travel, Coulomb's, viscous, a constant.
    """
    path = Legs.of(motion.q[:, joint])
    dq = motion.dq[:, joint]
    start = float(np.sign(dq[0]))
    travels = PreslidingHysteresis.shapes["d"].grid
    memory = [dahl(path, travel, start) for travel in travels]
    return np.column_stack(
        [
            *memory,
            motion.sign(joint),
            dq,
            np.ones(len(dq)),
        ]
    )


def unexplained_standstill_torque(
    left: Array,
    laws: Array,
    share: Array,
) -> tuple[float, bool]:
    """Estimate what standing still adds to rows, beyond laws of friction.

    s^2 = mean of e^2 - m^2 over rows of which more than half is standstill. e is what
    least squares leave, m^2 its mean square over rows in which the joint moves. What no
    law says is one unknown that all standstills may share: together they then weigh as
    one row, s^2 times their number.

    Parameters
    ----------
    left
        (M,) torque that is not explained [N m or N].
    laws
        (M, k) columns of friction.
    share
        (M,) share of each row that is standstill.

    Returns
    -------
    tuple
        s [N m or N], and whether no law explains it.
    """
    moves = share < STILL
    stands = share > 0.5
    if not moves.any() or not stands.any():
        return 0.0, False
    size = np.linalg.norm(laws, axis=0)
    laws = laws / nonzero_or_one(size)
    fitted = np.linalg.lstsq(
        laws,
        left,
        rcond=1e-10,
    )[0]
    squared_residual = (left - laws @ fitted) ** 2
    usual = float(squared_residual[moves].mean())
    variance = max(float(squared_residual[stands].mean()) - usual, 0.0)
    if variance <= 4.0 * usual:  # no more than twice as far off as moving rows
        return float(np.sqrt(variance)), False
    return float(np.sqrt(variance * np.sum(share**2))), True
