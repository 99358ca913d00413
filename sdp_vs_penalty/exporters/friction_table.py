"""Friction by velocity, joint by joint, for a controller that feeds it forward."""

from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.effects.effect import Motion, follows_alone
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import Options
from sdp_vs_penalty.exporters.interface import Written
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import joint_limits

ENDING = ".csv"
FILE = "friction.csv"
ABOUT = "friction by velocity"
BODIES = False


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


def write(estimate: Estimate, options: Options) -> Written:
    """Make a CSV table of friction torque over velocity for each joint.

    Columns: joint, velocity [rad/s, m/s], torque [N m, N] and its standard deviation.
    The torque is that of all effects that depend on the joint's velocity alone.

    This module is an :class:`ExportFormat`. Returns the file's bytes and the effects
    left out. Raises InputError for a model without such an effect.
    """
    curves = friction_curves(estimate)
    if not curves:
        raise InputError(
            "the model has no friction that follows the velocity alone", "add one"
        )
    lines = ["joint,velocity,torque,std"]
    for c in curves:
        for row in zip(c.velocity, c.torque, c.std, strict=True):
            lines.append(f"{c.joint + 1}," + ",".join(f"{x:.9g}" for x in row))
    others = (e for e in estimate.model.effects if e.simulator_field != "links")
    omitted = tuple(e.text for e in others if not follows_alone(e, "dq"))
    return ("\n".join(lines) + "\n").encode(), omitted


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
