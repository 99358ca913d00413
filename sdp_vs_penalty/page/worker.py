"""Workers: processes that do one job at a time, asked and answering through a pipe.

One is always started in advance; cancelling a job kills its worker; each ends with the server.
"""

import asyncio
import contextlib
import json
import multiprocessing
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.parallel import end_with

#: Jobs of all tabs together that run at once, each with its part of the memory; the others wait.
AT_ONCE = max(1, min(4, os.cpu_count() or 1))
#: A dead worker without an answer: the system ends processes that want too much memory.
_DIED = InputError(
    "the job was killed, probably for lack of memory; nothing was changed", "use fewer or shorter runs"
)
#: Of the computer's memory, how much all jobs together may use, and what each has at least [bytes].
_SHARE, _LEAST = 0.75, 2**31


class JobProcess:
    """A worker: a process that does one job after another; temporary : where it keeps what it needs."""

    def __init__(self, temporary: Path | None = None) -> None:
        spawn = multiprocessing.get_context("spawn")
        self.pipe, end = spawn.Pipe()
        self.process = spawn.Process(target=main, args=(end, os.getpid(), temporary))
        self.process.start()
        end.close()

    async def do(self, request: Mapping[str, Any], progress: Callable[[str], None]) -> dict[str, Any]:
        """The answer to a request; raises InputError: the worker's sentence, or that it was killed."""
        try:
            self.pipe.send(request)
            while "progress" in (message := json.loads(await asyncio.to_thread(self.pipe.recv_bytes))):
                progress(message["progress"])
        except (OSError, EOFError):
            raise _DIED from None
        if "error" in message:
            raise InputError(message["error"])
        return dict(message["result"])

    def kill(self) -> None:
        """End the worker and whatever it has started, at once."""
        if (number := self.process.pid) is None or not self.process.is_alive():
            return
        with contextlib.suppress(OSError, AttributeError):
            os.killpg(number, signal.SIGKILL)
        self.process.kill()
        threading.Thread(target=self.process.join, daemon=True).start()  # leaves no zombie behind


@dataclass
class Working:
    """A piece of work of a tab, of one or more jobs: what it is, since when [s], where it stands."""

    title: str
    since: float = field(default_factory=time.monotonic)
    status: str = ""


class WorkerPool:
    """Where workers come from; temporary : the folder for what they keep while they work."""

    def __init__(self, at_once: int = AT_ONCE) -> None:
        self.temporary: Path | None = None
        self._spare: JobProcess | None = None
        self._busy: set[JobProcess] = set()
        self._places, self._at_once, self._closed = asyncio.Semaphore(at_once), at_once, False

    def prepare(self) -> None:
        """Start a worker in advance: it loads its libraries."""
        self._spare = JobProcess(self.temporary)

    async def run(self, request: Mapping[str, Any], progress: Callable[[str], None]) -> dict[str, Any]:
        """The answer to a request, once there is a place for it; cancelled, its worker is killed, and
        nothing has changed. Raises InputError with the worker's sentence."""
        if self._places.locked():
            progress("waiting for the jobs of other tabs")
        async with self._places:
            work, done = self.worker(), False
            self._busy.add(work)
            try:
                answer = await work.do({**request, "at_once": self._at_once}, progress)
                done = True
                return answer
            finally:
                self._busy.discard(work)
                if not done or self._closed or self._spare is not None:
                    work.kill()
                if self._spare is None and not self._closed:
                    self._spare = work if done else JobProcess(self.temporary)

    def worker(self) -> JobProcess:
        """A worker that does nothing yet."""
        spare, self._spare = self._spare, None
        return JobProcess(self.temporary) if spare is None or not spare.process.is_alive() else spare

    def close(self) -> None:
        self._closed = True
        for work in filter(None, (self._spare, *self._busy)):
            work.kill()


def main(server: Any, parent: int, temporary: Path | None) -> None:
    """Do the jobs that come through a pipe, one after another, while the parent lives."""
    with contextlib.suppress(AttributeError):  # Ctrl-C is the server's; a kill reaches what a job starts
        os.setsid()
    end_with(parent)
    os.dup2(2, 1)  # what a library prints is no matter of the server's
    os.environ |= {"TMPDIR": str(temporary)} if temporary else {}

    def send(message: dict[str, Any]) -> None:  # arrays and numbers of NumPy as JSON has them
        server.send_bytes(json.dumps(message, default=lambda array: array.tolist()).encode())

    from sdp_vs_penalty.page import jobs, run_jobs  # takes seconds; a request may come meanwhile

    every = vars(run_jobs) | vars(jobs)
    with contextlib.suppress(EOFError, OSError):  # the server has closed its end
        while True:
            request = server.recv()
            limit_memory(int(request.get("at_once", 1)))
            asked = run_jobs.Asked(request, lambda text: send({"progress": text}))
            send(do(every[request["job"]], asked))


def do(job: Callable[[Any], dict[str, Any]], asked: Any) -> dict[str, Any]:
    """{"result": ...} of a request, or {"error": sentence}."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return {"result": job(asked)}
    except InputError as error:
        return {"error": str(error)}
    except MemoryError:
        return {"error": "Not enough memory: use fewer or shorter runs."}
    except Exception as error:
        return {"error": internal_error(error)}


def internal_error(error: BaseException) -> str:
    """What is said of an error that is ours."""
    what = (str(error).splitlines() or [""])[0][:200]
    return (
        f"Internal error ({type(error).__name__}: {what}): nothing was changed; try other data or "
        "settings, and report it."
    )


def limit_memory(at_once: int) -> None:
    """Let a job, one of so many at once, fail with a sentence before it makes the computer swap."""
    with contextlib.suppress(ImportError, AttributeError, ValueError, OSError):  # no such limits here
        import resource

        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        limit = max(int(_SHARE * total / at_once), min(_LEAST, int(_SHARE * total)))
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
