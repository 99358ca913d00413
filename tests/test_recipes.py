"""The recipes of CONTRIBUTING: one new file is found by everything that lists, runs and compares."""

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import sdp_vs_penalty.estimators
import sdp_vs_penalty.solvers
from sdp_vs_penalty import InputError, identify, load_problem
from sdp_vs_penalty.cli.verbs.list import listing
from sdp_vs_penalty.estimators import LmiSdp, estimator_types
from sdp_vs_penalty.paper.tables.methods import WITH_PRIOR, build
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.plugins import by_word
from sdp_vs_penalty.shootout.contestants import contestants
from sdp_vs_penalty.simulation import experiment
from sdp_vs_penalty.solvers import solver_modules

ESTIMATOR = '''"""Least squares with a pull of every parameter to the nominal one."""

from __future__ import annotations

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

from __future__ import annotations

from typing import Any

from sdp_vs_penalty.solvers import clarabel
from sdp_vs_penalty.solvers.conic import ConicProblem, Solution

NAME = "half-hearted"
EXTRA = None
REQUIRES = ("package", "clarabel")
CONES = clarabel.CONES
WARM = []


def options(accuracy: float) -> dict[str, Any]:
    return {"accuracy": 10.0 * accuracy}


def warm_up() -> None:
    WARM.append(True)


def solve(problem: ConicProblem, accuracy: float = 1e-9) -> Solution:
    return clarabel.solve(problem, **options(accuracy))
'''


@pytest.fixture
def added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """One file more in each of the two folders, as if it had been written there."""
    homes: tuple[tuple[ModuleType, str, str], ...] = (
        (sdp_vs_penalty.estimators, "ridge", ESTIMATOR),
        (sdp_vs_penalty.solvers, "half_hearted", SOLVER),
    )
    for package, name, content in homes:
        folder = tmp_path / package.__name__.rpartition(".")[2]
        folder.mkdir()
        (folder / f"{name}.py").write_text(content)
        monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    estimator_types.cache_clear()
    solver_modules.cache_clear()
    yield
    for package, name, _ in homes:
        sys.modules.pop(f"{package.__name__}.{name}", None)
        vars(package).pop(name, None)
    monkeypatch.undo()
    estimator_types.cache_clear()
    solver_modules.cache_clear()


def test_an_estimator_is_one_file(added):
    assert "ridge" in estimator_types()
    assert ("ridge", "least squares pulled to the nominal parameters") in listing("methods")[1]
    problem = load_problem("two_link")
    run = experiment(problem).training_run(seed=0)
    estimate = identify(problem, run, "ridge")
    assert estimate.method == "ridge"
    assert estimate.settings["weight"] == 1e-3
    torque = run.tau - run.tau.mean(axis=0)
    assert estimate.certificate.loss < np.sum(torque**2)


def test_what_must_differ_is_refused_if_equal():
    for twins, word in (
        ([("spring", int), ("spring", float)], "name"),
        ([(3, int), (3, str)], "table_place"),
    ):
        with pytest.raises(InputError, match=f"int and .* have the same {word}"):
            by_word(twins, word)
    assert list(by_word([(2, int), (1, str), (2, int)])) == [1, 2]  # one class in two files is one


def test_an_estimator_is_in_the_table_of_methods_by_itself(added, monkeypatch):
    few = {name: kind for name, kind in estimator_types().items() if name in ("ridge", "lmi-sdp-plain")}
    monkeypatch.setattr("sdp_vs_penalty.paper.tables.methods.estimator_types", lambda: few)
    study = Study(load_problem("two_link"))
    rows = [row for row in build(study).rows if row[0] == "simulated"]
    assert {row[1] for row in rows} == {"ridge", "lmi-sdp-plain", *WITH_PRIOR}


def test_a_solver_is_one_file(added):
    assert "half-hearted" in [row[0] for row in listing("solvers")[1]]
    problem = load_problem("two_link")
    estimate = identify(problem, experiment(problem).training_run(seed=0), LmiSdp(solver="half-hearted"))
    gap = estimate.certificate.gap
    assert gap < 1e-7
    contestant = contestants()["half-hearted"]
    contestant.warm_up()
    assert contestant.absent is None
    assert sys.modules["sdp_vs_penalty.solvers.half_hearted"].WARM == [True]
