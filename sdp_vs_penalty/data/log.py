"""A log before anyone knows what its columns are: what every adapter makes of a file."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

#: Rows by which a column is described.
ROWS_DESCRIBED = 50


@dataclass(frozen=True)
class Column:
    """One column of a log."""

    #: What its cells hold: "number", "list" (a block), "stamp", "text" or "empty".
    kind: str = "number"
    #: Its first cells that are not empty, as texts.
    cells: Sequence[str] = ()
    #: Unit that the file's metadata say; "" where they say none.
    unit: str = ""
    #: Quantity ("q", "dq", "tau") that they say, or "".
    quantity: str = ""
    #: Joint, or joints of a block, that they name.
    joints: tuple[str, ...] = ()
    #: Name among the log's clocks of its own stamps; "" where it has a value in every
    #: row.
    clock: str = ""
    #: What of the file it comes from: a topic of messages; "" where that says nothing.
    source: str = ""

    @property
    def head(self) -> Array:
        """(K,) numbers in the first cells; those of lists in one row."""
        found = re.findall(
            r"[-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?", " ".join(self.cells)
        )
        return np.array(found, float)


@dataclass(frozen=True)
class Values:
    """Values of some columns of a log."""

    #: (N,) numbers or (N, n) blocks, by name; seconds of stamps.
    columns: dict[str, Array]
    #: (N,) number in the file of each row; None where row k is number k + 2.
    rows: NDArray[np.intp] | None = None
    #: (N,) whether the cell is empty, of columns with empty cells.
    gaps: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)


@dataclass(frozen=True)
class Log:
    """The named columns of a file, and how to read them."""

    #: Path of the file, for messages and commands.
    path: Path
    #: Columns by name, in the file's order; "#1", "#2" ... where it has no names.
    columns: Mapping[str, Column]
    #: Reads the values of some columns.
    read: Callable[[Sequence[str]], Values]
    #: Reads the texts of some columns: a list of cells a row.
    texts: Callable[[Sequence[str]], Sequence[Sequence[str]]] | None = None
    #: (M,) stamps by the name of a clock, in the unit of the log's own [s].
    clocks: Mapping[str, Array] = field(default_factory=dict)
    #: Sampling rate that the file's header says [Hz]; None where it says none.
    rate: float | None = None
    #: What messages call a sample.
    word: str = "sample"
    #: What to do about missing columns of what is no file; "" for a file.
    remedy: str = ""
    #: Name of the run; "" for that of the file.
    run_name: str = ""
    #: Whether each column says its quantity, joint and clock, as those of messages do.
    is_of_messages: bool = False
    #: Names that two columns or more have.
    twice: frozenset[str] = frozenset()

    @property
    def names(self) -> list[str]:
        """Names of the columns in order."""
        return list(self.columns)


def log_of_arrays(
    path: Path,
    arrays: Mapping[str, Array],
    texts: Mapping[str, Sequence[Sequence[str]]] | None = None,
    facts: Mapping[str, Mapping[str, Any]] | None = None,
    rows: NDArray[np.intp] | None = None,
    **more: Any,
) -> Log:
    """Make a log of arrays in memory.

    Parameters
    ----------
    arrays : mapping of str to array
        (N,) columns, or (N, n) and (n, N) blocks, by name.
    texts : mapping of str to sequence
        Texts of each row by the name of a column of texts.
    facts : mapping of str to mapping
        Fields of :class:`Column` that the file says, by the column's name.
    rows : (N,) array of int, optional
        Number in the file of each row.
    more : dict
        Further fields of the log.
    """
    texts = texts or {}
    columns = {name: Column("text", [str(x[0])]) for name, x in texts.items() if len(x)}
    for name, array in arrays.items():
        is_block = array.ndim > 1 and min(array.shape) > 1
        is_upright = array.ndim < 2 or array.shape[0] >= array.shape[1]
        head = (array if is_upright else array.T)[:ROWS_DESCRIBED]
        cells = [" ".join(f"{x:.15g}" for x in np.ravel(row)) for row in head]
        columns[name] = Column("list" if is_block else "number", cells)
    for name, said in (facts or {}).items():
        if name in columns:
            columns[name] = Column(**{**vars(columns[name]), **said})

    def rows_of_texts(names: Sequence[str]) -> list[list[str]]:
        return [
            [x for cell in row for x in cell]
            for row in zip(*(texts[n] for n in names), strict=True)
        ]

    def read(names: Sequence[str]) -> Values:
        return Values({name: arrays[name] for name in names}, rows)

    return Log(path, columns, read, rows_of_texts if texts else None, **more)


def real_numbers(path: Path, name: str, array: Any) -> Array:
    """Convert an array of a file, of any type and shape, to floating-point numbers, at
    least (1,); raise InputError where it holds anything but real numbers."""
    if array.dtype.kind not in "fiu":
        what = f"array {name} holds {array.dtype}, not real numbers"
        raise InputError(what, "save it as floating-point numbers", path)
    with np.errstate(over="ignore"):  # a longer number becomes infinite: refused later
        return np.atleast_1d(np.asarray(array, float))
