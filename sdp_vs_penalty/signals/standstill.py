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
    stretch: Stretch, kernels: Sequence[Kernel], rows: NDArray[np.int64]
) -> Array:
    """(M, n) how much of a unit torque, whatever its sign, reaches filtered rows (M,),
    samples of a stretch, from when a joint stood still, and from when filtered states
    mistake that for motion.

    kernels : the low-passes of states and of torques.
    """
    reaching = is_still(stretch.resampled(stretch.q, 0, stretch.count)).astype(float)
    for kernel in kernels if reaching.any() else ():
        padded = np.pad(reaching, ((kernel.half, kernel.half), (0, 0)), mode="edge")
        (reaching,) = convolve(padded, np.abs(kernel.value))
    return np.asarray(reaching[rows])


def is_still(q: Array) -> NDArray[np.bool_]:
    """(N, n) whether positions (N, n), sampled uniformly, stand still: for longer than
    a smooth motion at the same place would stay within the resolution of the positions.
    """
    out = np.zeros(q.shape[::-1], bool)
    if len(q) < 16:
        return out.T
    step = resolution(q)
    half = 1
    joints = np.arange(q.shape[1])
    positions_by_joint = np.ascontiguousarray(q.T)
    while half < 0.1 * len(q) and len(joints):
        width = 2 * half + 1
        near = np.pad(positions_by_joint, ((0, 0), (half, half)), mode="symmetric")
        spread = sliding(np.maximum, near, width) - sliding(np.minimum, near, width)
        quiet = spread <= 2.0 * step[joints, None]
        some = quiet.any(axis=1)  # the others are not quiet for longer either
        joints = joints[some]
        positions_by_joint = positions_by_joint[some]
        quiet = quiet[some]
        ends = np.pad(positions_by_joint, ((0, 0), (3 * half, 3 * half)), mode="edge")
        aside = np.maximum(
            np.abs(ends[:, : -6 * half] - positions_by_joint),
            np.abs(ends[:, 6 * half :] - positions_by_joint),
        )
        # In three times the time a moving joint comes 9 times as far where it turns
        # round, and 27 times where its velocity passes through zero. Farther: it stood.
        stood = (quiet & (aside > 3**3 * step[joints, None])).astype(np.uint8)
        near = np.pad(stood, ((0, 0), (half, half)))
        out[joints] |= sliding(np.maximum, near, width) > 0
        half = max(half + 1, 3 * half // 2)
    return out.T


def sliding(extreme: np.ufunc, x: NDArray[Any], width: int) -> NDArray[Any]:
    """(n, N - width + 1) the largest or smallest of each ``width`` neighbours in a row
    of x (n, N), from those of 1, 2, 4, ...; without the import of SciPy's images."""
    size = 1
    while 2 * size <= width:
        x = extreme(x[:, :-size], x[:, size:])
        size *= 2
    return x if size == width else extreme(x[:, : size - width], x[:, width - size :])


def resolution(q: Array) -> Array:
    """(n,) how far positions (N, n), sampled uniformly, have to lie apart to differ for
    certain."""
    # Of fourth differences motion is no part, and white noise has 70 times its variance
    # in them.
    return np.asarray(
        _ALIKE
        * np.median(np.abs(np.diff(q, 4, axis=0)), axis=0)
        / (0.6745 * np.sqrt(70.0))
    )


def friction_laws(motion: Motion, joint: int) -> Array:
    """(N, k) a joint's friction of unit size: Dahl's for each travel, Coulomb's,
    viscous, a constant."""
    path = Legs.of(motion.q[:, joint])
    dq = motion.dq[:, joint]
    travels = PreslidingHysteresis.shapes["d"].grid
    memory = [dahl(path, travel, float(np.sign(dq[0]))) for travel in travels]
    return np.column_stack([*memory, motion.sign(joint), dq, np.ones(len(dq))])


def unexplained_standstill_torque(
    left: Array, laws: Array, share: Array
) -> tuple[float, bool]:
    """s of what standing still adds to the rows left (M,) beyond laws (M, k), and
    whether none says it.

    s^2 = mean of e^2 - m^2 where more than half of a row, whose share (M,) is of
    standstill, is; e what least squares leave, m the same of rows in which the joint
    moves. What no law says is one unknown that all standstills may share: together they
    then weigh as one row, s^2 times their number."""
    moves = share < STILL
    stands = share > 0.5
    if not moves.any() or not stands.any():
        return 0.0, False
    size = np.linalg.norm(laws, axis=0)
    laws = laws / nonzero_or_one(size)
    squared_residual = (left - laws @ np.linalg.lstsq(laws, left, rcond=1e-10)[0]) ** 2
    usual = float(squared_residual[moves].mean())
    variance = max(float(squared_residual[stands].mean()) - usual, 0.0)
    if variance <= 4.0 * usual:  # no more than twice as far off as moving rows
        return float(np.sqrt(variance)), False
    return float(np.sqrt(variance * np.sum(share**2))), True
