"""The step of an encoder: read off where values repeat it, and not off the smallest gap."""

import numpy as np
import pytest

from sdp_vs_penalty.signals.encoder import lattice_step

T = np.arange(2000) / 200.0
WAVE = 0.8 * np.sin(1.3 * T) + 0.3 * np.sin(2.9 * T + 1.0)
RAMP = 0.5 * T
#: There and back at one speed, with a rest at either end.
TRAPEZE = np.clip(np.abs((T % 5.0) - 2.5) - 0.3, 0.2, 2.0)
NOISE = np.random.default_rng(0).normal(size=len(T))
#: Values and their step [rad]; 0 : none is shown.
CHANNELS = {
    "a coarse encoder": (0.01 * np.round(WAVE / 0.01), 0.01),
    "a fine one, as text": (np.round(3.8e-4 * np.round(WAVE / 3.8e-4), 6), 3.8e-4),
    "a coarse one on one way": (0.01 * np.round(RAMP / 0.01), 0.01),
    "a coarse one under noise": (0.01 * np.round((WAVE + 5e-3 * NOISE) / 0.01), 0.01),
    "one way at one speed": (RAMP + 7e-6 * NOISE, 0.0),
    "one way without noise": (RAMP, 0.0),
    "a short one-way motion": (WAVE[200:400] + 1e-5 * NOISE[200:400], 0.0),
    "there and back without noise": (TRAPEZE, 0.0),
    "a period without noise": (np.round(np.sin(2.0 * np.pi * T / 2.5), 7), 0.0),
    "single precision": (WAVE.astype(np.float32).astype(float), 0.0),
    "one value": (np.ones(2000), 0.0),
    "four values": (np.array([0.0, 1.0, 0.0, 1.0]), 0.0),
}


@pytest.mark.parametrize("name", CHANNELS)
def test_a_step_is_one_that_values_repeat(name):
    values, step = CHANNELS[name]
    assert lattice_step(values) == pytest.approx(step, rel=0.02, abs=2e-6)
