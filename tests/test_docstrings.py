"""Docstrings say what they must, and their examples run."""

import doctest
import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import is_dataclass
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

import sdp_vs_penalty
from sdp_vs_penalty.effects import Effect, Model
from sdp_vs_penalty.effects.effect import JointEffect
from sdp_vs_penalty.estimators import Estimator, Fit, Task

ROOT = Path(sdp_vs_penalty.__file__).parent
WITH_EXAMPLES = [
    module.name
    for module in pkgutil.walk_packages([str(ROOT)], "sdp_vs_penalty.")
    if any(
        ">>> " in path.read_text()
        for path in (
            ROOT.parent / (module.name.replace(".", "/") + ".py"),
            ROOT.parent / module.name.replace(".", "/") / "__init__.py",
        )
        if path.is_file()
    )
]
VERBS = [
    name for name in sdp_vs_penalty.__all__ if inspect.isroutine(getattr(sdp_vs_penalty, name, None))
]


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_examples_run(name):
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted > 0
    assert result.failed == 0


@pytest.mark.parametrize("name", VERBS)
def test_public_verbs_explain_every_argument_and_what_they_raise(name):
    verb = getattr(sdp_vs_penalty, name)
    text = inspect.getdoc(verb)
    assert text is not None
    assert "InputError" in text, f"{name} does not say where it raises InputError"
    for parameter in inspect.signature(verb).parameters:
        assert parameter in text, f"{name} does not say what {parameter} is"


def held() -> Iterator[tuple[str, object]]:
    """Every public method of what users hold: the classes of ``__all__``, what its functions return,
    what effects, models and estimators are made of, and the fields of all these."""
    seen: set[type] = set()
    verbs = [getattr(sdp_vs_penalty, name) for name in VERBS]
    todo = [getattr(sdp_vs_penalty, name) for name in sdp_vs_penalty.__all__]
    todo += [Effect, JointEffect, Model, Estimator, Task, Fit]
    todo += [get_type_hints(verb).get("return") for verb in verbs]
    while todo:
        kind = todo.pop()
        todo += get_args(kind)
        if not inspect.isclass(kind) or kind in seen or not kind.__module__.startswith("sdp_vs"):
            continue
        seen.add(kind)
        todo += [*kind.__bases__, *getattr(kind, "__orig_bases__", ())]
        if is_dataclass(kind):
            with suppress(NameError):  # a type that is imported for type checkers alone
                todo += get_type_hints(kind).values()
        for name, member in vars(kind).items():
            for part in (member, *(getattr(member, of, None) for of in ("fget", "func", "__func__"))):
                if (
                    not name.startswith("_")
                    and inspect.isfunction(part)
                    and part.__module__ == kind.__module__
                ):
                    yield f"{kind.__name__}.{name}", part


def test_everything_that_users_hold_says_what_it_is():
    found = dict(held())
    assert len(found) > 150
    assert not [name for name, function in found.items() if not inspect.getdoc(function)]
