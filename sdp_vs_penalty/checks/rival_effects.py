"""Effects of the arm that resemble a fault of its log, as columns beside the arm's.

A wrong gain, zero, length or clock adapts to whatever the model lacks. A fault is
therefore compared with the effects of another kind that act on several joints at once: a
constant force on the last link, gears that couple two joints, a tilted base.
Springs and friction of single joints compete before
(:meth:`~sdp_vs_penalty.checks.search.RepairSearch.beats_physics`); a load that all runs
carry is in the last link's parameters, which every arm has.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.checks.constants import (
    COULOMB_WIDTHS,
    LEAST_RATIO_WITH_SIZE,
    REQUIRED_SIGMAS,
)
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform
from sdp_vs_penalty.effects.links import across_gravity
from sdp_vs_penalty.regression.evidence import standard_errors_above_zero
from sdp_vs_penalty.robot.arrays import Array

#: Fits of a tilted base, and of a coupling: the columns of the next fit hold what the
#: one before found, the links or the ratio of the gears.
_ROUNDS_OF_TILT = 2
_ROUNDS_OF_COUPLING = 3
#: Parameters of a link: mass, first moments (3), inertia (6). The first four make its
#: weight.
_PARAMETERS_OF_A_LINK = 10
_STATIC_PARAMETERS = 4


@dataclass(frozen=True)
class RivalEffect:
    """An effect of the arm that may explain a log as well as a fault does."""

    #: The effect in words, such as "a tilted base".
    what: str
    #: (PARTS, n) errors on parts of the log left out, over the mean energy of a part.
    errors: Array
    #: Whether it is the direction of gravity, which is a fault as well.
    is_of_gravity: bool = False


def is_clearly_worse(errors: Array, than: Array, moving: NDArray[np.bool_]) -> bool:
    """Whether one explanation of R logs is clearly worse than another.

    With e[r, p, j] and f[r, p, j] their errors on part p of log r left out, two things
    have to hold: the energy that it leaves is larger by a factor, the product over the
    joints of sum_rp e / sum_rp f > LEAST_RATIO_WITH_SIZE; and so it is in most parts:
    the mean over the parts of sum_j log(e / f) lies REQUIRED_SIGMAS standard errors
    above zero.

    Parameters
    ----------
    errors, than : (R, PARTS, n) array
        Of the one and of the other.
    moving : (R, n) array
        Joints that count in each log.
    """
    counts = np.broadcast_to(moving[:, None], errors.shape)
    energies = [np.where(counts, x, 0.0).sum(axis=(0, 1)) for x in (errors, than)]
    is_counted = moving.any(axis=0)
    ratio = float(np.prod(energies[0][is_counted] / energies[1][is_counted]))
    log_rises = np.where(counts, np.log(errors / than), 0.0).sum(axis=2)  # (R, PARTS)
    clearness = standard_errors_above_zero(log_rises)
    return ratio > LEAST_RATIO_WITH_SIZE and clearness > REQUIRED_SIGMAS


def rival_effects(
    log: Likelihood, repair: LogTransform, weights: Array
) -> Iterator[RivalEffect]:
    """Yield the effects that may explain a log beside its repair, with their errors.

    Parameters
    ----------
    log : Likelihood
        Rows that hypotheses are judged on.
    repair : LogTransform
        How the log is repaired, without the fault that the effects compete with.
    weights : (n,) array
        Weights of the joints' rows: those of the fit that the effects are compared
        with. Beside a fault, the fit without it gives too little weight to the joints
        that show it.

    Yields
    ------
    RivalEffect
        A constant force, a tilted base, and a coupling of each joint with each
        neighbour. Nothing for a model without links.
    """
    model = log.data.shared
    if model is None or not len(model.rigid_indices):
        return
    _, errors = log.jackknife_errors(repair, weights, _force_columns(log, repair))
    yield RivalEffect("a constant force on the last link", errors)
    errors = _errors_of_tilt(log, repair, weights)
    yield RivalEffect("a tilted base", errors, is_of_gravity=True)
    for i, j in pairwise(range(log.n)):
        for driven, driving in ((i, j), (j, i)):
            errors = _errors_of_coupling(log, repair, weights, driven, driving)
            what = f"gears that couple joints {i + 1} and {j + 1}"
            yield RivalEffect(what, errors)


def _weight_under(log: Likelihood, repair: LogTransform, gravity: Array) -> Array:
    """Return the links' static torque (n, M, p) under a unit gravity (3,), for each of
    the p parameters of the links.
    """
    x, y, z = gravity.tolist()
    turned = replace(repair, gravity=(x, y, z))
    return log.columns(turned, speed=0.0, push=0.0)


def _force_columns(log: Likelihood, repair: LogTransform) -> Array:
    """Return the columns (n, M, 12) of a force that is constant in the world, at any
    point of the last link.

    A force F at the point r of the link acts as the weight of a mass there would under
    a gravity along F, without inertia. It is linear in F_k and r_i F_k; the columns are
    those of mass and first moments under gravity along each axis.
    """
    assert log.data.shared is not None
    last_link = log.data.shared.rigid_indices[-_PARAMETERS_OF_A_LINK:]
    statics = last_link[:_STATIC_PARAMETERS]
    weights = [_weight_under(log, repair, axis)[:, :, statics] for axis in np.eye(3)]
    columns = np.concatenate(weights, axis=2)
    return np.asarray(columns * log.torque_mask(repair)[:, :, None])


def _errors_of_tilt(log: Likelihood, repair: LogTransform, weights: Array) -> Array:
    """Return the errors (PARTS, n) on parts left out of an arm on a tilted base.

    To first order a tilt adds the links' weight under gravity across the assumed one, g
    W_k theta, k = 1, 2. theta (s,) are the links of the fit before; weights (n,) : of
    the joints' rows.
    """
    robot = replace(log.problem.robot, gravity=repair.gravity)
    weight = [
        np.take(_weight_under(log, repair, axis), log.data.independent, axis=2)
        for axis in across_gravity(robot)
    ]
    theta = log.fit(repair).theta
    mask = log.torque_mask(repair)
    for _ in range(_ROUNDS_OF_TILT):
        columns = np.stack([(w @ theta) * mask for w in weight], axis=2)
        arms, errors = log.jackknife_errors(repair, weights, columns)
        theta = arms.mean(axis=0)[: len(theta)]
    return errors


def _errors_of_coupling(
    log: Likelihood, repair: LogTransform, weights: Array, driven: int, driving: int
) -> Array:
    """Return the errors (PARTS, n) on parts left out of gears that couple two joints
    (from 0).

    The motor of joint ``driving`` turns with both joints, by dq_driving + c dq_driven.
    Its torque times c, without its friction and inertia, is missing at the motor of
    joint ``driven``. Coulomb friction of the sum needs c: it is taken from the fit
    before. weights (n,) : of the joints' rows.
    """
    motion = log.motion(repair)
    mask = log.torque_mask(repair)[:, :, None]
    ratio = 0.0
    for _ in range(_ROUNDS_OF_COUPLING):
        velocity = motion.dq[:, driving] + ratio * motion.dq[:, driven]
        friction = [np.tanh(velocity / width) for width in COULOMB_WIDTHS]
        # The torque counts where the driven joint slides, be the other one at rest.
        torque = -log.torques(repair)[driving]
        of_driven = [torque, motion.dq[:, driving], motion.ddq[:, driving], *friction]
        of_driving = [motion.dq[:, driven], motion.ddq[:, driven], *friction]
        columns = np.zeros((*mask.shape[:2], len(of_driven) + len(of_driving)))
        columns[driven, :, : len(of_driven)] = np.column_stack(of_driven)
        columns[driving, :, len(of_driven) :] = np.column_stack(of_driving)
        arms, errors = log.jackknife_errors(repair, weights, columns * mask)
        ratio = float(arms.mean(axis=0)[-columns.shape[2]])
    return errors
