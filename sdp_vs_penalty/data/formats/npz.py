"""NPZ: NumPy's own archive of arrays t, q1..qn, dq1..dqn, tau1..taun, or whole q, dq,
tau (N, n)."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from sdp_vs_penalty.data.formats.columns import (
    Choice,
    Header,
    columns_of,
    real_numbers,
    table_of_arrays,
    understood,
)
from sdp_vs_penalty.data.formats.npy import columns_of_array, run_of_columns
from sdp_vs_penalty.data.formats.recognition import (
    CellTable,
    columns_of_joint_names,
    has_our_names,
    recognise,
)
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.store import LARGEST_IN_MEMORY, PART, concatenate_chunks
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import memory_for, unpacks_to_too_much, writing
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES = (".npz",)
_KIND = ".npz file of numbers", "write it anew with numpy.savez"


def read(path: Path, choice: Choice) -> Measurements:
    """Read the run of a NumPy archive; arrays of more than a million rows in pieces.

    Parameters
    ----------
    choice : Choice
        The robot's joints, the arrays chosen by ``--rename``, and the rate.

    Returns
    -------
    Measurements
        The run in SI units, one row a sample.

    Raises
    ------
    InputError
        A file that cannot be read, or a channel that is missing.
    """
    with _archive(path) as file:
        table = _columns_of_one_table(path, file)
        if table is not None:
            return run_of_columns(path, table, choice)
        header = Header.of(path, list(file.files), choice, table=_table_of_joints(file))
        arrays = {name: _channel(path, file, name) for name in header.columns}
    lengths = {len(array) for array in arrays.values()}
    if len(lengths) > 1 or max(lengths, default=0) <= PART or "t" not in header.groups:
        return header.read(arrays)
    return header.gather(_pieces(header, arrays))


@contextmanager
def _archive(path: Path) -> Iterator[Any]:
    """Open an archive whose arrays take no more memory than its size allows.

    What is unpacked ends at the size that the archive declares.
    """
    with understood(path, *_KIND), np.load(path, allow_pickle=False) as file:
        unpacked = sum(member.file_size for member in file.zip.infolist())
        if unpacked > memory_for(path.stat().st_size):
            raise unpacks_to_too_much(path)
        yield file


def _table_of_joints(file: Any) -> CellTable | None:
    """Describe an archive that names its joints beside blocks of numbers; None for one
    that does not.

    The names are an array of n texts called "joint_names" or alike. An array (N, n) is
    a "list" a row, whose order the names tell. Numbers are not read here.
    """
    kinds = dict.fromkeys(file.files, "list")
    cells = dict[str, list[str]]()
    for name in columns_of_joint_names(file.files):
        if _is_text(file, name):
            kinds[name] = "text"
            cells[name] = [str(np.ravel(file[name]).astype(str).tolist())]
    return CellTable(kinds, cells) if cells else None


def _is_text(file: Any, name: str) -> bool:
    """Return whether an array of an archive holds texts, by its header alone."""
    dtype = _type_of(file, name)
    return dtype is not None and dtype.kind in "US"


def _is_of_records(file: Any, name: str) -> bool:
    """Return whether an array of an archive has named fields, by its header alone."""
    dtype = _type_of(file, name)
    return dtype is not None and dtype.names is not None


def _type_of(file: Any, name: str) -> np.dtype[Any] | None:
    """Read the type of an array from its header in the archive; None where the archive
    has no such array."""
    if f"{name}.npy" not in file.zip.namelist():
        return None
    with file.zip.open(f"{name}.npy") as member:
        return _row_layout(member)[1]


def _pieces(header: Header, arrays: Mapping[str, Array]) -> Iterator[Measurements]:
    """Cut arrays (N, ...) of equal length into consecutive pieces of the run."""
    count = len(arrays[header.columns[0]])
    for start in range(0, count, PART):
        part = slice(start, start + PART)
        yield header.run({name: array[part] for name, array in arrays.items()})


def _channel(path: Path, file: Any, name: str) -> Array:
    """Read one array of an archive as floating-point numbers.

    An array too large for the memory is read row by row into a file on the disk.
    """
    if f"{name}.npy" in file.zip.namelist():
        with file.zip.open(f"{name}.npy") as member:
            shape, dtype = _row_layout(member)
            if dtype.itemsize * math.prod(shape) > LARGEST_IN_MEMORY:
                rows = _rows(member, shape, dtype)
                return concatenate_chunks(real_numbers(path, name, x) for x in rows)
    return real_numbers(path, name, file[name])


def _row_layout(member: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Read the shape and type of an array from its header in the archive.

    Returns the shape (0,) where the array cannot be read row by row: one stored column
    by column, or one that holds no numbers.
    """
    readers = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    version = np.lib.format.read_magic(member)
    read_header = readers.get(version)
    if read_header is None:
        return (0,), np.dtype(float)
    shape, is_column_major, dtype = read_header(member)
    is_by_row = len(shape) == 1 or not is_column_major
    is_numeric = dtype.kind in "fiu"
    return (shape if is_by_row and is_numeric else (0,)), dtype


