"""MATLAB .mat files (versions 4 to 7) with variables t, q, tau (dq optional), or q1, q2, ..."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import write_bytes
from sdp_vs_penalty.formats import Choice, check_size, from_columns
from sdp_vs_penalty.measurements import Measurements

Array = NDArray[np.float64]


def read(path: Path, choice: Choice) -> Measurements:
    """Variables of the file, or the fields of its one struct; other variables are ignored."""
    from scipy.io import loadmat, whosmat

    try:
        with path.open("rb") as file:
            start = file.read(128)
        if start.startswith(b"MATLAB 7.3") or start.startswith(b"\x89HDF"):
            raise InputError(f"{path}: a version 7.3 file (HDF5): save it with save(..., '-v7').")
        numbers = sum(int(np.prod(shape, dtype=float)) for _, shape, _ in whosmat(path))
        check_size(path, 8 * numbers, path.stat().st_size)
        content = loadmat(path, simplify_cells=True)
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except Exception as error:  # the reader has no exception of its own
        what = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: not a readable .mat file ({what}).") from error
    named = {name: value for name, value in content.items() if not name.startswith("__")}
    structs = [value for value in named.values() if isinstance(value, Mapping)]
    if len(structs) == 1 and len(named) == 1:
        named = dict(structs[0])
    return from_columns(path, _numeric(named), choice.rename)


def _numeric(named: Mapping[str, Any]) -> dict[str, Array]:
    out = {}
    for name, value in named.items():
        array = np.asarray(value)
        if array.dtype.kind in "fiu" and array.ndim <= 2:
            out[str(name)] = np.atleast_1d(array.astype(float))
    return out


def write(measurements: Measurements, path: Path) -> None:
    from scipy.io import savemat

    m = measurements
    content = {"t": m.t[:, None], "q": m.q, "tau": m.tau, **({} if m.dq is None else {"dq": m.dq})}
    buffer = io.BytesIO()
    savemat(buffer, content, do_compression=True)
    write_bytes(path, buffer.getvalue())
