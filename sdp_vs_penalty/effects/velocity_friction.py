"""Friction of a joint that is a function of its velocity, and of the load that it
carries."""

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from sdp_vs_penalty.effects.effect import SIGN_WIDTH, Array, Effect, JointEffect, Motion
from sdp_vs_penalty.effects.shape import VELOCITY, ShapeConstant, choice
from sdp_vs_penalty.robot.robot import Robot


class ViscousFriction(JointEffect):
    equation = "f_v dq"
    explanation = (
        "Lubricant shear and damping: a torque against the motion that grows with"
        " speed."
    )
    on_the_arm = "{joint} rubs harder the faster it moves: {size}"
    seen_against = "velocity"
    simulator_field = "damping"
    reference = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994, sec. 2"
    symbol = "f_v"
    units = ("N*m*s/rad", "N*s/m")
    lower = 0.0
    signless = True

    def column(self, motion: Motion, joint: int) -> Array:
        """Return the joint's velocity (N,) [rad/s, m/s]."""
        return motion.dq[:, joint]


class CoulombFriction(JointEffect):
    equation = "f_c tanh(dq / v_s)"
    explanation = (
        "Dry contact: a torque of fixed size against the direction of motion. It turns"
        " round over v_s, which is estimated joint by joint where it is not given."
        " Together with torque_offset it also covers a Coulomb friction that differs by"
        " direction."
    )
    in_words = "Coulomb friction"
    on_the_arm = "{joint} rubs with {size} at any speed"
    seen_against = "velocity"
    simulator_field = "friction"
    reference = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994, sec. 2"
    symbol = "f_c"
    at_rest = "turns"
    lower = 0.0
    shapes = {
        "v_s": ShapeConstant(
            SIGN_WIDTH,
            VELOCITY,
            grid=(
                0.00002,
                0.0001,
                0.00025,
                0.0005,
                0.001,
                0.002,
                0.004,
                0.008,
                0.016,
                0.032,
                0.064,
                0.128,
            ),
            bounds=(0.00002, 0.128),
            metres=0.1,
            role="estimated",
        )
    }

    def column(self, motion: Motion, joint: int) -> Array:
        """Return the smooth sign tanh(dq / v_s) (N,) of the joint's velocity."""
        return motion.sign(joint, self.shape["v_s"])


class FrictionLead(JointEffect):
    equation = "f_e (tanh((dq + lead ddq) / v_s) - tanh(dq / v_s))"
    explanation = (
        "Dry friction turns round before its joint does (f_e > 0), as in a simulator"
        " whose friction is a soft constraint (MuJoCo's solreffriction), or after it"
        " (f_e < 0), as bristles do. f_e / f_c times the lead is how much earlier, to"
        " first order. A simulation from torques leaves it out."
    )
    on_the_arm = (
        "dry friction of {joint} turns round {sign:before|after} its velocity does "
        "({size})"
    )
    seen_against = "reversal"
    reference = "Todorov, Erez, Tassa, IROS 2012 (MuJoCo); Dahl, AIAA Journal 1976"
    symbol = "f_e"
    sought = False
    shapes = {"lead": ShapeConstant(0.01, "s")}

    def column(self, motion: Motion, joint: int) -> Array:
        """Return the sign of the velocity ``lead`` [s] ahead, less that of the velocity
        (N,)."""
        return motion.sign_ahead(joint, self.shape["lead"]) - motion.sign(joint)


#: Name of the lead of dry friction.
LEAD = FrictionLead.name


def lead_of_friction(effects: Sequence[Effect]) -> Effect | None:
    """Return the lead of the dry friction among some effects; None without Coulomb
    friction, or where the lead is among them."""
    names = {effect.name for effect in effects}
    if CoulombFriction.name not in names or FrictionLead.name in names:
        return None
    return FrictionLead(effects[0].robot)


class AsymmetricViscousFriction(JointEffect):
    equation = "f_va |dq|"
    explanation = (
        "Viscous friction with different slopes in the two directions: f_v + f_va"
        " forwards, f_v - f_va backwards. Typical of seals and preloaded gears."
    )
    on_the_arm = (
        "{joint} is damped by {twice} more in its {sign:positive|negative} "
        "direction than in the other one, as by a tight seal"
    )
    seen_against = "velocity"
    reference = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994, sec. 2"
    symbol = "f_va"
    units = ("N*m*s/rad", "N*s/m")
    refines = ("viscous_friction",)

    def column(self, motion: Motion, joint: int) -> Array:
        """Return the joint's speed |dq| (N,)."""
        return np.abs(motion.dq[:, joint])


