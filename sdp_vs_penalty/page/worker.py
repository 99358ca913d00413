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
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Mapping
from typing import Any

from sdp_vs_penalty.errors import InputError, printable
from sdp_vs_penalty.parallel import end_with
from sdp_vs_penalty.records import WritesJson, to_json

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
    """Return the computer's memory [bytes]; enough for two jobs if the system hides
    it.
    """
    with contextlib.suppress(AttributeError, ValueError, OSError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return 3 * LEAST


class JobProcess:
    """A worker: a process that does one job after another within a limit of memory."""

    def __init__(self, limit: int) -> None:
        """Start the process; it may use ``limit`` bytes of memory.

        It is spawned, not forked, because a fork would copy the server's threads and
        sockets.
        """
        spawn = multiprocessing.get_context("spawn")
        self.pipe, end = spawn.Pipe()
        self.process = spawn.Process(target=main, args=(end, os.getpid(), limit))
        self.process.start()
        end.close()

    async def do(
        self, request: Mapping[str, Any], progress: Callable[[str], None]
    ) -> dict[str, Any]:
        """Send a request and return its answer; ``progress`` hears each step's short
        text.

        Raises InputError with the worker's error message, or if the system killed it.
        """
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
        """Kill the worker and all processes that it started, at once."""
        process_id = self.process.pid
        if process_id is None or not self.process.is_alive():
            return
        # The worker leads a process group (see main); not every system has them.
        with contextlib.suppress(OSError, AttributeError):
            os.killpg(process_id, signal.SIGKILL)
        self.process.kill()
        # Waiting for its end leaves no zombie process behind.
        threading.Thread(target=self.process.join, daemon=True).start()


class WorkerPool:
    """Workers for the jobs of all tabs; one is started in advance."""

    def __init__(self, at_once: int | None = None) -> None:
        """Share the computer's cores and memory among the jobs that run at once.

        Parameters
        ----------
        at_once : int, optional
            Number of jobs that run at once, the others wait. By default as many as
            there are cores, and as fit into memory with LEAST bytes each, one share
            kept for the rest.
        """
        fitting_in_memory = memory() // LEAST - 1
        places = at_once or max(1, min(os.cpu_count() or 1, fitting_in_memory))
        self._limit = max(memory() // (places + 1), min(LEAST, memory()))
        self._places = asyncio.Semaphore(places)
        self._closed = False
        self._spare: JobProcess | None = None
        self._busy: set[JobProcess] = set()

    def prepare(self) -> None:
        """Start a worker in advance, so that its libraries are loaded before the
        first job.
        """
        self._spare = JobProcess(self._limit)

    async def run(
        self,
        request: Mapping[str, Any],
        progress: Callable[[str], None],
        is_aside: bool = False,
    ) -> dict[str, Any]:
        """Run a request as soon as a worker is free, and return its answer.

        Cancelling this coroutine kills the worker. Beside a request that nobody waits
        for (``is_aside``) another worker stands ready. Raises InputError with the
        worker's error message.
        """
        if self._places.locked():
            progress("waiting for the jobs of other tabs")
        async with self._places:
            work = self.worker()
            if is_aside:
                self.prepare()
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
        """Return the idle worker that was started in advance, or start one."""
        spare = self._spare
        self._spare = None
        if spare is not None and spare.process.is_alive():
            return spare
        return JobProcess(self._limit)

    def close(self) -> None:
        """Kill all workers; no further one is started."""
        self._closed = True
        for work in filter(None, (self._spare, *self._busy)):
            work.kill()


def main(server: Any, parent: int, limit: int) -> None:
    """Run a worker: do the jobs that come through a pipe until the server ends.

    Parameters
    ----------
    server : connection
        The worker's end of the pipe: requests come in, progress and answers go out as
        JSON.
    parent : int
        Process id of the server; the worker ends with it.
    limit : int
        Memory that the worker may use [bytes]. A job beyond it fails with a sentence
        before the computer begins to swap.
    """
    # A process group: Ctrl-C ends the server alone, a kill all that a job started.
    with contextlib.suppress(AttributeError):
        os.setsid()
    end_with(parent)
    os.dup2(2, 1)  # what a library prints is no matter of the server's
    with contextlib.suppress(ImportError, ValueError, OSError):  # no such limits here
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))

    def send(message: dict[str, Any]) -> None:
        text = json.dumps(message, default=as_json)
        server.send_bytes(text.encode())

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


def as_json(value: Any) -> Any:
    """Return what stands in an answer for a record, or for an array."""
    return to_json(value) if isinstance(value, WritesJson) else value.tolist()


def do(job: Callable[[Any], dict[str, Any]], job_request: Any) -> dict[str, Any]:
    """Do a job; return {"result": its answer}, or {"error": a sentence} if it fails.

    A defect of this program also prints its traceback on stderr.
    """
    try:
        with warnings.catch_warnings(action="ignore"):
            return {"result": job(job_request)}
    except (InputError, MemoryError) as error:
        return {"error": sentence(error)}
    except Exception as error:  # a defect, of any kind: the page has to go on
        for line in traceback.format_exc().splitlines():
            print(printable(line), file=sys.stderr)
        return {"error": sentence(error)}


def sentence(error: BaseException) -> str:
    """Return the message to show for an error, with a remedy.

    InputError speaks for itself. Any other error but a lack of memory is a defect of
    this program, which the person is asked to report.
    """
    if isinstance(error, MemoryError):
        error = InputError("Not enough memory", "use fewer or shorter runs")
    if not isinstance(error, InputError):
        what = f"Internal error ({type(error).__name__}: {error})"
        error = InputError(
            what, "nothing was changed; try other data or settings, and report it"
        )
    return error.without_command
