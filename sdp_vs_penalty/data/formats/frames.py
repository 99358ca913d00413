"""What a program holds in memory: a mapping of arrays, or a data frame of pandas or
polars. It is read as the file that it came from."""

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.formats.columns import Header, table_of_arrays
from sdp_vs_penalty.data.formats.recognition import CellTable
from sdp_vs_penalty.data.formats.sparse import merged_rows
from sdp_vs_penalty.data.formats.stamps import is_stamp, past_midnight, seconds_of
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

_REMEDY = (
    "give t, q, tau and, if measured, dq: (N,) and (N, n) arrays, or the columns of"
    " RUN.csv"
)
#: Our names of the columns that a run cannot do without, or that replace another.
_OURS = re.compile(r"t|(q|dq|tau)[0-9]*")
#: How an empty cell of a column of texts is written.
_EMPTY = {"", "nan", "NaN", "NaT", "None", "<NA>"}
#: Cells by which a column of texts is judged.
_JUDGED = 20


@dataclass(frozen=True)
class Columns:
    """The columns of a mapping or data frame."""

    #: (N,) numbers or (N, n) blocks by name; dates in seconds since 1970, times of day
    #: and durations in seconds.
    numbers: Mapping[str, Array]
    #: First cells, as texts, of the columns that held dates or times, by name.
    stamps: Mapping[str, list[str]]
    #: First cell of each column that holds other texts, by name.
    texts: Mapping[str, str]
    #: Whether empty cells are NaN, as in a data frame.
    is_frame: bool

    @property
    def table(self) -> CellTable:
        """Kinds and first cells, for the recogniser of columns."""
        table = table_of_arrays({k: np.atleast_1d(x) for k, x in self.numbers.items()})
        kinds = {k: "number" for k, x in self.numbers.items() if x.ndim == 1}
        kinds |= dict.fromkeys(self.stamps, "stamp")
        return CellTable({**table.kinds, **kinds}, {**table.cells, **self.stamps})


def columns_in_memory(source: Any) -> Columns | None:
    """Take the columns of a mapping or data frame; None for other types.

    The index of a data frame is a column too, unless it has no name and counts the
    rows.

    Parameters
    ----------
    source : Any
        What a caller passes as a run.

    Raises
    ------
    InputError
        A column of stamps in which a cell is none.
    """
    is_frame = not isinstance(source, Mapping)
    names = getattr(source, "columns", None) if is_frame else source
    if names is None:
        return None
    columns = {str(name): source[name] for name in names}
    if is_frame:
        columns = _index_of(source, columns) | columns
    numbers = dict[str, Array]()
    stamps = dict[str, list[str]]()
    texts = dict[str, str]()
    for name, values in columns.items():
        found = _numbers_of(values)
        may_be_date = found is None or _kind_of_dates(values) is not None
        first_cells = _first_cells(values) if may_be_date else []
        if found is not None:
            numbers[name] = found
        elif first_cells and all(map(is_stamp, first_cells)):
            numbers[name] = _seconds_of_cells(name, values)
        elif first_cells:
            texts[name] = first_cells[0]
        if name in numbers and may_be_date:
            stamps[name] = first_cells
    return Columns(numbers, stamps, texts, is_frame)


def read_columns_in_memory(columns: Columns, number: int, what: str) -> Measurements:
    """Make the run of a mapping or data frame.

    A row of a data frame in which a channel is empty (NaN) is left out, as that of a
    file is.

    Parameters
    ----------
    number : int
        Of the run, from 1, among those that the caller passes: its name is "run1".
    what : str
        How messages call the argument.

    Returns
    -------
    Measurements
        The run in SI units, one row a sample.

    Raises
    ------
    InputError
        A channel that is missing, or holds texts.
    """
    for name, text in columns.texts.items():
        if _OURS.fullmatch(name):
            said = f"column {name} holds {text[:40]!r}, not numbers"
            raise InputError(said, "give it as numbers", what)
    header = Header.of(
        f"run{number}",
        list(columns.numbers),
        what=what,
        remedy=_REMEDY,
        table=columns.table,
    )
    chosen = {name: columns.numbers[name] for name in header.columns}
    if columns.is_frame:
        is_empty = _rows_with_empty_cells(header, chosen)
        if is_empty.any():
            first = int(np.flatnonzero(is_empty)[0]) + 1
            chosen = merged_rows(header, chosen, f"sample {first}")
    return header.read(chosen)


