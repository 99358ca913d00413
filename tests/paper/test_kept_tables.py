"""A table that was made before is read, and made again where what it depends on has
changed."""

from dataclasses import replace
from pathlib import Path

import pytest

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.paper import memo
from sdp_vs_penalty.paper.tables import kept, make_tables, makers


@pytest.fixture
def out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for tables, after table VI was made and kept; who makes it once more
    fails."""
    monkeypatch.setenv(memo.VARIABLE, str(tmp_path / "cache"))
    (tmp_path / "no_data").mkdir()
    monkeypatch.setenv("SDP_VS_PENALTY_DATA", str(tmp_path / "no_data"))
    make_tables(["VI"], out=tmp_path / "first")

    def build(study):
        raise AssertionError("made again")

    monkeypatch.setitem(makers(), "VI", replace(makers()["VI"], build=build))
    return tmp_path / "second"


def test_a_finished_table_is_read(out):
    """After a kill a run goes on with the first table that it had not finished."""
    make_tables(["VI"], out=out)
    for path in (out.parent / "first").iterdir():
        assert path.read_bytes() == (out / path.name).read_bytes()


def test_an_edited_program_makes_it_again(out, monkeypatch):
    monkeypatch.setattr(kept, "program_version", lambda: "another")
    with pytest.raises(AssertionError, match="made again"):
        make_tables(["VI"], out=out)


def test_another_problem_makes_it_again(out):
    heavier = replace(load_problem("two_link"), total_mass=(0.0, 16.0))
    with pytest.raises(AssertionError, match="made again"):
        make_tables(["VI"], heavier, out=out)


def test_another_budget_makes_it_again(out):
    with pytest.raises(AssertionError, match="made again"):
        make_tables(["VI"], budget="paper", out=out)


def test_a_real_run_makes_it_again(out, tmp_path, monkeypatch):
    (tmp_path / "data" / "two_link").mkdir(parents=True)
    (tmp_path / "data" / "two_link" / "run.csv").write_text("t,q1\n")
    monkeypatch.setenv("SDP_VS_PENALTY_DATA", str(tmp_path / "data"))
    with pytest.raises(AssertionError, match="made again"):
        make_tables(["VI"], out=out)
