"""All tabs of a server: sessions by their secret names, kept a while after a tab is closed."""

import contextlib
import os
import secrets
import shutil
import tempfile
import time
from pathlib import Path

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files.outputs import lives
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.uploads import SILENCE
from sdp_vs_penalty.page.worker import WorkerPool

#: Tabs that can be open at once, and closed ones that can be opened again.
MOST = 20

#: Begin of the names of servers' folders; the number of the server's process follows.
_PREFIX = "sdp-vs-penalty-page-"


def _remove_leftovers(home: Path) -> None:
    """What servers of this account that were killed have left."""
    for left in home.glob(f"{_PREFIX}*-*"):
        number = left.name.removeprefix(_PREFIX).split("-")[0]
        with contextlib.suppress(OSError, AttributeError):
            if number.isdigit() and not lives(int(number)) and left.lstat().st_uid == os.getuid():
                shutil.rmtree(left, ignore_errors=True)


class Sessions:
    """Sessions whose folders, readable by their owner only, end with the server."""

    def __init__(self, pool: WorkerPool) -> None:
        self.pool = pool
        _remove_leftovers(Path(tempfile.gettempdir()))
        self.root = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-"))
        pool.temporary = self.root
        self._all: dict[str, Session] = {}

    def new(self) -> Session:
        """An empty session, open from now on: a browser was sent there, and connects a while later.

        Raises InputError where as many tabs as there may be are open.
        """
        self._forget_old()
        if sum(map(_open, self._all.values())) >= MOST:
            raise InputError(f"{MOST} tabs are open", "close one, and open this page again")
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
        return None if session is None or any(w.present for w in session.watchers) else session

    def leave(self, session: Session) -> None:
        """A tab was closed: what it was doing ends with the last one that shows it."""
        if not session.watchers:
            session.left_at = time.monotonic()
            session.rest()

    def close(self) -> None:
        shutil.rmtree(self.root, ignore_errors=True)

    def _forget_old(self) -> None:
        closed = sorted((s for s in self._all.values() if not _open(s)), key=lambda s: -s.left_at)
        now = time.monotonic()
        for k, session in enumerate(closed):
            # On a busy computer many tabs lose their connection at once, and come back.
            if k >= MOST and now - session.left_at > SILENCE:
                session.cancel()
                del self._all[session.token]
                shutil.rmtree(session.folder, ignore_errors=True)


def _open(session: Session) -> bool:
    """Whether a tab shows it, or may be about to."""
    return bool(session.watchers) or (not session.shown and time.monotonic() - session.left_at < SILENCE)
