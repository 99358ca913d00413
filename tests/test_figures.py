"""Figures in README and docs are those of results/: a comment behind a number names its cell.

    93.2<!--coverage_in_life.md | closed loop; friction | coverage [%]--> %

File in results/, cells of its row, heading of its column; the sentence's digits decide how exact. Or it
names the test that compares it, 16.5<!--tests/reports/test_demo.py-->. What else has a unit is a
definition, a limit or a length of data: UNMARKED counts them; a new one is marked, or counted by hand.
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
UNIT = re.compile(rf"(?<![\w@=.:-]){NUMBER}\s?(?:%|ms|s|MB|GB|mm|N m|kg|times|of \d+)(?![\w/^])")
#: Numbers with a unit that are no results, page by page.
#: security.md is left out: each row of its table names the test, or says that it was done by hand.
#: Of benchmarks.md those of logs without torque are results, which a benchmark that has left printed.
UNMARKED = {
    "README.md": 1,
    "results/README.md": 17,
    "docs/README.md": 1,
    "docs/benchmarks.md": 24,
    "docs/concepts.md": 9,
    "docs/coupled-wrist.md": 1,
    "docs/files.md": 1,
    "docs/glossary.md": 1,
    "docs/how-to.md": 1,
    "docs/large-data.md": 1,
    "docs/performance.md": 2,
    "docs/tutorial.md": 3,
    "docs/unseen-motion.md": 6,
    "docs/your-robot.md": 2,
}


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
    assert not wrong(page.read_text())


@pytest.mark.parametrize(
    "page", [p for p in PAGES if p.name != "security.md"], ids=lambda p: f"{p.parent.name}/{p.name}"
)
def test_every_result_is_marked(page):
    text = page.read_text()
    for test in TESTED.findall(text):
        assert page.name in (ROOT / test).read_text(), f"{test} does not read {page.name}"
    prose = re.sub(r"```.*?```|`[^`]*`", "", TESTED.sub("", MARK.sub("", text)), flags=re.DOTALL)
    found = UNIT.findall(prose)
    assert len(found) <= UNMARKED.get(str(page.relative_to(ROOT)), 0), found


def test_a_stale_figure_is_found():
    said = "7.1<!--coverage_in_life.md | closed loop; friction | coverage [%]-->"
    assert wrong(said)
    with pytest.raises(AssertionError, match="no row"):
        wrong(said.replace("friction", "fraction"))
    assert sum(len(MARK.findall(page.read_text())) for page in PAGES) >= 10
