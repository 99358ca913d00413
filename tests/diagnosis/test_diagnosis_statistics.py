"""The diagnosis's linear algebra and tests against brute force and against their own promises."""

from __future__ import annotations

import numpy as np
import pytest
from challenge.judge import wilson
from numpy.typing import NDArray
from scipy import signal

from sdp_vs_penalty.diagnosis.block_test import (
    BlockSums,
    flip_threshold,
    largest_wald,
    wald,
    wald_exponent,
)
from sdp_vs_penalty.diagnosis.coloured import Coloured
from sdp_vs_penalty.diagnosis.events import spectral_lines
from sdp_vs_penalty.diagnosis.fit import RowLabels, Weighting, WhiteFit, orthonormal
from sdp_vs_penalty.diagnosis.library import Batch, Group, Library, grams
from sdp_vs_penalty.diagnosis.scoring import cross_validate, evidence, solve_group
from sdp_vs_penalty.effects import parse_effects
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.signals.autoregression import autoregression, beside
from sdp_vs_penalty.signals.outliers import local_excess, lone_windows, noise_profile

Array = NDArray[np.float64]


def problem(
    rng: np.random.Generator, n: int = 2, M: int = 240, p: int = 5, blocks: int = 24
) -> tuple[RowLabels, Array, Array, Weighting]:
    block = np.arange(M) * blocks // M
    rows = RowLabels(n, block, block * 3 // blocks, np.full(n, float(M)))
    A = rng.normal(size=(n * M, p))
    y = A @ rng.normal(size=p) + rng.normal(size=n * M)
    pieces = tuple((np.arange(M),) for _ in range(n))
    return rows, A, y, Weighting(np.ones(n), np.zeros((n, 4)), pieces)


def fitted(rows: RowLabels, basis: Array, target: Array, weighting: Weighting) -> WhiteFit:
    return Coloured.of(basis, target, weighting).fit(rows, weighting)


def squared_residual(A: Array, y: Array) -> float:
    return float(np.sum((y - A @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2))


def test_partialled_chi2_is_the_drop_of_the_squared_residual() -> None:
    rng = np.random.default_rng(0)
    rows, A, y, weighting = problem(rng)
    fit = fitted(rows, orthonormal(A), y, weighting)
    for k in (1, 2, 4):
        Z = rng.normal(size=(len(y), k))
        C = fit.Q.T @ Z
        chi2, beta, _ = solve_group(Z.T @ Z - C.T @ C, np.sum(Z**2, axis=0), Z.T @ fit.residual, False)
        both = np.column_stack([A, Z])
        assert chi2 == pytest.approx(squared_residual(A, y) - squared_residual(both, y), rel=1e-9)
        np.testing.assert_allclose(beta, np.linalg.lstsq(both, y, rcond=None)[0][-k:], rtol=1e-8)
        extended = fit.extended(Z)
        assert np.sum(extended.residual**2) == pytest.approx(squared_residual(both, y), rel=1e-10)


def test_signs_and_absorbed_columns() -> None:
    rng = np.random.default_rng(1)
    rows, A, y, weighting = problem(rng)
    fit = fitted(rows, orthonormal(A), y, weighting)
    z = A @ rng.normal(size=(A.shape[1], 1))
    C = fit.Q.T @ z
    chi2, beta, absorbed = solve_group(
        z.T @ z - C.T @ C, np.sum(z**2, axis=0), z.T @ fit.residual, False
    )
    assert chi2 == 0.0
    assert beta[0] == 0.0
    assert absorbed == pytest.approx(1.0)
    z = -fit.residual[:, None]
    C = fit.Q.T @ z
    chi2, beta, _ = solve_group(z.T @ z - C.T @ C, np.sum(z**2, axis=0), z.T @ fit.residual, True)
    assert chi2 == 0.0
    assert beta[0] == 0.0


def test_columns_without_energy_leave_the_others_alone() -> None:
    """What is known beforehand holds a coefficient that no row shows (a vertical axis's height)."""
    rng = np.random.default_rng(4)
    z = rng.normal(size=(200, 4)) * [1.0, 1.0, 1.0, 1e-16]
    r, known = z @ np.array([1.0, -2.0, 0.5, 0.0]), np.full(4, 10.0)
    gram, raw, right = z.T @ z, np.sum(z**2, axis=0), z.T @ r
    chi2, beta, _ = solve_group(gram, raw, right, False, known)
    shown = solve_group(gram[:3, :3], raw[:3], right[:3], False, known[:3])
    assert chi2 == pytest.approx(shown[0], rel=1e-9)
    assert chi2 == pytest.approx(r @ r, rel=1e-3)
    np.testing.assert_allclose(beta, [*shown[1], 0.0], atol=1e-9)


def test_cross_validation_is_refitting_without_each_fold(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sdp_vs_penalty.diagnosis.fit.HELD", 0.0)
    rng = np.random.default_rng(2)
    rows, A, y, weighting = problem(rng)
    z = rng.normal(size=(len(y), 1))
    y = y + 0.3 * z[:, 0]
    fit = fitted(rows, orthonormal(A), y, weighting)
    got = cross_validate(fit, [z], False, rows.fold)
    fold = np.tile(rows.fold, rows.n)
    gain = np.zeros(len(y))
    both = np.column_stack([A, z])
    for f in range(3):
        out = fold == f
        plain = np.linalg.lstsq(A[~out], y[~out], rcond=None)[0]
        more = np.linalg.lstsq(both[~out], y[~out], rcond=None)[0]
        gain[out] = (y[out] - A[out] @ plain) ** 2 - (y[out] - both[out] @ more) ** 2
    np.testing.assert_allclose(got, rows.block_sums(gain), rtol=1e-7, atol=1e-8)
    assert got.sum() > 0.0


def test_cross_validation_does_not_reward_noise() -> None:
    gains = []
    for seed in range(40):
        rng = np.random.default_rng(100 + seed)
        rows, A, y, weighting = problem(rng)
        fit = fitted(rows, orthonormal(A), y, weighting)
        gains.append(cross_validate(fit, [rng.normal(size=(len(y), 2))], False, rows.fold).sum())
    assert np.mean(gains) < 0.0


def test_the_block_robust_test_keeps_its_level() -> None:
    """Noise whose level differs from block to block: a false alarm at p < 1e-2 in about one in 100."""
    alarms = 0
    for seed in range(400):
        rng = np.random.default_rng(1000 + seed)
        rows, A, _, weighting = problem(rng, M=480, blocks=48)
        level = rng.uniform(0.2, 1.5, rows.blocks)[np.tile(rows.block, rows.n)]
        fit = fitted(rows, orthonormal(A), level * rng.normal(size=len(level)), weighting)
        z = level[:, None] * rng.normal(size=(len(level), 1))
        exponent = wald_exponent(BlockSums.of(fit, fit.partialled(z), 1))[0]
        alarms += exponent > 2.0
    assert alarms <= 12


def test_the_block_robust_test_sees_an_effect_in_few_blocks() -> None:
    rng = np.random.default_rng(5)
    rows, A, y, weighting = problem(rng, M=480, blocks=48)
    z = np.where(np.tile(rows.block, rows.n) % 6 == 0, 1.0, 0.0)[:, None]
    fit = fitted(rows, orthonormal(A), y + 1.0 * z[:, 0], weighting)
    assert wald_exponent(BlockSums.of(fit, fit.partialled(z), 1))[0] > 6.0
    two = np.column_stack([z, rng.normal(size=len(y))])
    assert wald_exponent(BlockSums.of(fit, fit.partialled(two), 2))[0] > 5.0


@pytest.mark.parametrize("k", [1, 2, 3])
def test_random_signs_are_the_same_test_block_by_block(k: int) -> None:
    """The sums that make 200 draws cheap against flipping the scores of every draw."""
    rng = np.random.default_rng(11)
    rows, A, y, weighting = problem(rng, M=480, blocks=48)
    fit = fitted(rows, orthonormal(A), y, weighting)
    sums = BlockSums.of(fit, fit.partialled(rng.normal(size=(len(y), 5 * k))), k)
    signs = rng.choice([-1.0, 1.0], (20, rows.blocks))
    each = [wald(BlockSums(sums.scores * s[None, :, None], sums.grams)).max() for s in signs]
    np.testing.assert_allclose(largest_wald(sums, signs), each, rtol=1e-7)


def test_what_cannot_be_added_hides_nothing(two_link: Problem) -> None:
    """A finer law that resembles one stretch of the error does so whatever the stretches' signs: where
    it may not be added, what can be is held against its own chance only."""
    rng = np.random.default_rng(12)
    rows, A, y, weighting = problem(rng, M=480, blocks=24)
    stretch = np.where(np.arange(480) // 20 == 7, 10.0 * rng.normal(size=480), 0.0)
    fit = fitted(rows, orthonormal(A), y + np.r_[stretch, np.zeros(480)], weighting)
    effects = parse_effects("coulomb_friction:1,maxwell_slip:1", two_link.robot)
    names = [e.name for e in effects]
    groups = [Group((e.name, 0), e, 0, slice(i, i + 1)) for i, e in enumerate(effects)]
    batch = Batch(0, True, np.arange(2), np.arange(2)[:, None])
    joints = (np.column_stack([rng.normal(size=480), stretch]), np.zeros((480, 0)))
    library = Library(tuple(groups), joints, (2, 0), (batch,))
    plain, both = (
        flip_threshold(fit, library, {(name, 0) for name in names[:count]}, 0) for count in (1, 2)
    )
    assert plain < 5.0
    assert both > 2.0 * plain


def test_evidence_prefers_fewer_columns_and_needs_more_than_chance() -> None:
    assert evidence(0.5, 1) == 0.0
    assert evidence(50.0, 1) > evidence(50.0, 2) > evidence(50.0, 6) > 0.0
    assert evidence(200.0, 6) > evidence(100.0, 1)


def test_the_likelihood_gain_is_chi2_near_the_noise_and_a_log_ratio_far_above() -> None:
    rng = np.random.default_rng(6)
    rows, A, y, weighting = problem(rng, n=1, M=2000)
    quiet = fitted(rows, orthonormal(A), 0.9 * y, weighting)
    assert quiet.likelihood_gain(quiet.joint_chi2 - 10.0) == pytest.approx(10.0, rel=1e-6)
    loud = fitted(rows, orthonormal(A), 30.0 * y, weighting)
    expected = loud.degrees[0] * np.log(4.0)
    assert loud.likelihood_gain(loud.joint_chi2 / 4.0) == pytest.approx(expected, rel=1e-6)


def test_autoregression_whitens() -> None:
    rng = np.random.default_rng(7)
    x = np.zeros(4000)
    for k in range(2, len(x)):
        x[k] = 0.6 * x[k - 1] - 0.3 * x[k - 2] + rng.normal()
    a, sigma, degrees = autoregression(x, [np.arange(2000), np.arange(2000, 4000)])
    np.testing.assert_allclose(a, [0.6, -0.3, 0.0, 0.0], atol=0.06)
    assert sigma == pytest.approx(1.0, abs=0.04)
    assert degrees == 3988.0


def test_slow_columns_do_not_take_the_slow_noise_with_them() -> None:
    """The noise found beside nine slow columns is the noise itself, in the mean of 60 draws."""
    rng = np.random.default_rng(12)
    pieces = [np.arange(k * 100, (k + 1) * 100) for k in range(3)]
    t = np.tile(np.arange(100.0), 3)
    slow = np.column_stack([np.cos(np.pi * k * (t + 0.5) / 100) for k in range(9)])
    Q = np.linalg.qr(slow)[0]
    gains, plain, sizes, floors = [], [], [], []
    for _ in range(60):
        x = np.concatenate(
            [signal.lfilter([1.0], [1.0, -0.4], rng.normal(size=150))[50:] for _ in pieces]
        )
        rest = x - Q @ (Q.T @ x)
        floor, a, sigma, rank = beside(rest, pieces, slow)
        gains.append(1.0 - a.sum())
        plain.append(1.0 - autoregression(rest, pieces)[0].sum())
        sizes.append(sigma**2)
        floors.append(floor**2)
    assert rank == 9
    assert np.mean(plain) > 0.66
    assert np.mean(gains) == pytest.approx(0.6, abs=0.03)
    assert np.mean(sizes) == pytest.approx(1.0, abs=0.04)
    assert np.mean(floors) == pytest.approx(1.0 / (1.0 - 0.4**2), abs=0.06)


def test_events_are_found_and_noise_is_left_alone() -> None:
    rng = np.random.default_rng(8)
    pieces = [np.arange(500), np.arange(500, 1000)]
    false = sum(local_excess(rng.normal(size=1000), pieces, 1, 1000.0).any() for _ in range(200))
    assert false <= 3
    x = rng.normal(size=1000)
    x[700:708] += 4.0
    found = local_excess(x, pieces, 1, 1000.0)
    assert found[700:708].mean() > 0.7
    assert found[:650].sum() == found[760:].sum() == 0


def test_noise_that_follows_a_rate_is_no_event() -> None:
    rng = np.random.default_rng(9)
    t = np.arange(1000) / 16.0
    rates = np.column_stack([np.sin(0.5 * t), np.cos(0.3 * t)]) ** 2
    spread = np.sqrt(0.3 + 3.0 * rates[:, 0])
    profile = noise_profile(spread * rng.normal(size=1000), rates, rates)
    assert np.corrcoef(profile, spread)[0, 1] > 0.9
    assert np.mean(profile**2) == pytest.approx(1.0)
    faster = noise_profile(spread * rng.normal(size=1000), rates, 2.0 * rates)
    assert 1.6 < np.mean(faster**2) < 2.0


def test_a_hum_is_a_line_and_noise_is_not() -> None:
    rng = np.random.default_rng(10)
    t = np.arange(330) / 16.5
    runs = [rng.normal(size=330) + 0.8 * np.sin(2 * np.pi * 3.1 * (t + 7 * k)) for k in range(3)]
    assert [round(f, 1) for f in spectral_lines(runs, 16.5, 7)] == [3.1]
    false = sum(bool(spectral_lines(list(rng.normal(size=(3, 330))), 16.5, 7)) for _ in range(200))
    assert false <= 3


def test_wilson_interval() -> None:
    low, high = wilson(297, 300)
    assert low == pytest.approx(0.9710, abs=5e-4)
    assert high == pytest.approx(0.9966, abs=5e-4)
    assert wilson(0, 0) == (0.0, 1.0)


def test_a_group_of_columns_does_not_depend_on_their_units() -> None:
    rng = np.random.default_rng(0)
    Z, r = rng.normal(size=(200, 3)), rng.normal(size=200)
    expected = np.linalg.lstsq(Z, r, rcond=None)[0]
    for units in (np.ones(3), np.array([1e-9, 1.0, 1e9])):
        scaled = Z * units
        gram = scaled.T @ scaled
        chi2, beta, absorbed = solve_group(gram, np.diagonal(gram), scaled.T @ r, False)
        np.testing.assert_allclose(beta * units, expected, rtol=1e-6)
        assert chi2 == pytest.approx(np.sum((Z @ expected) ** 2), rel=1e-6)
        assert absorbed == 0.0


def test_the_block_robust_test_does_not_depend_on_units() -> None:
    rng = np.random.default_rng(5)
    rows, A, y, weighting = problem(rng)
    fit = fitted(rows, orthonormal(A), y, weighting)
    Z = fit.partialled(rng.normal(size=(len(y), 2)))
    expected = wald(BlockSums.of(fit, Z, 2))
    for unit in (1e-6, 1e6):
        np.testing.assert_allclose(wald(BlockSums.of(fit, unit * Z, 2)), expected, rtol=1e-6)


@pytest.mark.parametrize("columns", [[[0], [3]], [[0, 1], [4, 2]], [[5, 1, 2]]])
def test_groups_of_any_size_are_partialled(columns: list[list[int]]) -> None:
    rng = np.random.default_rng(0)
    Q = np.linalg.qr(rng.normal(size=(40, 3)))[0]
    Z = rng.normal(size=(40, 6))
    rest = Z - Q @ (Q.T @ Z)
    wanted = [rest[:, c].T @ rest[:, c] for c in columns]
    every = np.ravel(columns)
    found = grams(Z[:, every], len(columns)) - grams(Q.T @ Z[:, every], len(columns))
    np.testing.assert_allclose(found, wanted)


def test_a_window_is_an_event_beside_a_models_error_only_if_no_like_motion_comes_near() -> None:
    rng, M = np.random.default_rng(5), 1800
    pieces, even = [np.arange(900), np.arange(900, M)], np.ones(M)
    slow = np.arange(M) % 120 < 30

    def found(white: Array, jerk: Array = even) -> Array:
        return lone_windows(white, pieces, slow, jerk, 30.0, 7)

    # Error that swells at reversals, with tails.
    error = rng.normal(size=M) * np.where(slow, 6.0, 1.0) * np.exp(rng.normal(0.0, 0.3, M))
    assert not found(error).any()
    knock = error.copy()
    knock[700:704] += 60.0
    where = np.flatnonzero(found(knock))
    assert where.min() > 660
    assert where.max() < 740
    assert np.isin([700, 701, 702, 703], where).all()
    assert not found(rng.standard_t(2, size=M)).any()
    sharp = even.copy()
    sharp[690:710] = 3.0  # a motion like no other
    assert not found(knock, sharp).any()
