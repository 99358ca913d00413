"""Outputs are written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from sdp_vs_penalty.errors import InputError

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


def write_text(path: str | Path, content: str) -> None:
    write_bytes(path, content.encode())
