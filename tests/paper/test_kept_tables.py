"""A table that was made before is read, and made again where what it depends on has
changed."""

from dataclasses import replace

import pytest

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.paper import memo
from sdp_vs_penalty.paper.tables import kept, make_tables, makers


@pytest.fixture
def out(tmp_path, monkeypatch):
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


def with_run(folder):
    """A folder of measurements that has a run of the 2R."""
    (folder / "data" / "two_link").mkdir(parents=True)
    (folder / "data" / "two_link" / "run.csv").write_text("t,q1\n")
    return str(folder / "data")


@pytest.mark.parametrize("change", ["program", "problem", "budget", "run"])
def test_what_a_table_depends_on_makes_it_again(change, out, tmp_path, monkeypatch):
    if change == "program":
        monkeypatch.setattr(kept, "program_version", lambda: "another")
    if change == "run":
        monkeypatch.setenv("SDP_VS_PENALTY_DATA", with_run(tmp_path))
    heavier = replace(load_problem("two_link"), total_mass=(0.0, 16.0))
    options = {"problem": {"problem": heavier}, "budget": {"budget": "paper"}}
    with pytest.raises(AssertionError, match="made again"):
        make_tables(["VI"], **options.get(change, {}), out=out)
