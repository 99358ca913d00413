"""Motions that shorten a range."""

from dataclasses import replace

import numpy as np
import pytest
from commands import run_cli

from sdp_vs_penalty import Measurements, identify, simulate
from sdp_vs_penalty.data import save
from sdp_vs_penalty.estimation.build_problem import PoseOptions, build_problem
from sdp_vs_penalty.ranges import EndSearch, allowed_set, shortening_runs
from sdp_vs_penalty.ranges.functions import functions_by_name
from sdp_vs_penalty.ranges.shortening import rows_of_motion, with_rows
from sdp_vs_penalty.robot.trajectory import random_trajectory


@pytest.fixture(scope="module")
def short_run():
    return simulate("two_link", seed=1).train[0].window(0.0, 5.0)


@pytest.fixture(scope="module")
def model(short_run):
    return identify("two_link", short_run, check=False)


@pytest.fixture(scope="module")
def allowed(model):
    return allowed_set(model.training.posed, model.theta)


def test_four_times_the_data_halve_what_data_determine(model, allowed):
    """An offset, which consistency hardly shortens."""
    (offset,) = functions_by_name(model.problem, model.model, ["f_o1"])
    once = allowed.ball
    std = np.sqrt(allowed.first_rise) / 1.96
    spread = lambda w: std * np.linalg.norm(w @ once.directions, axis=1)  # noqa: E731
    white = replace(allowed, ball=replace(once, spread=spread))
    four_times = with_rows(white, np.sqrt(3.0) * once.A, allowed.first_rise)
    (before,), (after,) = (
        EndSearch(x).least_and_greatest([offset.g]) for x in (white, four_times)
    )
    lengths = [high.value - low.value for low, high in (before, after)]
    assert lengths[1] == pytest.approx(0.5 * lengths[0], rel=0.03)


def test_the_rows_of_a_motion_are_those_of_its_measurement(model, short_run):
    motion = random_trajectory(model.robot, 3, duration=5.0)
    t = np.arange(0.0, 5.0, float(np.median(np.diff(short_run.t))))
    run = Measurements(t, motion.states(t)[0], np.ones((len(t), 2)))
    posed = model.training.posed
    options = PoseOptions(model.model.effects, preprocessing=posed.runs.settings)
    measured = build_problem(model.problem, run, options)
    rows = rows_of_motion(posed, motion)
    R = measured.regression.least_squares(posed.task.weights).R
    assert np.allclose(rows.T @ rows, R.T @ R, rtol=1e-6, atol=1e-6)


def test_the_first_motion_shortens_most(model):
    runs = shortening_runs(model, "m2", duration=5.0, candidates=4)
    lengths = [run.length for run in runs]
    assert lengths == sorted(lengths)
    assert lengths[0] < 0.99
    for run in runs:
        assert run.before[0] <= run.predicted[0] < run.predicted[1] <= run.before[1]


@pytest.mark.long
def test_excite_writes_the_motion(model, short_run, tmp_path, capsys):
    save(short_run, tmp_path / "run.csv")
    model.save(tmp_path / "m.json")
    files = ("--data", tmp_path / "run.csv", "--out", tmp_path / "motion.csv")
    words = ("excite", tmp_path / "m.json", "--for", "m2", "--duration", "4", *files)
    assert run_cli(*words) == 0
    assert "with this motion measured too" in capsys.readouterr().out
    header = (tmp_path / "motion.csv").read_text().splitlines()[0]
    assert header.startswith("t,q1,q2")
