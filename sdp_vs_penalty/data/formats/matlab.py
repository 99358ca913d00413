"""MATLAB .mat files (versions 4 to 7) with variables t, q, tau (dq optional), or q1,
q2, ..."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.formats.columns import Choice, Header, understood
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import writing

SUFFIXES = (".mat",)


def read(path: Path, choice: Choice) -> Measurements:
    """Variables of the file, or the fields of its one struct; other variables are
    ignored."""
    from scipy.io import loadmat

    with understood(path, ".mat file", "save it again, as version 7 or earlier"):
        with path.open("rb") as file:
            start = file.read(128)
        if start.startswith(b"MATLAB 7.3") or start.startswith(b"\x89HDF"):
            raise InputError(
                "a version 7.3 file (HDF5)", "save it with save(..., '-v7')", path
            )
        content = loadmat(path, simplify_cells=True)
    named = {
        name: value for name, value in content.items() if not name.startswith("__")
    }
    structs = [value for value in named.values() if isinstance(value, Mapping)]
    if len(structs) == 1 and len(named) == 1:
        named = dict(structs[0])
    arrays = {str(name): np.asarray(value) for name, value in named.items()}
    numeric = {k: x for k, x in arrays.items() if x.dtype.kind in "fiu" and x.ndim <= 2}
    columns = {name: np.atleast_1d(x.astype(float)) for name, x in numeric.items()}
    return Header.of(path, list(columns), choice).run(columns)


def write(measurements: Measurements, path: Path) -> None:
    from scipy.io import savemat

    m = measurements
    content = {"t": m.t[:, None], **m.groups}
    with writing(path) as file:
        savemat(file, content, do_compression=True)
