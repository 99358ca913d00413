"""What several tables share: the data of a problem and every method's estimate, computed once."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import unknown
from sdp_vs_penalty.estimation.certificate import Certificate
from sdp_vs_penalty.estimation.identify import certify, identify
from sdp_vs_penalty.estimators import estimator_types
from sdp_vs_penalty.estimators.estimator import Estimator, Progress, Task, make_task, no_progress
from sdp_vs_penalty.estimators.penalty_paper import PAPER_BUDGET, PenaltyPaper
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.plugins import by_word
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.problem.published import measured_run, real_file
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.regression.black_box import BlackBox, load_configurations
from sdp_vs_penalty.regression.regression import Regression, compress, compress_cells
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.phases import PhaseFolds, phase_folds
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.simulation.experiments import Experiment, experiment

BUDGETS = ("quick", "paper")
_PLACED = by_word(
    ((kind.table_place, kind) for kind in estimator_types().values() if kind.table_place), "table_place"
)
#: Methods with the pull of friction and offsets to zero that `lmi-sdp` has, and nothing else of it.
WITH_PRIOR = ("lmi-sdp-plain, joint prior", "penalty, joint prior")
#: The columns of Tables III, VII, VIII, IX and the rows of IV: our name and the method's.
METHODS: Mapping[str, str] = {
    re.sub(r"\W+", "_", name): name for name in (*(k.name for k in _PLACED.values()), *WITH_PRIOR)
}
#: Where the real run is cut for repeatability [s]: what comes later is its beginning again.
TRAIN_STOP, TEST_START = 14.0, 14.2
#: Folds by phase in which it is judged on motion that an estimate has not seen.
FOLDS = 5


@dataclass(frozen=True)
class Data:
    """One data set, compressed: what estimates are made from, and what they are judged on.

    label : how columns and rows are named, "simulated" or "measured"; test is None where nothing is
    held out.
    """

    label: str
    train: Measurements
    test: Measurements | None
    model: Model
    preprocessing: Preprocessing

    @property
    def key(self) -> str:
        """Which rows estimates are made from."""
        return self.train.data_hash

    @cached_property
    def regression(self) -> Regression:
        return compress(self.train, self.model, self.preprocessing)

    @cached_property
    def test_regression(self) -> Regression:
        return self.test_with(self.model)

    def test_with(self, model: Model) -> Regression:
        """The held-out rows in the columns of another model."""
        assert self.test is not None
        return compress(self.test, model, self.preprocessing, blocks_per_run=1)

    def errors(self, theta: Array, regression: Regression | None = None) -> tuple[Array, float]:
        """Held-out mean squared torque error (n,) [(N m)^2] and relative error over all joints [%]."""
        rows = self.test_regression if regression is None else regression
        return torque_errors(rows, theta)


@dataclass(frozen=True)
class PhaseFold(Data):
    """A run without one stretch of its motion, judged on that stretch and all its repetitions."""

    split: PhaseFolds
    number: int

    @property
    def key(self) -> str:
        return f"{self.train.data_hash}, fold {self.number + 1} of {self.split.count}"

    @cached_property
    def regression(self) -> Regression:
        return self._cells(self.model).select(self.split.training(self.number))

    def test_with(self, model: Model) -> Regression:
        return self._cells(model).select(self.split.tested(self.number))

    def _cells(self, model: Model) -> Regression:
        return compress_cells(self.train, model, self.preprocessing, self.split)


@dataclass(frozen=True)
class Unseen:
    """Errors on unseen motion: mse (n,) and relative [%] over all folds; folds : relative of each."""

    mse: Array
    relative: float
    folds: tuple[float, ...]


@dataclass(frozen=True)
class Result:
    """One method on one data set: theta as certified, its certificate, time to fit [s]."""

    theta: Array
    certificate: Certificate
    seconds: float
    details: dict[str, Any]


class Study:
    """The data and estimates behind the tables of one problem; everything is computed on first use.

    workers : who estimates where several estimates are needed at once. Raises InputError for a budget
    that does not exist.
    """

    def __init__(
        self,
        problem: Problem,
        budget: str = "quick",
        seed: int = 0,
        progress: Progress = no_progress,
        workers: Workers = ALONE,
    ) -> None:
        if budget not in BUDGETS:
            raise unknown("budget", budget, BUDGETS)
        self.problem, self.budget, self.seed, self.progress = problem, budget, seed, progress
        self.workers = workers
        self._results: dict[tuple[str, str], Result] = {}
        self._tasks: dict[str, Task] = {}

    @cached_property
    def experiment(self) -> Experiment:
        return experiment(self.problem)

    @cached_property
    def simulated(self) -> Data:
        """Trained on one exciting trajectory, judged on the validation trajectories."""
        self.progress("simulating")
        x = self.experiment
        train, test = x.training_run(self.seed), concatenate(x.validation_runs(self.seed))
        return self._data("simulated", train, test, self.problem.model(x.effects))

    @cached_property
    def run(self) -> Measurements | None:
        """The real run of this problem where it is at hand."""
        return measured_run(self.problem)

    @cached_property
    def measured(self) -> Data | None:
        """The whole real run, as the paper used it."""
        if self.run is None:
            return None
        return self._data("measured", self.run, None, self.problem.model())

    @cached_property
    def repeated(self) -> Data | None:
        """The real run before TRAIN_STOP, judged on its repetition after TEST_START."""
        if self.run is None:
            return None
        train, test = self.run.window(0.0, TRAIN_STOP), self.run.window(TEST_START, np.inf)
        return self._data("measured", train, test, self.problem.model())

    @cached_property
    def folds(self) -> tuple[Data, ...]:
        """The real run's folds by phase: each judged on motion that it does not train on."""
        if self.run is None:
            return ()
        self.progress("folds by phase")
        settings = self.problem.preprocessing.resolve(self.run)
        split, model = phase_folds(self.run, settings, FOLDS), self.problem.model()
        return tuple(
            PhaseFold("measured", self.run, None, model, settings, split, k) for k in range(FOLDS)
        )

    def unseen(self, theta: Callable[[Data], Array], model: Model | None = None) -> Unseen:
        """Errors over the folds of what ``theta`` makes of each, in the columns of a model."""
        pairs = []
        for fold in self.folds:
            rows = fold.test_regression if model is None else fold.test_with(model)
            pairs.append((rows, theta(fold)))
        losses = np.array([rows.joint_losses(x) for rows, x in pairs])
        count = np.array([rows.joint_rows() for rows, _ in pairs])
        squares = np.array([rows.least_squares().tau_squared for rows, _ in pairs])
        relative = 100.0 * np.sqrt(losses.sum() / squares.sum())
        each = 100.0 * np.sqrt(losses.sum(axis=1) / squares)
        mse = losses.sum(axis=0) / np.maximum(count.sum(axis=0), 1)
        return Unseen(mse, float(relative), tuple(each.tolist()))

    def _data(self, label: str, train: Measurements, test: Measurements | None, model: Model) -> Data:
        return Data(label, train, test, model, self.problem.preprocessing.resolve(train))

    @property
    def whole(self) -> list[Data]:
        """What Tables III, VII, VIII and IX are identified from."""
        return [self.simulated, *([] if self.measured is None else [self.measured])]

    @property
    def judged(self) -> list[Data]:
        """Where one estimate is judged by other rows than its own; the real one's are its repetition."""
        return [self.simulated, *([] if self.repeated is None else [self.repeated])]

    def task(self, data: Data) -> Task:
        key = data.key
        if key not in self._tasks:
            self.progress(f"compressing the {data.label} run")
            self._tasks[key] = make_task(self.problem, data.model, data.regression, seed=self.seed)
        return self._tasks[key]

    def result(self, method: str, data: Data) -> Result:
        """A method's estimate from the training part of a data set."""
        self.estimate([method], [data])
        return self._results[method, data.key]

    def estimate(self, methods: Iterable[str], sets: Sequence[Data]) -> None:
        """Have every method's estimate from each of the data sets, by the workers; a task is small."""
        new = {(m, d.key): d for m in methods for d in sets if (m, d.key) not in self._results}
        for (method, _), data in new.items():
            self.task(data)
            self.progress(f"{method} on {data.label} data")
        tasks = [(self.estimator(method), self._tasks[key]) for method, key in new]
        workers = replace(self.workers, progress=self.progress)
        self._results.update(zip(new, workers.map(_estimated, tasks), strict=True))

    @property
    def about_priors(self) -> list[str]:
        """A note on what the names of columns and rows say of the prior."""
        said = (
            "joint_prior: lmi-sdp-plain and penalty with the pull of friction and offsets to zero that "
            "lmi-sdp has, and nothing else of it; optimisers compare among methods with it, or without."
        )
        return [said] if set(WITH_PRIOR) & set(self.methods.values()) else []

    @cached_property
    def methods(self) -> Mapping[str, str]:
        """METHODS, those with another prior only where joints have parameters of their own."""
        own = [len(data.model.parameters) > len(data.model.rigid_indices) for data in self.whole]
        return {k: m for k, m in METHODS.items() if any(own) or m not in WITH_PRIOR}

    def fitted(self, method: str, data: Data) -> Array:
        """theta of a method's estimate."""
        return self.result(method, data).theta

    def links(self, method: str, data: Data) -> Array:
        """(n, 10) links of a method's estimate."""
        return self.fitted(method, data)[data.model.rigid_indices].reshape(-1, 10)

    def estimator(self, method: str) -> Estimator:
        """The method with the settings of this budget, and of its name: "penalty, joint prior"."""
        name, _, prior = method.partition(", ")
        kind: Any = estimator_types()[name]
        if prior:
            return cast(Estimator, kind(joint_prior=1.0))
        if issubclass(kind, PenaltyPaper):
            return kind(evaluations=PAPER_BUDGET if self.budget == "paper" else kind.evaluations)
        return cast(Estimator, kind())

    @cached_property
    def base(self) -> Array:
        """(b, 10 n) map from the links' standard parameters to the base parameters."""
        return base_parameters(self.problem.model("rigid_body"), self.problem.independent)[0]

    @cached_property
    def black_box(self) -> tuple[BlackBox, bool]:
        """The true links' answers, and whether at the authors' configurations."""
        x, file = self.experiment, real_file(self.problem.name, "good_configurations_1010.txt")
        if file is None:
            # Configurations of the black box where the authors' file is absent: as many as theirs.
            q = self.problem.robot.random_configurations(1010, self.seed)
        else:
            q = load_configurations(file, self.problem.robot.n)
        return BlackBox.of_links(self.problem.robot, x.links, q), file is not None

    @cached_property
    def reverse_engineered(self) -> Result:
        """Base parameters from the black box; details hold condition number and relative error."""
        box, _ = self.black_box
        begin = time.perf_counter()
        estimate = identify(self.problem, box, "reverse-engineering", seed=self.seed)
        seconds = time.perf_counter() - begin
        return Result(estimate.theta, estimate.certificate, seconds, estimate.details)

    def frozen_links(self, links: Array, data: Data) -> Array:
        """theta with given links, all other parameters refitted on the training part."""
        theta = np.zeros(len(data.model.parameters))
        theta[data.model.rigid_indices] = links.ravel()
        return refit_others(data.regression, theta, data.model)


