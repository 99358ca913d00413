"""How well a method's models predict motion that they have not seen.

In :func:`cross_validate` each fold leaves out one stretch of every motion's clock
(:mod:`~sdp_vs_penalty.signals.phases`), all its repetitions and a guard of the filters'
reach around it, identifies from the rest, shape constants included, as ``identify``
does, and is judged on what it left out. Every row is judged once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.plausibility import check_plausible
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import (
    PoseOptions,
    build_problem,
    filter_runs,
    with_known,
    with_reference,
)
from sdp_vs_penalty.estimation.guessed_bodies import fit_in_bodies
from sdp_vs_penalty.estimation.shapes import estimate_shapes, with_shapes
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.estimator import (
    Estimator,
    Progress,
    Task,
    make_task,
    no_progress,
)
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.records import WritesJson, stored_as
from sdp_vs_penalty.regression.evidence import relative_error
from sdp_vs_penalty.regression.regression import Regression, compress_cells
from sdp_vs_penalty.results.facts import fact
from sdp_vs_penalty.results.record import Record, Summary
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.phases import phase_folds
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.threads import on_one_thread

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class Fold(WritesJson):
    """One fold: identified from all but a stretch, judged on it."""

    derived = ("relative_error_percent", "rmse")

    #: Start of the stretch on the clock of the first motion [s].
    start: float
    #: End of the stretch on the same clock [s].
    stop: float
    #: (p,) parameters identified from everything else.
    theta: Array
    #: (n,) sum of squared torque errors of each joint on the stretch.
    losses: Array
    #: (n,) number of rows of each joint on the stretch.
    rows: Indices
    #: (n,) sum of squared torques of each joint on the stretch.
    torque_squared: Array

    @property
    def rmse(self) -> Array:
        """(n,) root mean square torque error of each joint on the judged stretch [N m
        or N].
        """
        return np.sqrt(self.losses / np.maximum(self.rows, 1))

    @property
    def relative_error_percent(self) -> float:
        """Relative torque error 100 |tau - tau_hat| / |tau| over all joints [%]."""
        return float(relative_error(self.losses.sum(), self.torque_squared.sum()))


@dataclass(frozen=True, repr=False)
class CrossValidation(Record):
    """Errors of a method on motion that its models have not seen, fold by fold."""

    derived = ("relative_error_percent", "rmse", "worst_fold")

    #: Name of the problem.
    problem: str
    #: Name of the estimator.
    method: str
    #: Effects of the model, as they are written.
    effects: tuple[str, ...]
    #: The folds that have rows to judge.
    folds: tuple[Fold, ...]
    #: Whether a motion repeats.
    periodic: bool
    #: Time that training keeps off the judged stretch [s].
    guard: float
    #: Frequency below which all errors are meant [Hz].
    band_hz: float
    #: Time for which the arm stood still, whose rows are left out [s].
    still: float = field(default=0.0, metadata=stored_as("standstill_left_out"))

    @property
    def scope(self) -> str:
        """Which errors are meant: below the low-pass, and what is left out."""
        return formatting.scope_of_errors(self.band_hz, self.still)

    @property
    def _whole(self) -> Fold:
        """All folds added up as one Fold: sums of squared errors, of rows, of squared
        torque.

        Its theta is that of the first fold and has no meaning here.
        """
        first = self.folds[0]
        return Fold(
            start=first.start,
            stop=self.folds[-1].stop,
            theta=first.theta,
            losses=np.sum([fold.losses for fold in self.folds], axis=0),
            rows=np.sum([fold.rows for fold in self.folds], axis=0),
            torque_squared=np.sum([fold.torque_squared for fold in self.folds], axis=0),
        )

    @property
    def rmse(self) -> Array:
        """(n,) root mean square torque error of each joint over all folds [N m or N]."""
        return self._whole.rmse

    @fact("%", digits=4, column="error on unseen motion [%]")
    def relative_error_percent(self) -> float:
        """Relative torque error 100 |tau - tau_hat| / |tau| over all folds and joints
        [%].
        """
        return self._whole.relative_error_percent

    @property
    def worst_fold(self) -> int:
        """Number of the fold with the largest relative error, from 1."""
        return 1 + int(np.argmax([f.relative_error_percent for f in self.folds]))

    @property
    def verdict(self) -> str:
        """Relative error over all folds and in the worst fold, as a sentence."""
        worst = self.folds[self.worst_fold - 1]
        return (
            f"{self.method} predicts unseen motion to {self.relative_error_percent:.3g}"
            f" % (relative error); worst fold {self.worst_fold}:"
            f" {worst.relative_error_percent:.3g} %."
        )

    @property
    def split_sentence(self) -> str:
        """How the runs were split, in one sentence."""
        kind = (
            "phase blocks: a motion's repetitions share a fold"
            if self.periodic
            else "blocks of time"
        )
        guard_words = f"training keeps {self.guard:.3g} s off the judged fold."
        return f"{len(self.folds)} folds by {kind}; {guard_words}"

    def _summary(self) -> Summary:
        """Return the title and the (label, text) lines of the printed summary."""
        return f"CrossValidation: {self.verdict}", [
            ("RMSE", ", ".join(f"{x:.3g}" for x in self.rmse)),
            ("split", self.split_sentence),
            ("band", self.scope),
        ]

    def _table(self) -> Table:
        """Return the table that notebooks show."""
        return self.table(["N m or N"])

    def table(self, units: Sequence[str]) -> Table:
        """Return a table of all folds: a row for each, and one for all of them.

        ``units`` are those of the joints' torques.
        """
        names = [
            f"{k}: {f.start:.3g}-{f.stop:.3g} s"
            for k, f in enumerate(self.folds, start=1)
        ]
        rows = [
            (name, *map(formatting.number, (f.relative_error_percent, *f.rmse)))
            for name, f in zip([*names, "all"], [*self.folds, self._whole], strict=True)
        ]
        kinds = ", ".join(dict.fromkeys(map(formatting.plain_unit, units)))
        joints = (str(j) for j, _ in enumerate(self.rmse, start=1))
        return Table(
            ("judged on", "error [%]", *joints),
            rows,
            title=f"Relative error, and RMSE [{kinds}] of each joint {self.scope}",
        )

    def to_frame(self) -> pandas.DataFrame:
        """Return a table (data frame) with one row for each fold (from 1) and joint.

        Columns: start and stop of the judged stretch [s], relative error of the fold
        over all joints [%], and RMS torque error of the joint [N m or N].
        """
        import pandas

        rows = [
            {
                "fold": number,
                "joint": joint,
                "start [s]": fold.start,
                "stop [s]": fold.stop,
                "relative error [%]": fold.relative_error_percent,
                "error [N m or N]": error,
            }
            for number, fold in enumerate(self.folds, start=1)
            for joint, error in enumerate(fold.rmse, start=1)
        ]
        return pandas.DataFrame(rows).set_index(["fold", "joint"])


@on_one_thread
@checked_arguments
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
    """Measure a method's torque error on motion that its models have not seen.

    Phase-block cross-validation: the clock of every motion is cut into stretches; each
    is left out once, in all repetitions of the motion. In a log without torque the
    servos' law, its delay and the shape constants are found once from all rows; the
    folds judge the parameters, by the difference between the torque of links and
    friction and that of the drives.

    Parameters
    ----------
    problem : str, Path or Problem
        The robot with its bounds, as in :func:`identify`.
    measurements : path, arrays, DataFrame, Measurements, list of these
        The runs of which each fold leaves a part out.
    method : str or Estimator, default "lmi-sdp"
        The method to judge, as in :func:`identify`.
    effects : str, names or Effects, optional
        Effects of the models; default: the problem's.
    preprocessing : Preprocessing, optional
        Filter settings; default: the problem's.
    weighting : {"noise", "none"}
        Weights of the joints, as in :func:`identify`.
    folds : int
        Number of stretches into which the clock of every motion is cut.
    seed : int
        Seed of the method's random choices.
    known : mapping of str to float, optional
        Parameters of known value, as in :func:`identify`.
    progress : callable
        Receives a line of text at each stage.
    workers : Workers
        Processes that fit the folds, one each.

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
        progress=progress,
    )
    split = Split(problem, measurements, options, folds)
    workers = replace(workers, progress=progress)
    return split.result(
        estimator, list(workers.map(partial(split.judged, estimator), split.numbers))
    )


