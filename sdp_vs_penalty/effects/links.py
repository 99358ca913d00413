"""The links' inertia and weight, what is carried, and links that stand elsewhere than
the model says."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Self

import numpy as np
import scipy

from sdp_vs_penalty.effects.effect import (
    Array,
    Block,
    Effect,
    JointCoverage,
    JointEffect,
    Motion,
    Parameter,
)
from sdp_vs_penalty.effects.shape import ShapeConstant, choice
from sdp_vs_penalty.effects.wave import Wave
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Indices, as_slice
from sdp_vs_penalty.robot.constraint import Constraint
from sdp_vs_penalty.robot.robot import ROUNDED_ANGLE, Robot

#: Distance [m] of a centre of mass beyond which rounding would show in a torque divided
#: by the mass.
_FARTHEST = 100.0


class RigidBody(Effect):
    equation = "M(q) ddq + C(q, dq) dq + g(q) = Y(q, dq, ddq) theta"
    explanation = (
        "Mass, centre of mass and inertia of every link determine the torque that"
        " accelerates the arm and holds it against gravity."
    )
    on_the_arm = "the links of {joint} weigh what the model says"
    simulator_field = "links"
    reference = "Atkeson, An, Hollerbach, IJRR 1986"
    signless = smooth = True
    sought = False  # a model without it has no torque to begin with

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:  # type: ignore[override]
        """Ten standard parameters of each link: mass, first moments, inertia about the
        link's frame."""
        return tuple(
            Parameter(name, unit, self.name, link)
            for link in range(1, self.robot.links + 1)
            for name, unit in zip(
                inertia.parameter_names(link), inertia.UNITS, strict=True
            )
        )

    def constraints(
        self, indices: Indices, parameters: Sequence[Parameter] = ()
    ) -> list[Constraint]:
        """Return no constraints: the bounds of the links' parameters are stated by the
        problem."""
        return []

    def blocks(self, motion: Motion) -> list[Block]:
        """Compute the columns (N, 10 k) of each joint's torque: of the k links that it
        carries."""
        regressor = self.robot.regressor(motion.q, motion.dq, motion.ddq)
        blocks = []
        for joint, links in enumerate(self.robot.subtree):
            # Places of the ten parameters of each link that the joint carries.
            indices = (10 * np.array(links, np.intp)[:, None] + np.arange(10)).ravel()
            # On a serial arm these links are consecutive.
            columns = regressor[:, joint, as_slice(indices)]
            blocks.append(Block(joint, indices, columns))
        return blocks

    def torque(self, theta: Array, motion: Motion) -> Array:
        """Compute the links' torque (N, n) [N m, N] by recursive Newton-Euler.

        This takes half the time of columns times theta. It divides by the masses, so a
        link with nearly no mass for its first moment goes through the columns.
        """
        links = theta.reshape(-1, 10)
        masses = np.abs(links[:, 0])
        first_moments = np.linalg.norm(links[:, 1:4], axis=1)
        if np.any(first_moments > _FARTHEST * masses):
            return super().torque(theta, motion)
        return self.robot.inverse_dynamics(theta, motion.q, motion.dq, motion.ddq)


class Payload(Effect):
    equation = "Y_last(q, dq, ddq) theta_payload"
    explanation = (
        "A body carried by the last link. Its ten parameters are those of the last"
        " link, so only a model held fixed (identified without the load) can show it."
        " Its mass is only as accurate as the scale of the torque channels: gains that"
        " are 1 % off make it 1 % off, and these data cannot separate the two."
    )
    on_the_arm = "the last link carries {size} more than in the model"
    seen_against = "position"
    simulator_field = "payload"
    reference = "Atkeson, An, Hollerbach, IJRR 1986"
    whole_robot = True
    signless = smooth = True
    frozen_only = True
    sized_by = slice(0, 1)  # its mass

    def parameter_names_and_units(self, joint: int) -> Iterable[tuple[str, str]]:
        """Name the ten standard parameters of the carried body, "payload_m" ..., with
        their units."""
        names = inertia.parameter_names(self.robot.links)
        n_digits = len(str(self.robot.links))  # of the link's number, "Ixx7"
        return zip(
            [f"payload_{name[:-n_digits]}" for name in names],
            inertia.UNITS,
            strict=True,
        )

    def constraints(
        self, indices: Indices, parameters: Sequence[Parameter] = ()
    ) -> list[Constraint]:
        """Demand that the payload is a body: a positive semidefinite pseudo-inertia,
        besides bounds."""
        return [
            build.pseudo_inertia(self.name, indices),
            *super().constraints(indices, parameters),
        ]

    @property
    def nominal(self) -> Array:
        """(10,) parameters of a solid ball of 0.5 kg and 5 cm radius, to start a solver
        from."""
        mass = 0.5
        # Over the mass: 1, centre of mass (3,), Ixx Ixy Iyy Ixz Iyz Izz = 2/5 r^2 1.
        return mass * np.array([1.0, 0, 0, 0, 1e-3, 0, 1e-3, 0, 0, 1e-3])

    def torques(self, motion: Motion) -> Array:
        """Compute the torque (N, n, 10) [N m, N] per unit of each parameter: the
        columns of the last link."""
        return self.robot.regressor(motion.q, motion.dq, motion.ddq)[:, :, -10:]


