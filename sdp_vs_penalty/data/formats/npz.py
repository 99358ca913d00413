"""NPZ: NumPy's own archive of arrays t, q1..qn, dq1..dqn, tau1..taun, or whole q, dq,
tau (N, n)."""

from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats.columns import (
    Choice,
    Header,
    columns_of,
    table_of_arrays,
    understood,
)
from sdp_vs_penalty.data.formats.recognition import CellTable
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import reading, writing
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES = (".npz",)
_KIND = ".npz file of numbers", "write it anew with numpy.savez"


def read(path: Path, choice: Choice) -> Measurements:
    """The run of an archive; InputError naming the array that cannot be used."""
    with (
        understood(path, *_KIND),
        reading(path),
        np.load(path, allow_pickle=False) as file,
    ):
        header = Header.of(path, list(file.files), choice)
        arrays = {
            name: _real_numbers(path, name, file[name]) for name in header.columns
        }
    return header.read(arrays)


def inspect(path: Path) -> CellTable:
    """What the arrays of an archive hold."""
    return table_of_arrays(numeric_arrays(path))


def write(measurements: Measurements, path: Path) -> None:
    columns: dict[str, Any] = columns_of(measurements)
    with writing(path) as file:
        np.savez_compressed(file, **columns)


def numeric_arrays(path: str | Path) -> dict[str, Array]:
    """The arrays of an .npz file as floats; InputError for anything but real numbers."""
    arrays: dict[str, Array] = {}
    with (
        understood(path, *_KIND),
        reading(path),
        np.load(path, allow_pickle=False) as file,
    ):
        for name in file.files:
            arrays[name] = _real_numbers(path, name, file[name])
    return arrays


def _real_numbers(path: str | Path, name: str, array: Any) -> Array:
    """An array as floating-point numbers; InputError for anything but real numbers."""
    if array.dtype.kind not in "fiu":
        what = f"array {name} holds {array.dtype}, not real numbers"
        raise InputError(what, "save it as floating-point numbers", path)
    with np.errstate(over="ignore"):  # a longer number becomes infinite: refused later
        return np.atleast_1d(np.asarray(array, float))
