"""DSDP (Benson, Ye 2008), a dual-scaling method, the command-line program dsdp5."""

import re
from collections.abc import Mapping
from typing import Any

from sdp_vs_penalty.solvers.programs import Program, Said
from sdp_vs_penalty.solvers.solver import ACCURACY

#: Our problem is DSDP's dual.
_CLAIMS = {
    "DSDP Converged": "optimal",
    "DSDP Primal Unbounded, Dual Infeasible": "infeasible",
    "DSDP Dual Unbounded, Primal Infeasible": "unbounded",
    "DSDP Terminated": "failed",
}


class Dsdp(Program):
    name = "dsdp"
    extra = "a system package: dsdp"
    requires = "program", "dsdp5"
    system_package = "dsdp"
    finest = 1e-6
    told = {"gaptol": ACCURACY, "maxit": 1000}

    def command(self, told: Mapping[str, Any]) -> tuple[list[str], dict[str, str]]:
        words = [word for key, value in told.items() for word in (f"-{key}", str(value))]
        return ["dsdp5", "problem.dat-s", "-save", "solution", *words], {}

    def said(self, text: str, code: int) -> Said:
        status = next((p for p in reversed(_CLAIMS) if p in text), f"exit code {code}")
        steps = re.findall(r"^(\d+)\s+[-\d.e+]+\s+[-\d.e+]+", text, re.M)
        return _CLAIMS.get(status, "failed"), status, int(steps[-1]) if steps else 0
