"""Data left out have the last word; confidence follows from named reasons."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sdp_vs_penalty.diagnosis.held_out import HeldOut, raises
from sdp_vs_penalty.diagnosis.reasons import REASONS, Evidence, legend, reasons
from sdp_vs_penalty.effects import Seen


class Told(HeldOut):
    """Errors by a rule of the effects that are chosen, in the place of fits."""

    def __init__(self, rule: Any) -> None:
        super().__init__(None, False, (), "folds")  # type: ignore[arg-type]
        self.rule = rule

    def errors(self, chosen: Any) -> np.ndarray:
        return np.array(self.rule(frozenset(chosen)), float)


def test_what_raises_any_joint_is_not_offered() -> None:
    judge = Told(lambda c: [1.0 - 0.3 * (0 in c), 1.0 + 0.05 * (1 in c)])
    assert judge.offered(2) == [0]
    assert Told(lambda c: [1.0 - 0.3 * (0 in c), 1.0 + 0.01 * (1 in c)]).offered(2) == [0, 1]
    assert Told(lambda c: [1.0]).offered(0) == []


def test_what_needs_another_one_comes_after_it() -> None:
    """The first raises the error unless the second is there."""
    judge = Told(lambda c: [1.0 + (0.2 if 0 in c and 1 not in c else 0.0) - 0.3 * (len(c) == 2)])
    assert judge.offered(2) == [1, 0]


def test_a_rise_is_of_any_joint() -> None:
    assert raises(np.array([1.0, 1.0]), np.array([0.95, 1.021]))
    assert not raises(np.array([1.0, 1.0]), np.array([0.95, 1.019]))
    assert not raises(np.array([1.0, 1.0]), np.array([0.3, 1.04]))  # repaid by the other joint


def evidence(**changes: Any) -> Evidence:
    effect: Any = SimpleNamespace(looks_like=lambda size, seen: changes.pop("said", ""))
    known: dict[str, Any] = {
        "size": 1.0,
        "std": 0.05,
        "J": 200.0,
        "rivals": False,
        "before": np.array([1.0, 1.0]),
        "after": np.array([0.5, 1.0]),
        "left": np.array([0.1, 9.0]),
        "joints": (0,),
        "absorbed": 0.5,
        "shared": 0.1,
        "torque": 0.3,
        "plausible": 0.5,
        "seen": Seen(),
    }
    return Evidence(effect, **{**known, **{k: v for k, v in changes.items() if k != "said"}})


def test_a_finding_without_a_reason_is_confident() -> None:
    assert reasons(evidence()) == {}


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("rivals", {"rivals": True}),
        ("uncertain", {"std": 0.3}),
        ("uncertain", {"std": np.nan}),
        ("uncertain", {"size": 0.0, "std": 0.0}),
        ("small", {"J": 15.0}),
        ("not_held_out", {"after": np.array([1.0, 0.4])}),
        ("more_left", {"left": np.array([0.9, 0.0])}),
        ("absorbed", {"absorbed": 0.9995}),
        ("shared", {"shared": 0.95}),
        ("implausible", {"torque": 12.0}),
        ("implausible", {"plausible": 10.0}),
        ("pieces", {"pieces": True}),
        ("looks_like", {"said": "less than one wave"}),
    ],
)
def test_each_reason_is_computed_and_said(name: str, changes: dict[str, Any]) -> None:
    found = reasons(evidence(**changes))
    assert name in found
    assert found[name] in (REASONS[name], "less than one wave")


def test_the_legend_is_made_from_the_reasons() -> None:
    assert all(text in legend() for text in REASONS.values())
