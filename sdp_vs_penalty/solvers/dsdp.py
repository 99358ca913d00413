"""DSDP (Benson, Ye 2008), a dual-scaling method, the command-line program dsdp5."""

import re
from typing import Any

from sdp_vs_penalty.solvers.conic import ConicProblem, Solution
from sdp_vs_penalty.solvers.programs import run_program

NAME = "dsdp"
EXTRA = "a system package: dsdp"
REQUIRES = ("program", "dsdp5")
SYSTEM_PACKAGE = "dsdp"
CONES = frozenset({"nonnegative", "psd"})


def options(accuracy: float) -> dict[str, Any]:
    """What the solver is told, in its own words, for a relative gap and feasibility."""
    return {"gaptol": accuracy, "maxit": 1000}


def solve(problem: ConicProblem, accuracy: float = 1e-6) -> Solution:
    """Solve to the accuracy asked for (relative gap)."""
    chosen = [word for key, value in options(accuracy).items() for word in (f"-{key}", str(value))]
    return run_program(problem, ["dsdp5", "problem.dat-s", "-save", "solution", *chosen], {}, _judge)


def _judge(text: str, code: int) -> tuple[str, str, int]:
    claims, status = "failed", f"exit code {code}"
    for phrase, meaning in (
        ("DSDP Converged", "optimal"),
        ("DSDP Primal Unbounded, Dual Infeasible", "infeasible"),  # our problem is DSDP's dual
        ("DSDP Dual Unbounded, Primal Infeasible", "unbounded"),
        ("DSDP Terminated", "failed"),
    ):
        if phrase in text:
            claims, status = meaning, phrase
    steps = re.findall(r"^(\d+)\s+[-\d.e+]+\s+[-\d.e+]+", text, re.M)
    return claims, status, int(steps[-1]) if steps else 0
