"""The runs of the shootout as tasks for any worker, each run in a forked process of its own.

A task is all accuracies of one solver on one problem, from loose to tight: what exceeds the time limit
at one accuracy would exceed it at every tighter one. The worker builds the instance, forks, and judges
the numbers that come back; a child that takes too long is killed with all that it started, one that
asks for too much memory or dies by a signal is told apart.
"""

from __future__ import annotations

import contextlib
import math
import os
import resource
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from sdp_vs_penalty.parallel import end_with
from sdp_vs_penalty.shootout.contestants import Contestant, contestants
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.instances import instance
from sdp_vs_penalty.shootout.judge import Answer, Judgement, judge, no_answer
from sdp_vs_penalty.shootout.reference import Reference, reference

Row = dict[str, Any]
#: Seconds that the proof of a reference may take.
REFERENCE_LIMIT = 900.0


@dataclass(frozen=True)
class Assignment:
    """Runs of one solver on one problem, or (solver "") the proof of the problem's interval.

    time_limit [s] and memory [GB] are for each run."""

    problem: str
    solver: str
    accuracies: tuple[float, ...]
    settings: tuple[str, ...]
    hash: str
    reference: dict[str, Any] | None
    time_limit: float
    memory: float


def perform(task: Assignment) -> tuple[Assignment, list[Row]]:
    """Do a task here; what a worker of any kind calls. {"error": ...} where that is not possible."""
    try:
        made = instance(task.problem)
        if made.hash != task.hash:
            raise ValueError(
                f"instance {task.problem!r} has hash {made.hash} here and {task.hash} where the run was "
                "asked for: use the same version and data on all machines"
            )
        # Work that belongs to no contestant: done before the fork, so that children have it.
        _ = made.interior, made.near, made.constraints.groups, made.task.ols
        return task, list(_runs(task, made)) if task.solver else [_proved(made, task.memory)]
    except Exception as error:  # an answer must come: the other side waits for it
        return task, [{"error": f"{type(error).__name__}: {error}"}]


def _proved(made: Instance, memory: float) -> Row:
    kind, found, _ = in_child(lambda: reference(made), REFERENCE_LIMIT, memory)
    remark = "" if kind == "ended" else f"{kind} {found}".strip()
    if remark:
        found = Reference("unknown", -np.inf, np.inf, 1.0)
    return {"hash": made.hash, "reference": asdict(found), "remark": remark}


def _runs(task: Assignment, made: Instance) -> Iterator[Row]:
    _ = made.sdp if made.sent is not None else None
    contestant, stopped = contestants()[task.solver], ""
    contestant.warm_up()  # what a first use pays for
    for accuracy, settings in zip(task.accuracies, task.settings, strict=True):
        why = f"not run: {stopped} exceeded the time limit"
        row = {"class": "timeout", "seconds": task.time_limit, "remark": why}
        if not stopped:
            row = run(task, contestant, made, accuracy)
            stopped = settings if row["class"] == "timeout" else ""
        yield {"settings": settings, "accuracy": accuracy, **row}


def run(task: Assignment, contestant: Contestant, made: Instance, asked: float) -> Row:
    """The row of runs.csv of one run; its seconds are processor time of set-up and solve."""
    assert task.reference is not None
    known = Reference(**task.reference)
    kind, payload, seconds = in_child(
        lambda: _timed(contestant, made, asked), task.time_limit, task.memory
    )
    if kind == "ended" and (used := payload.setup_seconds + payload.solve_seconds) > task.time_limit:
        kind, payload, seconds = "timeout", f"took {used:.2g} s of processor time", used
    if kind == "ended":
        answer = payload
        verdict = judge(made, known, answer, asked)
    else:
        answer = replace(no_answer(made, payload, seconds), claims="", attempts=0)
        verdict = Judgement(kind, np.inf, np.inf, np.inf, known.lower, known.upper, -np.inf)
    told = ("status", "iterations", "attempts", "setup_seconds", "solve_seconds")
    row = asdict(verdict)
    own = (verdict.upper - row.pop("own_lower")) / known.scale
    return {
        "claimed": answer.claims,
        "seconds": answer.setup_seconds + answer.solve_seconds,
        **{name: getattr(answer, name) for name in told},
        "class": row.pop("kind"),
        **row,
        "own_gap": own if np.isfinite(own) else np.inf,
        "dimacs": np.inf if verdict.dimacs is None else verdict.dimacs,
    }


