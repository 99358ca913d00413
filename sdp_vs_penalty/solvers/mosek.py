"""MOSEK, commercial, where its package and a licence are found; called through CVXPY."""

import os
from pathlib import Path

from sdp_vs_penalty.solvers.solver import ACCURACY
from sdp_vs_penalty.solvers.through_cvxpy import ThroughCvxpy


class Mosek(ThroughCvxpy):
    name = "mosek"
    extra = "its vendor, with a licence"
    requires = "package", "mosek"
    group = "mosek_params"
    told = {f"MSK_DPAR_INTPNT_CO_TOL_{what}": ACCURACY for what in ("REL_GAP", "PFEAS", "DFEAS")}

    def licence(self) -> str:
        named = os.environ.get("MOSEKLM_LICENSE_FILE")
        if named and ("@" in named or Path(named).exists()):  # a file, or port@server
            return ""
        if (Path.home() / "mosek" / "mosek.lic").is_file():
            return ""
        return "no licence in MOSEKLM_LICENSE_FILE or ~/mosek/mosek.lic"
