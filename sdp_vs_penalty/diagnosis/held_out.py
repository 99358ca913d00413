"""The last word: errors on data left out, with one finding after the other.

A finding that does harm on the test run goes only where folds of the training motion
agree. One that is doubted has to help on both, on one of them by more than its help
scatters on the test run between stretches of time.

At each step the model is fitted as ``add`` fits it, by its own method under its
problem's constraints. A test run is filtered as the runs that were searched; without
one, three folds by the phase of the motion take its place: sizes come from the other
folds, the choice of effects and constants from all rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import combinations, groupby
from typing import Any, NamedTuple

import numpy as np

from sdp_vs_penalty.diagnosis.constants import (
    CLEAR_HELP,
    FEWEST_SLIDING,
    MAX_JOINT_HARM,
    MINOR,
    PARTS,
    SURE_HELP,
    THIRDS,
)
from sdp_vs_penalty.diagnosis.white_rows import folds_of, model_columns, spread_columns
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.estimator import (
    Estimator,
    Progress,
    Task,
    make_task,
    no_progress,
    weighted_by_residuals,
)
from sdp_vs_penalty.regression.evidence import jackknifed, student_95
from sdp_vs_penalty.regression.products import ProductRegression
from sdp_vs_penalty.regression.regression import Regression
from sdp_vs_penalty.robot.arrays import Array, Mask
from sdp_vs_penalty.robot.constraint import ConstraintSet
from sdp_vs_penalty.signals.segments import SegmentedRuns


class JudgedRows(NamedTuple):
    """Rows to judge on, in stretches."""

    #: (n joints, M rows, p + 1) columns, the target last.
    columns: Array
    #: (n, S, M) 1 for the rows of each stretch that count for a joint, else 0.
    stretches: Array

    @classmethod
    def from_masks(cls, columns: Array, masks: Sequence[Mask]) -> JudgedRows:
        """Take the rows of S stretches by their flags (M, n)."""
        return cls(columns, np.array(masks, float).transpose(2, 0, 1))


@dataclass(frozen=True)
class HeldOutSplit:
    """Rows to fit to, as regressions, and rows to judge on.

    Their columns are those of the model, then those of ``effects``; the target is the
    torque. If the model is held fixed (``frozen``), the columns are those of the
    effects alone, and the target is the model's residual.
    """

    #: The candidate effects.
    effects: tuple[Effect, ...]
    #: The rows to fit to.
    train: Regression
    #: Those of them in which the joints slide.
    sliding: Regression
    #: The rows to judge on: S stretches, recording after recording, then those of their
    #: rows in which the joints slide, then the sliding rows fitted to.
    judged: tuple[JudgedRows, ...]
    #: Whether the model is held fixed.
    frozen: bool

    def fitted_rows(self, sliding: bool) -> Regression:
        """Return the rows to fit to: all, or those in which the joints slide."""
        return self.sliding if sliding else self.train

    @property
    def n_rows(self) -> Array:
        """(2 S + 1, n) numbers of the rows to judge on, joint by joint."""
        return np.hstack([x.stretches.sum(axis=2) for x in self.judged]).T

    def columns_of(self, estimate: Estimate, chosen: Sequence[int]) -> Columns:
        """Select the columns of a model with some of the effects.

        Effects of the model are left out on joints where a chosen effect of the same
        name replaces them.

        Parameters
        ----------
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

    def acts_in_slow_rows(self, k: int) -> bool:
        """Return whether effect k is a law of dry friction that acts in slow rows.

        It is one of friction at rest, or less than half of the squares of its torque
        are in those rows fitted to in which the joints slide (a Stribeck dip's, say).
        """
        effect = self.effects[k]
        if effect.at_rest or not effect.is_dry_friction:
            return bool(effect.at_rest)
        # The torque's column is the last one.
        end = -1 - sum(len(other.parameters) for other in self.effects[k + 1 :])
        own = slice(end - len(effect.parameters), end)
        in_all, in_sliding = (
            np.sum(rows.column_norms()[:, own] ** 2)
            for rows in (self.train, self.sliding)
        )
        return bool(in_sliding < 0.5 * in_all)


