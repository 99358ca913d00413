"""A sharp corner of the motion is no one-off event; a knock is one."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sdp_vs_penalty.checks.residual import _is_corner
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.rows import RegressionData
from sdp_vs_penalty.simulation import experiment

#: Of a log of 30 s at 10 Hz.
T = np.arange(0.0, 30.0, 0.1)
AT = 12.0


def log_of(scale: float, peak: float) -> Any:
    """A log with noise and a peak of 10 at AT [s]; with the motion low-passed the noise
    has another ``scale``, and the peak another size."""
    noise = np.random.default_rng(0).uniform(-1.0, 1.0, len(T))
    is_peak = np.abs(T - AT) < 0.15
    before = SimpleNamespace(residual=[np.where(is_peak, 10.0, noise)])
    after = SimpleNamespace(residual=[np.where(is_peak, peak, scale * noise)])
    return SimpleNamespace(
        data=SimpleNamespace(motion=SimpleNamespace(t=T)),
        fit=lambda _: before,
        with_low_passed_motion=SimpleNamespace(fit=lambda _: after),
    )


@pytest.mark.parametrize(
    ("scale", "peak", "corner"),
    [
        (0.5, 1.0, True),
        (0.5, 10.0, False),  # a knock stays
        (4.0, 10.0, False),  # it fits worse: it says nothing
    ],
)
def test_a_corner_is_what_a_better_filtered_motion_explains(scale, peak, corner):
    repair: Any = None
    assert _is_corner(log_of(scale, peak), repair, 0, AT) == corner


def test_the_motion_is_low_passed_like_the_torque(two_link):
    """A noisy position makes noise of the acceleration, most of it above the cut-off."""
    run = experiment(two_link).training_run(0)
    settings = two_link.preprocessing.resolve(run)
    log = Likelihood(two_link, RegressionData.of(two_link, run, settings))
    sharp = log.data.motion
    smooth = log.with_low_passed_motion.data.motion
    for name in ("dq", "ddq"):
        values = getattr(sharp, name)
        difference = np.abs(getattr(smooth, name) - values).max(axis=0)
        assert (difference > 0.0).all()
        assert (difference < 0.2 * np.ptp(values, axis=0)).all()
    np.testing.assert_array_equal(smooth.q, sharp.q)
