"""Command-line solvers that read the sparse SDPA format: CSDP, DSDP, SDPA."""

import signal
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.conic_files import sdpa_text, svec_entries
from sdp_vs_penalty.solvers.rewrite import linear_matrix_inequalities, reorder

#: From what a program printed and its exit code to (claims, its own words, iterations).
Judge = Callable[[str, int], tuple[str, str, int]]
#: From the folder it ran in to x and z, or None where it left no answer.
Reader = Callable[[Path, ConicProblem], tuple[Array, Array] | None]


def read_solution(folder: Path, problem: ConicProblem) -> tuple[Array, Array] | None:
    """x and z of "solution" in the format of CSDP, which DSDP shares: matrix 1 is Z, matrix 2 X."""
    try:
        lines = (folder / "solution").read_text().splitlines()
        x = np.array([float(word) for word in lines[0].split()])
        entries = np.array(
            [[float(word) for word in line.split()] for line in lines[1:] if line.strip()]
        )
    except (OSError, ValueError, IndexError):
        return None
    if len(x) != len(problem.q):
        return None
    z, (block, i, j, factor) = np.zeros(len(problem.b)), svec_entries(problem.cones)
    rows = {place: k for k, place in enumerate(zip(block, i, j, strict=True))}
    for matrix, number, *place, value in entries.reshape(-1, 5):
        if int(matrix) == 2:
            low, high = sorted(int(x) - 1 for x in place)
            k = rows[int(number) - 1, low, high]
            z[k] = value / factor[k]
    return x, z


def run_program(
    problem: ConicProblem,
    command: Sequence[str],
    files: dict[str, str],
    judge: Judge,
    reader: Reader = read_solution,
) -> Solution:
    """Write problem.dat-s and the program's own files into a fresh folder, run it there, read back."""
    # All inequalities in one block at the end: of several, DSDP's saved solution holds none.
    lmi = linear_matrix_inequalities(problem).then(lambda p: reorder(p, ("psd", "nonnegative")))
    with tempfile.TemporaryDirectory(prefix="sdp-vs-penalty-") as name:
        folder = Path(name)
        (folder / "problem.dat-s").write_text(sdpa_text(lmi.problem))
        for file, content in files.items():
            (folder / file).write_text(content)
        done = subprocess.run(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
        )
        if -done.returncode == signal.SIGXCPU:
            raise TimeoutError(f"{command[0]} used up its processor time")
        if done.returncode < 0:  # killed by a signal: the caller's process counts it as a crash
            raise ChildProcessError(f"{command[0]} ended by signal {-done.returncode}")
        claims, status, iterations = judge(done.stdout, done.returncode)
        answer = reader(folder, lmi.problem)
    if answer is None:
        answer = np.full(len(lmi.problem.q), np.nan), np.full(len(lmi.problem.b), np.nan)
        claims = "failed" if claims in ("optimal", "inaccurate") else claims
    x, z = lmi.back(*answer)
    return Solution(x, z, claims, status, iterations, (lmi.problem, *answer))
