"""Docstrings say what they must, and their examples run."""

from __future__ import annotations

import doctest
import importlib
import inspect
import pkgutil
from pathlib import Path

import pytest

import sdp_vs_penalty
from sdp_vs_penalty.effects import Effect, effect_types

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


def test_there_are_examples() -> None:
    assert {"sdp_vs_penalty.robot.inertia", "sdp_vs_penalty.constraints.cones"} <= set(WITH_EXAMPLES)


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_examples_run(name: str) -> None:
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted > 0
    assert result.failed == 0


@pytest.mark.parametrize("name", VERBS)
def test_public_verbs_explain_every_argument_and_what_they_raise(name: str) -> None:
    verb = getattr(sdp_vs_penalty, name)
    text = inspect.getdoc(verb)
    assert text is not None
    assert "InputError" in text, f"{name} does not say where it raises InputError"
    for parameter in inspect.signature(verb).parameters:
        assert parameter in text, f"{name} does not say what {parameter} is"


@pytest.mark.parametrize("kind", effect_types().values(), ids=effect_types())
def test_effects_explain_themselves(kind: type[Effect]) -> None:
    """What `list effects`, the diagnosis and the report show of an effect."""
    assert kind.equation
    assert kind.explanation.rstrip(")").endswith(".")
    assert kind.reference
