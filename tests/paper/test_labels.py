"""No label calls repeated motion held out or unseen: captions of tables, figures and
results are walked."""

import re
from pathlib import Path

import numpy as np
import pytest
from committed import RESULTS, TABLES
from studies import MeasuredStudy

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.paper.tables import build_tables, study
from sdp_vs_penalty.paper.tables.folds import interval_of

HELD_OUT = re.compile(r"held[- ]out", re.IGNORECASE)
NOTES = Path(study.__file__).with_name("notes")
FIGURES = Path(study.__file__).parents[1] / "figures"


@pytest.fixture(scope="module")
def table():
    """Table IV of a small study with measured rows of both kinds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "METHODS", {"ols": "ols", "lmi_sdp": "lmi-sdp"})
        yield build_tables(["IV"], MeasuredStudy(load_problem("two_link")))[0]


def texts():
    """Captions that the program writes, and those that were written."""
    for path in sorted(NOTES.glob("*.md")):
        yield path.name, path.read_text()
    for path in sorted(FIGURES.glob("*.py")):
        yield path.name, path.read_text()
    for path in sorted(RESULTS.glob("**/table_*.md")) if RESULTS.is_dir() else ():
        yield str(path.relative_to(RESULTS)), path.read_text()


def test_no_caption_says_held_out():
    captions = dict(texts())
    assert captions
    assert [name for name, text in captions.items() if HELD_OUT.search(text)] == []


def test_every_row_says_on_which_motion_it_is_judged(table):
    kinds = {"simulated", "measured, unseen", "measured, repeated", "published"}
    assert set(table.frame["data"]) <= kinds
    named = table.frame["estimate"].str.endswith("repeatability")
    assert (table.frame["data"][named] == "measured, repeated").all()
    assert (table.frame["data"][~named] != "measured, repeated").all()


def test_the_run_after_the_cut_is_repeated_motion():
    judged = MeasuredStudy(load_problem("two_link")).judged
    assert [data.judged_on for data in judged] == ["unseen motion", "repeated motion"]


def test_an_interval_holds_its_mean_and_is_students():
    """Of 1, 2, 3: mean 2, standard error 1 / sqrt(3), t of two degrees 4.303."""
    found = interval_of(np.array([1.0, 2.0, 3.0]))
    assert found.value == pytest.approx(2.0)
    assert found.upper - found.value == pytest.approx(4.3027 / 3.0**0.5, rel=1e-4)


def test_a_table_as_printed_has_at_most_eleven_columns(table):
    assert len(table.frame.columns) <= 11
    assert table.everything is not None
    assert set(table.frame.columns) < set(table.everything.columns)


@pytest.mark.parametrize("name", ["III", "VIII", "IX", "IV"])
def test_committed_tables_have_at_most_eleven_columns_and_two_ends(name):
    header = (TABLES / f"table_{name}.csv").read_text().splitlines()[0]
    assert header.count(",") < (13 if name in ("VIII", "IX") else 11)
