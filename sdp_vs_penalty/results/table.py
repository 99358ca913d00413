"""THE table: headings and rows, written as text, Markdown, HTML, LaTeX or CSV."""

from __future__ import annotations

import csv
import io
import math
import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from sdp_vs_penalty.errors import printable
from sdp_vs_penalty.files import read_text
from sdp_vs_penalty.formatting import escape_markdown
from sdp_vs_penalty.records import JsonRecord

if TYPE_CHECKING:
    import pandas

#: Text is written as it is (published cells keep their printed digits), None is an
#: empty cell.
Cell = str | float | int | None
#: What is smaller is rounding: it is written as 0.
ROUNDING = 1e-9

_HERE = Path(__file__).parent
_NUMBER = re.compile(r"[-+]?\d+(\.\d*)?([eE][-+]?\d+)?")
#: Of the characters that LaTeX has as commands.
_NAMED = "backslash asciicircum asciitilde less greater bar"
_LATEX = str.maketrans(
    {c: rf"\{c}" for c in "{}$&#_%"}
    | {
        c: rf"\text{name}{{}}"
        for c, name in zip("\\^~<>|", _NAMED.split(), strict=True)
    }
)
#: Between two characters of which LaTeX would make one: a dash, a quotation mark.
_LIGATURE = re.compile("(?<=-)(?=-)|(?<=`)(?=`)|(?<=')(?=')|(?<=[?!])(?=`)")
#: Letters of a line of a heading in a terminal.
_WIDEST_HEADING = 11
#: Letters up to which words are not broken.
_SHORT = 12
#: Letters of a word that a column is not made narrower than.
_LONGEST_WORD = 24
#: Longer text wraps in LaTeX.
_WRAPPED = 80


