"""Runs each solver in a process of its own, cheaply: a parent that has imported everything forks.

    python -m sdp_vs_penalty.shootout.nursery

reads one request a line on standard input (JSON) and answers each with one line on standard output.
A request names an instance, which is built here and kept, and a contestant; the forked child solves,
sends its numbers through a pipe and ends. A child that takes too long is killed with all that it
started, one that asks for too much memory or dies by a signal is told apart; the parent lives on,
judges the numbers, and answers. Whoever holds the other end of the pipe may die: the nursery ends.
"""

from __future__ import annotations

import io
import json
import math
import os
import resource
import select
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from sdp_vs_penalty.shootout.contestant import Contestant, no_answer
from sdp_vs_penalty.shootout.contestants import contestants
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.instances import instance
from sdp_vs_penalty.shootout.judge import Answer, Judgement, judge
from sdp_vs_penalty.shootout.reference import Reference, reference

#: Seconds that the proof of a reference may take.
REFERENCE_LIMIT = 900.0
_PREPARED: set[str] = set()
#: Exit codes of a child that ended by itself without an answer.
_OUT_OF_MEMORY, _RAISED, _OUT_OF_TIME = 3, 4, 6
#: By the clock a run may take so many times its limit.
_PATIENCE = 4.0


def main() -> None:
    """Answer requests until standard input ends."""
    answers = os.fdopen(os.dup(1), "w")
    # Solvers print; what they print must not mix with answers.
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    everyone = contestants()
    for line in _lines(sys.stdin.fileno()):
        request = json.loads(line)
        try:
            if request["do"] == "reference":
                reply = _reference(request)
            else:
                reply = _run(request, everyone[request["solver"]])
        except Exception as error:  # an answer must come: the other side waits for it
            reply = {"error": f"{type(error).__name__}: {error}"}
        answers.write(json.dumps(reply) + "\n")
        answers.flush()


def _prepare_for(contestant: Contestant) -> None:
    """What a contestant pays for on first use only, once, before its children are forked."""
    if contestant.name not in _PREPARED:
        _PREPARED.add(contestant.name)
        contestant.warm_up()


def _lines(handle: int) -> Any:
    """Lines of a file descriptor without reading ahead, so that select() sees what is there."""
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
    kind, payload, _ = in_child(
        lambda: json.dumps(reference(made).to_dict()).encode(), REFERENCE_LIMIT, request["memory"], [0]
    )
    if kind != "ended":
        found = Reference("unknown", -np.inf, np.inf, 1.0).to_dict()
        return {"hash": made.hash, "reference": found, "remark": f"{kind} {payload.decode()}".strip()}
    return {"hash": made.hash, "reference": json.loads(payload), "remark": ""}


def _prepare(made: Instance) -> None:
    """Work that belongs to no contestant: done before the fork, so that children have it."""
    _ = made.interior, made.near, made.constraints.stacks, made.task.ols


def _run(request: dict[str, Any], contestant: Contestant) -> dict[str, Any]:
    made = _checked(request)
    _prepare(made)
    _ = made.sdp if made.sent is not None else None
    _prepare_for(contestant)
    known = Reference(**request["reference"])
    asked = float(request["accuracy"])
    kind, payload, seconds = in_child(
        lambda: _pack(contestant.solve(made, asked)), request["time_limit"], request["memory"], [0]
    )
    if kind == "ended":
        answer = _unpack(payload)
        verdict = judge(made, known, answer, asked)
    else:
        answer = replace(
            no_answer(made, payload.decode(errors="replace"), seconds), claims="", attempts=0
        )
        verdict = Judgement(kind, np.inf, np.inf, np.inf, known.lower, known.upper, -np.inf)
    told = ("status", "iterations", "attempts", "setup_seconds", "solve_seconds")
    return {
        "claimed": answer.claims,
        "seconds": answer.setup_seconds + answer.solve_seconds,
        **{name: getattr(answer, name) for name in told},
        **_verdict(verdict, known),
    }


def _verdict(verdict: Judgement, known: Reference) -> dict[str, Any]:
    row = asdict(verdict)
    own = (verdict.upper - row.pop("own_lower")) / known.scale
    row["class"] = row.pop("kind")
    row["own_gap"] = own if np.isfinite(own) else np.inf
    row["dimacs"] = np.inf if verdict.dimacs is None else verdict.dimacs
    return row


