"""The integral part of a servo's law."""

from sdp_vs_penalty.effects.effect import Block, Motion
from sdp_vs_penalty.effects.servo import ServoGain


class ServoIntegral(ServoGain):
    name = "servo_integral"
    equation = "-ki integral (q_cmd(t - T) - q) dt"
    explanation = (
        "The drive adds up its position error and pulls until none is left. Nobody logs where the "
        "integral began: a torque_offset beside it holds that as well, and is no sensor's zero any more."
    )
    reference = "Astrom, Murray, Feedback Systems 2008, ch. 10"
    symbol = "ki"
    units = ("N*m/rad/s", "N/m/s")

    def blocks(self, motion: Motion) -> list[Block]:
        path = motion.told.integral(motion.t - self.shape["T"]) - motion.integral
        return self.apart([-path[:, j] for j in self.joints])
