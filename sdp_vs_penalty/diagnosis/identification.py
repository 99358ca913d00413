"""Identification with its verdict: the one step behind API, command line and page."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec

from sdp_vs_penalty.data.files import Source
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.comparison import Comparison, compare
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.identify import identify as _identify
from sdp_vs_penalty.estimation.pose import readable
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.black_box import BlackBox

P = ParamSpec("P")


def identified(
    problem: str | Path | Problem,
    measurements: Source | BlackBox,
    *settings: Any,
    noise_from: Measurements | None = None,
    **named: Any,
) -> tuple[Estimate, Comparison | None]:
    """The estimate of :func:`~sdp_vs_penalty.estimation.identify.identify`, which takes the settings,
    and its comparison with the same measurements, whose verdict the estimate keeps; None for a black
    box's answers, which are no torque along a motion. noise_from : as in :func:`~.comparison.compare`.
    """
    problem = as_problem(problem, "identify(problem=...)")
    measurements = readable(problem, measurements, "identify(measurements=...)")
    estimate = _identify(problem, measurements, *settings, **named)
    if not isinstance(measurements, Measurements):
        return estimate, None
    fit = compare({estimate.method: estimate}, measurements, noise_from=noise_from)[0]
    estimate.provenance["verdict"] = fit.verdict.to_dict()
    return estimate, fit


def _judged(function: Callable[P, Estimate]) -> Callable[P, Estimate]:
    @wraps(function)
    def verb(*given: P.args, **named: P.kwargs) -> Estimate:
        return identified(*given, **named)[0]  # type: ignore[arg-type]

    return verb


#: The verb of the API.
identify = _judged(_identify)
