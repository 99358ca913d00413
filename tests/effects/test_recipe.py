"""The recipe of CONTRIBUTING: one new file is an effect, everywhere, and nothing else is touched."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from effect_contract import check_units_are_those_of_the_columns
from hidden_contract import (
    check_columns_are_the_hidden_torque,
    check_the_hidden_world_shares_no_code,
    check_the_truth_is_what_a_finding_would_say,
    hidden_cases,
)

import sdp_vs_penalty.effects as folder
from sdp_vs_penalty.cli import registry
from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.diagnosis.adding import add
from sdp_vs_penalty.diagnosis.comparison import compare
from sdp_vs_penalty.diagnosis.diagnose import diagnose
from sdp_vs_penalty.effects import effect_types, parse_effects
from sdp_vs_penalty.estimation.estimate import load_estimate
from sdp_vs_penalty.estimation.identify import identify
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs, makers

NAME = "hardening_spring"
FILE = '''
"""A spring that stiffens."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.hidden import HiddenEffect, TrueRobot, either_sign, log_uniform, one_joint
from sdp_vs_penalty.effects.shape import POSITION, Shape


class HardeningSpring(JointEffect):
    name = "hardening_spring"
    equation = "k_h q_0 sinh(q / q_0)"
    explanation = "A spring that stiffens with the distance from zero, as rubber does."
    reference = "Ogden, Non-Linear Elastic Deformations, 1984"
    symbol = "k_h"
    units = ("N*m/rad", "N/m")
    shapes = {"q_0": Shape(0.5, POSITION, grid=(0.25, 0.5, 1.0), bounds=(0.1, 4.0))}

    def column(self, motion: Motion, joint: int) -> Array:
        return self.shape["q_0"] * np.sinh(motion.q[:, joint] / self.shape["q_0"])


def hidden(joint: int, true: TrueRobot, rng: np.random.Generator) -> HiddenEffect:
    q_0 = log_uniform(rng, 0.4, 0.6)

    def law(w: TrueRobot, m: Motion) -> Array:
        stretched = np.exp(m.q[:, joint] / q_0)
        return q_0 * (stretched - 1.0 / stretched) / 2.0

    return one_joint("hardening_spring", joint, law, either_sign(rng), {"q_0": q_0})
'''


@pytest.fixture
def new_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The file in a folder of its own that counts as part of the folder of effects."""
    (tmp_path / f"{NAME}.py").write_text(FILE)
    monkeypatch.setattr(folder, "__path__", [*folder.__path__, str(tmp_path)])
    effect_types.cache_clear()
    yield
    effect_types.cache_clear()
    hidden_cases.cache_clear()
    sys.modules.pop(f"{folder.__name__}.{NAME}", None)


@pytest.mark.usefixtures("new_file")
def test_one_file_keeps_the_contracts_and_is_listed() -> None:
    check_units_are_those_of_the_columns(NAME)
    check_columns_are_the_hidden_torque(NAME)
    check_the_truth_is_what_a_finding_would_say(NAME)
    check_the_hidden_world_shares_no_code(NAME)
    _, row = registry.details("effects", NAME)
    assert row[1:3] == ("k_h q_0 sinh(q / q_0)", "q_0=0.5")
    assert NAME in makers()


@pytest.mark.usefixtures("new_file")
def test_one_file_is_hidden_found_added_and_saved(two_link: Problem, tmp_path: Path) -> None:
    (written,) = parse_effects(f"{NAME}:2@q_0=0.7", two_link.robot)
    assert written.constants == "q_0 = 0.7 rad"
    made = hidden_runs(two_link, [(NAME, [1])], "strong", seed=3)
    data = concatenate(made.runs[:3])
    estimate = identify(two_link, data, "ols", effects=made.truth["model_effects"])
    first = diagnose(estimate, data, made.runs[3]).effects[0]
    assert (first.effect, first.joints) == (NAME, (2,))
    true = made.hidden[0]
    assert true.theta is not None
    assert first.size == pytest.approx(true.theta[0] * true.size, rel=0.1)
    assert first.shape["q_0"] == pytest.approx(true.details["shape"]["q_0"], rel=0.1)
    add(estimate, f"{NAME}:2", data).save(tmp_path / "model.json")
    bigger = load_estimate(tmp_path / "model.json")
    assert bigger.model.effects[-1].shape["q_0"] == pytest.approx(first.shape["q_0"], rel=0.1)
    before, after = compare({"before": estimate, "after": bigger}, made.runs[3])
    assert after.rmse[1] < 0.6 * before.rmse[1]


def test_without_the_file_nothing_of_it_is_left() -> None:
    assert NAME not in effect_types()
