"""Docstrings say what they must, and their examples run."""

import doctest
import importlib
import inspect
from functools import cached_property
from pathlib import Path
from types import FunctionType, MethodType
from typing import get_type_hints

import pytest

import sdp_vs_penalty
from sdp_vs_penalty.effects import Effect, Model
from sdp_vs_penalty.effects.effect import JointEffect
from sdp_vs_penalty.estimators import Estimator, Fit, Task

ROOT = Path(sdp_vs_penalty.__file__).parent
#: Modules, and packages by their own name.
WITH_EXAMPLES = [
    ".".join(path.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(
        ".__init__"
    )
    for path in sorted(ROOT.rglob("*.py"))
    if ">>> " in path.read_text()
]
VERBS = [
    name
    for name in sdp_vs_penalty.__all__
    if inspect.isroutine(getattr(sdp_vs_penalty, name, None))
]


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_examples_run(name):
    if name.startswith("sdp_vs_penalty.page"):
        pytest.importorskip("nicegui", reason="the page needs the extra [page]")
    result = doctest.testmod(
        importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE
    )
    assert result.attempted > 0
    assert result.failed == 0


@pytest.mark.parametrize("name", VERBS)
def test_public_verbs_explain_every_argument_and_what_they_raise(name):
    verb = getattr(sdp_vs_penalty, name)
    text = inspect.getdoc(verb)
    assert text is not None
    assert "InputError" in text, f"{name} does not say where it raises InputError"
    parameters = inspect.signature(verb).parameters
    for parameter in parameters:
        assert parameter in text, f"{name} does not say what {parameter} is"
    by_place = [p for p in parameters.values() if p.kind is p.POSITIONAL_OR_KEYWORD]
    assert len(by_place) <= 4, "options are given by name"


def test_everything_that_users_hold_says_what_it_is():
    """Every public method and property of the classes of ``__all__``, of what its
    functions return, and of what models are made of."""
    kinds = [getattr(sdp_vs_penalty, name) for name in sdp_vs_penalty.__all__]
    kinds += [
        get_type_hints(getattr(sdp_vs_penalty, verb)).get("return") for verb in VERBS
    ]
    kinds = [
        *filter(inspect.isclass, kinds),
        Effect,
        JointEffect,
        Model,
        Estimator,
        Task,
        Fit,
    ]
    found = {
        f"{kind.__name__}.{name}": x
        for kind in kinds
        for name, x in inspect.getmembers(kind)
    }
    described = (property, cached_property, FunctionType, MethodType)
    told = {
        k: x for k, x in found.items() if "._" not in k and isinstance(x, described)
    }
    assert len(told) > 120
    assert not [name for name, member in told.items() if not inspect.getdoc(member)]
