"""The same work by processes of this machine or on a Dask cluster: a function, and
items.

An item is a run or an instance; what comes back is small, such as the triangular
factors of a whole recording.
"""

import importlib
import logging
import os
import signal
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from multiprocessing import get_context
from multiprocessing.connection import wait
from typing import Any, TypeVar

from sdp_vs_penalty.errors import InputError, missing_extra

Item = TypeVar("Item")
Result = TypeVar("Result")

#: How often a task is started again when its worker dies.
_RETRIES = 5
#: Seconds to wait for a scheduler to answer.
_PATIENCE = 10.0


def spread(
    function: Callable[[Item], Result],
    items: Iterable[Item],
    scheduler: str | None = None,
    jobs: int = 2,
) -> Iterator[tuple[int, Result]]:
    """Map a function over items in several processes, and yield results as they come.

    A task whose worker died is repeated by another worker, a few times.

    Parameters
    ----------
    function : callable
        A function of one item that can be pickled.
    scheduler : str or None
        Address of a Dask scheduler; None for processes of this computer.
    jobs : int
        Number of processes on this computer.

    Yields
    ------
    tuple
        Index of the item and its result, in any order.

    Raises
    ------
    InputError
        If Dask is not installed, nobody answers at the address, or the scheduler ends.
    """
    todo = list(enumerate(items))
    if scheduler is None:
        yield from _here(function, todo, jobs)
        return
    with _connected(scheduler) as client:
        from distributed import KilledWorker, Variable, as_completed
        from distributed.comm import CommClosedError
        from distributed.protocol.serialize import serialize_bytes

        shared = Variable(f"sdp-vs-penalty-{uuid.uuid4().hex}", client)
        try:
            shared.set(serialize_bytes(function))
            # Short tasks travel together: at most 16 a thread, so that nobody waits for
            # the last one for long. One that ran when its worker died is started again
            # on another one.
            threads = sum(client.nthreads().values())
            size = -(-len(todo) // max(1, min(len(todo), 16 * threads)))
            batches = [todo[k : k + size] for k in range(0, len(todo), size)]
            futures = client.map(
                partial(_each, shared.name), batches, pure=False, retries=_RETRIES
            )
            for future in as_completed(futures):
                yield from future.result()
        except (CancelledError, CommClosedError, KilledWorker) as error:
            raise InputError(
                f"--scheduler {scheduler}: the scheduler, or one worker after another,"
                " has ended",
                "start them again and repeat the command",
            ) from error
        finally:
            shared.delete()


def _each(name: str, items: Sequence[tuple[int, Any]]) -> list[tuple[int, Any]]:
    """Apply the function in a variable of the Dask scheduler to a batch of indexed
    items.

    The function is not scattered to the workers: Dask waits for ever if a worker that
    holds scattered data is killed.
    """
    function = _fetched(name)
    return [(place, function(item)) for place, item in items]


@lru_cache(maxsize=1)
def _fetched(name: str) -> Callable[[Any], Any]:
    """Fetch the function from the Dask scheduler; a worker does so once.

    The worker's own connection is used, since a client would need to be closed.
    """
    from distributed import get_worker
    from distributed.protocol.serialize import deserialize_bytes
    from distributed.utils import sync

    worker = get_worker()
    ask = partial(
        worker.scheduler.variable_get, name=name, client="", timeout=_PATIENCE
    )
    held = sync(worker.loop, ask, callback_timeout=2.0 * _PATIENCE)
    function: Callable[[Any], Any] = deserialize_bytes(held["value"])
    return function


def _here(
    function: Callable[[Item], Result], todo: list[tuple[int, Item]], jobs: int
) -> Iterator[tuple[int, Result]]:
    """Map a function over indexed items by processes of this computer.

    On Linux they are forked, so that they import and read nothing again. An item whose
    process died is repeated; after more than _RETRIES deaths InputError is raised.
    """
    context: Any = get_context("fork" if sys.platform == "linux" else "spawn")
    if sys.platform == "linux":
        # Most work needs it. SciPy would import it on first use: in every process anew.
        importlib.import_module("scipy.optimize")
    process_by_pipe = dict[Any, Any]()
    item_by_pipe = dict[Any, tuple[int, Item]]()  # of processes that work
    n_deaths = 0

    def idle_pipe() -> Any:
        """Return the pipe to an idle process, which is started if there is none."""
        idle = process_by_pipe.keys() - item_by_pipe.keys()
        if idle:
            return idle.pop()
        our_end, their_end = context.Pipe()
        process_by_pipe[our_end] = context.Process(
            target=_serve, args=(function, their_end, os.getpid())
        )
        with _signals_held():  # until the worker knows what to do with them
            process_by_pipe[our_end].start()
        their_end.close()  # so that the worker's death closes it
        return our_end

    try:
        while todo or item_by_pipe:
            while todo and len(item_by_pipe) < jobs:
                pipe = idle_pipe()
                item_by_pipe[pipe] = todo.pop(0)
                with suppress(OSError):  # the worker has died
                    pipe.send(item_by_pipe[pipe])
            ready: list[Any] = wait(list(item_by_pipe))
            for pipe in ready:
                item = item_by_pipe.pop(pipe)
                try:
                    result, error = pipe.recv()
                except (EOFError, OSError):
                    todo = [item, *todo]
                    n_deaths += 1
                    process_by_pipe.pop(pipe).join()
                    if n_deaths > _RETRIES:
                        what = f"{n_deaths} processes were ended from outside"
                        raise InputError(
                            what, "take fewer --jobs: memory may be short"
                        ) from None
                    continue
                if error is not None:
                    raise error
                yield result
    finally:
        for process in process_by_pipe.values():
            if process.pid is not None:  # it could be started
                process.terminate()
                process.join()


#: What ends a command, and its workers in their own way.
_HELD = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def _signals_held() -> Iterator[None]:
    """Delay Ctrl-C and SIGTERM while this runs, also in a process that is started
    here.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _HELD)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(function: Callable[[Any], Any], line: Any, parent: int) -> None:
    """Serve as a worker process: answer each item with its result, or an error.

    Parameters
    ----------
    function : callable
        A function of one item.
    line : Connection
        The worker's end of the pipe.
    parent : int
        Process number of the parent, with which the worker ends.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # its parent ends it
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _HELD)
    end_with(parent)
    while True:
        place, item = line.recv()
        try:
            answer: tuple[Any, ...] = (place, function(item)), None
        except Exception as error:
            answer = None, error
        line.send(answer)


