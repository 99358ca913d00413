"""The same work on this machine (joblib) or on a Dask cluster: a function, and items with names in them.

Items travel, data do not: a task names a file or an instance and returns something small, such as the
triangular factors of a whole recording.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
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
    threads: bool = False,
) -> Iterator[Result]:
    """Results as they come, in any order; scheduler : a Dask scheduler's address, None: this machine.

    threads : here, enough where the function only waits for other processes.
    Raises InputError where Dask is not installed or nobody answers at the address.
    """
    if scheduler is None:
        from joblib import Parallel, delayed

        backend = "threading" if threads else "loky"
        parallel = Parallel(n_jobs=jobs, backend=backend, return_as="generator_unordered", batch_size=1)
        yield from parallel(delayed(function)(item) for item in items)
        return
    with _connected(scheduler) as client:
        from distributed import as_completed

        # A task that ran when its worker died is started again on another one.
        futures = client.map(function, list(items), pure=False, retries=_RETRIES)
        for _, result in as_completed(futures, with_results=True):
            yield result


def _connected(scheduler: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise missing_extra("--scheduler needs Dask,", "cluster") from None
    try:
        return Client(scheduler, timeout=_PATIENCE)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"--scheduler {scheduler}: no Dask scheduler answers there ({error})",
            "start one, or correct its address",
        ) from error
