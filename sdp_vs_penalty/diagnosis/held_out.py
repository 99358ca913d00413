"""The last word: errors on data left out, with one finding after the other.

A finding that does harm on the test run goes only where folds of the training motion
agree.

At each step the model is fitted as ``add`` fits it, by its own method under its
problem's constraints. A test run is filtered as the runs that were searched; without
one, three folds by the phase of the motion take its place: sizes come from the other
folds, the choice of effects and constants from all rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.constants import MAX_JOINT_HARM, MINOR, THIRDS
from sdp_vs_penalty.diagnosis.white_rows import folds_of, model_columns, spread_columns
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.estimator import (
    Estimator,
    Progress,
    Task,
    joint_weights,
    make_task,
    no_progress,
    with_plausible,
)
from sdp_vs_penalty.regression.regression import Factor, Regression, triangular
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import ConstraintSet
from sdp_vs_penalty.signals.segments import SegmentedRuns


@dataclass(frozen=True)
class HeldOutSplit:
    """Rows to fit to (train) and rows to judge on (test), as compressed regressions.

    Columns are those of the model, then those of ``effects``, and the target is the
    torque. For a model held fixed (``frozen``) they are those of the effects, and the
    target is what the model leaves.
    """

    effects: tuple[Effect, ...]
    train: Regression
    test: Regression
    frozen: bool

    def columns_of(self, estimate: Estimate, chosen: Sequence[int]) -> Columns:
        """Select the columns of a model with some of the effects.

        Effects of the model are left out on joints where a chosen effect of the same
        name replaces them.

        Parameters
        ----------
        estimate : Estimate
            The model.
        chosen : sequence of int
            Numbers of the effects that are added to it.

        Returns
        -------
        Columns
            The model's effects that stay, the chosen ones, and flags of their columns.
        """
        new = [effect for k, effect in enumerate(self.effects) if k in chosen]
        of_model = () if self.frozen else estimate.model.effects
        staying, columns_stay = with_replaced_joints(of_model, new)
        is_chosen = [k in chosen for k in range(len(self.effects))]
        n_columns = [len(effect.parameters) for effect in self.effects]
        is_kept = np.append(columns_stay, np.repeat(is_chosen, n_columns))
        return Columns(staying, new, is_kept.astype(bool))


class Columns(NamedTuple):
    """The effects of a fit, and their columns among those of a split.

    own : effects of the model that stay; new : effects beside them; kept (p,) : flags
    of the split's columns that belong to either.
    """

    own: list[Effect]
    new: list[Effect]
    kept: NDArray[np.bool_]


@dataclass
class HeldOut:
    """Errors of a model on data left out, with any selection of candidate effects.

    Effects are numbered in the order of each split's ``effects``. source : "test" (a
    test run) or "folds" (by the phase of the motion). make_second : makes the same for
    another split of the motion, which is asked before an effect is removed.
    """

    estimate: Estimate
    frozen: bool
    splits: Sequence[HeldOutSplit]
    source: str
    make_second: Callable[[], HeldOut] | None = None
    _known: dict[tuple[int, ...], Array] = field(default_factory=dict)
    _known_least_squares: dict[tuple[int, ...], Array] = field(default_factory=dict)

    @cached_property
    def second(self) -> HeldOut | None:
        """The same errors on another split of the motion; None where there is none."""
        return None if self.make_second is None else self.make_second()

    def errors(self, chosen: Sequence[int]) -> Array:
        """Return (n,) RMS errors [N m or N] on data left out, with the chosen effects
        (numbers).

        The model is fitted by its own method, under its constraints. Results are kept.
        """
        key = tuple(sorted(chosen))
        if key not in self._known:
            squares = sum(self._squares(key))
            rows = sum(s.test.joint_rows() for s in self.splits)
            self._known[key] = np.sqrt(squares / np.maximum(rows, 1))
        return self._known[key]

    def _squares(self, chosen: Sequence[int]) -> Iterator[Array]:
        """Yield, for each split, the sums (n,) of squared errors with the chosen
        effects.

        Splits with the same effects are fitted together: constraints and columns are
        set up once for them.
        """
        for _, splits in groupby(self.splits, key=lambda s: [id(e) for e in s.effects]):
            same_effects = list(splits)
            columns = same_effects[0].columns_of(self.estimate, chosen)
            trains = [s.train.keeping(columns.kept) for s in same_effects]
            fits = fitted_parameters(
                self.estimate,
                columns.own,
                columns.new,
                trains,
                self.frozen,
            )
            for split, theta in zip(same_effects, fits, strict=True):
                yield split.test.keeping(columns.kept).joint_losses(theta)

    def least_squares_errors(self, chosen: Sequence[int]) -> Array:
        """Return (n,) RMS errors [N m or N] on data left out, fitted by least squares.

        Faster than :meth:`errors`, for many comparisons: no constraints apply, only the
        sizes that are plausible for each effect. chosen : numbers of the effects.
        """
        key = tuple(sorted(chosen))
        if key not in self._known_least_squares:
            squares = np.zeros(self.estimate.robot.n)
            rows = np.zeros(self.estimate.robot.n)
            for split in self.splits:
                columns = split.columns_of(self.estimate, chosen)
                train = split.train.keeping(columns.kept)
                test = split.test.keeping(columns.kept)
                theta = least_squares_parameters(self.estimate, columns, train)
                squares += test.joint_losses(theta)
                rows += test.joint_rows()
            self._known_least_squares[key] = np.sqrt(squares / np.maximum(rows, 1))
        return self._known_least_squares[key]

    def drop_harmful(
        self,
        candidates: Sequence[int],
        needed: bool = False,
    ) -> list[int]:
        """Drop effects that raise the error on data left out, the most harmful one
        first.

        The harm of an effect is the sum over joints of the logarithm of the error with
        it over that without it, beside all others. After each drop the others are
        judged again. An effect that lowers the error on the second split by 1 % stays:
        one motion alone does not decide.

        Parameters
        ----------
        candidates
            Numbers of the effects.
        needed
            True: an effect stays only if it lowers the error by MINOR (1 %). Default:
            it goes only if it raises the error by as much.

        Returns
        -------
        list of int
            Numbers of the effects that stay.
        """
        accepted = list(candidates)
        confirmed = set[int]()
        limit = -MINOR if needed else MINOR
        while accepted:
            now = self.errors(accepted)
            harms = {
                k: harm(self.errors([i for i in accepted if i != k]), now)
                for k in accepted
                if k not in confirmed
            }
            worst = max(harms, key=harms.__getitem__, default=None)
            if worst is None or harms[worst] < limit:
                break
            if self._helps_elsewhere(worst, accepted):
                confirmed.add(worst)
            else:
                accepted.remove(worst)
        return accepted

    def _helps_elsewhere(self, k: int, accepted: Sequence[int]) -> bool:
        """Return whether effect k lowers the error on the second split, beside all
        accepted.
        """
        if self.second is None:
            return False
        without = [i for i in accepted if i != k]
        before = self.second.least_squares_errors(without)
        return harm(before, self.second.least_squares_errors(accepted)) < -MINOR

    def drop_harmful_to_a_joint(self, accepted: Sequence[int]) -> list[int]:
        """Drop effects until no joint has an error above 1.05 times that without any
        effect.

        Where a joint has, the effect is dropped whose removal lowers its error most,
        unless it lowers this joint's error on the second split. Returns the numbers
        that stay.
        """
        accepted = list(accepted)
        limit = (1.0 + MAX_JOINT_HARM) * self.errors(())
        while accepted:
            now = self.errors(accepted)
            worse = np.flatnonzero(now > limit)
            if not worse.size:
                break
            joint = int(worse[np.argmax(now[worse] / limit[worse])])
            without = {
                k: self.errors([i for i in accepted if i != k])[joint] for k in accepted
            }
            cause = min(without, key=without.__getitem__)
            if without[cause] >= now[joint] or self._lowers_elsewhere(
                joint,
                cause,
                accepted,
            ):
                break
            accepted.remove(cause)
        return accepted

    def _lowers_elsewhere(
        self,
        joint: int,
        k: int,
        accepted: Sequence[int],
    ) -> bool:
        """Return whether effect k lowers one joint's error on the second split by 1 %."""
        if self.second is None:
            return False
        without = [i for i in accepted if i != k]
        before = self.second.least_squares_errors(without)[joint]
        after = self.second.least_squares_errors(accepted)[joint]
        return bool(after <= (1.0 - MINOR) * before)


