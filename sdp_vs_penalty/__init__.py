"""Physically consistent identification of robot dynamics, and what a model is missing."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from sdp_vs_penalty.comparison import compare as compare
    from sdp_vs_penalty.diagnosis.adding import add as add
    from sdp_vs_penalty.diagnosis.diagnose import diagnose as diagnose
    from sdp_vs_penalty.estimate import Estimate as Estimate
    from sdp_vs_penalty.estimate import load_estimate as load_estimate
    from sdp_vs_penalty.estimators import identify as identify
    from sdp_vs_penalty.measurements import load_measurements as load_measurements
    from sdp_vs_penalty.problem import load_problem as load_problem

# Lazily, so that `--help` and one-line scripts do not pay for Pinocchio and SciPy.
_HOME = {
    "add": "diagnosis",
    "compare": "comparison",
    "diagnose": "diagnosis",
    "Estimate": "estimate",
    "load_estimate": "estimate",
    "identify": "estimators",
    "load_measurements": "measurements",
    "load_problem": "problem",
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