class ExternalWrench(Effect):
    equation = "-J(q)^T (F, M)"
    explanation = (
        "A force and a moment that stay constant in the world act on the last link, at"
        " its joint's origin: a cable or a balancer that pulls, a tool that rests on"
        " something."
    )
    on_the_arm = (
        "something pulls the last link with {size}, mostly towards {towards} of "
        "the world: a cable, a balancer or a contact"
    )
    seen_against = "position"
    has_constant_part = True
    reference = "Siciliano et al., Robotics: Modelling, Planning and Control, sec. 7.1"
    whole_robot = True
    signless = smooth = True
    sized_by = slice(0, 3)  # the force

    def parameter_names_and_units(self, joint: int) -> Iterable[tuple[str, str]]:
        """Name the force F_x, F_y, F_z [N] and the moment M_x, M_y, M_z [N m] in world
        axes."""
        return [
            (f"{x}_{axis}", unit)
            for x, unit in (("F", "N"), ("M", "N*m"))
            for axis in "xyz"
        ]

    def torques(self, motion: Motion) -> Array:
        """Compute the torque (N, n, 6) per unit force and moment: minus the transposed
        Jacobian.

        Elements that only rounded angles of the robot's file make are zero: on joints
        that are parallel but for these, a force along their axes would need 1e9 N to
        make a torque.
        """
        jacobians = self.robot.jacobians(motion.q, self.robot.link_joints[-1])
        reach = max(1.0, float(np.sum(self.robot.link_reach())))
        is_rounding = np.abs(jacobians) < ROUNDED_ANGLE * reach
        return -np.where(is_rounding, 0.0, jacobians).swapaxes(1, 2)


class RotorInertia(JointEffect):
    equation = "I_a ddq"
    explanation = (
        "Reflected rotor inertia (armature): the rotor turns N times faster than the"
        " link, so its inertia counts N^2 times on the joint's own axis. Only a"
        " motor-side torque contains it."
    )
    on_the_arm = "the motor's rotor adds {size} to {joint}"
    seen_against = "acceleration"
    simulator_field = "armature"
    reference = (
        "Khalil, Dombre, Modeling, Identification and Control of Robots, sec. 9.4"
    )
    symbol = "I_a"
    units = ("kg*m^2", "kg")
    lower = 0.0
    # Computed on the links' grid, so that a rotor which cannot be told from the links
    # stays so to the last bit.
    signless = smooth = True

    def column(self, motion: Motion, joint: int) -> Array:
        """Return the joint's acceleration (N,): the torque per unit of rotor
        inertia."""
        return motion.ddq[:, joint]


class MotorInertia(JointEffect):
    equation = (
        "I_m (ddq_m - ddq), q_m the motor's position on the joint's side of the gear"
    )
    explanation = (
        "Where motor and link have encoders of their own (columns qmot1..qmotn), the log"
        " shows how the gear yields: the rotor's inertia acts on the motor's"
        " acceleration. The part that follows the link's acceleration is rotor_inertia,"
        " which the links often absorb; this is the rest, which they cannot."
    )
    on_the_arm = (
        "the motor of {joint} turns an inertia of {size} that the gear keeps from "
        "the link"
    )
    reference = (
        "Albu-Schaeffer, Hirzinger, IEEE ICRA 2001 (both sides measured); Spong 1987"
    )
    symbol = "I_m"
    units = ("kg*m^2", "kg")
    lower = 0.0
    signless = True
    needs_motors = True
    forward = "left out"  # a motor that moves by itself

    def column(self, motion: Motion, joint: int) -> Array:
        """Return the motor's acceleration less the link's (N,), both on the joint's
        side of the gear."""
        return motion.motor_acceleration[:, joint] - motion.ddq[:, joint]


def across_gravity(robot: Robot) -> Array:
    """Return (2, 3) unit vectors of the two directions perpendicular to gravity.

    They are two base axes where gravity points along the third, otherwise the
    orthonormal pair that is nearest to two base axes.
    """
    gravity = np.array(robot.gravity if any(robot.gravity) else (0.0, 0.0, -1.0))
    down = gravity / np.linalg.norm(gravity)
    axes = np.delete(np.eye(3), int(np.argmax(np.abs(down))), axis=0)
    flat = axes - np.outer(axes @ down, down)
    u, _, vt = np.linalg.svd(flat, full_matrices=False)
    return u @ vt  # the orthonormal pair nearest to the projected axes


