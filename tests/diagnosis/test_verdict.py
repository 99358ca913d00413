"""What remains is told from noise: the two tests of the verdict against a calculation of their own."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from sdp_vs_penalty.diagnosis.events import Event
from sdp_vs_penalty.diagnosis.explanations import negligible, turning
from sdp_vs_penalty.diagnosis.show import event_lines
from sdp_vs_penalty.diagnosis.verdict import FALSE_UNKNOWN, remainder
from sdp_vs_penalty.signals.noise import REPETITION, RESIDUAL

RATE, SECONDS, LATE = 20.0, 30.0, 0.9
FLOOR = np.array([0.2, 3.0])


def left(repeating: float, sign: float = 1.0, seed: int = 0) -> tuple[Any, Any, Any]:
    """Fit, rows and noise of two joints and two segments; the second repeats the first a little late.

    repeating : size of what comes back on joint 1, sign : with which sign.
    """
    rng = np.random.default_rng(seed)
    M = int(RATE * SECONDS)
    t = np.arange(M) / RATE
    white = rng.normal(size=(2 * M, 2))
    wave = np.sin(2.0 * np.pi * 0.4 * t)
    white[:M, 0] += repeating * np.interp(t + LATE / RATE, t, wave)
    white[M:, 0] += sign * repeating * wave
    white[5:9] = 0.0  # the past of a filter
    keep = np.ones((2 * M, 2), bool)
    keep[100:120, 1] = False
    Q = np.linalg.qr(rng.normal(size=(4 * M, 7)))[0]
    level = rng.uniform(0.5, 2.0, 2)
    residual = (white / level).T.ravel()
    torque = FLOOR * white
    fit = SimpleNamespace(residual=residual, Q=Q, weighting=SimpleNamespace(level=level), torque=torque)
    segments = [SimpleNamespace(t=t), SimpleNamespace(t=100.0 + t)]
    still, slow, small = np.zeros((2 * M, 2)), np.zeros((2 * M, 2)), 1e-3 * torque
    rows = SimpleNamespace(
        n=2, t=np.tile(t, 2), keep=keep, segments=segments, rate=RATE, still=still, slow=slow
    )
    rows.torque = small
    repeat = SimpleNamespace(rows=np.arange(M), other=1, later=100.0 + t + LATE / RATE)
    noise = SimpleNamespace(
        source=REPETITION,
        degrees=np.array([300.0, 400.0]),
        repeats=[repeat],
        worth=np.ones(keep.shape),
        floor=FLOOR,
    )
    return fit, rows, noise


def expected(fit: Any, rows: Any, noise: Any) -> tuple[np.ndarray, list[float]]:
    """Shares of each joint, and the four p values, one sample at a time."""
    M = len(rows.t) // 2
    shares, p = [], []
    for j in range(2):
        white = fit.residual.reshape(2, -1)[j] * fit.weighting.level[j]
        free = 1.0 - np.sum(fit.Q.reshape(2, 2 * M, -1)[j] ** 2, axis=1)
        used = [k for k in range(2 * M) if rows.keep[k, j] and white[k] != 0.0]
        degrees = sum(free[k] for k in used)
        variance = sum(white[k] ** 2 for k in used) / degrees
        shares.append(variance - 1.0)
        p.append(float(stats.f.sf(variance, degrees, noise.degrees[j])))
        seconds: dict[int, float] = {k: 0.0 for k in range(int(SECONDS))}
        for k in range(M - 1):
            if {k, M + k, M + k + 1} <= set(used):
                seconds[int(k / RATE)] += white[k] * (
                    (1 - LATE) * white[M + k] + LATE * white[M + k + 1]
                )
        s = np.array(list(seconds.values()))
        student = np.sum(s) / np.sqrt(np.sum(s**2))
        student *= np.sqrt((len(s) - 1) / (len(s) - student**2))
        p.append(float(stats.t.sf(student, len(s) - 1)))
    return np.array(shares), p


@pytest.mark.parametrize(
    ("repeating", "sign", "remains"), [(0, 1, False), (1, 1, True), (0.3, -1, False)]
)
def test_what_comes_back_remains(repeating: float, sign: float, remains: bool) -> None:
    """Noise is new each time; an error of the model comes back as it was, not turned round."""
    given = left(repeating, sign)
    found = remainder(*given, given[0].torque)
    shares, p = expected(*given)
    np.testing.assert_allclose(found.share, shares, rtol=1e-9)
    assert found.p == pytest.approx(min(1.0, 4.0 * min(p)), rel=1e-6)
    assert found.remains == remains == (found.p < FALSE_UNKNOWN)
    assert found.joints == ((0,) if remains else ()) == found.matters
    if repeating != 0.3:  # a wave of that amplitude, in N m
        assert found.beyond[0] == pytest.approx(FLOOR[0] * repeating / np.sqrt(2.0), abs=0.05)


def test_what_surely_repeats_may_hardly_matter() -> None:
    """Noise that is loud where the error is not: sure in white values, little in N m."""
    fit, rows, noise = left(1.0)
    found = remainder(fit, rows, noise, 0.1 * fit.torque)
    assert found.remains
    assert found.matters == ()
    assert "on joint 1 hardly matters" in negligible(found)
    assert negligible(remainder(fit, rows, noise, fit.torque)) == ""
    noise.repeats = []  # a window of a recording whose noise is known from all of it
    assert remainder(fit, rows, noise, fit.torque).matters == (0,)


def test_what_friction_holds_at_rest_is_no_evidence() -> None:
    """It comes back with the motion and is no function of it."""
    fit, rows, noise = left(1.0)
    rows.still[:, 0] = 1.0
    found = remainder(fit, rows, noise, fit.torque)
    assert not found.remains
    assert found.beyond[0] == 0.0


def test_what_friction_makes_where_it_turns_round_is_no_headline() -> None:
    """It is said by its size, beside what is left while the joint slides."""
    fit, rows, noise = left(3.0)
    rows.slow[:, 0] = 1.0
    found = remainder(fit, rows, noise, fit.torque)
    assert not found.remains
    assert found.beyond[0] == 0.0
    assert found.slow[0] == pytest.approx(3.0 * FLOOR[0] / np.sqrt(2.0), abs=0.05)
    assert "joint 1" in turning(found)
    rows.slow[:, 0] = 0.0
    assert turning(remainder(fit, rows, noise, fit.torque)) == ""


def test_what_is_little_of_the_torque_hardly_matters() -> None:
    """A link that is 1 mm longer than the model says leaves as much, whatever the noise."""
    fit, rows, noise = left(1.0)
    rows.torque = np.full_like(fit.torque, 250.0 * FLOOR[0])
    found = remainder(fit, rows, noise, fit.torque)
    assert found.remains
    assert found.joints == (0,)
    assert found.matters == ()
    assert "on joint 1 hardly matters" in negligible(found)


def test_events_are_left_out_and_a_guessed_noise_proves_nothing() -> None:
    fit, rows, noise = left(0.0)
    whole = remainder(fit, rows, noise, fit.torque).share
    fit.residual[:20] += 1e3  # of joint 1
    ignore = np.zeros_like(rows.keep)
    ignore[:20, 0] = True
    assert remainder(fit, rows, noise, fit.torque).remains
    np.testing.assert_allclose(remainder(fit, rows, noise, fit.torque, ignore).share, whole, atol=0.1)
    noise.source = RESIDUAL
    assert remainder(fit, rows, noise, fit.torque).p == 1.0
    rows.keep[:] = False
    np.testing.assert_array_equal(remainder(fit, rows, noise, fit.torque).share, [-1.0, -1.0])


def test_many_events_are_one_line() -> None:
    """The findings stay in sight; every event is still listed where it is asked for."""
    events = [Event(k % 2, float(k), k + 0.5, "hum", 12.0) for k in range(4)]
    (line,) = event_lines(events)
    assert line == "4 events on joints 1 and 2, 0.00 s to 3.50 s, 4 of them a hum"
    assert len(event_lines(events, every=True)) == 4
    assert event_lines(events[:1]) == ["a hum of 12 Hz on joint 1: 0.00 s to 0.50 s"]