class AsymmetricCoulombFriction(JointEffect):
    equation = "f_ca |tanh(dq / v_s)|"
    explanation = (
        "Dry friction of different size in the two directions: f_c + f_ca forwards, f_c"
        " - f_ca backwards. Where it turns round at once that is Coulomb friction and"
        " an offset; over a wide velocity v_s both vanish together near standstill,"
        " where an offset does not."
    )
    in_words = "asymmetric Coulomb friction"
    on_the_arm = (
        "{joint} rubs {twice} harder in its {sign:positive|negative} direction "
        "than in the other one"
    )
    seen_against = "velocity"
    has_constant_part = True
    reference = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994, sec. 2"
    symbol = "f_ca"
    #: Beside an offset it shows only where friction turns round, which is what laws
    #: with a memory bend.
    refines = ("coulomb_friction", "presliding_hysteresis", "stiction")

    def column(self, motion: Motion, joint: int) -> Array:
        """Return the size |tanh(dq / v_s)| (N,) of the smooth sign: 1 in motion, 0 at
        rest."""
        return np.abs(motion.sign(joint))


class PowerLawFriction(JointEffect):
    equation = "f_p sign(dq) |dq|^alpha"
    explanation = (
        "Friction that is not linear in speed: alpha < 1 where the lubricant thins with"
        " shear and warms, alpha > 1 where it is churned (2: like drag)."
    )
    on_the_arm = (
        "friction of {joint} {sign:grows|falls} with its speed to the power "
        "{alpha} ({size})"
    )
    seen_against = "velocity"
    reference = "Waiboer, Aarts, Jonker, ECCOMAS Multibody Dynamics 2005"
    symbol = "f_p"
    units = ("N*m*(s/rad)^alpha", "N*(s/m)^alpha")
    refines = ("viscous_friction", "coulomb_friction")
    shapes = {
        "alpha": ShapeConstant(
            2.0, grid=(0.3, 0.5, 0.7, 1.5, 2.0, 3.0), bounds=(0.15, 4.0)
        )
    }

    def column(self, motion: Motion, joint: int) -> Array:
        """Return sign(dq) |dq|^alpha (N,)."""
        dq = motion.dq[:, joint]
        return motion.sign(joint) * np.abs(dq) ** self.shape["alpha"]


#: How a sigmoid rises from -1 to 1: soon, late, and in between.
_RISES: Mapping[str, Callable[[Array], Array]] = {
    "tanh": np.tanh,
    "atan": lambda x: 2.0 / np.pi * np.arctan(x),
    "algebraic": lambda x: x / np.hypot(1.0, x),
}


#: A rise by tanh is at least so many times wider than the sign, which is a tanh itself:
#: the difference of nearly equal curves is almost nothing, and its fitted size was eight
#: times that of the friction (22 standard deviations off; with 2 or 4 here, one).
WIDER_THAN_SIGN = 2.0