@dataclass(frozen=True, eq=False)
class Table(JsonRecord):
    """A table of words and numbers, for terminal, HTML, Markdown, CSV and LaTeX."""

    #: Headings of the columns.
    headings: Sequence[str]
    #: Cells, row by row.
    rows: Sequence[Sequence[Cell]]
    #: Line above the table.
    title: str = ""
    #: What the table shows, in words.
    caption: str = ""
    #: Notes below the table, a sentence each.
    notes: Sequence[str] = ()
    #: Label of the table in LaTeX.
    name: str = ""
    #: Significant digits of numbers.
    digits: int = 4
    #: Columns (from 0) that hold words and stand left.
    words: Sequence[int] = (0,)
    #: CSS classes of each row.
    row_classes: Sequence[str] = ()
    #: CSS classes of the table.
    style: str = ""

    def cells(self) -> list[list[str]]:
        """Return every cell as text, row by row."""
        return [[cell_text(cell, self.digits) for cell in row] for row in self.rows]

    def columns(self) -> list[list[str]]:
        """Return every cell as text, column by column."""
        rows = self.cells()
        return [[row[k] for row in rows] for k in range(len(self.headings))]

    def numeric(self) -> list[bool]:
        """Return for each column whether it holds numbers, which are aligned right:
        ``words`` does not list it.
        """
        return [k not in self.words for k in range(len(self.headings))]

    def __rich__(self) -> Any:
        """Return the table as an object of the library rich, which prints it in a
        terminal.

        Numbers are aligned right. Numbers, the first column and short texts stay on one
        line.
        """
        from rich import box
        from rich.markup import escape
        from rich.table import Table as Grid

        grid = Grid(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
        for k, column in enumerate(self.columns()):
            is_number = self.numeric()[k]
            heading = _in_lines(printable(self.headings[k]))
            longest = max(map(len, column), default=0)
            is_one_line = k == 0 or is_number or longest <= _SHORT
            grid.add_column(
                escape(heading),
                justify="right" if is_number else "left",
                no_wrap=is_one_line,
                min_width=self._widths[k],
                overflow="fold",
            )
        for row in self.cells():
            grid.add_row(*[escape(printable(cell)) for cell in row])
        return grid

    @cached_property
    def _widths(self) -> list[int]:
        """Smallest width of each column [characters] at which a terminal cuts nothing.

        Numbers, short texts and the first column need one line. Long texts break
        between words, but not within a word of up to _LONGEST_WORD (24) characters.
        """
        widths = []
        columns = zip(self.columns(), self.numeric(), strict=True)
        for k, (column, is_number) in enumerate(columns):
            heading_lines = _in_lines(printable(self.headings[k])).splitlines()
            longest = max(map(len, column), default=0)
            is_wrapped = k > 0 and not is_number and longest > _SHORT
            if is_wrapped:
                words = [word for cell in column for word in cell.split()]
                longest_word = max(map(len, words), default=0)
                longest = min(longest_word, _LONGEST_WORD)
            widths.append(max([longest, *map(len, heading_lines)]))
        return widths

    @property
    def least_width(self) -> int:
        """Width of a line [characters] below which a terminal would cut the table.

        Each column has two characters of margin.
        """
        return sum(self._widths) + 2 * len(self._widths)

    def blocks(self, width: int) -> list[Table]:
        """Split a table that is too wide for a terminal into several, column by column.

        Parameters
        ----------
        width : int
            Width of a line [characters].

        Returns
        -------
        list of Table
            Each repeats the first column; only the first table has the title.
        """
        first, *others = range(len(self.headings))
        margin = 2  # characters between two columns
        groups: list[list[int]] = []  # columns of each block
        used = width + 1  # as if a block were full: the first column begins one
        for k in others:
            needed = self._widths[k] + margin
            if used + needed > width:
                groups.append([first])
                used = self._widths[first] + margin
            groups[-1].append(k)
            used += needed
        if not groups:
            return [self]
        blocks = [
            replace(
                self,
                headings=[self.headings[k] for k in columns],
                rows=[[row[k] for k in columns] for row in self.rows],
                words=[place for place, k in enumerate(columns) if k in self.words],
            )
            for columns in groups
        ]
        return [blocks[0], *(replace(block, title="") for block in blocks[1:])]

    def text(self, width: int = 100) -> str:
        """Return the table as it is printed in a terminal of this width
        [characters].
        """
        from rich.console import Console

        out = io.StringIO()
        Console(file=out, width=width, highlight=False).print(self)
        lines = [line.rstrip() for line in out.getvalue().splitlines()]
        return "\n".join([*([self.title] if self.title else []), *lines]) + "\n"

    def markdown(self) -> str:
        """Return the table in Markdown: title as a heading, caption above, notes as a
        list below.

        Special characters of title, caption and cells are escaped; notes are Markdown
        already.
        """
        lines: list[str] = []
        if self.title:
            lines += [f"# {escape_markdown(self.title)}", ""]
        if self.title or self.caption:
            lines += [escape_markdown(self.caption), ""]
        rows = [[escape_markdown(cell) for cell in row] for row in self.cells()]
        headings = [escape_markdown(heading) for heading in self.headings]
        sides = ["---:" if is_number else ":---" for is_number in self.numeric()]
        lines += markdown_lines(headings, rows, sides)
        if self.notes:
            lines += ["", *(f"- {note}" for note in self.notes)]
        return "\n".join(lines) + "\n"

    def html(self) -> str:
        """Return the table as an HTML <table>.

        All text is escaped; text between backticks becomes <code>.
        """
        # jinja2 takes 40 ms to import.
        from sdp_vs_penalty.results.templates import render

        rows = self.cells()
        numeric = self.numeric() or [False] * len(rows[0] if rows else ())
        classes = self.row_classes or [""] * len(rows)
        return render(
            "table.html",
            headings=self.headings,
            rows=[
                {"style": style, "cells": list(zip(row, numeric, strict=True))}
                for row, style in zip(rows, classes, strict=True)
            ],
            numeric=numeric,
            style=self.style,
        )

    def latex(self) -> str:
        """Return the table as LaTeX: a floating table with booktabs and siunitx.

        siunitx aligns columns of numbers at the decimal marker; long texts wrap.
        """
        infinite = {"inf": r"{$\infty$}", "-inf": r"{$-\infty$}", "": "{}"}
        columns = []
        layout = []
        for column, is_number in zip(self.columns(), self.numeric(), strict=True):
            if is_number:
                columns.append([infinite.get(cell, cell) for cell in column])
                layout.append("S[table-alignment-mode=marker]")
                continue
            columns.append([escape_latex(cell) for cell in column])
            is_long = max(map(len, column), default=0) > _WRAPPED
            layout.append(r">{\raggedright\arraybackslash}p{26em}" if is_long else "l")
        rows = zip(*columns, strict=True)
        return _latex_template().substitute(
            title=escape_latex(self.title),
            caption=escape_latex(" ".join([self.caption, *self.notes])),
            name=self.name,
            layout=" ".join(layout),
            header=" & ".join(map(_latex_header, self.headings)),
            body="\n".join(f"    {' & '.join(row)} \\\\" for row in rows),
        )

    def csv(self) -> str:
        """Return the table as CSV, with all digits that restore the same numbers."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(self.headings)
        for row in self.rows:
            writer.writerow(
                repr(float(cell))
                if isinstance(cell, float) and math.isfinite(cell)
                else cell_text(cell)
                for cell in row
            )
        return out.getvalue()

    def to_frame(self) -> pandas.DataFrame:
        """Return the table as a pandas data frame with the unformatted cells."""
        import pandas

        rows = [list(row) for row in self.rows]
        return pandas.DataFrame(rows, columns=list(self.headings))


def _in_lines(heading: str) -> str:
    """Break a heading into short lines, so that a column of numbers stays narrow."""
    return "\n".join(textwrap.wrap(heading, _WIDEST_HEADING)) or heading


@cache
def _latex_template() -> Template:
    """Read the LaTeX template of a table, once."""
    return Template(read_text(_HERE / "table.tex"))


def cell_text(cell: Cell, digits: int = 4) -> str:
    """Return a cell as it is printed: text unchanged, numbers with significant digits.

    A number smaller than ROUNDING is written as 0, an unknown one as "".

    >>> cell_text(0.12345), cell_text(None), cell_text("1.50"), cell_text(1e-12)
    ('0.1235', '', '1.50', '0')
    """
    if isinstance(cell, str | int):
        return printable(cell)
    if cell is None or math.isnan(cell):
        return ""
    if math.isinf(cell):
        return "inf" if cell > 0 else "-inf"
    return "0" if abs(cell) < ROUNDING else f"{cell:.{digits}g}"


def is_numeric(cells: Sequence[str]) -> bool:
    """Return whether a column holds numbers: all cells that are not empty are numbers,
    and there is at least one.

    Cells "inf" and "-inf" count as empty.
    """
    filled = [cell for cell in cells if cell not in ("", "inf", "-inf")]
    return bool(filled) and all(_NUMBER.fullmatch(cell) for cell in filled)


def markdown_lines(
    headings: Sequence[str], rows: Iterable[Sequence[str]], sides: Sequence[str] = ()
) -> list[str]:
    """Return the lines of a Markdown table; ``sides`` aligns the columns, "---:" to the
    right, by default as Markdown decides."""
    marks = sides or ["---"] * len(headings)
    return [f"| {' | '.join(cells)} |" for cells in (headings, marks, *rows)]


def _latex_header(heading: str) -> str:
    """Return a column heading in LaTeX braces, so that siunitx does not read it as a
    number.

    A heading that ends with the kind of data, such as "loss_measured", has two lines,
    so that its column stays narrow.
    """
    first, _, data = heading.rpartition("_")
    if data in ("simulated", "measured"):
        return rf"{{\shortstack{{{escape_latex(first)}\\{data}}}}}"
    return f"{{{escape_latex(heading)}}}"


def escape_latex(plain: str) -> str:
    """Escape text so that LaTeX prints it literally.

    Control characters are written as Python does; ligatures are separated by {}.
    """
    return _LIGATURE.sub("{}", printable(plain).translate(_LATEX))
