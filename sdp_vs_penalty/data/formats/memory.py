"""What a program holds in memory: a mapping of arrays, or a data frame of pandas or
polars. It is read as the file that it came from."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.log import Log, log_of_arrays
from sdp_vs_penalty.robot.arrays import Array

_REMEDY = (
    "give t, q, tau and, if measured, dq: (N,) and (N, n) arrays, or the columns of"
    " RUN.csv"
)


def log_in_memory(source: Any, number: int) -> Log | None:
    """Take the columns of a mapping or data frame; None for other types.

    The index of a data frame is a column too, unless it has no name and counts the
    rows. NaN is an empty cell in a data frame, and a number that is none in a mapping.
    What is no number is read as a column of Parquet's is: dates become seconds since
    1970, times of day and durations seconds.

    Parameters
    ----------
    source : Any
        What a caller passes as a run.
    number : int
        Of the run, from 1, among those that the caller passes: its name is "run1".
    """
    is_frame = not isinstance(source, Mapping)
    names = getattr(source, "columns", None) if is_frame else source
    if names is None:
        return None
    columns = {str(name): source[name] for name in names}
    if is_frame:
        columns = _index_of(source, columns) | columns
    arrays = {name: _numbers_of(values) for name, values in columns.items()}
    others = {name: columns[name] for name, x in arrays.items() if x is None}
    path, numbers = (
        Path(f"run{number}"),
        {x: y for x, y in arrays.items() if y is not None},
    )
    facts, texts = dict[str, dict[str, Any]](), dict[str, list[list[str]]]()
    if others:
        from sdp_vs_penalty.data.formats.parquet import columns_of_table, table_of

        more, texts, facts = columns_of_table(path, table_of(others))
        numbers |= more
    count = max(map(len, numbers.values()), default=0)
    return log_of_arrays(
        path,
        numbers,
        texts,
        facts,
        np.arange(1, 1 + count),
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


def _numbers_of(values: Any) -> Array | None:
    """Return a column or block of numbers, at least (1,); None for others."""
    try:
        array = np.asarray(values)
    except ValueError:  # rows of different lengths
        return None
    with np.errstate(over="ignore"):
        is_number = array.dtype.kind in "fiub"
        return np.atleast_1d(np.asarray(array, float)) if is_number else None
