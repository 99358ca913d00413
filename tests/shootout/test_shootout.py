"""The shootout: wrong answers are planted and must be found; of its runs none is lost."""

import csv
import json
import os
import re
import resource
import runpy
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from fractions import Fraction
from itertools import product
from pathlib import Path

import cvxpy
import numpy as np
import pandas
import pytest
from commands import run_cli
from committed import as_kept
from numpy.testing import assert_allclose
from recorded import refusal

from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.robot import Constraint
from sdp_vs_penalty.shootout import (
    Answer,
    Chart,
    Reference,
    catalogue,
    everything,
    instance,
    reference,
    relative_violation,
    runner,
    statistics,
    summary,
)
from sdp_vs_penalty.shootout import judge as judging
from sdp_vs_penalty.shootout.catalogue import CHANGES, FORMS, ROBOTS, selected
from sdp_vs_penalty.shootout.contestants import contestants
from sdp_vs_penalty.shootout.instances import principal_rows
from sdp_vs_penalty.shootout.judge import CLASSES, JUDGED_TO, Judgement, classes, judge
from sdp_vs_penalty.solvers import SOLVERS, make_solver, solver_types
from sdp_vs_penalty.solvers.clarabel import Clarabel

CONTESTANTS = contestants()
SMALL = (
    "two_link simulated one-step gyration",
    "two_link simulated two-step gyration",
    "chain of 2 links gyration 0",
)


@pytest.fixture(scope="module")
def two_link():
    return instance(SMALL[0])


@pytest.fixture(scope="module")
def proved(two_link):
    return reference(two_link)


@pytest.fixture(scope="module")
def best(two_link):
    return CONTESTANTS["lmi-sdp"].solve(two_link, 1e-8)


@pytest.mark.nightly
def test_instances_are_what_they_were():
    """Their hashes are of problems to six digits: of the 2R and of arms of two links
    every one."""
    said = [
        f"{e.folder}: {e.make().hash}"
        for e in everything()
        if e.robot.startswith(("two_link", "chain of 2 "))
    ]
    as_kept("instances.txt", "\n".join(said) + "\n")
    assert len({line.split()[1] for line in said}) == len(said)


def test_no_robot_has_more_than_a_quarter_of_a_declared_set():
    """An instance is in one set at most; nobody chose which."""
    of_set = {name: [e for e in everything() if e.set == name] for name in summary.SETS}
    assert len(everything()) == 270
    for name in ("drawn", "untouched"):
        robots = Counter(e.robot for e in of_set[name])
        assert set(ROBOTS) < set(robots)
        assert max(robots.values()) <= 0.25 * len(of_set[name])
        assert max(e.links for e in of_set[name]) >= 40
        assert not {e.families[-1] for e in of_set[name]} & set(FORMS)
    assert {e.families[-1] for e in of_set["conic form"]} <= set(FORMS)
    assert all(e.set in ("drawn", "conic form") for e in everything() if is_quick(e))


def is_quick(e):
    return "quick" in e.tags


def test_links_of_robots_are_those_of_their_problems():
    assert {name: load_problem(name).robot.n for name in ROBOTS} == ROBOTS


@pytest.mark.parametrize(
    ("words", "having"),
    [
        (["emps"], lambda e: e.robot == "emps"),
        (["tx40+regulariser", "1 links"], lambda e: e.links == 1 or "tx40" in e.name),
        (["7 links+measured"], lambda e: e.robot == "panda" and e.measured),
        (["untouched+chains"], lambda e: e.set == "untouched"),
        (["noise-free"], lambda e: e.families[-1] == "noise-free"),
    ],
    ids=lambda x: "+".join(x) if isinstance(x, list) else "",
)
def test_instances_are_selected_by_robot_size_and_family(words, having, monkeypatch):
    monkeypatch.setattr(catalogue, "real_data_folder", lambda: Path())
    some, absent = selected(words)
    assert some
    assert not absent
    assert all(map(having, some))


def test_what_has_no_measurements_here_is_refused_by_name_and_left_out_by_tag(
    monkeypatch,
):
    monkeypatch.setattr(catalogue, "real_data_folder", lambda: None)
    name = "panda measured 14 s two-step gyration"
    refusal(lambda: selected([name, SMALL[0]]), "are absent")
    refusal(lambda: selected(["panda+measured"]), "no instance is left")
    refusal(lambda: selected(["no such tag"]), "no instance has")
    some, absent = selected(["panda"])
    assert name in {e.name for e in absent}
    assert not any(e.measured for e in some)


