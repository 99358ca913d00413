"""Sessions of the page without a browser."""

import asyncio
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

from sdp_vs_penalty import InputError
from sdp_vs_penalty.data import save
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.sessions import Sessions


async def finish(session: Session, act: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Do something and wait until its job is done; a sentence about an error fails the test."""
    session.start(act)
    await asyncio.wait([session.task])
    if session.notice is not None and session.notice.error:
        raise InputError(" ".join(session.notice.texts))


def do(session: Session, *deeds: Callable[[], Coroutine[Any, Any, None]]) -> None:
    for deed in deeds:
        asyncio.run(finish(session, deed))


def opened(sessions: Sessions, robot: str, **files: Path) -> Session:
    """A session in which a robot was chosen and runs were read, by the names that they come with."""
    s = sessions.new()
    do(s, lambda: s.choose_robot(robot))
    if files:
        s.arrived.update(files)
        do(s, s.read_files)
    return s


def saved(folder: Path, runs: Any, *names: str) -> dict[str, Path]:
    for run, name in zip(runs, names, strict=False):
        save(run, folder / name)
    return {name: folder / name for name in names}
