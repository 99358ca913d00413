"""Gravity along another direction of the base: its six axes, and around the assumed one."""

from collections.abc import Iterator
from dataclasses import replace

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
    """Yield gravity along each of the six axes of the base, the assumed gravity turned by
    the two angles of a first-order step, and of an arm that leaves much along any
    direction."""
    now = fit.chain
    if any(now.lacks):
        return  # weight that is missing has no direction
    gravity = np.array(now.gravity)
    size = float(np.linalg.norm(gravity))
    is_of_earth = _is_earths_gravity(size)
    new_size = size if is_of_earth else _EARTH
    kind = "gravity direction" if is_of_earth else "gravity of the problem"
    prior = prior_of_one_of(1)
    for axis in (*np.eye(3), *-np.eye(3)):
        chain = _with_gravity(now, new_size * axis)
        if not np.allclose(chain.gravity, gravity):
            yield Hypothesis(kind, (), prior, chain)
            for share in _SUBTRACTED:
                left = np.array(chain.gravity) - share * gravity
                yield Hypothesis(kind, (), 2.0 * prior, _with_gravity(chain, left))
    if not is_of_earth:
        return
    # A direction that is claimed already is not another mistake.
    is_claimed = now.gravity != evidence.log.as_logged.gravity
    odds = 0.0 if is_claimed else prior
    yield _tilted(evidence, fit, odds)
    if not fit.is_badly_explained:
        return
    nominal = _of_nominal_links(evidence, fit)
    if gravity @ nominal < size * _EARTH * np.cos(_FIRST_ORDER):
        far = evidence.fit(_with_direction(fit.view, nominal), fit.v)
        yield _tilted(evidence, far, odds)


def _of_nominal_links(evidence: Evidence, fit: ViewFit) -> Array:
    """Return Earth's gravity (3,) along the direction in which the nominal links, of any
    size, make most of the torques: least squares of their inertia and of their weight
    along each axis, beside each joint's own columns."""
    log, now, rows = evidence.log, fit.chain, fit.columns.rows
    still = [
        log.nominal(replace(now, gravity=tuple(axis)), is_still=True)
        for axis in np.eye(3).tolist()
    ]
    inertia = log.nominal(replace(now, gravity=(0.0, 0.0, 0.0)))
    torques = np.stack([inertia.T, *(x.T for x in still), log.torques(now)], axis=2)
    masked = torques * log.torque_mask(now)[:, :, None]
    left = rows.project_out_own(masked)[log.moving]
    left = left / np.linalg.norm(left[:, :, -1:], axis=1, keepdims=True)
    *columns, torque = left.reshape(-1, left.shape[2]).T
    sizes = np.linalg.lstsq(np.stack(columns, axis=1), torque, rcond=None)[0]
    return _EARTH * sizes[1:] / nonzero_or_one(np.linalg.norm(sizes[1:]))


def _tilted(evidence: Evidence, fit: ViewFit, odds: float) -> Hypothesis:
    """Return Earth's gravity turned from that of a fit by steps to first order, until one
    is shorter than bases are calibrated to; odds : prior log-odds, without the freedom of
    two angles."""
    for _ in range(_STEPS):
        angles, occam, turned = _step(evidence, fit)
        if np.linalg.norm(angles) < c.CALIBRATED:
            break
        fit = evidence.fit(_with_direction(fit.view, turned), fit.v)
    away = np.linalg.norm(turned - np.array(evidence.log.as_logged.gravity))
    return Hypothesis(
        kind="gravity direction",
        joints=(),
        log_prior=odds + occam,
        chain=_with_gravity(fit.chain, turned),
        is_usual=bool(away < 2.0 * c.CALIBRATED * _EARTH),
    )


def _step(evidence: Evidence, fit: ViewFit) -> tuple[Array, float, Array]:
    """Return the two angles (2,) [rad] across the gravity of a fit by which the arm leaves
    least to first order, what their freedom costs, and gravity (3,) turned by them."""
    log, now = evidence.log, fit.chain
    gravity = np.array(now.gravity)
    size = float(np.linalg.norm(gravity))
    across = np.linalg.svd(gravity[None, :])[2][1:]  # (2, 3)
    chains = [_with_gravity(now, gravity + size * _STEP * axis) for axis in across]
    log.prepare_columns(chains)
    left_tilted = [log.unexplained(chain, fit.links) for chain in chains]
    left = log.unexplained(now, fit.links)
    slopes = (left[:, :, None] - np.stack(left_tilted, axis=2)) / _STEP
    angles, information = evidence.score_test(fit, slopes, np.full(2, _SD))
    occam = -0.5 * float(np.sum(np.log1p(_SD**2 * information)))
    angles = np.clip(angles, -_FIRST_ORDER, _FIRST_ORDER)
    turned = gravity + size * angles @ across
    return angles, occam, turned * (size / np.linalg.norm(turned))


def list_faults(log: Likelihood, chain: LogTransform) -> Iterator[Fault]:
    """Yield the fault that gravity is another vector than the problem's."""
    assumed = np.array(log.problem.robot.gravity)
    g = np.array(chain.gravity)
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
        without=_with_gravity(chain, assumed),
        place="the base",
        gravity=chain.gravity_left,
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


def _with_gravity(chain: LogTransform, g: Array) -> LogTransform:
    """Return the transform under another gravity g (3,) [m/s^2] in the base frame."""
    return replace(chain, gravity=tuple(g.tolist()))


def _with_direction(view: LogView, g: Array) -> LogView:
    """Return the view under another gravity g (3,) [m/s^2] of all rows."""
    return replace(view, chain=_with_gravity(view.chain, g))
