"""The same work on this machine (joblib) or on a Dask cluster: a function, and items with names in them.

Items travel, data do not: a task names a file or an instance and returns something small, such as the
triangular factors of a whole recording.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any, TypeVar

from sdp_vs_penalty.errors import InputError, missing_extra
from sdp_vs_penalty.measurements import Measurements, load_measurements
from sdp_vs_penalty.preprocessing import Preprocessing
from sdp_vs_penalty.problem import load_problem
from sdp_vs_penalty.regression import Regression, compress
from sdp_vs_penalty.robot import Robot

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
            f"--scheduler {scheduler}: no Dask scheduler answers there ({error})."
        ) from error


@dataclass(frozen=True)
class _File:
    """One file to compress: place counts the files, so that they merge in their own order."""

    place: int
    path: str
    problem: str
    effects: str | None
    settings: Preprocessing


def compress_files(
    problem: str,
    files: Sequence[str | Path],
    effects: str | None = None,
    settings: Preprocessing | None = None,
    scheduler: str | None = None,
    jobs: int = 2,
) -> Regression:
    """The factors of many recordings, each file read and compressed by one worker, then merged.

    problem : a name, folder or URDF file that every worker can open; effects as on the command line.
    The filters are those of the file that needs the lowest cut-offs, for all files alike.
    """
    if not files:
        raise InputError("compress_files: no files are given.")
    robot = load_problem(problem)
    start = settings or robot.preprocessing
    items = [_File(k, str(f), problem, effects, start) for k, f in enumerate(files)]
    if len(items) > 1 or start.state_cutoff is None or start.torque_cutoff is None:
        found = list(spread(_resolved, items, scheduler, jobs))
        state = min(s.state_cutoff for s in found if s.state_cutoff is not None)
        torque = min(s.torque_cutoff for s in found if s.torque_cutoff is not None)
        common = replace(start, state_cutoff=state, torque_cutoff=torque)
        items = [replace(item, settings=common) for item in items]
    parts = sorted(spread(_compressed, items, scheduler, jobs), key=lambda part: part[0])
    return reduce(lambda a, b: a.merge(b), (regression for _, regression in parts))


def _resolved(item: _File) -> Preprocessing:
    robot = load_problem(item.problem).robot
    return item.settings.resolve(_run(item, robot))


def _compressed(item: _File) -> tuple[int, Regression]:
    problem = load_problem(item.problem)
    run = _run(item, problem.robot)
    return item.place, compress(run, problem.model(item.effects), item.settings)


def _run(item: _File, robot: Robot) -> Measurements:
    return load_measurements(item.path, joints=robot.n, names=[joint.name for joint in robot.joints])
