"""The verbs shootout and export-sdp as a user types them."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest
from commands import run_cli
from sdp_readers import PROGRAMS, outside_optimum, read_cbf, read_sdpa

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.data import save
from sdp_vs_penalty.simulation import experiment
from sdp_vs_penalty.solvers import solver


def test_shootout_writes_its_tables(tmp_path, capsys):
    out = tmp_path / "s"
    choice = ("--solvers", "clarabel,lmi-sdp", "--problems", "two_link simulated one-step plain")
    assert run_cli("shootout", *choice, "--accuracy", "1e-6", "--jobs", 1, "--out", out) == 0
    said = capsys.readouterr().out
    assert "Take " in said
    for name in ("runs.csv", "summary.md", "summary.csv"):
        assert str(out / name) in said
        assert (out / name).is_file()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--solvers", "gurobi"), "solver 'gurobi' is unknown: there are: clarabel"),
        (("--problems", "pandas"), "'pandas' is unknown"),
        (("--accuracy", "small"), "--accuracy 'small'"),
        (("--time-limit", "0"), "--time-limit"),
    ],
)
def test_mistakes_are_one_sentence(tmp_path, capsys, arguments, words):
    assert run_cli("shootout", *arguments, "--out", tmp_path / "s") == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


def test_list_names_instances_and_solvers(capsys):
    assert run_cli("shootout", "--list") == 0
    said = capsys.readouterr().out
    for name in (
        "panda gram g mm",
        "chain of 60 links gyration 0",
        "log-cholesky L-BFGS",
        "sdpa-program",
    ):
        assert name in said


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The 2R's problem in both formats, and with the entropic prior of the default method in one."""
    folder = tmp_path_factory.mktemp("exported")
    # On the run of seed 0 csdp says itself that it reaches "reduced accuracy" only.
    save(experiment(load_problem("two_link")).training_run(seed=2), folder / "run.csv")
    plain = ("--method", "lmi-sdp-thickness")
    for name, method in (("a.dat-s", plain), ("a.cbf", plain), ("entropic.cbf", ())):
        given = ("--data", folder / "run.csv", "--out", folder / name, *method)
        assert run_cli("export-sdp", "two_link", *given) == 0
    return folder


def within(about: dict[str, float], optimum: float, accuracy: float) -> bool:
    """Whether a file's optimum, found to an accuracy relative to 1 + |optimum|, is the loss proved."""
    loss = about["offset"] + about["scale"] * optimum
    slack = accuracy * about["scale"] * (1.0 + abs(optimum))
    return about["lower"] - slack <= loss <= about["upper"] + slack


def test_export_writes_files_whose_optimum_is_the_proved_loss(exported):
    for name, read in (("a.dat-s", read_sdpa), ("a.cbf", read_cbf), ("entropic.cbf", read_cbf)):
        about = json.loads((exported / f"{name}.json").read_text())
        assert about["sha256"] == hashlib.sha256((exported / name).read_bytes()).hexdigest()
        assert about["upper"] - about["lower"] < 1e-7 * about["upper"]
        conic = read(exported / name)
        assert (len(conic.q), len(conic.b)) == (about["variables"], about["rows"])
        optimum = float(conic.q @ solver("clarabel").solve(conic, 1e-9).x)
        assert within(about, optimum, 1e-7)
        assert not within(about, optimum + 1e-5, 1e-7)


@pytest.mark.parametrize("program", PROGRAMS)
def test_outside_programs_reproduce_the_interval_from_the_file_alone(program, exported, tmp_path):
    shutil.copy(exported / "a.dat-s", tmp_path)
    found = outside_optimum(program, tmp_path)
    about = json.loads((exported / "a.dat-s.json").read_text())
    assert within(about, found, 1e-6)
    assert not within({**about, "offset": 0.0}, found, 1e-5)


def test_what_cannot_be_exported_is_one_sentence(exported, tmp_path, capsys):
    wrong = ("--data", exported / "run.csv", "--out", tmp_path / "a.mps")
    assert run_cli("export-sdp", "two_link", *wrong) == 2
    assert ".dat-s" in capsys.readouterr().err
    penalty = ("--method", "penalty", "--data", exported / "run.csv", "--out", tmp_path / "a.cbf")
    assert run_cli("export-sdp", "two_link", *penalty) == 2
    assert "not a single SDP" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
