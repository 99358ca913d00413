"""What several tables share: the data of a problem and every method's estimate,
computed once."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Self, TypeVar, cast

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import require_known
from sdp_vs_penalty.estimation.build_problem import PoseOptions
from sdp_vs_penalty.estimation.constants import ROUNDING
from sdp_vs_penalty.estimation.identify import estimate_parameters
from sdp_vs_penalty.estimation.resampling import (
    CrossValidation,
    FoldData,
    Split,
    judged,
)
from sdp_vs_penalty.estimators import estimator_types
from sdp_vs_penalty.estimators.estimator import (
    Estimator,
    Fit,
    Progress,
    Task,
    make_task,
    no_progress,
)
from sdp_vs_penalty.estimators.penalty_paper import PenaltyPaper
from sdp_vs_penalty.paper.memo import Remembered, Result, estimate_once, fit_seconds
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.plugins import by_word
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.problem.published import (
    box_tables,
    measured_runs,
    published_links,
    real_file,
)
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.regression.black_box import BlackBox
from sdp_vs_penalty.regression.evidence import relative_error
from sdp_vs_penalty.regression.regression import (
    LeastSquares,
    Regression,
    compress,
    compress_cells,
)
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import ConstraintSet
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.simulation.experiments import Experiment, experiment

Made = TypeVar("Made")


@dataclass(frozen=True)
class Effort:
    """What a budget stands for."""

    #: Noisy runs behind Table I's coverage.
    replicates: int
    #: Iterations of Table II's search.
    iterations: int
    #: Length of Table V's sinusoids [s].
    duration: float
    #: Instants of the wrenches.
    instants: int
    #: Relaxed retrievals of the wrenches.
    retrievals: int
    #: Loss evaluations of a run of the paper's method; None: as many as the authors'
    #: program allows.
    evaluations: int | None
    #: Runs of the paper's method, of which each fold gets one.
    annealing_runs: int


QUICK = Effort(
    replicates=4,
    iterations=25,
    duration=10.0,
    instants=81,
    retrievals=10,
    evaluations=1_000,
    annealing_runs=1,
)
#: As quick, but annealing once as long as the authors' program allows.
SINGLE = replace(QUICK, evaluations=None)
PAPER = Effort(
    replicates=40,
    iterations=150,
    duration=30.0,
    instants=201,
    retrievals=50,
    evaluations=None,
    annealing_runs=PenaltyPaper.runs,
)
BUDGETS = {"quick": QUICK, "single": SINGLE, "paper": PAPER}
_PLACED = by_word(
    (
        (kind.table_place, kind)
        for kind in estimator_types().values()
        if kind.table_place
    ),
    "table_place",
)
#: Methods with the pull of friction and offsets to zero that `lmi-sdp` has, and nothing
#: else of it.
WITH_PRIOR = ("lmi-sdp-plain, joint prior", "penalty, joint prior")
#: The columns of Tables III, VII, VIII, IX and the rows of IV: our name and the
#: method's.
METHODS: Mapping[str, str] = {
    re.sub(r"\W+", "_", name): name
    for name in (*(k.name for k in _PLACED.values()), *WITH_PRIOR)
}
#: Where the real run is cut for repeatability [s]: what comes after is its beginning
#: again.
CUT = 14.0, 14.2
#: Folds by phase in which it is judged on motion that an estimate has not seen.
FOLDS = 5


@dataclass(frozen=True)
class FoldSettings:
    """How the real run is cut to judge a method on motion that it has not seen."""

    #: Effects of the model; None: the problem's.
    effects: tuple[str | Effect, ...] | None = None
    #: Stretches into which the motion is cut.
    folds: int = FOLDS
    #: What training keeps off the stretch left out [s]; None: the filters' reach.
    guard: float | None = None
    #: Weights of the joints, as `identify` takes them.
    weighting: str = "noise"


USUAL_FOLDS = FoldSettings()


@dataclass(frozen=True, eq=False)
class Data:
    """One data set, compressed: what estimates are made from, and what they are judged
    on."""

    #: Name of the data in columns and rows: "simulated" or "measured".
    label: str
    #: Runs that estimates are made from.
    train: Measurements
    #: Makes the runs that estimates are judged on; None where there are none.
    make_test: Callable[[], Measurements] | None
    #: Model that is identified.
    model: Model
    #: The filters.
    preprocessing: Preprocessing
    #: Whether the test motion is the training motion again, so that errors on it are
    #: repeatability.
    is_repeated: bool = False
    #: Processes that compress the test runs.
    workers: Workers = ALONE

    @property
    def judged_on(self) -> str:
        """What kind of motion the test rows hold, in words."""
        return "repeated motion" if self.is_repeated else "unseen motion"

    @cached_property
    def test(self) -> Measurements | None:
        """The runs that estimates are judged on, made when they are asked for."""
        return None if self.make_test is None else self.make_test()

    @cached_property
    def regression(self) -> Regression:
        """The training rows behind the filters, compressed by QR to as many as
        parameters.
        """
        return compress(
            FilteredRuns.filtering(self.train, self.preprocessing), self.model
        )

    @cached_property
    def test_regression(self) -> Regression:
        """The test rows behind the filters, compressed to one block for each run."""
        assert self.test is not None
        return compress(
            FilteredRuns.filtering(self.test, self.preprocessing),
            self.model,
            blocks_per_run=1,
            workers=self.workers,
        )

    def errors(self, theta: Array) -> tuple[Array, float]:
        """Return the torque error of an estimate on the test rows.

        Returns
        -------
        tuple of ((n,) array, float)
            Mean squared error of each joint [(N m)^2], and relative error over all
            joints [%].
        """
        return torque_errors(self.test_regression, theta)


@dataclass(frozen=True, eq=False)
class Frozen(Estimator):
    """Links that are given; other parameters may be fitted to the torque."""

    name = "given links"
    description = "links as they are given, all other parameters by least squares"
    #: (n, 10) standard parameters of the links.
    links: Array
    #: All other parameters; NaN: fitted to the torque.
    others: Array | float = np.nan

    def fit(self, task: Task) -> Fit:
        """Return a fit with this estimator's links; of the other parameters, those that
        are NaN are fitted to the torque by least squares."""
        theta = np.empty(len(task.bound))
        links = task.model.rigid_indices
        theta[links] = self.links.ravel()
        theta[np.delete(np.arange(len(theta)), links)] = self.others
        return Fit(refitted(task.data, theta), task.problem)


def refitted(data: LeastSquares, parameters: Array) -> Array:
    """Return the parameters (p,) with those that are NaN fitted by least squares, all
    others fixed."""
    is_free = np.isnan(parameters)
    theta = np.nan_to_num(parameters)
    residual = data.rho - data.R @ theta
    theta[is_free] = np.linalg.lstsq(data.R[:, is_free], residual, rcond=None)[0]
    return theta


class Study:
    """The data and estimates behind the tables of one problem; everything is computed
    on first use.

    workers : who estimates where several estimates are needed at once. Raises
    InputError for a budget that does not exist.
    """

    seed = 0  # of everything random

    def __init__(
        self,
        problem: Problem,
        budget: str = "quick",
        progress: Progress = no_progress,
        workers: Workers = ALONE,
    ) -> None:
        """Prepare a study; nothing is computed yet.

        Parameters
        ----------
        budget : str
            "quick", "single" or "paper": how long searches last.
        progress : callable
            Called with a short text at each step.
        workers : Workers
            Processes for estimates that are needed at the same time.
        """
        require_known("budget", budget, BUDGETS)
        self.problem = problem
        self.budget = budget
        self.progress = progress
        self.workers = workers
        self.effort = BUDGETS[budget]
        self._made: dict[object, Any] = {}

    def once(self, make: Callable[..., Made], *of: Any) -> Made:
        """Call a function of this study, and cache its result for later calls.

        Parameters
        ----------
        make : callable
            Takes this study and the further arguments.
        *of : Any
            Further arguments, which must be hashable.

        Returns
        -------
        Any
            What ``make`` returned the first time.
        """
        key = (make, *of)
        if key not in self._made:
            self._made[key] = make(self, *of)
        return cast(Made, self._made[key])

    @cached_property
    def experiment(self) -> Experiment:
        """The simulated experiment of the problem: true links, trajectory and
        sensor.
        """
        return experiment(self.problem)

    @cached_property
    def simulated(self) -> Data:
        """Simulated data: trained on one exciting trajectory, judged on random ones."""
        self.progress("simulating")
        x = self.experiment
        train = x.training_run(self.seed)
        test = lambda: concatenate(x.validation_runs(self.seed, self.workers))  # noqa: E731
        return self._data("simulated", train, test, x.effects)

    @cached_property
    def run(self) -> Measurements | None:
        """The authors' real run of this robot; None if the file is absent."""
        runs = measured_runs(self.problem.name) if self.problem.published else {}
        return next(iter(runs.values()), None)

    @cached_property
    def measured(self) -> Data | None:
        """The full real run as training data, as in the paper; None if the file is
        absent.
        """
        return None if self.run is None else self._data("measured", self.run, None)

    @cached_property
    def repeated(self) -> Data | None:
        """The real run up to CUT as training data; after it the motion repeats, as
        test data.
        """
        if self.run is None:
            return None
        train, test = halves(self.run)
        data = self._data("measured", train, lambda: test)
        return replace(data, is_repeated=True)

    def unseen(
        self, method: str | Estimator, settings: FoldSettings = USUAL_FOLDS
    ) -> CrossValidation:
        """Cross-validate a method on the real run, with folds by the phase of its
        motion.

        Each fold holds out a stretch of the motion with all its repetitions. Simulated
        annealing takes a single run on each.
        """
        return self.once(_unseen, method, settings)

    def folds(
        self, settings: FoldSettings = USUAL_FOLDS
    ) -> tuple[Split, list[FoldData]]:
        """Return the training and test rows of each fold of the real run, compressed.

        They include fitted constants of effects, and are the same for all methods.
        """
        return self.once(_folds, settings)

    def sibling(self, problem: Problem) -> Self:
        """Return the study of another problem with the same budget and workers."""
        return type(self)(problem, self.budget, self.progress, self.workers)

    def _data(
        self,
        label: str,
        train: Measurements,
        make_test: Callable[[], Measurements] | None,
        effects: Any = None,
    ) -> Data:
        """Bundle runs, model and filter settings as a data set.

        ``make_test`` makes the runs to judge on, None for a data set that is only
        trained on; ``effects`` are those of the model, None for the problem's own. The
        filters are chosen for the training run.
        """
        model = self.problem.model(effects)
        settings = self.problem.preprocessing.resolve(train)
        return Data(label, train, make_test, model, settings, workers=self.workers)

    @property
    def whole(self) -> list[Data]:
        """The data sets of Tables III, VII, VIII and IX: the full simulated and the
        full real run.
        """
        return [data for data in (self.simulated, self.measured) if data is not None]

    @property
    def judged(self) -> list[Data]:
        """The data sets with test rows: the simulated one, and the real run with its
        repetition.
        """
        return [data for data in (self.simulated, self.repeated) if data is not None]

    def task(self, data: Data) -> Task:
        """Return the estimation task of a data set's training rows; it is cached.

        Returns
        -------
        Task
            Compressed rows, constraints and bounds.
        """
        return self.once(_task, data)

    def seconds(self, method: str | Estimator, data: Data) -> float:
        """Return the processor time [s] of a method's fit to the training rows of a
        data set."""
        return fit_seconds(self.estimator(method), self.task(data))

    def estimated(self, method: str | Estimator, data: Data) -> Result:
        """Return a method's certified estimate; it is computed once.

        Parameters
        ----------
        method : str or Estimator
            The method; one without a name, such as given links, is passed itself.
        """
        self.estimate([method], [data])
        return cast(Result, self._made[method, data])

    def estimate(
        self, methods: Iterable[str | Estimator], sets: Sequence[Data]
    ) -> None:
        """Compute the estimate of every method from every data set, in parallel.

        The study caches them; those that exist already are left out.
        """
        new = [(m, d) for m in methods for d in sets if (m, d) not in self._made]
        items = [(self.estimator(m), self.task(d)) for m, d in new]
        workers = replace(self.workers, progress=self.progress)
        self._made.update(zip(new, workers.map(_estimated, items), strict=True))

    @property
    def compared_columns(self) -> list[str]:
        """Columns of the tables as printed: penalty and SDP, on measured data first."""
        return [
            f"{method}_{data.label}"
            for data in reversed(self.whole)
            for method in ("penalty", "lmi_sdp")
        ]

    @property
    def about_priors(self) -> str:
        """A note that explains the columns with a joint prior; "" if there are none."""
        sentence = (
            "joint_prior: lmi-sdp-plain and penalty with the pull of friction and"
            " offsets to zero that lmi-sdp has, and nothing else of it; optimisers"
            " compare among methods with it, or without."
        )
        return sentence if set(WITH_PRIOR) & set(self.methods.values()) else ""

    @cached_property
    def sentence(self) -> str:
        """The sentence that opens every caption: which figures are simulated, with
        which truth, and which are measured."""
        x = self.experiment
        friction = "without friction" if x.friction is None else "with sigmoid friction"
        known = {
            "panda": "the published p_hat (errata corrected)",
            "two_link": "the published p_real",
        }
        truth = known.get(self.problem.name, "the problem's nominal links")
        simulated = (
            f"Columns or rows named simulated: one {x.trajectory.duration:g} s exciting"
            f" trajectory simulated with {truth} as truth, {friction}, with torque"
            f" noise and quantisation (seed {self.seed})."
        )
        if self.run is not None:
            return (
                f"{simulated} Named measured: the authors' real run ({len(self.run.t)}"
                " samples)."
            )
        none = (
            f"no real run of {self.problem.name} is at hand (a folder named by"
            " SDP_VS_PENALTY_DATA)."
        )
        return f"{simulated} Nothing is measured: {none}"

    @cached_property
    def methods(self) -> Mapping[str, str]:
        """The compared methods: name of the column, and name of the estimator.

        Those with a joint prior are left out if no joint has parameters such as
        friction.
        """
        effects_of_sets: list[Any] = [self.experiment.effects]
        if self.run is not None:
            effects_of_sets.append(None)
        models = [self.problem.model(effects) for effects in effects_of_sets]
        has_joint_parameters = any(
            len(model.parameters) > len(model.rigid_indices) for model in models
        )
        return {
            column: method
            for column, method in METHODS.items()
            if has_joint_parameters or method not in WITH_PRIOR
        }

    def theta(self, method: str | Estimator, data: Data) -> Array:
        """Return a method's estimate as an array (p,), a value for each of the model's
        parameters."""
        return self.estimated(method, data).theta

    def links(self, method: str, data: Data) -> Array:
        """Return the links of a method's estimate.

        Returns
        -------
        (n, 10) array
            Standard parameters [kg, kg m, kg m^2].
        """
        return self.theta(method, data)[self.task(data).links]

    def estimator(self, method: str | Estimator) -> Estimator:
        """Return the estimator of a name, with the settings of this study's budget.

        Parameters
        ----------
        method : str or Estimator
            A name such as "penalty", or "penalty, joint prior" for one with a prior on
            friction and offsets. An estimator is returned as it is.
        """
        if isinstance(method, Estimator):
            return method
        name, _, prior = method.partition(", ")
        kind: Any = estimator_types()[name]
        if prior:
            return cast(Estimator, kind(joint_prior=1.0))
        if issubclass(kind, PenaltyPaper):
            return kind(
                runs=self.effort.annealing_runs, evaluations=self.effort.evaluations
            )
        return cast(Estimator, kind())

    @cached_property
    def base(self) -> Array:
        """(b, 10 n) matrix from the links' standard parameters to the base
        parameters.
        """
        return base_parameters(
            self.problem.model("rigid_body"), self.problem.independent
        )[0]

    @property
    def published_links(self) -> dict[str, Array]:
        """(n, 10) links that the paper publishes for this robot, by the name of the
        column.
        """
        tables = box_tables(self.problem)
        first_row = self.problem.published[tables[0]][0] if tables else {}
        return {
            column: published_links(self.problem, column)
            for column in ("p_real", "p_hat", "delta")
            if column in first_row
        }

    @cached_property
    def black_box(self) -> tuple[BlackBox, bool]:
        """Torques of the true links in static and moving states, for reverse
        engineering.

        The flag tells whether the states are those of the authors' file; otherwise they
        are random, as many as in the file.
        """
        robot = self.problem.robot
        file = real_file(self.problem.name, "good_configurations_1010.txt")
        if file is None:
            q = robot.random_configurations(1010, self.seed)
        else:
            q = np.loadtxt(file, ndmin=2)
        return BlackBox.from_links(robot, self.experiment.links, q), file is not None

    @cached_property
    def reverse_engineered(self) -> Result:
        """The estimate by reverse engineering (Gaz et al.): torques of the true links
        at chosen static and moving states determine the base parameters by least
        squares.

        Its details hold the condition number and the relative error.
        """
        box, _ = self.black_box
        options = PoseOptions(seed=self.seed)
        estimate = estimate_parameters(
            self.problem, box, "reverse-engineering", options
        )
        return Result(estimate.theta, estimate.certificate, estimate.details)


