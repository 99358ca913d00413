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
    """Rows to fit to, and rows to judge on, in the columns of a model and of effects;
    of a frozen model: what it leaves, in those of the effects."""

    effects: tuple[Effect, ...]
    train: Regression
    test: Regression
    frozen: bool

    def columns_of(self, estimate: Estimate, chosen: Sequence[int]) -> Columns:
        """Columns of this split that a model with some of the effects needs.

        Parameters
        ----------
        estimate : Estimate
            The model in question.
        chosen : sequence of int
            Numbers of the effects that are added to it.

        Returns
        -------
        Columns
            Effects of the model that stay, the chosen ones, and which columns are theirs.
        """
        new = [effect for k, effect in enumerate(self.effects) if k in chosen]
        of_model = () if self.frozen else estimate.model.effects
        staying, columns_stay = with_replaced_joints(of_model, new)
        is_chosen = [k in chosen for k in range(len(self.effects))]
        n_columns = [len(effect.parameters) for effect in self.effects]
        kept = np.append(columns_stay, np.repeat(is_chosen, n_columns))
        return Columns(staying, new, kept.astype(bool))


class Columns(NamedTuple):
    """Effects of the model that stay, those that are new, and which of a split's
    columns are theirs."""

    own: list[Effect]
    new: list[Effect]
    kept: NDArray[np.bool_]


@dataclass
class HeldOut:
    """What effects do to the errors of a model.

    source : "test" or "folds"; make_second : makes the same on another split of the
    motion, which has to agree before something goes.
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
        """The same on another split; None where there is none."""
        return None if self.make_second is None else self.make_second()

    def errors(self, chosen: Sequence[int]) -> Array:
        """(n,) root mean squares on data left out, with some of the effects."""
        key = tuple(sorted(chosen))
        if key not in self._known:
            squares = sum(self._squares(key))
            rows = sum(s.test.joint_rows() for s in self.splits)
            self._known[key] = np.sqrt(squares / np.maximum(rows, 1))
        return self._known[key]

    def _squares(self, chosen: Sequence[int]) -> Iterator[Array]:
        """(n,) squared errors of each split with some of the effects. Splits of the same
        effects share what does not depend on data."""
        for _, splits in groupby(self.splits, key=lambda s: [id(e) for e in s.effects]):
            alike = list(splits)
            columns = alike[0].columns_of(self.estimate, chosen)
            trains = [s.train.keeping(columns.kept) for s in alike]
            fits = fitted_parameters(
                self.estimate,
                columns.own,
                columns.new,
                trains,
                self.frozen,
            )
            for split, theta in zip(alike, fits, strict=True):
                yield split.test.keeping(columns.kept).joint_losses(theta)

    def least_squares_errors(self, chosen: Sequence[int]) -> Array:
        """(n,) the same by plain least squares with what is known of sizes, which takes
        no constraints: for comparisons of many."""
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
        """Of effects those that do no harm beside all others, and lower an error where
        that is ``needed``.

        The least useful of those that do is left out, and the others are asked again. One
        that lowers the error on another split of the motion stays: one motion alone has
        not the last word.
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
        """Whether an effect lowers the error on another split, beside all others."""
        if self.second is None:
            return False
        without = [i for i in accepted if i != k]
        before = self.second.least_squares_errors(without)
        return harm(before, self.second.least_squares_errors(accepted)) < -MINOR

    def drop_harmful_to_a_joint(self, accepted: Sequence[int]) -> list[int]:
        """Of effects those with which no joint errs more than without any, by 5 %.

        Of a joint that does, the effect goes without which its error is smallest, if both
        splits say so.
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
        """Whether an effect lowers one joint's error on another split."""
        if self.second is None:
            return False
        without = [i for i in accepted if i != k]
        before = self.second.least_squares_errors(without)[joint]
        after = self.second.least_squares_errors(accepted)[joint]
        return bool(after <= (1.0 - MINOR) * before)


def lowers(before: Array, after: Array) -> bool:
    """Whether some error falls by more than what is minor."""
    return bool(np.any(after <= (1.0 - MINOR) * before))


def harm(before: Array, after: Array) -> float:
    """By what share errors rise, added up over the joints."""
    return float(np.sum(np.log(np.maximum(after, 1e-300) / np.maximum(before, 1e-300))))


class _Table:
    """Rows in the columns of a model and of effects, with the torque; of a frozen model
    what it leaves, in those of the effects."""

    def __init__(
        self,
        rows: SegmentedRuns,
        estimate: Estimate,
        frozen: bool,
    ) -> None:
        self.rows = rows
        self.estimate = estimate
        self.frozen = frozen
        self.own_columns = model_columns(rows, estimate, frozen)
        self._last: tuple[tuple[Effect, ...], Array] | None = None

    def _columns(self, effects: tuple[Effect, ...]) -> Array:
        """(n, M, p + 1) columns and torque."""
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
        """Of the rows keep (M, n)."""
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
    """Who has the last word: a test run, or folds by phase. first : the model as it was
    given; test : the rows of a run that was not searched."""

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
        """Errors of models fitted to the rows that were searched.

        They are judged on the test run; without one, fitted to all folds but one, on that
        one. by_fold : at an effect's place, what rows outside of each fold make of it.
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
        """The same on thirds by the phase of the motion."""
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
        """Share of the test run's rows that leave what an effect is known for; none
        without one."""
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
    """Effects without those joints of theirs on which a new one, with another shape
    constant, stands in their place; and which of their parameters are left."""
    others = {
        (e.name, j) for e in new if not (e.whole_robot or e.several) for j in e.joints
    }
    out = list[Effect]()
    left = list[bool]()
    for e in effects:
        stay = [j for j in e.joints if (e.name, j) not in others]
        keeps_all = len(stay) == len(e.joints)
        left += (
            [True] * len(e.parameters)
            if keeps_all
            else [p.joint - 1 in stay for p in e.parameters]
        )
        if stay:
            out.append(e if keeps_all else type(e)(e.robot, stay, **e.shape))
    return out, left


def least_squares_parameters(
    estimate: Estimate,
    columns: Columns,
    data: Regression,
) -> Array:
    """(p,) of effects fitted to rows, joints weighted by what is left of them."""
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
    """The method that fits new effects to what a model leaves that is held fixed: a
    payload is a body, whatever the model was made by."""
    estimator = estimate.estimator
    return estimator if hasattr(estimator, "solver") else make_estimator(DEFAULT_METHOD)


def task_beside(
    estimate: Estimate,
    own_model: Model,
    left: Regression,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Task:
    """What fits only the new effects ``own_model``, under their own constraints; left : what
    the model leaves, in their columns."""
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
    """(p,) parameters of an estimate's ``own_effects`` effects and ``new`` ones for each of
    some ``data`` in their columns; frozen : of the new ones alone, from rows of what
    the model leaves.
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