@pytest.mark.parametrize("change", ["gram kg m", "gram g mm", "gram lb in"])
def test_a_gram_matrix_is_handed_out_without_rounding(two_link, change):
    """So it has no negative eigenvalue, and the proof for R is one for it."""
    made = CHANGES[change][0](two_link)
    P = made.sdp.conic.P.toarray()
    R = [[Fraction(x) for x in row] for row in made.data.R.tolist()]
    for i in range(len(P)):
        for j in range(i, len(P)):
            entry = 2 * sum(row[i] * row[j] for row in R)
            assert entry == Fraction(float(P[i, j]))


@pytest.mark.parametrize("change", ["rank-deficient", "float32 data", "gram kg m"])
def test_an_instance_follows_from_the_loss_not_from_its_factor(change):
    """A rank-deficient triangle's last rows are what rounding makes of them."""
    made = instance("chain of 3 links plain 0")
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=made.data.R.shape))
    data = replace(made.data, R=turn @ made.data.R, rho=turn @ made.data.rho)
    one, other = (CHANGES[change][0](x) for x in (made, made.with_data(data)))
    theta = made.task.nominal
    assert one.data.loss(theta) == pytest.approx(other.data.loss(theta), rel=1e-9)
    assert principal_rows(data).loss(theta) == pytest.approx(data.loss(theta), rel=1e-9)


def test_a_loss_is_judged_at_the_scale_at_which_it_is_handed_out():
    """Of exact torques the optimum is zero: an error is relative to the unit of the
    conic objective, and no answer of a solver that keeps its word is wrong."""
    made = instance("two_link noise-free")
    known = reference(made)
    assert known.scale == pytest.approx(made.sdp.loss_scale**2)
    answer = CONTESTANTS["clarabel"].solve(made, 1e-8)
    assert judge(made, known, answer).error < 1e-7


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
    assert kind(judge(made, known, says)) == "right"
    for lie in ("optimal", "unbounded"):
        verdict = judge(made, known, replace(says, claims=lie))
        expected = "far_unchecked" if lie == "optimal" else "false_claim"
        assert kind(verdict) == expected


def test_a_point_of_an_infeasible_problem_is_judged_by_what_it_violates(two_link, best):
    """To four digits a problem that misses by one in a million has a solution."""
    outside = best.theta.copy()
    outside[:10] = 0.0
    outside[0] = -1e-6  # kg
    answer = replace(best, theta=outside, claims="optimal", multipliers=None)
    verdict = judge(two_link, Reference("infeasible"), answer)
    assert 0.0 < verdict.error == verdict.violation < 1e-4
    assert kind(verdict, verdict.violation) == "right"
    assert kind(verdict, 0.01 * verdict.violation) == "inaccurate"


def test_planted_wrong_answers_are_found(two_link, proved, best):
    inside = two_link.interior
    optimal = replace(best, claims="optimal", multipliers=None)
    suboptimal = replace(optimal, theta=best.theta + 1e-3 * (inside - best.theta))
    outside = replace(optimal, theta=best.theta + 0.2 * (best.theta - inside))
    nan = replace(optimal, theta=np.full_like(best.theta, np.nan))
    assert kind(judge(two_link, proved, outside)) == "far_unchecked"
    for wrong in (nan, replace(best, claims="infeasible")):
        verdict = judge(two_link, proved, wrong)
        assert kind(verdict) == "false_claim"
    verdict = judge(two_link, proved, suboptimal)
    assert verdict.violation == 0.0
    assert 1e-7 < verdict.objective_error == verdict.error
    # The same point is right to fewer digits, and no lie where the solver admits it.
    assert kind(verdict, verdict.error / 9.0) == "right"
    assert kind(verdict, verdict.error / 11.0) != "right"
    for admitted in ("inaccurate", "failed"):
        verdict = judge(two_link, proved, replace(suboptimal, claims=admitted))
        assert kind(verdict) == admitted


def kind(verdict, accuracy=1e-8):
    """The class of an answer at an accuracy."""
    row = {"outcome": verdict.outcome, "error": verdict.error, "accuracy": accuracy}
    dimacs = {f"dimacs_{k}": x for k, x in enumerate(verdict.dimacs, start=1)}
    runs = pandas.DataFrame([row | dimacs])
    return str(classes(runs, accuracy)[0])


def test_without_an_interval_nobody_is_judged(two_link, best):
    for claims in ("optimal", "infeasible", "unbounded"):
        unknown = Reference("unknown", 0.0, np.inf, 1.0)
        verdict = judge(two_link, unknown, replace(best, claims=claims))
        assert kind(verdict) == "unproved"
    rows = pandas.DataFrame([_run("a", "x", outcome="unproved")])
    assert summary.best_answers(rows, 1e-6).empty


