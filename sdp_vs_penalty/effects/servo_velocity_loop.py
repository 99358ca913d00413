"""The integral of a velocity loop, inside of a position loop."""

from sdp_vs_penalty.effects.effect import Array, Motion
from sdp_vs_penalty.effects.servo import ServoGain


class ServoVelocityLoop(ServoGain):
    name = "servo_velocity_loop"
    equation = "kh q"
    explanation = (
        "A cascade: the position loop asks for the velocity w e, and the velocity loop answers with "
        "kv (w e - dq) + kh integral (w e - dq) dt. The first term is servo_position; of the second the "
        "integral of e is servo_integral (ki = kh w), and that of dq is this: a pull to where the "
        "joint began, which no motion tells from a joint_spring. In a cascade ki / kh = kp / kd."
    )
    reference = "Janot, Gautier, Brunot, Control Engineering Practice 2019 (EMPS); Corke, sec. 9.1.7"
    needs_command = False
    symbol = "kh"
    units = ("N*m/rad", "N/m")

    def column(self, motion: Motion, joint: int) -> Array:
        return motion.q[:, joint]
