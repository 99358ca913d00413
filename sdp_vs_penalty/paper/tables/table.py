"""A table as data, and its three written forms: CSV, Markdown, LaTeX (booktabs, siunitx)."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sdp_vs_penalty.estimation.constants import ROUNDING
from sdp_vs_penalty.files import as_csv, write_text
from sdp_vs_penalty.formatting import markdown_table

if TYPE_CHECKING:
    import pandas

#: Text is written as it is (published cells keep their printed digits), None is an empty cell.
Cell = str | float | int | None
#: A row's cells by column.
Row = dict[str, Any]

#: LaTeX: text columns longer than this (characters) wrap.
_WRAPPED = 80
#: Of the characters that LaTeX has as commands.
_NAMED = "backslash asciicircum asciitilde less greater bar"
_NUMBER = re.compile(r"[-+]?\d+(\.\d*)?([eE][-+]?\d+)?")
_LATEX = str.maketrans(
    {c: rf"\{c}" for c in "{}$&#_%"}
    | {c: rf"\text{name}{{}}" for c, name in zip("\\^~<>|", _NAMED.split(), strict=True)}
)


@dataclass(frozen=True)
class Column:
    """name : the header, the same in all three forms; digits : significant ones of a float."""

    name: str
    digits: int = 4


@dataclass(frozen=True)
class Maker:
    """How a table is made: build(study) -> Table; about : what it is, in its first line; problems : the
    names of those that it is about (none: any); slow : whether `tables --all` leaves it out."""

    name: str
    about: str | None
    build: Callable[[Any], Table]
    problems: tuple[str, ...] = ()
    slow: bool = False


@dataclass(frozen=True)
class Table:
    """name : "III" is written as table_III.csv, .md and .tex; caption : says what is simulated and
    what measured; rows : one cell a column; notes : below the table; gist : what it shows, in words.
    """

    name: str
    title: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()
    gist: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.name}: {len(row)} cells in {len(self.columns)} columns")

    @classmethod
    def of(
        cls,
        name: str,
        title: str,
        caption: str,
        rows: Sequence[Row],
        notes: Sequence[str] = (),
        gist: str = "",
        digits: int = 4,
    ) -> Table:
        """Rows as cells by column; columns come in the order of their first cells."""
        names = dict.fromkeys(key for row in rows for key in row)
        cells = tuple(tuple(row.get(key) for key in names) for row in rows)
        columns = tuple(Column(key, digits) for key in names)
        return cls(name, title, caption, columns, cells, tuple(notes), gist)

    def cells(self) -> list[list[str]]:
        """All cells as text."""
        return [
            [text(cell, column.digits) for cell, column in zip(row, self.columns, strict=True)]
            for row in self.rows
        ]

    def to_frame(self) -> pandas.DataFrame:
        """The cells as they are (published ones as printed text), for a notebook."""
        import pandas

        return pandas.DataFrame(self.rows, columns=[column.name for column in self.columns])

    def csv(self) -> str:
        cells = ([exact(cell) for cell in row] for row in self.rows)
        return as_csv([column.name for column in self.columns], cells)

    @property
    def measured(self) -> bool:
        """Whether anything in it comes from real measurements."""
        return is_measured([column.name for column in self.columns], self.rows)

    def lines(self) -> list[str]:
        """What it is, what it shows, and how large it is: a line each."""
        source = "with measured figures" if self.measured else "nothing measured"
        size = f"{len(self.rows)} rows, {len(self.columns)} columns; {source}"
        return [self.title, self.gist or self.caption.split(". ")[0].rstrip(".") + ".", size]

    def markdown(self) -> str:
        cells = [[c.replace("|", "\\|").replace("\n", " ") for c in row] for row in self.cells()]
        head, _, *rows = markdown_table([column.name for column in self.columns], cells)
        sides = ["---:" if n else ":---" for n in _numeric_columns(cells, len(self.columns))]
        notes = ["", *(f"- {note}" for note in self.notes)] if self.notes else []
        lines = [
            f"# {self.title}",
            "",
            self.caption,
            "",
            head,
            f"| {' | '.join(sides)} |",
            *rows,
            *notes,
        ]
        return "\n".join(lines) + "\n"

    def latex(self) -> str:
        cells = self.cells()
        infinite = {"inf": r"{$\infty$}", "-inf": r"{$-\infty$}", "": "{}"}
        layout, columns = [], []
        for column, number in zip(
            zip(*cells, strict=True), _numeric_columns(cells, len(self.columns)), strict=True
        ):
            wrapped = max(map(len, column)) > _WRAPPED
            text_column = r">{\raggedright\arraybackslash}p{26em}" if wrapped else "l"
            layout.append("S[table-alignment-mode=marker]" if number else text_column)
            columns.append([infinite.get(c, c) if number else escape_latex(c) for c in column])
        header = " & ".join(_latex_header(column.name) for column in self.columns)
        body = "\n".join(f"    {' & '.join(row)} \\\\" for row in zip(*columns, strict=True))
        caption = escape_latex(" ".join([self.caption, *self.notes]))
        return rf"""% Needs \usepackage{{array,booktabs,siunitx,graphicx}}.
