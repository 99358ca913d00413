"""The shootout: wrong answers are planted and must be found; of its runs none is lost."""

import csv
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas
import pytest
from commands import run_cli
from committed import as_kept
from recorded import refusal

from sdp_vs_penalty.robot import Constraint
from sdp_vs_penalty.shootout import (
    Answer,
    Chart,
    Instance,
    Reference,
    classified,
    everything,
    instance,
    reference,
    relative_violation,
    runner,
    summary,
)
from sdp_vs_penalty.shootout.catalogue import catalogue
from sdp_vs_penalty.shootout.contestants import contestants
from sdp_vs_penalty.shootout.judge import CLASSES, judge
from sdp_vs_penalty.solvers import solver

CONTESTANTS = contestants()
SMALL = (
    "two_link simulated one-step gyration",
    "two_link simulated two-step gyration",
    "chain of 2 links gyration 0",
)


@pytest.fixture(scope="module")
def two_link() -> Instance:
    return instance(SMALL[0])


@pytest.fixture(scope="module")
def proved(two_link: Instance) -> Reference:
    return reference(two_link)


@pytest.fixture(scope="module")
def best(two_link: Instance) -> Answer:
    return CONTESTANTS["lmi-sdp"].solve(two_link, 1e-8)


@pytest.mark.nightly
def test_instances_are_what_they_were():
    """Their hashes are of problems to six digits: of the 2R and of arms of two links
    every one."""
    said = []
    own = catalogue()
    for e in everything():
        if e.name.startswith(("two_link", "chain of 2 ")):
            where = (
                "library"[: 7 * bool(e.sentence)],
                "catalogue"[: 9 * (e.name in own)],
            )
            said.append(
                f"{e.folder}: {e.make().hash} {where} {e.quick} {e.measured};"
                f" {e.sentence}"
            )
    as_kept("instances.txt", "\n".join(said) + "\n")
    assert len({line.split()[1] for line in said}) == len(said)


def test_a_short_part_is_of_so_many_seconds_of_rows_however_far_the_filters_reach():
    one = instance(f"panda simulated {1} s one-step plain").data.rows
    three = instance(f"panda simulated {3} s one-step plain").data.rows
    assert 3 * one == pytest.approx(three, rel=0.03)


@pytest.mark.parametrize("name", ["panda infeasible 1e-3", "panda infeasible 1e-6"])
def test_infeasible_instances_are_proved_infeasible(name):
    made = instance(name)
    assert made.interior is None
    known = reference(made)
    assert known.verdict == "infeasible"
    nothing = np.zeros(len(made.task.bound))
    says = Answer(nothing, "infeasible", "")
    assert judge(made, known, says, 1e-6).kind == "right"
    assert (
        judge(made, known, replace(says, claims="optimal"), 1e-6).kind
        == "silently_wrong"
    )
    assert (
        judge(made, known, replace(says, claims="unbounded"), 1e-6).kind
        == "silently_wrong"
    )


def test_planted_wrong_answers_are_found(two_link, proved, best):
    inside = two_link.interior
    optimal = replace(best, claims="optimal", multipliers=None)
    suboptimal = replace(optimal, theta=best.theta + 1e-3 * (inside - best.theta))
    outside = replace(optimal, theta=best.theta + 0.2 * (best.theta - inside))
    nan = replace(optimal, theta=np.full_like(best.theta, np.nan))
    for wrong in (suboptimal, outside, nan, replace(best, claims="infeasible")):
        verdict = judge(two_link, proved, wrong, 1e-8)
        assert verdict.kind == "silently_wrong"
        assert verdict.remark
    # Half of the digits that were asked for are inaccurate, whoever returns them.
    near = replace(optimal, theta=best.theta + 1e-5 * (inside - best.theta))
    verdict = judge(two_link, proved, near, 1e-8)
    assert 1e-7 < verdict.objective_error < 1e-4
    assert verdict.kind == "inaccurate"
    assert judge(two_link, proved, suboptimal, 1e-8).violation == 0.0
    assert judge(two_link, proved, suboptimal, 1e-8).objective_error > 1e-7
    # The same points are no lie where the solver admits them, or was asked for less.
    assert (
        judge(two_link, proved, replace(suboptimal, claims="inaccurate"), 1e-8).kind
        == "inaccurate"
    )
    assert (
        judge(two_link, proved, replace(suboptimal, claims="failed"), 1e-8).kind
        == "failed"
    )
    assert judge(two_link, proved, suboptimal, 0.5).kind == "right"
    wide = judge(two_link, replace(proved, lower=0.0), optimal, 1e-8)
    assert wide.kind == "inaccurate"
    assert "interval" in wide.remark