class BaseTilt(Effect):
    equation = "g_1 dID/dg_1 + g_2 dID/dg_2"
    explanation = (
        "The base is not mounted as the model says: gravity has components along the"
        " two directions across the assumed one (x and y of an upright base). 0.17"
        " m/s^2 is one degree."
    )
    on_the_arm = (
        "the base is bolted {tilt} out of level, leaning towards {towards} (that "
        "side is the low one)"
    )
    seen_against = "position"
    reference = (
        "Luh, Walker, Paul, ASME J. Dynamic Systems 1980 (gravity as the base's"
        " acceleration)"
    )
    usual = (0.5, 0.5)  # three degrees, which an eye sees
    needs_links = True
    whole_robot = True
    signless = True

    def parameter_names_and_units(self, joint: int) -> Iterable[tuple[str, str]]:
        """Name the two components of gravity across the assumed one, "g_x" and "g_y"
        [m/s^2]."""
        names = ["1", "2"]
        is_along_an_axis = np.count_nonzero(self.robot.gravity) < 2
        if is_along_an_axis:
            names = [
                "xyz"[int(np.argmax(np.abs(axis)))]
                for axis in across_gravity(self.robot)
            ]
        return [(f"g_{name}", "m/s^2") for name in names]

    def torques(self, motion: Motion) -> Array:
        """Compute the static torque (N, n, 2) of the links per unit of gravity in each
        direction."""
        zero = np.zeros_like(motion.q)
        columns = []
        for gravity in across_gravity(self.robot):
            robot = replace(self.robot, gravity=(gravity[0], gravity[1], gravity[2]))
            columns.append(
                robot.inverse_dynamics(motion.model_links, motion.q, zero, zero)
            )
        return np.stack(columns, axis=2)

    def remark(self, size: float) -> str:
        """Say by how many degrees the base is tilted: size / 9.81, with ``size`` the
        component of gravity [m/s^2] across the assumed direction (small angles)."""
        return f"Here: {np.degrees(size / 9.81):.2g} degrees."


class LinkDeviation(Effect):
    """Joint j's link is elsewhere than its encoder says: torque on every joint that
    depends on it."""

    needs_links = True
    signless = True

    def torque_per_deviation(self, motion: Motion, joint: int) -> Array:
        """Compute the torque (N, n) on all joints from one unit of the deviation of one
        joint (from 0), at N instants."""
        raise NotImplementedError

    def torques(self, motion: Motion) -> Array:
        """Compute the torque (N, n, k) per unit of deviation of each of the effect's k
        joints."""
        return np.stack(
            [self.torque_per_deviation(motion, j) for j in self.joints], axis=2
        )


class JointZeroError(LinkDeviation):
    equation = "e_0 dID/dq_j"
    explanation = (
        "The true position of joint j is q_j + e_0: gravity and the coupling between"
        " links act at a different angle than the model assumes. (Rotating both"
        " neighbours' frames would do the same; on some joints the links' parameters"
        " absorb it.)"
    )
    on_the_arm = "{joint} stands {length} {sign:beyond|short of} what its encoder says"
    seen_against = "position"
    reference = "Mooring, Roth, Driels, Fundamentals of Manipulator Calibration, 1991"
    symbol = "e_0"
    units = ("rad", "m")
    usual = (0.05, 0.01)  # an arm that was homed by eye
    faults = ("encoder offset",)

    def torque_per_deviation(self, motion: Motion, joint: int) -> Array:
        """Return the torque (N, n) per radian or metre of zero error of one joint:
        dID/dq_j."""
        by_q, _, _ = motion.derivatives(joint)
        return by_q


#: Waves per turn of a joint up to which a gear's error is looked for: twice the ratio of
#: a strain wave gear of 1:100.
_MOST_WAVES = 200


