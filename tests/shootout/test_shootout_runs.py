"""Runs of the shootout: resuming, killed processes and workers; nothing is lost."""

import csv
from pathlib import Path

import pytest

from sdp_vs_penalty import InputError
from sdp_vs_penalty import parallel as cluster
from sdp_vs_penalty.shootout import runner
from sdp_vs_penalty.shootout.runner import COLUMNS, Results, Shootout

PROBLEM = "two_link simulated one-step gyration"


def setup(out: Path, **changes: object) -> Shootout:
    chosen: dict[str, object] = {
        "solvers": ["clarabel", "lmi-sdp"],
        "problems": [PROBLEM],
        "accuracies": (1e-4, 1e-6),
        "jobs": 1,
    }
    return Shootout(out, **{**chosen, **changes})


def test_runs_resume(tmp_path):
    out = tmp_path / "shootout"
    first = runner.run(setup(out))
    runs = first.results.runs
    assert set(zip(runs["solver"], runs["settings"], strict=True)) == {
        ("clarabel", "1e-04"), ("clarabel", "1e-06"), ("lmi-sdp", "default"),
    }  # fmt: skip
    assert set(runs["class"]) == {"right"}
    with (out / "runs.csv").open(newline="") as file:
        assert [r["class"] for r in csv.DictReader(file)] == ["right"] * 3
    before = (out / "runs.csv").read_text()

    again = runner.run(setup(out))
    assert (out / "runs.csv").read_text() == before
    assert len(again.results.runs) == 3

    # Only what is missing is done again.
    lines = before.splitlines(keepends=True)
    (out / "runs.csv").write_text("".join(lines[:-1]))
    resumed = runner.run(setup(out))
    assert resumed.results.keys == first.results.keys
    assert set(lines[:-1]) <= set((out / "runs.csv").read_text().splitlines(keepends=True))

    more = runner.run(setup(out, solvers=["clarabel"], accuracies=(1e-5,)))
    assert len(more.results.runs) == 4


def test_runs_of_an_instance_that_changed_are_done_again(tmp_path):
    runner.run(setup(tmp_path / "s", solvers=["clarabel"], accuracies=(1e-4,)))
    path = tmp_path / "s" / "runs.csv"
    (digest,) = Results(tmp_path / "s").runs["hash"]
    path.write_text(path.read_text().replace(digest, "0" * 16))
    outcome = runner.run(setup(tmp_path / "s", solvers=["clarabel"], accuracies=(1e-4,)))
    assert any("changed" in note for note in outcome.notes)
    assert list(outcome.results.runs["hash"]) == [digest]


def test_folders_that_hold_something_else_are_refused(tmp_path):
    (tmp_path / "table_III.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="holds other files"):
        Results(tmp_path)
    other = tmp_path / "other"
    other.mkdir()
    (other / "runs.csv").write_text("run,result\n1,2\n")
    with pytest.raises(InputError, match="something else"):
        Results(other)
    (other / "runs.csv").write_text(",".join(COLUMNS) + "\na,b\n" + "," * (len(COLUMNS) - 1) + "\n")
    with pytest.raises(InputError, match="a row is damaged"):
        Results(other)


def test_the_time_limit_ends_one_cell_and_tighter_ones_are_not_tried(tmp_path):
    outcome = runner.run(setup(tmp_path / "s", solvers=["penalty"], time_limit=1e-3))
    runs = outcome.results.runs.set_index("settings")
    kinds = dict(zip(runs.index, zip(runs["class"], runs["remark"], strict=True), strict=True))
    assert kinds["1e-04"][0] == kinds["1e-06"][0] == "timeout"
    assert "not run" in kinds["1e-06"][1]


@pytest.mark.parametrize("accuracies", [(), (0.0,), (2.0,)])
def test_senseless_settings_are_refused(tmp_path, accuracies):
    with pytest.raises(InputError, match="--accuracy"):
        setup(tmp_path, accuracies=accuracies)


def test_nobody_at_the_address(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(cluster, "_PATIENCE", 0.5)
    with pytest.raises(InputError, match="no Dask scheduler answers"):
        runner.run(setup(tmp_path / "s", scheduler="tcp://127.0.0.1:9"))