def test_a_chart_of_links_begins_inside_and_knows_its_slope():
    """By central differences, of every variable."""
    made = instance("two_link simulated one-step cones")
    inside = made.interior
    rng = np.random.default_rng(0)
    chart = Chart(made.sent, inside)
    np.testing.assert_allclose(
        chart.theta(chart.start)[0], inside, rtol=1e-9, atol=1e-12
    )
    x = chart.start + 0.3 * rng.normal(size=len(inside))
    gradient = rng.normal(size=len(inside))
    steps = 1e-6 * np.eye(len(x))
    moved = [
        (chart.theta(x + s)[0] - chart.theta(x - s)[0]) @ gradient / 2e-6 for s in steps
    ]
    np.testing.assert_allclose(
        chart.slope(chart.theta(x)[1], gradient), moved, rtol=1e-6, atol=1e-8
    )


@pytest.mark.parametrize("name", list(CONTESTANTS))
@pytest.mark.parametrize(
    "problem",
    [SMALL[0], *(pytest.param(name, marks=pytest.mark.long) for name in SMALL[1:])],
)
def test_every_contestant_on_every_small_instance(name, problem):
    contestant = CONTESTANTS[name]
    if contestant.absent:
        pytest.skip(contestant.absent)
    made = instance(problem)
    assert contestant.refuses(made) is None
    if name == "cvxpy" and problem.startswith("chain"):
        pytest.skip("100 000 iterations of SCS; the shootout shows how they end")
    answer = contestant.solve(made, 1e-6)
    verdict = judge(made, reference(made), answer, 1e-6)
    assert verdict.kind in CLASSES
    assert answer.status
    # Whatever is claimed, our bounds hold: no multipliers prove more than the proved
    # optimum.
    assert verdict.own_gap >= -1e-12
    # A chart has minima of its own: on the chain it ends in one, .15 above the optimum.
    assert (
        not name.startswith("log-cholesky")
        or problem.startswith("chain")
        or verdict.kind == "right"
    )
    if name in ("lmi-sdp", "clarabel", "penalty", "csdp", "sdpa"):
        # Where the optimum is 0 no multipliers lie inside of the cones; whether SDPA
        # then ends early, and says so, depends on the processor's BLAS (with two of
        # seven kernels of OpenBLAS).
        admits = (
            name == "sdpa"
            and reference(made).upper < 1e-20
            and answer.claims == "inaccurate"
        )
        assert verdict.kind == "right" or admits


def test_the_forms_users_write_have_the_same_optimum(two_link):
    known = reference(two_link)
    for formulation in ("residual", "gram", "rows"):
        posed = replace(two_link, formulation=formulation)
        ours = formulation == "residual"  # users send redundant constraints, too
        assert (len(posed.sent) < len(posed.constraints.convex)) is ours
        answer = CONTESTANTS["clarabel"].solve(posed, 1e-9)
        verdict = judge(posed, known, answer, 1e-3)
        assert verdict.kind == "right"
        assert verdict.own_gap <= 0.01
        sdp = posed.sdp  # what the file says of its optimum is the loss there
        solution = solver("clarabel").solve(sdp.conic, 1e-9)
        # the upper triangle
        x = solution.x
        P = sdp.conic.P
        square = x @ (P @ x) - 0.5 * x @ (P.diagonal() * x)
        optimum = sdp.offset + sdp.loss_scale**2 * (square + sdp.conic.q @ x)
        assert optimum == pytest.approx(
            posed.objective.value(sdp.theta(solution)), rel=1e-5
        )
    single = replace(two_link, formulation="gram in float32")
    difference = abs(
        single.sdp.conic.P - replace(two_link, formulation="gram").sdp.conic.P
    ).max()
    assert difference > 0.0


