"""Numbers of a recording: in memory while they are few, else in a temporary file that
is mapped there.

A mapped array is an ordinary NumPy array that cannot be written to: whatever works on
one works on the other, with the same result. The file has no name, so that nothing is
left of it however the process ends; it lies in $TMPDIR, else in /var/tmp, which is on a
disk where /tmp may not be. What has been read of a mapped array stays in memory until
something else needs the memory.
"""

import errno
import hashlib
import mmap
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.errors import InputError

#: Bytes of one array above which it goes to a file: 300 000 samples of seven joints.
LARGEST_IN_MEMORY = 2**24
#: Samples that are worked on at a time.
PART = 1 << 15


def iter_chunks(
    array: NDArray[Any], overlap: int = 0
) -> Iterator[tuple[int, NDArray[Any]]]:
    """Go through an array in consecutive chunks.

    Parameters
    ----------
    array : NDArray[Any]
        (N, ...) numbers.
    overlap : int
        How many rows of the next chunk belong to each one too.

    Yields
    ------
    tuple[int, NDArray[Any]]
        The first row of each chunk, and its rows.
    """
    for start in range(0, len(array), PART):
        yield start, array[start : start + PART + overlap]


def digest(arrays: Iterable[NDArray[Any]]) -> str:
    """Hash arrays over their numbers.

    Parameters
    ----------
    arrays : Iterable[NDArray[Any]]
        Of any shape.

    Returns
    -------
    str
        SHA-256 as hexadecimal digits.
    """
    hasher = hashlib.sha256()
    for array in arrays:
        hasher.update(repr(array.shape).encode())
        for _, part in iter_chunks(array):
            hasher.update(np.ascontiguousarray(part, dtype="<f8").data)
    return hasher.hexdigest()


@dataclass
class AppendableArray:
    """An array (N, ...) that rows are appended to."""

    _pieces: list[NDArray[Any]] = field(default_factory=list)
    _bytes: int = 0
    _rows: int = 0
    _file: BinaryIO | None = None

    def append(self, rows: NDArray[Any]) -> None:
        """Append rows.

        Parameters
        ----------
        rows : NDArray[Any]
            (N, ...) numbers.
        """
        self._pieces.append(rows)
        self._bytes, self._rows = self._bytes + rows.nbytes, self._rows + len(rows)
        if self._bytes > LARGEST_IN_MEMORY:
            with _room():
                self._file = self._file or _unnamed_file()
                for piece in self._pieces:
                    for _, part in iter_chunks(piece):
                        self._file.write(np.ascontiguousarray(part).data)
            self._pieces = [rows[:0]]

    def array(self) -> NDArray[Any]:
        """All rows; nothing can be appended any more."""
        if self._file is None:
            return (
                self._pieces[0]
                if len(self._pieces) == 1
                else np.concatenate(self._pieces)
            )
        first = self._pieces[0]
        with _room(), self._file as file:
            file.flush()
            mapped = mmap.mmap(
                file.fileno(),
                0,
                access=mmap.ACCESS_READ,
            )
        return np.frombuffer(mapped, first.dtype).reshape(self._rows, *first.shape[1:])


class DiskCache:
    """Values in a temporary file, each read again when it is asked for: what every pass
    over a long recording needs."""

    def __init__(self) -> None:
        with _room():
            self._file = _unnamed_file()

    def put(self, value: Any) -> Callable[[], Any]:
        """How to read a value again: arrays from the file, also those within lists and
        dataclasses; everything else is kept as it is."""
        if isinstance(value, list):
            readers = [self.put(x) for x in value]
            return lambda: [read() for read in readers]
        if is_dataclass(value) and not isinstance(value, type):
            known = {
                f.name: self.put(getattr(value, f.name))
                for f in fields(value)
                if f.init
            }
            kind = type(value)
            return lambda: kind(**{name: read() for name, read in known.items()})
        if not isinstance(value, np.ndarray):
            return lambda: value
        turned = value.flags.f_contiguous and not value.flags.c_contiguous
        rows = np.ascontiguousarray(value.T if turned else value)
        with _room():
            start = self._file.seek(0, os.SEEK_END)
            self._file.write(rows.data)
            self._file.flush()
        shape = rows.shape
        dtype = rows.dtype
        size = rows.nbytes

        def read() -> NDArray[Any]:
            flat = np.frombuffer(
                os.pread(self._file.fileno(), size, start), dtype
            ).reshape(shape)
            return flat.T if turned else flat

        return read


def _unnamed_file() -> BinaryIO:
    home = os.environ.get("TMPDIR") or (
        "/var/tmp" if Path("/var/tmp").is_dir() else None
    )
    return tempfile.TemporaryFile(dir=home, buffering=1 << 20)  # type: ignore[return-value]


@contextmanager
def _room() -> Iterator[None]:
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
    """Put chunks together, on the disk where they are many.

    Parameters
    ----------
    arrays : Iterable[NDArray[Any]]
        (N, ...) each.

    Returns
    -------
    NDArray[Any]
        (sum of N, ...) numbers.
    """
    joined = AppendableArray()
    for array in arrays:
        joined.append(array)
    return joined.array()
