"""A run in a forked process of its own, which ends by itself, the clock, its memory or a signal."""

import contextlib
import math
import os
import resource
import signal
import time
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from sdp_vs_penalty.parallel import end_with


def in_child(work: Callable[[], Any], limit: float, memory: float) -> tuple[str, Any, float]:
    """Fork and work: ("ended", result, seconds), or "failed", "timeout" or "crash" with words.

    limit : seconds of processor time, and four times as many by the clock, because machines are shared;
    memory : GB beyond what the parent already has.
    """
    reader, writer = Pipe(duplex=False)
    start, parent = time.monotonic(), os.getpid()
    child = os.fork()
    if child == 0:
        _child(work, writer, limit, memory, parent)
    writer.close()
    ended, status, told = 0, 0, None
    # Not by the pipe's end alone: a child of another thread may hold that open.
    while not ended and not reader.poll(0.05) and time.monotonic() - start < 4.0 * limit:
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