def test_violations_are_in_units_of_their_own_cones():
    """Rows: the largest term that they can hold; a cone: its largest row; a matrix: its
    diagonal."""
    x = np.array([3.0, 0.0])
    inside = np.zeros(2)
    bound = np.array([10.0, 10.0])
    rows = Constraint(
        "a", "", "nonnegative", [0], np.array([1.0, 40.0]), np.array([[-1.0, -20.0]])
    )
    assert relative_violation([rows], x, inside, bound) == pytest.approx(
        2.0 / 10.0
    )  # and 20 of 200
    cone = Constraint("a", "", "soc", [0], np.array([1.0, 0.0]), np.array([[0.0, 2.0]]))
    assert relative_violation([cone], x, inside, bound) == pytest.approx(5.0 / 20.0)
    matrix = Constraint(
        "a", "", "psd", [0], np.diag([4.0, 9.0]), np.diag([-2.0, 0.0])[None]
    )
    assert relative_violation([matrix], x, inside, bound) == pytest.approx(2.0 / 4.0)
    assert relative_violation([rows, cone, matrix], np.zeros(2), inside, bound) == 0.0


def _spin() -> bytes:
    while True:
        pass


@pytest.mark.parametrize(
    ("work", "limit", "kind", "said"),
    [
        (lambda: b"x" * 200_000, 20.0, "ended", "^x{200000}$"),
        (_spin, 0.2, "timeout", "processor|stopped"),
        (
            lambda: os.kill(os.getpid(), signal.SIGKILL),
            20.0,
            "crash",
            "^ended by signal 9$",
        ),
        (
            lambda: bytes(np.ones(int(1e10))),
            20.0,
            "crash",
            "^asked for more than 1 GB$",
        ),
        (lambda: int("odd"), 20.0, "failed", "^ValueError: invalid literal"),
    ],
    ids=["ends", "spins", "dies", "eats", "raises"],
)
def test_a_run_ends_in_its_own_process(work, limit, kind, said):
    found, words, seconds = runner.in_child(work, limit, 1.0)
    assert found == kind
    assert re.search(said, words.decode() if isinstance(words, bytes) else words)
    assert seconds < 5.0


def test_a_run_that_sleeps_is_stopped_by_the_clock(monkeypatch):
    monkeypatch.setattr(runner, "CLOCK_AT_LEAST", 0.5)
    kind, _, seconds = runner.in_child(lambda: time.sleep(30), limit=0.1, memory=1.0)
    assert kind == "timeout"
    assert seconds < 5.0


def test_a_run_that_spins_is_stopped_at_its_processor_time():
    before = _seconds_of_children()
    kind, *_ = runner.in_child(_spin, limit=0.2, memory=1.0)
    assert kind == "timeout"
    assert _seconds_of_children() - before < 0.6  # limits of the system: whole seconds


def _seconds_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_seconds_are_processor_time(two_link, proved, best):
    """Of two contestants that take a quarter of a second, one sleeps and the other's program
    computes."""
    busy = "import time\nwhile time.process_time() < 0.25: pass"

    def seconds(wait: Callable[[], object]) -> float:
        def solve(made: Instance, accuracy: float) -> Answer:
            wait()
            return best

        task = runner.Assignment("", "", 20.0, 1.0, reference=proved)
        row = runner.run_one(
            task, replace(CONTESTANTS["lmi-sdp"], solve=solve), two_link, 1e-6
        )
        assert row["class"] == "right"
        return row["seconds"]

    assert seconds(lambda: time.sleep(0.25)) < 0.1
    assert (
        0.25
        <= seconds(lambda: subprocess.run([sys.executable, "-c", busy], check=True))
        < 2.0
    )


def _run(problem: str, solver: str, **changes: object) -> dict[str, object]:
    row: dict[str, object] = {
        "problem": problem,
        "group": "panda",
        "solver": solver,
        "settings": "1e-06",
        "accuracy": 1e-6,
        "claimed": "optimal",
        "class": "right",
        "objective_error": 1e-6,
        "violation": 0.0,
        "lower": 1.0,
        "upper": 1.0,
        "attempts": 1,
        "seconds": 0.1,
        "hash": "h",
        "own_gap": np.inf,
        "version": "1",
        "machine": "m",
    }
    return row | changes


