"""The runs of the shootout as tasks for any worker, each run in a forked process of its own.

A task is all accuracies of one solver on one problem, from loose to tight: what exceeds the time limit
at one accuracy would exceed it at every tighter one. The worker builds the instance, forks, and judges
the numbers that come back; a child that takes too long is killed with all that it started, one that
asks for too much memory or dies by a signal is told apart.
"""

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
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.parallel import end_with
from sdp_vs_penalty.shootout.contestants import Contestant, contestants
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.instances import instance
from sdp_vs_penalty.shootout.judge import Answer, Judgement, Reference, judge, no_answer, reference

Row = dict[str, Any]
#: Seconds that the proof of a reference may take.
REFERENCE_LIMIT = 900.0


@dataclass(frozen=True)
class Assignment:
    """Runs of one solver on one problem, or (solver "") the proof of the problem's interval.

    time_limit [s] and memory [GB] are for each run."""

    problem: str
    hash: str
    time_limit: float
    memory: float
    solver: str = ""
    accuracies: tuple[float, ...] = ()
    reference: Reference | None = None


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
        _ = made.interior, made.constraints.groups, made.task.ols
        if task.solver:
            return task, list(_runs(task, made))
        kind, found, _ = in_child(lambda: reference(made), REFERENCE_LIMIT, task.memory)
        remark = "" if kind == "ended" else f"{kind} {found}".strip()
        found = Reference("unknown", -np.inf, np.inf, 1.0) if remark else found
        return task, [{"hash": made.hash, "reference": asdict(found), "remark": remark}]
    except Exception as error:  # an answer must come: the other side waits for it
        return task, [{"error": f"{type(error).__name__}: {error}"}]


def _runs(task: Assignment, made: Instance) -> Iterator[Row]:
    _ = made.sdp if made.sent is not None else None
    contestant, stopped = contestants()[task.solver], ""
    contestant.warm_up()  # what a first use pays for
    for accuracy in task.accuracies:
        if stopped:
            answer, seconds = _nothing(made, ""), task.time_limit
            verdict = Judgement("timeout", remark=f"not run: {stopped} exceeded the time limit")
        else:
            answer, seconds, verdict = run(task, contestant, made, accuracy)
        settings = contestant.settings(accuracy)
        stopped = stopped or (settings if verdict.kind == "timeout" else "")
        row = asdict(verdict)
        yield {
            **{"settings": settings, "accuracy": accuracy, "class": row.pop("kind"), "seconds": seconds},
            **{"claimed": answer.claims, "status": " ".join(answer.status.split())},
            **{"iterations": answer.iterations, "attempts": answer.attempts, **row},
        }


def run(
    task: Assignment, contestant: Contestant, made: Instance, asked: float
) -> tuple[Answer, float, Judgement]:
    """One run: the answer, its seconds of processor time, programs that it ran included (machines are
    shared), and what it is worth."""
    assert task.reference is not None

    def timed() -> tuple[Answer, float]:
        used = _processor()
        answer = contestant.solve(made, asked)
        return answer, _processor() - used

    kind, payload, seconds = in_child(timed, task.time_limit, task.memory)
    if kind == "ended":
        answer, seconds = payload
        if seconds <= task.time_limit:
            return answer, seconds, judge(made, task.reference, answer, asked)
        kind, payload = "timeout", f"took {seconds:.2g} s of processor time"
    return _nothing(made, payload), seconds, Judgement(kind)


def _nothing(made: Instance, words: str) -> Answer:
    return replace(no_answer(made, words), claims="", attempts=0)


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
        try:  # the address space in use, where the system says it
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            size = pages * resource.getpagesize() + int(memory * 1e9)
        except OSError:
            size = int(8e9 + memory * 1e9)
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
