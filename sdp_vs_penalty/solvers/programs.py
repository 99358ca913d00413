"""Command-line solvers that read the sparse SDPA format: CSDP, DSDP, SDPA."""

import signal
import subprocess
import tempfile
from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.conic_files import sdpa_text, svec_entries
from sdp_vs_penalty.solvers.solver import Solver

#: What a program claims, its own words, iterations.
Said = tuple[str, str, int]


class Program(Solver):
    """Runs in a fresh folder that holds problem.dat-s."""

    cones = frozenset({"nonnegative", "psd"})
    # All inequalities in one block at the end: of several, DSDP's saved solution holds none.
    order = "psd", "nonnegative"

    @abstractmethod
    def command(self, told: Mapping[str, Any]) -> tuple[list[str], dict[str, str]]:
        """What is run, and the files of its own that it reads, by name."""

    @abstractmethod
    def said(self, text: str, code: int) -> Said:
        """From what it printed and its exit code."""

    def read(self, folder: Path, problem: ConicProblem) -> tuple[Array, Array]:
        """x and z of "solution" in the format of CSDP, which DSDP shares: matrix 1 is Z, matrix 2 X.

        Raises OSError, ValueError or IndexError where there is no answer.
        """
        lines = (folder / "solution").read_text().splitlines()
        x = np.array([float(word) for word in lines[0].split()])
        entries = np.array([[float(w) for w in line.split()] for line in lines[1:] if line.strip()])
        z, (block, i, j, factor) = np.zeros(len(problem.b)), svec_entries(problem.cones)
        rows = {place: k for k, place in enumerate(zip(block, i, j, strict=True))}
        for matrix, number, *place, value in entries.reshape(-1, 5):
            if int(matrix) == 2:
                low, high = sorted(int(x) - 1 for x in place)
                k = rows[int(number) - 1, low, high]
                z[k] = value / factor[k]
        return x, z

    def run(self, problem: ConicProblem, told: Mapping[str, Any]) -> Solution:
        command, files = self.command(told)
        with tempfile.TemporaryDirectory(prefix="sdp-vs-penalty-") as name:
            folder = Path(name)
            for file, content in {"problem.dat-s": sdpa_text(problem), **files}.items():
                (folder / file).write_text(content)
            done = subprocess.run(
                command,
                cwd=folder,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                check=False,
            )
            if -done.returncode == signal.SIGXCPU:
                raise TimeoutError(f"{command[0]} used up its processor time")
            if done.returncode < 0:  # killed by a signal: the caller's process counts it as a crash
                raise ChildProcessError(f"{command[0]} ended by signal {-done.returncode}")
            claims, status, iterations = self.said(done.stdout, done.returncode)
            try:
                x, z = self.read(folder, problem)
            except (OSError, ValueError, IndexError):
                x, z = np.zeros(0), np.zeros(0)
        if (len(x), len(z)) == (len(problem.q), len(problem.b)):
            return Solution(x, z, claims, status, iterations)
        claims = "failed" if claims in ("optimal", "inaccurate") else claims
        return Solution.none(problem, status, claims, iterations)