class GearError(Wave, LinkDeviation):
    equation = "a_g D cos(k q) + b_g D sin(k q), D as of joint_elasticity"
    explanation = (
        "The gear of joint j does not turn evenly: the link runs ahead of the motor-side"
        " encoder and behind it in turn, k times per turn of the joint, by up to"
        " sqrt(a_g^2 + b_g^2). Its weight acts at another angle, and the faster it turns"
        " the more the link is shaken, on all joints that carry it: eccentric wheels,"
        " worn teeth, or a strain wave generator, which turns twice its ratio."
    )
    on_the_arm = (
        "the gear of {joint} turns unevenly: its link runs ahead and behind by "
        "{length}{waves}"
    )
    seen_against = "waves per turn"
    reference = (
        "Tuttle, Seering, IEEE Trans. Robotics and Automation 1996 (strain wave gears)"
    )
    usual = (5e-3, 5e-4)  # a wheel so eccentric that it is heard
    several = True  # one for each wheel
    symbols = "a_g", "b_g"
    units = ("rad", "m")
    starts_stand_out = True
    forward = "left out"  # a link that moves by itself
    shapes = {
        "k": ShapeConstant(
            2.0,
            ("1/turn", "rad/m"),
            # Once a turn is left out: that is a joint mounted off its place.
            grid=tuple(float(k) for k in range(2, _MOST_WAVES + 1)),
            bounds=(1.9, 1e4),
            scale="linear",
        )
    }

    def torques(self, motion: Motion) -> Array:
        """Compute the torque (N, n, 2 k) per radian or metre of the cosine and the sine
        of each of the effect's k joints."""
        return np.concatenate(
            [self._wave_torques(motion, j) for j in self.joints], axis=2
        )

    def _wave_torques(self, motion: Motion, joint: int) -> Array:
        """Compute the torque (N, n, 2) per unit of the cosine and the sine of one
        joint's gear (from 0).

        With x = cos(k q) the link moves by x' = -k sin(k q) dq and x'' = -k^2 cos(k q)
        dq^2 - k sin(k q) ddq; with the sine likewise. The gear's ratio changes along the
        wave as well: as much power leaves it as enters, so that the motor carries
        (1 + dx/dq) times its link's torque.
        """
        k = self.shape["k"]
        by_q, by_dq, by_ddq = motion.derivatives(joint)
        q, dq, ddq = (x[:, [joint]] for x in (motion.q, motion.dq, motion.ddq))
        # Factors of the wave itself and of its derivative over k; with cos(k q) these
        # are cos(k q) and -sin(k q).
        of_wave = by_q - (k * dq) ** 2 * by_ddq
        of_derivative = k * (dq * by_dq + ddq * by_ddq)
        of_derivative[:, joint] += k * motion.link_torque[:, joint]
        cosine, sine = np.cos(k * q), np.sin(k * q)
        torque_of_cosine = cosine * of_wave - sine * of_derivative
        torque_of_sine = sine * of_wave + cosine * of_derivative
        return np.stack([torque_of_cosine, torque_of_sine], axis=2)

    @classmethod
    def own_columns(cls, forms: Sequence[Self], motion: Motion) -> Array:
        """Compute the torque (N, 2 K) on the gear's own joint alone, per unit of the
        cosine and the sine of K wave numbers k.

        They are real and imaginary part of exp(i k q) (a - k^2 b + i k c), with what
        acts on the wave, on its curvature and on its slope. Each exp(i k q) is the last
        one times exp(i q (k - last k)): a product costs a tenth of a cosine.
        """
        joint = forms[0].joints[0]
        by_q, by_dq, by_ddq = (x[:, joint] for x in motion.derivatives(joint))
        q, dq, ddq = (x[:, joint] for x in (motion.q, motion.dq, motion.ddq))
        of_curvature = dq**2 * by_ddq
        of_slope = dq * by_dq + ddq * by_ddq + motion.link_torque[:, joint]
        columns = np.empty((len(q), len(forms)), complex)
        last_k = 0.0
        wave = np.ones(len(q), complex)  # exp(i k q) at the last k
        # The last step of k, and exp(i step q), kept while k is evenly spaced.
        step = 0.0
        wave_of_step = wave
        for place, form in enumerate(forms):
            k = form.shape["k"]
            if k - last_k != step:
                step = k - last_k
                wave_of_step = np.exp(1j * step * q)
            wave = wave * wave_of_step
            last_k = k
            columns[:, place] = wave * (by_q - k**2 * of_curvature + 1j * k * of_slope)
        return columns.view(float)  # real and imaginary parts take turns


#: Below this frequency [Hz] a geared joint yields like a spring without mass. For gears in
#: MuJoCo with resonances of 4 to 8 Hz the compliance is right within a fifth with 2 or 4
#: Hz here; with 8 Hz it is -.1 to .7 of the true one.
_BENDS = 4.0


class Backlash(LinkDeviation):
    equation = (
        "-b dID/dq_j s | -b D s below the frequency band, for law = rests | crosses; s"
        " = sign(tau_j), D as of joint_elasticity"
    )
    explanation = (
        "The gear of joint j has play: the link rests against one flank or the other, b"
        " away from the position that the motor-side encoder shows, on the side that"
        " the transmitted torque tau_j determines. With law = crosses the way from"
        " flank to flank counts too, whose velocity and acceleration the encoder does"
        " not show."
    )
    on_the_arm = "the gear of {joint} has play: {length} to either side"
    seen_against = "modelled torque"
    reference = "Nordin, Gutman, Automatica 2002"
    symbol = "b"
    units = ("rad", "m")
    usual = (0.02, 0.002)  # a worn gear; a new one has a tenth
    lower = 0.0
    forward = "left out"  # a link that moves by itself within the play
    has_memory = True  # time derivatives of the side
    shapes = {"law": choice("rests", "crosses"), "band": ShapeConstant(_BENDS, "Hz")}

    def torque_per_deviation(self, motion: Motion, joint: int) -> Array:
        """Return the torque (N, n) per radian or metre of play in one joint's gear.

        The link rests on one of the gear's two flanks: it is displaced against the
        sign s(t) of the torque that the gear transmits. The law "rests" counts the
        displacement only, -dtau/dq s; "crosses" also counts the velocity and
        acceleration of the link from flank to flank.
        """
        side = np.sign(motion.link_torque[:, joint])
        derivatives = motion.derivatives(joint)
        by_q = derivatives[0]
        if self.shape["law"] == 1.0:  # rests
            return -by_q * side[:, None]
        # The difference to the first side is exactly 0 where the flank never changes,
        # so that smoothing leaves no velocity by rounding.
        crossed = motion.smoothed(side - side[0], self.shape["band"])
        return -by_q * side[0] - _torque_of_displacement(motion, crossed, derivatives)


