"""The control laws of servos: the drive's torque, moved to the load's side of tau = Y
theta.

Where no torque is logged, the drive's law replaces it. With tau_drive = k (q_cmd -
q) - d dq the equation of motion reads 0 = Y theta - k (q_cmd - q) + d dq: linear in the
links, the friction and the gains together, up to one common factor.
"""

from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Block, JointEffect, Motion
from sdp_vs_penalty.effects.shape import ShapeConstant

#: The longest delay of a command [s]: with a longer one no useful loop is stable.
LATEST = 0.1


class Servo(JointEffect):
    """A part of the drive's law: a torque of the drive counts negative here, as a
    load's would.

    T : how much later than it is logged the command acts [s]; one for all joints.
    """

    forward = "drive"
    needs_command = True
    #: Its law without the gain, as a combination (7,) of a command, its two derivatives
    #: and its integral, and of position, velocity and integral; d [s] is a further
    #: delay, by Taylor's series to second order: q_cmd(t - d) = q_cmd - d q_cmd' + d^2 /
    #: 2 q_cmd''.
    terms: ClassVar["staticmethod[[float], list[float]]"]
    signless = True
    lower = 0.0
    range = 1e8
    # It drives the joint: a search for missing loads must not find it.
    sought = False
    shapes = {
        "T": ShapeConstant(
            0.0, "s", grid=(0.0,), bounds=(0.0, LATEST), scale="linear", signed=True
        )
    }


class ServoGain(Servo):
    """A part with one gain a joint."""

    shape_of = "servo_position"
    searched = ()  # none of its own: the delay is servo_position's

    def blocks(self, motion: Motion) -> list[Block]:
        """Compute one column (N,) for each joint: the torque of the drive per unit
        gain, as a load.

        The drive sees the command T seconds late (shape constant T).
        """
        column = self.torque_per_gain(motion, motion.t - self.shape["T"])
        return self.blocks_per_joint([column[:, j] for j in self.joints])

    def torque_per_gain(self, motion: Motion, command_t: Array) -> Array:
        """Compute the torque (N, n) on the load from gains of one, with the command at
        the instants ``command_t`` (N,) [s]."""
        raise NotImplementedError


class ServoPosition(Servo):
    equation = "-kp (q_cmd(t - T) - q) + kd dq(t - d)"
    explanation = (
        "The drive pulls the joint towards its commanded position and damps it. A"
        " cascade kv (w e - dq) is the same law, with kp = kv w and kd = kv. Motions"
        " show only the sum of kd and viscous friction: beside viscous_friction kd is"
        " the rest of that sum. A drive that differentiates its encoder feels an older"
        " velocity: kd dq(t - d) is kd dq less kd d ddq, to first order, which without"
        " a logged torque cannot be told from a lighter link."
    )
    on_the_arm = "the drive of {joint} pulls it to its command with {size}"
    reference = "Siciliano et al., Robotics: Modelling, Planning and Control, sec. 8.5"
    sized_by = slice(0, 1)
    simulator_field = "servo"
    #: Of the position error; the damping kd is in all laws.
    terms = staticmethod(lambda d: [1.0, -d, d * d / 2.0, 0.0, -1.0, 0.0, 0.0])
    shapes = {**Servo.shapes, "d": ShapeConstant(0.0, "s", scale="linear", signed=True)}
    searched = ("T",)  # the delay; the age of the velocity is given or zero

    def parameter_names_and_units(self, joint: int) -> Iterable[tuple[str, str]]:
        """Name the gains of position error and velocity of a joint, "kp3" and "kd3",
        with their units."""
        torque_unit = self.unit_on(joint)
        per = self.robot.position_units[joint]
        return [
            (f"kp{joint + 1}", f"{torque_unit}/{per}"),
            (f"kd{joint + 1}", f"{torque_unit}*s/{per}"),
        ]

    def blocks(self, motion: Motion) -> list[Block]:
        """Compute the columns (N, 2) of each joint: minus the position error, and the
        velocity.

        The error is minus, because a drive's torque counts as a negative load. The
        command is T old; the velocity is d old: dq - d ddq to first order.
        """
        error = motion.logged_command.position(motion.t - self.shape["T"]) - motion.q
        rate = motion.dq - self.shape["d"] * motion.ddq
        return self.blocks_per_joint(
            [np.column_stack([-error[:, j], rate[:, j]]) for j in self.joints]
        )