def _unheard(text: str) -> None:
    """Report progress to nobody."""


@dataclass(frozen=True)
class Workers:
    """Who does work that falls into parts: this process, several, or a Dask cluster."""

    #: Number of processes of this computer.
    jobs: int = 1
    #: Address of the cluster's scheduler, tcp://HOST:PORT; None for this computer.
    scheduler: str | None = None
    #: Receives how many parts are done, as a line of text.
    progress: Callable[[str], None] = _unheard

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item]
    ) -> list[Result]:
        """Map a function of one item, which can be pickled, over items; results are in
        the order of the items.

        Raises InputError as :func:`spread` does.
        """
        todo = list(items)
        result_by_place: dict[int, Result] = {}
        begin = time.monotonic()
        results: Iterable[tuple[int, Result]] = enumerate(map(function, todo))
        if self.scheduler is not None or min(self.jobs, len(todo)) > 1:
            results = spread(function, todo, self.scheduler, self.jobs)
        for k, result in results:
            result_by_place[k] = result
            done, total = len(result_by_place), len(todo)
            if total > 1:
                # How long the others take at this pace.
                seconds_left = (time.monotonic() - begin) * (total - done) / done
                words = f"{done} of {total} done"
                words += f", about {seconds_left:.0f} s left" * (seconds_left >= 1.0)
                self.progress(words)
        return [result_by_place[k] for k in range(len(todo))]


#: This process alone.
ALONE = Workers()


def end_with(parent: int) -> None:
    """Make this worker process end when its parent ends, for whatever reason.

    Parameters
    ----------
    parent : int
        Process number of the parent.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _connected(scheduler: str) -> Any:
    """Connect to a Dask scheduler. Raises InputError if Dask or the scheduler is
    missing.
    """
    try:
        from distributed import Client
    except ImportError:
        raise missing_extra("--scheduler needs Dask,", "cluster") from None
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # the error below says it
    try:
        return Client(scheduler, timeout=_PATIENCE)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({error})",
            "start one, or correct its address",
        ) from error
