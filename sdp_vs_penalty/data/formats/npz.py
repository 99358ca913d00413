"""NumPy archives of arrays t, q1..qn, tau1..taun, or whole q, dq, tau (N, n)."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats.limits import understood
from sdp_vs_penalty.data.log import Log, log_of_arrays, real_numbers
from sdp_vs_penalty.data.measurements import Measurements, columns_of
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import memory_for, unpacks_to_too_much, writing
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES: tuple[str, ...] = (".npz",)
#: Arrays of more dimensions, such as pictures, are no channels.
_MOST_DIMENSIONS = 3


def read(path: Path) -> Log:
    """Read the arrays of an archive, and of an array of records its fields.

    An archive with one matrix, alone or beside its columns' names, is a table. What is no
    number is a text: whoever chooses it hears of it.
    """
    numbers, texts = dict[str, Any](), dict[str, Any]()
    records = list[str]()
    with _archive(path) as file:
        for name in file.files:
            n_dimensions, kind = _layout_of(file, name)
            if kind is None or kind.kind not in "fiuUSV" or kind.hasobject:
                texts[name] = np.array(str(kind))
            elif n_dimensions <= _MOST_DIMENSIONS:
                (texts if kind.kind in "US" else numbers)[name] = file[name]
                records += [name] if kind.names else []
    if len(records) == 1:
        numbers |= columns_of_array(path, numbers.pop(records[0]))
    elif len(numbers) == 1 and len(texts) < 2:
        table = columns_of_array(path, next(iter(numbers.values())))
        names = np.ravel(next(iter(texts.values()), [*table])).astype(str).tolist()
        if len({*names}) == len(table):
            return log_of_arrays(path, dict(zip(names, table.values(), strict=True)))
    arrays = {
        name: real_numbers(path, name, x)
        for name, x in numbers.items()
        if not x.dtype.names
    }
    # A text a sample may be its time; other texts are one row, such as the joints' names.
    count = max(map(len, arrays.values()), default=0)
    cells = {name: np.ravel(x).astype(str).tolist() for name, x in texts.items()}
    rows = {
        name: [[cell] for cell in x] if len(x) == count else [x]
        for name, x in cells.items()
    }
    return log_of_arrays(path, arrays, rows)


@contextmanager
def _archive(path: Path) -> Iterator[Any]:
    """Open an archive whose arrays take no more memory than its size allows.

    What is unpacked ends at the size that the archive declares.
    """
    kind = ".npz file of numbers", "write it anew with numpy.savez"
    with understood(path, *kind), np.load(path, allow_pickle=False) as file:
        unpacked = sum(member.file_size for member in file.zip.infolist())
        if unpacked > memory_for(path.stat().st_size):
            raise unpacks_to_too_much(path)
        yield file


def _layout_of(file: Any, name: str) -> tuple[int, np.dtype[Any] | None]:
    """Read the number of dimensions and the type of an array from its header in the
    archive; no type where there is none that can be read."""
    if f"{name}.npy" not in file.zip.namelist():
        return 0, None
    with file.zip.open(f"{name}.npy") as member:
        major, minor = np.lib.format.read_magic(member)
        reader = f"read_array_header_{major}_{minor}"
        if not hasattr(np.lib.format, reader):
            return 0, None
        shape, _, kind = getattr(np.lib.format, reader)(member)
        return len(shape), kind


def columns_of_array(path: Path, array: Any) -> dict[str, Array]:
    """Split a structured array (N,), or a plain one (N, columns) or (columns, N), into
    columns: (N,) numbers, or (N, n) of a field that is a block, by the field's name; "#1",
    "#2" ... for a plain array.

    The longer side of a plain array is that of the samples: some programs save one
    channel a row. Raises InputError for an array of another shape.
    """
    if array.dtype.names:
        flat = np.ravel(array)
        fields = {name: flat[name] for name in array.dtype.names}
        fields = {name: x for name, x in fields.items() if x.dtype.kind in "fiu"}
        return {name: real_numbers(path, name, x) for name, x in fields.items()}
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or array.size == 0:
        what = f"an array of shape {array.shape}"
        raise InputError(what, "save one row a sample and one column a channel", path)
    columns = array.T if array.shape[0] >= array.shape[1] else array
    numbered = enumerate(columns, start=1)
    return {f"#{k}": real_numbers(path, f"column {k}", x) for k, x in numbered}


def write(measurements: Measurements, path: Path) -> None:
    """Write one run as a compressed NumPy archive, one array for each column of
    RUN.csv."""
    columns: dict[str, Any] = columns_of(measurements)
    with writing(path) as file:
        np.savez_compressed(file, **columns)


def numeric_arrays(path: str | Path) -> dict[str, Array]:
    """Read all arrays of an archive, of any shape, by name; raise InputError for one that
    holds anything but real numbers."""
    path = Path(path)
    with _archive(path) as file:
        return {name: real_numbers(path, name, file[name]) for name in file.files}
