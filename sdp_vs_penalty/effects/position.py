"""Torques that follow the position of a joint."""

from collections.abc import Iterable, Sequence

import numpy as np

from sdp_vs_penalty.effects.effect import (
    Array,
    JointCoverage,
    JointEffect,
    Motion,
    Parameter,
)
from sdp_vs_penalty.effects.shape import POSITION, ShapeConstant, choice, six_digits
from sdp_vs_penalty.effects.wave import WAVES_TO_REPEAT, Wave, wave_numbers
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot.arrays import Indices
from sdp_vs_penalty.robot.constraint import Constraint
from sdp_vs_penalty.robot.robot import Robot, joint_limits


class JointSpring(JointEffect):
    equation = "k_s q"
    explanation = (
        "A torque that grows with the joint's position: cables and hoses that are wound"
        " up, a balance spring. Its rest position appears as part of the offset."
    )
    on_the_arm = (
        "{joint} is {sign:pulled back|pushed away} as by a spring of "
        "{size}{per_degree}: a cable, a hose or a balance spring"
    )
    seen_against = "position"
    has_constant_part = True
    simulator_field = "stiffness"
    reference = "Khalil, Dombre, Modeling, Identification and Control of Robots, ch. 9"
    signless = True
    symbol = "k_s"
    units = ("N*m/rad", "N/m")

    def column(self, motion: Motion, joint: int) -> Array:
        """Return the joint's position (N,) [rad, m]."""
        return motion.q[:, joint]


class StiffeningSpring(JointEffect):
    equation = "k_1 q + k_2 q^2 + k_3 q^3"
    explanation = (
        "A spring that stiffens (or yields) along its way: a cable bundle that is wound"
        " up, a hose, a bump stop. Its rest position appears in the lower powers and in"
        " the offset; the cubic part says how much it stiffens."
    )
    on_the_arm = (
        "{joint} is held as by a spring that {sign:stiffens|yields} along its way "
        "({size}): a cable, a hose or a stop"
    )
    seen_against = "position"
    has_constant_part = True
    reference = (
        "Nayfeh, Mook, Nonlinear Oscillations, 1979, ch. 4 (Duffing's cubic spring)"
    )
    generalises = ("joint_spring",)
    signless = True
    sized_by = slice(2, 3)  # the cubic part

    def parameter_names_and_units(self, joint: int) -> Iterable[tuple[str, str]]:
        """Name the factors of q, q^2 and q^3: "k_1_3", "k_2_3" and "k_3_3" on joint
        3."""
        torque = self.unit_on(joint)
        position = self.robot.position_units[joint]
        powers = (position, f"{position}^2", f"{position}^3")
        return [
            (f"k_{power}_{joint + 1}", f"{torque}/{unit}")
            for power, unit in enumerate(powers, start=1)
        ]

    def column(self, motion: Motion, joint: int) -> Array:
        """Return q, q^2 and q^3 (N, 3) of the joint's position q [rad, m]."""
        q = motion.q[:, joint]
        return np.column_stack([q, q**2, q**3])


#: Places along a joint's range from which a search for its end stop starts.
_PLACES = 20


class EndStop(JointEffect):
    equation = "k_e max(q - q0, 0) | k_e min(q - q0, 0), for side = above | below"
    explanation = (
        "From q0 on the joint is pushed back, as by a spring on one side only: an end"
        " stop, a bumper, a cable that is pulled taut. Before q0 nothing touches."
    )
    on_the_arm = (
        "{place} {joint} is pushed back as by a spring of {size}{per_degree}: an "
        "end stop, a bumper or a taut cable"
    )
    seen_against = "position"
    reference = "Shaw, Holmes, J. Sound and Vibration 1983 (piecewise linear spring)"
    generalises = ("joint_spring",)  # where it touches all the way
    lower = 0.0
    several = True  # one at either end
    starts_stand_out = True
    signless = True
    symbol = "k_e"
    units = ("N*m/rad", "N/m")
    shapes = {
        "q0": ShapeConstant(
            0.0, POSITION, grid=(0.0,), bounds=(-1e3, 1e3), scale="linear", signed=True
        ),
        "side": choice("above", "below"),
    }

    @property
    def is_above(self) -> bool:
        """Whether it touches at positions above q0, and not at those below."""
        return self.shape["side"] == 1.0

    def parameter_name(self, joint: int) -> str:
        """Name the stiffness after joint, side and place: "k_e3_above_0.5"."""
        side = self.shapes["side"].written(self.shape["side"])
        return f"{self.symbol}{joint + 1}_{side}_{self.shape['q0']:.6g}"

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """List the places from which a search chooses those that stand out: evenly along
        the joint's range, for one side and then for the other."""
        lower, upper, _ = joint_limits(robot)
        places = np.linspace(lower[joint], upper[joint], _PLACES + 1)[1:-1]
        return [
            {"q0": six_digits(place), "side": side}
            for side in cls.shapes["side"].choices
            for place in places
        ]

    def column(self, motion: Motion, joint: int) -> Array:
        """Return how far (N,) [rad, m] the joint is beyond q0; 0 before it, and negative
        where it is below."""
        beyond = motion.q[:, joint] - self.shape["q0"]
        side = np.maximum if self.is_above else np.minimum
        return side(beyond, 0.0)

    def looks_like(self, size: float, coverage: JointCoverage) -> str:
        """Give a reason to doubt a stop that was never reached, or never left."""
        if coverage.lowest < self.shape["q0"] < coverage.highest:
            return super().looks_like(size, coverage)
        return "the joint did not move both before it and beyond it"


