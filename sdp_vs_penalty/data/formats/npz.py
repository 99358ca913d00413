"""NumPy archives of arrays t, q1..qn, tau1..taun, or whole q, dq, tau (N, n)."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

from sdp_vs_penalty.data.formats.limits import understood
from sdp_vs_penalty.data.log import (
    ROWS_DESCRIBED,
    Column,
    Log,
    Values,
    log_of_arrays,
    real_numbers,
)
from sdp_vs_penalty.data.measurements import Measurements, columns_of
from sdp_vs_penalty.data.store import LARGEST_IN_MEMORY, PART, concatenate_chunks
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import memory_for, unpacks_to_too_much, writing
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES: tuple[str, ...] = (".npz",)


def read(path: Path) -> Log:
    """Read the arrays of an archive."""
    with _archive(path) as file:
        layouts = {name: _layout_of(file, name) for name in file.files}
        table = _one_table(path, file, layouts)
        if table is not None:
            return log_of_arrays(path, table)
        columns, texts = dict[str, Column](), dict[str, list[str]]()
        for name, (shape, dtype, _) in layouts.items():
            is_text = dtype is not None and dtype.kind in "US"
            if is_text and len(shape) == 1:
                texts[name] = file[name].astype(str).tolist()
            is_block = len(shape) > 1 and min(shape) > 1
            kind = "list" if is_block else "number"
            cells = (
                [str(texts[name])]
                if name in texts
                else _first_cells(file, name, *layouts[name])
            )
            columns[name] = Column("text" if is_text else kind, cells)

    def read_columns(names: Sequence[str]) -> Values:
        with _archive(path) as file:
            return Values({name: _channel(path, file, name) for name in names})

    return Log(path, columns, read_columns)


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


#: Shape and type of a stored array, and whether it is stored row by row; no type where
#: the archive has no such array, or its header cannot be read.
_Layout = tuple[tuple[int, ...], np.dtype[Any] | None, bool]


def _layout_of(file: Any, name: str) -> _Layout:
    """Read the layout of an array from its header in the archive."""
    if f"{name}.npy" not in file.zip.namelist():
        return (0,), None, False
    with file.zip.open(f"{name}.npy") as member:
        return _read_header(member)


def _read_header(member: IO[bytes]) -> _Layout:
    """Read the header of a stored array, behind which its numbers follow."""
    readers = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    read_header = readers.get(np.lib.format.read_magic(member))
    if read_header is None:
        return (0,), None, False
    shape, is_column_major, dtype = read_header(member)
    is_by_row = len(shape) == 1 or not is_column_major
    return shape, dtype, is_by_row and len(shape) > 0 and dtype.kind in "fiu"


def _first_cells(
    file: Any, name: str, shape: tuple[int, ...], dtype: Any, is_by_row: bool
) -> list[str]:
    """Return the first rows of a stored array as texts; none where it is not stored row
    by row."""
    if not is_by_row or len(shape) > 2:
        return []
    with file.zip.open(f"{name}.npy") as member:
        _read_header(member)
        rows = (min(ROWS_DESCRIBED, shape[0]), *shape[1:])
        block = next(_rows(member, rows, dtype), np.zeros((0, 0)))
    return [" ".join(f"{x:.15g}" for x in np.ravel(row)) for row in block]


def _channel(path: Path, file: Any, name: str) -> Array:
    """Read one array of an archive as floating-point numbers; one too large for the
    memory row by row into a file on the disk."""
    shape, dtype, is_by_row = _layout_of(file, name)
    if is_by_row and dtype and dtype.itemsize * math.prod(shape) > LARGEST_IN_MEMORY:
        with file.zip.open(f"{name}.npy") as member:
            _read_header(member)
            rows = _rows(member, shape, dtype)
            return concatenate_chunks(real_numbers(path, name, x) for x in rows)
    return real_numbers(path, name, file[name])


def _rows(
    member: IO[bytes], shape: tuple[int, ...], dtype: np.dtype[Any]
) -> Iterator[Array]:
    """Read the rows of a stored array in pieces of PART rows; raise ValueError where the
    file ends early."""
    size = dtype.itemsize * math.prod(shape[1:])
    for start in range(0, shape[0], PART):
        count = min(PART, shape[0] - start)
        content = member.read(count * size)
        if len(content) < count * size:
            raise ValueError("an array ends early")
        yield np.frombuffer(content, dtype).reshape(count, *shape[1:])


def _one_table(
    path: Path, file: Any, layouts: dict[str, _Layout]
) -> dict[str, Array] | None:
    """Read an archive that holds one table: an array of records with named fields, or a
    matrix alone or beside an array with its columns' names.

    Returns (N,) columns by name ("#1", "#2" ... without names), None for other archives.
    The arrays beside records keep their names.
    """
    records = [name for name, (_, dtype, _) in layouts.items() if dtype and dtype.names]
    numbers = [
        name for name, (_, dtype, _) in layouts.items() if dtype and dtype.kind in "fiu"
    ]
    if len(records) == 1:
        fields = columns_of_array(path, file[records[0]])
        return fields | {name: _channel(path, file, name) for name in numbers}
    if len(numbers) != 1 or len(layouts) > 2:
        return None
    columns = columns_of_array(path, file[numbers[0]])
    texts = [file[name] for name in layouts if name not in numbers]
    names = (
        texts[0].astype(str).tolist() if texts and texts[0].dtype.kind in "US" else None
    )
    if not texts:
        return columns
    if not isinstance(names, list) or len({*names}) != len(columns):
        return None
    return dict(zip(names, columns.values(), strict=True))


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
