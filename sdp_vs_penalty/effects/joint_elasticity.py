"""A soft gear between encoder and link."""

import numpy as np

from sdp_vs_penalty.effects.effect import Array, LinkDeviation, Motion


class JointElasticity(LinkDeviation):
    name = "joint_elasticity"
    equation = "-c_e (dID/dq_j tau_j + dID/d dq_j d tau_j/dt + dID/d ddq_j d^2 tau_j/dt^2)"
    explanation = (
        "The gear of joint j yields under the torque tau_j that it transmits (that of the links; "
        "motor friction does not pass through it): the link lags behind the motor-side encoder by "
        "c_e tau_j, c_e = 1 / stiffness. To first order that changes position, velocity and "
        "acceleration in the inverse dynamics of every joint."
    )
    reference = "Spong, ASME J. Dynamic Systems 1987"
    symbol = "c_e"
    units = ("rad/(N*m)", "m/N")
    lower = 0.0
    signless = True
    forward = "left out"  # a link that moves by itself
    has_memory = True  # time derivatives of the torque

    def deviated(self, motion: Motion, joint: int) -> Array:
        by_q, by_dq, by_ddq = motion.derivatives
        tau = motion.link_torque[:, joint, None]
        rate, acceleration = (x[:, joint, None] for x in motion.link_torque_rates)
        out = by_q[:, :, joint] * tau + by_dq[:, :, joint] * rate + by_ddq[:, :, joint] * acceleration
        return np.negative(out)
