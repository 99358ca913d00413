"""Outputs are written whole or not at all, never over what the same command has read."""

import csv
import glob
import io
import os
import stat
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files.inputs import is_input


@contextmanager
def writing(path: str | Path) -> Iterator[BinaryIO]:
    """A temporary file beside the target, to be renamed: an interruption keeps the old file.

    A writer that is killed leaves at most that one file, which the next writer of the target removes.

    A link stays, its target is replaced. A device or a pipe is written to as it is. Raises InputError
    where the file is an input of this command, or cannot be written.
    """
    path = Path(path)
    try:
        there = _there(path)
        if there is not None and stat.S_ISDIR(there.st_mode):
            raise InputError("cannot be written (it is a folder)", "name a file", path)
        if there is not None and is_input(there):
            raise InputError("is also an input of this command", "name another file to write", path)
        if there is None or stat.S_ISREG(there.st_mode):
            with _replacing(Path(os.path.realpath(path))) as file:
                yield file
            return
        content = io.BytesIO()  # which can be told where it is, as some formats need
        yield content
        with path.open("wb") as device:
            device.write(content.getbuffer())
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise _unwritable(error, path) from error


def _unwritable(error: Exception, path: Path) -> InputError:
    what = error.strerror if isinstance(error, OSError) else error
    return InputError(f"cannot be written ({what})", "choose another place, or free this one", path)


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file, whole or not at all; errors as of :func:`writing`."""
    with writing(path) as file:
        file.write(content)


def _there(path: Path) -> os.stat_result | None:
    """What the path leads to, links followed; None for nothing yet."""
    try:
        return path.stat()
    except FileNotFoundError:
        return None


@contextmanager
def _replacing(path: Path) -> Iterator[BinaryIO]:
    """The new file whole under a name of its own, on the disk, and only then under the old name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_leftovers(path)
    umask = os.umask(0)
    os.umask(umask)
    handle, temporary = tempfile.mkstemp(_PART, f"{_prefix(path)}{os.getpid()}.", path.parent)
    try:
        try:
            with open(handle, "wb", closefd=False) as file:
                yield file
            os.fchmod(handle, 0o666 & ~umask)
            os.fsync(handle)
        finally:
            os.close(handle)
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(temporary)
        raise
    _sync_folder(path.parent)


#: End of the names of files that are being written.
_PART = ".part"


def _prefix(path: Path) -> str:
    return f".{path.name[:100]}."


def _remove_leftovers(path: Path) -> None:
    """What a writer that was killed has left: its name tells its process, which is no more."""
    for file in path.parent.glob(f"{glob.escape(_prefix(path))}*{_PART}"):
        number = file.name.removeprefix(_prefix(path)).split(".")[0]
        if number.isdigit() and not lives(int(number)):
            with suppress(OSError):
                file.unlink()


def lives(process: int) -> bool:
    """Whether there is a process of this number."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True  # somebody else's
    return True


def _sync_folder(folder: Path) -> None:
    """The new name on the disk as well; not every file system can."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """While this runs, no other command adds its results to this folder; the lock ends with the process.

    Raises InputError where another command does so already, and where the folder cannot be made.
    """
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        yield
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise _unwritable(error, folder) from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                "another command is writing its results there",
                "wait until it ends, or name another folder",
                folder,
            ) from None
        yield
    finally:
        os.close(handle)


def write_text(path: str | Path, content: str) -> None:
    write_bytes(path, content.encode())


def as_csv(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A CSV table with a row of headings."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([headings, *rows])
    return out.getvalue()
