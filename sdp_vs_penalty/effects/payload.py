"""A load on the last link."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.robot import inertia


class Payload(Effect):
    name = "payload"
    equation = "Y_last(q, dq, ddq) theta_payload"
    explanation = (
        "A body carried by the last link. Its ten parameters are those of the last link, so only a "
        "model held fixed (identified without the load) can show it. Its mass is as certain as the "
        "scale of the torque channels: gains that are 1 % off make it 1 % off, and these data cannot "
        "tell the two apart."
    )
    reference = "Atkeson, An, Hollerbach, IJRR 1986"
    whole_robot = True
    frozen_only = True

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        names = inertia.parameter_names(self.robot.n)
        return tuple(
            Parameter(f"payload_{name[: -len(str(self.robot.n))]}", unit, self.name, 0)
            for name, unit in zip(names, inertia.UNITS, strict=True)
        )

    def blocks(self, motion: Motion) -> list[Block]:
        last = self.robot.n - 1
        columns = self.robot.regressor(motion.q, motion.dq, motion.ddq)[:, :, 10 * last :]
        return [
            Block(j, np.arange(10), columns[:, j])
            for j, links in enumerate(self.robot.subtree)
            if last in links
        ]