def test_summary_of_known_runs(tmp_path):
    liar = {"class": "silently_wrong", "seconds": 0.01}
    rows = pandas.DataFrame(
        [
            _run("a", "good"),
            _run("b", "good", seconds=0.4),
            _run("a", "fast", seconds=0.05),
            _run(
                "b", "fast", **{"class": "failed", "claimed": "failed", "seconds": 0.01}
            ),
            _run("a", "liar", **liar, objective_error=0.3),
            _run("b", "liar", **liar, objective_error=0.2),
            _run("a", "slow", seconds=0.9),
            _run("chain of 14 links", "other", group="chains"),
            _run("ill-conditioned a", "other", group="ill-conditioned"),
        ]
    )
    assert summary.answer(rows[-2:]) == ""
    table = summary.summary_table(rows, 10.0).set_index("solver")
    expected = np.exp(np.mean(np.log([0.11, 0.41]))) - 0.01
    assert table.loc["good", "mean_seconds"] == pytest.approx(expected)
    curves = summary.profile(rows, 1e-6)
    np.testing.assert_allclose(curves["good"][0], [1.0, 2.0])
    np.testing.assert_allclose(curves["good"][1], [0.25, 0.5])
    np.testing.assert_allclose(curves["fast"][0], [1.0])
    assert len(curves["liar"][0]) == 0
    left_out = {"mosek": "no licence"}, [("a", "x", "no cone")]
    paths = summary.write_summary(tmp_path, rows, 10.0, *left_out)
    assert [path.name for path in paths[:2]] == ["summary.md", "summary.csv"]
    assert "silently wrong" in paths[0].read_text()
    for drawn in paths[2:]:  # with matplotlib
        assert drawn.name in ("profile.svg", "solved_over_time.svg")
        assert drawn.read_text().startswith("<?xml")


def ranked(*rows: tuple[str, int, int, float]) -> pandas.DataFrame:
    """A ranking of solvers on ten problems: name, right, silently wrong, seconds."""
    heads = ["solver", "right", "silently wrong", "seconds"]
    return pandas.DataFrame(rows, columns=heads).assign(problems=10, run=10)


def test_advice_does_not_contradict_itself():
    """Nobody is taken and to be checked; two that are taken have a reason each."""
    same = summary.advice(
        ranked(("good", 10, 0, 0.1), ("slow", 10, 0, 0.2)), "at 1e-06"
    )
    assert same == [
        "At 1e-06, take good: right on 10 of 10 problems, 0 times silently wrong, 100 ms"
        " (median)."
    ]
    liar, good, quick = ("liar", 10, 1, 0.1), ("good", 9, 0, 0.2), ("quick", 9, 0, 0.1)
    said = summary.advice(ranked(liar, good, quick), "at 1e-06")
    assert [sentence.split(":")[0] for sentence in said] == [
        "At 1e-06, take good",
        "Where time matters more, take quick, never silently wrong either",
        "Check every answer of liar",
    ]


def setup(out: Path, **changes: object) -> runner.Shootout:
    chosen: dict[str, object] = {
        "solvers": ["clarabel", "lmi-sdp"],
        "problems": [SMALL[0]],
        "accuracies": (1e-4, 1e-6),
        "jobs": 1,
        "memory": 0.9,
    }
    return runner.Shootout(out, **{**chosen, **changes})


def test_runs_resume(tmp_path):
    out = tmp_path / "shootout"
    first = runner.run(setup(out))
    runs = first.results.runs
    assert set(zip(runs["solver"], runs["settings"], strict=True)) == {
        ("clarabel", "1e-04"),
        ("clarabel", "1e-06"),
        ("lmi-sdp", "default"),
    }
    assert set(runs["class"]) == {"right"}
    with (out / "runs.csv").open(newline="") as file:
        assert [r["class"] for r in csv.DictReader(file)] == ["right"] * 3
    before = (out / "runs.csv").read_text()

    lines = before.splitlines(keepends=True)
    (out / "runs.csv").write_text("".join(lines[:-1]))
    resumed = runner.run(setup(out))  # what is missing, and nothing else
    assert resumed.results.runs[runner.KEY].equals(first.results.runs[runner.KEY])
    assert set(lines[:-1]) <= set(
        (out / "runs.csv").read_text().splitlines(keepends=True)
    )
    digest = first.results.runs["hash"][0]
    (out / "runs.csv").write_text(
        before.replace(digest, "0" * 16)
    )  # of an instance that was another
    again = runner.run(setup(out, accuracies=(1e-5,)))
    assert any("changed" in note for note in again.notes)
    assert set(again.results.runs["hash"]) == {digest}


