"""Command-line solvers that read the sparse SDPA format: CSDP, DSDP, SDPA."""

import re
import signal
import subprocess
import tempfile
from abc import abstractmethod
from collections.abc import Mapping
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
        """The command line of the program.

        Parameters
        ----------
        options : mapping
            Its options.

        Returns
        -------
        list of str
            Its words.
        """

    @abstractmethod
    def ended(
        self,
        text: str,
        code: int,
    ) -> tuple[str, str, int]:
        """What the program says of its answer.

        Parameters
        ----------
        text : str
            What it printed.
        code : int
            Its exit code.

        Returns
        -------
        tuple
            What it claims, its own words, and how many iterations it made.
        """

    def read(
        self,
        folder: Path,
        problem: ConicProblem,
    ) -> tuple[Array, Array]:
        """x and z of the file "solution" in the format of CSDP, which DSDP shares: matrix
        1 is Z, matrix 2 X.

        Parameters
        ----------
        folder : Path
            Where the program ran.
        problem : ConicProblem
            What it was asked.

        Returns
        -------
        tuple
            x (m,) and z (r,).

        Raises
        ------
        ArithmeticError, LookupError, OSError, ValueError
            Where there is no answer.
        """
        lines = (folder / "solution").read_text("utf-8").splitlines()
        x = np.array([float(word) for word in lines[0].split()])
        entries = np.array(
            [[float(w) for w in line.split()] for line in lines[1:] if line.strip()]
        )
        z = np.zeros(len(problem.b))
        block, i, j, factor = svec_entries(problem.cones)
        places = zip(
            block,
            i,
            j,
            strict=True,
        )
        row_by_place = {place: row for row, place in enumerate(places)}
        for matrix, number, first, second, value in entries.reshape(-1, 5):
            if int(matrix) != 2:
                continue
            low, high = sorted((int(first) - 1, int(second) - 1))
            row = row_by_place[int(number) - 1, low, high]
            z[row] = value / factor[row]
        return x, z

    def answer(
        self,
        folder: Path,
        problem: ConicProblem,
    ) -> tuple[Array, Array] | None:
        """x and z that the program has written.

        Parameters
        ----------
        folder : Path
            Where the program ran.
        problem : ConicProblem
            What it was asked.

        Returns
        -------
        tuple or None
            None where its file is broken.
        """
        try:
            x, z = self.read(folder, problem)
        except (ArithmeticError, LookupError, OSError, ValueError):
            return None
        has_all = len(x) == len(problem.q) and len(z) == len(problem.b)
        return (x, z) if has_all else None

    def run(
        self,
        problem: ConicProblem,
        options: Mapping[str, Any],
    ) -> Solution:
        command = self.command(options)
        program = command[0]
        with tempfile.TemporaryDirectory(prefix="sdp-vs-penalty-") as name:
            folder = Path(name)
            (folder / "problem.dat-s").write_text(sdpa_text(problem))
            _write_parameters(folder, f"param.{program}", options)
            done = subprocess.run(
                command,
                cwd=folder,
                check=False,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
            )
            _raise_on_signal(program, -done.returncode)
            claims, status, iterations = self.ended(done.stdout, done.returncode)
            answer = self.answer(folder, problem)
        if answer is not None:
            x, z = answer
            return Solution(
                x,
                z,
                claims,
                status,
                iterations,
            )
        if claims in ("optimal", "inaccurate"):
            claims = "failed"
        return Solution.none(
            problem,
            status,
            claims,
            iterations,
        )


def _write_parameters(
    folder: Path,
    name: str,
    options: Mapping[str, Any],
) -> None:
    """The file of options of a program that takes them from one."""
    template = Path(__file__).with_name(name)
    if template.is_file():
        (folder / name).write_text(template.read_text("utf-8").format(**options))


def _raise_on_signal(program: str, number: int) -> None:
    """TimeoutError or ChildProcessError where a signal has ended a program: the caller's
    process counts it as a crash."""
    if number == signal.SIGXCPU:
        raise TimeoutError(f"{program} used up its processor time")
    if number > 0:
        raise ChildProcessError(f"{program} ended by signal {number}")


