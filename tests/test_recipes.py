"""The recipes of CONTRIBUTING: one new file is found by everything that lists, runs and
compares."""

import sys
from collections.abc import Iterator
from pathlib import Path

import effect_contract
import numpy as np
import pytest
from numpy.typing import NDArray

import sdp_vs_penalty.effects
import sdp_vs_penalty.estimators
import sdp_vs_penalty.solvers
from sdp_vs_penalty import export, identify
from sdp_vs_penalty.api.registration import REGISTRIES
from sdp_vs_penalty.cli.verbs.list import details, listing
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.estimators import LmiSdp, estimator_types
from sdp_vs_penalty.shootout.contestants import contestants
from sdp_vs_penalty.simulation import (
    MAKERS,
    Hidden,
    TrueMotion,
    World,
    at_joint,
    experiment,
    log_uniform,
)
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs
from sdp_vs_penalty.testing import contracts

ESTIMATOR = '''"""Least squares with a pull of every parameter to the nominal one."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task
from sdp_vs_penalty.solvers.objective import Objective


@dataclass(frozen=True)
class Ridge(Estimator):
    name: ClassVar[str] = "ridge"
    description = "least squares pulled to the nominal parameters"

    weight: float = 1e-3

    def fit(self, task: Task) -> Fit:
        data, p = task.data, len(task.nominal)
        scale = self.weight * np.sqrt(data.tau_squared) / np.maximum(task.bound, 1e-9)
        rows = np.vstack([data.R, np.diag(scale)])
        right = np.concatenate([data.rho, scale * task.nominal])
        theta = np.linalg.lstsq(rows, right, rcond=None)[0]
        return Fit(theta, Objective(data), task.constraints)
'''

SOLVER = '''"""Clarabel under another name, asked for half the digits."""

from sdp_vs_penalty.solvers.clarabel import Clarabel

WARM = []


class HalfHearted(Clarabel):
    name = "half-hearted"
    finest = 1e-9

    def options(self, accuracy, tuned=True):
        return super().options(10.0 * accuracy, tuned)

    def warm_up(self):
        WARM.append(True)
'''


@pytest.fixture
def added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """One file more in each of three folders, as if it had been written there."""
    homes = (
        (sdp_vs_penalty.estimators, "ridge", ESTIMATOR),
        (sdp_vs_penalty.solvers, "half_hearted", SOLVER),
        (sdp_vs_penalty.effects, NAME, FILE),
    )
    for package, name, content in homes:
        folder = tmp_path / package.__name__.rpartition(".")[2]
        folder.mkdir()
        (folder / f"{name}.py").write_text(content)
        monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    monkeypatch.setitem(MAKERS, NAME, hardening)
    forget()
    yield
    for package, name, _ in homes:
        sys.modules.pop(f"{package.__name__}.{name}", None)
        vars(package).pop(name, None)
    monkeypatch.undo()
    forget()


def forget() -> None:
    """Look for plug-ins again, and draw hidden worlds again."""
    for registry in REGISTRIES:
        registry.forget()
    effect_contract.hidden_cases.cache_clear()


def test_an_estimator_is_one_file(two_link, added):
    assert "ridge" in estimator_types()
    assert ("ridge", "least squares pulled to the nominal parameters") in listing(
        "methods"
    )[1]
    run = experiment(two_link).training_run(seed=0)
    estimate = identify(two_link, run, "ridge")
    assert estimate.method == "ridge"
    assert estimate.settings["weight"] == 1e-3
    torque = run.tau - run.tau.mean(axis=0)
    assert estimate.certificate.loss < np.sum(torque**2)


def test_a_solver_is_one_file(two_link, added):
    assert "half-hearted" in [row[0] for row in listing("solvers")[1]]
    estimate = identify(
        two_link,
        experiment(two_link).training_run(seed=0),
        LmiSdp(solver="half-hearted"),
    )
    gap = estimate.certificate.gap
    assert gap < 1e-7
    contestant = contestants()["half-hearted"]
    contestant.warm_up()
    assert not contestant.absent
    assert sys.modules["sdp_vs_penalty.solvers.half_hearted"].WARM == [True]


NAME = "hardening_spring"
FILE = '''
"""A spring that stiffens."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.shape import POSITION, ShapeConstant


class HardeningSpring(JointEffect):
    name = "hardening_spring"
    equation = "k_h q_0 sinh(q / q_0)"
    explanation = "A spring that stiffens with the distance from zero, as rubber does."
    reference = "Ogden, Non-Linear Elastic Deformations, 1984"
    symbol = "k_h"
    units = ("N*m/rad", "N/m")
    shapes = {"q_0": ShapeConstant(0.5, POSITION, grid=(0.25, 0.5, 1.0), bounds=(0.1, 4.0))}

    def column(self, motion: Motion, joint: int) -> Array:
        return self.shape["q_0"] * np.sinh(motion.q[:, joint] / self.shape["q_0"])
'''


def hardening(w: World, j: int, rng: np.random.Generator) -> Hidden:
    q_0 = log_uniform(rng, 0.4, 0.6)
    side = float(rng.choice([-1.0, 1.0]))

    def law(w: World, m: TrueMotion) -> NDArray[np.float64]:
        stretched = np.exp(m.q[:, j] / q_0)
        return np.asarray(side * q_0 * (stretched - 1.0 / stretched) / 2.0)

    return at_joint(j, law, side, q_0=q_0)


def test_an_effect_of_one_file_is_exported_and_hidden(two_link, added, tmp_path):
    """Its columns are its C code and its torque in a simulated world."""
    MAKERS.pop(NAME)  # which states it a second time
    runs = hidden_runs(two_link, [(NAME, [1])], "strong", seed=1)
    assert runs.truth["effects"][0]["effect"] == NAME
    estimate = identify(
        two_link, runs.runs[0], effects=f"rigid_body,{NAME}:2", check=False
    )
    assert export(estimate, tmp_path / "model.h") == ()
    code = (tmp_path / "model.h").read_text("utf-8")
    assert "* 0.5 * sinh(q[1] / 0.5); /* hardening_spring */" in code


def test_one_file_keeps_the_contracts_and_is_listed(added):
    for contract in contracts(effect_types()[NAME]).values():
        contract()
    effect_contract.check_columns_are_the_hidden_torque(NAME)
    row = details("effects", NAME)
    assert row[1:3] == ("k_h q_0 sinh(q / q_0)", "q_0=0.5")
