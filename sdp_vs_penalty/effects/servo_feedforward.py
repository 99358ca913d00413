"""The velocity feed-forward of a servo's law."""

from sdp_vs_penalty.effects.effect import Block, Motion
from sdp_vs_penalty.effects.servo import ServoGain


class ServoFeedforward(ServoGain):
    name = "servo_feedforward"
    equation = "-kc dq_cmd(t - T)"
    explanation = (
        "The drive adds a torque in proportion to the commanded velocity; where it damps the error's "
        "rate, kc = kd. A late command looks like a negative one: kp e(t - T) is kp e - kp T dq_cmd, to "
        "first order in T."
    )
    reference = "Siciliano et al., Robotics: Modelling, Planning and Control, sec. 8.3"
    symbol = "kc"
    units = ("N*m*s/rad", "N*s/m")

    def blocks(self, motion: Motion) -> list[Block]:
        rate = motion.told.velocity(motion.t - self.shape["T"])
        return self.apart([-rate[:, j] for j in self.joints])
