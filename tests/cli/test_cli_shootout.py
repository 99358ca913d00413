"""The verbs shootout and export-sdp as a user types them."""

import pytest
from commands import run_cli
from small_runs import write_run


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
        (("--accuracy", "2"), "--accuracy"),
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


def test_what_cannot_be_exported_is_one_sentence(two_link, tmp_path, capsys):
    run = write_run(tmp_path / "run.csv", two_link)
    wrong = ("--data", run, "--out", tmp_path / "a.mps")
    assert run_cli("export-sdp", "two_link", *wrong) == 2
    assert ".dat-s" in capsys.readouterr().err
    penalty = ("--method", "penalty", "--data", run, "--out", tmp_path / "a.cbf")
    assert run_cli("export-sdp", "two_link", *penalty) == 2
    assert "not a single SDP" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [run]
