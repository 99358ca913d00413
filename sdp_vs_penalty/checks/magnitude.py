"""Whether a torque that never is negative is a magnitude: does the arm explain it with
signs clearly better than as it is logged?

Weight and friction alone may keep the sign of a torque, and let it come near to zero.
Only the motion tells: a magnitude contradicts every arm, with any parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import orthonormal
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRun, Rows
from sdp_vs_penalty.signals.preprocessing import Preprocessing

#: Signs are estimated anew so many times; they settle in a few.
_ITERATIONS = 30
#: A torque that is smaller than this share of its largest value may change its sign.
_NEAR_ZERO = 0.2
#: An arm contradicts a torque if it leaves so many times the energy that it leaves of
#: the same torque with signs.
_TIMES = c.CONTRADICTS[0]


def magnitudes(
    problem: Problem, run: Measurements, settings: Preprocessing, joints: Sequence[int]
) -> list[int]:
    """List those of some joints whose torque signs explain clearly better than none.

    The arm's model, with all parameters free, is fitted to the torque as it is logged,
    and to the torque with the signs that the model itself gives it. The first has to
    leave _TIMES (2) as much energy as the second: a model's error is no noise, so that
    a smaller fall of it says nothing.

    Parameters
    ----------
    problem : Problem
        Of the robot that was logged.
    run : Measurements
        A single run.
    settings : Preprocessing
        Filters.
    joints : sequence of int
        Of torques that never are negative, from 0.

    Returns
    -------
    list of int
        Joints whose torque is a magnitude; none where the run is too short to be
        filtered.
    """
    if not joints:
        return []
    model = problem.model()
    try:
        rows = FilteredRun(run, settings.resolve(run)).all_rows(model)
    except InputError:
        return []
    nominal = problem.nominal(model)
    return [j for j in joints if _is_magnitude(rows, j, nominal)]


def _is_magnitude(rows: Rows, joint: int, nominal: Array) -> bool:
    """Whether signs explain a joint's torque clearly better than none.

    rows : of the run; joint : from 0; nominal : parameters of the problem's arm.
    """
    torque = rows.torque[:, joint]
    columns = rows.columns[joint]
    basis = orthonormal(columns.columns[None])[0]
    squares_as_logged = _squares_left(torque, basis)
    nominal_torque = columns.columns @ nominal[columns.indices]
    squares_signed = [
        _squares_left(signs * torque, basis)
        for first_signs in _first_signs(rows, joint, nominal_torque)
        if np.ptp(signs := _settled(first_signs, torque, basis)) > 0.0
    ]
    smallest = min(squares_signed, default=np.inf)
    return _TIMES * smallest < squares_as_logged


def _first_signs(rows: Rows, joint: int, nominal: Array) -> Iterator[Array]:
    """Yield signs (M,) of a joint's torque from which the estimation begins.

    They are those of the nominal arm, those of the velocity (friction alone), and signs
    that change wherever the torque comes near to zero.
    """
    torque = rows.torque[:, joint]
    yield _signs(nominal)
    yield _signs(rows.motion.dq[:, joint])
    is_near = torque < _NEAR_ZERO * torque.max()
    n_crossings = np.cumsum(np.diff(is_near, prepend=is_near[0]) & is_near)
    yield np.where(n_crossings % 2 == 0, 1.0, -1.0)


def _settled(signs: Array, torque: Array, basis: Array) -> Array:
    """Return the signs (M,) that the model gives a torque (M,) that has these signs.

    basis (M, r) : orthonormal basis of the model's columns.
    """
    for _ in range(_ITERATIONS):
        modelled = basis @ (basis.T @ (signs * torque))
        next_signs = _signs(modelled)
        if np.array_equal(next_signs, signs):
            break
        signs = next_signs
    return signs


def _signs(x: Array) -> Array:
    """Return 1 or -1 for each value of x; 1 for zero."""
    return np.where(x < 0.0, -1.0, 1.0)


def _squares_left(torque: Array, basis: Array) -> float:
    """Return the sum of squares of a torque (M,) that columns leave, with their
    orthonormal basis (M, r).
    """
    error = torque - basis @ (basis.T @ torque)
    return float(error @ error)