def _estimated(given: tuple[Estimator, Task]) -> Result:
    estimator, task = given
    fresh = replace(task)  # without what an earlier method has left in its cache
    begin = time.perf_counter()
    fit = estimator.fit(fresh)
    seconds = time.perf_counter() - begin
    theta, certificate = certify(task, fit)
    return Result(theta, certificate, seconds, fit.details)


def refit_others(rows: Regression, theta: Array, model: Model) -> Array:
    """theta with all but the links' parameters fitted to rows by least squares, joint by joint."""
    out = theta.copy()
    for factor in rows.per_joint:
        y, tau = factor.triangle[:, :-1], factor.triangle[:, -1]
        free = ~np.isin(factor.indices, model.rigid_indices)
        if free.any():
            rest = tau - y[:, ~free] @ theta[factor.indices[~free]]
            out[factor.indices[free]] = np.linalg.lstsq(y[:, free], rest, rcond=None)[0]
    return out


def torque_errors(rows: Regression, theta: Array) -> tuple[Array, float]:
    """Mean squared torque error (n,) of each joint, and 100 |tau - tau_hat| / |tau| over all [%]."""
    losses = rows.joint_losses(theta)
    relative = 100.0 * np.sqrt(losses.sum() / rows.least_squares().tau_squared)
    return losses / rows.joint_rows(), float(relative)


def sentence(study: Study) -> str:
    """What is simulated and what is measured: opens every caption."""
    x = study.experiment
    friction = "without friction" if x.friction is None else "with sigmoid friction"
    truth = {"panda": "the published p_hat (errata corrected)", "two_link": "the published p_real"}.get(
        study.problem.name, "the problem's nominal links"
    )
    simulated = (
        f"Columns or rows named simulated: one {x.trajectory.duration:g} s exciting trajectory "
        f"simulated with {truth} as truth, {friction}, with torque noise and quantisation "
        f"(seed {study.seed})."
    )
    if study.run is None:
        return (
            f"{simulated} Nothing is measured: no real run of {study.problem.name} is at hand (a folder "
            "named by SDP_VS_PENALTY_DATA)."
        )
    return f"{simulated} Named measured: the authors' real run ({len(study.run.t)} samples)."
