"""A table as data, and its three written forms: CSV, Markdown, LaTeX (booktabs, siunitx)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING

from sdp_vs_penalty.estimation.constants import ROUNDING
from sdp_vs_penalty.files import as_csv, write_text

if TYPE_CHECKING:
    import pandas

#: Text is written as it is (published cells keep their printed digits), None is an empty cell.
Cell = str | float | int | None

#: LaTeX: text columns longer than this (characters) wrap.
_WRAPPED = 80
_NUMBER = re.compile(r"([-+]?)(\d+)(?:\.(\d*))?(?:[eE]([-+]?)(\d+))?")
_LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "_": r"\_",
    "%": r"\%",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
}


@dataclass(frozen=True)
class Column:
    """name : the header, the same in all three forms; digits : significant ones of a float."""

    name: str
    digits: int = 4


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
        cells = self.cells()
        numeric = _numeric_columns(cells, len(self.columns))
        lines = [
            f"# {self.title}",
            "",
            self.caption,
            "",
            _markdown_row([column.name for column in self.columns]),
            _markdown_row(["---:" if n else ":---" for n in numeric], escape=False),
            *(_markdown_row(row) for row in cells),
        ]
        if self.notes:
            lines += ["", *(f"- {note}" for note in self.notes)]
        return "\n".join(lines) + "\n"

    def latex(self) -> str:
        cells = self.cells()
        numeric = _numeric_columns(cells, len(self.columns))
        for row in cells:
            row[:] = [plain_number(c) if n else c for c, n in zip(row, numeric, strict=True)]
        layout = []
        for k, is_number in enumerate(numeric):
            column = [row[k] for row in cells]
            layout.append(number_column(column) if is_number else _text_column(column))
        header = " & ".join(_latex_header(column.name) for column in self.columns)
        infinite = {"inf": r"{$\infty$}", "-inf": r"{$-\infty$}", "": "{}"}
        body = []
        for row in cells:
            both = zip(row, numeric, strict=True)
            written = (infinite.get(c, c) if n else escape_latex(c) for c, n in both)
            body.append(" & ".join(written) + r" \\")
        caption = " ".join([self.caption, *self.notes])
        return "\n".join(
            [
                r"% Needs \usepackage{array,booktabs,siunitx,graphicx}.",
                r"\begin{table*}",
                r"  \centering",
                rf"  \caption{{{escape_latex(self.title)}. {escape_latex(caption)}}}",
                rf"  \label{{tab:{self.name}}}",
                r"  \resizebox{\textwidth}{!}{%",
                rf"  \begin{{tabular}}{{{' '.join(layout)}}}",
                r"    \toprule",
                rf"    {header} \\",
                r"    \midrule",
                *(f"    {line}" for line in body),
                r"    \bottomrule",
                r"  \end{tabular}}",
                r"\end{table*}",
                "",
            ]
        )

    def write(self, folder: str | Path) -> list[Path]:
        """Write the three forms, each whole or not at all; the paths, CSV first."""
        base = Path(folder) / f"table_{self.name}"
        paths = []
        for suffix, content in ((".csv", self.csv()), (".md", self.markdown()), (".tex", self.latex())):
            path = base.with_name(base.name + suffix)
            write_text(path, content)
            paths.append(path)
        return paths


def text(cell: Cell, digits: int = 4) -> str:
    """A cell as written: printed text untouched, numbers to ``digits`` significant digits."""
    if cell is None:
        return ""
    if isinstance(cell, str):
        return cell
    if isinstance(cell, int):
        return str(cell)
    if math.isnan(cell):
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


def number_column(cells: Sequence[str]) -> str:
    """siunitx's column type S with the format that the widest of these numbers needs."""
    whole = decimals = exponent = 0
    sign = exponent_sign = ""
    for cell in cells:
        match = _NUMBER.fullmatch(cell)
        if match is None:
            continue
        sign = "-" if match[1] == "-" else sign
        whole = max(whole, len(match[2]))
        decimals = max(decimals, len(match[3] or ""))
        exponent = max(exponent, len(match[5].lstrip("0") or "0") if match[5] else 0)
        exponent_sign = "-" if match[4] == "-" else exponent_sign
    power = f"e{exponent_sign}{exponent}" if exponent else ""
    return f"S[table-format={sign}{whole or 1}.{decimals}{power}]"


def plain_number(cell: str, longest: int = 6) -> str:
    """A number without its power of ten up to the ``longest``, all digits kept: 5.46e-01 -> 0.546."""
    match = _NUMBER.fullmatch(cell)
    if match is None or match[5] is None or int(match[5]) > longest:
        return cell
    return f"{Decimal(cell):f}"


def _text_column(cells: Sequence[str]) -> str:
    longest = max((len(cell) for cell in cells), default=0)
    return "l" if longest <= _WRAPPED else r">{\raggedright\arraybackslash}p{26em}"


def _latex_header(name: str) -> str:
    """The data set on a line of its own, so that columns stay narrow."""
    for ending in ("_simulated", "_measured"):
        if name.endswith(ending):
            return rf"{{\shortstack{{{escape_latex(name.removesuffix(ending))}\\{ending[1:]}}}}}"
    return f"{{{escape_latex(name)}}}"


def escape_latex(plain: str) -> str:
    return "".join(_LATEX.get(character, character) for character in plain)


def _numeric_columns(cells: Sequence[Sequence[str]], count: int) -> list[bool]:
    """Columns in which every cell that is not empty is a number (or infinite), and one is."""
    out = []
    for k in range(count):
        filled = [row[k] for row in cells if row[k] not in ("", "inf", "-inf")]
        out.append(bool(filled) and all(_NUMBER.fullmatch(cell) for cell in filled))
    return out


def _markdown_row(cells: Sequence[str], escape: bool = True) -> str:
    if escape:
        cells = [cell.replace("|", "\\|").replace("\n", " ") for cell in cells]
    return "| " + " | ".join(cells) + " |"
