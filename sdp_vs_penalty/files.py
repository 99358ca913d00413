"""Outputs are written whole or not at all, never over what the same command has read; JSON is read.

And where the files of the package itself are.
"""

from __future__ import annotations

import csv
import glob
import io
import itertools
import json
import os
import stat
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from sdp_vs_penalty.errors import InputError, unreadable

T = TypeVar("T")

#: Device and inode of every file that the running command was given or has read. None outside of one:
#: in a notebook a model may be written over the file that it came from.
_inputs: set[tuple[int, int]] | None = None


@contextmanager
def protecting() -> Iterator[None]:
    """While this runs, no output may replace a file that :func:`opened` has heard of."""
    global _inputs
    before, _inputs = _inputs, set()
    try:
        yield
    finally:
        _inputs = before


def problems_folder() -> Path:
    """Where the built-in problems are: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).parent
    inside = package / "problems"
    return inside if inside.is_dir() else package.parent / "problems"


def opened(path: str | Path) -> None:
    """A reader says what it reads; of a folder all files in it. By inode, so that no link hides it."""
    if _inputs is None:
        return
    path = Path(path)
    try:
        for file in path.iterdir() if path.is_dir() else [path]:
            found = file.stat()
            if stat.S_ISREG(found.st_mode):
                _inputs.add((found.st_dev, found.st_ino))
    except (OSError, ValueError):  # no such file, or no name of one: whoever reads it says so
        return


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
        if there is not None and _inputs and (there.st_dev, there.st_ino) in _inputs:
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
        what = error.strerror if isinstance(error, OSError) else error
        raise InputError(
            f"cannot be written ({what})", "choose another place, or free this one", path
        ) from error


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
    temporary = path.parent / f"{_prefix(path)}{os.getpid()}.{next(_written)}{_PART}"
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
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


#: End of the names of files that are being written, and how many this process has written.
_PART = ".part"
_written = itertools.count()


def _prefix(path: Path) -> str:
    return f".{path.name[:100]}."


def _remove_leftovers(path: Path) -> None:
    """What a writer that was killed has left: its name tells its process, which is no more."""
    for file in path.parent.glob(f"{glob.escape(_prefix(path))}*{_PART}"):
        number = file.name.removeprefix(_prefix(path)).split(".")[0]
        if number.isdigit() and not _lives(int(number)):
            with suppress(OSError):
                file.unlink()


def _lives(process: int) -> bool:
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

    Raises InputError where another command does so already.
    """
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        yield
        return
    folder.mkdir(parents=True, exist_ok=True)
    handle = os.open(folder, os.O_RDONLY)
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


def read_table(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV table, as text by heading."""
    opened(path)
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [dict(row) for row in csv.DictReader(file)]
    except OSError as error:
        raise unreadable(error, path) from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"not a CSV table ({error})", "write it anew as UTF-8 text", path) from error


def read_json(path: str | Path, kind: str, mark: str, build: Callable[[dict[str, Any]], T]) -> T:
    """What ``build`` makes of the JSON object at ``path``; every ``kind`` of file has a field ``mark``.

    Raises InputError naming the file and what is wrong with it, whatever build raises on bad content.
    """

    def checked(data: Any) -> T:
        if not isinstance(data, dict) or mark not in data:
            raise InputError(f"not a {kind} of this program (no field {mark!r})", f"name a {kind}")
        return build(data)

    return _built(Path(path), "JSON", json.loads, checked, "write the file anew")


def read_toml(path: Path, build: Callable[[dict[str, Any]], T]) -> T:
    """What ``build`` makes of the TOML file at ``path``; errors as of :func:`read_json`."""
    import tomllib

    return _built(path, "TOML", tomllib.loads, build, "compare the file with a built-in one")


def _built(
    path: Path, kind: str, parse: Callable[[str], Any], build: Callable[[Any], T], remedy: str
) -> T:
    opened(path)
    try:
        data = parse(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise unreadable(error, path) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"not a {kind} file ({error})", "correct it, or name another", path) from error
    try:
        return build(data)
    except InputError as error:
        # One that names a file of its own, which this one mentions, stays as it is.
        raise error if isinstance(error.where, Path) else error.within(path) from error
    except KeyError as error:
        raise InputError(f"the field {error.args[0]!r} is missing", remedy, path) from error
    except (TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        raise InputError(f"a field has the wrong content ({error})", remedy, path) from error