class Columns(NamedTuple):
    """The effects of a fit, and their columns among those of a split."""

    #: Effects of the model that stay.
    own: list[Effect]
    #: Effects that are added to them.
    new: list[Effect]
    #: (p,) flags of the split's p columns that belong to either.
    kept: Mask

    def with_zeros(self, theta: Array) -> Array:
        """Return the parameters (p,) of all columns: ``theta`` of the kept ones, zeros
        for the others."""
        out = np.zeros(len(self.kept))
        out[self.kept] = theta
        return out


#: Fits effects of a model and new ones to several sets of rows.
_Fitted = Callable[
    [Estimate, Sequence[Effect], Sequence[Effect], Sequence[Regression]], list[Array]
]


@dataclass
class HeldOut:
    """Errors of a model on data left out, with any selection of candidate effects.

    Effects are numbered in the order of each split's ``effects``.
    """

    #: The model.
    estimate: Estimate
    #: Whether its parameters stay fixed.
    frozen: bool
    #: The rows to fit to and to judge on.
    splits: Sequence[HeldOutSplit]
    #: "test" (a test run) or "folds" (by the phase of the motion).
    source: str
    #: How many stretches each recording has among the rows to judge on.
    n_stretches: int = 1
    #: Computes such errors for folds of the training motion, the second opinion before
    #: an effect is removed; None if there is none.
    make_second: Callable[[], HeldOut] | None = None
    #: Sums of squared errors computed before, by the chosen effects' numbers, whether
    #: they are fitted where the joints slide, and how they are fitted.
    _known_squares: dict[tuple[Any, ...], Array] = field(default_factory=dict)

    @cached_property
    def second(self) -> HeldOut | None:
        """Such errors on folds of the training motion, as a second opinion.

        None if the errors here come from these folds themselves.
        """
        return None if self.make_second is None else self.make_second()

    def errors(self, chosen: Sequence[int]) -> Array:
        """Return the RMS errors (n,) [N m or N] of the joints on all rows left out, of the
        model with the chosen effects (their numbers), fitted by its own method."""
        squares, n_rows = (
            self._by_stretch(values, False).sum(axis=0)
            for values in (self._squares(chosen, False), self._n_rows)
        )
        return np.sqrt(squares / np.maximum(n_rows, 1.0))

    def _is_told_by_sliding(self, judged: int | None) -> bool:
        """Return whether the rows in which the joints slide tell of an effect (its
        number): friction that sticks holds any torque. Of a law of that friction they
        tell only if it acts there."""
        return judged is not None and not self._acts_in_slow_rows[judged]

    @cached_property
    def _acts_in_slow_rows(self) -> list[bool]:
        """Which effects are laws of dry friction that act in slow rows."""
        split = self.splits[0]
        numbers = range(len(split.effects))
        return [split.acts_in_slow_rows(k) for k in numbers]

    def _by_stretch(self, values: Array, sliding: bool) -> Array:
        """Return sums (S, n) over all splits of values (splits, 2 S + 1, n) of S stretches
        left out: those of all their rows, or of the ones in which the joints slide."""
        first = self._n_tests if sliding else 0
        return values[:, first : first + self._n_tests].sum(axis=0)

    @property
    def _n_tests(self) -> int:
        """The number S of stretches to judge on."""
        return self._n_rows.shape[1] // 2

    def errors_by_recording(self, chosen: Sequence[int]) -> Array:
        """Return the RMS errors (R + 1, n) [N m or N] of each of R recordings left out,
        and of the rows fitted to, where the joints slide.

        A joint that stands or turns round is held by any torque up to its dry friction:
        such rows tell no harm. The recordings are those of the test run or, without
        one, the searched ones, of which all folds are taken together. ``chosen`` are
        the numbers of the effects.
        """
        n_tests = self._n_tests
        first_stretches = np.arange(0, n_tests + 1, self.n_stretches)
        squares, n_rows = (
            np.add.reduceat(values[:, n_tests:].sum(axis=0), first_stretches)
            for values in (self._squares(chosen, False), self._n_rows)
        )
        return np.sqrt(squares / np.maximum(n_rows, 1))

    @cached_property
    def _n_rows(self) -> Array:
        """(splits, 2 S + 1, n) number of rows, joint by joint: of each split those of
        its stretches in order, then those where the joints slide.
        """
        return np.array([split.n_rows for split in self.splits])

    def _squares(
        self, chosen: Sequence[int], sliding: bool, fitted: _Fitted | None = None
    ) -> Array:
        """Return the sums (splits, 2 S + 1, n) of squared errors [(N m)^2 or N^2] on these
        rows.

        The model with the chosen effects (their numbers) is fitted to each split's
        training rows, all or those in which the joints slide. Each choice is computed
        once. Splits with the same effects are fitted together, so that constraints and
        columns are set up once. ``fitted`` : how; default: by the model's method
        (:func:`fitted_parameters`).
        """
        key = (*sorted(chosen), sliding, fitted)
        fit = fitted or partial(fitted_parameters, frozen=self.frozen)
        if key not in self._known_squares:
            squares = []
            for _, splits in groupby(self.splits, key=lambda x: [*map(id, x.effects)]):
                alike = list(splits)
                columns = alike[0].columns_of(self.estimate, sorted(chosen))
                trains = [s.fitted_rows(sliding).keeping(columns.kept) for s in alike]
                fits = fit(self.estimate, columns.own, columns.new, trains)
                squares.append(_squared_errors(alike, map(columns.with_zeros, fits)))
            self._known_squares[key] = np.concatenate(squares)
        return self._known_squares[key]

    def change(
        self,
        before: Sequence[int],
        after: Sequence[int],
        judged: int | None,
        fitted: _Fitted | None = None,
        joints: Sequence[int] | slice = slice(None),
    ) -> ErrorChange:
        """Return how the sum over joints of their log errors changes from one choice of
        effects (their numbers) to another, in the rows that tell of the effect
        ``judged`` or in all; without a spread on folds, whose motion has chosen the effects.

        Parameters
        ----------
        fitted
            How both are fitted; default: by the model's method.
        joints
            Those of the sum, from 0; default: all.
        """
        sliding = self._is_told_by_sliding(judged)
        squares = (
            self._by_stretch(self._squares(chosen, sliding, fitted), sliding)[:, joints]
            for chosen in (before, after)
        )
        change = change_of(*squares)
        return change if self.source == "test" else change._replace(spread=0.0)

    def drop_harmful(
        self,
        candidates: Sequence[int],
        least_help: Mapping[int, float],
        doubted: Set[int] = frozenset(),
    ) -> list[int]:
        """Drop effects that raise the error on data left out, the most harmful first,
        and those in doubt that do not lower it.

        The harm of an effect is the sum over joints of log(error with it / error
        without it), beside all others, in the rows that tell of it. After each drop the
        others are judged again: those that helped by much (SURE_HELP) only if no other
        one does harm. An effect stays if it helps on the second data, folds of the
        training motion: one motion alone does not decide. A doubted one has to help on both, on one
        of them beyond the spread of a test run.

        Least squares suffice for an effect that helps by far, or has helped by much
        (SURE_HELP) in a fit under all constraints and still does.

        Parameters
        ----------
        least_help
            By the number of an effect: by how much it has to lower the sum of log
            errors to stay. Any other one is dropped only if it raises it by MINOR
            (1 %).
        doubted
            Numbers of the effects whose help has to be shown.

        Returns
        -------
        list of int
            Numbers of the effects that stay.
        """
        accepted = list(candidates)
        confirmed = set[int]()  # by the second data: they stay
        sure = set[int]()  # they helped by much in the last round
        while accepted:
            judged = set(accepted) - confirmed
            harms_of = partial(self._harms, accepted, least_help, doubted)
            harms = harms_of(judged - sure, -CLEAR_HELP)
            if max(harms.values(), default=-np.inf) < 0.0:
                harms |= harms_of(judged & sure, -SURE_HELP)
            sure |= {k for k, harm_of_k in harms.items() if harm_of_k < -SURE_HELP}
            worst = max(harms, key=harms.__getitem__, default=None)
            if worst is None or harms[worst] < 0.0:
                break
            if self._helps_elsewhere(worst, accepted, least_help, doubted):
                confirmed.add(worst)
            else:
                accepted.remove(worst)
        return accepted

    def _harms(
        self,
        accepted: Sequence[int],
        least_help: Mapping[int, float],
        doubted: Set[int],
        judged: Set[int],
        by_least_squares: float,
    ) -> dict[int, float]:
        """Return the harm of each of the ``judged`` effects beside all accepted ones,
        above what is allowed to it.

        It is the sum over joints of log(error with it / error without it), less MINOR,
        or plus the least help of an effect in doubt. Errors are those of fits under all
        constraints, but for effects whose harm by least squares is below
        ``by_least_squares``.
        """
        out = {}
        for k in accepted:
            if k not in judged:
                continue
            without = _without(accepted, k)
            least = least_help.get(k, -MINOR)
            # By least squares first; None: by the model's method, under all constraints.
            for fitted in (least_squares_parameters, None):
                if k in doubted:
                    out[k] = self._missing_help(without, accepted, k, least, fitted)
                else:
                    out[k] = self.change(without, accepted, k, fitted).rise + least
                if out[k] < by_least_squares:
                    break
        return out

    def _missing_help(
        self,
        before: Sequence[int],
        after: Sequence[int],
        judged: int,
        least: float,
        fitted: _Fitted | None = None,
    ) -> float:
        """Return by how much a change of the effects falls short of the help that a
        doubted one needs; negative if it does not.

        It has to lower the sum of log errors on these data and on the second ones, folds
        of the training motion, on one of them by ``least`` and beyond the spread of a
        test run.
        """
        here = self.change(before, after, judged, fitted)
        falls = [-here.rise]
        if self.second is not None:
            falls.append(-self.second.change(before, after, judged, fitted).rise)
        missing = max(least, here.spread) - max(falls)
        return missing if len(falls) == 1 else max(missing, -min(falls))

    def _helps_elsewhere(
        self,
        k: int,
        accepted: Sequence[int],
        least_help: Mapping[int, float],
        doubted: Set[int],
    ) -> bool:
        """Return whether effect k lowers the error on the second data by 1 % (MINOR), or
        by its least help.

        These are folds of the training motion. ``accepted`` are the numbers of all
        effects of the fit, k among them. False if there are no second data, or if the
        effect is doubted.
        """
        if self.second is None or k in doubted:
            return False
        change = self.second.change(_without(accepted, k), accepted, k)
        return change.rise < -least_help.get(k, MINOR)

    def with_helpful(
        self, accepted: Sequence[int], in_doubt: Sequence[int], floor: Array
    ) -> list[int]:
        """Add effects in doubt, one or two at once, while they lower the error on data
        left out.

        Two that help together alone, and two that cancel, are measured as one candidate.
        It is taken if it lowers the sum of the joints' log errors, in the rows that tell
        of them, on these data and on the second ones, folds of the training motion, on
        one of them by 5 % for each effect (SURE_HELP) and beyond the spread of a test
        run. It must raise no joint's error on a recording left out, or on the rows
        fitted to, by more than 5 % (MAX_JOINT_HARM). The best by least squares is judged
        first.

        Parameters
        ----------
        in_doubt
            Numbers of the effects in doubt.
        floor
            (n,) noise [N m or N]; errors below it count as that large.

        Returns
        -------
        list of int
            Numbers of the effects, with those that help.
        """
        accepted = list(accepted)

        def told_by(added: Sequence[int]) -> int:
            """Return the effect whose rows tell of all that are added."""
            by_all_rows = (k for k in added if not self._is_told_by_sliding(k))
            return next(by_all_rows, added[0])

        def helps(added: Sequence[int]) -> bool:
            """Return whether effects help under all constraints, and harm no joint."""
            choices = accepted, [*accepted, *added]
            before, after = (
                np.maximum(self.errors_by_recording(chosen), floor)
                for chosen in choices
            )
            if error_ratios(before, after).max() > 1.0 + MAX_JOINT_HARM:
                return False
            least = SURE_HELP * len(added)
            return self._missing_help(*choices, told_by(added), least) <= 0.0

        while True:
            rest = [k for k in in_doubt if k not in accepted]
            promising = []
            for added in [*combinations(rest, 1), *combinations(rest, 2)]:
                change = self.change(
                    accepted,
                    [*accepted, *added],
                    told_by(added),
                    least_squares_parameters,
                )
                if change.rise < 0.0:
                    promising.append((change.rise, added))
            promising.sort(key=lambda pair: pair[0])
            best = next((added for _, added in promising if helps(added)), None)
            if best is None:
                return accepted
            accepted += best

    def drop_harmful_to_a_joint(
        self, accepted: Sequence[int], floor: Array
    ) -> list[int]:
        """Drop effects that raise the error of one joint, where it slides, on one
        recording left out, or on the rows fitted to, by more than 5 % (MAX_JOINT_HARM),
        until none has.

        The recordings are those of the test run or, without one, the searched ones, of
        which all folds are taken together. The effects are judged together, against the
        errors without any effect: for the error that has risen by most, the effect is
        dropped without which it is lowest, unless another joint's error on the same
        recording would then rise by more. Each effect may raise errors that others lower
        by more: beside them even true effects do.

        Parameters
        ----------
        floor
            (n,) noise [N m or N]; errors below it count as that large.

        Returns
        -------
        list of int
            Numbers of the effects that stay.
        """
        accepted = list(accepted)

        def errors(chosen: Sequence[int]) -> Array:
            """Return the errors with some effects, none below the noise."""
            return np.maximum(self.errors_by_recording(chosen), floor)

        before = errors(())
        is_paid_for = np.zeros(before.shape, bool)
        while accepted:
            now = errors(accepted)
            rise = error_ratios(before, now) * ~is_paid_for
            place = np.unravel_index(np.argmax(rise), rise.shape)
            if rise[place] <= 1.0 + MAX_JOINT_HARM:
                break
            without = {k: errors(_without(accepted, k)) for k in accepted}
            worst = min(accepted, key=lambda k: float(without[k][place]))
            rise_without = error_ratios(now, without[worst])[place[0]].max()
            if rise_without > rise[place]:
                is_paid_for[place] = True
            else:
                accepted.remove(worst)
        return accepted