def in_child(
    work: Callable[[], bytes], limit: float, memory: float, watch: Sequence[int] = ()
) -> tuple[str, bytes, float]:
    """Fork, work, and return ("ended" | "failed" | "timeout" | "crash", bytes, seconds).

    limit : seconds of processor time, and ``_PATIENCE`` times as many by the clock, because machines are
    shared; memory : GB beyond what the parent already has; watch : file descriptors at whose end nobody
    waits for the answer any more: child and parent then end.
    """
    reader, writer = os.pipe()
    start = time.monotonic()
    pid = os.fork()
    if pid == 0:
        _child(work, reader, writer, limit, memory)
    os.close(writer)
    chunks: list[bytes] = []
    timed_out = False
    while True:
        left = _PATIENCE * limit - (time.monotonic() - start)
        ready = select.select([reader, *watch], [], [], left)[0] if left > 0.0 else []
        if reader in ready:
            chunk = os.read(reader, 1 << 20)
            if not chunk:
                break
            chunks.append(chunk)
        elif ready:  # standard input: requests come one at a time, so this is its end
            _kill(pid)
            os._exit(0)
        else:
            timed_out = True
            break
    if timed_out:
        _kill(pid)
    os.close(reader)
    _, status = os.waitpid(pid, 0)
    seconds = time.monotonic() - start
    if timed_out:
        return "timeout", f"stopped after {seconds:.0f} s".encode(), seconds
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU:
        return "timeout", f"stopped after {limit:g} s of processor time".encode(), seconds
    if os.WIFSIGNALED(status):
        return "crash", f"ended by signal {os.WTERMSIG(status)}".encode(), seconds
    code = os.WEXITSTATUS(status)
    if code == 0:
        return "ended", b"".join(chunks), seconds
    if code == _OUT_OF_TIME:
        return "timeout", b"".join(chunks), seconds
    if code == _OUT_OF_MEMORY:
        return "crash", f"asked for more than {memory:g} GB".encode(), seconds
    return ("failed" if code == _RAISED else "crash"), b"".join(chunks), seconds


def _child(work: Callable[[], bytes], reader: int, writer: int, limit: float, memory: float) -> None:
    """In the forked process: never returns."""
    code = _RAISED
    try:
        os.setsid()  # a group of its own, so that programs it starts are killed with it
        os.close(reader)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        used = resource.getrusage(resource.RUSAGE_SELF)
        whole = math.ceil(used.ru_utime + used.ru_stime + limit)  # whole seconds: the kernel's grain
        resource.setrlimit(resource.RLIMIT_CPU, (whole, whole + 2))
        size = _address_space() + int(memory * 1e9)
        resource.setrlimit(resource.RLIMIT_AS, (size, size))
        payload = work()
        code = 0
    except MemoryError:
        payload, code = b"", _OUT_OF_MEMORY
    except TimeoutError as error:  # a solver's program used up the processor time
        payload, code = str(error).encode(), _OUT_OF_TIME
    except ChildProcessError as error:  # a solver's program died by a signal
        payload, code = str(error).encode(), 5
    except BaseException as error:  # a Rust panic is not an Exception
        payload = f"{type(error).__name__}: {error}".encode()[:2000]
    try:
        while payload:
            payload = payload[os.write(writer, payload) :]
    finally:
        os._exit(code)


def _address_space() -> int:
    """Bytes of address space in use; 0 where the system does not say."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return int(8e9)


def _kill(pid: int) -> None:
    for target in (os.killpg, os.kill):
        try:
            target(pid, signal.SIGKILL)
        except (ProcessLookupError, PermissionError):
            continue


def _pack(answer: Answer) -> bytes:
    head = {k: v for k, v in vars(answer).items() if isinstance(v, str | int | float)}
    arrays = {"theta": answer.theta, "entropy_slopes": answer.entropy_slopes}
    if answer.multipliers is not None:
        head["multipliers"] = len(answer.multipliers)
        arrays |= {f"m{k}": m for k, m in enumerate(answer.multipliers)}
    found = {name: np.asarray(a, float) for name, a in arrays.items() if a is not None}
    file = io.BytesIO()
    np.savez(file, head=np.frombuffer(json.dumps(head).encode(), np.uint8), **found)  # type: ignore[arg-type]
    return file.getvalue()


def _unpack(payload: bytes) -> Answer:
    with np.load(io.BytesIO(payload), allow_pickle=False) as file:
        head = json.loads(file["head"].tobytes())
        if "multipliers" in head:
            head["multipliers"] = [file[f"m{k}"] for k in range(head["multipliers"])]
        arrays = {name: file[name] for name in ("theta", "entropy_slopes") if name in file.files}
        return Answer(**head, **arrays)


if __name__ == "__main__":
    main()
