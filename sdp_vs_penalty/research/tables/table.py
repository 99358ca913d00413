"""A table as data, and its three written forms: CSV, Markdown, LaTeX (booktabs,
siunitx)."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from string import Template
from typing import Any

import pandas

from sdp_vs_penalty.errors import printable
from sdp_vs_penalty.estimation.constants import ROUNDING
from sdp_vs_penalty.files import WRITERS_PATIENCE, folder_lock, write_text
from sdp_vs_penalty.formatting import escape_markdown, markdown_table
from sdp_vs_penalty.plugins import summary_line

#: Text is written as it is (published cells keep their printed digits), None is an
#: empty cell.
Cell = str | float | int | None
#: A row's cells by column.
Row = dict[str, Any]

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


@dataclass(frozen=True)
class TableSpec:
    """How a table is made: build(study) -> Table; about : what it is, the first line of
    build's docstring; problems : the names of those that it is about (none: any); slow
    : whether `tables --all` leaves it out."""

    name: str
    about: str
    build: Callable[[Any], Table]
    problems: tuple[str, ...] = ()
    slow: bool = False

    def made(self, study: Any) -> Table:
        """The table under its name, its caption where it gives none the study's
        sentence."""
        study.progress(f"table {self.name}")
        table = self.build(study)
        return replace(table, name=self.name, caption=table.caption or study.sentence)


def register_table(
    name: str, *problems: str, slow: bool = False
) -> Callable[[Callable[[Any], Table]], TableSpec]:
    """Decorates what builds the table of a name: its registration."""

    def register(build: Callable[[Any], Table]) -> TableSpec:
        return TableSpec(name, summary_line(build), build, problems, slow)

    return register


@dataclass(frozen=True, eq=False)
class Table:
    """rows : cells by column (published ones as printed text); notes : below the table;
    headline : what it shows, in words; digits : significant ones of a number that is shown;
    caption : says what is simulated and what measured; name : "III" is written as
    table_III.csv, .md and .tex; everything : of a table as printed all columns and rows,
    written as table_III_all.csv.
    """

    title: str
    rows: Sequence[Row] | pandas.DataFrame
    notes: Sequence[str] = ()
    headline: str = ""
    digits: int = 4
    caption: str = ""
    name: str = ""
    everything: pandas.DataFrame | None = None

    def shortened(
        self, columns: Iterable[str], rows: Iterable[bool] | None = None
    ) -> Table:
        """The table with these columns, of which those that are not there are left out,
        and rows; all of it is kept as ``everything``."""
        shown = [name for name in columns if name in self.frame]
        frame = self.frame if rows is None else self.frame[list(rows)]
        return replace(self, rows=frame[shown], everything=self.frame)

    @cached_property
    def frame(self) -> pandas.DataFrame:
        """The cells as they are; columns come in the order of their first cells."""
        return pandas.DataFrame(self.rows, dtype=object)

    def cells(self) -> pandas.DataFrame:
        """All cells as text."""
        return self.frame.map(lambda cell: text(cell, self.digits))

    def csv(self) -> str:
        """With all digits that it takes to read the same numbers back."""
        return exact_csv(self.frame)

    @property
    def measured(self) -> bool:
        """Whether anything in it comes from real measurements, as all tables name
        these."""
        words = self.frame.astype(str).apply(
            lambda column: column.str.match(r"measured([, ]|$)")
        )
        named = any(str(name).endswith("_measured") for name in self.frame)
        return named or bool(words.to_numpy().any())

    def lines(self) -> list[str]:
        """What it is, what it shows, and how large it is: a line each."""
        source = "with measured figures" if self.measured else "nothing measured"
        size = f"{len(self.frame)} rows, {len(self.frame.columns)} columns; {source}"
        return [
            self.title,
            self.headline or self.caption.split(". ")[0].rstrip(".") + ".",
            size,
        ]

    def markdown(self) -> str:
        """The title, the caption, the cells as shown, and the notes."""
        cells = self.cells().map(escape_markdown)
        headings = [escape_markdown(str(name)) for name in cells.columns]
        sides = ["---:" if _numeric(cells[name]) else ":---" for name in cells]
        lines = [f"# {escape_markdown(self.title)}", ""]
        lines += [escape_markdown(self.caption), ""]
        lines += markdown_table(headings, cells.to_numpy().tolist(), sides)
        if self.notes:
            lines += ["", *(f"- {note}" for note in self.notes)]
        return "\n".join(lines) + "\n"

    def latex(self) -> str:
        cells = self.cells()
        layout = []
        infinite = {"inf": r"{$\infty$}", "-inf": r"{$-\infty$}", "": "{}"}
        for name, column in cells.items():
            number = _numeric(column)
            cells[name] = (
                column.replace(infinite) if number else column.map(escape_latex)
            )
            # Longer text wraps.
            wide = (
                r">{\raggedright\arraybackslash}p{26em}"
                if column.str.len().max() > 80
                else "l"
            )
            layout.append("S[table-alignment-mode=marker]" if number else wide)
        header = " & ".join(map(_latex_header, cells))
        body = "\n".join(f"    {' & '.join(row)} \\\\" for row in cells.to_numpy())
        caption = escape_latex(" ".join([self.caption, *self.notes]))
        fields_of_column = {
            "title": escape_latex(self.title),
            "caption": caption,
            "name": self.name,
        }
        template = Template(Path(__file__).with_name("table.tex").read_text())
        return template.substitute(
            fields_of_column, layout=" ".join(layout), header=header, body=body
        )

    def write(self, folder: str | Path) -> list[Path]:
        """Write the three forms, and all columns where these are some, each whole or not
        at all; the paths, CSV first."""
        base = Path(folder) / f"table_{self.name}"
        forms = {".csv": self.csv(), ".md": self.markdown(), ".tex": self.latex()}
        if self.everything is not None:
            forms["_all.csv"] = exact_csv(self.everything)
        with folder_lock(Path(folder), patience=WRITERS_PATIENCE):
            for suffix, content in forms.items():
                write_text(f"{base}{suffix}", content)
        return [Path(f"{base}{suffix}") for suffix in forms]


def exact_csv(frame: pandas.DataFrame) -> str:
    """Cells with all digits that it takes to read the same numbers back."""
    exact = frame.map(
        lambda x: (
            repr(float(x)) if isinstance(x, float) and math.isfinite(x) else text(x)
        )
    )
    return str(exact.to_csv(index=False, lineterminator="\n"))


def notes(table: str, **values: object) -> list[str]:
    """What a table says below itself: the paragraphs of notes/TABLE.md beside this file
    with the values in their places, without those that are empty then."""
    written = Path(__file__).with_name("notes") / f"{table}.md"
    paragraphs = (" ".join(part.split()) for part in written.read_text().split("\n\n"))
    return [note for note in (part.format(**values) for part in paragraphs) if note]


def text(cell: Cell, digits: int = 4) -> str:
    """A cell as written: printed text untouched, numbers to ``digits`` significant
    digits."""
    if isinstance(cell, str | int):
        return printable(cell)
    if cell is None or math.isnan(cell):
        return ""
    if math.isinf(cell):
        return "inf" if cell > 0 else "-inf"
    return "0" if abs(cell) < ROUNDING else f"{cell:.{digits}g}"


def by_joint(values: Iterable[Cell], prefix: str = "joint") -> Row:
    """Cells joint_1, joint_2, ..."""
    cells = (x if isinstance(x, str) or x is None else float(x) for x in values)
    return {f"{prefix}_{j}": cell for j, cell in enumerate(cells, start=1)}


def _latex_header(name: str) -> str:
    """The data set on a line of its own, so that columns stay narrow."""
    first, _, data = name.rpartition("_")
    if data in ("simulated", "measured"):
        return rf"{{\shortstack{{{escape_latex(first)}\\{data}}}}}"
    return f"{{{escape_latex(name)}}}"


def escape_latex(plain: str) -> str:
    """Text that LaTeX sets as it is written, control characters as Python writes
    them."""
    return _LIGATURE.sub("{}", printable(plain).translate(_LATEX))


def _numeric(column: pandas.Series[str]) -> bool:
    """Whether every cell that is not empty is a number (or infinite), and one is."""
    filled = column[~column.isin(["", "inf", "-inf"])]
    return len(filled) > 0 and bool(
        filled.str.fullmatch(r"[-+]?\d+(\.\d*)?([eE][-+]?\d+)?").all()
    )
