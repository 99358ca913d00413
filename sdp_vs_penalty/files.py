"""Every file that a user names: inputs are bounded; outputs are whole or not there at
all, and never replace what the same command has read.

An input is a regular file, no device and no pipe; at most so many bytes by its kind;
and while a library unpacks it, at most so much memory. Whatever a file holds, it costs
a bounded amount and ends in one sentence. Frozen dataclasses become plain JSON, there
and back, by the types of their fields.
"""

import csv
import errno
import glob
import io
import json
import os
import stat
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from sdp_vs_penalty.errors import InputError, quote_value, unreadable

T = TypeVar("T")

#: Bytes of one file: of a recording (CSV text of 4 GiB of numbers), of what is parsed
#: whole (URDF, mesh, JSON, bounds, proofs: the largest of ours, a proof of 60 links,
#: has 12 MB), and of TOML, whose parser takes time with the square of a dotted key's
#: length (ours have 2 kB).
LARGEST_RUN = 2**34
LARGEST_TEXT = 2**26
LARGEST_TOML = 2**16
#: Memory that unpacking a file may take: bytes, and bytes a byte of it. Measured
#: channels unpack to 3 to 20 times their size.
_ROOM = 384 * 2**20
_PER_BYTE = 25
#: Seconds for which a command that writes several files waits for another one that
#: writes into the same folder.
WRITERS_PATIENCE = 10.0
#: Device and inode of every file that the running command was given or has read. None
#: outside of one: in a notebook a model may be written over the file that it came from.
_inputs = ContextVar[set[tuple[int, int]] | None]("inputs", default=None)


@contextmanager
def protecting() -> Iterator[None]:
    """Keep the outputs of a command from replacing files that it reads, while this
    runs.

    :func:`opened` registers these files.
    """
    before = _inputs.set(set())
    try:
        yield
    finally:
        _inputs.reset(before)


def opened(path: str | Path) -> None:
    """Register a file that the running command reads, so that it cannot overwrite it.

    Parameters
    ----------
    path : path
        A file, or a folder whose files all count.
    """
    inputs = _inputs.get()
    path = Path(path)
    if inputs is None:
        return
    # A file that does not exist, or has an impossible name, is reported by its reader.
    with suppress(OSError, ValueError):
        for file in path.iterdir() if path.is_dir() else [path]:
            status = file.stat()
            if stat.S_ISREG(status.st_mode):
                inputs.add((status.st_dev, status.st_ino))


def _bounded(path: Path, mode: int, size: int, largest: int) -> None:
    """Raise InputError unless a file is regular and not too large.

    Parameters
    ----------
    path : Path
        The file, for the error message.
    mode : int
        Its mode, as os.stat gives it.
    size, largest : int
        Its size, and the largest one allowed [bytes].
    """
    if stat.S_ISDIR(mode):
        raise InputError("is a folder", "name a file", path)
    if not stat.S_ISREG(mode):
        raise InputError(
            "is no regular file (a device, a pipe or a socket)",
            "save it to a file",
            path,
        )
    if size > largest:
        limit_words = f"{largest // 2**10} KiB"
        if largest >= 2**20:
            limit_words = f"{largest // 2**20} MiB"
        raise InputError(
            f"larger than {limit_words}", "name a smaller file, or cut it", path
        )


@contextmanager
def reading(path: str | Path, largest: int = LARGEST_RUN) -> Iterator[Path]:
    """Let a library read a file by its path.

    Limits of this process would hold for all its threads: what unpacks a file in this
    process looks at the sizes that the file declares (:func:`memory_for`), and
    compiled parsers run in a process of their own, which is limited.

    Parameters
    ----------
    path : path
        A regular file, or a folder of regular files.
    largest : int
        Largest size of a file [bytes].

    Raises
    ------
    InputError
        If the path is no such file, is too large, or takes more memory than there is.
    """
    path = Path(path)
    try:
        files = (
            [f for f in path.iterdir() if not f.is_dir()] if path.is_dir() else [path]
        )
        states = [file.stat() for file in files]
    except (OSError, ValueError) as error:
        raise unreadable(error, path) from error
    for file, status in zip(files, states, strict=True):
        _bounded(file, status.st_mode, status.st_size, largest)
    opened(path)
    try:
        yield path
    except MemoryError as error:
        raise unpacks_to_too_much(path) from error
    except OSError as error:
        raise unreadable(error, path) from error


def unpacks_to_too_much(path: Path) -> InputError:
    """Return the error for a file that unpacks to more memory than one of its size
    should."""
    return InputError(
        "unpacks to far more than a file of its size",
        "split it, or save it without compression",
        path,
    )


def memory_for(size: int) -> int:
    """Return how much memory [bytes] the unpacking of a file of this size [bytes] may
    take.

    Measured channels unpack to 3 to 20 times the size of their file.
    """
    return _ROOM + _PER_BYTE * size


