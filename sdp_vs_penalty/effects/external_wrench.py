"""Something pulls at the last link."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter


class ExternalWrench(Effect):
    name = "external_wrench"
    equation = "-J(q)^T (F, M)"
    explanation = (
        "A force and a moment that stay constant in the world act on the last link, at its joint's "
        "origin: a cable or a balancer that pulls, a tool that rests on something."
    )
    reference = "Siciliano et al., Robotics: Modelling, Planning and Control, sec. 7.1"
    whole_robot = True
    signless = smooth = True
    sized_by = slice(0, 3)  # the force

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
