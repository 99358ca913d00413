"""NPZ: NumPy's own archive of arrays t, q1..qn, dq1..dqn, tau1..taun, or whole q, dq,
tau (N, n)."""

from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats.columns import Choice, Header, columns_of, understood
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import reading, writing
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES = (".npz",)


def read(path: Path, choice: Choice) -> Measurements:
    """The run of an archive; InputError naming the array that cannot be used."""
    arrays = numeric_arrays(path)
    return Header.of(path, list(arrays), choice).run(arrays)


def write(measurements: Measurements, path: Path) -> None:
    columns: dict[str, Any] = columns_of(measurements)
    with writing(path) as file:
        np.savez_compressed(file, **columns)


def numeric_arrays(path: str | Path) -> dict[str, Array]:
    """The arrays of an .npz file as floats; InputError for anything but real numbers."""
    arrays: dict[str, Array] = {}
    kind = ".npz file of numbers", "write it anew with numpy.savez"
    with (
        understood(path, *kind),
        reading(path),
        np.load(path, allow_pickle=False) as file,
    ):
        for name in file.files:
            array = file[name]
            if array.dtype.kind not in "fiu":
                what = f"array {name} holds {array.dtype}, not real numbers"
                raise InputError(what, "save it as floating-point numbers", path)
            arrays[name] = np.atleast_1d(np.asarray(array, float))
    return arrays
