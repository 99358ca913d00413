"""All tabs of a server: sessions by their secret names, each a project in a folder; and
what people drop there, kept under names of our own in a session's private folder."""

import asyncio
import contextlib
import os
import secrets
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.effects import effects_in_words
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import lives
from sdp_vs_penalty.page.project import STATE_FILE, read_state
from sdp_vs_penalty.page.runs import ENDINGS, kind_of
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.spoken import name_in_title, repairs_in_words
from sdp_vs_penalty.page.view import Project
from sdp_vs_penalty.page.worker import LEAST, WorkerPool

#: Bytes of all files of a session: those that a job's memory holds at least.
LARGEST = LEAST
#: How long a browser may be silent, sleep or wait for a busy computer [s]: a file that
#: it sends is then refused, the work of a tab that was closed ends, and a tab that was
#: asked for is not waited for.
SILENCE = 30.0


def _size_of(folder: Path) -> int:
    """Return the size of all files in a folder and below it [bytes]."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


async def receive(folder: Path, name: str, chunks: AsyncIterator[bytes]) -> Path:
    """Write an uploaded file that arrives in chunks, completely or not at all.

    Parameters
    ----------
    folder : Path
        The session's folder; the file gets a random name there.
    name : str
        Name to show, made by :func:`shown_name`, with one of the ENDINGS.

    Raises
    ------
    InputError
        For a suffix that cannot be read, a folder that grows too large, or a browser
        that sends nothing for SILENCE seconds.
    """
    if not kind_of(name):
        known = ", ".join(ending for kind in ENDINGS.values() for ending in kind)
        what = "files of this kind cannot be read"
        raise InputError(what, f"choose one of {known}", name)
    path = folder / f"file-{secrets.token_hex(8)}{Path(name).suffix.lower()}"
    clock = asyncio.get_running_loop().time
    try:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
        with open(os.open(path, flags, 0o600), "wb") as file:
            async with asyncio.timeout(SILENCE) as patience:
                async for chunk in chunks:
                    file.write(chunk)
                    file.flush()
                    if _size_of(folder) > LARGEST:
                        what = f"a page takes {LARGEST // 2**20} MB of files"
                        raise InputError(
                            what, "start over, or use the command line", name
                        )
                    patience.reschedule(clock() + SILENCE)
    except BaseException as error:
        path.unlink(missing_ok=True)
        if isinstance(error, TimeoutError):
            raise InputError(
                f"nothing came for {SILENCE:g} s", "send it again", name
            ) from error
        raise
    return path


#: Tabs that can be open at once, and closed ones that can be opened again.
MOST = 20
#: Begin of the names of servers' folders; the number of the server's process follows.
_PREFIX = "sdp-vs-penalty-page-"


class Sessions:
    """The sessions of a server, each with a folder that only its owner can read.

    Folders in ``projects`` stay when the server ends; without it they end with it.
    """

    def __init__(self, pool: WorkerPool, projects: Path | None = None) -> None:
        """Make the server's temporary folder, and remove those of servers that were
        killed.

        A temporary folder's name ends in its server's process id. One that lies there
        without such a process is a leftover.

        Parameters
        ----------
        projects : Path, optional
            Folder in which each session is a project that stays.
        """
        self.pool = pool
        for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*-*"):
            process = folder.name.removeprefix(_PREFIX).split("-")[0]
            # Systems without user ids lack getuid: folders stay there.
            with contextlib.suppress(OSError, AttributeError):
                is_leftover = process.isdigit() and not lives(int(process))
                if is_leftover and folder.lstat().st_uid == os.getuid():
                    shutil.rmtree(folder, ignore_errors=True)
        self.root = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-"))
        self.projects = projects
        #: Folders that the user has named, which may hold more than a project.
        self._named = set[Path]()
        self._all: dict[str, Session] = {}

    def new(self) -> Session:
        """Open an empty session; a browser is about to connect to it.

        The MOST sessions closed last stay in memory; older ones are saved, or removed
        where nothing was done in them. Raises InputError if MOST tabs are open.
        """
        closed = [session for session in self._all.values() if not _open(session)]
        closed.sort(key=lambda session: session.left_at, reverse=True)
        for session in closed[MOST:]:
            if session.task is None:
                self._leave(session)
        if sum(map(_open, self._all.values())) >= MOST:
            raise InputError(
                f"{MOST} tabs are open", "close one, and open this page again"
            )
        token = secrets.token_urlsafe(24)
        if self.projects is None:
            folder = self.root / token
            folder.mkdir(mode=0o700)
        else:
            self.projects.mkdir(mode=0o700, parents=True, exist_ok=True)
            prefix = time.strftime("%Y-%m-%d-%H%M-")
            folder = Path(tempfile.mkdtemp(prefix=prefix, dir=self.projects))
        return self._add(Session(token, folder, self.pool))

    def _add(self, session: Session) -> Session:
        """Add a session to those in memory, and return it."""
        self._all[session.token] = session
        return session

    def _leave(self, session: Session) -> None:
        """Take a session out of memory; what was made in it stays if it is a project's."""
        del self._all[session.token]
        stays = self.projects is not None and session.robot
        if stays or session.folder.resolve() in self._named:
            session.save()
        else:
            shutil.rmtree(session.folder, ignore_errors=True)

    def open_folder(self, folder: Path) -> Session:
        """Open the project of a folder that the user has named; an empty one begins.

        Raises InputError for a folder that holds something else.
        """
        known = [s for s in self._all.values() if s.folder == folder]
        if known:
            return known[0]
        token = secrets.token_urlsafe(24)
        if (folder / STATE_FILE).is_file():
            session = Session.load(folder, self.pool, token)
        else:
            if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
                what = "this is no project of the page, and not empty"
                raise InputError(what, "name a folder that is new", folder)
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            session = Session(token, folder, self.pool, name=folder.name)
        self._named.add(folder.resolve())
        return self._add(session)

    def saved(self) -> list[Project]:
        """List the projects that can be opened, the one saved last first: those of the
        user's folder, and the one whose folder was named."""
        folders = [*self._named]
        if self.projects is not None:
            folders += self.projects.glob("*")
        each_once = {folder.resolve(): folder for folder in folders}.values()
        files = [x / STATE_FILE for x in each_once if (x / STATE_FILE).is_file()]
        files.sort(key=lambda file: file.stat().st_mtime, reverse=True)
        found = (_project_of(x, x.stat().st_mtime) for x in files[:_MOST_LISTED])
        projects = [project for project in found if project is not None]
        earlier = Counter(project.name for project in projects)
        listed = list[Project]()
        for project in projects:  # equal names have a number, the first one none
            number = earlier[project.name]
            name = f"{project.name} ({number})" if number > 1 else project.name
            earlier[project.name] -= 1
            listed.append(replace(project, name=name))
        return listed

    def delete(self, project: Project) -> None:
        """Delete a project with its folder.

        Raises InputError where a tab shows it, and for a folder that the user has named:
        that may hold other files.
        """
        known = self._all.get(project.token)
        if known is not None and any(tab.present for tab in known.watchers):
            raise InputError(f"{project.name} is open in a tab", "close that first")
        if project.folder.resolve() in self._named:
            what = f"{project.name} is in a folder that you have named"
            raise InputError(what, f"remove {project.folder} by yourself")
        self._all.pop(project.token, None)
        shutil.rmtree(project.folder, ignore_errors=True)

    def get(self, token: str) -> Session | None:
        """Return the session with this token, opened from its folder if need be; None if
        there is none.
        """
        if token in self._all:
            return self._all[token]
        for project in self.saved():
            if secrets.compare_digest(project.token.encode(), token.encode()):
                with contextlib.suppress(InputError):
                    return self._add(Session.load(project.folder, self.pool, token))
        return None

    def unwatched(self, token: str | None) -> Session | None:
        """Return the session with this token if no tab shows it at the moment, else None.

        A person who comes back to the address finds this session again.
        """
        session = self.get(token or "")
        if session is None or any(tab.present for tab in session.watchers):
            return None
        return session

    def close(self) -> None:
        """End all workers, save the projects, and remove what is temporary."""
        self.pool.close()
        for session in [*self._all.values()]:
            self._leave(session)
        shutil.rmtree(self.root, ignore_errors=True)


