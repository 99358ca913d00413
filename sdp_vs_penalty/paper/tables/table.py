"""A table of a study as data, written as CSV, Markdown and LaTeX (results/table.py)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas

from sdp_vs_penalty.files import WRITERS_PATIENCE, folder_lock, write_text
from sdp_vs_penalty.plugins import summary_line
from sdp_vs_penalty.results.table import Cell, Table, is_numeric

#: A row's cells by column.
Row = dict[str, Any]


@dataclass(frozen=True)
class TableSpec:
    """How a table is made: build(study) -> StudyTable."""

    #: Name of the table, such as "III".
    name: str
    #: What the table is: the first line of build's docstring.
    about: str
    #: Function of a study that makes the table.
    build: Callable[[Any], StudyTable]
    #: Names of the problems that the table is about; none: any.
    problems: tuple[str, ...] = ()
    #: Whether `tables --all` leaves it out.
    slow: bool = False

    def made(self, study: Any) -> StudyTable:
        """Return the table that this specification builds, with its name and caption.

        Parameters
        ----------
        study : Study
            The robot's data sets and every method's estimate, computed on demand.
        """
        study.progress(f"table {self.name}")
        table = self.build(study)
        return replace(table, name=self.name, caption=table.caption or study.sentence)


def register_table(
    name: str, *problems: str, slow: bool = False
) -> Callable[[Callable[[Any], StudyTable]], TableSpec]:
    """Return a decorator that registers the function that builds a table.

    Parameters
    ----------
    *problems : str
        Names of the problems that have this table; none for all.
    slow : bool
        Whether `tables --all` leaves it out.

    Returns
    -------
    callable
        Turns the building function into a TableSpec.
    """

    def register(build: Callable[[Any], StudyTable]) -> TableSpec:
        """Return the registration of a function that builds a table."""
        return TableSpec(name, summary_line(build), build, problems, slow)

    return register


@dataclass(frozen=True, eq=False)
class StudyTable:
    """A table, and what is said of it."""

    #: Title of the table.
    title: str
    #: Cells by column, published ones as printed text.
    rows: Sequence[Row] | pandas.DataFrame
    #: Paragraphs below the table.
    notes: Sequence[str] = ()
    #: Significant digits of a number that is shown.
    digits: int = 4
    #: Says what is simulated and what measured.
    caption: str = ""
    #: Name of the table: "III" is written as table_III.csv, .md and .tex.
    name: str = ""
    #: All columns and rows of a table as printed, written as table_III_all.csv; None
    #: without.
    everything: pandas.DataFrame | None = None

    def shortened(
        self, columns: Iterable[str], rows: Iterable[bool] | None = None
    ) -> StudyTable:
        """Return the table with some of its columns and rows shown.

        Parameters
        ----------
        columns : iterable of str
            Columns in their order; those that do not exist are left out.
        rows : iterable of bool, optional
            Whether each row is shown; by default all are.

        Returns
        -------
        StudyTable
            The full table is its ``everything``.
        """
        shown = [name for name in columns if name in self.frame]
        frame = self.frame if rows is None else self.frame[list(rows)]
        return replace(self, rows=frame[shown], everything=self.frame)

    @cached_property
    def frame(self) -> pandas.DataFrame:
        """The cells as a data frame; columns come in the order of their first cells."""
        return pandas.DataFrame(self.rows, dtype=object)

    @property
    def measured(self) -> bool:
        """Whether any figure of the table comes from real measurements.

        Rows and columns of such figures are named "measured" in all tables.
        """
        words = self.frame.astype(str).apply(
            lambda column: column.str.match(r"measured([, ]|$)")
        )
        named = any(str(name).endswith("_measured") for name in self.frame)
        return named or bool(words.to_numpy().any())

    def lines(self) -> list[str]:
        """Return three lines for a terminal: title, what it is of, and its size."""
        source = "with measured figures" if self.measured else "nothing measured"
        size = f"{len(self.frame)} rows, {len(self.frame.columns)} columns; {source}"
        return [self.title, f"{self.caption.split('. ')[0].rstrip('.')}.", size]

    @property
    def form(self) -> Table:
        """The table in the form that is written as text, Markdown, LaTeX or CSV."""
        form = replace(
            _bare(self.frame),
            title=self.title,
            caption=self.caption,
            notes=self.notes,
            name=self.name,
            digits=self.digits,
        )
        columns = enumerate(form.columns())
        return replace(form, words=[k for k, x in columns if not is_numeric(x)])

    def write(self, folder: str | Path) -> list[Path]:
        """Write the table as CSV, Markdown and LaTeX, each file atomically.

        Columns and rows that are not shown are in a further file, table_NAME_all.csv.

        Parameters
        ----------
        folder : str or Path
            Folder to write to; it is made if it does not exist.
        """
        base = Path(folder) / f"table_{self.name}"
        form = self.form
        texts = {".csv": form.csv(), ".md": form.markdown(), ".tex": form.latex()}
        if self.everything is not None:
            texts["_all.csv"] = exact_csv(self.everything)
        with folder_lock(Path(folder), patience=WRITERS_PATIENCE):
            for suffix, content in texts.items():
                write_text(f"{base}{suffix}", content)
        return [Path(f"{base}{suffix}") for suffix in texts]


def _bare(frame: pandas.DataFrame) -> Table:
    """Return a data frame as a table without words."""
    return Table(list(map(str, frame)), frame.to_numpy().tolist())


def exact_csv(frame: pandas.DataFrame) -> str:
    """Return a data frame as CSV, with all digits that restore the same numbers."""
    return _bare(frame).csv()


def notes(table: str, **values: object) -> list[str]:
    """Return the notes below a table: paragraphs of notes/TABLE.md with values filled
    in.

    Parameters
    ----------
    table : str
        Name of the file in notes/.
    **values : object
        Values by the names of their places in the text.

    Returns
    -------
    list of str
        Paragraphs that are not empty.
    """
    written = Path(__file__).with_name("notes") / f"{table}.md"
    paragraphs = (
        " ".join(part.split()) for part in written.read_text("utf-8").split("\n\n")
    )
    return [note for note in (part.format(**values) for part in paragraphs) if note]


def by_joint(values: Iterable[Cell], prefix: str = "joint") -> Row:
    """Return one cell for each joint, by the name of its column.

    Parameters
    ----------
    values : iterable of float, str or None
        One value for each joint.
    prefix : str
        Beginning of the columns' names.
    """
    cells = (x if isinstance(x, str) or x is None else float(x) for x in values)
    return {f"{prefix}_{j}": cell for j, cell in enumerate(cells, start=1)}
