"""Torques that follow the position of a joint."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion, Parameter
from sdp_vs_penalty.effects.shape import ShapeConstant
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot.constraint import Constraint
from sdp_vs_penalty.robot.robot import Robot


class JointSpring(JointEffect):
    equation = "k_s q"
    explanation = (
        "A torque that grows with the joint's position: cables and hoses that are wound"
        " up, a balance spring. Its rest position appears as part of the offset."
    )
    reference = "Khalil, Dombre, Modeling, Identification and Control of Robots, ch. 9"
    signless = True
    symbol = "k_s"
    units = ("N*m/rad", "N/m")

    def column(self, motion: Motion, joint: int) -> Array:
        return motion.q[:, joint]


#: Metres of travel where a robot states none; waves per metre times 2 pi of a screw of
#: 5 mm; and how many orders are tried at most.
_TRAVEL = 0.5
_FINEST = 2.0 * np.pi / 0.005
_MOST = 200


def _orders(
    robot: Robot,
    joint: int,
    turns: Sequence[float],
    finest: float,
) -> list[float]:
    """Waves per turn; on a prismatic joint neighbours half a wave apart over the
    travel; without one, that of a common axis."""
    joint_record = robot.joints[joint]
    if joint_record.kind != "prismatic":
        return list(turns)
    travel = joint_record.upper - joint_record.lower
    step = np.pi / (travel if 0.0 < travel < np.inf else _TRAVEL)
    orders = np.arange(2.0 * step, finest, step)[:_MOST].tolist()
    return [float(f"{k:.6g}") for k in orders]  # as many digits as a written effect has


class TorqueRipple(JointEffect):
    equation = "a_r cos(k q) + b_r sin(k q)"
    explanation = (
        "A torque that repeats k times per turn (k times 2 pi metres on a prismatic"
        " joint): motor poles, gear teeth, an eccentric gear or a strain wave"
        " generator, which turns twice its ratio."
    )
    reference = (
        "Tuttle, Seering, IEEE Trans. Robotics and Automation 1996 (strain wave gears)"
    )
    several = True
    shapes = {
        "k": ShapeConstant(
            2.0,
            ("1/turn", "rad/m"),
            # Once a turn is geometry: a link's weight, a joint beside where it is
            # believed. Higher orders are visible at full rate only (the order
            # spectrum).
            grid=tuple(float(k) for k in range(2, 41)),
            bounds=(1.9, 1e4),
            # Waves: neighbours are a fixed distance apart, whatever their order.
            scale="linear",
        )
    }

    signless = True

    def parameter_names_and_units(self, joint: int) -> Iterable[tuple[str, str]]:
        k = f"{self.shape['k']:.6g}"
        return [
            (f"{symbol}{joint + 1}_{k}", self.unit_on(joint))
            for symbol in ("a_r", "b_r")
        ]

    @property
    def waves(self) -> float | None:
        return self.shape["k"]

    @classmethod
    def starts(
        cls,
        robot: Robot,
        joint: int,
    ) -> Iterable[dict[str, float]]:
        """Waves per turn; on a prismatic joint screws of 1 to 100 mm, and what the
        travel may hold."""
        return [{"k": k} for k in _orders(robot, joint, cls.shapes["k"].grid, _FINEST)]

    def column(self, motion: Motion, joint: int) -> Array:
        phase = self.shape["k"] * motion.q[:, joint]
        return np.column_stack(
            [
                np.cos(phase),
                np.sin(phase),
            ]
        )


#: Phases of a wave at which the friction may not become negative.
_PHASES = 48


class PositionDependentFriction(JointEffect):
    equation = "sign(dq) sum_i (a_i cos(i k q) + b_i sin(i k q)), i = 1 .. waves"
    explanation = (
        "Dry friction that varies along the range: an eccentric or bent shaft, a cable"
        " bundle that is pressed, a gear worn where it works most. Waves of k per turn,"
        " with twice k where waves = 2. Beside coulomb_friction on the same joint the"
        " sum is kept from becoming negative, so that it never feeds energy."
    )
    reference = (
        "Popovic, Goldenberg, IEEE Trans. Robotics and Automation 1998 (spectral"
        " friction model)"
    )
    refines = ("coulomb_friction",)
    shapes = {
        "k": ShapeConstant(
            1.0,
            ("1/turn", "rad/m"),
            grid=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
            bounds=(0.5, 300.0),
            scale="linear",
        ),
        "waves": ShapeConstant(1.0, choices=(1.0, 2.0)),
    }

    @classmethod
    def starts(
        cls,
        robot: Robot,
        joint: int,
    ) -> Iterable[dict[str, float]]:
        # Two waves are not looked for: along less than a whole one they fit anything
        # that is seen.
        shape = cls.shapes["k"]
        grid = _orders(
            robot,
            joint,
            shape.grid,
            (shape.bounds or (0.0, np.inf))[1],
        )
        return [{"k": k, "waves": 1.0} for k in grid]

    def parameter_names_and_units(self, joint: int) -> Iterable[tuple[str, str]]:
        waves = range(1, int(self.shape["waves"]) + 1)
        return [
            (f"{x}{joint + 1}_{i}", self.unit_on(joint))
            for i in waves
            for x in ("a_p", "b_p")
        ]

    def column(self, motion: Motion, joint: int) -> Array:
        return motion.sign(joint)[:, None] * self._waves(
            self.shape["k"] * motion.q[:, joint]
        )

    def _waves(self, phase: Array) -> Array:
        """(N, 2 waves) cos and sin of the phase and its multiples."""
        waves = np.arange(1.0, self.shape["waves"] + 1.0) * phase[:, None]
        return np.stack([np.cos(waves), np.sin(waves)], axis=2).reshape(len(phase), -1)

    def constraints(
        self,
        indices: NDArray[np.intp],
        parameters: Sequence[Parameter] = (),
    ) -> list[Constraint]:
        """Coulomb friction of the same joint, which it varies, stays above zero at
        every position."""
        phases = np.linspace(
            0.0,
            2.0 * np.pi,
            _PHASES,
            endpoint=False,
        )
        between = np.cos(
            np.pi * self.shape["waves"] / _PHASES
        )  # how low a wave is at the nearest phase
        coefficients = np.vstack(
            [
                np.ones(_PHASES),
                self._waves(phases).T / between,
            ]
        )
        coulomb = {
            p.joint - 1: k
            for k, p in enumerate(parameters)
            if p.effect == "coulomb_friction"
        }
        k = len(coefficients) - 1
        sign_constraints = super().constraints(indices, parameters)
        return sign_constraints + [
            build.linear(
                "sign",
                f"{self.name} {j + 1}",
                np.array([coulomb[j], *indices[k * place : k * (place + 1)]]),
                coefficients,
                np.zeros(_PHASES),
            )
            for place, j in enumerate(self.joints)
            if j in coulomb
        ]