def lowers(before: Array, after: Array) -> bool:
    """Return whether the error of some joint falls by MINOR (1 %) or more."""
    return bool(np.any(after <= (1.0 - MINOR) * before))


def harm(before: Array, after: Array) -> float:
    """Return the sum over joints of log(after / before) of their errors (n,).

    Positive: errors rise; 0.01 is about one joint's error rising by 1 %.
    """
    return float(np.sum(np.log(np.maximum(after, 1e-300) / np.maximum(before, 1e-300))))


class _Table:
    """Rows with the columns of a model and of effects, to be compressed for any
    selection.

    Of a model held fixed the target is what it leaves, and only effects have columns.
    """

    def __init__(
        self,
        rows: SegmentedRuns,
        estimate: Estimate,
        frozen: bool,
    ) -> None:
        """Compute the model's own columns; those of effects follow when they are
        needed.
        """
        self.rows = rows
        self.estimate = estimate
        self.frozen = frozen
        self.own_columns = model_columns(rows, estimate, frozen)
        self._last: tuple[tuple[Effect, ...], Array] | None = None

    def _columns(self, effects: tuple[Effect, ...]) -> Array:
        """Return (n, M, p + 1): the columns of model and effects, and the torque as the
        last one.

        Those of the last effects that were asked for are kept.
        """
        if self._last is None or self._last[0] is not effects:
            torque = self.rows.residual if self.frozen else self.rows.torque
            blocks = [self.own_columns]
            blocks += [spread_columns(self.rows, e) for e in effects]
            blocks.append(torque.T[:, :, None])
            self._last = effects, np.concatenate(blocks, axis=2)
        return self._last[1]

    def compressed(
        self,
        effects: Sequence[Effect],
        keep: NDArray[np.bool_],
    ) -> Regression:
        """Return the regression of some rows, each joint's reduced to a triangular
        factor.

        keep (M, n) : which rows. The factor has p + 1 rows instead of M, and the same
        least squares solutions.
        """
        effects = tuple(effects)
        own_effects = () if self.frozen else self.estimate.model.effects
        parameters = tuple(p for e in (*own_effects, *effects) for p in e.parameters)
        all_columns = np.arange(len(parameters))
        factors = []
        for j, columns in enumerate(self._columns(effects)):
            part = columns[keep[:, j]]
            triangle = triangular([part]) if len(part) else part
            factors.append(
                Factor(
                    j,
                    0,
                    all_columns,
                    triangle,
                    len(part),
                )
            )
        n = self.rows.n
        block = ((0, 0.0, 0.0),)
        return Regression(parameters, n, block, tuple(factors), oversampling=1.0)


