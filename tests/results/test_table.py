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


def test_a_terminal_shows_title_and_rows():
    lines = TABLE.text(40).splitlines()
    assert lines[0] == "Sizes"
    assert "0.125" in lines[3]


def test_markdown_escapes_what_it_would_read():
    assert r"| a\|\<b> | 0.125 |" in TABLE.markdown()


def test_markdown_puts_numbers_at_the_right():
    assert "| :--- | ---: |" in TABLE.markdown()


def test_html_escapes_what_it_would_read():
    assert "a|&lt;b&gt;" in TABLE.html()


def test_html_shows_backticks_as_code():
    html = Table(("what",), [("run `check`",)]).html()
    assert "run <code>check</code>" in html


def test_latex_has_a_column_of_numbers():
    latex = Table(("name", "size"), [("a_b", 0.125)]).latex()
    assert r"\begin{tabular}{l S[table-alignment-mode=marker]}" in latex
    assert r"a\_b & 0.125 \\" in latex


def test_csv_reads_back_to_the_same_numbers():
    third = 1.0 / 3.0
    text = Table(("x",), [(third,)]).csv()
    (_, (cell,)) = csv.reader(io.StringIO(text))
    assert float(cell) == third


def test_a_frame_holds_the_cells_as_they_are():
    assert TABLE.to_frame()["size"][0] == 0.125


def test_a_table_comes_back_from_json():
    again = Table.from_dict(TABLE.to_dict())
    assert again.cells() == TABLE.cells()


@pytest.mark.parametrize(
    ("cell", "text"),
    [(None, ""), (float("nan"), ""), (float("inf"), "inf"), (1e-12, "0"), (3, "3")],
)
def test_a_cell_is_written(cell, text):
    assert cell_text(cell) == text