def path_or_file(path: Path) -> Path | BinaryIO:
    """Return a path, or the opened file if its name is not UTF-8.

    Some libraries take UTF-8 paths only.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return path.open("rb")
    return path


def read_bytes(
    path: str | Path, largest: int = LARGEST_TEXT, is_own: bool = False
) -> bytes:
    """Read a complete file of at most ``largest`` bytes.

    Parameters
    ----------
    is_own : bool
        Whether the command maintains this file itself, and may write it again.

    Raises
    ------
    InputError
        If it is no regular file, is too large, or cannot be read.
    """
    path = Path(path)
    try:
        # Opened before it is looked at, so that it cannot change in between; a pipe
        # does not wait.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with open(handle, "rb") as file:
            status = os.fstat(handle)
            _bounded(path, status.st_mode, status.st_size, largest)
            # Memory for all that is asked for is taken at once; some files of the
            # system state no size.
            content = file.read(min(largest, status.st_size or LARGEST_TEXT) + 1)
        _bounded(path, status.st_mode, len(content), largest)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise unreadable(error, path) from error
    if not is_own:
        opened(path)
    return content


def refuse_stand_in(path: str | Path, content: bytes) -> None:
    """Refuse what a download can leave in place of a file.

    Parameters
    ----------
    path : str | Path
        Path of the file, for messages.
    content : bytes
        The file, or its beginning.

    Raises
    ------
    InputError
        It is a pointer of Git LFS, or a web page.
    """
    beginning = content[:1000].lstrip().lower()
    if beginning.startswith(b"version https://git-lfs"):
        what = "a pointer of Git LFS, not the file itself"
        raise InputError(what, "fetch the file with `git lfs pull`", path)
    if beginning.startswith((b"<!doctype html", b"<html")):
        what = "a web page, not the file itself"
        raise InputError(what, "download the raw file", path)


def read_text(
    path: str | Path, largest: int = LARGEST_TEXT, is_own: bool = False
) -> str:
    """Read a complete file of UTF-8 text, of at most ``largest`` bytes.

    Parameters
    ----------
    is_own : bool
        Whether the command maintains this file itself, and may write it again.

    Raises
    ------
    InputError
        If it cannot be read, as for :func:`read_bytes`, or is not UTF-8.
    """
    try:
        return read_bytes(path, largest, is_own).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"not UTF-8 text ({error})", "save it as UTF-8", Path(path)
        ) from error


def read_table(path: str | Path) -> list[dict[str, str]]:
    """Read the rows of a CSV table.

    Parameters
    ----------
    path : path
        A CSV file with headings.

    Returns
    -------
    list of dict
        Each row as text by heading.
    """
    try:
        return [
            dict(row)
            for row in csv.DictReader(io.StringIO(read_text(path), newline=""))
        ]
    except csv.Error as error:
        raise InputError(
            f"not a CSV table ({error})", "write it anew as UTF-8 text", path
        ) from error


def read_json(
    path: str | Path, kind: str, mark: str, build: Callable[[dict[str, Any]], T]
) -> T:
    """Read a JSON document of this program and build its record.

    Parameters
    ----------
    kind : str
        What the document is, for the error's sentence.
    mark : str
        A field that every document of this kind has.
    build : callable
        Makes the record from the document's fields.

    Raises
    ------
    InputError
        Names the file and what is wrong with it, whatever ``build`` raises.
    """

    def checked(data: Any) -> T:
        if not isinstance(data, dict) or mark not in data:
            raise InputError(
                f"not a {kind} of this program (no field {mark!r})", f"name a {kind}"
            )
        return build(data)

    return _built(
        Path(path), read_text(path), _parse_json, checked, "write the file anew"
    )


def require_format(
    data: Mapping[str, Any],
    newest: int,
    oldest: int = 1,
    *,
    older: str = "",
    remedy: str = "write it anew with this version",
) -> None:
    """Raise InputError for a JSON document of a format that this version cannot read.

    Parameters
    ----------
    newest, oldest : int
        Formats that this version reads.
    older : str
        What an older format lacks, for the error message.
    remedy : str
        What to do about it.
    """
    number = data.get("format")
    if not isinstance(number, int) or isinstance(number, bool):
        what = f"its format is {quote_value(number)}, which is no whole number"
        raise InputError(what, "write the file anew")
    if number < oldest:
        what = f"written by an earlier version (format {number})"
        reason = older or f"this one reads from {oldest} on"
        raise InputError(f"{what}, {reason}", remedy)
    if number > newest:
        raise InputError(
            f"written by a newer version (format {number}, this one reads up to"
            f" {newest})",
            "upgrade sdp-vs-penalty",
        )


def _parse_json(text: str) -> Any:
    """Parse JSON text; a field that comes twice, and a whole number that no double
    holds, raise ValueError."""
    return json.loads(text, object_pairs_hook=unique_fields, parse_int=_whole_number)


def _whole_number(digits: str) -> int:
    """Return a whole number of JSON; ValueError for more than 300 digits."""
    if len(digits) > 300:
        raise ValueError(f"a whole number of {len(digits)} digits")
    return int(digits)


def unique_fields(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the fields of a JSON object; raise ValueError if one comes twice.

    Programs differ in which of two equal fields they read, so such a file is refused.

    Parameters
    ----------
    pairs : list of tuples
        Names and values, as the parser finds them.
    """
    value_by_name = dict(pairs)
    if len(value_by_name) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the field {twice!r} comes twice")
    return value_by_name