def _task(study: Study, data: Data) -> Task:
    """Make the estimation task of a data set: compressed rows, constraints and
    bounds.
    """
    study.progress(f"compressing the {data.label} run")
    return make_task(study.problem, data.model, data.regression, seed=study.seed)


def _unseen(
    study: Study, method: str | Estimator, settings: FoldSettings
) -> CrossValidation:
    """Cross-validate a method, each fold in a process of its own; fits are kept."""
    estimator = study.estimator(method)
    if isinstance(estimator, PenaltyPaper):
        estimator = replace(estimator, runs=1)
    study.progress(f"folds by phase, {estimator.name}")
    split, folds = study.folds(settings)
    judge = partial(judged, estimator=Remembered(estimator))
    return split.result(estimator, study.workers.map(judge, folds))


def _folds(study: Study, settings: FoldSettings) -> tuple[Split, list[FoldData]]:
    """Cut the real run into folds, and compress them."""
    assert study.run is not None
    options = PoseOptions(
        settings.effects, weighting=settings.weighting, seed=study.seed
    )
    split = Split(study.problem, study.run, options, settings.folds)
    if settings.guard is not None:
        split.phases = replace(split.phases, guard=settings.guard)
        columns = split.model.reference_free
        split.common = compress_cells(split.runs, columns, split.phases)
    return split, study.workers.map(split.fold, split.numbers)