class SigmoidFriction(JointEffect):
    equation = (
        "f_sg (s(dq / v0) - sign(dq)), s(x) = tanh x | 2/pi atan x | x / sqrt(1 + x^2),"
        " for law = tanh | atan | algebraic"
    )
    explanation = (
        "A part f_sg of the Coulomb friction rises over a velocity range v0 instead of"
        " jumping: the sigmoid form phi_1 / (1 + exp(-phi_2 (dq + phi_3))) of the"
        " paper's Table I, whose phi_3 is an offset, or one with a longer tail. Near"
        " standstill there is less friction than Coulomb's law says."
    )
    on_the_arm = (
        "close to standstill {joint} rubs {size} {sign:less|more} than when it moves"
    )
    seen_against = "velocity"
    reference = (
        "Gaz et al., RA-L 2019, eq. 9 and Table I; Pennestri et al., Nonlinear Dynamics"
        " 2016"
    )
    symbol = "f_sg"
    lower = 0.0
    refines = ("coulomb_friction",)
    #: With f_sg = f_c and the first law the sum is Coulomb friction of another width.
    generalises = ("coulomb_friction",)
    width_shape = "v0"
    shapes = {
        "v0": ShapeConstant(
            0.1, VELOCITY, grid=(0.02, 0.04, 0.08, 0.16, 0.32), bounds=(0.012, 2.0)
        ),
        "law": choice(*_RISES),
    }

    def column(self, motion: Motion, joint: int) -> Array:
        """Return s(dq / v0) - sign(dq) (N,), the deviation of a slow rise from
        Coulomb's jump.

        Zeros for a tanh whose v0 is less than twice the sign's own width: the difference
        of two equal curves would determine nothing. The other rises differ from the
        sign at any v0, and one of them is the whole law where f_sg = f_c.
        """
        law = self.shapes["law"].written(self.shape["law"])
        v0 = self.shape["v0"]
        deviation = _RISES[law](motion.dq[:, joint] / v0) - motion.sign(joint)
        differs = law != "tanh" or v0 >= WIDER_THAN_SIGN * motion.width(joint)
        return deviation * differs


class StribeckFriction(JointEffect):
    equation = (
        "f_st sign(dq) times exp(-x) | 1 / (1 + x), x = (|dq| / vs)^delta, for law ="
        " dip | tail"
    )
    explanation = (
        "At low speed the surfaces touch; as speed rises a lubricant film lifts them"
        " apart and the friction falls by f_st towards its Coulomb level, within about"
        " the Stribeck velocity vs, or with a long tail."
    )
    in_words = "Stribeck friction"
    on_the_arm = (
        "{joint} rubs {size} {sign:more|less} when it creeps than when it moves fast"
    )
    seen_against = "velocity"
    reference = (
        "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 1994, eq. 7; tail:"
        " Hess, Soom, ASME J. Tribology 1990"
    )
    symbol = "f_st"
    lower = 0.0
    refines = ("coulomb_friction",)
    shapes = {
        "vs": ShapeConstant(
            0.1, VELOCITY, grid=(0.02, 0.04, 0.08, 0.16, 0.32), bounds=(0.012, 1.0)
        ),
        "delta": ShapeConstant(2.0, grid=(1.0, 2.0)),
        "law": choice("dip", "tail"),
    }

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """List the shape constants with which a search begins: every law but the tail
        with delta = 1.

        That tail falls so slowly that Coulomb friction of any size could make up for
        it.
        """
        tail = 2.0  # number of this law
        return [
            start
            for start in super().starts(robot, joint)
            if not (start["law"] == tail and start["delta"] == 1.0)
        ]

    def column(self, motion: Motion, joint: int) -> Array:
        """Return sign(dq) times exp(-x), or times 1 / (1 + x) for law = tail, x = (|dq|
        / vs)^delta; (N,)."""
        x = (np.abs(motion.dq[:, joint]) / self.shape["vs"]) ** self.shape["delta"]
        is_dip = self.shape["law"] == 1.0
        fall = np.exp(-x) if is_dip else 1.0 / (1.0 + x)
        return motion.sign(joint) * fall


class LoadDependentFriction(JointEffect):
    equation = "f_l |tau_l| sign(dq), tau_l the links' torque"
    explanation = (
        "Gear teeth and bearings are pressed harder by the torque that they transmit"
        " and rub more: f_l is the share of it that is lost, one minus the gear's"
        " efficiency. It is the links' torque: motor friction and rotor do not pass"
        " through the gear."
    )
    on_the_arm = "the gear of {joint} loses {share} of the torque that it carries"
    seen_against = "load"
    reference = "Hamon, Gautier, Garrec, IROS 2010; Wahrburg et al., ICRA 2018"
    symbol = "f_l"
    units = ("-", "-")
    usual = (0.3, 0.3)  # of a worm gear half is lost
    lower = 0.0
    refines = ("coulomb_friction",)
    needs_links = True

    def column(self, motion: Motion, joint: int) -> Array:
        """Return |tau_l| sign(dq) (N,) [N m, N], tau_l being the torque of the current
        model's links."""
        return np.abs(motion.link_torque[:, joint]) * motion.sign(joint)
