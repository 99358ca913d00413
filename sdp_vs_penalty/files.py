"""Outputs are written whole or not at all; a JSON file is read, or refused in a sentence."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

from sdp_vs_penalty.errors import InputError

T = TypeVar("T")

#: Files that this process was given to read: outputs never replace them.
_inputs: set[Path] = set()


def protect(paths: Iterable[str | Path]) -> None:
    """From now on no output may replace one of these files (the command line's inputs)."""
    _inputs.clear()
    _inputs.update(Path(p).resolve() for p in paths if Path(p).is_file())


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write to a temporary file beside the target and rename: an interruption keeps the old file."""
    path = Path(path)
    if path.resolve() in _inputs:
        raise InputError(f"{path}: is also an input of this command: name another file to write.")
    if path.is_dir():
        raise InputError(f"{path}: cannot be written (it is a folder): name a file.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}).") from error
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, path)
    except BaseException as error:
        os.unlink(temporary)
        if isinstance(error, OSError):
            raise InputError(f"{path}: cannot be written ({error.strerror}).") from error
        raise


def read_json(path: str | Path, kind: str, mark: str, build: Callable[[dict[str, Any]], T]) -> T:
    """What ``build`` makes of the JSON object at ``path``; every ``kind`` of file has a field ``mark``.

    Raises InputError naming the file and what is wrong with it, whatever build raises on bad content.
    """
    path = Path(path)
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a JSON file ({error}).") from error
    if not isinstance(data, dict) or mark not in data:
        raise InputError(f"{path}: not a {kind} of this program (no field {mark!r}).")
    try:
        return build(data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except KeyError as error:
        raise InputError(f"{path}: the field {error.args[0]!r} is missing.") from error
    except (TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        raise InputError(f"{path}: a field has the wrong content ({error}).") from error


def write_text(path: str | Path, content: str) -> None:
    write_bytes(path, content.encode())
