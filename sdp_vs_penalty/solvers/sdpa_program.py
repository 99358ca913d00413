"""SDPA (Yamashita et al. 2010), the command-line program."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.conic import ConicProblem, svec
from sdp_vs_penalty.solvers.programs import Program, Said
from sdp_vs_penalty.solvers.sdpa import CLAIMS
from sdp_vs_penalty.solvers.solver import ACCURACY

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


class SdpaProgram(Program):
    name = "sdpa-program"
    extra = "a system package: sdpa"
    requires = "program", "sdpa"
    finest = 1e-7
    told = {
        "maxIteration": 200,
        "epsilonStar": ACCURACY,
        "epsilonDash": ACCURACY,
        "lambdaStar": 1e2,
        "betaStar": 0.1,
        "betaBar": 0.2,
        "gammaStar": 0.9,
    }
    variants = {  # -pt 1 and -pt 2
        "fast": {"betaStar": 0.01, "betaBar": 0.02, "gammaStar": 0.95},
        "stable": {"lambdaStar": 1e4, "betaBar": 0.3, "gammaStar": 0.8, "maxIteration": 1000},
    }

    def command(self, told: Mapping[str, Any]) -> tuple[list[str], dict[str, str]]:
        words = ["sdpa", "-ds", "problem.dat-s", "-o", "answer", "-p", "param.sdpa", "-numThreads", "1"]
        return words, {"param.sdpa": _PARAMETERS.format(**told)}

    def said(self, text: str, code: int) -> Said:
        phase = re.search(r"phase\.value\s*=\s*(\w+)", text)
        steps = re.search(r"Iteration\s*=\s*(\d+)", text)
        status = phase.group(1) if phase else f"exit code {code}"
        return CLAIMS.get(status, "failed"), status, int(steps.group(1)) if steps else 0

    def read(self, folder: Path, problem: ConicProblem) -> tuple[Array, Array]:
        text = (folder / "answer").read_text()
        x = _numbers(text.split("xVec =")[1].split("xMat =")[0])
        values = _numbers(text.split("yMat =")[1].split("main loop time")[0])
        z, at = list[Array](), 0
        for cone in problem.cones:
            d = cone.size
            own = values[at : at + (d * d if cone.kind == "psd" else d)]
            z.append(svec(own.reshape(d, d)) if cone.kind == "psd" else own)
            at += len(own)
        return x, np.concatenate(z)


def _numbers(text: str) -> Array:
    return np.array([float(w) for w in re.findall(r"[-+]?(?:\d[\d.]*(?:[eE][-+]?\d+)?|nan|inf)", text)])
