"""Charts show what the error does, and no beat of it with their bins."""

import numpy as np
import pytest

from sdp_vs_penalty.diagnosis import causes
from sdp_vs_penalty.diagnosis.causes import WAVES
from sdp_vs_penalty.diagnosis.comparison import Signals
from sdp_vs_penalty.render.charts import cause_axis, mean_curve


def test_a_ripple_is_drawn_over_one_of_its_waves():
    """24 bins in a turn hold 36 waves: their means were a slower wave that is none."""
    t = np.linspace(0.0, 20.0, 40_000)
    q = 3.0 * np.sin(t)[:, None]
    ripple = 1.6 * np.sin(36.0 * q)
    signals = Signals(t, q, np.gradient(q, t, axis=0), ripple, np.zeros_like(q))
    axis = cause_axis(signals, 1, WAVES, "rad", waves=36.0)
    centres, means = mean_curve(axis.x, signals.residual[:, 0])
    assert np.ptp(centres) == pytest.approx(2.0 * np.pi / 36.0, rel=0.1)
    assert np.nanmax(means) == pytest.approx(1.6, rel=0.05)


def test_friction_by_load_is_drawn_as_a_straight_line():
    """Over the torque itself its two branches crossed, and their mean showed neither."""
    t = np.linspace(0.0, 20.0, 40_000)
    dq, torque = np.sin(3.1 * t), 100.0 * np.sin(t)
    error = 0.08 * np.abs(torque) * np.sign(dq)
    columns = (np.sin(t), dq, torque + error, torque)
    signals = Signals(t, *(column[:, None] for column in columns))
    axis = cause_axis(signals, 1, causes.LOAD, "rad", torque_unit="A")
    assert axis.label == "load: size of torque [A]"
    centres, means = mean_curve(axis.x, signals.residual[:, 0] * axis.sign)
    assert means == pytest.approx(0.08 * centres)


def test_rows_far_apart_are_one_mean_an_instant():
    """Eleven a second around reversals: each instant was a stretch of several bins, and the
    picture had strokes and no curve."""
    instants = 0.09 * np.arange(-3.5, 4.0)
    x = np.tile(instants, 40) + np.random.default_rng(0).normal(0.0, 1e-9, 320)
    centres, means = mean_curve(x, x**2)
    assert centres == pytest.approx(instants)
    assert means == pytest.approx(instants**2)


def test_a_mean_curve_is_broken_where_no_row_lies():
    """Two stretches of positions, between which the arm was not logged."""
    x = np.concatenate([np.linspace(0.0, 1.0, 500), np.linspace(2.0, 3.0, 500)])
    centres, means = mean_curve(x, 2.0 * x)
    assert np.flatnonzero(np.isnan(centres)).tolist() == [12]
    assert len(centres) == 25
    assert means == pytest.approx(2.0 * centres, nan_ok=True)


@pytest.mark.parametrize(
    ("cause", "x", "label"),
    [
        (causes.POSITION, lambda t: np.sin(t), "position [rad]"),
        (causes.TURN, lambda t: np.sin(t) % (2.0 * np.pi), "angle within a turn [rad]"),
        (causes.VELOCITY, lambda t: np.cos(t), "velocity [rad/s]"),
        (causes.ACCELERATION, lambda t: -np.sin(t), "acceleration [rad/s^2]"),
        (causes.LOAD, lambda t: np.exp(t), "load: size of torque [N m]"),
        (causes.MODELLED_TORQUE, lambda t: np.exp(t), "modelled torque [N m]"),
        (causes.TORQUE_RATE, lambda t: np.exp(t), "rate of the modelled torque"),
        (causes.TORQUE_CURVATURE, lambda t: np.exp(t), "second derivative of the"),
        (causes.TIME, lambda t: t, "time [s]"),
    ],
)
def test_an_error_is_drawn_over_its_cause(cause, x, label):
    """Of q = sin t beside a modelled torque of exp t."""
    t = np.linspace(0.0, 3.0, 3001)
    torque = np.exp(t)[:, None]
    signals = Signals(t, np.sin(t)[:, None], np.cos(t)[:, None], torque, torque)
    axis = cause_axis(signals, 1, cause, "rad")
    inside = slice(2, -2)
    assert axis.x[inside] == pytest.approx(x(t)[inside], abs=1e-4)
    assert axis.label.startswith(label)