class TorqueRipple(Wave, JointEffect):
    equation = "a_r cos(k q) + b_r sin(k q)"
    explanation = (
        "A torque that repeats k times per turn (k times 2 pi metres on a prismatic"
        " joint): motor poles, gear teeth, an eccentric gear or a strain wave"
        " generator, which turns twice its ratio."
    )
    on_the_arm = (
        "the torque of {joint} waves by {size} as it turns{waves}: motor poles, "
        "gear teeth or an eccentric gear"
    )
    seen_against = "waves per turn"
    reference = (
        "Tuttle, Seering, IEEE Trans. Robotics and Automation 1996 (strain wave gears)"
    )
    several = True
    symbols = "a_r", "b_r"
    shapes = {
        "k": ShapeConstant(
            2.0,
            ("1/turn", "rad/m"),
            # Once a turn is left out: that is geometry, such as a link's weight or a
            # joint mounted off its place. Orders above 40 are visible at full rate only
            # (the order spectrum).
            grid=tuple(float(k) for k in range(2, 41)),
            bounds=(1.9, 1e4),
            # Waves: neighbours are a fixed distance apart, whatever their order.
            scale="linear",
        )
    }

    signless = True

    def resembles_over(self, coverage: JointCoverage) -> tuple[str, ...]:
        """Name springs where fewer than two waves were travelled: these make any smooth
        torque there."""
        if self.n_waves(coverage) >= WAVES_TO_REPEAT:
            return super().resembles_over(coverage)
        return ("joint_spring", "stiffening_spring")

    def column(self, motion: Motion, joint: int) -> Array:
        """Return cos(k q) and sin(k q) (N, 2)."""
        phase = self.shape["k"] * motion.q[:, joint]
        return np.column_stack([np.cos(phase), np.sin(phase)])


#: Phases of a wave at which the friction may not become negative, and its finest waves
#: on a prismatic joint [rad/m].
_PHASES = 48
_FINEST_FRICTION = 300.0


class PositionDependentFriction(JointEffect):
    equation = "sign(dq) sum_i (a_i cos(i k q) + b_i sin(i k q)), i = 1 .. waves"
    explanation = (
        "Dry friction that varies along the range: an eccentric or bent shaft, a cable"
        " bundle that is pressed, a gear worn where it works most. Waves of k per turn,"
        " with twice k where waves = 2. Beside coulomb_friction on the same joint the"
        " sum is kept from becoming negative, so that it never feeds energy."
    )
    on_the_arm = (
        "{joint} rubs harder at some positions than at others, by up to {size}: a "
        "bent shaft, a pressed cable or a worn gear"
    )
    seen_against = "position and direction"
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
            bounds=(0.5, _FINEST_FRICTION),
            scale="linear",
        ),
        "waves": choice(count=2),
    }

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """List the wave numbers with which a search begins, each with one wave.

        Two waves fit anything where less than a full turn was travelled, so none is
        tried.
        """
        numbers = wave_numbers(cls.shapes["k"], robot, joint, _FINEST_FRICTION)
        return [{"k": k, "waves": 1.0} for k in numbers]

    def parameter_names_and_units(self, joint: int) -> Iterable[tuple[str, str]]:
        """Name the amplitudes of each wave, "a_p3_1", "b_p3_1", with the unit of a
        torque."""
        waves = range(1, int(self.shape["waves"]) + 1)
        return [
            (f"{x}{joint + 1}_{i}", self.unit_on(joint))
            for i in waves
            for x in ("a_p", "b_p")
        ]

    def column(self, motion: Motion, joint: int) -> Array:
        """Return sign(dq) times cos and sin of each wave (N, 2 waves)."""
        sign = motion.sign(joint)
        waves = self._waves(self.shape["k"] * motion.q[:, joint])
        return np.column_stack([sign * wave for wave in waves])

    def _waves(self, phase: Array) -> list[Array]:
        """Return cos(i phase) and sin(i phase) for i = 1 ... ``waves``, in turn, of a
        phase (N,) [rad]: (N,) each."""
        orders = range(1, int(self.shape["waves"]) + 1)
        return [wave(i * phase) for i in orders for wave in (np.cos, np.sin)]

    def constraints(
        self, indices: Indices, parameters: Sequence[Parameter] = ()
    ) -> list[Constraint]:
        """Demand that Coulomb friction plus its variation stays at least zero at every
        position.

        This is stated at 48 phases; the waves are scaled up by how much lower they can
        be between two of them. It applies to joints that also have coulomb_friction.

        Parameters
        ----------
        indices
            (k,) places of this effect's parameters in theta.
        parameters
            All of theta, among which the Coulomb frictions are found.

        Returns
        -------
        list of Constraint
            Linear constraints F(theta) >= 0, with the usual bounds.
        """
        phases = np.linspace(0.0, 2.0 * np.pi, _PHASES, endpoint=False)
        # Half a step from a stated phase a wave has fallen to this share of its peak.
        share_of_peak = np.cos(np.pi * self.shape["waves"] / _PHASES)
        waves = np.array(self._waves(phases)) / share_of_peak  # (k, phases)
        coefficients = np.vstack([np.ones(_PHASES), waves])
        coulomb_index = {
            p.joint - 1: index
            for index, p in enumerate(parameters)
            if p.effect == "coulomb_friction"
        }
        k = len(waves)  # parameters of each joint
        constraints = super().constraints(indices, parameters)
        for place, joint in enumerate(self.joints):
            if joint not in coulomb_index:
                continue
            variation = indices[k * place : k * (place + 1)]
            constraints.append(
                build.linear(
                    "sign",
                    f"{self.name} {joint + 1}",
                    np.array([coulomb_index[joint], *variation]),
                    coefficients,
                    np.zeros(_PHASES),
                )
            )
        return constraints
