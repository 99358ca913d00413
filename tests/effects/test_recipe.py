"""The recipe of CONTRIBUTING: one new file is an effect, and one maker hides it in a world."""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from effect_contract import check_units_are_those_of_the_columns
from hidden_contract import check_columns_are_the_hidden_torque, check_every_form_is_met, hidden_cases
from numpy.typing import NDArray

import sdp_vs_penalty.effects as folder
from sdp_vs_penalty import add, compare, diagnose, identify, load_estimate
from sdp_vs_penalty.cli.verbs.list import details
from sdp_vs_penalty.data import concatenate
from sdp_vs_penalty.effects import effect_types, parse_effects
from sdp_vs_penalty.simulation import MAKERS
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs
from sdp_vs_penalty.simulation.worlds.conditions import log_uniform
from sdp_vs_penalty.simulation.worlds.hidden import Hidden, at_joint
from sdp_vs_penalty.simulation.worlds.motion import TrueMotion
from sdp_vs_penalty.simulation.worlds.world import World

NAME = "hardening_spring"
FILE = '''
"""A spring that stiffens."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
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
'''


def hardening(w: World, j: int, rng: np.random.Generator) -> Hidden:
    q_0, side = log_uniform(rng, 0.4, 0.6), float(rng.choice([-1.0, 1.0]))

    def law(w: World, m: TrueMotion) -> NDArray[np.float64]:
        stretched = np.exp(m.q[:, j] / q_0)
        return np.asarray(side * q_0 * (stretched - 1.0 / stretched) / 2.0)

    return at_joint(NAME, j, law, side, q_0=q_0)


@pytest.fixture
def new_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The file in a folder of its own that counts as part of the folder of effects."""
    (tmp_path / f"{NAME}.py").write_text(FILE)
    monkeypatch.setattr(folder, "__path__", [*folder.__path__, str(tmp_path)])
    monkeypatch.setitem(MAKERS, NAME, hardening)
    effect_types.cache_clear()
    yield
    effect_types.cache_clear()
    hidden_cases.cache_clear()
    sys.modules.pop(f"{folder.__name__}.{NAME}", None)


@pytest.mark.usefixtures("new_file")
def test_one_file_keeps_the_contracts_and_is_listed():
    check_units_are_those_of_the_columns(NAME)
    check_columns_are_the_hidden_torque(NAME)
    check_every_form_is_met(NAME)
    row = details("effects", NAME)
    assert row[1:3] == ("k_h q_0 sinh(q / q_0)", "q_0=0.5")


@pytest.mark.long
@pytest.mark.usefixtures("new_file")
def test_one_file_is_hidden_found_added_and_saved(two_link, tmp_path):
    (written,) = parse_effects(f"{NAME}:2@q_0=0.7", two_link.robot)
    assert written.constants == "q_0 = 0.7 rad"
    made = hidden_runs(two_link, [(NAME, [1])], "strong", seed=3)
    data = concatenate(made.runs[:3])
    estimate = identify(two_link, data, "ols", effects=made.truth["model_effects"])
    first = diagnose(estimate, data, made.runs[3]).effects[0]
    assert (first.effect, first.joints) == (NAME, (2,))
    (true,) = made.truth["effects"]
    assert first.size == pytest.approx(true["size"], rel=0.1)
    assert first.shape["q_0"] == pytest.approx(true["shape"]["q_0"], rel=0.1)
    add(estimate, f"{NAME}:2", data).save(tmp_path / "model.json")
    bigger = load_estimate(tmp_path / "model.json")
    assert bigger.model.effects[-1].shape["q_0"] == pytest.approx(first.shape["q_0"], rel=0.1)
    before, after = compare({"before": estimate, "after": bigger}, made.runs[3])
    assert after.rmse[1] < 0.6 * before.rmse[1]


def test_without_the_file_nothing_of_it_is_left():
    assert NAME not in effect_types()
