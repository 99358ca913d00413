"""A zero that moves with time."""

from sdp_vs_penalty.effects.drift import Drift
from sdp_vs_penalty.effects.effect import Array, Motion


class DriftOffset(Drift):
    name = "drift_offset"
    equation = "f_do times t | exp(-t / T), for form = 1 | 2 (t from t0)"
    explanation = (
        "The zero of the torque channel drifts: a strain gauge or a current sensor that warms up. "
        "It depends on the time, not on the motion."
    )
    reference = "Doebelin, Measurement Systems, ch. 3 (zero drift)"
    signless = True
    symbol = "f_do"
    refines = ("torque_offset",)

    def unit_on(self, joint: int) -> str:
        return super().unit_on(joint) + ("" if self.exponential else "/s")

    def column(self, motion: Motion, joint: int) -> Array:
        return self.course(motion)