def _rows(
    member: IO[bytes], shape: tuple[int, ...], dtype: np.dtype[Any]
) -> Iterator[Array]:
    """Read the rows of a stored array in pieces of PART rows.

    Raises ValueError where the file ends early.
    """
    size = dtype.itemsize * math.prod(shape[1:])
    for start in range(0, shape[0], PART):
        count = min(PART, shape[0] - start)
        content = member.read(count * size)
        if len(content) < count * size:
            raise ValueError("an array ends early")
        yield np.frombuffer(content, dtype).reshape(count, *shape[1:])


def _columns_of_one_table(path: Path, file: Any) -> dict[str, Array] | None:
    """Read an archive that holds one table: an array of records with named fields, or a
    matrix alone or beside an array with its columns' names. Records beside arrays that
    are a run themselves are no table: gains, say.

    Returns (N,) columns by name ("#1", "#2" ... without names); None for other
    archives.
    """
    records = [name for name in file.files if _is_of_records(file, name)]
    others = [name for name in file.files if name not in records]
    is_run = has_our_names(others) or recognise(others) is not None
    if len(records) == 1 and not is_run:
        return columns_of_array(path, file[records[0]])
    if not 1 <= len(file.files) <= 2:
        return None
    arrays = [file[name] for name in file.files]
    tables = [x for x in arrays if x.dtype.names or x.dtype.kind in "fiu"]
    if len(tables) != 1:
        return None
    columns = columns_of_array(path, tables[0])
    if len(arrays) == 1:
        return columns
    texts = next(x for x in arrays if x is not tables[0])
    names = texts.astype(str).tolist() if texts.dtype.kind in "US" else []
    if not isinstance(names, list):  # a single text
        return None
    is_unique = len(set(names)) == len(names)
    if len(names) != len(columns) or not is_unique:
        return None
    return dict(zip(names, columns.values(), strict=True))


def inspect(path: Path) -> CellTable:
    """Describe the arrays of an archive by their kinds and first rows; what is not
    numeric is "text". See
    :meth:`~sdp_vs_penalty.data.formats.interface.TableFormat.inspect`."""
    arrays, texts = _arrays_and_texts(path)
    numbers = table_of_arrays(arrays)
    return CellTable({**numbers.kinds, **dict.fromkeys(texts, "text")}, numbers.cells)


def read_columns(path: Path) -> dict[str, Array]:
    """Read the numeric arrays of an archive, by name: (N,) numbers or (N, n) blocks.

    An archive that holds one table gives its columns. See
    :meth:`~sdp_vs_penalty.data.formats.interface.TableFormat.read_columns`.
    """
    return _arrays_and_texts(path)[0]


def _arrays_and_texts(path: Path) -> tuple[dict[str, Array], list[str]]:
    """Read the numeric arrays of an archive, and list the names of the others."""
    arrays = dict[str, Array]()
    texts = list[str]()
    with _archive(path) as file:
        table = _columns_of_one_table(path, file)
        if table is not None:
            return table, []
        for name in file.files:
            with suppress(InputError, ValueError):
                arrays[name] = real_numbers(path, name, file[name])
                continue
            texts.append(name)
    return arrays, texts


def write(measurements: Measurements, path: Path) -> None:
    """Write one run as a compressed NumPy archive, one array for each column of
    RUN.csv.

    The file appears when it is complete: an interruption leaves no half-written file.

    Parameters
    ----------
    path : Path
        Path of the file to write.
    """
    columns: dict[str, Any] = columns_of(measurements)
    with writing(path) as file:
        np.savez_compressed(file, **columns)


def numeric_arrays(path: str | Path) -> dict[str, Array]:
    """Read all arrays of an archive, each of which has to be numeric.

    Returns
    -------
    dict[str, Array]
        Floating-point numbers of any shape, by name.

    Raises
    ------
    InputError
        An array that holds anything but real numbers.
    """
    path = Path(path)
    arrays: dict[str, Array] = {}
    with _archive(path) as file:
        for name in file.files:
            arrays[name] = real_numbers(path, name, file[name])
    return arrays
