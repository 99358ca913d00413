"""All tabs of a server: sessions by their secret names, kept a while after a tab is
closed; and what people drop there, kept under names of our own in a session's private
folder."""

import asyncio
import contextlib
import os
import secrets
import shutil
import tempfile
import time
from collections.abc import AsyncIterator
from pathlib import Path, PureWindowsPath

from sdp_vs_penalty.data.formats import suffixes
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import lives
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.worker import LEAST, WorkerPool

#: Bytes of all files of a session: those that a job's memory holds at least.
LARGEST = LEAST
#: How long a browser may be silent, sleep or wait for a busy computer [s]: a file that
#: it sends is then refused, the work of a tab that was closed ends, and a tab that was
#: asked for is not waited for.
SILENCE = 30.0

#: By what is dropped.
SUFFIXES = {
    "runs": suffixes(),
    "robot": (".urdf", ".xml"),
    "model": (".json",),
}


def shown_name(name_given: str) -> str:
    """What to call a file: the last part of its name without what cannot be printed;
    never a path.

    >>> shown_name("../../etc/run 1.csv"), shown_name("C:\\\\temp\\\\run.csv"), shown_name("..")
    ('run 1.csv', 'run.csv', 'file')
    """
    last = PureWindowsPath(
        name_given.replace("\0", "")
    ).name  # takes / and \ and drives for separators
    name = "".join(c for c in last if c.isprintable()).strip()
    if name in ("", ".", ".."):
        return "file"
    return name if len(name) <= 80 else f"{name[:40]}...{name[-36:]}"


async def receive(
    folder: Path, name: str, chunks: AsyncIterator[bytes], kind: str
) -> Path:
    """Write a file that arrives in pieces, whole or not at all.

    name : as :func:`shown_name` made it; kind : of SUFFIXES. Raises InputError for a
    suffix that nobody reads, and where the folder's files become too many bytes.
    """
    suffix = Path(name).suffix.lower()
    allowed = SUFFIXES.get(kind, ())
    if suffix not in allowed:
        raise InputError(
            "files of this kind cannot be read",
            f"choose one of {', '.join(allowed)}",
            name,
        )
    path = folder / f"file-{secrets.token_hex(8)}{suffix}"
    clock = asyncio.get_running_loop().time
    try:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
        with open(os.open(path, flags, 0o600), "wb") as file:
            async with asyncio.timeout(SILENCE) as patience:
                async for chunk in chunks:
                    file.write(chunk)
                    file.flush()
                    if (
                        sum(p.stat().st_size for p in folder.rglob("*") if p.is_file())
                        > LARGEST
                    ):
                        what = f"a page takes {LARGEST // 2**20} MB of files"
                        raise InputError(
                            what,
                            "start over, or use the command line",
                            name,
                        )
                    patience.reschedule(clock() + SILENCE)
    except BaseException as error:
        path.unlink(missing_ok=True)
        if isinstance(error, TimeoutError):
            raise InputError(
                f"nothing came for {SILENCE:g} s",
                "send it again",
                name,
            ) from error
        raise
    return path


#: Tabs that can be open at once, and closed ones that can be opened again.
MOST = 20
#: Begin of the names of servers' folders; the number of the server's process follows.
_PREFIX = "sdp-vs-penalty-page-"


class Sessions:
    """Sessions whose folders, readable by their owner only, end with the server."""

    def __init__(self, pool: WorkerPool) -> None:
        self.pool = pool
        for left in Path(tempfile.gettempdir()).glob(
            f"{_PREFIX}*-*"
        ):  # of servers that were killed
            number = left.name.removeprefix(_PREFIX).split("-")[0]
            with contextlib.suppress(OSError, AttributeError):
                if (
                    number.isdigit()
                    and not lives(int(number))
                    and left.lstat().st_uid == os.getuid()
                ):
                    shutil.rmtree(left, ignore_errors=True)
        self.root = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-"))
        self._all: dict[str, Session] = {}

    def new(self) -> Session:
        """An empty session, open from now on: a browser was sent there, and connects a
        while later.

        Raises InputError where as many tabs as there may be are open.
        """
        closed = sorted(
            (s for s in self._all.values() if not _open(s)), key=lambda s: -s.left_at
        )
        for session in closed[MOST:]:
            del self._all[session.token]
            shutil.rmtree(session.folder, ignore_errors=True)
        if sum(map(_open, self._all.values())) >= MOST:
            raise InputError(
                f"{MOST} tabs are open", "close one, and open this page again"
            )
        token = secrets.token_urlsafe(24)
        folder = self.root / token
        folder.mkdir(mode=0o700)
        self._all[token] = Session(token, folder, self.pool)
        return self._all[token]

    def get(self, token: str) -> Session | None:
        return self._all.get(token)

    def closed(self, token: str | None) -> Session | None:
        """The session of this name if no tab shows it."""
        session = self._all.get(token or "")
        return (
            None
            if session is None or any(w.present for w in session.watchers)
            else session
        )

    def close(self) -> None:
        """End the workers, and remove all files."""
        self.pool.close()
        shutil.rmtree(self.root, ignore_errors=True)


def _open(session: Session) -> bool:
    """Whether a tab shows it, or may be about to: on a busy computer many tabs lose
    their connection at once, and come back."""
    return bool(session.watchers) or time.monotonic() - session.left_at < SILENCE
