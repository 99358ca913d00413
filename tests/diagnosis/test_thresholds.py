"""Thresholds of the search by their consequences, on a clean run: what luck makes is never a finding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import THREE, write_urdf
from scipy import stats
from small_runs import small_run

from sdp_vs_penalty.diagnosis.block_test import (
    BlockSums,
    _exponent,
    above_chance,
    flip_threshold,
    largest_wald,
)
from sdp_vs_penalty.diagnosis.candidates import Candidate
from sdp_vs_penalty.diagnosis.ladder import accepted
from sdp_vs_penalty.diagnosis.rows import diagnosis_rows
from sdp_vs_penalty.diagnosis.stage import prepare
from sdp_vs_penalty.diagnosis.state import SearchState
from sdp_vs_penalty.estimation.identify import identify
from sdp_vs_penalty.problem.load import load_problem

#: Of all clean runs, the share in which a search may claim an effect.
CLEAN_CLAIMS = 0.01


@pytest.fixture(scope="module")
def state(tmp_path_factory: pytest.TempPathFactory) -> SearchState:
    problem = load_problem(write_urdf(tmp_path_factory.mktemp("arm") / "arm.urdf", "arm", THREE))
    run = small_run(problem, seconds=20.0)
    estimate = identify(problem, run, "ols")
    rows = diagnosis_rows(run, estimate, estimate.preprocessing.resolve(run))
    return SearchState.start(prepare(rows, estimate, False, 0))


def candidate(state: SearchState, columns: np.ndarray) -> Candidate:
    """Columns (n M, 1) of joint 1 as a candidate of the search."""
    group = next(g for g in state.stage.white.groups if g.key == ("joint_spring", 0))
    return state.stage.candidates.judged(state.fit, group.key, group.effect, columns)


def on_joint_1(state: SearchState, values: np.ndarray) -> np.ndarray:
    """White columns that act on the first joint alone."""
    columns = np.zeros((len(state.fit.residual), 1))
    columns[: len(values), 0] = values
    return columns


def test_a_clean_run_makes_no_finding_by_luck(state: SearchState) -> None:
    """The smallest chi2 that is accepted, times the number of columns searched: under 1 % of runs."""
    first = len(state.fit.residual) // state.stage.rows.n
    true = candidate(state, on_joint_1(state, np.sin(np.linspace(0.0, 200.0, first))))
    residual = on_joint_1(state, state.fit.residual[:first])
    real = candidate(state, residual)  # explains all of joint 1's error, rows left out included
    assert accepted(state, real, lucky=False) is not None
    low, high = 0.0, real.chi2
    for _ in range(40):
        middle = 0.5 * (low + high)
        believed = accepted(state, replace(real, chi2=middle), lucky=False) is not None
        low, high = (low, middle) if believed else (middle, high)
    assert stats.chi2.sf(high, 1) * state.stage.white.size <= CLEAN_CLAIMS
    assert accepted(state, true, lucky=False) is None


def test_what_predicts_no_rows_left_out_is_no_finding(state: SearchState) -> None:
    """Random columns, however large the chi2 that they are given."""
    rng = np.random.default_rng(0)
    first = len(state.fit.residual) // state.stage.rows.n
    for _ in range(60):
        one = candidate(state, on_joint_1(state, rng.normal(size=first)))
        assert accepted(state, replace(one, chi2=1e6), lucky=False) is None


def test_the_threshold_is_that_of_columns_beside_the_model(state: SearchState) -> None:
    """What luck makes of one effect's columns, found as for the whole library, by the plain way."""
    fit, library, key = state.fit, state.stage.white, ("joint_spring", 0)
    (g,) = [i for i, group in enumerate(library.groups) if group.key == key]
    batch = next(b for b in library.batches if g in b.groups)
    index = batch.columns[list(batch.groups).index(g)]
    assert batch.joint == 0
    columns = np.column_stack([on_joint_1(state, library.joints[0][:, c]) for c in index])
    sums = BlockSums.of(fit, fit.partialled(columns), len(index))
    signs = np.random.default_rng(7).choice([-1.0, 1.0], (200, fit.rows.blocks))
    expected = float(np.quantile(_exponent(largest_wald(sums, signs), len(index)), 0.99))
    assert flip_threshold(fit, library, {key}, 7) == pytest.approx(expected, rel=1e-6)


def test_what_only_forbidden_signs_explain_is_not_plausible(state: SearchState) -> None:
    """It would head the list, and keep all others from being tried."""
    stage, fit = state.stage, state.fit
    place, group = next(
        (g, x) for g, x in enumerate(stage.white.groups) if x.key == ("maxwell_slip", 0) and x.k > 1
    )
    pushing = fit.partialled(fit.scaled(stage.white.columns(group).reshape(len(fit.residual), -1)))
    pushed = replace(fit, residual=-50.0 * pushing[:, 1] / np.linalg.norm(pushing[:, 1]))
    allowed = stage.candidates.judged(
        pushed, group.key, group.effect, stage.white.columns(group).reshape(len(fit.residual), -1)
    )
    assert np.all(allowed.beta >= 0.0)
    assert allowed.chi2 < 500.0  # of 2 500
    coarse = stage.candidates._coarse(pushed, state.scaled)
    assert coarse[place] == pytest.approx(allowed.evidence, rel=0.05, abs=5.0)


def test_chance_decides_early_as_its_whole_distribution_would(state: SearchState) -> None:
    """Exponents on both sides of the threshold, and next to it, whatever may be added."""
    fit, library, stage = state.fit, state.scaled, state.stage
    scores, keys = stage.candidates.scores(fit, library), sorted(state.eligible, key=str)
    for seed, eligible in enumerate([keys, keys[::7], keys[3::11]]):
        threshold = flip_threshold(fit, library, set(eligible), seed)
        for share in (0.3, 0.9, 0.999, 1.001, 1.1, 3.0):
            decided = above_chance(fit, library, scores, set(eligible), seed, share * threshold)
            assert decided == (share > 1.0), (seed, share)