#: Below this frequency [Hz] a flight through the play does not depend on how the flanks
#: catch the link: they ring at some tens of Hz.
_FLIES = 10.0
#: A flight through a play of b displaces the link by about b: at least half, at most
#: twice that.
_LEAST_OVER_PLAY, _MOST_OVER_PLAY = 0.5, 2.0


class BacklashInFlight(LinkDeviation):
    equation = (
        "-b_f D x / b below the frequency band, M d^2 x/dt^2 = tau_j between the flanks"
        " |x| <= b, which catch without a rebound; D and M as of joint_resonance"
    )
    explanation = (
        "The gear of joint j has play of b to either side, and its link flies from flank"
        " to flank: between them no torque reaches it, while the motor with its encoder"
        " jumps ahead by itself. Backlash of law = crosses follows the sign of the torque"
        " at once; here the link takes as long as its inertia M needs. b_f is about b."
    )
    on_the_arm = (
        "the gear of {joint} has play, {length} to either side, and its link flies "
        "from flank to flank"
    )
    seen_against = "modelled torque"
    reference = "Nordin, Gutman, Automatica 2002; Moreau 1988 (impacts without rebound)"
    symbol = "b_f"
    units = ("rad", "m")
    usual = (0.02, 0.002)  # as of backlash
    lower = 0.0
    forward = "left out"  # a link that moves by itself within the play
    has_memory = True  # a link that flies
    generalises = ("backlash",)
    shapes = {
        "b": ShapeConstant(
            0.008,
            ("rad", "m"),
            grid=(0.002, 0.004, 0.008, 0.016),
            bounds=(5e-4, 0.06),
            metres=0.1,
        ),
        "band": ShapeConstant(_FLIES, "Hz"),
    }

    def contradicts_itself(self, theta: Array, mean_inertia: float) -> bool:
        """Return whether the link moves by far less or more than the play b."""
        over_play = theta[0] / self.shape["b"]
        return bool(over_play < _LEAST_OVER_PLAY or over_play > _MOST_OVER_PLAY)

    def torque_per_deviation(self, motion: Motion, joint: int) -> Array:
        """Return the torque (N, n) per radian or metre of play in one joint's gear: that
        of the link's lag x below the frequency ``band``, -D x / b."""
        derivatives = motion.derivatives(joint)
        derivatives_of_joint = tuple(x[:, joint] for x in derivatives)
        inertia_of_joint = derivatives_of_joint[2]
        # Links from least squares may have an inertia that is not positive.
        if inertia_of_joint.min() <= 0.0:
            return np.zeros_like(motion.q)
        lag = self._lag(motion, joint, derivatives_of_joint)
        # The difference to the first lag is exactly 0 where the link never flies, so
        # that smoothing leaves no velocity by rounding.
        flown = motion.smoothed(lag - lag[0], self.shape["band"])
        torque = derivatives[0] * lag[0]
        torque = torque + _torque_of_displacement(motion, flown, derivatives)
        return -torque / self.shape["b"]

    def _lag(self, motion: Motion, joint: int, derivatives: Sequence[Array]) -> Array:
        """Compute by how much (N,) [rad, m] the link lags behind the encoder.

        Each step is a free flight by central differences, cut off at the flanks, which
        takes the velocity relative to the encoder: the impact has no rebound.
        ``derivatives`` (N,) are those of the joint's torque by its position, velocity
        and acceleration.
        """
        play = self.shape["b"]
        by_q, by_dq, by_ddq = derivatives
        torque = motion.link_torque[:, joint]
        h = (motion.t[-1] - motion.t[0]) / max(len(torque) - 1, 1)
        inertia_term, damping_term = by_ddq / h**2, by_dq / (2.0 * h)
        # x(t + h) = push + from_this x(t) + from_last x(t - h)
        denominator = inertia_term + damping_term
        push = (torque / denominator).tolist()
        from_this = ((2.0 * inertia_term - by_q) / denominator).tolist()
        from_last = ((damping_term - inertia_term) / denominator).tolist()
        this = last = play * float(np.sign(torque[0]))
        lags = [this]
        for a, b, c in zip(push[:-1], from_this, from_last, strict=False):
            flown = a + b * this + c * last
            last, this = this, min(max(flown, -play), play)
            lags.append(this)
        return np.array(lags)


