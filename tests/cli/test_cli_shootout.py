"""The verbs shootout and export-sdp as a user types them."""

from __future__ import annotations

from pathlib import Path

import pytest
from sdp_readers import read_cbf, read_sdpa

from sdp_vs_penalty.cli.main import main
from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.simulation.experiment import experiment
from sdp_vs_penalty.solvers import solver


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    return int(ended.value.code or 0)


def test_shootout_writes_its_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "s"
    choice = ("--solvers", "clarabel,lmi-sdp", "--problems", "two_link one-step plain")
    assert run("shootout", *choice, "--accuracy", "1e-6", "--jobs", 1, "--out", out) == 0
    said = capsys.readouterr().out
    assert "Most often right" in said
    for name in ("runs.csv", "summary.md", "summary.tex", "summary.csv"):
        assert str(out / name) in said
        assert (out / name).is_file()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--solvers", "gurobi"), "solver 'gurobi' is unknown; there are: clarabel"),
        (("--problems", "pandas"), "'pandas' is unknown"),
        (("--accuracy", "small"), "--accuracy 'small'"),
        (("--time-limit", "0"), "--time-limit"),
    ],
)
def test_mistakes_are_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], words: str
) -> None:
    assert run("shootout", *arguments, "--out", tmp_path / "s") == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


def test_list_names_instances_and_solvers(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("shootout", "--list") == 0
    said = capsys.readouterr().out
    for name in ("hostile gram g mm", "chain of 60 links", "log-cholesky", "sdpa-program"):
        assert name in said


def test_export_writes_files_that_solve_to_the_same_optimum(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    problem = load_problem("two_link")
    save(experiment(problem).training_run(seed=0), tmp_path / "run.csv")
    optima = []
    for name, read in (("a.dat-s", read_sdpa), ("a.cbf", read_cbf)):
        given = ("--data", tmp_path / "run.csv", "--out", tmp_path / name)
        assert run("export-sdp", "two_link", "--method", "lmi-sdp-thickness", *given) == 0
        conic = read(tmp_path / name)
        optima.append(float(conic.q @ solver("clarabel").solve(conic, 1e-8).x))
    assert optima[0] == pytest.approx(optima[1], rel=1e-6)
    capsys.readouterr()
    wrong = ("--data", tmp_path / "run.csv", "--out", tmp_path / "a.mps")
    assert run("export-sdp", "two_link", *wrong) == 2
    assert ".dat-s" in capsys.readouterr().err
    penalty = ("--method", "penalty", "--data", tmp_path / "run.csv", "--out", tmp_path / "a.cbf")
    assert run("export-sdp", "two_link", *penalty) == 2
    assert "not a single SDP" in capsys.readouterr().err
