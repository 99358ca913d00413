"""The width over which friction changes its sign, estimated in all columns that have the
sign."""

from dataclasses import replace

import numpy as np
import pytest
from arms import run_of_widths

import sdp_vs_penalty as sdp

#: Widths that hide an effect are in test_adding.py as well.
pytestmark = pytest.mark.long

#: What the arm has, and what the model says.
WIDTH, WRONG = 0.01, 0.0018
#: Stribeck friction of the first joint: its size [N m] and velocity [rad/s].
SIZE, VELOCITY = 0.9, 0.07
EFFECTS = f"rigid_body,viscous_friction,torque_offset,coulomb_friction@v_s={WRONG}"


@pytest.fixture(scope="module")
def run(scara_arm):
    """A motion of the SCARA with Stribeck friction on its first joint, written out."""
    out = run_of_widths(scara_arm, (WIDTH, WRONG, WRONG, WRONG), 24.0)
    dq = out.dq[:, 0]
    fall = np.exp(-((dq / VELOCITY) ** 2))
    torque = out.tau.copy()
    torque[:, 0] += SIZE * np.tanh(dq / WIDTH) * fall
    return replace(out, tau=torque)


@pytest.fixture(scope="module")
def found(scara_arm, run):
    estimate = sdp.identify(scara_arm, run, "ols", effects=EFFECTS, check=False)
    return sdp.diagnose(estimate, run, run, check=False)


def test_a_wrong_width_of_coulomb_friction_makes_no_sigmoid_beside_stribeck(found):
    (stribeck,) = found.effects
    assert stribeck.text.startswith("stribeck_friction:1@")
    assert abs(stribeck.size - SIZE) < 2.0 * stribeck.std


def test_the_width_is_re_estimated(found):
    (width,) = (r for r in found.retuned if r.joint == 1)
    assert width.after == pytest.approx(WIDTH, rel=0.15)
    assert width.confidence == "confident"
    assert width.rmse_after < width.rmse_before