class ServoIntegral(ServoGain):
    equation = "-ki integral (q_cmd(t - T) - q) dt"
    explanation = (
        "The drive adds up its position error and pulls until none is left. Nobody logs"
        " where the integral began: a torque_offset beside it holds that as well, and"
        " is no sensor's zero any more."
    )
    on_the_arm = "the drive of {joint} adds up its position error ({size})"
    reference = "Astrom, Murray, Feedback Systems 2008, ch. 10"
    has_constant_part = True  # the integral begins anywhere
    terms = staticmethod(lambda d: [-d, d * d / 2.0, 0.0, 1.0, 0.0, 0.0, -1.0])
    symbol = "ki"
    units = ("N*m/rad/s", "N/m/s")

    def torque_per_gain(self, motion: Motion, command_t: Array) -> Array:
        """Return minus the integral (N, n) of the position error [rad s, m s], with the
        command at the instants ``command_t`` (N,) [s].

        Minus, because a drive's torque counts as a negative load.
        """
        return motion.integral - motion.logged_command.integral(command_t)


class ServoVelocityLoop(ServoGain):
    equation = "kh q"
    explanation = (
        "A cascade: the position loop asks for the velocity w e, and the velocity loop"
        " answers with kv (w e - dq) + kh integral (w e - dq) dt. The first term is"
        " servo_position; of the second the integral of e is servo_integral (ki = kh"
        " w), and that of dq is this: a pull to where the joint began, which no motion"
        " tells from a joint_spring. In a cascade ki / kh = kp / kd."
    )
    on_the_arm = (
        "the drive of {joint} adds up its velocity error, as a spring of {size} "
        "would pull"
    )
    reference = (
        "Janot, Gautier, Brunot, Control Engineering Practice 2019 (EMPS); Corke, sec."
        " 9.1.7"
    )
    terms = staticmethod(lambda d: [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    needs_command = False
    symbol = "kh"
    units = ("N*m/rad", "N/m")

    def torque_per_gain(self, motion: Motion, command_t: Array) -> Array:
        """Return the positions q (N, n) [rad, m]: the integral of the velocity, up to a
        constant, against which the drive pulls.

        A drive's torque, -kh q, counts as a negative load: the sign is plus.
        """
        return motion.q


class ServoFeedforward(ServoGain):
    equation = "-kc dq_cmd(t - T)"
    explanation = (
        "The drive adds a torque in proportion to the commanded velocity; where it"
        " damps the error's rate, kc = kd. A late command looks like a negative one: kp"
        " e(t - T) is kp e - kp T dq_cmd, to first order in T."
    )
    on_the_arm = (
        "the drive of {joint} adds torque in proportion to the commanded speed ({size})"
    )
    reference = "Siciliano et al., Robotics: Modelling, Planning and Control, sec. 8.3"
    terms = staticmethod(lambda d: [0.0, 1.0, -d, 0.0, 0.0, 0.0, 0.0])
    symbol = "kc"
    units = ("N*m*s/rad", "N*s/m")

    def torque_per_gain(self, motion: Motion, command_t: Array) -> Array:
        """Return minus the commanded velocity (N, n) at the instants ``command_t`` (N,)
        [s].

        Minus, because a drive's torque counts as a negative load.
        """
        return -motion.logged_command.velocity(command_t)


#: The laws of drives by their names, those with fewer gains first: their effects.
LAWS: dict[str, tuple[type[Servo], ...]] = {
    name + more: effects + also
    for name, effects in (
        ("PD", (ServoPosition,)),
        ("PID", (ServoPosition, ServoIntegral)),
        ("cascade", (ServoPosition, ServoIntegral, ServoVelocityLoop)),
    )
    for more, also in (("", ()), (" with feed-forward", (ServoFeedforward,)))
}


def law_of_terms(name: str, d: float) -> Array:
    """Return the law ``name`` of :data:`LAWS` as a matrix (7, 1 + m): each column
    combines the seven terms of a drive (:attr:`Servo.terms`). ``d`` is a further delay
    of the command [s].

    Column 0 is the control error e = q_cmd(t - d) - q; the other m columns are what the
    law adds to it (damping, integral, velocity loop, feed-forward), each with a gain.
    """
    damping = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]  # the velocity alone
    error, *further = (effect.terms(d) for effect in LAWS[name])
    return np.array([error, damping, *further]).T