def test_folders_that_hold_something_else_are_refused(tmp_path):
    (tmp_path / "table_III.csv").write_text("a,b\n1,2\n")
    refusal(lambda: runner.Results(tmp_path), "holds other files")
    other = tmp_path / "other"
    other.mkdir()
    (other / "runs.csv").write_text("run,result\n1,2\n")
    refusal(lambda: runner.Results(other), "something else")
    (other / "runs.csv").write_text(
        ",".join(runner.COLUMNS) + "\na,b\n" + "," * (len(runner.COLUMNS) - 1) + "\n"
    )
    refusal(lambda: runner.Results(other), "a row is damaged")


def test_the_time_limit_ends_one_cell_and_tighter_ones_are_not_tried(tmp_path):
    outcome = runner.run(setup(tmp_path / "s", solvers=["penalty"], time_limit=1e-3))
    runs = outcome.results.runs.set_index("settings")
    kinds = dict(
        zip(runs.index, zip(runs["class"], runs["remark"], strict=True), strict=True)
    )
    assert kinds["1e-04"][0] == kinds["1e-06"][0] == "timeout"
    assert "not run" in kinds["1e-06"][1]


def test_a_proof_that_hangs_is_ended_and_its_problem_runs_without_an_interval(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(runner, "reference", lambda made: time.sleep(60.0))
    monkeypatch.setattr(runner, "CLOCK_AT_LEAST", 0.5)
    begin = time.monotonic()
    outcome = runner.run(setup(tmp_path / "s", solvers=["clarabel"], proof_limit=0.2))
    assert time.monotonic() - begin < 30.0
    assert np.isinf(outcome.results.runs["lower"]).all()
    (known,) = json.loads((tmp_path / "s" / "references.json").read_text()).values()
    assert known["reference"]["verdict"] == "unknown"
    assert known["remark"].startswith("timeout")


@pytest.mark.parametrize("asked", [1e-4, 1e-8])
def test_right_is_what_was_asked_for_and_inaccurate_half_of_the_digits(asked):
    """Of errors and of violations, the larger decides; what is no number is neither."""
    known = Reference("feasible", 0.0, 0.0, 1.0)
    kinds = {
        0.0: "right",
        asked: "right",
        0.5 * asked**0.5: "inaccurate",
        2.0 * asked**0.5: "silently_wrong",
    }
    for x, kind in (kinds | {np.nan: "silently_wrong"}).items():
        assert [
            classified(known, "optimal", *e, asked)[0] for e in ((x, 0.0), (0.0, x))
        ] == [kind] * 2


def test_solved_over_time_counts_right_answers_and_marks_wrong_ones():
    """Two problems: one solved after a second, one answered wrongly after two."""
    rows = {
        "problem": ["a", "b"],
        "solver": ["x", "x"],
        "settings": ["1e-06", "1e-06"],
        "accuracy": [1e-6, 1e-6],
        "claimed": ["optimal", "optimal"],
        "class": ["right", "silently_wrong"],
        "objective_error": [1e-8, 1.0],
        "violation": [0.0, 0.0],
        "lower": [1.0, 1.0],
        "seconds": [1.0, 2.0],
    }
    curves = summary.solved_over_time(pandas.DataFrame(rows), 1e-6)
    seconds, shares, wrong = curves["x"]
    assert seconds.tolist() == [1.0]
    assert shares.tolist() == [0.5]
    assert wrong.tolist() == [2.0]


@pytest.mark.long
def test_a_shootout_that_is_stopped_leaves_a_summary(tmp_path, monkeypatch, capsys):
    out = tmp_path / "shootout"
    names = ("--problems", SMALL[2], "--solvers", "clarabel", "--out", str(out))
    assert run_cli("shootout", *names, "--quick") == 0
    (out / "summary.md").unlink()

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(runner, "run", stopped)
    assert run_cli("shootout", *names, "--quick") == 130
    assert (out / "summary.md").is_file()
    assert "stopped after 1 runs" in " ".join(capsys.readouterr().err.split())
