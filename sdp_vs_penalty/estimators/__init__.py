"""Estimators, one file a family."""

from __future__ import annotations

from functools import cache

from sdp_vs_penalty.errors import unknown
from sdp_vs_penalty.estimators.estimator import Estimator
from sdp_vs_penalty.registration import classes

DEFAULT_METHOD = "lmi-sdp"


@cache
def estimator_types() -> dict[str, type[Estimator]]:
    """Every estimator by name."""
    return classes(__name__, __path__, Estimator)


def make_estimator(method: str | Estimator) -> Estimator:
    if isinstance(method, Estimator):
        return method
    try:
        return estimator_types()[method]()
    except KeyError:
        raise unknown("method", method, estimator_types()) from None
