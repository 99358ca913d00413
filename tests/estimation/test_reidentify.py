"""Identification that goes on: the same answer as from all the data at once, certified each time."""

from __future__ import annotations

import numpy as np
import pytest

from sdp_vs_penalty import InputError, Reidentifier, load_problem
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.simulation.experiment import experiment


def test_it_goes_on_to_the_answer_of_all_the_data_at_once() -> None:
    problem = load_problem("two_link")
    run = experiment(problem).training_run(seed=0)
    end, half = float(run.t[-1]), 0.5 * float(run.t[0] + run.t[-1])
    loop = Reidentifier(problem, run.window(run.t[0], half))
    before = loop.solve()
    later = run.window(half, end)
    for k in range(0, later.samples, 7):
        few = slice(k, k + 7)
        if loop.take(later.t[few], later.q[few], later.tau[few]):
            assert -1e-9 <= loop.solve().gap <= 1e-6
            assert loop.solve() is loop.solve()  # nothing new
    after = loop.solve()
    whole = Reidentifier(problem, run)
    model, settings = problem.model(), problem.preprocessing.resolve(run)
    data = compress(run, model, settings).least_squares()

    # What remains: weights and prior of the first half, and the rows at the joint between the windows.
    # (Not residual_norm^2: of rows whose rank is not full that is not the least that can be left.)
    least = data.loss(np.linalg.lstsq(data.R, data.rho, rcond=None)[0])
    best = whole.solve().theta
    left, was = (np.linalg.norm(data.R @ (theta - best)) for theta in (after.theta, before.theta))
    assert data.loss(after.theta) - least < 0.5 * (data.loss(before.theta) - least)
    assert left < 0.5 * was


def test_old_rows_fade() -> None:
    problem = load_problem("two_link")
    run = experiment(problem).training_run(seed=0)
    loop = Reidentifier(problem, run, half_life=1.0)
    heavier = 1.5 * run.tau
    later = run.t + float(run.t[-1] - run.t[0]) + 1.0
    loop.take(later, run.q, heavier)
    theta, first = loop.solve().theta, Reidentifier(problem, run).solve().theta
    data = compress(run, problem.model(), problem.preprocessing.resolve(run)).least_squares()
    ratio = np.linalg.norm(data.R @ theta) / np.linalg.norm(data.R @ first)
    assert ratio == pytest.approx(1.5, abs=0.05)


def test_standing_still_neither_stops_it_nor_piles_up() -> None:
    """Half a minute between two motions: no rows, no error, nothing kept, nothing forgotten."""
    problem = load_problem("two_link")
    run = experiment(problem).training_run(seed=0)
    loop = Reidentifier(problem, run, half_life=1.0)
    step = float(np.median(np.diff(run.t)))
    end, before, kept = float(run.t[-1]), loop.solve(), []
    for k in range(60):
        t = end + 0.5 * k + np.arange(step, 0.5 + 0.5 * step, step)
        still = np.repeat(run.q[-1:], len(t), axis=0), np.repeat(run.tau[-1:], len(t), axis=0)
        assert not loop.take(t, *still)
        kept.append(sum(len(part[0]) for part in loop._buffer))
    assert max(kept) * step < 2.5 * loop.reach + 1.0
    assert loop.solve() is before
    assert loop.take(run.t + end + 31.0, run.q, run.tau)
    assert loop.solve() is not before


def test_samples_that_cannot_be_used_are_refused() -> None:
    problem = load_problem("two_link")
    run = experiment(problem).training_run(seed=0)
    loop = Reidentifier(problem, run, LmiSdp())
    loop.take(0.0, [0.0, 0.0], [0.0, 0.0])
    for t, q in ((0.0, [0.0, 0.0]), (1.0, [np.nan, 0.0]), (1.0, [0.0, 0.0, 0.0])):
        with pytest.raises(InputError):
            loop.take(t, q, [0.0, 0.0])
    with pytest.raises(InputError, match="half_life"):
        Reidentifier(problem, run, half_life=0.0)