@dataclass(frozen=True)
class HeldOutData:
    """The data that decide whether findings stay: a test run, or folds of the training
    run.

    first : the model before the diagnosis; test : filtered rows of a run that was not
    searched, or None; frozen : whether the model is held fixed.
    """

    first: Estimate
    test: SegmentedRuns | None
    frozen: bool

    def held_out_errors(
        self,
        rows: SegmentedRuns,
        effects: Sequence[Effect],
        estimate: Estimate,
        by_fold: Mapping[int, Sequence[Effect]] | None = None,
    ) -> HeldOut:
        """Return the errors on data left out of a model with any of these effects.

        They are judged on the test run. Without one, the model is fitted to all folds
        but one and judged on that one, in turn.

        Parameters
        ----------
        rows
            The rows that were searched.
        effects
            The effects, which are then chosen by number.
        estimate
            The model beside them.
        by_fold
            For the effects at these numbers: the effect to use for each fold, computed
            from the rows outside of the fold (a measured curve's table is itself a
            fit).

        Returns
        -------
        HeldOut
            The errors, computed when they are needed.
        """
        table = _Table(rows, estimate, self.frozen)
        by_folds = partial(
            self._by_folds,
            table,
            tuple(effects),
            by_fold or {},
        )
        if self.test is None:
            return by_folds()
        test = _Table(
            self.test.with_model(*rows.attached),
            estimate,
            self.frozen,
        )
        split = HeldOutSplit(
            effects=tuple(effects),
            train=table.compressed(effects, rows.keep),
            test=test.compressed(effects, test.rows.keep),
            frozen=self.frozen,
        )
        return HeldOut(estimate, self.frozen, (split,), "test", by_folds)

    def _by_folds(
        self,
        table: _Table,
        effects: tuple[Effect, ...],
        by_fold: Mapping[int, Sequence[Effect]],
    ) -> HeldOut:
        """Return the errors on three folds (THIRDS) by the phase of the motion."""
        fold = folds_of(table.rows, THIRDS)
        splits = []
        for f in range(fold.max() + 1):
            shaped = effects
            if by_fold:
                shaped = tuple(
                    by_fold[k][f] if k in by_fold else e for k, e in enumerate(effects)
                )
            left_out = (fold == f)[:, None]
            split = HeldOutSplit(
                effects=shaped,
                train=table.compressed(shaped, table.rows.keep & ~left_out),
                test=table.compressed(shaped, table.rows.keep & left_out),
                frozen=self.frozen,
            )
            splits.append(split)
        return HeldOut(table.estimate, self.frozen, splits, "folds")

    def outside(self, effect: Effect) -> float:
        """Return the share of the test run's rows outside of an effect's known range.

        A measured curve, for example, is known only where the searched motion went. 0
        without a test run.
        """
        if self.test is None:
            return 0.0
        outside_shares = [
            s.low_pass @ effect.outside(s.motion).astype(float)
            for s in self.test.segments
        ]
        return float(
            np.mean(np.concatenate(outside_shares)[self.test.keep.any(axis=1)] > 0.5)
        )


