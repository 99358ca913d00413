"""Two standard deviations are luck, eight are not: what the check calls wrong with a file."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sdp_vs_penalty.check import beyond, channels, rows, zeros
from sdp_vs_penalty.check.evidence import Evidence
from sdp_vs_penalty.check.hypothesis import ENOUGH, Hypothesis, Number
from sdp_vs_penalty.check.signs import time_reversed
from sdp_vs_penalty.data.measurements import Measurements

N = 3


def physics(z: float, inertia: float = 100.0, weight: float = 1.0) -> Any:
    """An arm whose friction seems to drive it, by ``z`` standard deviations."""
    return SimpleNamespace(
        dissipation=(np.full(N, -z), np.ones(N)),
        inertia=np.full(N, inertia / N),
        agreement_with_weight=lambda: weight,
        motion=SimpleNamespace(t=np.arange(100.0)),
        part=lambda _: physics(z, inertia, weight),
    )


@pytest.mark.parametrize(("z", "believed"), [(2.0, False), (8.0, True)])
def test_time_runs_backwards_only_where_noise_cannot_say_so(z: float, believed: bool) -> None:
    moving = np.ones(N, bool)
    assert (time_reversed(physics(z), moving) is not None) == believed
    assert time_reversed(physics(8.0, inertia=2.0, weight=0.1), moving) is None
    assert time_reversed(physics(8.0, inertia=-8.0), moving) is None


@pytest.mark.parametrize("seconds", [0.04, -0.04])
def test_a_delay_of_one_channel_moves_that_channel_only(seconds: float) -> None:
    """Torques of a later row belong to this one's positions."""
    t = np.arange(0.0, 10.0, 1e-3)
    ramp = Measurements(t, np.zeros((len(t), N)), np.tile(t[:, None], (1, N)))
    moved = channels.shifted(ramp, np.eye(N)[1], seconds)
    np.testing.assert_allclose(moved.tau[:, 1] - moved.t, seconds, atol=1e-9)
    np.testing.assert_allclose(moved.tau[:, [0, 2]] - moved.t[:, None], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("gain", "left", "determined"),
    [(1.0, 0.4, False), (1.0, 0.6, True), (5.0, 0.9 * ENOUGH, False), (5.0, 1.1 * ENOUGH, True)],
)
def test_what_friction_explains_as_well_is_no_delay(
    gain: float, left: float, determined: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A number of which other laws leave neither half nor enough is the model's matter."""
    monkeypatch.setattr(beyond, "rival", lambda _: "rival")
    number = SimpleNamespace(determined=lambda _: True, where=lambda p: p)
    given = SimpleNamespace(number=number, gain=lambda p: left if p == "rival" else gain)
    assert Hypothesis.determined(given, "physics") == determined  # type: ignore[arg-type]


def channel(step: float) -> np.ndarray[Any, Any]:
    """A channel of this resolution that passes through zero ten times."""
    t = np.linspace(0.0, 10.0, 4000)
    noise = np.random.default_rng(0).normal(size=len(t))
    return np.asarray(np.round((np.sin(np.pi * t + 0.3) + 0.01 * noise) / step) * step)


@pytest.mark.parametrize("step", [1e-6, 0.02])
def test_zeros_are_filled_in_only_where_the_channel_jumps_to_them(step: float) -> None:
    x, travel = channel(step), np.ones(4000)
    assert not zeros._filled(x, travel).any()
    gone = [1000, 1001, 2150, 2151, 2152, 3400]
    x[gone] = 0.0
    found = np.flatnonzero(zeros._filled(x, travel))
    assert set(gone) <= set(found.tolist())
    assert np.all(x[found] == 0.0)
    assert len(found) <= len(gone) + 1


def test_rows_at_rest_are_left_out_and_slow_joints_are_not() -> None:
    moving = np.column_stack([np.sin(np.arange(300) / 20.0), 1e-3 * np.cos(np.arange(300) / 20.0)])
    moving[100:150] *= 1e-3
    assert rows._sliding(moving).tolist() == [*range(100), *range(150, 300)]


def test_a_gain_is_known_only_where_another_joint_feels_the_same_mass() -> None:
    """Two channels c_1 = g a m, c_2 = b m: coupled; with a parameter each, nothing tells of g."""
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 800, 1))
    for coupled in (True, False):
        first, second = np.hstack([a, 0.0 * a]), np.hstack([b, 0.0 * b] if coupled else [0.0 * b, b])
        channels = np.hstack([1.3 * a, b]) + 0.05 * rng.normal(size=(800, 2))
        arm = _Bare([first, second], channels)
        number = Number(-np.log(1.3), arm.gained)
        assert number.determined(arm) == coupled  # type: ignore[arg-type]


class _Bare:
    """As much of :class:`Physics` as a number needs."""

    def __init__(self, columns: list[Any], channels: Any) -> None:
        self.columns, self.channels = columns, channels
        self.counted = channels
        self.evidence = Evidence.of(columns, channels)

    def gained(self, log: float) -> Any:
        return lambda p: _Bare(p.columns, p.channels * np.array([np.exp(log), 1.0]))
