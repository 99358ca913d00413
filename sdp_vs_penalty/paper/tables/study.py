"""What several tables share: the data of a problem and every method's estimate,
computed once."""

import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, TypeVar, cast

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import require_known
from sdp_vs_penalty.estimation.build_problem import PoseOptions
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
from sdp_vs_penalty.estimators.penalty_paper import (
    PAPER_BUDGET,
    PenaltyPaper,
    PenaltyPaperTwoStep,
)
from sdp_vs_penalty.paper.estimates import (
    Remembered,
    Result,
    estimate_once,
    fit_seconds,
)
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
from sdp_vs_penalty.regression.regression import LeastSquares, Regression, compress
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.simulation.experiments import Experiment, experiment
from sdp_vs_penalty.solvers.objective import Objective

Made = TypeVar("Made")


@dataclass(frozen=True)
class Effort:
    """What a budget stands for.

    replicates : noisy runs behind Table I's coverage; iterations : of Table II's
    search; duration : of Table V's sinusoids [s]; instants, retrievals : of the
    wrenches, and relaxed retrievals of them; evaluations, annealing_runs : loss
    evaluations of a run of the paper's method, and its runs; fold_evaluations,
    two_step_fold_evaluations : of the one run on each fold, in one step and in two;
    global_evaluations, global_runs : evaluations at each weight of the table of global
    optima, and its runs.
    """

    replicates: int
    iterations: int
    duration: float
    instants: int
    retrievals: int
    evaluations: int
    annealing_runs: int
    fold_evaluations: int
    two_step_fold_evaluations: int
    global_evaluations: int
    global_runs: int


