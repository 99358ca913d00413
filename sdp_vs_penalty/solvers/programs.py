"""Command-line solvers that read the sparse SDPA format: CSDP, DSDP, SDPA."""

import re
import signal
import subprocess
import tempfile
import time
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.conic import (
    ConicProblem,
    Solution,
    sdpa_text,
    svec,
    svec_entries,
)
from sdp_vs_penalty.solvers.solver import ACCURACY, SDPA_CLAIMS, Solver


class Program(Solver):
    """Runs in a fresh folder that holds problem.dat-s, and the parameters that it is
    told where they go into a file: param.csdp, param.sdpa, as beside this one."""

    cones = frozenset({"nonnegative", "psd"})
    # All inequalities in one block at the end: of several, DSDP's saved solution holds
    # none.
    order = "psd", "nonnegative"

    @abstractmethod
    def command(self, options: Mapping[str, Any]) -> list[str]:
        """Return the command line of the program.

        Parameters
        ----------
        options : mapping
            Options by the program's own names.

        Returns
        -------
        list of str
            Words of the command line.
        """

    @abstractmethod
    def ended(self, text: str, code: int) -> tuple[str, str, int]:
        """Read the outcome from the program's output.

        Returns
        -------
        tuple
            Claim ("optimal", "infeasible", ...), the program's own words, number of
            iterations.
        """

    def read(self, folder: Path, problem: ConicProblem) -> tuple[Array, Array]:
        """Read x and z from the file "solution" in CSDP's format, which DSDP shares.

        Its first line is x; each other line has matrix (1: Z, 2: X), block, row, column
        (from 1) and value. z is the svec of X.

        Parameters
        ----------
        folder : Path
            Folder in which the program ran.

        Returns
        -------
        tuple
            x (m,) and z (r,).

        Raises
        ------
        ArithmeticError, LookupError, OSError, ValueError
            For a missing or broken file.
        """
        lines = (folder / "solution").read_text("utf-8").splitlines()
        x = np.array([float(word) for word in lines[0].split()])
        entries = np.array(
            [[float(w) for w in line.split()] for line in lines[1:] if line.strip()]
        )
        z = np.zeros(len(problem.b))
        block, i, j, factor = svec_entries(problem.cones)
        places = zip(block, i, j, strict=True)
        row_by_place = {place: row for row, place in enumerate(places)}
        for matrix, block_number, first, second, value in entries.reshape(-1, 5):
            is_dual = int(matrix) == 2
            if not is_dual:
                continue
            low, high = sorted((int(first) - 1, int(second) - 1))
            row = row_by_place[int(block_number) - 1, low, high]
            z[row] = value / factor[row]
        return x, z

    def answer(self, folder: Path, problem: ConicProblem) -> tuple[Array, Array] | None:
        """Return x (m,) and z (r,) from the program's file, None if it is broken.

        Parameters
        ----------
        folder : Path
            Folder in which the program ran.
        """
        try:
            x, z = self.read(folder, problem)
        except (ArithmeticError, LookupError, OSError, ValueError):
            return None
        has_all = len(x) == len(problem.q) and len(z) == len(problem.b)
        return (x, z) if has_all else None

    def run(self, problem: ConicProblem, options: Mapping[str, Any]) -> Solution:
        """Solve a conic problem by a solver that is a program of its own.

        The problem is written as a file in the sparse SDPA format to a temporary
        folder, the program runs there, and its solution file is read: variables x (m,)
        and multipliers z (rows,). ``options`` are the program's. Without a readable
        solution the Solution has no numbers, and says what the program claims.
        """
        command = self.command(options)
        with tempfile.TemporaryDirectory(prefix="sdp-vs-penalty-") as name:
            folder = Path(name)
            begin = time.process_time()
            self._write_files(folder, problem, options)
            file_seconds = time.process_time() - begin
            output, code = _run_in(folder, command)
            claims, status, iterations = self.ended(output, code)
            begin = time.process_time()
            answer = self.answer(folder, problem)
            file_seconds += time.process_time() - begin
        if answer is not None:
            return Solution(*answer, claims, status, iterations, file_seconds)
        # A program that claims success without a readable solution has failed.
        if claims in ("optimal", "inaccurate"):
            claims = "failed"
        nothing = Solution.none(problem, status, claims, iterations)
        return replace(nothing, file_seconds=file_seconds)

    def _write_files(
        self, folder: Path, problem: ConicProblem, options: Mapping[str, Any]
    ) -> None:
        """Write the problem, and the options of a program that takes them from a
        file."""
        program = self.command(options)[0]
        (folder / "problem.dat-s").write_text(sdpa_text(problem))
        template = Path(__file__).with_name(f"param.{program}")
        if template.is_file():
            parameters = template.read_text("utf-8").format(**options)
            (folder / template.name).write_text(parameters)


def _run_in(folder: Path, command: Sequence[str]) -> tuple[str, int]:
    """Run a program in a folder; return its output and exit code.

    Raises TimeoutError or ChildProcessError if a signal has ended it, which the caller
    counts as a crash of the solver.
    """
    done = subprocess.run(
        command,
        cwd=folder,
        check=False,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    )
    # A negative return code is minus the signal that ended the program.
    if done.returncode == -signal.SIGXCPU:
        raise TimeoutError(f"{command[0]} used up its processor time")
    if done.returncode < 0:
        what = f"{command[0]} ended by signal {-done.returncode}"
        raise ChildProcessError(what)
    return done.stdout, done.returncode