class JointElasticity(LinkDeviation):
    equation = (
        "-c_e D x, x = tau_j - c (D tau_j)_j below the frequency band, D x = dID/dq_j x"
        " + dID/d dq_j dx/dt + dID/d ddq_j d^2 x/dt^2"
    )
    explanation = (
        "The gear of joint j yields under the torque tau_j that it transmits (that of"
        " the links; motor friction does not pass through it): the link lags behind the"
        " motor-side encoder by c_e x, c_e = 1 / stiffness, which changes position,"
        " velocity and acceleration in the inverse dynamics of every joint. What bends"
        " the gear is the torque x of the link that lags; c is c_e. That holds well"
        " below the gear's resonance, and band keeps to there: where friction turns"
        " round the motor shakes faster than its link can follow."
    )
    on_the_arm = (
        "the gear of {joint} yields by {length} for each {torque} that it carries"
    )
    seen_against = "modelled torque"
    reference = "Spong, ASME J. Dynamic Systems 1987"
    symbol = "c_e"
    units = ("rad/(N*m)", "m/N")
    lower = 0.0
    forward = "left out"  # a link that moves by itself
    has_memory = True  # time derivatives of the torque
    shapes = {
        "c": ShapeConstant(0.0, units, signed=True),
        "band": ShapeConstant(_BENDS, "Hz"),
    }
    sized_shape = "c"

    def torque_per_deviation(self, motion: Motion, joint: int) -> Array:
        """Return the torque (N, n) per unit compliance of one joint's gear.

        The link is displaced from the encoder's position by -compliance times the
        torque of the gear, smoothed below the frequency ``band`` [Hz]. A shape
        constant c > 0 (an assumed compliance) computes that torque at the displaced
        link instead of at the encoder's position.
        """
        c = self.shape["c"]
        gear_torque = motion.smoothed(motion.link_torque[:, joint], self.shape["band"])
        derivatives = motion.derivatives(joint)
        if c:
            # Without this correction the compliance is up to a quarter too large.
            lost = _torque_of_displacement(motion, gear_torque, derivatives)[:, joint]
            gear_torque = gear_torque - c * lost
        return -_torque_of_displacement(motion, gear_torque, derivatives)


#: Least and greatest ratio of a gear's compliance to the one that follows from its
#: frequency and the joint's inertia. A model's inertia includes that of the motor, which
#: does not swing: it is up to twice that of the links.
_COMPLIANCE_OVER_EXPECTED = 1.0 / 3.0, 2.0
#: Damping ratio from which a swing is damped as by impacts and not as by a spring.
_DAMPED = 0.15


