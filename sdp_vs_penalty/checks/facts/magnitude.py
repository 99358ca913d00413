"""What torques are that no motor made: magnitudes, which lost their sign, and a model's.

Weight and friction alone may keep the sign of a torque, and let it come near to zero.
Only the motion tells: a magnitude contradicts every arm, with any parameters, and the arm
explains it with signs clearly better than as it is logged.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.certainty import likely
from sdp_vs_penalty.checks.facts.noise import shows_noise
from sdp_vs_penalty.checks.glance import RunSummary
from sdp_vs_penalty.checks.issue import Issue, Left, make_explanation, make_issue
from sdp_vs_penalty.race.arm_fit import orthonormal
from sdp_vs_penalty.robot.arrays import Array, Indices, nonzero_or_one
from sdp_vs_penalty.signals.filtered import Rows

#: Rows for each column of the links, from which on they cannot explain friction by chance.
_ROWS_A_LINK_COLUMN = 1.2

#: The fact that torques are no measured ones.
make_computed_torque = partial(
    make_issue,
    "torques of a model",
    heading="torque that was computed, not measured",
    where="all torque channels",
)


def find_model_torques(glance: RunSummary) -> Iterator[Issue]:
    """Yield a warning where torques carry no noise and no friction of any joint: a model
    made them.

    Friction is a hundred times the energy that the links' columns may leave of each
    torque, in joints that turn both ways.
    """
    joints = np.flatnonzero(glance.moving)
    if any(shows_noise(glance.run.tau[:, j]) for j in joints):
        return
    rows = glance.arm_rows
    if rows is None:
        return
    links = glance.problem.model().rigid_indices
    shares = []  # of each torque's energy that the links leave; 1 where nothing tells
    for j in joints:
        velocity, torque = rows.motion.dq[:, j], rows.torque[:, j]
        of_links = np.isin(rows.columns[j].indices, links)
        columns = rows.columns[j].columns[:, of_links]
        left = _squares_left(torque, orthonormal(columns[None])[0])
        turns_both_ways = velocity.min() < 0.0 < velocity.max()
        shares.append(
            left / nonzero_or_one(torque @ torque) if turns_both_ways else 1.0
        )
    has_many_rows = len(rows.torque) > _ROWS_A_LINK_COLUMN * len(links)
    if has_many_rows and max(shares) < c.MODEL_OF_WEIGHT:
        yield make_computed_torque(
            what="these torques carry no noise and no friction: a model made them, a"
            " controller's or a simulator's.",
            certainty=likely("every measurement carries noise, every motor friction"),
            remedy="log the measured torque or current: what is identified from these is"
            " that model",
            figures={"largest_share": max(shares)},
        )


def find_magnitudes(glance: RunSummary) -> Iterator[Issue]:
    """Yield a warning about torques that are magnitudes: they come down to zero, are
    never negative, and the arm explains them with signs clearly better."""
    least, largest = glance.run.tau.min(axis=0), glance.run.tau.max(axis=0)
    is_unsigned = (least >= 0.0) & (least <= _TOUCHES_ZERO * largest) & (largest > 0.0)
    if joints := magnitudes(glance, np.flatnonzero(glance.moving & is_unsigned)):
        yield make_explanation(
            kind="torque magnitude",
            in_doubt="torque magnitude",
            joints=joints,
            what="{where} never changes sign: the logger wrote magnitudes.",
            certainty=likely("with signs the arm explains it clearly better"),
            remedy="log the torque with its sign",
            where=", ".join(f"tau{j + 1}" for j in joints),
            left=Left.FACTS,
        )


#: A torque below this share of its largest value is near zero: there a magnitude may
#: have lost a change of sign.
_NEAR_ZERO = 0.2


#: The least value of a magnitude is at most this share of the largest.
_TOUCHES_ZERO = 0.01


#: Signs are estimated anew so many times; they settle in a few.
_ITERATIONS = 30


#: The arm contradicts a torque as logged where its residual has this many times the
#: energy of the residual with signs.
_TIMES = c.CONTRADICTS[0]


def magnitudes(glance: RunSummary, joints: Indices) -> list[int]:
    """List the joints, among some (from 0), whose torque the arm explains clearly better
    with signs than as logged; the list is empty where the run gives no rows of the arm.

    The arm's model, with all parameters free, is fitted to the torque as it is logged,
    and to the torque with the signs that the model itself gives it. The first has to
    leave _TIMES (2) as much energy as the second: a model's error is no noise, so that
    a smaller fall of it says nothing.
    """
    rows = glance.arm_rows if len(joints) else None
    if rows is None:
        return []
    nominal = glance.problem.nominal(glance.problem.model())
    return [j for j in joints.tolist() if _is_magnitude(rows, j, nominal)]


def _is_magnitude(rows: Rows, joint: int, nominal: Array) -> bool:
    """Whether signs explain a joint's torque clearly better than none.

    rows : of the run; joint : from 0; nominal : parameters of the problem's arm.
    """
    torque = rows.torque[:, joint]
    columns = rows.columns[joint]
    basis = orthonormal(columns.columns[None])[0]
    squares_as_logged = _squares_left(torque, basis)
    nominal_torque = columns.columns @ nominal[columns.indices]
    squares_signed = []
    for first_signs in _first_signs(rows, joint, nominal_torque):
        signs = _consistent_signs(first_signs, torque, basis)
        if np.ptp(signs) > 0.0:  # equal signs are the torque as logged
            squares_signed.append(_squares_left(signs * torque, basis))
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


def _consistent_signs(signs: Array, torque: Array, basis: Array) -> Array:
    """Return signs (M,) of a torque (M,) for which the fitted model's torque has the same
    signs, by iteration from given ones.

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
