"""Models as a user gives them, an Estimate or a model.json: the one place where that is decided."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

from sdp_vs_penalty.errors import InputError, given
from sdp_vs_penalty.estimation.estimate import Estimate, load_estimate

#: One Estimate or the path of a model.json; a sequence of these; or a mapping from names to these.
Models: TypeAlias = Any


def as_estimate(source: Estimate | str | Path, what: str = "estimate") -> Estimate:
    """An Estimate as it is, or that of a model.json.

    what : how messages call it, such as "diagnose(estimate=...)".
    Raises InputError naming what was given where it is neither, or the file cannot be used.
    """
    if isinstance(source, Estimate):
        return source
    if isinstance(source, str | Path):
        return load_estimate(source)
    what = what.replace("...", given(source))
    raise InputError("no model", "give an Estimate or the path of a model.json", what)


def as_estimates(models: Models, what: str = "models") -> dict[str, Estimate]:
    """Models by name: that of the file, else of the method, numbered where there are several.

    Raises InputError for no model at all, and as :func:`as_estimate` does.
    """
    if isinstance(models, Mapping):
        named = {str(name): as_estimate(model, what) for name, model in models.items()}
    elif isinstance(models, list | tuple):
        named = {}
        for k, model in enumerate(models, start=1):
            estimate = as_estimate(model, what)
            named[_name(model, f"{k} ({estimate.method})")] = estimate
    else:
        estimate = as_estimate(models, what)
        named = {_name(models, estimate.method): estimate}
    if not named:
        raise InputError("No model to compare", "name at least one model.json")
    return named


def _name(source: Any, otherwise: str) -> str:
    return str(source) if isinstance(source, str | Path) else otherwise
