"""How much torque a finding makes, and how well that is known."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from sdp_vs_penalty.diagnosis.finding import Finding
from sdp_vs_penalty.diagnosis.nuisances import share_of_one_misfit
from sdp_vs_penalty.diagnosis.sizes import torque_made
from sdp_vs_penalty.effects.drift import DriftOffset
from sdp_vs_penalty.effects.motion import Motion
from sdp_vs_penalty.effects.velocity_friction import PowerLawFriction
from sdp_vs_penalty.estimation.sensitivity import free_constants, prior_deviation


@dataclass(frozen=True)
class Unfiltered:
    """Rows that are the samples of a motion."""

    motion: Motion

    @property
    def n(self):
        return self.motion.q.shape[1]

    @property
    def t(self):
        return self.motion.t

    def blocks(self, effect):
        return effect.blocks(self.motion)


@pytest.fixture(scope="module")
def rows():
    t = np.linspace(0.0, 10.0, 1001)
    q = np.column_stack([np.sin(1.3 * t), 0.8 * np.cos(0.7 * t)])
    dq = np.gradient(q, t, axis=0)
    return Unfiltered(Motion(t, q, dq, np.gradient(dq, t, axis=0)))


def test_a_slow_drift_makes_the_torque_by_which_it_drifts(two_link, rows):
    """Its amplitude cancels against the offset, which is another number."""
    drift = DriftOffset(two_link.robot, [0], form=2.0, T=1000.0)
    slope = 0.04  # N m/s
    beta = np.array([-slope * 1000.0])
    covariance = np.zeros((1 + len(free_constants(drift)),) * 2)
    made = torque_made(rows, drift, beta, covariance, frozenset({0}))
    assert made.rms == pytest.approx(slope * 10.0 / np.sqrt(12.0), rel=0.01)
    whole = torque_made(rows, drift, beta, covariance)
    assert whole.rms == pytest.approx(slope * 1000.0, rel=0.01)


def test_the_torque_of_a_power_law_scatters_as_its_draws_do(two_link, rows):
    """Size and exponent err together: a larger exponent goes with a larger size."""
    alpha, size, relative = 1.5, 2.0, 0.1
    law = PowerLawFriction(two_link.robot, [0], alpha=alpha)
    unit = prior_deviation(law, "alpha")
    by_alpha = relative / unit  # of the constant, in units of its prior
    correlated = np.array(
        [
            [(0.2 * size) ** 2, 0.9 * 0.2 * size * by_alpha],
            [0.9 * 0.2 * size * by_alpha, by_alpha**2],
        ]
    )
    made = torque_made(rows, law, np.array([size]), 1e-2 * correlated)
    draws = np.random.default_rng(0).multivariate_normal(
        np.zeros(2), 1e-2 * correlated, 2000
    )
    speed = np.abs(rows.motion.dq[:, 0])
    torques = [
        np.sqrt(np.mean(((size + b) * speed ** (alpha * np.exp(a * unit))) ** 2))
        for b, a in draws
    ]
    of_law = share_of_one_misfit(law) * made.rms**2
    assert made.rms == pytest.approx(np.mean(torques), rel=0.01)
    assert np.sqrt(made.std**2 - of_law) == pytest.approx(np.std(torques), rel=0.06)


@pytest.mark.parametrize(
    ("std", "torque_std", "is_said"),
    [
        (0.3, 0.01, True),  # the size follows the exponent, its torque does not
        (0.3, 0.1, False),  # both are as uncertain
        (0.05, 0.01, False),  # the size is known
        (0.3, None, False),  # findings.json of an older version
        (0.6, 0.01, True),  # the size may be zero, and is not said
    ],
)
def test_the_torque_is_said_where_it_tells_more_than_the_size(std, torque_std, is_said):
    finding = SimpleNamespace(
        size=1.0,
        std=std,
        unit="N*m*(s/rad)^alpha",
        torque_rms=None if torque_std is None else 0.5,
        torque_std=torque_std,
        torque_unit="N m",
    )
    for name in (
        "half_width_95",
        "size_may_be_zero",
        "torque_text",
        "_torque_is_known",
        "_torque_tells_more",
    ):
        setattr(finding, name, vars(Finding)[name].fget(finding))
    text = vars(Finding)["size_text"].fget(finding)
    assert ("0.5 ± 0.02 N m RMS" in text) == is_said
    assert text.startswith("size open") == (std > 0.5)