def test_an_interval_that_is_too_wide_judges_nobody(two_link, monkeypatch):
    _, exact = judging.proved(two_link)
    wide = exact | {"lower": str(float(exact["upper"]) * (1.0 - 2.0 * JUDGED_TO))}
    monkeypatch.setattr(judging, "proved", lambda made: ("optimum proved", wide))
    assert reference(two_link).verdict == "unknown"


def test_dimacs_errors_of_a_known_solution():
    """At the optimum all are small; multipliers that are moved show in 3 to 6."""
    made = instance(SMALL[2])
    solution = CONTESTANTS["clarabel"].solve(made, 1e-9).solution
    errors = judging.dimacs_errors(made, solution)
    assert errors[0] == 0.0
    assert np.abs(errors).max() < 1e-7
    moved = judging.dimacs_errors(made, replace(solution, z=-solution.z))
    assert moved[1] == errors[1]
    assert np.abs(moved[2:5]).min() > 1e-3
    assert np.isnan(judging.dimacs_errors(made, None)).all()


@pytest.mark.parametrize("form", ["gram kg m", "no scaling"])
def test_a_bare_conic_form_is_posed_to_conic_solvers_only(form):
    """Who poses R and rho would be given other data than its rivals."""
    made = instance(f"two_link {form}")
    takers = {name for name, c in CONTESTANTS.items() if c.refuses(made) is None}
    assert takers == {name for name, c in CONTESTANTS.items() if c.takes_conic_form}
    assert {"clarabel", "scs", "csdp"} <= takers
    assert not takers & {"lmi-sdp", "cvxpy scs", "penalty"}


def test_stock_and_tuned_settings_are_two_rows_with_every_setting():
    stock, tuned = (CONTESTANTS[name] for name in ("clarabel", "clarabel tuned"))
    said = "tol_gap_abs 1e-06, tol_gap_rel 1e-06, tol_feas 1e-06, max_threads 1"
    assert stock.settings(1e-6) == said
    assert tuned.settings(1e-6).startswith(f"{said}, direct_solve_method faer, ")
    inside = "clarabel, at most 4 calls (tol_gap_abs 1e-10, tol_gap_rel 1e-10, "
    assert f", inside {inside}" in CONTESTANTS["lmi-sdp"].settings(1e-6)
    assert CONTESTANTS["cvxopt tuned"].settings(1e-6).endswith("kktsolver ldl")
    assert all(c.settings(1e-6) and c.clock for c in CONTESTANTS.values())


def test_a_version_is_that_of_the_solver_that_answers():
    for name in ("scs", "clarabel"):
        version = CONTESTANTS[f"cvxpy {name}"].version()
        assert version.endswith(f", {name} {CONTESTANTS[name].version()}")


@pytest.mark.parametrize("name", list(CONTESTANTS))
def test_what_only_a_first_call_pays_for_is_paid_before_the_fork(name, monkeypatch):
    """Every solver in this process solves something; a program pays in every run."""
    contestant = CONTESTANTS[name]
    if contestant.absent:
        pytest.skip(contestant.absent)
    solved = []
    for kind in solver_types().values():
        solve = kind.solve
        monkeypatch.setattr(
            kind,
            "solve",
            lambda self, *args, solve=solve, **kwargs: (
                solved.append(self.name) or solve(self, *args, **kwargs)
            ),
        )
    problems = cvxpy.Problem.solve
    monkeypatch.setattr(
        cvxpy.Problem,
        "solve",
        lambda self, solver=None, **kwargs: (
            solved.append(f"cvxpy {(solver or 'scs').lower()}")
            or problems(self, solver=solver, **kwargs)
        ),
    )
    contestant.warm_up()
    inside = name.removesuffix(" tuned")
    calls_no_solver = name in ("penalty", "log-cholesky L-BFGS")
    if calls_no_solver or solver_types().get(inside, Clarabel).requires[0] == "program":
        assert not solved
    else:
        assert solved[0] == ("clarabel" if name == "lmi-sdp" else inside)


