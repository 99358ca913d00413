"""Figures in README and docs are those of results/: a comment behind a number names its cell.

    93.2<!--coverage_in_life.md | closed loop; friction | coverage [%]--> %

File in results/, cells of its row, heading of its column; the sentence's digits decide how exact. Or it
names the test that compares it, 16.5<!--tests/reports/test_demo.py-->, which then reads that page.
"""

import csv
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "results" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
NUMBER = r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?"
MARK = re.compile(rf"({NUMBER})<!--([^|>]+)\|([^|>]+)\|([^>]+?)-->")
TESTED = re.compile(rf"{NUMBER}<!--(tests/[\w/]+\.py)-->")


def cell(file: str, words: str, column: str) -> str:
    """The cell of the first row that holds all words (between semicolons), in any table of the file."""
    path, wanted = ROOT / "results" / file, [w.strip() for w in words.split(";")]
    if path.suffix == ".csv":
        rows = list(csv.reader(path.read_text().splitlines()))
    else:
        lines = (line.strip() for line in path.read_text().splitlines())
        rows = [[c.strip() for c in s.strip("|").split("|")] for s in lines if s.startswith("|")]
    heads: list[str] = []
    for row in rows:
        if column in row:
            heads = row
        elif heads and all(word in row for word in wanted):
            return row[heads.index(column)]
    raise AssertionError(f"{file}: no row with {wanted} under {column!r}")


def wrong(text: str) -> list[str]:
    """What of a page's marked figures is not its source's."""
    out = []
    for said, file, words, column in MARK.findall(text):
        source = cell(file.strip(), words.strip(), column.strip())
        found = re.search(NUMBER, source)
        assert found, f"{file}: {source!r} is no number"
        half = 0.5 * 10.0 ** -len(said.partition(".")[2])
        if abs(float(said) - float(found.group())) > half * (1.0 + 1e-9):
            out.append(f"{said} is {source} in {file} ({words})")
    return out


@pytest.mark.parametrize("page", PAGES, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_marked_figures_are_their_sources(page):
    text = page.read_text()
    assert not wrong(text)
    for test in TESTED.findall(text):
        assert page.name in (ROOT / test).read_text(), f"{test} does not read {page.name}"


def test_a_stale_figure_is_found():
    said = "7.1<!--coverage_in_life.md | closed loop; friction | coverage [%]-->"
    assert wrong(said)
    with pytest.raises(AssertionError, match="no row"):
        wrong(said.replace("friction", "fraction"))
    assert sum(len(MARK.findall(page.read_text())) for page in PAGES) >= 10