def _timed(contestant: Contestant, made: Instance, asked: float) -> Answer:
    """The answer, its seconds in processor time, programs that it ran included: machines are shared.

    A contestant's own clock says which part of the call is set-up and which solve; both are cut to the
    share of the call in which the processor worked.
    """
    clock, used = time.perf_counter(), _processor()
    answer = contestant.solve(made, asked)
    share = min(1.0, (_processor() - used) / max(time.perf_counter() - clock, 1e-9))
    return replace(
        answer,
        setup_seconds=share * answer.setup_seconds,
        solve_seconds=share * answer.solve_seconds,
    )


def _processor() -> float:
    """Processor time of this process and of the programs that it ran [s]."""
    own, others = (resource.getrusage(x) for x in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + others.ru_utime + others.ru_stime


def in_child(
    work: Callable[[], Any], limit: float, memory: float, patience: float = 4.0
) -> tuple[str, Any, float]:
    """Fork and work: ("ended", result, seconds), or "failed", "timeout" or "crash" with words.

    limit : seconds of processor time, and ``patience`` times as many by the clock, because machines are
    shared; memory : GB beyond what the parent already has.
    """
    reader, writer = Pipe(duplex=False)
    start, parent = time.monotonic(), os.getpid()
    child = os.fork()
    if child == 0:
        _child(work, writer, limit, memory, parent)
    writer.close()
    ended, status, told = 0, 0, None
    # Not by the pipe's end alone: a child of another thread may hold that open.
    while not ended and not reader.poll(0.05) and time.monotonic() - start < patience * limit:
        ended, status = os.waitpid(child, os.WNOHANG)
    seconds = time.monotonic() - start
    if reader.poll():
        with contextlib.suppress(EOFError):  # it has died
            told = reader.recv()
    elif not ended:
        told = "timeout", f"stopped after {seconds:.0f} s"
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
    if not ended:
        _, status = os.waitpid(child, 0)
    reader.close()
    if told is None:
        number = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
        told = "crash", f"ended by signal {number}" if number else ""
        if number == signal.SIGXCPU:
            told = "timeout", f"stopped after {limit:g} s of processor time"
    return *told, seconds


def _child(
    work: Callable[[], Any], writer: Connection, limit: float, memory: float, parent: int
) -> None:
    """In the forked process, which ends here."""
    try:
        os.setsid()  # a group of its own, so that programs it starts are killed with it
        end_with(parent)
        os.environ["RAYON_NUM_THREADS"] = "1"  # runs share the machine
        silence = os.open(os.devnull, os.O_WRONLY)  # solvers print
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        used = resource.getrusage(resource.RUSAGE_SELF)
        whole = math.ceil(used.ru_utime + used.ru_stime + limit)  # whole seconds: the kernel's grain
        resource.setrlimit(resource.RLIMIT_CPU, (whole, whole + 2))
        size = _address_space() + int(memory * 1e9)
        resource.setrlimit(resource.RLIMIT_AS, (size, size))
        writer.send(("ended", work()))
    except MemoryError:
        writer.send(("crash", f"asked for more than {memory:g} GB"))
    except TimeoutError as error:  # a solver's program used up the processor time
        writer.send(("timeout", str(error)))
    except ChildProcessError as error:  # a solver's program died by a signal
        writer.send(("crash", str(error)))
    except BaseException as error:  # a Rust panic is not an Exception
        writer.send(("failed", f"{type(error).__name__}: {error}"[:2000]))
    finally:
        os._exit(0)


def _address_space() -> int:
    """Bytes of address space in use; 0 where the system does not say."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return int(8e9)
