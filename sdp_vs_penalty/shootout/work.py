"""The runs of the shootout as tasks for any worker: a thread of this process, or of a Dask cluster.

Each worker, local or remote, holds a :mod:`process_runner` and sends it names; numbers are judged there.
A task is all accuracies of one solver on one problem, from loose to tight: what exceeds the time
limit at one accuracy would exceed it at every tighter one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

Row = dict[str, Any]


@dataclass(frozen=True)
class Assignment:
    """Runs of one solver on one problem, or (solver "") the proof of the problem's interval."""

    problem: str
    solver: str
    accuracies: tuple[float, ...]
    settings: tuple[str, ...]
    hash: str | None
    reference: dict[str, Any] | None
    time_limit: float
    memory: float


#: One thread each: runs share the machine, and a forked child must not inherit a pool of threads.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS")


class ProcessRunner:
    """The other end of a process_runner process; started on first use and again if it ever dies."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """One request, one answer. Raises RuntimeError with its own words if it cannot."""
        process = self._started()
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            code = process.wait()
            self._process = None
            raise RuntimeError(f"the process that runs solvers ended with code {code}")
        reply: dict[str, Any] = json.loads(line)
        if "error" in reply:
            raise RuntimeError(reply["error"])
        return reply

    def _started(self) -> subprocess.Popen[str]:
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "sdp_vs_penalty.shootout.watched"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                env={**os.environ, **dict.fromkeys(_THREADS, "1")},
            )
        return self._process

    def close(self) -> None:
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()
            self._process.wait()
            self._process = None


_LOCAL = threading.local()


def process_runner() -> ProcessRunner:
    """This thread's own."""
    if not hasattr(_LOCAL, "process_runner"):
        _LOCAL.process_runner = ProcessRunner()
    found: ProcessRunner = _LOCAL.process_runner
    return found


def perform(task: Assignment) -> tuple[Assignment, list[Row]]:
    """Do a task here; what a worker of any kind calls."""
    try:
        if not task.solver:
            reply = process_runner().ask(
                {"do": "reference", "problem": task.problem, "memory": task.memory}
            )
            return task, [reply]
        return task, list(_runs(task))
    except RuntimeError as error:
        return task, [{"error": str(error)}]


def _runs(task: Assignment) -> Iterator[Row]:
    stopped = ""
    for accuracy, settings in zip(task.accuracies, task.settings, strict=True):
        if stopped:
            yield {
                "settings": settings,
                "accuracy": accuracy,
                "class": "timeout",
                "seconds": task.time_limit,
                "remark": f"not run: {stopped} exceeded the time limit",
            }
            continue
        row = process_runner().ask({**asdict(task), "do": "run", "accuracy": accuracy})
        if row["class"] == "timeout":
            stopped = settings
        yield {"settings": settings, "accuracy": accuracy, **row}
