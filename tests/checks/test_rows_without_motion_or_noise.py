"""Rows that are poses, rows that come twice, and torques without noise: each beside what
looks like it."""

from dataclasses import replace

import numpy as np
import pytest
from small_runs import small_run

from sdp_vs_penalty import Measurements, load_problem
from sdp_vs_penalty.api.remedies import State, apply_change
from sdp_vs_penalty.checks.check import judge_facts
from sdp_vs_penalty.checks.facts.noise import shows_noise
from sdp_vs_penalty.checks.facts.repetition import find_overlaps

PROBLEM = load_problem("two_link")
RUN = replace(small_run(PROBLEM, seconds=8.0), dq=None)
RNG = np.random.default_rng(0)


def periodic(noise, friction=1.0):
    """Three periods of a motion, as text with seven digits."""
    t = np.arange(3000) / 200.0
    w = 2.0 * np.pi / 5.0 * np.array([1.0, 2.0])
    q, dq, ddq = 0.8 * np.array(
        [
            np.sin(t[:, None] * w),
            w * np.cos(t[:, None] * w),
            -(w**2) * np.sin(t[:, None] * w),
        ]
    )
    links = 1.2 * PROBLEM.nominal_links.ravel()
    tau = PROBLEM.robot.inverse_dynamics(links, q, dq, ddq)
    tau += friction * np.tanh(dq / 0.05) + noise * RNG.normal(size=q.shape)
    q = q + 1e-3 * noise * RNG.normal(size=q.shape)
    as_text = np.vectorize(lambda x: float(f"{x:.7g}"))
    return Measurements(t, as_text(q), as_text(tau))


def poses(n_rows, seconds):
    q = RNG.uniform(-1.5, 1.5, (n_rows, 2))
    return Measurements(seconds * np.arange(n_rows), q, np.cos(q))


def with_copy(run):
    """400 rows come a second time, in another phase, and the clock is made anew."""
    at = len(run.t) - 200
    rows = np.r_[0:at, 100:500, at : len(run.t)]
    return replace(run.rows(rows), t=np.arange(len(rows)) / 200.0)


#: A run and the facts that are problems of it.
LOGS = {
    "a period without noise": (periodic(0.0), []),
    "a period with noise": (periodic(0.02), []),
    "a copy in it": (with_copy(periodic(0.02)), ["repeated run"]),
    "a copy that jumps, in one period without noise": (
        with_copy(periodic(0.0).rows(slice(0, 1000))),
        ["repeated run"],
    ),
    "no noise and no friction": (periodic(0.0, 0.0), ["torques of a model"]),
    "no friction": (periodic(0.02, 0.0), []),
    "poses": (poses(80, 3.5), ["static poses"]),
    "a few poses a minute apart": (poses(20, 60.0), ["static poses"]),
    "milliseconds": (replace(RUN, t=1e3 * RUN.t), ["time unit"]),
}


@pytest.mark.parametrize("name", LOGS)
def test_what_the_rows_are(name):
    run, kinds = LOGS[name]
    report = judge_facts(PROBLEM, run)
    assert [issue.kind for issue in report.errors_and_warnings] == kinds


@pytest.mark.parametrize(
    ("other", "n_rows"),
    [
        (RUN.rows(slice(0, 700)), 700),
        (replace(RUN.rows(slice(100, 700)), t=RUN.t[:600]), 600),
        (replace(RUN, q=RUN.q + 1e-6 * RNG.normal(size=RUN.q.shape)), 0),
        (RUN.rows(slice(0, 40)), 0),
    ],
)
def test_runs_that_hold_the_same_rows_overlap(other, n_rows):
    """A window, one with a clock of its own, the same motion again, a few rows."""
    said = [(k, x.figures["rows"]) for k, x in find_overlaps([RUN, other])]
    assert said == [(1, n_rows)] * (n_rows > 0)


def test_rows_that_two_runs_hold_are_left_out_of_one():
    is_new = np.arange(len(RUN.t)) >= 700
    noise = 1e-6 * RNG.normal(size=RUN.q.shape)
    other = replace(RUN, q=RUN.q + is_new[:, None] * noise, names=("other.csv",))
    ((_, issue),) = find_overlaps([RUN, other])
    (remedy,) = issue.remedies
    cut = apply_change(remedy.change, State(PROBLEM, (RUN, other)))
    assert len(RUN.t) - 800 < cut.runs[1].samples < len(RUN.t) - 699
    assert not [*find_overlaps(cut.runs)]


@pytest.mark.parametrize("noise", [0.0, 1.0, 10.0])
@pytest.mark.parametrize("step", [1e-6, 1e-3])
def test_noise_is_more_than_rounding_leaves(noise, step):
    t = np.arange(4000) / 200.0
    smooth = np.sin(1.3 * t) + 0.3 * np.sin(3.1 * t)
    x = smooth + noise * step * np.random.default_rng(1).normal(size=len(t))
    assert shows_noise(step * np.round(x / step)) == (noise > 0.0)
    assert not shows_noise(smooth.astype(np.float32).astype(float))
