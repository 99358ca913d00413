"""Friction by velocity, joint by joint, as page and report draw it."""

from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.effects.effect import Motion, follows_alone
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import joint_limits


@dataclass(frozen=True)
class FrictionCurve:
    """Friction torque of a joint over its velocity."""

    #: Index of the joint, from 0.
    joint: int
    #: (k,) velocities [rad/s, m/s].
    velocity: Array
    #: (k,) torque of all effects that follow the velocity alone [N m, N].
    torque: Array
    #: (k,) standard deviation of the torque by the parameters' intervals [N m, N].
    std: Array


def friction_curves(estimate: Estimate) -> list[FrictionCurve]:
    """Return the friction torque of each joint over its velocity.

    Returns
    -------
    list of FrictionCurve
        One for each joint, at 61 velocities that lie closest around zero, where dry
        friction changes sign. Empty without an effect that depends on velocity alone.
    """
    model = estimate.model
    robot = estimate.robot
    effects = [(e, indices) for e, indices in model.parts if follows_alone(e, "dq")]
    if not effects:
        return []
    factor = estimate.uncertainty.factor  # (p, r), covariance = factor factor^T
    _, _, largest_velocities = joint_limits(robot)
    curves = []
    for j, fastest in enumerate(largest_velocities):
        slowest = min(model.sign_width[j], fastest) / 4.0
        positive = np.geomspace(slowest, fastest, 30)
        velocity = np.concatenate([-positive[::-1], [0.0], positive])
        # Joint j alone moves.
        zeros = np.zeros((len(velocity), robot.n))
        dq = zeros.copy()
        dq[:, j] = velocity
        motion = Motion(
            np.zeros(len(velocity)), zeros, dq, zeros, sign_width=model.sign_width
        )
        torque = zeros[:, 0]
        # Rows s with standard deviation |s|: columns times a factor of the covariance.
        spread = np.zeros((len(velocity), factor.shape[1]))
        for effect, indices in effects:
            for block in effect.blocks(motion):
                if block.joint != j:
                    continue
                parameters = indices[block.parameters]
                torque = torque + block.columns @ estimate.theta[parameters]
                spread = spread + block.columns @ factor[parameters]
        std = np.linalg.norm(spread, axis=1)
        curves.append(FrictionCurve(j, velocity, torque, std))
    return curves
