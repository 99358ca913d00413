"""CSDP (Borchers 1999), the command-line program, through the sparse SDPA format."""

import re
from typing import Any

from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.programs import run_program

NAME = "csdp"
EXTRA = "a system package: coinor-csdp"
REQUIRES = ("program", "csdp")
SYSTEM_PACKAGE = "coinor-csdp"
CONES = frozenset({"nonnegative", "psd"})

#: Its exit codes. Our problem is the one that CSDP calls the dual.
_CLAIMS = ("optimal", "unbounded", "infeasible", "inaccurate")

_PARAMETERS = """axtol={axtol}
atytol={atytol}
objtol={objtol}
pinftol=1.0e8
dinftol=1.0e8
maxiter={maxiter}
minstepfrac=0.90
maxstepfrac=0.97
minstepp=1.0e-8
minstepd=1.0e-8
usexzgap=1
tweakgap=0
affine=0
printlevel=1
perturbobj=1
fastmode=0
"""


def options(accuracy: float) -> dict[str, Any]:
    """What the solver is told, in its own words, for a relative gap and feasibility."""
    return {"axtol": accuracy, "atytol": accuracy, "objtol": accuracy, "maxiter": 200}


def solve(problem: ConicProblem, accuracy: float = 1e-8) -> Solution:
    """Solve to the accuracy asked for (feasibility and gap)."""
    files = {"param.csdp": _PARAMETERS.format(**options(accuracy))}
    return run_program(problem, ["csdp", "problem.dat-s", "solution"], files, _judge)


def _judge(text: str, code: int) -> tuple[str, str, int]:
    said = re.findall(r"^(Success|Partial Success|Failure|Declaring|Stuck)[^\n]*", text, re.M)
    line = next((s for s in text.splitlines() if said and s.startswith(said[-1])), f"exit code {code}")
    iterations = len(re.findall(r"^Iter:", text, re.M)) - 1
    claims = _CLAIMS[code] if 0 <= code < len(_CLAIMS) else "failed"
    return claims, line, max(iterations, 0)
