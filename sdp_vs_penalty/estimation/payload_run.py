"""The run that weighs a load: a short motion of the wrist beside an arm that is known.

The arm's model stays fixed, so that the load's ten parameters alone are estimated; with W (N n, 10) its
rows over each joint's noise, their covariance is (W' W)^-1 of independent rows. The motion makes its
determinant as small as the limits allow (D-optimality: Swevers et al., T-RA 1997).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.payload import Payload
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.excitation import Limits, optimised
from sdp_vs_penalty.estimation.motion_regressor import Regressor
from sdp_vs_penalty.estimation.separation import independent_rate
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.trajectory import FourierTrajectory, random_trajectory


@dataclass(frozen=True)
class PayloadRun:
    """trajectory : found; deviation (10,) : standard deviations of mass [kg], first moments [kg m] and
    inertia about the flange [kg m^2] after one such motion; started (10,) : those of the random motion
    that the search began with."""

    trajectory: FourierTrajectory
    deviation: Array
    started: Array


def payload_run(
    estimate: Estimate,
    *,
    joints: Sequence[int] | None = None,
    duration: float = 2.0,
    harmonics: int = 3,
    iterations: int = 60,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> PayloadRun:
    """A motion of ``joints`` (from 0; default the last three) that determines a load at the flange.

    The other joints stand in the middle of their ranges. Noise and cut-off are those of the model's
    data. Raises InputError for a joint that does not exist, and where such a motion cannot tell the
    load's ten parameters apart.
    """
    robot = estimate.robot
    # Joints that move unless others are named: the last three.
    moving = list(range(max(robot.n - 3, 0), robot.n)) if joints is None else list(joints)
    if not moving or not all(0 <= j < robot.n for j in moving):
        named = ", ".join(str(j + 1) for j in moving) or "none"
        raise InputError(f"joints that move: {named}", f"name some of 1 to {robot.n}")
    limits = Limits.of_robot(robot)
    frequency = 2.0 * np.pi / duration
    # Seconds of a blend over those of the motion.
    start = random_trajectory(robot, seed, duration, harmonics, frequency, 0.125 * duration)
    still = np.setdiff1d(np.arange(robot.n), moving)
    start.a[still], start.b[still] = 0.0, 0.0
    middle = 0.5 * (limits.lower + limits.upper)
    start = replace(start, q_0=np.where(np.isin(np.arange(robot.n), still), middle, start.q_0))
    noise = np.maximum(estimate.uncertainty.noise, 1e-12)
    regressor = Regressor(Model(robot, (Payload(robot),)), np.arange(10), 1.0 / noise)
    rate = independent_rate(estimate)
    found = optimised(regressor, limits, start, "d-optimal", iterations, moving, progress)
    return PayloadRun(
        found.trajectory,
        _deviation(regressor.along(found.trajectory, rate)),
        _deviation(regressor.along(start, rate)),
    )


def _deviation(rows: Array) -> Array:
    """(10,) standard deviations from rows of noise one; infinite where the rows do not determine one."""
    _, s, vt = np.linalg.svd(rows, full_matrices=False)
    known = s > 1e-9 * s[0]
    out = np.sqrt(np.sum((vt[known].T / s[known]) ** 2, axis=1))
    return np.where(np.any(np.abs(vt[~known]) > 1e-6, axis=0), np.inf, out)