def _squared_errors(splits: Sequence[HeldOutSplit], thetas: Iterable[Array]) -> Array:
    """Return the sums (splits, 2 S + 1, n) of squared errors on the rows to judge on, of
    splits of the same rows with parameters (p,) each."""
    signed = np.stack([np.append(theta, -1.0) for theta in thetas], axis=1)
    out = []
    for of_splits in zip(*(split.judged for split in splits), strict=True):
        squares = (of_splits[0].columns @ signed) ** 2  # (n, M, splits)
        sums = [rows.stretches @ squares[:, :, [k]] for k, rows in enumerate(of_splits)]
        out.append(np.stack(sums)[..., 0])
    return np.concatenate(out, axis=2).transpose(0, 2, 1)


def _without(accepted: Sequence[int], k: int) -> list[int]:
    """Return the numbers of the effects without effect k."""
    return [number for number in accepted if number != k]


def error_ratios(before: Array, after: Array) -> Array:
    """Return after / before of errors; 1 where both are zero."""
    tiny = 1e-300  # no division by 0
    return np.maximum(after, tiny) / np.maximum(before, tiny)


class ErrorChange(NamedTuple):
    """How the sum over joints of their log errors changes."""

    #: The change: 0.01 is about one joint's error rising by 1 %.
    rise: float
    #: Half its 95 % interval.
    spread: float


