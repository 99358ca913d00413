"""Physically consistent identification of robot dynamics, and what a model is missing."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from sdp_vs_penalty.version import __version__

if TYPE_CHECKING:
    from sdp_vs_penalty.data.files import load_measurements as load_measurements
    from sdp_vs_penalty.diagnosis.adding import add as add
    from sdp_vs_penalty.diagnosis.comparison import compare as compare
    from sdp_vs_penalty.diagnosis.diagnose import diagnose as diagnose
    from sdp_vs_penalty.estimation.estimate import Estimate as Estimate
    from sdp_vs_penalty.estimation.estimate import load_estimate as load_estimate
    from sdp_vs_penalty.estimation.identify import identify as identify
    from sdp_vs_penalty.problem.load import load_problem as load_problem

# Lazily, so that `--help` and one-line scripts do not pay for Pinocchio and SciPy.
_HOME = {
    "add": "diagnosis.adding",
    "compare": "diagnosis.comparison",
    "diagnose": "diagnosis.diagnose",
    "Estimate": "estimation.estimate",
    "load_estimate": "estimation.estimate",
    "identify": "estimation.identify",
    "load_measurements": "data.files",
    "load_problem": "problem.load",
}
__all__ = [
    "Estimate",
    "__version__",
    "add",
    "compare",
    "diagnose",
    "identify",
    "load_estimate",
    "load_measurements",
    "load_problem",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
