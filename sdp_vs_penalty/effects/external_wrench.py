"""Something pulls at the last link."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.hidden import HiddenEffect, TrueRobot
from sdp_vs_penalty.robot._pinocchio import pin


class ExternalWrench(Effect):
    name = "external_wrench"
    equation = "-J(q)^T (F, M)"
    explanation = (
        "A force and a moment that stay constant in the world act on the last link, at its joint's "
        "origin: a cable or a balancer that pulls, a tool that rests on something."
    )
    reference = "Siciliano et al., Robotics: Modelling, Planning and Control, sec. 7.1"
    whole_robot = True
    signless = True
    sized_by = slice(0, 3)  # the force
    one_number = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{symbol}_{axis}", unit, self.name, 0)
            for symbol, unit in (("F", "N"), ("M", "N*m"))
            for axis in "xyz"
        )

    def blocks(self, motion: Motion) -> list[Block]:
        jacobian = self.robot.jacobians(motion.q, self.robot.link_joints[-1])
        return [Block(j, np.arange(6), -jacobian[:, :, j]) for j in range(self.robot.n)]


def hidden(joint: int, true: TrueRobot, rng: np.random.Generator) -> HiddenEffect:
    force, moment = rng.normal(size=3), 0.2 * rng.normal(size=3)
    theta = (*force.tolist(), *moment.tolist())
    return HiddenEffect(
        "external_wrench", (), lambda w, m, a: a * wrench_torque(w, m, force, moment), theta=theta
    )


def wrench_torque(true: TrueRobot, motion: Motion, force: Array, moment: Array) -> Array:
    """Joint torque (N, n) against a wrench on the last link, by recursive Newton-Euler."""
    robot = true.robot
    model = robot._with_inertias(true.links.ravel())
    data = model.createData()
    external = pin.StdVec_Force([pin.Force.Zero() for _ in range(robot.n + 1)])
    out = np.empty_like(motion.q)
    for k, (q, dq, ddq) in enumerate(zip(motion.q, motion.dq, motion.ddq, strict=True)):
        plain = pin.rnea(model, data, q, dq, ddq).copy()
        pin.forwardKinematics(model, data, q)
        turn = data.oMi[robot.n].rotation
        external[robot.n] = pin.Force(turn.T @ force, turn.T @ moment)
        out[k] = pin.rnea(model, data, q, dq, ddq, external) - plain
    return out
