"""Physically consistent identification of robot dynamics, and what a model is missing."""

import importlib
from typing import TYPE_CHECKING, Any

from sdp_vs_penalty.plugins import lazy_exports
from sdp_vs_penalty.version import __version__

if TYPE_CHECKING:
    from sdp_vs_penalty import effects as effects
    from sdp_vs_penalty.api.adding import add as add
    from sdp_vs_penalty.api.diagnosis import diagnose as diagnose
    from sdp_vs_penalty.api.exporting import export as export
    from sdp_vs_penalty.api.identification import identify as identify
    from sdp_vs_penalty.api.identification import identify_many as identify_many
    from sdp_vs_penalty.api.registration import register as register
    from sdp_vs_penalty.checks.check import check as check
    from sdp_vs_penalty.data.datasets import fetch as fetch
    from sdp_vs_penalty.data.files import load_measurements as load_measurements
    from sdp_vs_penalty.data.measurements import Measurements as Measurements
    from sdp_vs_penalty.diagnosis.comparison import compare as compare
    from sdp_vs_penalty.diagnosis.where_it_fails import where_it_fails as where_it_fails
    from sdp_vs_penalty.errors import InputError as InputError
    from sdp_vs_penalty.estimation.estimate import Estimate as Estimate
    from sdp_vs_penalty.estimation.estimate import load_estimate as load_estimate
    from sdp_vs_penalty.estimation.excitation import excite as excite
    from sdp_vs_penalty.estimation.resampling import cross_validate as cross_validate
    from sdp_vs_penalty.online.payload import PayloadEstimator as PayloadEstimator
    from sdp_vs_penalty.problem.load import convert as convert
    from sdp_vs_penalty.problem.load import load_problem as load_problem
    from sdp_vs_penalty.problem.problem import Problem as Problem
    from sdp_vs_penalty.ranges.table import find_ranges as find_ranges
    from sdp_vs_penalty.reports import report as report
    from sdp_vs_penalty.simulation.follow import follow as follow
    from sdp_vs_penalty.simulation.hidden_runs import simulate as simulate

# Lazily, so that `--help` and one-line scripts do not pay for Pinocchio and SciPy.
_NAMES = {
    "api.adding": "add",
    "api.diagnosis": "diagnose",
    "api.identification": "identify identify_many",
    "api.registration": "register",
    "checks": "check",
    "data.datasets": "fetch",
    "data.files": "load_measurements",
    "data.measurements": "Measurements",
    "diagnosis.comparison": "compare",
    "diagnosis.where_it_fails": "where_it_fails",
    "errors": "InputError",
    "estimation.estimate": "Estimate load_estimate",
    "estimation.excitation": "excite",
    "estimation.resampling": "cross_validate",
    "api.exporting": "export",
    "online.payload": "PayloadEstimator",
    "problem.load": "convert load_problem",
    "problem.problem": "Problem",
    "ranges": "find_ranges",
    "reports": "report",
    "simulation.follow": "follow",
    "simulation.hidden_runs": "simulate",
}
_found = lazy_exports(__name__, **_NAMES)
__all__ = ["__version__", "effects", *" ".join(_NAMES.values()).split()]


def __getattr__(name: str) -> Any:
    """Import an exported name, or the subpackage ``effects``, on first use."""
    if name == "effects":
        return importlib.import_module(f"{__name__}.effects")
    return globals().setdefault(name, _found(name))


def __dir__() -> list[str]:
    """List the exported names, and the module's dunder attributes."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
