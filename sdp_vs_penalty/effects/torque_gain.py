"""A wrong scale of the torque channel."""

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion, Seen

#: Drives state their gains to some per cent; beyond this, something else is wrong.
_LARGEST = 0.3


class TorqueGain(JointEffect):
    name = "torque_gain"
    equation = "g tau_hat"
    explanation = (
        "The torque channel of this joint reads 1 + g times the true torque: a sensor's or a "
        "drive's gain. It is identifiable because the other joints show the true inertia."
    )
    reference = "Gautier, Briot, ASME J. Dynamic Systems 2014 (drive gains)"
    symbol = "g"
    units = ("-", "-")
    needs_torque = True
    forward = "channel"

    def column(self, motion: Motion, joint: int) -> Array:
        return motion.model_torque[:, joint]

    def undone(self, theta: Array, t: Array, torque: Array) -> Array:
        out = torque.copy()
        out[:, list(self.joints)] /= 1.0 + theta
        return out

    def looks_like(self, size: float, seen: Seen) -> str:
        if abs(size) > _LARGEST:
            return f"a gain that is off by {100.0 * abs(size):.0f} % is rather a wrong ratio or unit"
        return super().looks_like(size, seen)
