"""How well a method's models predict motion that they have not seen, and how far they
would move.

In :func:`cross_validate` each fold leaves out one stretch of every motion's clock
(:mod:`~sdp_vs_penalty.signals.phases`), all its repetitions and a guard of the filters'
reach around it, identifies from the rest, shape constants included, as ``identify``
does, and is judged on what it left out. Every row is judged once.

:func:`bootstrap` is the block bootstrap of the certified estimate: how far parameters that are held by
physics and priors move when other stretches of the same motion had been measured.

Intervals of :mod:`uncertainty` are of least squares, cut where constraints begin. Here
blocks of time are drawn anew (Kuensch, Annals of Statistics 1989) and each draw is
solved and certified as the estimate itself is. In the coordinates in which all rows
together have the identity for their products, G_b are those of block b, and a draw that
holds it w_b times has the factor chol(sum_b w_b G_b) R: no row is looked at again, and
no digit is lost, since the sum of all G_b is at most one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.plausibility import check_plausible
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import (
    PoseOptions,
    build_problem,
    with_reference,
)
from sdp_vs_penalty.estimation.shapes import estimate_shapes, with_shapes
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.estimator import (
    Estimator,
    Progress,
    Task,
    make_task,
    no_progress,
)
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp, PosedSdp
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.linalg import column_space
from sdp_vs_penalty.regression.regression import (
    LeastSquares,
    Regression,
    compress_cells,
)
from sdp_vs_penalty.results.record import Shown, Summary
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.phases import phase_folds
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.solvers.objective import Objective
from sdp_vs_penalty.solvers.rigorous_bounds import TIGHT

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class Fold:
    """One fold: identified from all but a stretch, judged on it.

    start, stop [s] : the stretch, on the clock of the first motion; theta (p,); losses,
    rows (n,) : sums of squared torque errors of each joint on it, and how many;
    torque_squared (n,) : the same of torque.
    """

    start: float
    stop: float
    theta: Array
    losses: Array
    rows: NDArray[np.int64]
    torque_squared: Array

    @property
    def rmse(self) -> Array:
        """(n,) [N m or N] of each joint."""
        return np.asarray(np.sqrt(self.losses / np.maximum(self.rows, 1)))

    @property
    def relative_error_percent(self) -> float:
        """100 |tau - tau_hat| / |tau| over all joints."""
        return float(100.0 * np.sqrt(self.losses.sum() / self.torque_squared.sum()))


@dataclass(frozen=True, repr=False)
class CrossValidation(Shown):
    """Errors of a method on motion that its models have not seen, fold by fold.

    folds : those with rows to judge; periodic : whether a motion repeats; guard [s] :
    what training keeps off the judged stretch; band_hz : below which all errors are
    meant.
    """

    problem: str
    method: str
    effects: tuple[str, ...]
    folds: tuple[Fold, ...]
    periodic: bool
    guard: float
    band_hz: float

    @property
    def _whole(self) -> Fold:
        """All folds as one."""
        sums = np.sum(
            [
                [
                    f.losses,
                    f.rows,
                    f.torque_squared,
                ]
                for f in self.folds
            ],
            axis=0,
        )
        return Fold(
            self.folds[0].start,
            self.folds[-1].stop,
            self.folds[0].theta,
            *sums,
        )

    @property
    def rmse(self) -> Array:
        """(n,) [N m or N] of each joint over all folds."""
        return self._whole.rmse

    @property
    def relative_error_percent(self) -> float:
        """100 |tau - tau_hat| / |tau| over all folds and joints."""
        return self._whole.relative_error_percent

    @property
    def worst(self) -> int:
        """Number of the fold with the largest relative error, from 1."""
        return 1 + int(np.argmax([f.relative_error_percent for f in self.folds]))

    @property
    def verdict(self) -> str:
        """The errors in one sentence."""
        worst = self.folds[self.worst - 1]
        return (
            f"{self.method} predicts unseen motion to {self.relative_error_percent:.3g}"
            f" % (relative error); worst fold {self.worst}:"
            f" {worst.relative_error_percent:.3g} %."
        )

    @property
    def how(self) -> str:
        """How the runs were split, in one sentence."""
        kind = (
            "phase blocks: a motion's repetitions share a fold"
            if self.periodic
            else "blocks of time"
        )
        guard_words = f"training keeps {self.guard:.3g} s off the judged fold."
        return f"{len(self.folds)} folds by {kind}; {guard_words}"

    def _summary(self) -> Summary:
        return f"CrossValidation: {self.verdict}", [
            ("RMSE", ", ".join(f"{x:.3g}" for x in self.rmse)),
            ("split", self.how),
            ("band", f"below {self.band_hz:.3g} Hz"),
        ]

    def _table(self) -> Table:
        rows = [
            (str(k), f"{f.start:.3g}-{f.stop:.3g}", f"{f.relative_error_percent:.3g}")
            for k, f in enumerate(self.folds, start=1)
        ]
        return Table(("fold", "seconds", "relative error [%]"), rows)

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        names = (
            "problem",
            "method",
            "periodic",
            "guard",
            "band_hz",
            "relative_error_percent",
        )
        folds = [
            {
                "number": k,
                "start": f.start,
                "stop": f.stop,
                "rows": int(f.rows.max(initial=0)),
            }
            | {
                "relative_error_percent": f.relative_error_percent,
                "rmse": f.rmse.tolist(),
            }
            for k, f in enumerate(self.folds, start=1)
        ]
        fields_of_result = {name: getattr(self, name) for name in names} | {
            "effects": list(self.effects)
        }
        return {
            **fields_of_result,
            "rmse": self.rmse.tolist(),
            "worst_fold": self.worst,
            "folds": folds,
        }


def cross_validate(
    problem: str | Path | Problem,
    measurements: Source,
    method: str | Estimator = DEFAULT_METHOD,
    *,
    effects: str | Sequence[str | Effect] | None = None,
    preprocessing: Preprocessing | None = None,
    weighting: str = "noise",
    folds: int = 5,
    seed: int = 0,
    known: Mapping[str, float] | None = None,
    progress: Progress = no_progress,
    workers: Workers = ALONE,
) -> CrossValidation:
    """Judge a method on motion that its models have not seen.

    The clock of every motion is cut into stretches; each is left out once, in all its
    repetitions (phase-block cross-validation). Without torque the servos' law, its
    delay and the shape constants are found once, in all rows, and the folds judge the
    parameters: by how far the torque of links and friction differs from the drives'.

    Parameters
    ----------
    problem : str, Path or Problem
        As in :func:`identify`.
    measurements : path, arrays, DataFrame, Measurements, list of these
        The runs.
    method : str or Estimator, default "lmi-sdp"
        The method to judge.
    effects : str, names or Effects, optional
        Default: the problem's.
    preprocessing : Preprocessing, optional
        Filter settings; default: the problem's.
    weighting : {"noise", "none"}
        As in :func:`identify`.
    folds : int
        Into how many stretches the clock of every motion is cut.
    seed : int
        Of the method.
    known : mapping of str to float, optional
        Parameters that set the scale of a log without torque.
    progress : callable
        Hears what is at work, a short text each time.
    workers : Workers
        Who fits the folds, one each.

    Returns
    -------
    CrossValidation
        Errors on unseen motion, fold by fold and joint by joint.

    Raises
    ------
    InputError
        For input that cannot be used, or is too short for so many folds.
    """
    estimator = make_estimator(method)
    if estimator.needs_black_box:
        raise InputError(
            f"method {estimator.name} needs a black box's answers",
            "choose another method",
        )
    options = PoseOptions(
        effects,
        preprocessing,
        weighting,
        seed=seed,
        known=known or {},
    )
    split = Split(problem, measurements, options, folds, progress)
    workers = replace(workers, progress=progress)
    return split.result(
        estimator, list(workers.map(partial(split.judged, estimator), split.numbers))
    )


#: What one fold is identified from and judged on, before a method is known: where it
#: starts and stops [s], the task, rows to judge on.
FoldData = tuple[float, float, Task, Regression]


def judged(fold: FoldData, estimator: Estimator) -> Fold:
    """A fold identified by an estimator."""
    start, stop, task, test = fold
    # Without what another method has left in the task.
    theta = task.model.with_known(estimator.fit(replace(task)).theta)
    squares = test.joint_losses(
        theta * task.model.drives
    )  # servos stand for what was not logged
    return Fold(
        start,
        stop,
        theta,
        test.joint_losses(theta),
        test.joint_rows(),
        squares,
    )


class Split:
    """The data of :func:`cross_validate`, whatever the method: what each fold needs,
    wherever it is worked on. Raises InputError as that does.

    common : all rows, in the model's columns; raw : where servos stand for a torque,
    the same without instruments, by which folds are judged.
    """

    def __init__(
        self,
        problem: str | Path | Problem,
        measurements: Source,
        options: PoseOptions,
        folds: int,
        progress: Progress = no_progress,
    ) -> None:
        self.problem = problem = as_problem(problem, "cross_validate(problem=...)")
        self.weighting = options.weighting
        self.seed = options.seed
        names = problem.robot.joint_names
        data = as_measurements(
            measurements,
            problem.robot.n,
            names,
            "cross_validate(measurements=...)",
        )
        if folds < 2:
            raise InputError(
                f"cross_validate(folds={folds}) is no number of folds", "give 2 or more"
            )
        check_plausible(problem.robot, data)
        self.raw: Regression | None = None
        if data.torque_logged:
            self.runs = FilteredRuns.of(
                data, options.preprocessing or problem.preprocessing
            )
            self.model = problem.model(options.effects).without_drives
            self.phases = phase_folds(data, self.runs.settings, folds)
            self.common = compress_cells(
                self.runs,
                self.model.reference_free,
                self.phases,
            )
        else:
            posed = build_problem(problem, data, options, progress)
            assert posed.runs is not None
            self.runs = FilteredRuns.of(data, posed.runs.settings)
            self.model = posed.task.model
            self.phases = phase_folds(data, self.runs.settings, folds)
            self.common = compress_cells(posed.runs, self.model, self.phases)
            self.raw = compress_cells(
                self.runs,
                replace(self.model, reference=None),
                self.phases,
            )
        trained = all(
            self.common.select(self.phases.training(k)).factors for k in range(folds)
        )
        if not (trained and self.numbers):
            raise InputError(
                f"{formatting.count(folds, 'fold')} with {self.phases.guard:.3g} s kept"
                " clear on either side leave nothing to train on or to judge",
                "choose fewer folds, or record longer",
                data.names[0],
            )

    @property
    def numbers(self) -> list[int]:
        """The folds that have rows to judge on."""
        rows = self.raw or self.common
        tested = self.phases.tested
        return [k for k in range(self.phases.count) if rows.select(tested(k)).factors]

    def fold(self, number: int) -> FoldData:
        """The data of a fold."""
        model = self.model if self.raw else self._trained(number)
        rows = self.common
        if model is not self.model:
            rows = compress_cells(self.runs, model, self.phases)
        train = rows.select(self.phases.training(number))
        test = (self.raw or rows).select(self.phases.tested(number))
        task = make_task(
            self.problem,
            model,
            train,
            self.weighting,
            self.seed,
        )
        return *self.phases.stretch(number), task, test

    def judged(self, estimator: Estimator, number: int) -> Fold:
        return judged(self.fold(number), estimator)

    def result(self, estimator: Estimator, judged: Sequence[Fold]) -> CrossValidation:
        """What folds add up to."""
        effects = tuple(e.text for e in self.model.effects)
        periodic = any(clock.periodic for clock in self.phases.clocks)
        band = self.runs.settings.torque_cutoff
        assert band is not None
        return CrossValidation(
            self.problem.name,
            estimator.name,
            effects,
            tuple(judged),
            periodic,
            self.phases.guard,
            band,
        )

    def _trained(self, fold: int) -> Model:
        """The model with what :func:`identify` takes from the data beside its
        parameters, from the fold's training rows alone: shape constants, the current
        model. Itself where that is nothing.
        """
        cells = self.phases.training(fold)
        model = self.model

        def training(run: int, t: Array) -> NDArray[np.bool_]:
            return np.isin(self.phases.cell(run, t), cells)

        def compressed(m: Model) -> Regression:
            return compress_cells(self.runs, m, self.phases).select(cells)

        shapes = estimate_shapes(model, self.runs, self.weighting, training)
        if any(shape.after != shape.before for shape in shapes):
            model = replace(model, effects=with_shapes(model.effects, shapes))
        return with_reference(self.problem, model, compressed, self.weighting)


def bootstrap(
    problem: str | Path | Problem,
    measurements: Source,
    draws: int = 200,
    method: str | Estimator = DEFAULT_METHOD,
    *,
    effects: str | Sequence[str | Effect] | None = None,
    seed: int = 0,
) -> pandas.DataFrame:
    """Certified estimates from resamples of the blocks of time, a twentieth of a run
    each.

    Shape constants and the joints' weights stay those of all measurements.

    Parameters
    ----------
    problem : str, Path or Problem
        As in :func:`sdp_vs_penalty.identify`.
    measurements : path, arrays, DataFrame, Measurements, list of these
        The same.
    draws : int
        How many.
    method : str or Estimator
        A torque SDP.
    effects : str, names or Effects, optional
        Default: the problem's.
    seed : int
        Of the draws.

    Returns
    -------
    DataFrame
        A row a draw, a column a parameter [SI], and "gap", the certified one relative
        to the loss.

    Raises
    ------
    InputError
        For input that cannot be used, and for a method that is no torque SDP.
    """
    import pandas

    estimator = make_estimator(method)
    if not isinstance(estimator, LmiSdp):
        raise InputError(
            f"method {estimator.name} is not drawn anew",
            "choose lmi-sdp, or one named so",
        )
    posed = build_problem(problem, measurements, PoseOptions(effects, seed=seed))
    task = posed.task
    regression = posed.regression
    objective, constraints = estimator.posed(task)
    data = objective.least_squares
    sdp = PosedSdp(task, objective, constraints, estimator.solver)
    first = sdp.fit(objective, estimator.accuracy)
    p = len(task.bound)
    count = len(regression.blocks)
    stacked = np.vstack(
        [
            np.column_stack([data.R, data.rho]),
            np.append(np.zeros(p), data.residual_norm),
        ]
    )
    U, V = column_space(stacked)
    grams = np.zeros((count, V.shape[1], V.shape[1]))
    into = U.T @ stacked
    for joint, indices, blocks, rows in regression.by_joint():
        visible_rows = task.weights[joint] * rows @ V[np.append(indices, p)]
        grams[blocks] += visible_rows.swapaxes(1, 2) @ visible_rows
    # A direction that no drawn block shows keeps what rounding is worth.
    priors = np.eye(V.shape[1]) * (1.0 + len(V) * np.finfo(float).eps) - grams.sum(
        axis=0
    )
    draws_of_parameters = np.empty((draws, p + 1))
    rng = np.random.default_rng(seed)
    for row in draws_of_parameters:
        times = rng.multinomial(count, np.full(count, 1.0 / count))
        rows = np.linalg.cholesky(priors + np.tensordot(times, grams, 1)).T @ into
        drawn = LeastSquares(
            rows[:, :p],
            rows[:, p],
            0.0,
            float(rows[:, p] @ rows[:, p]),
            data.rows,
        )
        fit = sdp.fit(
            Objective(drawn, objective.entropy),
            0.5 * TIGHT,
            near=first,
        )
        row[:] = np.append(task.model.with_known(fit.theta), fit.gap)
    return pandas.DataFrame(
        draws_of_parameters, columns=[*(q.name for q in task.model.parameters), "gap"]
    )
