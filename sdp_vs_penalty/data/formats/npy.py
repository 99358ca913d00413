"""NPY: one array of NumPy's, with named fields or one column a channel."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats.columns import (
    Choice,
    Header,
    real_numbers,
    table_of_arrays,
    understood,
)
from sdp_vs_penalty.data.formats.headerless import names_without_header
from sdp_vs_penalty.data.formats.recognition import CellTable
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES = (".npy",)
_KIND = (
    ".npy file of numbers",
    "save its arrays with numpy.savez(path, t=..., q=..., tau=...)",
)


def read(path: Path, choice: Choice) -> Measurements:
    """Read the run of a structured array (N,), by the names of its fields, or of a
    plain array (N, columns), which has no names and no rate. See
    :meth:`~sdp_vs_penalty.data.formats.interface.MeasurementFormat.read`."""
    return run_of_columns(path, read_columns(path), choice)


def run_of_columns(
    path: Path, columns: Mapping[str, Array], choice: Choice
) -> Measurements:
    """Make a run of the columns of a table, with or without names.

    Parameters
    ----------
    path : Path
        How messages call the file.
    columns : Mapping[str, Array]
        (N,) numbers or (N, n) blocks by name; "#1", "#2" ... where there are no names.
    choice : Choice
        The robot's joints, the columns chosen by ``--rename``, and the rate.

    Returns
    -------
    Measurements
        The run in SI units, one row a sample.

    Raises
    ------
    InputError
        Where a column is unknown, or a channel is missing.
    """
    names = list(columns)
    if names[:1] == ["#1"] and not choice.rename:
        names = names_without_header(path, len(names), choice, lambda: columns)
    named = dict(zip(names, columns.values(), strict=True))
    return Header.of(path, names, choice).read(named)


def inspect(path: Path) -> CellTable:
    """Describe the fields or columns of an array by their kinds and first rows. See
    :meth:`~sdp_vs_penalty.data.formats.interface.TableFormat.inspect`."""
    return table_of_arrays(read_columns(path))


def read_columns(path: Path) -> dict[str, Array]:
    """Read the fields or columns of an array.

    Parameters
    ----------
    path : Path
        Path of a file with a structured array (N,), or a plain array (N, columns).

    Returns
    -------
    dict of str to array
        (N,) numbers, or (N, n) of a field that is a block, by the field's name; "#1",
        "#2" ... for a plain array.

    Raises
    ------
    InputError
        An array of objects (a pickle, which could run code), or of another shape.
    """
    with understood(path, *_KIND):
        array = np.load(path, allow_pickle=False)
    return columns_of_array(path, array)


def columns_of_array(path: Path, array: Any) -> dict[str, Array]:
    """Split an array into columns.

    The longer side of a plain array is that of the samples: some programs save one
    channel a row.

    Parameters
    ----------
    path : Path
        How messages call the file.
    array : Any
        A structured array (N,), or a plain one (N, columns) or (columns, N).

    Returns
    -------
    dict[str, Array]
        (N,) numbers, or (N, n) of a field that is a block, by the field's name; "#1",
        "#2" ... for a plain array.

    Raises
    ------
    InputError
        An array of another shape.
    """
    fields = array.dtype.names
    if fields:
        flat = np.ravel(array)
        return {
            name: real_numbers(path, name, flat[name])
            for name in fields
            if flat[name].dtype.kind in "fiu"
        }
    if array.ndim == 1:
        array = array[:, None]
    if array.ndim != 2 or array.size == 0:
        what = f"an array of shape {array.shape}"
        raise InputError(what, "save one row a sample and one column a channel", path)
    # Some save a channel a row.
    columns = array.T if array.shape[0] >= array.shape[1] else array
    return {
        f"#{k}": real_numbers(path, f"column {k}", column)
        for k, column in enumerate(columns, start=1)
    }