def _rows_with_empty_cells(
    header: Header, columns: Mapping[str, Array]
) -> NDArray[np.bool_]:
    """Return whether each row (N,) lacks a number in one of the columns, (N,) or (N, n).

    Columns without any number do not count; no row lacks one where positions are such:
    whoever reads them says so.
    """
    is_empty = {
        name: np.asarray(np.isnan(x.reshape(len(x), -1)).any(axis=1))
        for name, x in columns.items()
    }
    silent = {name for name, empty in is_empty.items() if empty.all()}
    counted = is_empty.keys() - silent
    n_rows = len(next(iter(is_empty.values())))
    out = np.zeros(n_rows, bool)
    if silent.isdisjoint(header.groups["q"]):
        for name in counted:
            out |= is_empty[name]
    return out


def _index_of(frame: Any, columns: Mapping[str, Any]) -> dict[str, Any]:
    """Return the index of a pandas data frame by its name, "index" without one.

    Empty where the frame has none, or one of several levels; where it has no name and
    counts the rows; and where a column has its name.
    """
    index: Any = getattr(frame, "index", None)
    if getattr(index, "nlevels", 0) != 1:
        return {}
    if index.name is None and index.dtype.kind in "iu":
        return {}
    name = "index" if index.name is None else str(index.name)
    return {} if name in columns else {name: index}


def _kind_of_dates(values: Any) -> str | None:
    """Return NumPy's type of a column of dates or durations; None for other columns.

    Dates with a zone are objects to NumPy: the type that pandas gives them says it.
    """
    dtype = str(getattr(values, "dtype", ""))
    letter = np.asarray(values).dtype.kind if _is_column(values) else ""
    if letter == "M" or dtype.startswith("datetime64"):
        return "datetime64[ns]"
    return "timedelta64[ns]" if letter == "m" else None


def _numbers_of(values: Any) -> Array | None:
    """Return a column as numbers; dates and durations as seconds [s], NaN where there
    is none. None for texts and other objects."""
    with suppress(TypeError, ValueError), np.errstate(over="ignore"):
        kind = _kind_of_dates(values)
        if kind is None:
            return np.asarray(values, float)
        dates = np.asarray(values, kind)
        nanoseconds = dates.astype("int64").astype(float)
        return np.where(np.isnat(dates), np.nan, 1e-9 * nanoseconds)
    # Numbers of pandas that can be missing.
    with suppress(AttributeError, TypeError, ValueError):
        return np.asarray(values.to_numpy(float, na_value=np.nan))
    return None


def _is_column(values: Any) -> bool:
    """Return whether values are (N,): a number or an object in each row."""
    try:
        return np.ndim(values) == 1
    except ValueError:  # rows of different lengths
        return False


def _first_cells(values: Any) -> list[str]:
    """Return the first cells of a column that are not empty, as texts; none for what is
    no column."""
    if not _is_column(values):
        return []
    filled = (str(cell) for cell in values if str(cell) not in _EMPTY)
    return list(islice(filled, _JUDGED))


def _seconds_of_cells(name: str, values: Any) -> Array:
    """Convert texts of times to seconds (N,) [s], NaN where a cell is empty; raise
    InputError for a text that is no time."""
    cells = [str(cell) for cell in values]
    is_filled = np.array([cell not in _EMPTY for cell in cells])
    seconds = np.full(len(cells), np.nan)
    try:
        filled = [cell for cell in cells if cell not in _EMPTY]
        seconds[is_filled] = past_midnight(seconds_of(filled))
    except InputError as error:
        raise error.within(f"column {name}") from error
    return seconds