def read_toml(path: Path, build: Callable[[dict[str, Any]], T]) -> T:
    """Read a TOML file of this program and build its record.

    Parameters
    ----------
    build : callable
        Makes the record from the file's fields.

    Raises
    ------
    InputError
        Names the file and what is wrong with it, whatever ``build`` raises.
    """
    remedy = "compare the file with a built-in one"
    return _built(path, read_text(path, LARGEST_TOML), tomllib.loads, build, remedy)


def _built(
    path: Path,
    text: str,
    parse: Callable[[str], Any],
    build: Callable[[Any], T],
    remedy: str,
) -> T:
    """Parse a text and build a record from it; turn every error into one sentence.

    Parameters
    ----------
    path : Path
        The file, for the error message.
    parse : callable
        Parser of JSON or TOML.
    build : callable
        Makes the record from the parsed data.
    remedy : str
        What the user can do if a field is wrong.
    """
    try:
        data = parse(text)
    except (ValueError, RecursionError) as error:
        what = "nested too deeply" if isinstance(error, RecursionError) else error
        kind = "JSON" if parse is _parse_json else "TOML"
        raise InputError(
            f"not a {kind} file ({what})", "correct it, or name another", path
        ) from error
    try:
        return build(data)
    except InputError as error:
        # One that names a file of its own, which this one mentions, stays as it is.
        raise error if isinstance(error.where, Path) else error.within(path) from error
    except KeyError as error:
        raise InputError(
            f"the field {error.args[0]!r} is missing", remedy, path
        ) from error
    except (
        ArithmeticError,
        AttributeError,
        LookupError,
        RecursionError,
        TypeError,
        ValueError,
    ) as why:
        raise InputError(
            f"a field has the wrong content ({why})", remedy, path
        ) from why


@contextmanager
def writing(path: str | Path, lasting: bool = True) -> Iterator[BinaryIO]:
    """Write a file atomically: the new file replaces the old one once it is complete.

    A writer that is killed leaves nothing behind. On systems where a file cannot exist
    without a name, it leaves at most one file, which the next writer removes. A
    symbolic link stays, and its target is replaced. A device or a pipe is written to
    directly.

    Parameters
    ----------
    lasting : bool
        Whether it waits until the file is on the disk and survives a power cut.

    Raises
    ------
    InputError
        If the file is an input of this command, or cannot be written.
    """
    path = Path(path)
    try:
        there = None
        with suppress(FileNotFoundError):
            there = path.stat()  # of what a link leads to
        if there is not None and stat.S_ISDIR(there.st_mode):
            raise _is_folder(path)
        _refuse_input(path, there)
        if there is None or stat.S_ISREG(there.st_mode):
            with _replacing(Path(os.path.realpath(path)), lasting) as file:
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
    """Return the InputError for a file that cannot be written, with the reason."""
    what = error.strerror if isinstance(error, OSError) else error
    return InputError(
        f"cannot be written ({what})", "choose another place, or free this one", path
    )


def require_writable(path: str | Path, may_be_folder: bool) -> None:
    """Raise InputError if :func:`writing` would refuse a path; nothing is written.

    It is asked before long work. A folder that does not exist yet would be made, so the
    nearest folder above it that exists must take new files.

    Parameters
    ----------
    path : path
        The file to write, or a folder to write into.
    may_be_folder : bool
        Whether an existing folder is meant as the place of several files.

    Raises
    ------
    InputError
        The path is an input of this command, is a folder where a file is needed, or
        cannot be written.
    """
    path = Path(path)
    try:
        there = None
        with suppress(FileNotFoundError):
            there = path.stat()
        _refuse_input(path, there)
        folder = path
        if there is not None and not stat.S_ISDIR(there.st_mode):
            if not stat.S_ISREG(there.st_mode):
                return  # a device or a pipe
            folder = Path(os.path.realpath(path)).parent
        elif there is not None and not may_be_folder:
            raise _is_folder(path)
        while not folder.exists():
            folder = folder.parent
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise _unwritable(error, path) from error


