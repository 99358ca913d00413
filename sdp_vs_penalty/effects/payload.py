"""A load on the last link."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Array, Effect, Motion
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.constraint import Constraint


class Payload(Effect):
    name = "payload"
    equation = "Y_last(q, dq, ddq) theta_payload"
    explanation = (
        "A body carried by the last link. Its ten parameters are those of the last link, so only a "
        "model held fixed (identified without the load) can show it. Its mass is only as accurate "
        "as the scale of the torque channels: gains that are 1 % off make it 1 % off, and these "
        "data cannot separate the two."
    )
    reference = "Atkeson, An, Hollerbach, IJRR 1986"
    whole_robot = True
    signless = smooth = True
    frozen_only = True
    sized_by = slice(0, 1)  # its mass

    def named(self, joint: int) -> Iterable[tuple[str, str]]:
        names, last = inertia.parameter_names(self.robot.links), len(str(self.robot.links))
        return zip([f"payload_{name[:-last]}" for name in names], inertia.UNITS, strict=True)

    def constraints(self, indices: NDArray[np.intp]) -> list[Constraint]:
        """It is a body."""
        return [build.pseudo_inertia(self.name, indices), *super().constraints(indices)]

    @property
    def nominal(self) -> Array:
        """A solid ball of 0.5 kg and 5 cm radius."""
        return 0.5 * np.array([1.0, 0, 0, 0, 1e-3, 0, 1e-3, 0, 0, 1e-3])

    def torques(self, motion: Motion) -> Array:
        return self.robot.regressor(motion.q, motion.dq, motion.ddq)[:, :, -10:]