\begin{{table*}}
  \centering
  \caption{{{escape_latex(self.title)}. {caption}}}
  \label{{tab:{self.name}}}
  \resizebox{{\textwidth}}{{!}}{{%
  \begin{{tabular}}{{{" ".join(layout)}}}
    \toprule
    {header} \\
    \midrule
{body}
    \bottomrule
  \end{{tabular}}}}
\end{{table*}}
"""

    def write(self, folder: str | Path) -> list[Path]:
        """Write the three forms, each whole or not at all; the paths, CSV first."""
        base = Path(folder) / f"table_{self.name}"
        forms = {".csv": self.csv(), ".md": self.markdown(), ".tex": self.latex()}
        for suffix, content in forms.items():
            write_text(f"{base}{suffix}", content)
        return [Path(f"{base}{suffix}") for suffix in forms]


def text(cell: Cell, digits: int = 4) -> str:
    """A cell as written: printed text untouched, numbers to ``digits`` significant digits."""
    if isinstance(cell, str | int):
        return str(cell)
    if cell is None or math.isnan(cell):
        return ""
    if math.isinf(cell):
        return "inf" if cell > 0 else "-inf"
    return "0" if abs(cell) < ROUNDING else f"{cell:.{digits}g}"


def exact(cell: Cell) -> str:
    """A cell to compute with: a number with all digits that it takes to read the same one back."""
    if isinstance(cell, float) and math.isfinite(cell):
        return repr(float(cell))
    return text(cell)


def is_measured(names: Sequence[str], rows: Iterable[Sequence[Cell]]) -> bool:
    """Whether a table with these columns and rows holds measured figures, as all tables name them."""
    if any(name.endswith("_measured") for name in names):
        return True
    words = (str(cell) for row in rows for cell in row if isinstance(cell, str))
    return any(word == "measured" or word.startswith(("measured,", "measured ")) for word in words)


def _latex_header(name: str) -> str:
    """The data set on a line of its own, so that columns stay narrow."""
    for ending in ("_simulated", "_measured"):
        if name.endswith(ending):
            return rf"{{\shortstack{{{escape_latex(name.removesuffix(ending))}\\{ending[1:]}}}}}"
    return f"{{{escape_latex(name)}}}"


def escape_latex(plain: str) -> str:
    return plain.translate(_LATEX)


def _numeric_columns(cells: Sequence[Sequence[str]], count: int) -> list[bool]:
    """Columns in which every cell that is not empty is a number (or infinite), and one is."""
    filled = [[r[k] for r in cells if r[k] not in ("", "inf", "-inf")] for k in range(count)]
    return [bool(column) and all(map(_NUMBER.fullmatch, column)) for column in filled]