def test_a_chart_of_links_begins_inside_and_knows_its_slope():
    """By central differences, of every variable."""
    made = instance("two_link simulated one-step cones")
    inside = made.interior
    rng = np.random.default_rng(0)
    chart = Chart(made.sent, inside)
    assert_allclose(chart.theta(chart.start)[0], inside, rtol=1e-9, atol=1e-12)
    x = chart.start + 0.3 * rng.normal(size=len(inside))
    gradient = rng.normal(size=len(inside))
    steps = 1e-6 * np.eye(len(x))
    moved = [
        (chart.theta(x + s)[0] - chart.theta(x - s)[0]) @ gradient / 2e-6 for s in steps
    ]
    assert_allclose(
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
    if name == "cvxpy scs" and problem.startswith("chain"):
        pytest.skip("100 000 iterations of SCS; the shootout shows how they end")
    answer = contestant.solve(made, 1e-6)
    verdict = judge(made, reference(made), answer)
    assert kind(verdict, 1e-6) in CLASSES
    assert answer.status
    # Whatever is claimed, our bounds hold: no multipliers prove more than the proved
    # optimum.
    assert verdict.own_gap >= -1e-12
    # A chart has minima of its own: on the chain it ends in one, .15 above the optimum.
    assert (
        not name.startswith("log-cholesky")
        or problem.startswith("chain")
        or kind(verdict, 1e-6) == "right"
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
        assert kind(verdict, 1e-6) == "right" or admits


def test_the_forms_users_write_have_the_same_optimum(two_link):
    known = reference(two_link)
    for formulation in ("residual", "gram", "rows"):
        posed = replace(two_link, formulation=formulation)
        ours = formulation == "residual"  # users send redundant constraints, too
        assert (len(posed.sent) < len(posed.constraints.convex)) is ours
        answer = CONTESTANTS["clarabel"].solve(posed, 1e-9)
        verdict = judge(posed, known, answer)
        assert kind(verdict, 1e-3) == "right"
        assert verdict.own_gap <= 0.01
        sdp = posed.sdp  # what the file says of its optimum is the loss there
        solution = make_solver("clarabel").solve(sdp.conic, 1e-9)
        # the upper triangle
        x = solution.x
        P = sdp.conic.P
        square = x @ (P @ x) - 0.5 * x @ (P.diagonal() * x)
        optimum = sdp.offset + sdp.loss_scale**2 * (square + sdp.conic.q @ x)
        assert optimum == pytest.approx(
            posed.problem.value(sdp.theta(solution)), rel=1e-5
        )


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


def _spin():
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


def _seconds_of_children():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_seconds_are_processor_time(two_link, proved, best):
    """Of two contestants that take a quarter of a second, one sleeps and the other's program
    computes."""
    busy = "import time\nwhile time.process_time() < 0.25: pass"

    def seconds(wait):
        def solve(made, accuracy):
            wait()
            return best

        task = runner.Assignment("", "", 20.0, 1.0, reference=proved)
        row = runner.run_one(
            task, replace(CONTESTANTS["lmi-sdp"], solve=solve), two_link, 1e-6
        )
        assert row["outcome"] == "claim"
        return row["seconds"]

    assert seconds(lambda: time.sleep(0.25)) < 0.1
    assert (
        0.25
        <= seconds(lambda: subprocess.run([sys.executable, "-c", busy], check=True))
        < 2.0
    )


def test_a_short_run_is_repeated_and_its_files_are_no_time_of_the_solver(
    two_link, proved, best
):
    """Five repetitions: the median counts, least and largest stand beside it."""

    def solve(made, accuracy):
        end = time.process_time() + 0.05
        while time.process_time() < end:
            pass
        return replace(best, file_seconds=0.03)

    task = runner.Assignment("", "", 20.0, 1.0, reference=proved, repeats=5)
    lazy = replace(CONTESTANTS["lmi-sdp"], solve=solve)
    row = runner.run_one(task, lazy, two_link, 1e-6)
    assert row["repeats"] == 5
    assert row["file_seconds"] == 0.03
    assert 0.019 <= row["seconds_least"] <= row["seconds"] <= row["seconds_most"] < 0.2


def _run(problem, solver, **changes):
    row = {
        "problem": problem,
        "set": "drawn",
        "robot": "panda",
        "solver": solver,
        "settings": "tol 1e-06",
        "time_limit": 10.0,
        "accuracy": 1e-6,
        "claimed": "optimal",
        "status": "",
        "outcome": "claim",
        "error": 1e-6,
        "objective_error": 1e-6,
        "violation": 0.0,
        "lower": 1.0,
        "upper": 1.0,
        "scale": 1.0,
        "attempts": 1,
        "seconds": 0.1,
        "seconds_least": 0.1,
        "seconds_most": 0.1,
        "form_seconds": 0.0,
        "file_seconds": 0.0,
        "repeats": 1,
        "hash": "h",
        "own_gap": np.inf,
        **{f"dimacs_{k}": np.nan for k in range(1, 7)},
        "version": "1",
        "machine": "m",
        "remark": "",
    }
    return row | changes


LIE = {"error": 0.3, "seconds": 0.01}


@pytest.mark.long
def test_summary_of_known_runs(tmp_path):
    rows = pandas.DataFrame(
        [
            _run("a", "good"),
            _run("b", "good", seconds=0.4),
            _run("a", "fast", seconds=0.05),
            _run("b", "fast", outcome="failed", claimed="failed", seconds=0.01),
            _run("a", "liar", **LIE),
            _run("b", "liar", **LIE),
            _run("a", "slow", seconds=0.9),
            _run("c", "slow", set="untouched"),
        ]
    )
    table = summary.by_setting(rows).set_index("solver")
    expected = np.exp(np.mean(np.log([0.11, 0.41]))) - 0.01
    assert table.loc["good", "mean seconds 1e-06"] == pytest.approx(expected)
    assert table.loc["liar", "far_unchecked"] == 2
    curves = summary.profile(rows[:-1], 1e-6)
    assert_allclose(curves["good"][0], [1.0, 2.0])
    assert_allclose(curves["good"][1], [0.5, 1.0])
    assert_allclose(curves["fast"][0], [1.0])
    assert len(curves["liar"][0]) == 0
    left_out = {"mosek": "no licence"}, [("a", "x", "no cone")]
    paths = summary.write_summary(tmp_path, rows, *left_out)
    assert [path.name for path in paths[:2]] == ["summary.md", "summary.csv"]
    text = paths[0].read_text()
    assert "Drawn problems: 2" in text
    assert "Untouched problems: 1" in text
    assert "x: not applicable to 1 problem: no cone" in text
    for drawn in paths[2:]:  # with matplotlib
        assert drawn.name in ("profile.svg", "work_precision.svg")
        assert drawn.read_text().startswith("<?xml")
    for solver_name in ("good", "fast", "liar", "slow"):  # nobody is left out
        assert solver_name in (tmp_path / "profile.svg").read_text() or not paths[2:]


def test_an_answer_counts_by_its_figures_whatever_was_asked_for():
    """Asked for more, a contestant that obeyed a loose wish is right as well."""
    rows = [
        _run("a", "x", settings="4", accuracy=1e-4, error=5e-4, seconds=0.01),
        _run("a", "x", settings="8", accuracy=1e-8, error=1e-9, seconds=0.2),
        _run("b", "x", settings="4", accuracy=1e-4, error=1e-9, seconds=0.03),
        _run("b", "x", settings="8", accuracy=1e-8, error=1e-9, seconds=0.3),
        _run("a", "shy", settings="4", accuracy=1e-4, error=5e-3),
        _run("a", "shy", settings="8", accuracy=1e-8, outcome="failed"),
        _run("b", "shy", settings="8", accuracy=1e-8, error=1e-9),
        _run("a", "loose", settings="4", accuracy=1e-4, error=1e-9),
    ]
    frame = pandas.DataFrame(rows)
    cells = summary.best_answers(frame, 1e-6).set_index(["solver", "problem"])
    assert cells["seconds"]["x"].to_dict() == {"a": 0.2, "b": 0.03}
    assert cells["class"]["shy"].to_dict() == {"a": "failed", "b": "right"}
    assert "loose" not in cells.index  # was never asked for so much
    loose = summary.best_answers(frame, 1e-4).set_index(["solver", "problem"])
    assert loose["right"].sum() == 4
    assert loose["class"]["shy"]["a"] == "far_unchecked"


def test_false_claims_and_answers_that_kept_their_own_rule_are_two_classes():
    """By what runs.csv has: DIMACS errors within ten times what was asked for."""
    kept, broken = ({f"dimacs_{k}": x for k in range(1, 7)} for x in (5e-6, 5e-5))
    rows = [
        _run("a", "kept", error=0.5, **kept),
        _run("a", "broken", error=0.5, **broken),
        _run("a", "unchecked", error=0.5),
        _run("a", "refuted", error=np.inf, claimed="unbounded", **kept),
    ]
    frame = pandas.DataFrame(rows)
    said = dict(zip(frame["solver"], classes(frame, 1e-6), strict=True))
    assert said == {
        "kept": "far",
        "broken": "far_unchecked",
        "unchecked": "far_unchecked",
        "refuted": "false_claim",
    }
    table = summary.false_claims(frame).set_index("solver")
    assert table["claims"].to_dict() == {"refuted": "unbounded"}


def test_medians_are_over_all_problems_and_one_form_has_one_time():
    """The limit stands where a run is not right; solvers' own times of a form are one."""
    rows = [
        *many("good", 10, form_seconds=0.01),
        *many("poor", 4, 0.01, form_seconds=0.03, **FAILED),
    ]
    table = summary.ranking(summary.best_answers(pandas.DataFrame(rows), 1e-6))
    table = table.set_index("solver")
    assert table["seconds"]["good"] == 0.1
    assert np.isnan(table["seconds"]["poor"])  # half of them are not right
    assert table["form_seconds"].to_dict() == {"good": 0.02, "poor": 0.02}
    assert table["proved"].isna().all()  # neither returns multipliers


@pytest.mark.parametrize(
    ("times", "said"), [(1.05, "about as fast"), (1.5, "1.5 times as long")]
)
def test_times_within_ten_percent_are_about_the_same(times, said):
    rows = pandas.DataFrame([*many("a", 10, 0.1), *many("b", 10, 0.1 * times)])
    table = summary._ranking_in_words(summary.best_answers(rows, 1e-6))
    assert f"about as right (0 to 0 of 10, p 1), {said}" in table


def test_the_summary_tells_who_is_inaccurate_by_its_figures_from_who_says_so(
    tmp_path, monkeypatch
):
    """And what was not run from what was ended by the clock."""
    late = {"outcome": "timeout", "claimed": "", "error": np.inf}
    says = {"outcome": "inaccurate", "claimed": "inaccurate", "error": 1e-9}
    rows = [
        _run("a", "modest", **says),
        _run("a", "loose", error=5e-4),
        _run("a", "far", error=0.5, objective_error=2e-5, violation=0.5),
        _run("a", "late", status="stopped", **late),
        _run("a", "later", status="not run: x exceeded the time limit", **late),
    ]
    runs = pandas.DataFrame(rows)
    (grid,) = summary.by_problem(runs, 1e-6).to_dict("records")
    assert grid["modest"] == "says inaccurate"
    assert grid["loose"] == "inaccurate"
    assert grid["far"] == "far, unchecked: objective 2e-05, violation 5e-01"
    said = " ".join(summary.sentences(runs))
    assert (
        "Asked for 1e-06, so many do (in brackets: within 1e-05): modest 1 (1)." in said
    )
    assert "1 of 1 of far have an objective within 0.001" in said
    for picture in ("plot_profile", "plot_work_precision"):
        monkeypatch.setattr(summary, picture, lambda *_: None)
    summary.write_summary(tmp_path, runs, {}, [])
    assert "(1 of 2 timeouts)" in (tmp_path / "summary.md").read_text()


def test_times_of_two_clocks_have_no_ratio():
    rows = [*many("cvxpy clarabel", 10, 0.3), *many("clarabel", 10, 0.1)]
    table = summary._ranking_in_words(
        summary.best_answers(pandas.DataFrame(rows), 1e-6)
    )
    assert "another clock" in table
    assert "times as long" not in table


def test_wilson_intervals_and_sign_tests():
    """27 of 27 is not all: Wilson 1927; 5 to 0 is no proof at 5 %, 6 to 0 is."""
    low, high = statistics.wilson(27, 27)
    assert (low, high) == (pytest.approx(0.875, abs=5e-4), 1.0)
    low, high = statistics.wilson(5, 10)
    assert (low, high) == (
        pytest.approx(0.2366, abs=5e-5),
        pytest.approx(0.7634, abs=5e-5),
    )
    assert statistics.sign_test(5, 0) == 0.0625
    assert statistics.sign_test(0, 6) == 0.03125
    assert statistics.sign_test(0, 0) == 1.0
    assert [statistics.can_tell(n) for n in (5, 6)] == [False, True]
    # Nine tests err more often than one: 8 problems cannot rank ten contestants.
    assert [statistics.can_tell(n, 10) for n in (8, 9)] == [False, True]
    assert statistics.sign_test(9, 6) == pytest.approx(0.6072, abs=5e-5)


def many(solver_name, n_right, seconds=0.1, form_seconds=0.0, **lie):
    same = {"seconds": seconds, "form_seconds": form_seconds}
    return [
        _run(f"p{k}", solver_name, **same, **({} if k < n_right else lie))
        for k in range(10)
    ]


FAILED = {"outcome": "failed", "claimed": "failed", "error": np.inf}


def test_sentences_begin_with_who_is_right_most_often_and_name_who_is_wrong():
    rows = [
        *many("good", 10, 0.2, **FAILED),
        *many("near", 8, 0.1, **FAILED),
        *many("poor", 2, 0.01, **FAILED),
        *many("liar", 9, 0.01, error=0.5, objective_error=0.5),
    ]
    runs = pandas.DataFrame(rows)
    cells = summary.best_answers(runs, 1e-6)
    alike = summary.about_as_right(cells, summary.ranking(cells))
    assert alike == ["good", "liar", "near"]
    (said,) = summary.sentences(runs[runs["accuracy"] == 1e-6])[1:2]
    assert said == (
        "Right to 1e-06 on 10 drawn problems: most surely good (10 of 10), from which no test"
        " tells liar (9 of 10) and near (8 of 10); good takes 200 ms (median). Violates a"
        " constraint, or its objective is far; says that its own rule was met, not checked by"
        " us: liar on 1 of 10 (violation on 0, objective on 1)."
    )


def test_a_solver_of_the_users_own_is_named_however_it_fares(monkeypatch):
    monkeypatch.setattr(
        summary.SOLVERS, "provider", lambda name: "mine" if name == "poor" else ""
    )
    rows = [*many("good", 10, 0.2, **FAILED), *many("poor", 2, 0.01, **FAILED)]
    (said,) = summary.sentences(pandas.DataFrame(rows))[1:2]
    assert "poor (2 of 10): failed 8" in said


def test_a_contestant_is_ranked_by_its_share_of_the_problems_posed_to_it():
    """9 of 9 come before 8 of 10, and behind 10 of 10."""
    rows = [*many("all", 10), *many("most", 8, **FAILED), *many("few", 10)[:-1]]
    cells = summary.best_answers(pandas.DataFrame(rows), 1e-6)
    assert summary.ranking(cells)["solver"].tolist() == ["all", "few", "most"]


def test_what_our_default_claims_is_said_at_the_tightest_that_it_was_asked_for():
    """Others' one setting is no accuracy of ours."""
    status = "primal-dual: proved gap 1e-9"
    rows = [
        _run("a", "lmi-sdp", accuracy=1e-4, status=status),
        _run("a", "lmi-sdp", accuracy=1e-6, status=status),
        _run("b", "lmi-sdp", status=status, outcome="inaccurate", claimed="inaccurate"),
        _run("a", "cvxpy clarabel", accuracy=1e-8),
    ]
    *_, said = summary.sentences(pandas.DataFrame(rows))
    assert "asked for 1e-06 alone, 1 of 2 are right, and 1 it calls inaccurate" in said


def test_two_problems_rank_nobody():
    rows = [*many("good", 10), *many("liar", 1, error=0.5, violation=0.5)]
    of_two = pandas.DataFrame(rows).query(
        "problem in ('p0', 'p1') and accuracy == 1e-6"
    )
    _, said, _, of_violation = summary.sentences(of_two)
    assert of_violation.startswith(
        "Of claimed optima that are far, under any setting, 1 of 1"
    )
    assert said == (
        "2 drawn problems cannot rank anybody. Right to 1e-06: good on 2 of 2 and liar on"
        " 1 of 2. Violates a constraint, or its objective is far; says that its own rule was"
        " met, not checked by us: liar on 1 of 2 (violation on 1, objective on 0)."
    )
    _, said, _ = summary.sentences(of_two[of_two["solver"] == "good"])
    assert said.endswith("good on 2 of 2.")


def setup(out, **changes):
    chosen = {
        "solvers": ["clarabel", "lmi-sdp"],
        "problems": [SMALL[0]],
        "accuracies": (1e-4, 1e-6),
        "jobs": 1,
        "memory": 0.9,
    }
    return runner.Shootout(out, **{**chosen, **changes})


@pytest.fixture(scope="module")
def four_runs(tmp_path_factory):
    """The folder of a shootout of two solvers at two accuracies."""
    out = tmp_path_factory.mktemp("four") / "shootout"
    runs = runner.run(setup(out)).results.runs
    wanted = product(("clarabel", "lmi-sdp"), (1e-4, 1e-6))
    assert set(zip(runs["solver"], runs["accuracy"], strict=True)) == {*wanted}
    assert set(runs["outcome"]) == {"claim"}
    return out


@pytest.fixture
def resumed(four_runs, tmp_path):
    """Four runs, and those that there are when their runs.csv was changed and the shootout
    goes on."""

    def resume(change):
        out = Path(shutil.copytree(four_runs, tmp_path / "shootout"))
        with (out / "runs.csv").open(newline="") as file:
            before = [*csv.DictReader(file)]
        with (out / "runs.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, list(before[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(change(before))
        again = runner.run(setup(out))
        first = runner.Results(four_runs).runs
        assert again.results.runs[runner.KEY].equals(first[runner.KEY])
        with (out / "runs.csv").open(newline="") as file:
            return before, [*csv.DictReader(file)], again.notes

    return resume


def test_runs_resume(resumed):
    """What is missing is run, and nothing else."""
    before, after, _ = resumed(lambda rows: rows[:-1])
    assert all(row in after for row in before[:-1])


def test_a_run_of_another_instance_version_setting_or_limit_is_repeated(resumed):
    stale = {"hash": "0" * 16, "version": "0.0", "settings": "1", "time_limit": "0.3"}
    pairs = [*stale.items()]
    _, after, notes = resumed(
        lambda rows: [
            row | {column: value, "outcome": "timeout"}
            for row, (column, value) in zip(rows, pairs, strict=True)
        ]
    )
    assert any(note.startswith("4 runs were dropped") for note in notes)
    assert {row["outcome"] for row in after} == {"claim"}


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
    runs = outcome.results.runs.sort_values("accuracy")
    assert runs["outcome"].tolist() == ["timeout", "timeout"]
    assert "not run" in runs["status"].iloc[0]


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
    assert set(outcome.results.runs["outcome"]) == {"unproved"}


@pytest.mark.parametrize("accuracy", [1e-4, 1e-8])
def test_right_is_within_the_slack_and_far_what_is_not_right_to_four_digits(accuracy):
    kinds = {
        0.0: "right",
        9.0 * accuracy: "right",
        11.0 * accuracy: "inaccurate" if accuracy < 1e-4 else "far_unchecked",
        2e-3: "far_unchecked",
        np.nan: "false_claim",
    }
    for error, expected in kinds.items():
        assert kind(Judgement("claim", error), accuracy) == expected


def test_a_solver_of_another_package_takes_part(tmp_path, monkeypatch):
    """By an entry point: nothing here is changed."""
    info = tmp_path / "theirs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n"
    )
    (info / "entry_points.txt").write_text(
        f"[{SOLVERS.package}]\ntheirs = their_solver:Theirs\n"
    )
    (tmp_path / "their_solver.py").write_text(
        "from sdp_vs_penalty.solvers.clarabel import Clarabel\n\n\n"
        "class Theirs(Clarabel):\n"
        '    """Ours, under their name."""\n\n'
        '    name = "theirs"\n'
        "    tuned_options = {}\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    SOLVERS.forget()
    try:
        runs = runner.run(setup(tmp_path / "s", solvers=["theirs"])).results.runs
        assert set(runs["solver"]) == {"theirs"}
        assert set(classes(runs, 1e-4)) == {"right"}
        (info / "entry_points.txt").write_text(f"[{SOLVERS.package}]\nx = nowhere:X\n")
        SOLVERS.forget()
        refusal(solver_types, "nowhere")
    finally:
        SOLVERS.forget()


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


RESULTS = Path(__file__).parents[2] / "results" / "shootout"


@pytest.mark.long
@pytest.mark.skipif(
    not (RESULTS / "runs.csv").exists(), reason="results/shootout/make.py has not run"
)
def test_the_readme_of_the_results_says_what_its_runs_say():
    with_sentences = runpy.run_path(str(RESULTS / "make.py"))["with_sentences"]
    readme = (RESULTS / "README.md").read_text()
    assert with_sentences(readme) == readme


def test_eight_problems_of_the_results_rank_nobody_and_the_rows_of_cvxpy_prove_nothing():
    runs = runner.Results(RESULTS).runs
    cells = summary.best_answers(runs[runs["set"] == "conic form"], 1e-8)
    assert not summary.is_ranked(cells)
    cells = summary.best_answers(runs[runs["set"] == "drawn"], 1e-4)
    table = summary.ranking(cells).set_index("solver")
    assert table["proved"].isna()[["cvxpy clarabel", "cvxpy scs"]].all()
    tighter = summary.best_answers(runs[runs["set"] == "drawn"], 1e-6)
    assert "cvxpy clarabel" in set(tighter["solver"])
    assert "cvxpy scs" not in set(tighter["solver"])  # was asked for 1e-5


def test_an_outsider_is_compared_with_the_runs_that_are_here():
    """By his own reading of runs.csv; where verdicts differ, it is the solver's."""
    kind_of = runpy.run_path(str(RESULTS / "outsider.py"))["kind"]
    with (RESULTS / "runs.csv").open(newline="") as file:
        runs = {
            (row["problem"], row["solver"]): row
            for row in csv.DictReader(file)
            if float(row["accuracy"]) == 1e-8
        }
    with (RESULTS / "outsider.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len({row["problem"] for row in rows}) == 12
    for row in rows:
        run = runs[row["problem"], row["solver"]]
        kinds = [kind_of(run, accuracy) for accuracy in (1e-4, 1e-6, 1e-8)]
        assert row["of the table"] == ", ".join(kinds)
        assert row["verdicts equal"] == "yes" or row["solver"] == "scs"


def test_short_work_is_timed_to_a_fraction_of_a_millisecond():
    """A timer of processor time runs in the child: clocks that it makes stale are of no
    use."""

    def work():
        begin, used = time.thread_time(), runner._processor()
        while time.thread_time() < begin + 3e-3:
            pass
        return runner._processor() - used

    kind, seconds, _ = runner.in_child(work, limit=5.0, memory=1.0)
    assert kind == "ended"
    assert seconds == pytest.approx(3e-3, abs=5e-4)