def _estimated(estimator_and_task: tuple[Estimator, Task]) -> Result:
    """Estimate and certify in a worker process, which takes a single argument."""
    return estimate_once(*estimator_and_task)


def halves(run: Measurements) -> tuple[Measurements, Measurements]:
    """Split the real run into its motion and the repetition of that motion.

    Returns
    -------
    tuple of (Measurements, Measurements)
        Before CUT, and after it.
    """
    return run.window(0.0, CUT[0]), run.window(CUT[1], np.inf)


def torque_errors(rows: Regression, theta: Array) -> tuple[Array, float]:
    """Return the torque error of an estimate on compressed rows.

    Returns
    -------
    tuple of ((n,) array, float)
        Mean squared error of each joint [(N m)^2], and 100 |tau - tau_hat| / |tau| over
        all joints [%].
    """
    losses = rows.joint_losses(theta)
    relative = relative_error(losses.sum(), rows.least_squares().tau_squared)
    return losses / rows.joint_rows(), float(relative)


def worst_violations(task: Task, theta: Array) -> tuple[float, float]:
    """Return the largest violation of the constraints on links, and of all others.

    They are separate because friction may be fitted beside published links.

    Returns
    -------
    tuple of float
        Of the links (masses, centres of mass, inertias), and of friction and offsets,
        each in the constraint's unit; 0 below rounding.
    """
    links = task.model.rigid_indices
    convex, nonconvex = task.constraints.convex, task.constraints.nonconvex
    on_links = [c for c in convex if np.isin(c.indices, links).all()]
    on_others = [c for c in convex if not np.isin(c.indices, links).all()]
    sets = ConstraintSet(tuple(on_links), nonconvex), ConstraintSet(tuple(on_others))
    worst = [max(part.worst(theta).values(), default=0.0) for part in sets]
    of_links, of_others = (x if x >= ROUNDING else 0.0 for x in worst)
    return of_links, of_others