class JointResonance(LinkDeviation):
    equation = (
        "-c_r D x, x + c (D x + d dx/dt) = c tau_j, c = 1 / ((2 pi f)^2 M), d = 2 zeta"
        " (2 pi f) M, D as of joint_elasticity, M the joint's mean inertia"
    )
    explanation = (
        "The gear of joint j yields like a spring, and its link swings on it at f: the"
        " motor-side encoder does not show this. Unlike joint_elasticity it holds up"
        " to and above the resonance. c_r is 1 / stiffness."
    )
    in_words = "joint elasticity with resonance"
    on_the_arm = (
        "the gear of {joint} yields by {length} for each {torque} that it carries, "
        "and its link swings on it"
    )
    seen_against = "modelled torque"
    reference = "Spong, ASME J. Dynamic Systems 1987"
    symbol = "c_r"
    units = ("rad/(N*m)", "m/N")
    lower = 0.0
    forward = "left out"  # a link that moves by itself
    has_memory = True  # a link that swings
    shapes = {
        "f": ShapeConstant(4.0, "Hz", grid=(1.6, 2.5, 4.0, 6.3), bounds=(0.7, 15.0)),
        # A search begins with a wide resonance, so that few frequencies are enough.
        "zeta": ShapeConstant(0.05, grid=(0.1,), bounds=(0.005, 0.3)),
    }
    generalises = ("joint_elasticity",)

    def looks_like(self, size: float, coverage: JointCoverage) -> str:
        """Return a sentence on play, which damps a swing as no spring does; "" for a
        damping of springs."""
        if size == 0.0 or not self.is_stand_in:
            return ""
        return "play of the gear swings as strongly damped: backlash looks so"

    def contradicts_itself(self, theta: Array, mean_inertia: float) -> bool:
        """Return whether the compliance c_r is not that of a gear on which the joint's
        inertia M swings at f: a gear has c_r = 1 / ((2 pi f)^2 M).

        False where M is not known (NaN).
        """
        expected_stiffness = (2.0 * np.pi * self.shape["f"]) ** 2 * mean_inertia
        compliance_over_expected = theta[0] * expected_stiffness
        smallest, largest = _COMPLIANCE_OVER_EXPECTED
        return bool(
            compliance_over_expected < smallest or compliance_over_expected > largest
        )

    @property
    def resembles(self) -> tuple[str, ...]:  # type: ignore[override]
        """The effects that look so: play, where the swing is damped strongly."""
        return ("backlash",) if self.is_stand_in else ()

    @property
    def is_stand_in(self) -> bool:  # type: ignore[override]
        """Whether the swing is damped more than gears do: it stands in for play, or for
        any error whose phase changes with the frequency."""
        return self.shape["zeta"] >= _DAMPED

    def torque_per_deviation(self, motion: Motion, joint: int) -> Array:
        """Return the torque (N, n) per unit compliance of one joint's gear, on which
        its link swings at f."""
        derivatives = motion.derivatives(joint)
        derivatives_of_joint = tuple(x[:, joint] for x in derivatives)
        compliance = self._compliance(motion, joint, derivatives_of_joint)
        if compliance == 0.0:
            return np.zeros_like(motion.q)
        torque = motion.link_torque[:, joint]
        step = (motion.t[-1] - motion.t[0]) / max(len(torque) - 1, 1)
        lag = self.lag(torque, step, compliance, derivatives_of_joint)
        return -_torque_of_displacement(motion, lag, derivatives) / compliance

    def _compliance(
        self, motion: Motion, joint: int, derivatives: Sequence[Array]
    ) -> float:
        """Return 1 / stiffness [rad/(N m), m/N] of the gear on which the joint's mean
        inertia swings at f.

        It is 0 where the inertia, or the stiffness with that of the weight, is not
        positive at some instant, as least squares may have it: such a link does not
        swing. ``derivatives`` (N,) are those of the joint's torque by its position,
        velocity and acceleration.
        """
        mean_inertia = float(motion.mean_inertias[joint])
        stiffness = (2.0 * np.pi * self.shape["f"]) ** 2 * mean_inertia
        by_q, _, by_ddq = derivatives
        smallest_stiffness = stiffness + by_q.min()
        smallest_inertia = by_ddq.min()
        if min(stiffness, smallest_stiffness, smallest_inertia) <= 0.0:
            return 0.0
        return float(1.0 / stiffness)

    def lag(
        self, torque: Array, step: float, compliance: float, slopes: Sequence[Array]
    ) -> Array:
        """Compute by how much the link lags behind the encoder.

        The linear differential equation of the lag is solved step by step, from a
        spring that is stretched at rest: central differences, with the spring's torque
        averaged over three instants, which is stable for any step.

        Parameters
        ----------
        torque
            (N,) torque of the joint's links [N m, N].
        step
            Time between two instants [s].
        compliance
            1 / stiffness of the gear [rad/(N m), m/N].
        slopes
            Derivatives (N,) of the torque by the joint's position, velocity and
            acceleration.

        Returns
        -------
        Array
            (N,) the lag [rad, m].
        """
        by_q, by_dq, by_ddq = slopes
        stiffness = 1.0 / compliance + by_q
        damping = by_dq + self.shape["zeta"] / (np.pi * self.shape["f"] * compliance)
        # Of the lags x at three instants: next_one x_k+1 + this_one x_k + last_one x_k-1 =
        # (torque_k+1 + 2 torque_k + torque_k-1) / 4.
        by_step = by_ddq / step**2
        next_one = by_step + damping / (2.0 * step) + stiffness / 4.0
        this_one = stiffness / 2.0 - 2.0 * by_step
        last_one = by_step - damping / (2.0 * step) + stiffness / 4.0
        # The matrix has a diagonal and two bands below it: row k + 1 is that of x_k+1. Its
        # first two rows state x = torque / stiffness, at rest.
        bands = np.zeros((3, len(torque)))
        bands[0, :2] = 1.0
        bands[0, 2:] = next_one[1:-1]
        bands[1, 1:-1] = this_one[1:-1]
        bands[2, :-2] = last_one[1:-1]
        right_side = np.empty_like(torque)
        right_side[:2] = torque[0] / stiffness[0]
        right_side[2:] = (torque[:-2] + 2.0 * torque[1:-1] + torque[2:]) / 4.0
        lower_and_upper = (2, 0)
        return scipy.linalg.solve_banded(lower_and_upper, bands, right_side)


def _torque_of_displacement(
    motion: Motion, displacement: Array, derivatives: Sequence[Array]
) -> Array:
    """Return the change (N, n) of all joints' torque where the link of one joint is
    displaced by x (N,) [rad, m].

    dtau = dtau/dq_j x + dtau/ddq_j x' + dtau/dddq_j x'', with the displacement's
    velocity x' and acceleration x''. ``derivatives`` are those of the torque by the
    joint's position, velocity and acceleration, three (N, n).
    """
    by_q, by_dq, by_ddq = derivatives
    x, velocity, acceleration = motion.rates(displacement)
    torque = by_q * x[:, None]
    torque += by_dq * velocity[:, None]
    torque += by_ddq * acceleration[:, None]
    return torque


#: What may be expected of an arm that nobody has calibrated: displacements [m] and
#: turns [rad].
_SLIP = 2e-3
_TURN = 4e-3
#: Columns are computed at fewer instants if that loses no more than this share of the
#: acceleration (RMS) [-].
_THINNED = 0.02
#: Motions with fewer instants are not thinned.
_FEWEST = 200