class Csdp(Program):
    """CSDP (Borchers 1999), the command-line program, through the sparse SDPA format."""

    name = "csdp"
    requires = "program", "csdp"
    system_package = "coinor-csdp"
    default_options = dict.fromkeys(("axtol", "atytol", "objtol"), ACCURACY)

    def command(self, options: Mapping[str, Any]) -> list[str]:
        """Return CSDP's command line; its options are in the file param.csdp."""
        return ["csdp", "problem.dat-s", "solution"]

    def ended(self, text: str, code: int) -> tuple[str, str, int]:
        """Return claim, status line and number of iterations from CSDP's output.

        The claim follows from the exit code; our problem is the one that CSDP calls the
        dual.
        """
        words = re.findall(
            r"^(Success|Partial Success|Failure|Declaring|Stuck)[^\n]*", text, re.M
        )
        # The first line that begins like the last verdict.
        verdicts = (s for s in text.splitlines() if words and s.startswith(words[-1]))
        status = next(verdicts, f"exit code {code}")
        iterations = len(re.findall(r"^Iter:", text, re.M)) - 1
        claim_of_code = ("optimal", "unbounded", "infeasible", "inaccurate")
        claim = claim_of_code[code] if 0 <= code < len(claim_of_code) else "failed"
        return claim, status, max(iterations, 0)


class Dsdp(Program):
    """DSDP (Benson, Ye 2008), a dual-scaling method, the command-line program dsdp5."""

    name = "dsdp"
    requires = "program", "dsdp5"
    system_package = "dsdp"
    default_options = {"gaptol": ACCURACY}
    # Our problem is DSDP's dual.
    status_meaning = {
        "DSDP Converged": "optimal",
        "DSDP Primal Unbounded, Dual Infeasible": "infeasible",
        "DSDP Dual Unbounded, Primal Infeasible": "unbounded",
        "DSDP Terminated": "failed",
    }

    def command(self, options: Mapping[str, Any]) -> list[str]:
        """Return DSDP's command line with all options."""
        words = [
            word for key, value in options.items() for word in (f"-{key}", str(value))
        ]
        return ["dsdp5", "problem.dat-s", "-save", "solution", *words]

    def ended(self, text: str, code: int) -> tuple[str, str, int]:
        """Return claim, status and number of iterations from DSDP's output.

        The status has its reason, and how far DSDP says its solution is infeasible.
        """
        status = next(
            (p for p in reversed(self.status_meaning) if p in text), f"exit code {code}"
        )
        reason = re.search(f"^{re.escape(status)}([^\n.]*)", text, re.M)
        words = status + (reason.group(1).rstrip() if reason else "")
        for misses in re.findall(r"^[PD] Infeasible: *[-\d.e+]+", text, re.M):
            words += f"; {misses}"
        steps = re.findall(r"^(\d+)\s+[-\d.e+]+\s+[-\d.e+]+", text, re.M)
        return (
            self.status_meaning.get(status, "failed"),
            words,
            int(steps[-1]) if steps else 0,
        )

    def run(self, problem: ConicProblem, options: Mapping[str, Any]) -> Solution:
        """Solve a conic problem by DSDP, as by any program.

        A solution that DSDP itself says misses by more than what was asked for is
        inaccurate: it solves a problem with bounds of its own on both variables.
        """
        solution = super().run(problem, options)
        misses = re.findall(r"[PD] Infeasible: *([-\d.e+]+)", solution.status)
        worst = max(map(float, misses), default=0.0)
        if solution.claims == "optimal" and worst > options["gaptol"]:
            return replace(solution, claims="inaccurate")
        return solution


class SdpaProgram(Program):
    """SDPA (Yamashita et al. 2010), the command-line program."""

    name = "sdpa-program"
    requires = "program", "sdpa"
    default_options = {"epsilonStar": ACCURACY, "epsilonDash": ACCURACY}
    status_meaning = SDPA_CLAIMS

    def command(self, options: Mapping[str, Any]) -> list[str]:
        """Return SDPA's command line; its options are in the file param.sdpa."""
        files = "-ds", "problem.dat-s", "-o", "answer", "-p", "param.sdpa"
        return ["sdpa", *files, "-numThreads", "1"]

    def ended(self, text: str, code: int) -> tuple[str, str, int]:
        """Return claim, phase and number of iterations from SDPA's output."""
        phase = re.search(r"phase\.value\s*=\s*(\w+)", text)
        steps = re.search(r"Iteration\s*=\s*(\d+)", text)
        status = phase.group(1) if phase else f"exit code {code}"
        return (
            self.status_meaning.get(status, "failed"),
            status,
            int(steps.group(1)) if steps else 0,
        )

    def read(self, folder: Path, problem: ConicProblem) -> tuple[Array, Array]:
        """Read x and z from SDPA's file "answer" (xVec and yMat).

        Parameters
        ----------
        folder : Path
            Folder in which the program ran.

        Returns
        -------
        tuple
            x (m,) and z (r,); matrices of yMat as svec.
        """
        text = (folder / "answer").read_text("utf-8")
        x = _numbers(text.split("xVec =")[1].split("xMat =")[0])
        values = _numbers(text.split("yMat =")[1].split("main loop time")[0])
        z = list[Array]()
        start = 0
        for cone in problem.cones:
            d = cone.size
            n_entries = d * d if cone.kind == "psd" else d
            entries = values[start : start + n_entries]
            if cone.kind == "psd":
                entries = svec(entries.reshape(d, d))
            z.append(entries)
            start += n_entries
        return x, np.concatenate(z)


def _numbers(text: str) -> Array:
    """Return all decimal numbers, nan and inf in a text."""
    return np.array(
        [
            float(w)
            for w in re.findall(r"[-+]?(?:\d[\d.]*(?:[eE][-+]?\d+)?|nan|inf)", text)
        ]
    )
