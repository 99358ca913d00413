"""Where a motion comes back, and where a joint stands still, as far as positions tell."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from periodic_runs import periodic

from sdp_vs_penalty.effects.bristles import dahl
from sdp_vs_penalty.signals import repeat_period
from sdp_vs_penalty.signals.repetition import recurring
from sdp_vs_penalty.signals.standstill import lawless, still, turned_at_rest

seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seeds, st.floats(4.0, 9.0))
def test_the_period_is_found_between_the_samples(seed, period):
    rng = np.random.default_rng(seed)
    t = np.arange(3.0, 24.0, 0.031)
    q = periodic(rng, t, period) + 1e-4 * rng.normal(size=(len(t), 3))
    assert repeat_period(t, q) == pytest.approx(period, abs=2e-3)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seeds)
def test_motion_without_repetition_has_no_period(seed):
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 0.03)
    q = np.sin(np.outer(t, rng.uniform(0.3, 4.0, 12))) @ rng.normal(size=(12, 3))
    assert repeat_period(t, q + 0.3 * t[:, None]) is None


T = np.arange(0.0, 20.0, 0.03)
FIVE = periodic(np.random.default_rng(0), T, 5.0)
NOISE = np.random.default_rng(1).normal(size=len(T))
SLOW = np.arange(0.0, 300.0, 0.1)
#: name : (instants, positions, period or None)
MOTIONS = {
    "all joints repeat": (T, FIVE, 5.0),
    "one does not, however small its motion": (
        T, np.column_stack([FIVE[:, :2], 0.01 * np.sin(1.1 * T) * T / 20.0]), None,
    ),
    "one only flickers": (T, np.column_stack([FIVE[:, :2], 1e-6 * NOISE]), 5.0),
    "standing still": (T, np.zeros((len(T), 2)), None),
    "too short": (T[T < 2.5], periodic(np.random.default_rng(0), T[T < 2.5], 1.0), None),
    # Neighbouring samples are alike; only a valley of the difference is a repeat.
    "slow": (SLOW, np.sin(2.0 * np.pi * SLOW / 400.0)[:, None], None),
}  # fmt: skip


@pytest.mark.parametrize("name", MOTIONS)
def test_what_has_a_period(name):
    t, q, period = MOTIONS[name]
    assert repeat_period(t, q) == (None if period is None else pytest.approx(period, abs=2e-3))


def test_long_logs_take_no_quadratic_time():
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 3600.0, 0.031)  # an hour of rows
    q = periodic(rng, t, 700.0, 6)
    start = time.process_time()
    period = repeat_period(t, q)
    assert time.process_time() - start < 5.0  # all lags one by one would take minutes
    assert period == pytest.approx(700.0, abs=1e-2)


def test_what_differs_at_one_phase_between_other_instants_too_is_no_event():
    """Five periods of 100 rows: rows 20 to 23 of one period are odd, or others are too."""
    rows = np.arange(400)
    both, phase = np.column_stack([rows, rows + 100]), rows % 100.0
    odd = np.isin(rows, [120, 121, 122, 220, 221, 222])  # differences that hold the third period
    assert not recurring(both, phase, odd, 10).any()
    again = odd | np.isin(rows, [25, 325])
    assert not recurring(both, phase, again, 2)[odd].any()
    assert recurring(both, phase, again, 10)[[25, 120, 220, 325]].all()


RATE = 250.0


def positions(held: float, resolution: float) -> tuple[np.ndarray, np.ndarray]:
    """(N, 1) of a joint that swings to and fro and is held so long [s] at each end; and when it is."""
    t = np.arange(0.0, 20.0, 1.0 / RATE)
    clock, standing, elapsed = np.zeros_like(t), np.zeros(len(t), bool), 0.0
    for k in range(1, len(t)):
        turned = int((clock[k - 1] + 1.0 / RATE) // 1.0) > int(clock[k - 1] // 1.0)
        elapsed = elapsed + 1.0 / RATE if turned or elapsed > 0.0 else 0.0
        standing[k] = 0.0 < elapsed < held
        if not standing[k]:
            elapsed = 0.0
        clock[k] = clock[k - 1] + (0.0 if standing[k] else 1.0 / RATE)
    q = 0.3 * np.cos(np.pi * clock)
    return (resolution * np.round(q / resolution))[:, None], standing


@pytest.mark.parametrize("resolution", [1e-5, 5e-5, 2e-4])
def test_a_smooth_reversal_is_no_standstill_whatever_the_encoder(resolution):
    q, _ = positions(0.0, resolution)
    assert not still(q).any()


@pytest.mark.parametrize("held", [0.06, 0.3, 1.0])
def test_a_joint_that_is_held_stands_still_that_long(held):
    q, standing = positions(held, 2e-5)
    found = still(q)[:, 0]
    assert found[standing].mean() > 0.95
    # Beside it: as long as the encoder shows no motion.
    assert found[~standing].mean() < 0.05


def test_noise_on_positions_is_told_from_motion():
    q, standing = positions(0.3, 1e-9)
    noisy = q + np.random.default_rng(0).normal(0.0, 2e-5, q.shape)
    assert still(noisy)[standing].mean() > 0.9
    smooth = positions(0.0, 1e-9)[0]
    assert not still(smooth + np.random.default_rng(1).normal(0.0, 2e-5, q.shape)).any()


def stopping(rng: np.random.Generator, d: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Friction (M,) of 2 N m beside a rotor, rates (M, 2) and standstill (M,) of a joint that is pushed
    back after each stop: set-valued, or Dahl's over a travel d, of which the push covers 1e-5 rad."""
    friction, rates, share = [], [], []
    for way in (1.0, -1.0) * 6:
        v = way * np.sin(np.linspace(0.0, np.pi, 42)[1:-1])
        a = way * np.cos(np.linspace(0.0, np.pi, 42)[1:-1])
        held = np.linspace(1.0, -1.0 if d is None else 2.0 * np.exp(-1e-5 / d) - 1.0, 20)
        friction += [2.0 * way + 0.7 * v + 3.0 * a, 2.0 * way * held]
        rates += [np.column_stack([v, a]), np.zeros((20, 2))]
        share += [np.zeros(40), np.ones(20)]
    noise = 0.02 * rng.normal(size=720)
    return np.concatenate(friction) + noise, np.concatenate(rates), np.concatenate(share)


