"""Base of the effects that change with time."""

from abc import abstractmethod
from collections.abc import Iterable

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.shape import ShapeConstant, choice
from sdp_vs_penalty.robot.robot import Robot


class Drift(JointEffect):
    """Odd forms are linear in time, even ones settle with the time constant T; t0 is
    the clock's reading from which time counts: the measurements' first instant."""

    follows_clock = True
    time_constant = ShapeConstant(
        300.0, "s", grid=(10.0, 30.0, 100.0), bounds=(3.0, 3000.0)
    )
    clock = ShapeConstant(0.0, "s", signed=True, role="clock")
    shapes = {"form": choice(count=2), "T": time_constant, "t0": clock}

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """List the shape constants with which a search begins: {"form": ..., "T": ...}
        for each settling form (even numbers) and three time constants T [s].

        Linear forms are not tried: a linear drift grows without end in a later run, and
        a long time constant is nearly linear.
        """
        settling = [form for form in cls.shapes["form"].choices if form % 2 == 0]
        return [
            {"form": form, "T": T} for form in settling for T in cls.shapes["T"].grid
        ]

    @property
    def exponential(self) -> bool:
        """Whether the effect settles as exp(-t / T) (even forms) instead of growing
        with time."""
        return self.shape["form"] % 2 == 0

    def unit_on(self, joint: int) -> str:
        """Return the parameter's unit: that of a torque (N*m, N) for a settling drift,
        torque per second for a linear one, which is multiplied by the time."""
        return super().unit_on(joint) + ("" if self.exponential else "/s")

    @property
    def searched(self) -> tuple[str, ...]:
        """Names of the shape constants that measurements can determine: T only where it
        settles."""
        return ("form", "T") if self.exponential else ("form",)

    def course(self, motion: Motion) -> Array:
        """Compute how the effect follows time at N instants (N,): t [s] for linear
        forms, exp(-|t| / T) [-] for settling ones.

        Time counts from t0. A settling effect fades before t0 too: in an older run
        exp(-t / T) would grow without end.
        """
        t = motion.t - self.shape["t0"]
        return np.exp(-np.abs(t) / self.shape["T"]) if self.exponential else t


class DriftOffset(Drift):
    equation = "f_do times t | exp(-t / T), for form = 1 | 2 (t from t0)"
    explanation = (
        "The zero of the torque channel drifts: a strain gauge or a current sensor that"
        " warms up. It depends on the time, not on the motion."
    )
    on_the_arm = (
        "the torque reading of {joint} drifts while the arm runs ({size}), as a "
        "sensor that warms up does"
    )
    seen_against = "time"
    has_constant_part = True
    reference = "Doebelin, Measurement Systems, ch. 3 (zero drift)"
    signless = True
    symbol = "f_do"
    refines = ("torque_offset",)

    def column(self, motion: Motion, joint: int) -> Array:
        """Return the course of time (N,): t or exp(-|t| / T), from t0."""
        return self.course(motion)


class Rubbing(JointEffect):
    """Coulomb or viscous friction that changes."""

    @property
    @abstractmethod
    def viscous(self) -> bool:
        """Whether the effect changes viscous friction, proportional to the velocity;
        otherwise it changes Coulomb friction, by the velocity's sign."""

    def unit_on(self, joint: int) -> str:
        """Return the unit: of a torque, over velocity for viscous friction."""
        torque = super().unit_on(joint)
        position = self.robot.position_units[joint]
        return f"{torque}*s/{position}" if self.viscous else torque

    def rubbing(self, motion: Motion, joint: int) -> Array:
        """Compute the friction of unit size on a joint (from 0) at N instants: the
        velocity (N,) [rad/s, m/s], or its smooth sign (N,) in [-1, 1]."""
        return motion.dq[:, joint] if self.viscous else motion.sign(joint)


