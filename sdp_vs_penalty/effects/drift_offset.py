"""A zero that moves with time."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.drift import Drift, hidden_drift
from sdp_vs_penalty.effects.effect import Array, Motion
from sdp_vs_penalty.effects.hidden import HiddenEffect, TrueRobot


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
    units = ("N*m", "N")
    refines = ("torque_offset",)

    def unit_on(self, joint: int) -> str:
        return super().unit_on(joint) + ("" if self.exponential else "/s")

    def column(self, motion: Motion, joint: int) -> Array:
        return self.course(motion)


def hidden(joint: int, true: TrueRobot, rng: np.random.Generator) -> HiddenEffect:
    return hidden_drift("drift_offset", joint, rng, friction=False)
