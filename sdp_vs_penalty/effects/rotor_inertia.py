"""The motor's rotor, seen through the gear."""

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion


class RotorInertia(JointEffect):
    name = "rotor_inertia"
    equation = "I_a ddq"
    explanation = (
        "Reflected rotor inertia (armature): the rotor turns N times faster than the link, so its "
        "inertia counts N^2 times on the joint's own axis. Only a motor-side torque contains it."
    )
    reference = "Khalil, Dombre, Modeling, Identification and Control of Robots, sec. 9.4"
    symbol = "I_a"
    units = ("kg*m^2", "kg")
    lower = 0.0
    # On the links' grid: what cannot be told from them stays so to the last bit.
    signless = smooth = True

    def column(self, motion: Motion, joint: int) -> Array:
        return motion.ddq[:, joint]