class DriftFriction(Rubbing, Drift):
    equation = (
        "f_df times sign(dq) t | sign(dq) exp(-t / T) | dq t | dq exp(-t / T), for form"
        " = 1 | 2 | 3 | 4"
    )
    explanation = (
        "Friction falls (or rises) with the time since the start: grease warms up and"
        " thins. Coulomb (form 1, 2) or viscous (form 3, 4) friction follows the clock,"
        " linearly or settling with T. Settling is warming_friction without a"
        " thermometer: where logged temperatures explain as much, that is named."
    )
    on_the_arm = "friction of {joint} changes while the arm runs ({size})"
    seen_against = "time"
    reference = "Simoni, Beschi, Legnani, Visioli, IROS 2015"
    symbol = "f_df"
    # Where temperatures are logged they are the cause; the clock only stands in for
    # them.
    refines: tuple[str, ...] = (
        "coulomb_friction",
        "viscous_friction",
        "warming_friction",
    )
    shapes = {**Drift.shapes, "form": choice(count=4)}

    def settle(self) -> None:
        """Set what the effect refines, which a search must have before it tries this one:
        the friction that its form changes, and warming by a logged temperature."""
        # The class lists Coulomb friction first, then viscous friction.
        self.refines = self.refines[int(self.viscous)], "warming_friction"

    @property
    def viscous(self) -> bool:
        """Whether viscous friction changes (forms 3 and 4); otherwise Coulomb
        friction."""
        return self.shape["form"] > 2.0

    def column(self, motion: Motion, joint: int) -> Array:
        """Return friction of unit size times the course of time (N,)."""
        return self.course(motion) * self.rubbing(motion, joint)


#: Temperature at which the exponential is 1 [degrees Celsius]; another one would only
#: scale the amplitude.
_ROOM = 20.0


class WarmingFriction(Rubbing):
    equation = (
        "f_w exp(-(temp - 20) / warm) or f_w exp(-(t - t0) / T), for by = temperature |"
        " clock, times sign(dq) | dq, for law = coulomb | viscous"
    )
    explanation = (
        "Grease thins as it warms, and friction falls exponentially with the gear's"
        " temperature (columns temp1..tempn of the log). By the clock it settles with"
        " T, counted over all runs by their own time stamps, pauses included: that is"
        " drift_friction with form 2 or 4, its special case, which a search names where"
        " no temperature was logged. For f_w >= 0 it never feeds energy."
    )
    on_the_arm = "{joint} rubs {sign:less|more} as it warms up ({size})"
    seen_against = "time"
    reference = (
        "Simoni, Beschi, Legnani, Visioli, IROS 2015; Carlson et al., Mech. Mach."
        " Theory 2015"
    )
    symbol = "f_w"
    lower = 0.0
    needs_temperature = True
    refines: tuple[str, ...] = (
        "coulomb_friction",
        "viscous_friction",
    )  # each law its own
    shapes = {
        "law": choice("coulomb", "viscous"),
        "by": choice("temperature", "clock"),
        "warm": ShapeConstant(20.0, "K", grid=(8.0, 20.0, 50.0), bounds=(3.0, 200.0)),
        "T": Drift.time_constant,
        "t0": Drift.clock,
    }

    def settle(self) -> None:
        """Note which signal the effect needs: the clock (by = 2) or a logged temperature.

        The effect refines the friction that it changes, viscous or Coulomb: a search
        tries it only beside that one.
        """
        coulomb_friction, viscous_friction = type(self).refines
        self.refines = (viscous_friction if self.viscous else coulomb_friction,)
        self.follows_clock = self.shape["by"] == 2.0
        self.needs_temperature = not self.follows_clock

    @property
    def searched(self) -> tuple[str, ...]:
        """Names of the shape constants that measurements can determine: the scale of
        the temperature, or the time constant by the clock."""
        return ("law", "by", "T" if self.follows_clock else "warm")

    @property
    def viscous(self) -> bool:
        """Whether viscous friction falls with temperature; otherwise Coulomb
        friction."""
        return self.shape["law"] == 2.0

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """List the shape constants with which a search begins, all by temperature.

        By the clock the effect is drift_friction, which a search tries anyway.
        """
        scales = list(zip(cls.shapes["warm"].grid, cls.shapes["T"].grid, strict=True))
        laws = cls.shapes["law"].choices
        return [
            {"law": law, "warm": warm, "T": T} for law in laws for warm, T in scales
        ]

    def column(self, motion: Motion, joint: int) -> Array:
        """Return friction of unit size times exp(-x) (N,).

        x is the temperature above 20 degrees Celsius over ``warm`` [K], or the time
        from t0 over T.
        """
        if self.follows_clock:
            x = np.abs(motion.t - self.shape["t0"]) / self.shape["T"]  # as of Drift
        else:
            x = (motion.joint_temperature[:, joint] - _ROOM) / self.shape["warm"]
        return np.exp(-x) * self.rubbing(motion, joint)