def change_of(before: Array, after: Array) -> ErrorChange:
    """Return the change from errors whose sums of squares in stretches of time are
    ``before`` (S, n) to those of ``after``, with its spread between the stretches, by the
    jackknife."""

    def rise(before: Array, after: Array) -> Array:
        """Return half the sum over joints of log(after / before), of sums of squares."""
        return np.asarray(0.5 * np.sum(np.log(error_ratios(before, after)), axis=-1))

    sums = before.sum(axis=0), after.sum(axis=0)
    n_stretches = len(before)
    _, std = jackknifed(rise(sums[0] - before, sums[1] - after))
    half = student_95(n_stretches) * float(std) if n_stretches > 1 else np.inf
    return ErrorChange(float(rise(*sums)), half)


class _Table:
    """The columns of a model and of effects on filtered rows.

    Regressions of any selection of rows are made from it. If the model is held fixed
    (``frozen``), the target is the model's residual, and only effects have columns.
    """

    def __init__(self, rows: SegmentedRuns, estimate: Estimate, frozen: bool) -> None:
        """Compute the model's columns on filtered rows; those of effects follow when
        they are needed."""
        self.rows = rows
        self.estimate = estimate
        self.frozen = frozen
        self.own_columns = model_columns(rows, estimate, frozen)
        #: The effects of the last call, and the columns with them.
        self._last: tuple[tuple[Effect, ...], Array] | None = None

    def columns(self, effects: tuple[Effect, ...]) -> Array:
        """Return the columns (n joints, M rows, p + 1) of the model and of effects.

        The last column is the target: the torque, or the residual of a fixed model. The
        columns of the last call are kept.
        """
        if self._last is None or self._last[0] is not effects:
            torque = self.rows.residual if self.frozen else self.rows.torque
            of_effects = [spread_columns(self.rows, e) for e in effects]
            blocks = [self.own_columns, *of_effects, torque.T[:, :, None]]
            self._last = effects, np.concatenate(blocks, axis=2)
        return self._last[1]

    def compressed(self, effects: tuple[Effect, ...], keep: Mask) -> Regression:
        """Return the regression of some rows, compressed to the products of its columns.

        Parameters
        ----------
        effects
            The effects in addition to the model.
        keep
            (M, n) flags: which rows count for which joint.
        """
        own_effects = () if self.frozen else self.estimate.model.effects
        parameters = tuple(p for e in (*own_effects, *effects) for p in e.parameters)
        of_joints = self.columns(effects)
        rows = [x[kept] for x, kept in zip(of_joints, keep.T, strict=True)]
        return ProductRegression.from_rows(parameters, rows)