def with_replaced_joints(
    effects: Sequence[Effect], new: Sequence[Effect]
) -> tuple[list[Effect], list[bool]]:
    """Remove the joints of effects on which a new effect of the same name replaces
    them.

    Effects of the whole robot and those that may come several times are never replaced.

    Returns
    -------
    list of Effect
        The effects on the joints that are left; without those that have none.
    list of bool
        For each parameter of the given effects, whether it is left.
    """
    others = {
        (e.name, j) for e in new if not (e.whole_robot or e.several) for j in e.joints
    }
    out = list[Effect]()
    stays = list[bool]()
    for e in effects:
        stay = [j for j in e.joints if (e.name, j) not in others]
        keeps_all = len(stay) == len(e.joints)
        stays += (
            [True] * len(e.parameters)
            if keeps_all
            else [p.joint - 1 in stay for p in e.parameters]
        )
        if stay:
            out.append(e if keeps_all else type(e)(e.robot, stay, **e.shape))
    return out, stays


def least_squares_parameters(
    estimate: Estimate,
    columns: Columns,
    data: Regression,
) -> Array:
    """Fit the effects of ``columns`` by least squares, with plausible sizes as priors.

    Each joint is weighted by its residual, in two rounds. data : the rows in these
    columns. Returns the parameters (p,) in SI units.
    """
    effects = (*columns.own, *columns.new)
    if not effects:
        return np.zeros(0)
    model = Model(estimate.robot, effects, gains=estimate.model.gains)
    weights: Array = np.ones(estimate.robot.n)
    theta: Array = np.zeros(0)
    for _ in range(2):
        squares = data.least_squares(weights)
        known = with_plausible(squares, model, data.oversampling)
        theta = np.asarray(np.linalg.lstsq(known.R, known.rho, rcond=1e-9)[0])
        weights = joint_weights(data, theta)
    return np.asarray(theta)


def estimator_beside(estimate: Estimate) -> Estimator:
    """Return the method that fits new effects beside a model whose parameters stay
    fixed.

    It is the model's own if that solves convex problems; else the default one, since a
    payload has constraints of a rigid body.
    """
    estimator = estimate.estimator
    return estimator if hasattr(estimator, "solver") else make_estimator(DEFAULT_METHOD)


def task_beside(
    estimate: Estimate,
    own_model: Model,
    left: Regression,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Task:
    """Set up the fit of new effects alone, to what a model leaves.

    Parameters
    ----------
    estimate
        The model that is held fixed.
    own_model
        The new effects, as a model.
    left
        What the model leaves, in the columns of the new effects.
    seed
        Of the method.
    progress
        Is called with a short text.

    Returns
    -------
    Task
        The problem under the new effects' own constraints, for an estimator.
    """
    problem = estimate.problem
    weights = np.ones(estimate.robot.n)
    for _ in range(2):
        data = with_plausible(left.least_squares(weights), own_model, left.oversampling)
        weights = joint_weights(left, np.linalg.lstsq(data.R, data.rho, rcond=1e-9)[0])
    return Task(
        own_model,
        data,
        ConstraintSet(problem.constraints(own_model).convex),
        problem.parameter_bound(own_model),
        problem.nominal(own_model),
        problem.box,
        None,
        seed,
        progress,
        weights=weights,
    )


def fitted_parameters(
    estimate: Estimate,
    own_effects: Sequence[Effect],
    new: Sequence[Effect],
    data: Sequence[Regression],
    frozen: bool,
) -> list[Array]:
    """Fit effects of a model and new ones to several sets of rows, by the model's
    method.

    Parameters
    ----------
    estimate
        The model.
    own_effects
        Its effects that stay.
    new
        Effects beside them.
    data
        Sets of rows, each in the columns of all these effects.
    frozen
        True: only the new effects are fitted, to what the model leaves.

    Returns
    -------
    list of (p,) arrays
        For each set of rows the parameters, in SI units.
    """
    if not (own_effects or new):
        return [np.zeros(0) for _ in data]
    model = Model(
        estimate.robot,
        (*own_effects, *new),
        gains=estimate.model.gains,
    )
    tasks = list[Task]()
    for rows in data:
        if frozen:
            tasks.append(task_beside(estimate, model, rows))
            continue
        first = tasks[0] if tasks else None
        weighting = estimate.weighting
        tasks.append(
            make_task(
                estimate.problem,
                model,
                rows,
                weighting,
                like=first,
            )
        )
    method = estimator_beside(estimate) if frozen else estimate.estimator
    fits = [method.fit(task) for task in tasks] if frozen else method.fit_each(tasks)
    return [np.asarray(fit.theta, float) for fit in fits]
