"""SDPA (Yamashita et al. 2010), the command-line program."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.solvers.conic import ConicProblem, Solution, svec
from sdp_vs_penalty.solvers.programs import run_program
from sdp_vs_penalty.solvers.sdpa import CLAIMS

NAME = "sdpa-program"
EXTRA = "a system package: sdpa"
REQUIRES = ("program", "sdpa")
CONES = frozenset({"nonnegative", "psd"})

_DEFAULT = {"lambdaStar": 1e2, "betaStar": 0.1, "betaBar": 0.2, "gammaStar": 0.9}
#: The other two parameter sets of its manual (-pt 1 and -pt 2).
VARIANTS = {
    "fast": {"lambdaStar": 1e2, "betaStar": 0.01, "betaBar": 0.02, "gammaStar": 0.95},
    "stable": {
        "lambdaStar": 1e4,
        "betaStar": 0.1,
        "betaBar": 0.3,
        "gammaStar": 0.8,
        "maxIteration": 1000,
    },
}

_PARAMETERS = """{maxIteration} unsigned int maxIteration;
{epsilonStar} double 0.0 < epsilonStar;
{lambdaStar} double 0.0 < lambdaStar;
2.0 double 1.0 < omegaStar;
-1.0E5 double lowerBound;
1.0E5 double upperBound;
{betaStar} double 0.0 <= betaStar < 1.0;
{betaBar} double 0.0 <= betaBar < 1.0, betaStar <= betaBar;
{gammaStar} double 0.0 < gammaStar < 1.0;
{epsilonDash} double 0.0 < epsilonDash;
%+.17e char* xPrint (default %+8.3e, NOPRINT skips printout)
%+.17e char* XPrint (default %+8.3e, NOPRINT skips printout)
%+.17e char* YPrint (default %+8.3e, NOPRINT skips printout)
%+.17e char* infPrint (default %+10.16e, NOPRINT skips printout)
"""


def options(accuracy: float, variant: str = "") -> dict[str, Any]:
    """What the solver is told, by the names of its manual (param.sdpa)."""
    told = {"maxIteration": 200, "epsilonStar": accuracy, "epsilonDash": accuracy}
    return told | VARIANTS.get(variant, _DEFAULT)


def solve(problem: ConicProblem, accuracy: float = 1e-7, variant: str = "") -> Solution:
    """Solve to the accuracy asked for (gap and feasibility)."""
    files = {"param.sdpa": _PARAMETERS.format(**options(accuracy, variant))}
    command = ["sdpa", "-ds", "problem.dat-s", "-o", "answer", "-p", "param.sdpa", "-numThreads", "1"]
    return run_program(problem, command, files, _judge, _read)


def _judge(text: str, code: int) -> tuple[str, str, int]:
    phase = re.search(r"phase\.value\s*=\s*(\w+)", text)
    steps = re.search(r"Iteration\s*=\s*(\d+)", text)
    status = phase.group(1) if phase else f"exit code {code}"
    return CLAIMS.get(status, "failed"), status, int(steps.group(1)) if steps else 0


def _read(folder: Path, problem: ConicProblem) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    try:
        text = (folder / "answer").read_text()
        x = _numbers(text.split("xVec =")[1].split("xMat =")[0])
        values = _numbers(text.split("yMat =")[1].split("main loop time")[0])
    except (OSError, IndexError, ValueError):
        return None
    z, at = [], 0
    for cone in problem.cones:
        if cone.kind == "nonnegative":
            z.append(values[at : at + cone.size])
            at += cone.size
            continue
        d = cone.size
        z.append(svec(values[at : at + d * d].reshape(d, d)))
        at += d * d
    return (x, np.concatenate(z)) if len(x) == len(problem.q) and at == len(values) else None


def _numbers(text: str) -> NDArray[np.float64]:
    return np.array([float(w) for w in re.findall(r"[-+]?(?:\d[\d.]*(?:[eE][-+]?\d+)?|nan|inf)", text)])
