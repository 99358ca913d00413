"""Gravity along another direction of the base: its six axes, and around the assumed one."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, prior_of_one_of
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis, LogView
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.robot import STANDARD_GRAVITY

#: Gravity on Earth [m/s^2]; a problem whose gravity is of another size is corrected.
_EARTH = max(map(abs, STANDARD_GRAVITY))
#: Step of the difference quotient by an angle, standard deviation beforehand, and the
#: largest angle for which a first-order step is trusted [rad].
_STEP, _SD, _FIRST_ORDER = 0.02, 0.3, 0.5
#: Most steps to first order towards the direction that leaves least.
_STEPS = 5
#: Shares of its weight that a controller subtracts from an arm that stands as assumed: all
#: of it, or that of links as light as the nominal ones.
_SUBTRACTED = (1.0, 0.8)


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield other directions of gravity in the base.

    They are the six axes, each also less the weight that a controller may subtract; the
    present gravity turned by Newton steps of two angles; and the same from the direction of
    the nominal links, if the arm is badly explained.
    """
    current = fit.transform
    if any(current.missing_weight):
        return  # weight that is missing has no direction
    gravity = np.array(current.gravity)
    size = float(np.linalg.norm(gravity))
    is_of_earth = _is_earths_gravity(size)
    new_size = size if is_of_earth else _EARTH
    kind = "gravity direction" if is_of_earth else "gravity of the problem"
    prior = prior_of_one_of(1)
    for axis in (*np.eye(3), *-np.eye(3)):
        transform = _with_gravity(current, new_size * axis)
        if not np.allclose(transform.gravity, gravity):
            yield Hypothesis(kind, (), prior, transform)
            for share in _SUBTRACTED:
                reduced = np.array(transform.gravity) - share * gravity
                yield Hypothesis(
                    kind, (), 2.0 * prior, _with_gravity(transform, reduced)
                )
    if not is_of_earth:
        return
    # A direction that is claimed already is not another mistake.
    is_claimed = current.gravity != evidence.log.as_logged.gravity
    odds = 0.0 if is_claimed else prior
    yield _tilted(evidence, fit, odds)
    if not fit.is_badly_explained:
        return
    nominal = _of_nominal_links(evidence, fit)
    if gravity @ nominal < size * _EARTH * np.cos(_FIRST_ORDER):
        turned_fit = evidence.fit(
            _with_direction(fit.view, nominal), fit.rows_worth_one
        )
        yield _tilted(evidence, turned_fit, odds)


def _of_nominal_links(evidence: Evidence, fit: ViewFit) -> Array:
    """Return Earth's gravity (3,) [m/s^2] in the direction in which the nominal links
    explain the torques best.

    The torques are fitted, by least squares, with the links' inertial torque and their
    weight along each axis, with each joint's own columns projected out.
    """
    log, current, rows = evidence.log, fit.transform, fit.columns.rows
    weights = [  # by unit gravity along each axis
        log.nominal(replace(current, gravity=tuple(axis)), is_still=True)
        for axis in np.eye(3).tolist()
    ]
    inertia = log.nominal(replace(current, gravity=(0.0, 0.0, 0.0)))
    torques = np.stack(
        [inertia.T, *(x.T for x in weights), log.torques(current)], axis=2
    )
    masked = torques * log.torque_mask(current)[:, :, None]
    projected = rows.project_out_own(masked)[log.moving]
    # Each joint counts as much: its rows are divided by the norm of its torque.
    projected = projected / np.linalg.norm(projected[:, :, -1:], axis=1, keepdims=True)
    *columns, torque = projected.reshape(-1, projected.shape[2]).T
    sizes = np.linalg.lstsq(np.stack(columns, axis=1), torque, rcond=None)[0]
    return _EARTH * sizes[1:] / nonzero_or_one(np.linalg.norm(sizes[1:]))


def _tilted(evidence: Evidence, fit: ViewFit, odds: float) -> Hypothesis:
    """Return the hypothesis that gravity is turned from that of a fit, by Newton steps
    until one is shorter than bases are calibrated to.

    odds : its prior log-odds, to which the Occam factor of the two angles is added.
    """
    for _ in range(_STEPS):
        step = _newton_step(evidence, fit)
        if np.linalg.norm(step.angles) < c.CALIBRATED:
            break
        fit = evidence.fit(_with_direction(fit.view, step.gravity), fit.rows_worth_one)
    distance = np.linalg.norm(step.gravity - np.array(evidence.log.as_logged.gravity))
    return Hypothesis(
        kind="gravity direction",
        joints=(),
        log_prior=odds + step.occam,
        transform=_with_gravity(fit.transform, step.gravity),
        is_usual=bool(distance < 2.0 * c.CALIBRATED * _EARTH),
    )