def _refuse_input(path: Path, there: os.stat_result | None) -> None:
    """Raise InputError if a file to write is an input of this command.

    there : state of the file that the path leads to; None if there is none. Files are
    compared by inode, so that no link hides an input.
    """
    if there is not None and (there.st_dev, there.st_ino) in (_inputs.get() or ()):
        raise InputError(
            "is also an input of this command", "name another file to write", path
        )


def _is_folder(path: Path) -> InputError:
    """Return the InputError for a folder where a file is to be written."""
    return InputError("cannot be written (it is a folder)", "name a file", path)


def write_bytes(path: str | Path, content: bytes, lasting: bool = True) -> None:
    """Write a file atomically: completely or not at all.

    Raises
    ------
    InputError
        If it is an input of this command, or cannot be written.
    """
    with writing(path, lasting) as file:
        file.write(content)


@contextmanager
def _replacing(path: Path, lasting: bool) -> Iterator[BinaryIO]:
    """Yield a new file, and put it in the place of ``path`` once it is complete.

    If possible the file has no name until then, so that it vanishes if the writer is
    killed. ``lasting``: it is on the disk before it replaces the old one.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = _part_name(path)
    handle = _nameless_file(path.parent)
    has_name = handle is None
    if handle is None:
        handle = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666)
    try:
        try:
            with open(handle, "wb", closefd=False) as part:
                yield part
            if lasting:
                os.fsync(handle)
            if not has_name:
                folder = os.open(temporary.parent, os.O_RDONLY)
                try:
                    # With the handle of a folder Python follows the link to the file.
                    os.link(f"/proc/self/fd/{handle}", temporary, src_dir_fd=folder)
                finally:
                    os.close(folder)
        finally:
            os.close(handle)
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(temporary)
        raise
    if lasting:
        with suppress(OSError):  # not every file system can
            _sync_folder(path.parent)


def _part_name(path: Path) -> Path:
    """Return a temporary name for the file that will replace ``path``.

    The name holds this process's number. Files of processes that no longer exist are
    removed.
    """
    # A name has at most 255 bytes.
    prefix = f".{os.fsdecode(os.fsencode(path.name)[:100])}."
    end = ".part"
    for file in path.parent.glob(f"{glob.escape(prefix)}*{end}"):
        number = file.name.removeprefix(prefix).split(".")[0]
        if number.isdigit() and not lives(int(number)):
            with suppress(OSError):
                file.unlink()
    unique = os.urandom(6).hex()
    return path.parent / f"{prefix}{os.getpid()}.{unique}{end}"


def _nameless_file(folder: Path) -> int | None:
    """Open a file without a name in a folder; it vanishes with its writer.

    Returns the file descriptor, or None if the system or the file system cannot do
    that.
    """
    if not hasattr(os, "O_TMPFILE"):
        return None
    try:
        return os.open(folder, os.O_TMPFILE | os.O_RDWR, 0o666)
    except OSError as error:
        if error.errno in (errno.EOPNOTSUPP, errno.EISDIR, errno.ENOENT, errno.EINVAL):
            return None
        raise


def _sync_folder(folder: Path) -> None:
    """Flush the names of a folder's files to the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def lives(process: int) -> bool:
    """Whether a process exists, perhaps of another user."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True  # somebody else's
    return True


@contextmanager
def folder_lock(folder: Path, patience: float = 0.0) -> Iterator[None]:
    """Keep other commands from writing results into a folder while this one runs.

    The lock ends with the process. A folder that was made for the lock is removed again
    if nothing was written into it.

    Parameters
    ----------
    patience : float
        How long to wait for another command [s].

    Raises
    ------
    InputError
        If the other command is still writing after that, or the folder cannot be made.
    """
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        yield
        return
    try:
        is_new = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise _unwritable(error, folder) from error
    end = time.monotonic() + patience
    try:
        while True:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() >= end:
                    raise InputError(
                        "another command is writing its results there",
                        "wait until it ends, or name another folder",
                        folder,
                    ) from None
            time.sleep(0.05)
        yield
    finally:
        with suppress(OSError):  # it holds something
            if is_new:
                folder.rmdir()
        os.close(handle)


def write_text(path: str | Path, content: str, lasting: bool = True) -> None:
    """Write a text as UTF-8, atomically: completely or not at all.

    Bytes of a file name that are not text (PEP 383) are written as escapes.

    Raises
    ------
    InputError
        If it is an input of this command, or cannot be written.
    """
    write_bytes(path, content.encode("utf-8", "backslashreplace"), lasting)


def problems_folder() -> Path:
    """Return the folder of the built-in problems.

    It is part of the installed package, or stands next to the package in a checkout.
    """
    package = Path(__file__).parent
    inside = package / "problems"
    return inside if inside.is_dir() else package.parent / "problems"