@pytest.mark.parametrize(("d", "holds"), [(None, True), (1e-3, False), (5e-5, False), (5e-6, True)])
def test_friction_that_turns_round_at_rest_holds(d, holds):
    friction, rates, share = stopping(np.random.default_rng(0), d)
    rows = [np.arange(300), np.arange(300, 720)]
    assert turned_at_rest(friction, rates, share, rows) is holds
    # In motion alone nothing shows it, whatever the friction does.
    assert not turned_at_rest(friction, rates, np.zeros_like(share), rows)
    # Once is a knock.
    once = np.where(np.arange(720) < 120, share, 0.5)
    assert not turned_at_rest(friction, rates, np.where(np.arange(720) < 60, once, 0.5), rows)


@pytest.mark.parametrize("law", ["dahl", "anything"])
def test_what_a_law_of_friction_says_is_evidence_and_what_none_says_weighs_as_one_row(law):
    """A joint creeps while friction yields, or is held by a torque that no position shows."""
    rng = np.random.default_rng(4)
    t = np.arange(4000) / 100.0
    rests = np.sin(0.4 * np.pi * t) > 0.6
    q = np.cumsum(np.where(rests, 1e-5, 0.5 * np.cos(0.8 * np.pi * t) / 100.0))
    says = dahl(q, 2e-3, 1.0)
    held = np.interp(t, np.arange(0.0, 41.0, 0.7), rng.uniform(-1.0, 1.0, 59))
    friction = says if law == "dahl" else np.where(rests, held, says)
    left = friction + 0.02 * rng.normal(size=len(t))
    laws = np.column_stack([dahl(q, d, 1.0) for d in (1e-3, 2e-3, 4e-3)])
    std, none = lawless(left, laws, rests.astype(float))
    assert none == (law == "anything")
    if none:  # all rests together tell no more than one row of the friction's size
        assert std / np.sqrt(rests.sum()) == pytest.approx(0.6, abs=0.25)
    else:
        assert std < 0.02
