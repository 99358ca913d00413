"""Every file that a user names: inputs are bounded; outputs are whole or not there at
all, and never replace what the same command has read.

An input is a regular file, no device and no pipe; at most so many bytes by its kind;
and while a library unpacks it, at most so much memory. Whatever a file holds, it costs
a bounded amount and ends in one sentence. Frozen dataclasses become plain JSON, there
and back, by the types of their fields.
"""

import collections.abc
import csv
import errno
import glob
import io
import json
import os
import stat
import time
import tomllib
import types
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import MISSING, fields
from functools import cache
from pathlib import Path
from typing import (
    Any,
    BinaryIO,
    Literal,
    Self,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

from sdp_vs_penalty.errors import InputError, given, unreadable

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
    """While this runs, no output may replace a file that :func:`opened` has heard of."""
    before = _inputs.set(set())
    try:
        yield
    finally:
        _inputs.reset(before)


def opened(path: str | Path) -> None:
    """Note that the running command reads a file, so that it cannot overwrite it.

    Parameters
    ----------
    path : path
        A file, or a folder of which all files count.
    """
    inputs = _inputs.get()
    path = Path(path)
    if inputs is None:
        return
    try:
        for file in path.iterdir() if path.is_dir() else [path]:
            status = file.stat()
            if stat.S_ISREG(status.st_mode):
                inputs.add((status.st_dev, status.st_ino))
    except (
        OSError,
        ValueError,
    ):  # no such file, or no name of one: whoever reads it says so
        return


def _bounded(
    path: Path,
    mode: int,
    size: int,
    largest: int,
) -> None:
    """InputError unless it is a file that may be read whole."""
    if stat.S_ISDIR(mode):
        raise InputError("is a folder", "name a file", path)
    if not stat.S_ISREG(mode):
        raise InputError(
            "is no regular file (a device, a pipe or a socket)",
            "save it to a file",
            path,
        )
    if size > largest:
        limit_words = (
            f"{largest // 2**20} MiB" if largest >= 2**20 else f"{largest // 2**10} KiB"
        )
        raise InputError(
            f"larger than {limit_words}",
            "name a smaller file, or cut it",
            path,
        )


@contextmanager
def reading(path: str | Path, largest: int = LARGEST_RUN) -> Iterator[Path]:
    """Open a file for a library that takes a path, with memory limited while it reads.

    Parameters
    ----------
    path : path
        A regular file, or a folder of regular files.
    largest : int
        Largest size of a file [bytes].

    Yields
    ------
    Path
        The path to read.

    Raises
    ------
    InputError
        Where the path is no such file, is too large, or unpacks to more than its size
        allows.
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
    room = memory_for(sum(status.st_size for status in states))
    try:
        with limited_memory(room):
            yield path
    except (MemoryError, OSError) as error:
        if isinstance(error, OSError) and error.errno != errno.EFBIG:
            raise unreadable(error, path) from error
        raise InputError(
            f"unpacks to more than {room // 2**20} MiB, unlike a file of its size",
            "split it, or save it without compression",
            path,
        ) from error


def memory_for(size: int) -> int:
    """Memory that unpacking a file may take.

    Parameters
    ----------
    size : int
        Size of the file [bytes].

    Returns
    -------
    int
        Bytes.
    """
    return _ROOM + _PER_BYTE * size


@contextmanager
def limited_memory(room: int) -> Iterator[None]:
    """Limit the memory that this process may add, and the size of files that it may write.

    Mapped files do not count. Where the system has no such limits, nothing is limited.

    Parameters
    ----------
    room : int
        Memory beyond what the process has now [bytes].
    """
    try:  # private memory, as the limit counts it; the sixth figure is its pages
        pages = int(Path("/proc/self/statm").read_text("utf-8").split()[5])
    except OSError:  # not Linux
        yield
        return
    import resource

    used = pages * resource.getpagesize()
    before = {}
    for kind, allowed in (
        (resource.RLIMIT_DATA, used + room),
        (resource.RLIMIT_FSIZE, room),
    ):
        soft, hard = before[kind] = resource.getrlimit(kind)
        limits = [x for x in (allowed, soft, hard) if x != resource.RLIM_INFINITY]
        resource.setrlimit(kind, (min(limits), hard))
    try:
        yield
    finally:
        for kind, limits_before in before.items():
            resource.setrlimit(kind, limits_before)


def path_or_file(path: Path) -> Path | BinaryIO:
    """What to hand to a library that takes UTF-8 paths only.

    Parameters
    ----------
    path : Path
        A path whose name may be no UTF-8.

    Returns
    -------
    Path or BinaryIO
        The path; the opened file where the name is no UTF-8.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return path.open("rb")
    return path


def read_bytes(
    path: str | Path,
    largest: int = LARGEST_TEXT,
    is_own: bool = False,
) -> bytes:
    """Read a whole file.

    Parameters
    ----------
    path : path
        A regular file.
    largest : int
        Largest size [bytes].
    is_own : bool
        Whether the command keeps this file itself and may write it again.

    Returns
    -------
    bytes
        Its content.

    Raises
    ------
    InputError
        Where it is no regular file, is too large, or cannot be read.
    """
    path = Path(path)
    try:
        # Opened before it is looked at, so that it cannot change in between; a pipe
        # does not wait.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with open(handle, "rb") as file:
            status = os.fstat(handle)
            _bounded(path, status.st_mode, status.st_size, largest)
            content = file.read(largest + 1)  # some files of the system state no size
        _bounded(path, status.st_mode, len(content), largest)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise unreadable(error, path) from error
    if not is_own:
        opened(path)
    return content


def read_text(
    path: str | Path,
    largest: int = LARGEST_TEXT,
    is_own: bool = False,
) -> str:
    """Read a whole file of UTF-8 text.

    Parameters
    ----------
    path : path
        A regular file.
    largest : int
        Largest size [bytes].
    is_own : bool
        Whether the command keeps this file itself and may write it again.

    Returns
    -------
    str
        Its text.

    Raises
    ------
    InputError
        Where it cannot be read, as :func:`read_bytes` does, or is no UTF-8.
    """
    try:
        return read_bytes(path, largest, is_own).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"not UTF-8 text ({error})",
            "save it as UTF-8",
            Path(path),
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
        A row each: text by heading.
    """
    try:
        return [
            dict(row)
            for row in csv.DictReader(io.StringIO(read_text(path), newline=""))
        ]
    except csv.Error as error:
        raise InputError(
            f"not a CSV table ({error})",
            "write it anew as UTF-8 text",
            path,
        ) from error


def read_json(
    path: str | Path,
    kind: str,
    mark: str,
    build: Callable[[dict[str, Any]], T],
) -> T:
    """Read a JSON document of this program and build its record.

    Parameters
    ----------
    path : path
        The file.
    kind : str
        What the document is, for the error's sentence.
    mark : str
        A field that every document of this kind has.
    build : callable
        Makes the record from the document's fields.

    Returns
    -------
    Any
        What ``build`` returns.

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
        Path(path),
        read_text(path),
        _parse_json,
        checked,
        "write the file anew",
    )