def _make_split(
    effects: tuple[Effect, ...],
    train: _Table,
    train_rows: Mask,
    test: _Table,
    stretches: Sequence[Mask],
) -> HeldOutSplit:
    """Make a split for a model with effects: of the rows to fit to, and of the stretches
    to judge on, (M, n) flags each."""
    slides = where_joints_slide(test.rows)
    sliding_rows = train_rows & where_joints_slide(train.rows)
    judged = [(test, [*stretches, *(rows & slides for rows in stretches)])]
    if test is train:
        judged[0][1].append(sliding_rows)
    else:
        judged.append((train, [sliding_rows]))
    return HeldOutSplit(
        effects=effects,
        train=train.compressed(effects, train_rows),
        sliding=train.compressed(effects, sliding_rows),
        judged=tuple(
            JudgedRows.from_masks(table.columns(effects), masks)
            for table, masks in judged
        ),
        frozen=train.frozen,
    )


def _errors_of_folds(
    table: _Table, effects: tuple[Effect, ...], by_fold: Mapping[int, Sequence[Effect]]
) -> HeldOut:
    """Prepare the errors on three folds (THIRDS) of the searched rows by the phase of the
    motion; by_fold : by the number of an effect, the one to use for each fold instead."""
    fold = folds_of(table.rows, THIRDS)
    stretches, n_stretches = rows_by_stretch(table.rows)
    splits = []
    for number in range(fold.max() + 1):
        its_effects = effects
        if by_fold:
            replaced = {k: of_folds[number] for k, of_folds in by_fold.items()}
            its_effects = tuple(replaced.get(k, e) for k, e in enumerate(effects))
        is_left_out = (fold == number)[:, None]
        left_out = [rows & is_left_out for rows in stretches]
        train_rows = table.rows.keep & ~is_left_out
        splits.append(_make_split(its_effects, table, train_rows, table, left_out))
    return HeldOut(table.estimate, table.frozen, splits, "folds", n_stretches)


