"""Data left out have the last word; confidence follows from named reasons."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from sdp_vs_penalty.diagnosis.conclude import _judged_alone
from sdp_vs_penalty.diagnosis.findings import Finding
from sdp_vs_penalty.diagnosis.held_out import HeldOut, raises
from sdp_vs_penalty.diagnosis.sentences import REASONS, legend


class Told(HeldOut):
    """Errors by a rule of the effects that are chosen, in the place of fits."""

    def __init__(self, rule: Any) -> None:
        super().__init__(None, False, (), "folds")
        self.rule = rule

    def errors(self, chosen: Any) -> np.ndarray:
        return np.array(self.rule(frozenset(chosen)), float)


def test_what_raises_any_joint_is_not_offered():
    judge = Told(lambda c: [1.0 - 0.3 * (0 in c), 1.0 + 0.05 * (1 in c)])
    assert judge.offered(2) == [0]
    assert Told(lambda c: [1.0 - 0.3 * (0 in c), 1.0 + 0.01 * (1 in c)]).offered(2) == [0, 1]
    assert Told(lambda c: [1.0]).offered(0) == []


def test_a_rise_is_of_any_joint():
    assert raises(np.array([1.0, 1.0]), np.array([0.95, 1.021]))
    assert not raises(np.array([1.0, 1.0]), np.array([0.95, 1.019]))
    assert not raises(np.array([1.0, 1.0]), np.array([0.3, 1.04]))  # repaid by the other joint


def test_confident_findings_do_no_harm_without_the_weak_ones():
    """The first raises joint 1 unless the second, a weak one, is there; the third does nothing to it."""
    finding = Finding(
        "made", (1,), {}, 1.0, "N*m", 0.1, {}, "confident", (), np.ones(2), np.ones(2), "", "made:1", 9.0
    )
    every = [finding, replace(finding, confidence="weak"), finding]
    found: Any = SimpleNamespace(held_out=Told(lambda _: [1.0, 1.0]))
    out = _judged_alone(found, every, lambda c: np.array([1.0 + 0.2 * (0 in c and 1 not in c), 0.5]))
    assert [f.confidence for f in out] == ["weak", "weak", "confident"]
    assert out[0].remarks == (REASONS["not_alone"],)


def test_the_legend_is_made_from_the_reasons():
    assert all(text in legend() for text in REASONS.values())