#: What one fold is identified from and judged on, before a method is known: where it
#: starts and stops [s], the task, rows to judge on.
FoldData = tuple[float, float, Task, Regression]


def judged(fold: FoldData, estimator: Estimator) -> Fold:
    """Identify a fold's training rows by an estimator and measure errors on its test
    rows.

    In a log without torque the drives' torque is the reference of the relative error.
    """
    start, stop, task, test = fold
    # A copy of the task: the original may hold cached results of another method.
    _, fit = fit_in_bodies(replace(task), estimator)
    theta = task.model.with_known(fit.theta)
    # With torque no parameter is a drive's, and this is the squared measured torque.
    torque_squared = test.joint_losses(theta * task.model.drives)
    return Fold(
        start,
        stop,
        theta,
        losses=test.joint_losses(theta),
        rows=test.joint_rows(),
        torque_squared=torque_squared,
    )


class Split:
    """The data of :func:`cross_validate`, which are the same for every method and fold."""

    def __init__(
        self,
        problem: str | Path | Problem,
        measurements: Source,
        options: PoseOptions,
        folds: int,
    ) -> None:
        """Read the data of a cross-validation and compress them, in blocks by folds.

        A fold is a stretch of the motion, the same one in all its repetitions.
        ``common`` are the rows that identify, in the model's columns, and ``raw`` those
        that judge. With a logged torque both are the same. Without, the servos' control
        law stands for the torque. It is estimated once from all rows; instruments, which
        make the estimate unbiased, are in ``common`` alone.

        Raises InputError as :func:`cross_validate` does, also if a fold leaves no rows
        to train on or no fold has rows to judge.
        """
        self.problem = problem = as_problem(problem, "cross_validate(problem=...)")
        self.weighting = options.weighting
        self.seed = options.seed
        names = problem.channel_names
        data = as_measurements(
            measurements, problem.robot.n, names, "cross_validate(measurements=...)"
        )
        if folds < 2:
            raise InputError(
                f"cross_validate(folds={folds}) is no number of folds", "give 2 or more"
            )
        check_plausible(problem.robot, data)
        self.raw: Regression | None = None
        # Compress the rows, one block a fold (and one for rows between folds).
        if data.torque_logged:
            self.runs = identified = filter_runs(problem, data, options.preprocessing)
            model = problem.model(options.effects).without_drives
            self.model = with_known(model, options.known)
            columns = self.model.reference_free
        else:
            posed = build_problem(problem, data, options)
            assert posed.runs is not None
            identified = posed.runs
            self.runs = FilteredRuns.filtering(data, identified.settings)
            self.model = columns = posed.task.model
        _require_long_folds(folds, self.runs)
        self.phases = phase_folds(data, self.runs.settings, folds)
        self.common = compress_cells(identified, columns, self.phases)
        if not data.torque_logged:
            self.raw = compress_cells(
                self.runs, replace(self.model, reference=None), self.phases
            )
        all_have_training = all(
            self.common.select(self.phases.training(k)).factors for k in range(folds)
        )
        if not (all_have_training and self.numbers):
            raise InputError(
                f"{formatting.count(folds, 'fold')} with {self.phases.guard:.3g} s kept"
                " clear on either side leave nothing to train on or to judge",
                "choose fewer folds, or record longer",
                data.names[0],
            )

    @property
    def numbers(self) -> list[int]:
        """Numbers (from 0) of the folds that have rows to judge."""
        rows = self.raw or self.common
        tested = self.phases.tested
        return [k for k in range(self.phases.count) if rows.select(tested(k)).factors]

    def fold(self, number: int) -> FoldData:
        """Return what a fold (from 0) is identified from and judged on.

        The result is (start [s], stop [s], training task, test rows). With logged
        torque the shape constants of friction are estimated anew from the training
        rows, so that the test rows stay unseen.
        """
        # In a log without torque, the model comes from all rows (class docstring).
        model = self.model if self.raw else self._trained(number)
        rows = self.common
        if model is not self.model:
            rows = compress_cells(self.runs, model, self.phases)
        train = rows.select(self.phases.training(number))
        test = (self.raw or rows).select(self.phases.tested(number))
        task = make_task(
            self.problem,
            model,
            regression=train,
            weighting=self.weighting,
            seed=self.seed,
        )
        return *self.phases.stretch(number), task, test

    def judged(self, estimator: Estimator, number: int) -> Fold:
        """Identify fold ``number`` (from 0) by an estimator and measure its errors."""
        return judged(self.fold(number), estimator)

    def result(self, estimator: Estimator, folds: Sequence[Fold]) -> CrossValidation:
        """Collect the judged folds in a CrossValidation."""
        effects = tuple(e.text for e in self.model.effects)
        periodic = any(clock.periodic for clock in self.phases.clocks)
        band = self.runs.settings.torque_cutoff  # Hz
        assert band is not None
        return CrossValidation(
            problem=self.problem.name,
            method=estimator.name,
            effects=effects,
            folds=tuple(folds),
            periodic=periodic,
            guard=self.phases.guard,
            band_hz=band,
            still=self.runs.still_seconds,
        )

    def _trained(self, fold: int) -> Model:
        """Return the model with shape constants and reference from a fold's training
        rows.

        These are what :func:`identify` takes from the data besides the linear
        parameters: a shape constant is nonlinear, such as a Stribeck velocity; the
        reference are parameters about which an effect is linearised. A model that has
        neither is returned as it is.
        """
        cells = self.phases.training(fold)
        model = self.model

        def training(run: int, t: Array) -> Mask:
            """Return (N,) whether a run's rows at instants t are training rows."""
            return np.isin(self.phases.cell(run, t), cells)

        def compressed(m: Model) -> Regression:
            """Return the training rows in a model's columns."""
            return compress_cells(self.runs, m, self.phases).select(cells)

        shapes = estimate_shapes(model, self.runs, self.weighting, training)
        if any(shape.after != shape.before for shape in shapes):
            model = replace(model, effects=with_shapes(model.effects, shapes))
        if model.needs_reference:
            model, _ = with_reference(self.problem, model, compressed, self.weighting)
        return model


def _require_long_folds(folds: int, runs: FilteredRuns) -> None:
    """Raise InputError for folds that are shorter than one period of the low-pass: no
    motion of their own is in them."""
    seconds, cutoff = runs.measurements.seconds, runs.settings.torque_cutoff
    assert cutoff is not None  # the settings are resolved
    most = max(int(seconds * cutoff), 2)
    if folds > most:
        raise InputError(
            f"{formatting.count(folds, 'fold')} of {seconds:.3g} s are shorter than what"
            f" the low-pass of {cutoff:.3g} Hz blurs",
            f"choose at most {most}",
            runs.measurements.names[0],
        )