QUICK = Effort(
    replicates=4,
    iterations=25,
    duration=10.0,
    instants=81,
    retrievals=10,
    evaluations=PenaltyPaper.evaluations // 3,
    annealing_runs=1,
    fold_evaluations=PenaltyPaper.evaluations // 3,
    two_step_fold_evaluations=PenaltyPaper.evaluations // 3,
    global_evaluations=600,
    global_runs=3,
)
#: As quick, but annealing once as long as the authors' program allows.
SINGLE = replace(
    QUICK,
    evaluations=PAPER_BUDGET,
    fold_evaluations=PenaltyPaper.evaluations,
    two_step_fold_evaluations=PAPER_BUDGET,
    global_evaluations=PAPER_BUDGET // len(PenaltyPaper.weights),
    global_runs=1,
)
PAPER = Effort(
    replicates=40,
    iterations=150,
    duration=30.0,
    instants=201,
    retrievals=50,
    evaluations=PAPER_BUDGET,
    annealing_runs=PenaltyPaper.runs,
    fold_evaluations=PAPER_BUDGET,
    two_step_fold_evaluations=PAPER_BUDGET,
    global_evaluations=PAPER_BUDGET // len(PenaltyPaper.weights),
    global_runs=PenaltyPaper.runs,
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


@dataclass(frozen=True, eq=False)
class Data:
    """One data set, compressed: what estimates are made from, and what they are judged
    on.

    label : how columns and rows are named, "simulated" or "measured"; test is None
    where estimates are judged on no other rows. is_repeated : whether the test motion is
    the training motion again, so that errors on it are repeatability.
    """

    label: str
    train: Measurements
    test: Measurements | None
    model: Model
    preprocessing: Preprocessing
    is_repeated: bool = False

    @property
    def judged_on(self) -> str:
        """What kind of motion the test rows have."""
        return "repeated motion" if self.is_repeated else "unseen motion"

    @cached_property
    def regression(self) -> Regression:
        """Compressed training rows."""
        return compress(FilteredRuns.of(self.train, self.preprocessing), self.model)

    @cached_property
    def test_regression(self) -> Regression:
        """Compressed test rows."""
        assert self.test is not None
        return compress(
            FilteredRuns.of(self.test, self.preprocessing),
            self.model,
            blocks_per_run=1,
        )

    def errors(self, theta: Array) -> tuple[Array, float]:
        """Torque error on the test rows.

        Parameters
        ----------
        theta : (p,) array
            Parameters of the model.

        Returns
        -------
        tuple of ((n,) array, float)
            Mean squared error of each joint [(N m)^2], and relative error
            over all joints [%].
        """
        return torque_errors(self.test_regression, theta)


@dataclass(frozen=True, eq=False)
class Frozen(Estimator):
    """Given links (n, 10); all other parameters are ``others``, NaN: fitted to the
    torque."""

    name = "given links"
    description = "links as they are given, all other parameters by least squares"
    links: Array
    others: Array | float = np.nan

    def fit(self, task: Task) -> Fit:
        """The given links, with all other parameters fitted.

        Parameters
        ----------
        task : Task
            The data.

        Returns
        -------
        Fit
            Without multipliers.
        """
        theta = np.empty(len(task.bound))
        links = task.model.rigid_indices
        theta[links] = self.links.ravel()
        theta[np.delete(np.arange(len(theta)), links)] = self.others
        return Fit(
            refitted(task.data, theta),
            Objective(task.data),
            task.constraints,
        )


def refitted(data: LeastSquares, links_given: Array) -> Array:
    """Parameters of least squares where none are given.

    Parameters
    ----------
    data : LeastSquares
        The rows.
    links_given : (p,) array
        Parameters; NaN where they are to be fitted.

    Returns
    -------
    (p,) array
        Without NaN.
    """
    free = np.isnan(links_given)
    theta = np.nan_to_num(links_given)
    theta[free] = np.linalg.lstsq(
        data.R[:, free],
        data.rho - data.R @ theta,
        rcond=None,
    )[0]
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
        require_known("budget", budget, BUDGETS)
        self.problem = problem
        self.budget = budget
        self.progress = progress
        self.workers = workers
        self.effort = BUDGETS[budget]
        self._made: dict[object, Any] = {}

    def once(self, make: Callable[..., Made], *of: Any) -> Made:
        """The result of a function of this study, computed on the first call only.

        Parameters
        ----------
        make : callable
            Takes this study and the further arguments.
        *of : Any
            Further arguments, which can be hashed.

        Returns
        -------
        Any
            What ``make`` returned the first time.
        """
        if (key := (make, *of)) not in self._made:
            self._made[key] = make(self, *of)
        return cast(Made, self._made[key])

    @cached_property
    def experiment(self) -> Experiment:
        """The simulated experiment of the problem."""
        return experiment(self.problem)

    @cached_property
    def simulated(self) -> Data:
        """Trained on one exciting trajectory, judged on the validation trajectories."""
        self.progress("simulating")
        x = self.experiment
        train = x.training_run(self.seed)
        test = concatenate(x.validation_runs(self.seed))
        return self._data("simulated", train, test, x.effects)

    @cached_property
    def run(self) -> Measurements | None:
        """The real run of a robot of the paper where it is at hand."""
        runs = measured_runs(self.problem.name) if self.problem.published else {}
        return next(iter(runs.values()), None)

    @cached_property
    def measured(self) -> Data | None:
        """The whole real run, as the paper used it."""
        return None if self.run is None else self._data("measured", self.run, None)

    @cached_property
    def repeated(self) -> Data | None:
        """The real run before CUT, judged on its repetition after it."""
        if self.run is None:
            return None
        return replace(self._data("measured", *halves(self.run)), is_repeated=True)

    def unseen(
        self,
        method: str | Estimator,
        effects: Sequence[str | Effect] | None = None,
        n_folds: int = FOLDS,
    ) -> CrossValidation:
        """Errors on motion of the real run that no estimate was made from.

        Parameters
        ----------
        method : str or Estimator
            What is judged.
        effects : sequence of str or Effect, optional
            Of the model; default: the problem's.
        n_folds : int
            Into how many stretches the motion is cut.

        Returns
        -------
        CrossValidation
            Errors of every fold.
        """
        named = None if effects is None else tuple(effects)
        return self.once(_unseen, method, named, n_folds)

    def _data(
        self,
        label: str,
        train: Measurements,
        test: Measurements | None,
        effects: Any = None,
    ) -> Data:
        model = self.problem.model(effects)
        settings = self.problem.preprocessing.resolve(train)
        return Data(label, train, test, model, settings)

    @property
    def whole(self) -> list[Data]:
        """What Tables III, VII, VIII and IX are identified from."""
        return [data for data in (self.simulated, self.measured) if data is not None]

    @property
    def judged(self) -> list[Data]:
        """Where one estimate is judged by other rows than its own; the real one's are
        its repetition."""
        return [data for data in (self.simulated, self.repeated) if data is not None]

    def task(self, data: Data) -> Task:
        """What an estimator is given.

        Parameters
        ----------
        data : Data
            Which data set.

        Returns
        -------
        Task
            Of its training part.
        """
        return self.once(_task, data)

    def result(self, method: str, data: Data) -> Result:
        """A method's estimate from the training part of a data set.

        Parameters
        ----------
        method : str
            Its name.
        data : Data
            Which data set.

        Returns
        -------
        Result
            Certified.
        """
        return self.estimated(method, data)

    def seconds(self, method: str | Estimator, data: Data) -> float:
        """Processor time of a method's fit to the training part of a data set.

        Parameters
        ----------
        method : str or Estimator
            Which.
        data : Data
            Which data set.

        Returns
        -------
        float
            [s].
        """
        return fit_seconds(self.estimator(method), self.task(data))

    def estimated(self, method: str | Estimator, data: Data) -> Result:
        """A method's estimate; the method may have no name, such as given links.

        Parameters
        ----------
        method : str or Estimator
            Which.
        data : Data
            Which data set.

        Returns
        -------
        Result
            Certified.
        """
        self.estimate([method], [data])
        return cast(Result, self._made[method, data])

    def estimate(
        self,
        methods: Iterable[str | Estimator],
        sets: Sequence[Data],
    ) -> None:
        """Compute every method's estimate from each data set, by the workers.

        Parameters
        ----------
        methods : iterable of str or Estimator
            Which.
        sets : sequence of Data
            From which data sets.

        Returns
        -------
        None
            The study holds the estimates then.
        """
        new = [(m, d) for m in methods for d in sets if (m, d) not in self._made]
        for method, data in new:
            name = method if isinstance(method, str) else method.name
            self.progress(f"{name} on {data.label} data")
        workers = replace(self.workers, progress=self.progress)
        results = workers.map(
            _estimated, [(self.estimator(m), self.task(d)) for m, d in new]
        )
        self._made.update(zip(new, results, strict=True))

    @property
    def compared_columns(self) -> list[str]:
        """Columns of the tables as printed: both routes, on measured data first."""
        return [
            f"{method}_{data.label}"
            for data in reversed(self.whole)
            for method in ("penalty", "lmi_sdp")
        ]

    @property
    def about_priors(self) -> str:
        """A note on what the names of columns and rows say of the prior."""
        sentence = (
            "joint_prior: lmi-sdp-plain and penalty with the pull of friction and"
            " offsets to zero that lmi-sdp has, and nothing else of it; optimisers"
            " compare among methods with it, or without."
        )
        return sentence if set(WITH_PRIOR) & set(self.methods.values()) else ""

    @cached_property
    def sentence(self) -> str:
        """What is simulated and what is measured: opens every caption."""
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
        """METHODS, those with another prior only where joints have parameters of their
        own."""
        own_methods = [
            len(data.model.parameters) > len(data.model.rigid_indices)
            for data in self.whole
        ]
        return {
            k: m for k, m in METHODS.items() if any(own_methods) or m not in WITH_PRIOR
        }

    def theta(self, method: str | Estimator, data: Data) -> Array:
        """A method's estimate as an array.

        Parameters
        ----------
        method : str or Estimator
            Which.
        data : Data
            Which data set.

        Returns
        -------
        (p,) array
            Parameters of the model.
        """
        if isinstance(method, str):
            return self.result(method, data).theta
        return method.fit(self.task(data)).theta

    def links(self, method: str, data: Data) -> Array:
        """Links of a method's estimate.

        Parameters
        ----------
        method : str
            Its name.
        data : Data
            Which data set.

        Returns
        -------
        (n, 10) array
            Standard parameters [kg, kg m, kg m^2].
        """
        return self.theta(method, data)[self.task(data).links]

    def estimator(self, method: str | Estimator) -> Estimator:
        """The estimator of a name.

        Parameters
        ----------
        method : str or Estimator
            "penalty", or "penalty, joint prior".

        Returns
        -------
        Estimator
            With the settings of this budget.
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

    def fold_estimator(self, estimator: Estimator) -> Estimator:
        """The estimator with the settings with which folds are judged.

        Parameters
        ----------
        estimator : Estimator
            With the settings for the whole run.

        Returns
        -------
        Estimator
            Of annealing with one run.
        """
        if isinstance(estimator, PenaltyPaper):
            evaluations = self.effort.fold_evaluations
            if isinstance(estimator, PenaltyPaperTwoStep):
                evaluations = self.effort.two_step_fold_evaluations
            return replace(estimator, runs=1, evaluations=evaluations)
        return estimator

    @cached_property
    def base(self) -> Array:
        """(b, 10 n) map from the links' standard parameters to the base parameters."""
        return base_parameters(
            self.problem.model("rigid_body"), self.problem.independent
        )[0]

    @property
    def published_links(self) -> dict[str, Array]:
        """(n, 10) links that are published of this robot, by column."""
        tables = box_tables(self.problem)
        held = self.problem.published[tables[0]][0] if tables else {}
        return {
            c: published_links(self.problem, c)
            for c in ("p_real", "p_hat", "delta")
            if c in held
        }

    @cached_property
    def black_box(self) -> tuple[BlackBox, bool]:
        """The true links' answers, and whether at the authors' configurations."""
        robot = self.problem.robot
        file = real_file(self.problem.name, "good_configurations_1010.txt")
        # Where the authors' file is absent as many as theirs.
        q = (
            robot.random_configurations(1010, self.seed)
            if file is None
            else np.loadtxt(file, ndmin=2)
        )
        return BlackBox.of_links(robot, self.experiment.links, q), file is not None

    @cached_property
    def reverse_engineered(self) -> Result:
        """Base parameters from the black box; details hold condition number and
        relative error."""
        box, _ = self.black_box
        begin = time.process_time()
        options = PoseOptions(seed=self.seed)
        estimate = estimate_parameters(
            self.problem,
            box,
            "reverse-engineering",
            options,
        )
        seconds = time.process_time() - begin
        return Result(estimate.theta, estimate.certificate, seconds, estimate.details)


def _task(study: Study, data: Data) -> Task:
    study.progress(f"compressing the {data.label} run")
    return make_task(
        study.problem,
        data.model,
        data.regression,
        seed=study.seed,
    )


def _unseen(
    study: Study,
    method: str | Estimator,
    effects: tuple[Any, ...] | None,
    n_folds: int,
) -> CrossValidation:
    estimator = study.estimator(method)
    study.progress(f"folds by phase, {estimator.name}")
    split, folds = study.once(_folds, effects, n_folds)
    once = Remembered(study.fold_estimator(estimator))
    folds_judged = study.workers.map(partial(judged, estimator=once), folds)
    return split.result(estimator, folds_judged)


def _folds(
    study: Study,
    effects: tuple[Any, ...] | None,
    n_folds: int,
) -> tuple[Split, list[FoldData]]:
    """The real run's folds, shape constants included; no method changes them."""
    assert study.run is not None
    options = PoseOptions(effects, seed=study.seed)
    split = Split(study.problem, study.run, options, n_folds)
    return split, study.workers.map(split.fold, split.numbers)


def _estimated(estimator_and_task: tuple[Estimator, Task]) -> Result:
    return estimate_once(*estimator_and_task)


def halves(run: Measurements) -> tuple[Measurements, Measurements]:
    """The real run's motion, and its repetition.

    Parameters
    ----------
    run : Measurements
        The real run.

    Returns
    -------
    tuple of (Measurements, Measurements)
        Before CUT, and after it.
    """
    return run.window(0.0, CUT[0]), run.window(CUT[1], np.inf)


def torque_errors(rows: Regression, theta: Array) -> tuple[Array, float]:
    """Torque error of an estimate.

    Parameters
    ----------
    rows : Regression
        Filtered rows.
    theta : (p,) array
        Parameters of the model.

    Returns
    -------
    tuple of ((n,) array, float)
        Mean squared error of each joint [(N m)^2], and 100 |tau - tau_hat| /
        |tau| over all [%].
    """
    losses = rows.joint_losses(theta)
    relative = 100.0 * np.sqrt(losses.sum() / rows.least_squares().tau_squared)
    return losses / rows.joint_rows(), float(relative)