class _NewtonStep(NamedTuple):
    """A step of gravity's direction towards the least residual."""

    #: (2,) angles about two axes across gravity [rad].
    angles: Array
    #: Natural logarithm of the Occam factor of the two angles.
    occam: float
    #: (3,) gravity turned by them [m/s^2].
    gravity: Array


def _newton_step(evidence: Evidence, fit: ViewFit) -> _NewtonStep:
    """Return one Newton step of gravity's direction from that of a fit, by difference
    quotients of the torque that the links do not explain."""
    log, current = evidence.log, fit.transform
    gravity = np.array(current.gravity)
    size = float(np.linalg.norm(gravity))
    across = np.linalg.svd(gravity[None, :])[2][1:]  # (2, 3)
    transforms = [
        _with_gravity(current, gravity + size * _STEP * axis) for axis in across
    ]
    log.prepare_columns(transforms)
    tilted = [log.unexplained(transform, fit.links) for transform in transforms]
    unexplained = log.unexplained(current, fit.links)
    slopes = (unexplained[:, :, None] - np.stack(tilted, axis=2)) / _STEP
    angles, information = evidence.score_test(fit, slopes, np.full(2, _SD))
    occam = -0.5 * float(np.sum(np.log1p(_SD**2 * information)))
    angles = np.clip(angles, -_FIRST_ORDER, _FIRST_ORDER)
    turned = gravity + size * angles @ across
    return _NewtonStep(angles, occam, turned * (size / np.linalg.norm(turned)))


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield the fault that gravity is another vector than the problem's."""
    assumed = np.array(log.problem.robot.gravity)
    g = np.array(transform.gravity)
    if np.allclose(assumed, g, rtol=0.0, atol=1e-6):
        return
    size = float(np.linalg.norm(assumed))
    cosine = assumed @ g / max(size * float(np.linalg.norm(g)), 1e-300)
    angle = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    vector = [float(round(v, 2)) + 0.0 for v in g]  # no negative zero
    x, y, z = vector
    kind = "gravity direction"
    remedy = f"set gravity to ({x:g}, {y:g}, {z:g}) m/s^2"
    if not _is_earths_gravity(size):
        kind = "gravity of the problem"
        remedy = f"{remedy}, or correct the problem's gravity"
    yield Fault(
        kind=kind,
        in_doubt=kind,
        joints=(),
        what=f"the weight in the torques points along ({_in_words(g)}) m/s^2,"
        f" {angle:.0f} degrees away from the assumed ({_in_words(assumed)})"
        f"{_subtracted_in_words(g, assumed)}.",
        remedy=remedy,
        without=_with_gravity(transform, assumed),
        place="the base",
        gravity=transform.gravity_left,
        figures={"angle_degrees": angle, "vector": vector},
    )


def _subtracted_in_words(g: Array, assumed: Array) -> str:
    """Say which mounting leaves a gravity (3,) that is not Earth's, where a controller
    subtracts the weight of an arm that stands as assumed; "" where none does."""
    if _is_earths_gravity(float(np.linalg.norm(g))):
        return ""
    sums = [g + share * assumed for share in _SUBTRACTED]
    mounted = min(sums, key=lambda x: abs(float(np.linalg.norm(x)) - _EARTH))
    if not _is_earths_gravity(float(np.linalg.norm(mounted))):
        return ""
    return (
        f": as of an arm under gravity along ({_in_words(mounted)}) whose"
        " controller subtracts its weight as if gravity were the assumed one"
    )


def _in_words(gravity: Array) -> str:
    """Write a gravity (3,) [m/s^2] with three decimals, and no negative zero."""
    return ", ".join(f"{round(float(x), 3) + 0.0:g}" for x in gravity)


def _is_earths_gravity(size: float) -> bool:
    """Whether a gravity [m/s^2] is Earth's, to within the calibration of drives."""
    return abs(size / _EARTH - 1.0) < c.CALIBRATED_GAIN


def _with_gravity(transform: LogTransform, g: Array) -> LogTransform:
    """Return the transform under another gravity g (3,) [m/s^2] in the base frame."""
    return replace(transform, gravity=tuple(g.tolist()))


def _with_direction(view: LogView, g: Array) -> LogView:
    """Return the view under another gravity g (3,) [m/s^2] of all rows."""
    return replace(view, transform=_with_gravity(view.transform, g))
