"""Workers, one per job: the next one is always started in advance; cancelling a job kills its worker."""

from __future__ import annotations

import asyncio
import contextlib
import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Mapping
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
from typing import Any

from sdp_vs_penalty.errors import InputError

#: Jobs of all tabs together that run at once, each with its part of the memory; the others wait.
AT_ONCE = max(1, min(4, os.cpu_count() or 1))
#: A dead worker without an answer: the system ends processes that want too much memory.
_DIED = InputError(
    "the job was killed, probably for lack of memory; nothing was changed", "use fewer or shorter runs"
)


class Cancelled(Exception):  # noqa: N818  (it is no error)
    """A job was cancelled."""


class JobProcess:
    """One worker and the job that it does; its process starts meanwhile, which can take seconds."""

    def __init__(self, context: BaseContext) -> None:
        self.connection, theirs = context.Pipe()
        self.process = self._of(context, theirs)
        self.cancelled = self.killed = self._started = False
        self._lock = threading.Lock()
        self._starting = threading.Thread(target=self._start, args=(theirs,), daemon=True)
        self._starting.start()

    @staticmethod
    def _of(context: BaseContext, theirs: Connection) -> BaseProcess:
        return context.Process(target=_run, args=(theirs,), daemon=True)  # type: ignore[attr-defined, no-any-return]

    def _start(self, theirs: Connection) -> None:
        try:
            self.process.start()
        except OSError:  # the name of a temporary folder can be too long for a forking server
            self.process = self._of(multiprocessing.get_context("spawn"), theirs)
            self.process.start()
        theirs.close()
        with self._lock:
            self._started = True
            if self.killed:
                self._kill()

    @property
    def ended(self) -> bool:
        return self._started and not self.process.is_alive()

    async def do(self, request: Mapping[str, Any], progress: Callable[[str], None]) -> dict[str, Any]:
        """The answer to a request; raises InputError with the worker's sentence, or Cancelled."""
        loop, messages = asyncio.get_running_loop(), asyncio.Queue[Any]()
        talk = (json.dumps(request).encode(), loop, messages)
        threading.Thread(target=self._talk, args=talk, daemon=True).start()
        try:
            while (message := await messages.get()) is not None:
                if "progress" in message:
                    progress(message["progress"])
                elif "error" in message:
                    raise InputError(message["error"])
                else:
                    return dict(message["result"])
            raise Cancelled if self.cancelled else _DIED
        finally:
            self.kill()

    def _talk(self, request: bytes, loop: asyncio.AbstractEventLoop, messages: Any) -> None:
        """Ask, and hand every message to the event loop; None at the end of the pipe."""
        self._starting.join()
        with contextlib.suppress(OSError):  # killed already: reading says so
            self.connection.send_bytes(request)
        message: Any = {}
        while message is not None:
            try:
                message = json.loads(self.connection.recv_bytes())
            except (EOFError, OSError):
                message = None
            with contextlib.suppress(RuntimeError):  # the loop is closed: the server is ending
                loop.call_soon_threadsafe(messages.put_nowait, message)
        self.connection.close()

    def cancel(self) -> None:
        self.cancelled = True
        self.kill()

    def kill(self) -> None:
        """End the worker and whatever it has started, at once; its number may be another's later."""
        with self._lock:
            if self._started and not self.killed:
                self._kill()
            self.killed = True

    def _kill(self) -> None:
        pid = self.process.pid
        assert pid is not None
        with contextlib.suppress(OSError, AttributeError):
            if os.getpgid(pid) == pid:
                os.killpg(pid, signal.SIGKILL)
        self.process.kill()
        threading.Thread(target=self.process.join, daemon=True).start()  # leaves no zombie behind


def _run(connection: Connection) -> None:
    from sdp_vs_penalty.page.worker import main

    main(connection)


class WorkerPool:
    """Where workers come from: forked from a process that has loaded everything, where that exists."""

    def __init__(self) -> None:
        self._forks = "forkserver" in multiprocessing.get_all_start_methods()
        self._context: BaseContext = multiprocessing.get_context(
            "forkserver" if self._forks else "spawn"
        )
        if self._forks:
            here = "sdp_vs_penalty.page"
            self._context.set_forkserver_preload([f"{here}.forked", f"{here}.worker"])
        self._spare: JobProcess | None = None
        self._running = 0

    async def run(
        self, work: JobProcess, request: Mapping[str, Any], progress: Callable[[str], None]
    ) -> dict[str, Any]:
        """What ``work.do`` returns, once fewer than AT_ONCE jobs are running."""
        waited = False
        while self._running >= AT_ONCE:
            if work.cancelled:
                raise Cancelled
            if not waited:
                progress("waiting for the jobs of other tabs")
            waited = True
            await asyncio.sleep(0.1)
        self._running += 1
        try:
            return await work.do({**request, "jobs": AT_ONCE}, progress)
        finally:
            self._running -= 1

    def warm(self) -> None:
        """Start the next worker."""
        if self._spare is None or self._spare.ended:
            if self._forks:  # by this thread, with which it ends
                with contextlib.suppress(OSError):
                    forkserver.ensure_running()
            self._spare = JobProcess(self._context)

    def worker(self) -> JobProcess:
        """A started worker; the next one starts meanwhile."""
        self.warm()
        work, self._spare = self._spare, None
        assert work is not None
        self.warm()
        return work

    def close(self) -> None:
        if self._spare is not None:
            self._spare.kill()
