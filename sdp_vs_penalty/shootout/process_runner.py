"""Runs each solver in a process of its own, cheaply: a parent that has imported everything forks.

    python -m sdp_vs_penalty.shootout.watched

reads one request a line on standard input (JSON) and answers each with one line on standard output.
A request names an instance, which is built here and kept, and a contestant; the forked child solves,
sends its numbers through a pipe and ends. A child that takes too long is killed with all that it
started, one that asks for too much memory or dies by a signal is told apart; the parent lives on,
judges the numbers, and answers. Whoever holds the other end of the pipe may die: it ends.
"""

from __future__ import annotations

import contextlib
import json
import math
import multiprocessing
import os
import resource
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from sdp_vs_penalty.parallel import kill
from sdp_vs_penalty.shootout.contestants import Contestant, contestants
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.instances import instance
from sdp_vs_penalty.shootout.judge import Answer, Judgement, judge, no_answer
from sdp_vs_penalty.shootout.reference import Reference, reference

#: Seconds that the proof of a reference may take.
REFERENCE_LIMIT = 900.0
_FORK = multiprocessing.get_context("fork")
#: By the clock a run may take so many times its limit.
_PATIENCE = 4.0


def main() -> None:
    """Answer requests until standard input ends."""
    answers = os.fdopen(os.dup(1), "w")
    # Solvers print; what they print must not mix with answers.
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    everyone, warm = contestants(), set()
    for line in _lines(sys.stdin.fileno()):
        request = json.loads(line)
        try:
            if request["do"] == "reference":
                reply = _reference(request)
            else:
                contestant = everyone[request["solver"]]
                if contestant.name not in warm:  # what a first use pays for, before children are forked
                    warm.add(contestant.name)
                    contestant.warm_up()
                reply = run(request, contestant)
        except Exception as error:  # an answer must come: the other side waits for it
            reply = {"error": f"{type(error).__name__}: {error}"}
        answers.write(json.dumps(reply) + "\n")
        answers.flush()


def _lines(handle: int) -> Any:
    """Lines of a file descriptor without reading ahead, so that whoever waits sees what is there."""
    buffer = b""
    while True:
        chunk = os.read(handle, 65536)
        if not chunk:
            return
        buffer += chunk
        while b"\n" in buffer:
            line, buffer = buffer.split(b"\n", 1)
            yield line


def _checked(request: dict[str, Any]) -> Instance:
    made = instance(request["problem"])
    wanted = request.get("hash")
    if wanted is not None and made.hash != wanted:
        raise ValueError(
            f"instance {request['problem']!r} has hash {made.hash} here and {wanted} where the run was "
            "asked for: use the same version and data on all machines"
        )
    return made


def _reference(request: dict[str, Any]) -> dict[str, Any]:
    made = _checked(request)
    _prepare(made)
    kind, payload, _ = in_child(lambda: reference(made), REFERENCE_LIMIT, request["memory"])
    if kind != "ended":
        found = asdict(Reference("unknown", -np.inf, np.inf, 1.0))
        return {"hash": made.hash, "reference": found, "remark": f"{kind} {payload}".strip()}
    return {"hash": made.hash, "reference": asdict(payload), "remark": ""}


def _prepare(made: Instance) -> None:
    """Work that belongs to no contestant: done before the fork, so that children have it."""
    _ = made.interior, made.near, made.constraints.groups, made.task.ols


def run(request: dict[str, Any], contestant: Contestant) -> dict[str, Any]:
    """The row of runs.csv of one run; its seconds are processor time of set-up and solve."""
    made = _checked(request)
    _prepare(made)
    _ = made.sdp if made.sent is not None else None
    known = Reference(**request["reference"])
    asked = float(request["accuracy"])
    kind, payload, seconds = in_child(
        lambda: _timed(contestant, made, asked), request["time_limit"], request["memory"]
    )
    if kind == "ended":
        answer = payload
        verdict = judge(made, known, answer, asked)
    else:
        answer = replace(no_answer(made, payload, seconds), claims="", attempts=0)
        verdict = Judgement(kind, np.inf, np.inf, np.inf, known.lower, known.upper, -np.inf)
    told = ("status", "iterations", "attempts", "setup_seconds", "solve_seconds")
    return {
        "claimed": answer.claims,
        "seconds": answer.setup_seconds + answer.solve_seconds,
        **{name: getattr(answer, name) for name in told},
        **_verdict(verdict, known),
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


def _verdict(verdict: Judgement, known: Reference) -> dict[str, Any]:
    row = asdict(verdict)
    own = (verdict.upper - row.pop("own_lower")) / known.scale
    row["class"] = row.pop("kind")
    row["own_gap"] = own if np.isfinite(own) else np.inf
    row["dimacs"] = np.inf if verdict.dimacs is None else verdict.dimacs
    return row


def in_child(work: Callable[[], Any], limit: float, memory: float) -> tuple[str, Any, float]:
    """Fork and work: ("ended", result, seconds), or "failed", "timeout" or "crash" with words.

    limit : seconds of processor time, and ``_PATIENCE`` times as many by the clock, because machines are
    shared; memory : GB beyond what the parent already has.
    """
    reader, writer = _FORK.Pipe(duplex=False)
    start = time.monotonic()
    child = _FORK.Process(target=_child, args=(work, writer, limit, memory))
    child.start()
    writer.close()
    ready = reader.poll(_PATIENCE * limit)
    told = None
    if ready:
        with contextlib.suppress(EOFError):  # it has died
            told = reader.recv()
    else:
        kill(child)
    child.join()
    reader.close()
    seconds = time.monotonic() - start
    if not ready:
        told = "timeout", f"stopped after {seconds:.0f} s"
    elif told is None:
        number = -(child.exitcode or 0)
        told = "crash", f"ended by signal {number}" if number > 0 else ""
        if number == signal.SIGXCPU:
            told = "timeout", f"stopped after {limit:g} s of processor time"
    return *told, seconds


def _child(work: Callable[[], Any], writer: Connection, limit: float, memory: float) -> None:
    """In the forked process, which ends here."""
    try:
        os.setsid()  # a group of its own, so that programs it starts are killed with it
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