class Csdp(Program):
    """CSDP (Borchers 1999), the command-line program, through the sparse SDPA format."""

    name = "csdp"
    requires = "program", "csdp"
    system_package = "coinor-csdp"
    finest = 1e-8
    default_options = {
        **dict.fromkeys(("axtol", "atytol", "objtol"), ACCURACY),
        "maxiter": 200,
    }

    def command(self, options: Mapping[str, Any]) -> list[str]:
        return ["csdp", "problem.dat-s", "solution"]

    def ended(
        self,
        text: str,
        code: int,
    ) -> tuple[str, str, int]:
        words = re.findall(
            r"^(Success|Partial Success|Failure|Declaring|Stuck)[^\n]*",
            text,
            re.M,
        )
        line = (s for s in text.splitlines() if words and s.startswith(words[-1]))
        iterations = len(re.findall(r"^Iter:", text, re.M)) - 1
        # By its exit codes. Our problem is the one that CSDP calls the dual.
        claims = dict(enumerate(("optimal", "unbounded", "infeasible", "inaccurate")))
        return (
            claims.get(code, "failed"),
            next(line, f"exit code {code}"),
            max(iterations, 0),
        )


class Dsdp(Program):
    """DSDP (Benson, Ye 2008), a dual-scaling method, the command-line program dsdp5."""

    name = "dsdp"
    requires = "program", "dsdp5"
    system_package = "dsdp"
    finest = 1e-6
    default_options = {
        "gaptol": ACCURACY,
        "maxit": 1000,
    }
    # Our problem is DSDP's dual.
    status_meaning = {
        "DSDP Converged": "optimal",
        "DSDP Primal Unbounded, Dual Infeasible": "infeasible",
        "DSDP Dual Unbounded, Primal Infeasible": "unbounded",
        "DSDP Terminated": "failed",
    }

    def command(self, options: Mapping[str, Any]) -> list[str]:
        words = [
            word for key, value in options.items() for word in (f"-{key}", str(value))
        ]
        return ["dsdp5", "problem.dat-s", "-save", "solution", *words]

    def ended(
        self,
        text: str,
        code: int,
    ) -> tuple[str, str, int]:
        status = next(
            (p for p in reversed(self.status_meaning) if p in text), f"exit code {code}"
        )
        steps = re.findall(r"^(\d+)\s+[-\d.e+]+\s+[-\d.e+]+", text, re.M)
        return (
            self.status_meaning.get(status, "failed"),
            status,
            int(steps[-1]) if steps else 0,
        )


class SdpaProgram(Program):
    """SDPA (Yamashita et al. 2010), the command-line program."""

    name = "sdpa-program"
    requires = "program", "sdpa"
    finest = 1e-7
    default_options = {
        **{
            "maxIteration": 200,
            "epsilonStar": ACCURACY,
            "epsilonDash": ACCURACY,
        },
        **{
            "lambdaStar": 1e2,
            "betaStar": 0.1,
            "betaBar": 0.2,
            "gammaStar": 0.9,
        },
    }
    status_meaning = SDPA_CLAIMS

    def command(self, options: Mapping[str, Any]) -> list[str]:
        files = "-ds", "problem.dat-s", "-o", "answer", "-p", "param.sdpa"
        return ["sdpa", *files, "-numThreads", "1"]

    def ended(
        self,
        text: str,
        code: int,
    ) -> tuple[str, str, int]:
        phase = re.search(r"phase\.value\s*=\s*(\w+)", text)
        steps = re.search(r"Iteration\s*=\s*(\d+)", text)
        status = phase.group(1) if phase else f"exit code {code}"
        return (
            self.status_meaning.get(status, "failed"),
            status,
            int(steps.group(1)) if steps else 0,
        )

    def read(
        self,
        folder: Path,
        problem: ConicProblem,
    ) -> tuple[Array, Array]:
        """x and z of the file "answer".

        Parameters
        ----------
        folder : Path
            Where the program ran.
        problem : ConicProblem
            What it was asked.

        Returns
        -------
        tuple
            x (m,) and z (r,).
        """
        text = (folder / "answer").read_text("utf-8")
        x = _numbers(text.split("xVec =")[1].split("xMat =")[0])
        values = _numbers(text.split("yMat =")[1].split("main loop time")[0])
        z = list[Array]()
        at = 0
        for cone in problem.cones:
            d = cone.size
            entries = values[at : at + (d * d if cone.kind == "psd" else d)]
            z.append(svec(entries.reshape(d, d)) if cone.kind == "psd" else entries)
            at += len(entries)
        return x, np.concatenate(z)


def _numbers(text: str) -> Array:
    return np.array(
        [
            float(w)
            for w in re.findall(r"[-+]?(?:\d[\d.]*(?:[eE][-+]?\d+)?|nan|inf)", text)
        ]
    )
