"""CSDP (Borchers 1999), the command-line program, through the sparse SDPA format."""

import re
from collections.abc import Mapping
from typing import Any

from sdp_vs_penalty.solvers.programs import Program, Said
from sdp_vs_penalty.solvers.solver import ACCURACY

#: By its exit codes. Our problem is the one that CSDP calls the dual.
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


class Csdp(Program):
    name = "csdp"
    extra = "a system package: coinor-csdp"
    requires = "program", "csdp"
    system_package = "coinor-csdp"
    finest = 1e-8
    told = {**dict.fromkeys(("axtol", "atytol", "objtol"), ACCURACY), "maxiter": 200}

    def command(self, told: Mapping[str, Any]) -> tuple[list[str], dict[str, str]]:
        return ["csdp", "problem.dat-s", "solution"], {"param.csdp": _PARAMETERS.format(**told)}

    def said(self, text: str, code: int) -> Said:
        said = re.findall(r"^(Success|Partial Success|Failure|Declaring|Stuck)[^\n]*", text, re.M)
        found = (s for s in text.splitlines() if said and s.startswith(said[-1]))
        iterations = len(re.findall(r"^Iter:", text, re.M)) - 1
        claims = _CLAIMS[code] if 0 <= code < len(_CLAIMS) else "failed"
        return claims, next(found, f"exit code {code}"), max(iterations, 0)