@dataclass(frozen=True)
class HeldOutData:
    """The data that decide whether findings stay: a test run, or folds of training."""

    #: The model before the diagnosis.
    first: Estimate
    #: Filtered rows of a run that was not searched, or None (folds of the searched rows
    #: then take its place).
    test: SegmentedRuns | None
    #: Whether the model is held fixed.
    frozen: bool

    def held_out_errors(
        self,
        rows: SegmentedRuns,
        effects: Sequence[Effect],
        estimate: Estimate,
        by_fold: Mapping[int, Sequence[Effect]] | None = None,
    ) -> HeldOut:
        """Prepare the errors on data left out of a model with any of these effects.

        The model is judged on the test run. Without one, it is fitted to all folds but
        one and judged on that one, in turn; folds are intervals of the motion's phase.

        Parameters
        ----------
        rows
            The rows that were searched.
        effects
            The effects, which are then chosen by number.
        estimate
            The model to which effects are added.
        by_fold
            By the number of an effect: the effect to use for each fold instead,
            computed from the rows outside of the fold. A measured curve needs that,
            since its table is itself a fit.

        Returns
        -------
        HeldOut
            The errors, computed when they are needed.
        """
        effects = tuple(effects)
        table = _Table(rows, estimate, self.frozen)
        errors_of_folds = partial(_errors_of_folds, table, effects, by_fold or {})
        if self.test is None:
            return errors_of_folds()
        # Torque-dependent columns follow from the same model as in the searched rows.
        test = _Table(self.test.with_model(*rows.attached), estimate, self.frozen)
        stretches, n_stretches = rows_by_stretch(test.rows)
        return HeldOut(
            estimate,
            self.frozen,
            splits=(_make_split(effects, table, rows.keep, test, stretches),),
            source="test",
            n_stretches=n_stretches,
            make_second=errors_of_folds,
        )


