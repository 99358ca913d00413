"""The state filter's cut-off follows the motion, and stops at the noise."""

import numpy as np

from sdp_vs_penalty import Measurements
from sdp_vs_penalty.signals import Preprocessing

NOISE = 3e-6


def _resolved(sticks: bool, noise: float = NOISE) -> Preprocessing:
    """Of a joint that swings, and does not move for 60 ms at its reversals if it sticks."""
    t = np.arange(0.0, 20.0, 0.002)
    phase = 2.0 * np.pi * 0.5 * t
    q = np.sin(phase)
    if sticks:
        q = np.clip(q, -np.cos(0.1), np.cos(0.1))
    rng = np.random.default_rng(1)
    q = q + rng.normal(0.0, noise, len(t))
    torque = np.cos(phase) + rng.normal(0.0, 0.01, len(t))
    return Preprocessing().resolve(Measurements(t, q[:, None], torque[:, None]))


def test_a_joint_that_sticks_moves_more_sharply_than_it_was_told_to():
    smooth, sharp = _resolved(False), _resolved(True)
    assert sharp.state_cutoff is not None
    assert smooth.torque_cutoff == 1.6 * smooth.state_cutoff
    assert sharp.state_cutoff > 2.0 * smooth.state_cutoff
    assert sharp.torque_cutoff == smooth.torque_cutoff


def test_noise_of_the_positions_is_not_let_through_for_it():
    fine, coarse = _resolved(True), _resolved(True, 300.0 * NOISE)
    assert coarse.state_cutoff < fine.state_cutoff
