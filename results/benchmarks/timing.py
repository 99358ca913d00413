"""Times of calls and processes, each beside another way to do the same in turn."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

#: Command of a process on one thread that only imports NumPy and SciPy: one B of processor
#: time, to which commands are compared.
BARE = [sys.executable, "-c", "import numpy, scipy.linalg, scipy.signal"]
PROGRAM = [sys.executable, "-m", "sdp_vs_penalty"]

#: Run by a small process: a child's peak begins with the memory of the process that
#: starts it. Memory of the child's own (no pages of files) is looked at every 5 ms.
_MEASURE = """
import re, resource, subprocess, sys, tempfile, time

def own_kilobytes(process):
    try:
        with open(f"/proc/{process}/status") as file:
            return sum(map(int, re.findall(r"Rss(?:Anon|Shmem):\\s+(\\d+)", file.read())))
    except OSError:  # no such system, or the process has just ended
        return 0

start = time.perf_counter()
own = 0
with tempfile.TemporaryFile() as errors:
    child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=errors)
    while child.poll() is None:
        own = max(own, own_kilobytes(child.pid))
        time.sleep(0.005)
    wall = time.perf_counter() - start
    errors.seek(0)
    said = errors.read()
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, wall, used.ru_maxrss / 1024.0, own / 1024.0,
      child.returncode)
sys.stderr.buffer.write(said[-2000:])
"""


@dataclass(frozen=True)
class Figure:
    """One row of the table.

    Attributes
    ----------
    what : str
        What was measured.
    ours, other : float or None
        Median of this program, and of the other way.
    unit : str
        Unit of both.
    low, high : float or None
        Smallest and largest ratio other / ours of the single pairs.
    note : str
        What the other way is.
    """

    what: str
    ours: float
    other: float | None
    unit: str
    low: float | None
    high: float | None
    note: str

    @classmethod
    def of_pairs(
        cls, what: str, pairs: NDArray[np.float64], unit: str, note: str
    ) -> Self:
        """Summarise pairs (repeats, 2) of this program's and the other way's figures."""
        ratios = pairs[:, 1] / pairs[:, 0]
        ours, other = np.median(pairs, axis=0)
        return cls(
            what, float(ours), float(other), unit, ratios.min(), ratios.max(), note
        )

    @classmethod
    def single(
        cls, what: str, ours: float, unit: str, note: str, other: float | None = None
    ) -> Self:
        """Keep a figure that was measured once."""
        return cls(what, ours, other, unit, None, None, note)


@dataclass(frozen=True)
class Usage:
    """What a process used.

    processor, wall : time [s]; memory : peak of resident pages [MB], those of files among
    them; own : peak of the pages that belong to no file [MB].
    """

    processor: float
    wall: float
    memory: float
    own: float


def run_process(command: list[str], may_fail: bool = False) -> Usage:
    """Run a command on one thread and return what it used."""
    # Bytecode is kept, as on a user's machine.
    environment = {
        k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"
    }
    done = subprocess.run(
        [sys.executable, "-c", _MEASURE, *command],
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    )
    *used, code = map(float, done.stdout.split())
    if code and not may_fail:
        raise SystemExit(f"{' '.join(command)}: code {code:.0f}\n{done.stderr}")
    return Usage(*used)


def in_turn(
    ours: Callable[[], object],
    other: Callable[[], object],
    repeats: int,
    scale: float = 1.0,
) -> NDArray[np.float64]:
    """Measure processor times (repeats, 2) of two calls, each pair in turn.

    Parameters
    ----------
    ours, other : callable
        The calls. Both are called once before, for imports and caches.
    repeats : int
        Number of pairs.
    scale : float
        Factor on the seconds: 1000 for milliseconds.
    """
    ours()
    other()
    return scale * np.array(
        [[_processor_time(ours), _processor_time(other)] for _ in range(repeats)]
    )


def _processor_time(call: Callable[[], object]) -> float:
    """Processor time of one call [s]."""
    start = time.process_time()
    call()
    return time.process_time() - start


@contextmanager
def busy_machine(processes: int) -> Iterator[None]:
    """Keep this many processes busy meanwhile."""
    spinning = [
        subprocess.Popen(
            [
                sys.executable,
                "-c",
                "import numpy as np\nx = np.ones((300, 300))\nwhile True: x @ x",
            ]
        )
        for _ in range(processes)
    ]
    try:
        yield
    finally:
        for process in spinning:
            process.kill()
            process.wait()