class KinematicError(Effect):
    equation = "sum_jk e_jk dID/d(placement of joint j)_k"
    explanation = (
        "The joints are mounted off their places in the model, by small displacements"
        " and rotations in their own frames, so that gravity and inertia act elsewhere."
        " The data determine their common torque; a single one is known no better than"
        " its interval says. A calibration would measure each."
    )
    on_the_arm = "the joints sit beside their places in the model, by up to {slip}"
    seen_against = "position"
    reference = (
        "Mooring, Roth, Driels, Fundamentals of Manipulator Calibration, 1991, ch. 3"
    )
    generalises = ("base_tilt", "joint_zero_error")
    needs_links = True
    whole_robot = True
    signless = True

    def parameter_names_and_units(self, joint: int) -> Iterable[tuple[str, str]]:
        """Name the displacements [m] and rotations [rad] of the joints' frames:
        "slip_x3" along, and "turn_x3" about, the x axis of joint 3."""
        names = []
        for place, axis in self._joint_axis_pairs:
            word, unit = ("slip", "m") if axis < 3 else ("turn", "rad")
            names.append((f"{word}_{'xyz'[axis % 3]}{place + 1}", unit))
        return names

    @cached_property
    def _joint_axis_pairs(self) -> list[tuple[int, int]]:
        """Pairs (joint from 0, axis) of the errors that can make torque, displacements
        first.

        Axes 0 to 2 are displacements along x, y and z of the joint's frame, axes 3 to 5
        rotations about them. For a joint on the base only rotations that turn gravity
        change a torque; 1e-6 m/s^2 counts as no gravity.
        """
        pairs = list[tuple[int, int]]()
        for j, joint in enumerate(self.robot.tree):
            axes = list(range(6))
            if joint.parent == -1:
                # Gravity in the joint's frame; a rotation about it turns nothing.
                down = joint.placement[:3, :3].T @ np.array(self.robot.gravity)
                axes = [3 + k for k in range(3) if np.hypot(*np.delete(down, k)) > 1e-6]
            pairs += [(j, axis) for axis in axes]
        return sorted(pairs, key=lambda pair: pair[1] >= 3)

    @property
    def plausible(self) -> Array:
        """(k,) prior standard deviations of the parameters about zero, of an arm that
        was never calibrated: _SLIP [m] for displacements of joints, _TURN [rad] for
        rotations."""
        return np.array([_SLIP if k < 3 else _TURN for _, k in self._joint_axis_pairs])

    @property
    def sized_by(self) -> slice:  # type: ignore[override]
        """Slice of the parameters by which the effect's size is measured: the
        rotations, which stand behind the displacements and change gravity's torque
        most."""
        return slice(sum(k < 3 for _, k in self._joint_axis_pairs), None)

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """Return one start without shape constants, [{}], for a search; none for a
        robot on which no displacement changes a torque."""
        return [{}] if cls(robot).parameters else []

    def torques(self, motion: Motion) -> Array:
        """Compute the torque (N, n, k) per unit of each displacement and rotation.

        The derivatives are expensive: they are computed at fewer instants and
        interpolated by cubic splines.
        """
        instants = _sparse_instants(motion)
        return _interpolated(motion, instants, self._torques_at(motion, instants))

    def torque(self, theta: Array, motion: Motion) -> Array:
        """Compute the torque (N, n) [N m, N] of all displacements and rotations.

        Only the sum is interpolated between the instants of :meth:`torques`.
        """
        instants = _sparse_instants(motion)
        torque = self._torques_at(motion, instants) @ theta
        return _interpolated(motion, instants, torque)

    def _torques_at(self, motion: Motion, instants: Indices) -> Array:
        """Compute the torque (K, n, k) per unit of each displacement and rotation at K
        instants of a motion, given by their numbers."""
        derivatives = self.robot.placement_derivatives(
            motion.model_links,
            motion.q[instants],
            motion.dq[instants],
            motion.ddq[instants],
        )
        return np.stack(
            [derivatives[:, :, j, k] for j, k in self._joint_axis_pairs], axis=2
        )


def _interpolated(motion: Motion, instants: Indices, values: Array) -> Array:
    """Interpolate values (K, ...) at K instants of a motion, given by their numbers, at
    all its N instants by cubic splines; return (N, ...)."""
    if len(instants) == len(motion.t):
        return values
    spline = scipy.interpolate.CubicSpline(motion.t[instants], values)
    return spline(motion.t)


def _sparse_instants(motion: Motion) -> Indices:
    """Choose instants from which cubic splines restore the motion to 2 % of its
    acceleration.

    Returns their numbers: every 16th, 8th, 4th or 2nd instant, or all. All as well
    where time does not ascend, as for a simulation's independent states.
    """
    all_instants = np.arange(len(motion.t))
    if len(all_instants) < _FEWEST or np.any(np.diff(motion.t) <= 0.0):
        return all_instants
    for stride in (16, 8, 4, 2):
        chosen = np.unique(np.append(all_instants[::stride], all_instants[-1]))
        spline = scipy.interpolate.CubicSpline(motion.t[chosen], motion.ddq[chosen])
        error = spline(motion.t) - motion.ddq
        if np.all(error.std(axis=0) <= _THINNED * motion.ddq.std(axis=0)):
            return chosen
    return all_instants
