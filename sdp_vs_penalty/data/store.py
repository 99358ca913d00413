"""Numbers of a recording: in memory while they are few, else in a temporary file that
is mapped there.

A mapped array is an ordinary NumPy array that cannot be written to: whatever works on
one works on the other, with the same result. The file has no name, so that nothing is
left of it however the process ends; it lies in $TMPDIR, else in /var/tmp, which is on a
disk where /tmp may not be. Rows that :func:`iter_chunks` has gone through are dropped
from memory, and are read from the file again by whoever needs them next.
"""

import errno
import hashlib
import mmap
import os
import pickle
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.errors import InputError

#: Bytes of one array above which it goes to a file: 75 000 samples of seven joints.
LARGEST_IN_MEMORY = 2**22
#: Samples that are worked on at a time.
PART = 1 << 15
#: Advice to the system by which it drops pages of a map; None where it has no such advice.
_DROP: int | None = getattr(mmap, "MADV_DONTNEED", None)


def iter_chunks(
    array: NDArray[Any], overlap: int = 0
) -> Iterator[tuple[int, NDArray[Any]]]:
    """Yield an array (N, ...) in consecutive chunks of 32768 rows, each with the index
    of its first row; a chunk has ``overlap`` rows of the next one as well."""
    for start in range(0, len(array), PART):
        chunk = array[start : start + PART + overlap]
        yield start, chunk
        drop_pages(chunk)


def drop_pages(rows: NDArray[Any]) -> None:
    """Give the memory of consecutive rows (K, ...) of a mapped array back to the system.

    The rows stay valid: who reads them again gets them from the file. Nothing happens
    to an array in memory.
    """
    mapped = _map_of(rows)
    if mapped is None or not rows.size or _DROP is None:
        return
    file_map, first_byte = mapped
    low, high = np.lib.array_utils.byte_bounds(rows)
    start = (low - first_byte) // mmap.PAGESIZE * mmap.PAGESIZE
    file_map.madvise(_DROP, start, high - first_byte - start)


def _map_of(array: NDArray[Any]) -> tuple[mmap.mmap, int] | None:
    """Return the mapped file that an array is a view of, and the address of the file's
    first byte; None for an array in memory."""
    root = array
    while isinstance(root.base, np.ndarray):
        root = root.base
    # NumPy refers to what it was made from directly, or by a memoryview of it.
    source = getattr(root.base, "obj", root.base)
    if not isinstance(source, mmap.mmap):
        return None
    first_byte, _ = np.lib.array_utils.byte_bounds(root)
    return source, first_byte


def column_range(array: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Find the smallest and the largest number of each column, chunk by chunk.

    Parameters
    ----------
    array : NDArray[Any]
        (N, n) numbers, at least one row.

    Returns
    -------
    smallest, largest : NDArray[Any]
        (n,) each; NaN where a column has one.
    """
    extremes = []
    for _, chunk in iter_chunks(array):
        columns = np.ascontiguousarray(chunk.T)  # several times as fast as row by row
        extremes.append((columns.min(axis=1), columns.max(axis=1)))
    smallest, largest = np.transpose(extremes, (1, 0, 2))
    return smallest.min(axis=0), largest.max(axis=0)


def digest(arrays: Iterable[NDArray[Any]]) -> str:
    """Hash the shapes and numbers of arrays: SHA-256 as hexadecimal digits."""
    hasher = hashlib.sha256()
    for array in arrays:
        hasher.update(repr(array.shape).encode())
        for _, part in iter_chunks(array):
            hasher.update(np.ascontiguousarray(part, dtype="<f8").data)
    return hasher.hexdigest()


@dataclass
class AppendableArray:
    """An array (N, ...) to which rows are appended; beyond 4 MB it lies in a temporary
    file."""

    #: Rows in memory.
    _pieces: list[NDArray[Any]] = field(default_factory=list)
    #: Size of all rows so far [bytes].
    _bytes: int = 0
    #: Number of all rows so far.
    _rows: int = 0
    #: Temporary file that holds the rows; None while they are in memory.
    _file: BinaryIO | None = None

    def append(self, rows: NDArray[Any]) -> None:
        """Append rows (K, ...); move all of them to a temporary file once they are
        large."""
        self._pieces.append(rows)
        self._bytes += rows.nbytes
        self._rows += len(rows)
        if self._bytes > LARGEST_IN_MEMORY:
            with _room():
                self._file = self._file or _unnamed_file()
                for piece in self._pieces:
                    for _, part in iter_chunks(piece):
                        self._file.write(np.ascontiguousarray(part).data)
            self._pieces = [rows[:0]]

    def array(self) -> NDArray[Any]:
        """Return all rows as one array, and end the appending. The array is in memory,
        or mapped read-only from the temporary file if it is large."""
        if self._file is None:
            is_one_piece = len(self._pieces) == 1
            pieces = self._pieces or [np.zeros(0)]
            return pieces[0] if is_one_piece else np.concatenate(pieces)
        first = self._pieces[0]
        with _room(), self._file as file:
            file.flush()
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        return np.frombuffer(mapped, first.dtype).reshape(self._rows, *first.shape[1:])


class DiskCache:
    """Values in a temporary file, each read again when it is asked for: what every pass
    over a long recording needs."""

    def __init__(self) -> None:
        """Open the temporary file."""
        with _room():
            self._file = _unnamed_file()

    def put(self, value: Any) -> Callable[[], Any]:
        """Write a value to the file, its arrays without a copy, and return a function
        that reads it again."""
        buffers = list[pickle.PickleBuffer]()
        head = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
        places = [self._put(memoryview(head)), *(self._put(x.raw()) for x in buffers)]

        def read() -> Any:
            """Read the value from its places in the file."""
            number = self._file.fileno()
            head, *arrays = (os.pread(number, size, start) for start, size in places)
            return pickle.loads(head, buffers=arrays)

        return read

    def _put(self, content: memoryview) -> tuple[int, int]:
        """Write bytes behind all others; return their place and number."""
        with _room():
            start = self._file.seek(0, os.SEEK_END)
            self._file.write(content)
            self._file.flush()
        return start, len(content)


def _unnamed_file() -> BinaryIO:
    """Open a temporary file without a name, in $TMPDIR or /var/tmp, which lie on a
    disk."""
    folder = os.environ.get("TMPDIR")
    if not folder and Path("/var/tmp").is_dir():
        folder = "/var/tmp"
    return tempfile.TemporaryFile(dir=folder or None, buffering=1 << 20)  # type: ignore[return-value]


@contextmanager
def _room() -> Iterator[None]:
    """While a temporary file is written, turn errors of the system (a full disk) into
    InputError."""
    try:
        yield
    except OSError as error:
        if error.errno == errno.EFBIG:  # the limit while a file is unpacked
            raise
        what = f"no temporary file for the samples ({error.strerror})"
        raise InputError(
            what, "set TMPDIR to a folder with room for 8 bytes a number"
        ) from error


def concatenate_chunks(arrays: Iterable[NDArray[Any]]) -> NDArray[Any]:
    """Concatenate chunks (N_i, ...), each of which is made when it is its turn; a large
    result lies in a temporary file.

    Returns
    -------
    NDArray[Any]
        (sum of N_i, ...) numbers.
    """
    joined = AppendableArray()
    for array in arrays:
        joined.append(array)
    return joined.array()
