"""THE table in its five forms."""

import csv
import io

import pytest

from sdp_vs_penalty.results import Table, cell_text

TABLE = Table(
    headings=("name", "size"),
    rows=[("a|<b>", 0.125), ("c", None)],
    title="Sizes",
    caption="Of two things.",
)
LATEX = Table(("name", "size"), [("a_b", 0.125)]).latex()


@pytest.mark.parametrize(
    ("text", "part"),
    [
        (TABLE.text(40), "Sizes\n"),
        (TABLE.text(40).splitlines()[3], "0.125"),
        (TABLE.markdown(), r"| a\|\<b> | 0.125 |"),
        (TABLE.markdown(), "| :--- | ---: |"),  # numbers at the right
        (TABLE.html(), "a|&lt;b&gt;"),
        (Table(("what",), [("run `check`",)]).html(), "run <code>check</code>"),
        (LATEX, r"\begin{tabular}{l S[table-alignment-mode=marker]}"),
        (LATEX, r"a\_b & 0.125 \\"),
    ],
)
def test_a_form_escapes_what_it_would_read_and_sets_numbers_as_such(text, part):
    assert part in text


def test_a_frame_and_json_hold_the_cells():
    assert TABLE.to_frame()["size"][0] == 0.125
    assert Table.from_dict(TABLE.to_dict()).cells() == TABLE.cells()


def test_csv_reads_back_to_the_same_numbers():
    third = 1.0 / 3.0
    text = Table(("x",), [(third,)]).csv()
    (_, (cell,)) = csv.reader(io.StringIO(text))
    assert float(cell) == third


@pytest.mark.parametrize(
    ("cell", "text"),
    [(None, ""), (float("nan"), ""), (float("inf"), "inf"), (1e-12, "0"), (3, "3")],
)
def test_a_cell_is_written(cell, text):
    assert cell_text(cell) == text