def where_joints_slide(rows: SegmentedRuns) -> Mask:
    """Return the flags (M, n): which rows count for which joint, and it slides in them.

    A joint that slides in too few of them keeps all.
    """
    slides = rows.keep & rows.slides
    has_enough = slides.sum(axis=0) >= FEWEST_SLIDING
    return np.where(has_enough, slides, rows.keep)


def rows_by_stretch(rows: SegmentedRuns) -> tuple[list[Mask], int]:
    """Return for each stretch of each recording the flags (M, n): which of its rows count
    for which joint; and the number of stretches of a recording.

    Recordings are cut so that there are PARTS (8) stretches or more in all.
    """
    runs = np.unique(rows.run)
    n_stretches = -(-PARTS // len(runs))
    out = []
    for number in runs:
        its_rows = np.flatnonzero(rows.run == number)
        for stretch in np.array_split(its_rows, n_stretches):
            is_in_it = np.zeros((len(rows.run), 1), bool)
            is_in_it[stretch] = True
            out.append(rows.keep & is_in_it)
    return out, n_stretches


def with_replaced_joints(
    effects: Sequence[Effect], new: Sequence[Effect]
) -> tuple[list[Effect], list[bool]]:
    """Remove effects from the joints on which a new effect of the same name acts.

    New effects of the whole robot, and those of which a joint may have several, replace
    nothing.

    Parameters
    ----------
    effects
        Effects, such as those of a model.

    Returns
    -------
    list of Effect
        The effects on their remaining joints; those without any are left out.
    list of bool
        For each parameter of ``effects``, in order, whether it remains.
    """
    replacing = [e for e in new if not (e.whole_robot or e.several)]
    replaced = {(e.name, j) for e in replacing for j in e.joints}
    out = list[Effect]()
    remains = list[bool]()
    for e in effects:
        joints = [j for j in e.joints if (e.name, j) not in replaced]
        keeps_all = len(joints) == len(e.joints)
        if keeps_all:
            remains += [True] * len(e.parameters)
        else:
            remains += [p.joint - 1 in joints for p in e.parameters]
        if joints:
            out.append(e if keeps_all else type(e)(e.robot, joints, **e.shape))
    return out, remains


def least_squares_parameters(
    estimate: Estimate,
    own_effects: Sequence[Effect],
    new: Sequence[Effect],
    data: Sequence[Regression],
) -> list[Array]:
    """Fit effects to each of several sets of rows by least squares, with no prior but
    the plausible sizes of the effects; return their parameters for each set.

    own_effects : of the model, which are fitted again; new : beside these. Joints are
    weighted by their residuals in a first fit.
    """
    effects = (*own_effects, *new)
    if not effects:
        return [np.zeros(0) for _ in data]
    model = replace(estimate.model, effects=effects, reference=None)
    out = []
    for rows in data:
        weighted, *_ = weighted_by_residuals(rows, model)
        out.append(model.with_known(weighted.nearest(0.0)))
    return out


def estimator_beside(estimate: Estimate) -> Estimator:
    """Return the estimator that fits new effects to the residual of a fixed model.

    It is the model's own if that solves convex problems (it then has a ``solver``);
    else the default one, since a payload has the constraints of a rigid body.
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
    """Set up the fit of new effects alone to the residual of a fixed model.

    Parameters
    ----------
    estimate
        The model that is held fixed.
    own_model
        The new effects, as a model of their own.
    left
        A regression of the fixed model's residual on the columns of the new effects.
    seed
        Seed of the estimator's random numbers.
    progress
        Is called with a short text.

    Returns
    -------
    Task
        The problem under the new effects' constraints, for an estimator.
    """
    problem = estimate.problem
    data, weights, _ = weighted_by_residuals(left, own_model)
    return Task(
        model=own_model,
        data=data,
        constraints=ConstraintSet(problem.constraints(own_model).convex),
        bound=problem.parameter_bound(own_model),
        nominal=problem.nominal(own_model),
        box=problem.box,
        seed=seed,
        progress=progress,
        weights=weights,
    )


def fitted_parameters(
    estimate: Estimate,
    own_effects: Sequence[Effect],
    new: Sequence[Effect],
    data: Sequence[Regression],
    frozen: bool,
) -> list[Array]:
    """Fit a model with new effects to several sets of rows, by the model's method.

    Parameters
    ----------
    estimate
        The model, whose method and constraints are used.
    own_effects
        The model's effects that stay; empty if ``frozen``.
    new
        Effects that are added to them.
    data
        Sets of rows, each a regression on the columns of all these effects.
    frozen
        True: only the new effects are fitted, to the residual of the fixed model.

    Returns
    -------
    list of (p,) arrays
        For each set of rows the parameters, in SI units.
    """
    effects = (*own_effects, *new)
    if not effects:
        return [np.zeros(0) for _ in data]
    model = replace(estimate.model, effects=effects, reference=None)
    method = estimator_beside(estimate) if frozen else estimate.estimator
    weighting = estimate.weighting
    tasks = [
        task_beside(estimate, model, rows)
        if frozen
        else make_task(estimate.problem, model, rows, weighting)
        for rows in data
    ]
    return [model.with_known(fit.theta) for fit in method.fit_each(tasks)]
