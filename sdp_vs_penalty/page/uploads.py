"""Files that people drop: kept under names of our own in the session's private folder."""

import asyncio
import contextlib
import os
import secrets
from collections.abc import AsyncIterator, Iterable
from pathlib import Path, PureWindowsPath

from sdp_vs_penalty.data.formats import suffixes
from sdp_vs_penalty.errors import InputError

#: Bytes of all files of a session.
LARGEST = 2**30
#: How long a browser may be silent, sleep or wait for a busy computer [s]: a file that it sends is then
#: refused, the work of a tab that was closed ends, and a tab that was asked for is not waited for.
SILENCE = 30.0

#: Suffixes that the readers know.
RUN_SUFFIXES = suffixes()
ROBOT_SUFFIXES = (".urdf", ".xml")
#: By what is dropped.
SUFFIXES = {"runs": RUN_SUFFIXES, "robot": ROBOT_SUFFIXES, "model": (".json",), "proof": (".json",)}


def shown_name(given: str) -> str:
    """What to call a file: the last part of its name without what cannot be printed; never a path.

    >>> shown_name("../../etc/run 1.csv"), shown_name("C:\\\\temp\\\\run.csv"), shown_name("..")
    ('run 1.csv', 'run.csv', 'file')
    """
    last = PureWindowsPath(given.replace("\0", "")).name  # takes / and \ and drives for separators
    name = "".join(c for c in last if c.isprintable()).strip()
    if name in ("", ".", ".."):
        return "file"
    return name if len(name) <= 80 else f"{name[:40]}...{name[-36:]}"


async def receive(folder: Path, name: str, length: int, chunks: AsyncIterator[bytes], kind: str) -> Path:
    """Write a file that arrives in pieces; never more than announced, whole or not at all.

    name : as :func:`shown_name` made it; length : in bytes, as announced; kind : of SUFFIXES.
    Raises InputError for a suffix that nobody reads and for too many bytes.
    """
    suffix, allowed = Path(name).suffix.lower(), SUFFIXES.get(kind, ())
    if suffix not in allowed:
        raise InputError(
            "files of this kind cannot be read", f"choose one of {', '.join(allowed)}", name
        )
    if length > LARGEST:
        what = f"{min(length, 10**15) // 2**20} MB; the page takes files up to {LARGEST // 2**20} MB"
        raise InputError(what, "use the command line, or cut the run into pieces", name)
    if length > LARGEST - sum(p.stat().st_size for p in folder.rglob("*") if p.is_file()):
        raise InputError("this page has reached its limit of files", "start over", name)
    path = folder / f"file-{secrets.token_hex(8)}{suffix}"
    size = 0
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "wb") as file:
            file.truncate(length)  # for whatever else arrives meanwhile; takes no disk
            while chunk := await _next(chunks, name):
                size += len(chunk)
                if size > length:
                    raise InputError("holds more than was announced", "send it again", name)
                file.write(chunk)
            file.truncate(size)
    except BaseException:
        with contextlib.suppress(OSError):
            path.unlink()
        raise
    return path


async def _next(chunks: AsyncIterator[bytes], name: str) -> bytes:
    """What comes next, nothing at the end. Raises InputError after a silence."""
    try:
        async with asyncio.timeout(SILENCE):
            async for chunk in chunks:
                if chunk:
                    return chunk
    except TimeoutError as error:
        raise InputError(f"nothing came for {SILENCE:g} s", "send it again", name) from error
    return b""


def forget(folder: Path, files: Iterable[Path]) -> None:
    """Remove files that were read, where they are copies of ours in this folder: their runs are kept."""
    for path in files:
        if path.parent == folder:
            path.unlink(missing_ok=True)
