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
    """An argument of the running command is an input; of a folder all files in it."""
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


def _bounded(path: Path, mode: int, size: int, largest: int) -> None:
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
            f"larger than {limit_words}", "name a smaller file, or cut it", path
        )


@contextmanager
def reading(path: str | Path, largest: int = LARGEST_RUN) -> Iterator[Path]:
    """The path, for a library that opens it; while it reads, memory is limited (on
    Linux).

    path : a regular file of at most ``largest`` bytes, or a folder of such. Raises
    InputError for anything else, and where the file unpacks to more than its size
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
    """Memory that unpacking a file of this size may take; both in bytes."""
    return _ROOM + _PER_BYTE * size


@contextmanager
def limited_memory(room: int) -> Iterator[None]:
    """While this runs, this process may take so many bytes of memory more (files that
    are mapped do not count), and write no file that is larger. Nothing where the system
    has no such limits."""
    try:  # private memory, as the limit counts it; the sixth figure is its pages
        pages = int(Path("/proc/self/statm").read_text().split()[5])
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
    """What a library opens that takes UTF-8 names alone: the path, or, where its name
    is none, the file."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return path.open("rb")
    return path


def read_bytes(
    path: str | Path, largest: int = LARGEST_TEXT, is_own: bool = False
) -> bytes:
    """A whole file. is_own : one that this command keeps, and may write again. Raises
    InputError for what is no regular file, too large, or cannot be read."""
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
    path: str | Path, largest: int = LARGEST_TEXT, is_own: bool = False
) -> str:
    """A whole file of UTF-8 text; arguments and errors as of :func:`read_bytes`."""
    try:
        return read_bytes(path, largest, is_own).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"not UTF-8 text ({error})", "save it as UTF-8", Path(path)
        ) from error


def read_table(path: str | Path) -> list[dict[str, str]]:
    """The rows of a CSV table, as text by heading."""
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
    """What ``build`` makes of the JSON object at ``path``; every ``kind`` of file has a
    field ``mark``.

    Raises InputError naming the file and what is wrong with it, whatever build raises
    on bad content.
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
    unmarked: int | None = None,
    older: str = "",
    remedy: str = "write it anew with this version",
) -> int:
    """The number of a JSON document's format, which has to be one that this version
    reads.

    oldest, newest : formats that are read; unmarked : that of a document without the
    field; older, remedy : what an older format lacks, and what to do about it. Raises
    InputError that names the document's format.
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
    """The fields of a JSON object; ValueError where one comes twice, of which others
    may read the first."""
    fields_ = dict(pairs)
    if len(fields_) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the field {twice!r} comes twice")
    return fields_


def read_toml(path: Path, build: Callable[[dict[str, Any]], T]) -> T:
    """What ``build`` makes of the TOML file at ``path``; errors as of
    :func:`read_json`."""
    remedy = "compare the file with a built-in one"
    return _built(path, read_text(path, LARGEST_TOML), tomllib.loads, build, remedy)


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
            f"not a {kind} file ({what})", "correct it, or name another", path
        ) from error
    try:
        return build(data)
    except InputError as error:
        # One that names a file of its own, which this one mentions, stays as it is.
        raise error if isinstance(error.where, Path) else error.within(path) from error
    except KeyError as error:
        raise InputError(
            f"the field {error.args[0]!r} is missing", else_, path
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
    """A new file that takes the target's place once it is whole: an interruption keeps
    the old one.

    A writer that is killed leaves nothing; where files cannot be without a name, at
    most one file beside the target, which its next writer removes.

    A link stays, its target is replaced. A device or a pipe is written to as it is.
    Raises InputError where the file is an input of this command, or cannot be written.
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
                "is also an input of this command", "name another file to write", path
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
        f"cannot be written ({what})", "choose another place, or free this one", path
    )


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file, whole or not at all; errors as of :func:`writing`."""
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
        handle = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666)
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
    """Whether there is a process of this number."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True  # somebody else's
    return True


@contextmanager
def folder_lock(folder: Path, patience: float = 0.0) -> Iterator[None]:
    """While this runs, no other command adds its results to this folder; the lock ends
    with the process.
    A folder that was made for it goes again where nothing was written there.

    patience : how long to wait for the other command [s]. Raises InputError where it
    still writes then, and where the folder cannot be made.
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
    """Write a text as UTF-8, whole or not at all; bytes of a file name that are no text
    (PEP 383) as escapes. Errors as of :func:`writing`."""
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
        """What :meth:`to_dict` wrote; null stands for the field's default, where it has
        one. Raises KeyError, TypeError or ValueError for a field that is missing or of
        another kind."""
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
