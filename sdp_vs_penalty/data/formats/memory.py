"""What a program holds in memory: a mapping of arrays, or a data frame of pandas or
polars. It is read as the file that it came from."""

import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.log import Log, log_of_arrays
from sdp_vs_penalty.data.words.stamps import is_stamp, past_midnight, seconds_of
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


def log_in_memory(source: Any, number: int, what: str) -> Log | None:
    """Take the columns of a mapping or data frame; None for other types.

    The index of a data frame is a column too, unless it has no name and counts the
    rows. NaN is an empty cell in a data frame, and a number that is none in a mapping.
    Dates become seconds since 1970, times of day and durations seconds.

    Parameters
    ----------
    source : Any
        What a caller passes as a run.
    number : int
        Of the run, from 1, among those that the caller passes: its name is "run1".
    what : str
        How messages call the argument.

    Raises
    ------
    InputError
        A column of stamps in which a cell is none; our name for a column of texts.
    """
    is_frame = not isinstance(source, Mapping)
    names = getattr(source, "columns", None) if is_frame else source
    if names is None:
        return None
    columns = {str(name): source[name] for name in names}
    if is_frame:
        columns = _index_of(source, columns) | columns
    arrays, facts = dict[str, Array](), dict[str, dict[str, Any]]()
    for name, values in columns.items():
        array = _numbers_of(values)
        if array is None or _kind_of_dates(values) is not None:
            cells = [str(x) for x in values] if _is_column(values) else []
            filled = [x for x in cells if x not in _EMPTY]
            if array is None and filled and all(map(is_stamp, filled[:_JUDGED])):
                array = _seconds_of_cells(name, cells)
            elif array is None and filled and _OURS.fullmatch(name):
                said = f"column {name} holds {filled[0][:40]!r}, not numbers"
                raise InputError(said, "give it as numbers", what)
            facts[name] = {"kind": "stamp", "cells": filled[:_JUDGED]}
        if array is not None:
            arrays[name] = np.atleast_1d(array)
            if array.ndim == 1:
                facts.setdefault(name, {"kind": "number"})
    rows = np.arange(1, 1 + max(map(len, arrays.values()), default=0))
    return log_of_arrays(
        Path(f"run{number}"),
        arrays,
        facts=facts,
        rows=rows,
        has_gaps=is_frame,
        remedy=_REMEDY,
    )


def _index_of(frame: Any, columns: Mapping[str, Any]) -> dict[str, Any]:
    """Return the index of a pandas data frame by its name, "index" without one.

    Empty where the frame has none, or one of several levels; where it has no name and
    counts the rows; and where a column has its name.
    """
    index: Any = getattr(frame, "index", None)
    if getattr(index, "nlevels", 0) != 1 or (
        index.name is None and index.dtype.kind in "iu"
    ):
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


def _seconds_of_cells(name: str, cells: list[str]) -> Array:
    """Convert texts of times to seconds (N,) [s], NaN where a cell is empty; raise
    InputError for a text that is no time."""
    is_filled = np.array([cell not in _EMPTY for cell in cells])
    seconds = np.full(len(cells), np.nan)
    try:
        filled = [cell for cell in cells if cell not in _EMPTY]
        seconds[is_filled] = past_midnight(seconds_of(filled))
    except InputError as error:
        raise error.within(f"column {name}") from error
    return seconds
