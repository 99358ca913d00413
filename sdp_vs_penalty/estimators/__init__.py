"""Estimators, one file a family."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from sdp_vs_penalty.errors import unknown
from sdp_vs_penalty.estimators.estimator import Estimator

DEFAULT_METHOD = "lmi-sdp"


@cache
def estimator_types() -> dict[str, type[Estimator]]:
    """Every estimator by name."""
    found: dict[str, type[Estimator]] = {}
    for module in pkgutil.iter_modules(__path__):
        home = importlib.import_module(f"{__name__}.{module.name}")
        for value in vars(home).values():
            if isinstance(value, type) and issubclass(value, Estimator) and hasattr(value, "name"):
                found[value.name] = value
    return dict(sorted(found.items()))


def make_estimator(method: str | Estimator) -> Estimator:
    if isinstance(method, Estimator):
        return method
    try:
        return estimator_types()[method]()
    except KeyError:
        raise unknown("method", method, estimator_types()) from None
