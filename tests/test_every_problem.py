"""No built-in robot and no effect is dead: each problem is identified by default; the
long part walks each, and each effect's default form, through the verbs of a job."""

from dataclasses import replace

import numpy as np
import pytest
from commands import run_cli
from small_runs import small_run, write_run

from sdp_vs_penalty import identify, load_problem
from sdp_vs_penalty.data import save
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.problem.load import problem_names

BASE = ("rigid_body", "viscous_friction", "coulomb_friction", "torque_offset")
#: Whose joints robot files have no words for.
WITHOUT_URDF = ("dvrk_psm",)


@pytest.mark.filterwarnings("ignore:warning. run. joints")
@pytest.mark.parametrize("name", problem_names())
def test_every_built_in_problem_is_identified(name):
    problem = load_problem(name)
    model = identify(problem, small_run(problem))
    assert model.certificate.worst == 0.0
    assert model.certificate.gap < 1e-8
    assert model.provenance["verdict"]


def walk(problem, run, test, plainer, added, *effects):
    """Each verb ends with 0: identify (with ``effects``), compare, diagnose, add (to the
    model ``plainer``), export, report."""
    folder = plainer.parent
    data = ("--data", run, "-q")
    model = folder / "model.json"
    endings = (".json",) if problem in WITHOUT_URDF else (".json", ".urdf")
    commands = [
        ("identify", problem, *effects, *data, "--out", model),
        ("compare", model, "--data", test, "-q"),
        ("diagnose", model, *data, "--json", folder / "findings.json"),
        ("add", plainer, added, *data, "--out", folder / "extended.json"),
        *(("export", model, "--out", folder / f"out{x}", "-q") for x in endings),
        ("report", model, *data, "--out", folder / "report.html"),
    ]
    for command in commands:
        assert run_cli(*command) == 0, command[0]


#: A slide, coupled joints, and mimic joints; what the docs' own jobs walk is slow.
KINDS = ("emps", "tx40", "dvrk_psm")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(x, marks=pytest.mark.long if x in KINDS else pytest.mark.slow)
        for x in problem_names()
    ],
)
def test_every_built_in_problem_walks_through_a_job(name, tmp_path):
    runs = tmp_path / "runs"
    assert run_cli("simulate", name, "--out", runs, "-q") == 0
    assert run_cli("check", name, "--data", runs / "run1.csv", "-q") == 0
    problem = load_problem(name)
    run, test = (write_run(tmp_path / f"{k}.csv", problem, seed=k) for k in (0, 1))
    walk(name, run, test, tmp_path / "model.json", "joint_spring:1")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two runs of the two links that log what any effect may need: commands, motors'
    positions, temperatures."""
    folder = tmp_path_factory.mktemp("runs")
    paths = folder / "run.csv", folder / "test.csv"
    for seed, path in enumerate(paths):
        run = small_run(load_problem("two_link"), 6.0, seed=seed)
        ahead = np.array([np.interp(run.t + 0.01, run.t, q) for q in run.q.T]).T
        commanded = {"qcmd": ahead, "qmot": run.q + 1e-4 * run.tau}
        warm = 20.0 + 2.0 * run.t[:, None] + np.zeros(run.q.shape)
        save(replace(run, commanded=commanded, temperature=warm), path)
    return paths


#: Some at a time: what a verb does with one it does with each.
NAMES = [*effect_types()]
EIGHT = [NAMES[k : k + 8] for k in range(0, len(NAMES), 8)]


@pytest.mark.long
@pytest.mark.parametrize("names", EIGHT, ids=lambda names: names[0])
def test_every_effect_walks_through_a_job_in_its_default_form(names, runs, tmp_path):
    """Part of a model, and added to one without it; tests/effects hides each in a world."""
    run, test = runs
    others = [e for e in BASE if e not in names]
    plainer = tmp_path / "plainer.json"
    without = ("--effects", ",".join(others), "--data", run, "--out", plainer, "-q")
    assert run_cli("identify", "two_link", *without) == 0
    effects = ",".join([*names, *others])
    walk("two_link", run, test, plainer, ",".join(names), "--effects", effects)