def require_format(
    data: Mapping[str, Any],
    newest: int,
    oldest: int = 1,
    *,
    unmarked: int | None = None,
    older: str = "",
    remedy: str = "write it anew with this version",
) -> int:
    """Format number of a JSON document, which has to be one that this version reads.

    Parameters
    ----------
    data : mapping
        The document's fields.
    newest, oldest : int
        Formats that this version reads.
    unmarked : int or None
        Format of a document without the field; None: such a document is refused.
    older : str
        What an older format lacks, for the error's sentence.
    remedy : str
        What to do about it.

    Returns
    -------
    int
        The format.

    Raises
    ------
    InputError
        Where the format is older or newer.
    """
    number = data.get("format", unmarked)
    if not isinstance(number, int) or isinstance(number, bool):
        what = f"its format is {given(number)}, which is no whole number"
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
    return number


def _parse_json(text: str) -> Any:
    return json.loads(text, object_pairs_hook=unique_fields)


def unique_fields(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Fields of a JSON object, none of which may come twice.

    Programs differ in which of two equal fields they read.

    Parameters
    ----------
    pairs : list of tuples
        Names and values, as the parser finds them.

    Returns
    -------
    dict
        The fields.

    Raises
    ------
    ValueError
        Where a field comes twice.
    """
    fields_ = dict(pairs)
    if len(fields_) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the field {twice!r} comes twice")
    return fields_


def read_toml(path: Path, build: Callable[[dict[str, Any]], T]) -> T:
    """Read a TOML file of this program and build its record.

    Parameters
    ----------
    path : Path
        The file.
    build : callable
        Makes the record from the file's fields.

    Returns
    -------
    Any
        What ``build`` returns.

    Raises
    ------
    InputError
        Names the file and what is wrong with it, whatever ``build`` raises.
    """
    remedy = "compare the file with a built-in one"
    return _built(
        path,
        read_text(path, LARGEST_TOML),
        tomllib.loads,
        build,
        remedy,
    )


def _built(
    path: Path,
    text: str,
    parse: Callable[[str], Any],
    build: Callable[[Any], T],
    else_: str,
) -> T:
    try:
        data = parse(text)
    except (ValueError, RecursionError) as error:
        what = "nested too deeply" if isinstance(error, RecursionError) else error
        kind = "JSON" if parse is _parse_json else "TOML"
        raise InputError(
            f"not a {kind} file ({what})",
            "correct it, or name another",
            path,
        ) from error
    try:
        return build(data)
    except InputError as error:
        # One that names a file of its own, which this one mentions, stays as it is.
        raise error if isinstance(error.where, Path) else error.within(path) from error
    except KeyError as error:
        raise InputError(
            f"the field {error.args[0]!r} is missing",
            else_,
            path,
        ) from error
    except (
        ArithmeticError,
        AttributeError,
        LookupError,
        RecursionError,
        TypeError,
        ValueError,
    ) as why:
        raise InputError(f"a field has the wrong content ({why})", else_, path) from why


@contextmanager
def writing(path: str | Path) -> Iterator[BinaryIO]:
    """Write a file whole or not at all: the new file replaces the old one once it is complete.

    A writer that is killed leaves nothing behind. On systems where a file cannot be without
    a name it leaves at most one file beside the target, which the next writer removes. A
    link stays and its target is replaced. A device or a pipe is written to directly.

    Parameters
    ----------
    path : path
        The file to write.

    Yields
    ------
    BinaryIO
        The new file.

    Raises
    ------
    InputError
        Where the file is an input of this command, or cannot be written.
    """
    path = Path(path)
    try:
        there = None
        with suppress(FileNotFoundError):
            there = path.stat()  # of what a link leads to
        if there is not None and stat.S_ISDIR(there.st_mode):
            raise InputError("cannot be written (it is a folder)", "name a file", path)
        # By inode, so that no link hides it.
        if there is not None and (there.st_dev, there.st_ino) in (_inputs.get() or ()):
            raise InputError(
                "is also an input of this command",
                "name another file to write",
                path,
            )
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
    return InputError(
        f"cannot be written ({what})",
        "choose another place, or free this one",
        path,
    )


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file, whole or not at all.

    Parameters
    ----------
    path : path
        The file.
    content : bytes
        Its content.

    Raises
    ------
    InputError
        As :func:`writing` does.
    """
    with writing(path) as file:
        file.write(content)


@contextmanager
def _replacing(path: Path) -> Iterator[BinaryIO]:
    """The new file without a name, whole and on the disk, and only then under the old
    name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = _part_name(path)
    handle = _nameless_file(path.parent)
    has_name = handle is None
    if handle is None:
        handle = os.open(
            temporary,
            os.O_CREAT | os.O_EXCL | os.O_RDWR,
            0o666,
        )
    try:
        try:
            with open(handle, "wb", closefd=False) as part:
                yield part
            os.fsync(handle)
            if not has_name:
                _name_file(handle, temporary)
        finally:
            os.close(handle)
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(temporary)
        raise
    with suppress(OSError):  # not every file system can
        _sync_folder(path.parent)


def _part_name(path: Path) -> Path:
    """What to call a new file until it takes the place of the old one. Removes what a
    writer that was killed has left: such a name holds the number of its process."""
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
    """A file of the folder that is gone when its writer is, as Linux has them; None
    where the system or the file system has none."""
    if not hasattr(os, "O_TMPFILE"):
        return None
    try:
        return os.open(folder, os.O_TMPFILE | os.O_RDWR, 0o666)
    except OSError as error:
        if error.errno in (errno.EOPNOTSUPP, errno.EISDIR, errno.ENOENT, errno.EINVAL):
            return None
        raise


def _name_file(handle: int, path: Path) -> None:
    """Give a nameless file a name."""
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        # With the handle of a folder Python follows the link to the file.
        os.link(f"/proc/self/fd/{handle}", path, src_dir_fd=folder)
    finally:
        os.close(folder)


def _sync_folder(folder: Path) -> None:
    """Put the names of a folder on the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def lives(process: int) -> bool:
    """Whether a process of this number exists.

    Parameters
    ----------
    process : int
        Process number.

    Returns
    -------
    bool
        True where it exists.
    """
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True  # somebody else's
    return True


@contextmanager
def folder_lock(folder: Path, patience: float = 0.0) -> Iterator[None]:
    """Keep other commands from adding results to a folder while this one runs.

    The lock ends with the process. A folder that was made for the lock is removed again
    where nothing was written into it.

    Parameters
    ----------
    folder : Path
        The folder.
    patience : float
        How long to wait for another command [s].

    Raises
    ------
    InputError
        Where the other command is still writing then, or the folder cannot be made.
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


def write_text(path: str | Path, content: str) -> None:
    """Write a text as UTF-8, whole or not at all.

    Bytes of a file name that are no text (PEP 383) are written as escapes.

    Parameters
    ----------
    path : path
        The file.
    content : str
        Its text.

    Raises
    ------
    InputError
        As :func:`writing` does.
    """
    write_bytes(path, content.encode("utf-8", "backslashreplace"))


def problems_folder() -> Path:
    """Where the built-in problems are: inside the installed package, or beside it in a
    checkout."""
    package = Path(__file__).parent
    inside = package / "problems"
    return inside if inside.is_dir() else package.parent / "problems"


class JsonRecord:
    """A dataclass of numbers, texts, arrays, other ``Plain`` ones, and tuples and
    mappings of these."""

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON; null where a number is not finite."""
        return {f.name: _plain(getattr(self, f.name)) for f in fields(self)}  # type: ignore[arg-type]

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Make the record that :meth:`to_dict` wrote.

        Parameters
        ----------
        data : mapping
            Fields by name; null stands for a field's default, where it has one.

        Returns
        -------
        JsonRecord
            The record.

        Raises
        ------
        KeyError, TypeError, ValueError
            Where a field is missing or of another kind.
        """
        kinds = _kinds(cls)  # type: ignore[arg-type]
        required = [
            f
            for f in fields(cls)  # type: ignore[arg-type]
            if f.default is MISSING and f.default_factory is MISSING
        ]
        there = {f.name for f in required} | {
            k for k in kinds if data.get(k) is not None
        }
        return cls(**{name: _restored(kinds[name], data[name]) for name in there})


class JsonRecordSkippingNone(JsonRecord):
    """The same, without fields that hold nothing: infinite limits, what a robot lacks."""

    def to_dict(self) -> dict[str, Any]:
        return {k: x for k, x in super().to_dict().items() if x is not None}


#: The types of a class's fields, which cost more to look up than a field to read.
_kinds = cache(get_type_hints)


def _plain(value: Any) -> Any:
    import numpy as np  # which `--help` does not pay for

    if hasattr(value, "to_dict"):
        return value.to_dict()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return [_plain(x) for x in value] if isinstance(value, tuple) else value


def _restored(kind: Any, value: Any) -> Any:
    """A value of a type hint; an absent one may be None."""
    import numpy as np

    origin = get_origin(kind)
    args = get_args(kind)
    if origin is types.UnionType:
        return None if value is None else _restored(args[0], value)
    if origin is np.ndarray:
        return np.array(value, float)
    if origin is collections.abc.Mapping:
        return {str(key): _restored(args[1], x) for key, x in value.items()}
    if origin is tuple:
        if isinstance(value, str):
            raise TypeError(f"{value!r} is no list")
        kinds = args[:1] * len(value) if args[-1] is Ellipsis else args
        return tuple(_restored(a, x) for a, x in zip(kinds, value, strict=True))
    if origin is Literal:
        if value not in args:
            raise ValueError(f"{value!r} is none of {', '.join(args)}")
        return value
    if kind in (str, bool) and not isinstance(value, kind):
        raise TypeError(f"{value!r} is no {kind.__name__}")
    return kind.from_dict(value) if hasattr(kind, "from_dict") else kind(value)
