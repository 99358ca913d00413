"""Workers: processes that do one job at a time, asked and answering through a pipe.

One is always started in advance; cancelling a job kills its worker; each ends with the
server.
"""

import asyncio
import contextlib
import importlib
import json
import multiprocessing
import os
import signal
import threading
import warnings
from collections.abc import Callable, Mapping
from typing import Any

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.parallel import end_with

#: The least of the computer's memory that a job is given [bytes]: what a recording of
#: an hour takes.
LEAST = 2**31
#: What jobs import where they first need it: half a second that nobody waits for.
PRELOADED = (
    "pyarrow.csv",
    "scipy.fft",
    "scipy.interpolate",
    "scipy.linalg",
    "scipy.optimize",
    "scipy.spatial",
)


def memory() -> int:
    """Of the computer [bytes]; room for two jobs where the system does not say."""
    with contextlib.suppress(AttributeError, ValueError, OSError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return 3 * LEAST


class JobProcess:
    """A worker: a process that does one job after another, each within so much memory
    [bytes]."""

    def __init__(self, limit: int) -> None:
        spawn = multiprocessing.get_context("spawn")
        self.pipe, end = spawn.Pipe()
        self.process = spawn.Process(target=main, args=(end, os.getpid(), limit))
        self.process.start()
        end.close()

    async def do(
        self, request: Mapping[str, Any], progress: Callable[[str], None]
    ) -> dict[str, Any]:
        """The answer to a request; raises InputError: the worker's sentence, or that it
        was killed."""
        try:
            self.pipe.send(request)
            while "progress" in (
                message := json.loads(await asyncio.to_thread(self.pipe.recv_bytes))
            ):
                progress(message["progress"])
        except (
            OSError,
            EOFError,
        ):  # the system ends processes that want too much memory
            what = (
                "the job was killed, probably for lack of memory; nothing was changed"
            )
            raise InputError(what, "use fewer or shorter runs") from None
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
        threading.Thread(
            target=self.process.join, daemon=True
        ).start()  # leaves no zombie behind


class WorkerPool:
    """Where workers come from. at_once : jobs of all tabs together that run at once,
    the others wait; by default as many as there are cores, and parts of the memory
    beside one for all else."""

    def __init__(self, at_once: int | None = None) -> None:
        places = at_once or max(1, min(os.cpu_count() or 1, memory() // LEAST - 1))
        self._limit = max(memory() // (places + 1), min(LEAST, memory()))
        self._places = asyncio.Semaphore(places)
        self._closed = False
        self._spare: JobProcess | None = None
        self._busy: set[JobProcess] = set()

    def prepare(self) -> None:
        """Start a worker in advance: it loads its libraries."""
        self._spare = JobProcess(self._limit)

    async def run(
        self, request: Mapping[str, Any], progress: Callable[[str], None]
    ) -> dict[str, Any]:
        """The answer to a request, once there is a place for it; cancelled, its worker
        is killed, and nothing has changed. Raises InputError with the worker's
        sentence."""
        if self._places.locked():
            progress("waiting for the jobs of other tabs")
        async with self._places:
            work = self.worker()
            done = False
            self._busy.add(work)
            try:
                answer = await work.do(request, progress)
                done = True
                return answer
            finally:
                self._busy.discard(work)
                if not done or self._closed or self._spare is not None:
                    work.kill()
                if self._spare is None and not self._closed:
                    self._spare = work if done else JobProcess(self._limit)

    def worker(self) -> JobProcess:
        """A worker that does nothing yet."""
        spare = self._spare
        self._spare = None
        return (
            JobProcess(self._limit)
            if spare is None or not spare.process.is_alive()
            else spare
        )

    def close(self) -> None:
        self._closed = True
        for work in filter(None, (self._spare, *self._busy)):
            work.kill()


def main(server: Any, parent: int, limit: int) -> None:
    """Do the jobs that come through a pipe, one after another, while the parent lives;
    each fails with a sentence at the limit of memory [bytes], before it makes the
    computer swap."""
    with contextlib.suppress(
        AttributeError
    ):  # Ctrl-C is the server's; a kill reaches what a job starts
        os.setsid()
    end_with(parent)
    os.dup2(2, 1)  # what a library prints is no matter of the server's
    with contextlib.suppress(ImportError, ValueError, OSError):  # no such limits here
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))

    def send(
        message: dict[str, Any],
    ) -> None:  # arrays and numbers of NumPy as JSON has them
        server.send_bytes(
            json.dumps(message, default=lambda array: array.tolist()).encode()
        )

    from sdp_vs_penalty.page import jobs  # takes seconds; a request may come meanwhile

    for name in PRELOADED:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    with contextlib.suppress(EOFError, OSError):  # the server has closed its end
        while True:
            request = server.recv()
            job_request = jobs.JobRequest(
                request, lambda text: send({"progress": text})
            )
            send(do(getattr(jobs, request["job"]), job_request))


def do(job: Callable[[Any], dict[str, Any]], job_request: Any) -> dict[str, Any]:
    """{"result": ...} of a request, or {"error": sentence}."""
    try:
        with warnings.catch_warnings(action="ignore"):
            return {"result": job(job_request)}
    except Exception as error:
        return {"error": sentence(error)}


def sentence(error: BaseException) -> str:
    """What is said of an error: of somebody's input, for lack of memory, or of ours."""
    if isinstance(error, MemoryError):
        error = InputError("Not enough memory", "use fewer or shorter runs")
    if not isinstance(error, InputError):
        what = f"Internal error ({type(error).__name__}: {error})"
        error = InputError(
            what, "nothing was changed; try other data or settings, and report it"
        )
    return str(error)
