"""COPT, commercial, where its package and a licence are found; called through CVXPY."""

import os
from pathlib import Path

from sdp_vs_penalty.solvers.solver import ACCURACY
from sdp_vs_penalty.solvers.through_cvxpy import ThroughCvxpy


class Copt(ThroughCvxpy):
    name = "copt"
    extra = "its vendor, with a licence"
    requires = "package", "coptpy"
    told = dict.fromkeys(("RelGap", "FeasTol", "DualTol"), ACCURACY)

    def licence(self) -> str:
        named = (os.environ.get(name) for name in ("COPT_LICENSE_DIR", "COPT_HOME"))
        folders = [*(Path(folder) for folder in named if folder), Path.home() / "copt"]
        if any((folder / "license.dat").is_file() for folder in folders):
            return ""
        return "no license.dat in COPT_LICENSE_DIR, COPT_HOME or ~/copt"
