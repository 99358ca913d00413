"""Constants of several effects on one joint end where they together explain most."""

import numpy as np
import pytest
from random_robots import sines

from sdp_vs_penalty import Measurements
from sdp_vs_penalty.estimation.shape_constants import settled
from sdp_vs_penalty.regression import compress

RIGID = "rigid_body,viscous_friction,torque_offset"
WANTED = [
    ("coulomb_friction", 1, "v_s"),
    ("stribeck_friction", 1, "vs"),
    ("stribeck_friction", 1, "delta"),
]


def texts(width: float, vs: float, delta: float) -> str:
    return f"{RIGID},coulomb_friction:2@v_s={width},stribeck_friction:2@vs={vs}@delta={delta}"


@pytest.mark.parametrize("truth", [(0.025, 0.07, 1.0), (0.025, 0.1, 2.0), (0.004, 0.05, 2.0)])
@pytest.mark.parametrize("start", [(0.01, 0.13, 2.0), (0.02, 0.09, 1.0)])
def test_exact_data_give_exact_constants(two_link, truth, start):
    model = two_link.model(texts(*truth))
    theta = two_link.nominal(model)
    theta[len(model.rigid_indices) :] = 0.5
    motion = sines(np.random.default_rng(5), 2, np.arange(0.0, 10.0, 4e-3), 0.1, 5)
    data = Measurements(motion.t, motion.q, model.torque(theta, motion))
    begin = two_link.model(texts(*start))
    settings = two_link.preprocessing.resolve(data)
    found = settled(begin, WANTED, lambda m: compress(data, m, settings))
    shapes = [effect.shape for effect in found.model.effects[-2:]]
    assert (shapes[0]["v_s"], shapes[1]["vs"]) == pytest.approx(truth[:2], rel=1e-4)
    assert shapes[1]["delta"] == truth[2]
    assert set(found.std) == set(WANTED[:2])
