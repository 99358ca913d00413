"""Pipes and process substitutions: what can be read once only is kept in a file while it is read."""

from __future__ import annotations

import os
import select
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sdp_vs_penalty.data.formats.columns import LARGEST
from sdp_vs_penalty.errors import InputError

#: How long a pipe may stay silent [s], and how much may come through it [bytes].
_PATIENCE, _MOST = 30.0, 8 * LARGEST


@contextmanager
def spooled(path: Path) -> Iterator[Path]:
    """The path itself, or for a pipe a temporary file with what came through it.

    Raises InputError for a pipe that nobody writes to, and for devices and sockets.
    """
    kind = path.stat().st_mode
    if stat.S_ISREG(kind) or stat.S_ISDIR(kind):
        yield path
        return
    if not stat.S_ISFIFO(kind):
        raise InputError("neither a file nor a folder", "name a file of measurements", path)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"pipe{path.suffix}"
        _copy(path, file)
        try:
            yield file
        except InputError as error:
            where = str(error.where).replace(str(file), str(path))
            raise InputError(error.what.replace(str(file), str(path)), error.remedy, where) from error


def _copy(path: Path, file: Path) -> None:
    pipe = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        os.set_blocking(pipe, False)
        waiting, total = select.poll(), 0
        waiting.register(pipe, select.POLLIN)
        last = time.monotonic()
        with file.open("wb") as out:
            while True:
                if not waiting.poll(200):
                    if time.monotonic() - last > _PATIENCE:
                        raise InputError(
                            f"a pipe that nothing comes through for {_PATIENCE:g} s", "name a file", path
                        )
                    continue
                piece = os.read(pipe, 1 << 20)
                if not piece:
                    return
                last, total = time.monotonic(), total + len(piece)
                if total > _MOST:
                    raise InputError("more than 4 GiB come through this pipe", "name a file", path)
                out.write(piece)
    finally:
        os.close(pipe)