#: Projects that the first screen lists, and runs of each.
_MOST_LISTED = 30
_MOST_RUNS = 2


@lru_cache(2 * _MOST_LISTED)
def _project_of(file: Path, written: float) -> Project | None:
    """Return the project whose state was ``written`` [s since 1970] to a file; None where
    nothing was done in it, or it is none of ours."""
    try:
        content = read_state(file.parent)
    except InputError:
        return None
    robot = content["now"]["robot"]
    if not robot:
        return None
    name = title_of(content["name"], robot, content.get("begun", written))
    last = time.strftime("%d %b, %H:%M", time.localtime(written))
    text = f"{_verdict_and_runs(content)}; last work {last}"
    return Project(content["token"], name, text, file.parent)


def title_of(name: str, robot: Mapping[str, Any], begun: float) -> str:
    """Return what the page calls a project: its name, or its robot's file or name with the
    minute in which it was begun, which tells projects of one robot apart."""
    minute = time.strftime("%d %b %Y %H:%M", time.localtime(begun))
    return name or f"{robot['file'] or name_in_title(robot['title'])}, {minute}"


def _verdict_and_runs(content: Mapping[str, Any]) -> str:
    """Return the grade of a saved project's model, what was found, its runs and how they
    were changed, in words: what tells projects apart comes first, since a list cuts it."""
    names = [run["name"] for run in content["now"]["runs"]]
    more = len(names) - _MOST_RUNS
    shown = names[:_MOST_RUNS] + ([f"{more} more"] if more > 0 else [])
    models = content["now"]["history"]
    grade = "no model yet"
    if models:
        steps = [content["steps"][k] for k in models]
        grade = steps[-1]["comparison"]["verdict"]["grade"]
        added = [text for step in steps for text in step["added"]]
        found = effects_in_words(added) + " added" if added else ""
        if not added and (diagnosis := steps[-1]["findings"]):
            sure = Diagnosis.from_dict(diagnosis).helpful
            found = effects_in_words([f.text for f in sure]) + " found" if sure else ""
        grade = f"{grade}; {found}" if found else grade
    runs = formatting.words(shown) if shown else "no runs"
    if repairs := repairs_in_words(content["now"].get("repairs", ())):
        runs = f"{runs} ({repairs})"
    return f"{grade}: {runs}"


def _open(session: Session) -> bool:
    """Whether a tab shows the session, or did so less than SILENCE seconds ago.

    On a busy computer many tabs lose their connection at once and come back soon.
    """
    return bool(session.watchers) or time.monotonic() - session.left_at < SILENCE
