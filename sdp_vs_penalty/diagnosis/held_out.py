"""The error that falls along the ladder, on data that no choice has seen.

At each step the model is fitted as ``add`` would fit it, by its own method under its problem's
constraints, and on a test run it is judged on the rows on which ``compare`` judges it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.ladder import climbed
from sdp_vs_penalty.diagnosis.library import Key, spread_columns
from sdp_vs_penalty.diagnosis.refit import fitted_parameters, model_beside, weighting_of
from sdp_vs_penalty.diagnosis.rows import with_estimate
from sdp_vs_penalty.diagnosis.search import Found
from sdp_vs_penalty.diagnosis.stage import Stage, informative, model_columns
from sdp_vs_penalty.diagnosis.state import Pick, SearchState
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.identify import with_reference
from sdp_vs_penalty.regression.regression import Factor, Regression, TimeBlock, compress, triangular
from sdp_vs_penalty.robot.arrays import Array

#: By this share an error falls, rather than merely not rising.
_FALLS = 0.001
#: Outer folds at most: the search is repeated without each of them.
_OUTER = 5


@dataclass(frozen=True)
class HeldOut:
    """before (n,) : RMSE of each joint with the shape constants that the model was given; ladder
    (steps + 1, n) : with those that the search adopted, before the first effect and after each; source :
    "test" or "folds"; holds (steps,) : whether the error of a joint on which an effect acts falls on
    data from which its size was not estimated (the test run, or folds left out); rises (steps,) :
    whether it rises on all of them there."""

    before: Array
    ladder: Array
    source: str
    holds: tuple[bool, ...]
    rises: tuple[bool, ...]


@dataclass(frozen=True)
class OnTest:
    """Errors on a test run of models fitted to the runs that were searched."""

    found: Found
    data: Measurements
    test: Measurements

    def errors(self, picks: Sequence[Pick]) -> HeldOut:
        first, effects = self.found.first, [p.candidate.effect for p in picks]
        ladder = self._ladder(self.found.estimate, effects)
        before = ladder[0] if first is self.found.estimate else self._ladder(first, [])[0]
        return HeldOut(before, ladder, "test", *_told(picks, ladder))

    def _ladder(self, estimate: Estimate, effects: Sequence[Effect]) -> Array:
        """(steps + 1, n) RMSE."""
        frozen, settings = self.found.state.stage.frozen, estimate.preprocessing
        model = model_beside(estimate, effects)
        if model.needs_reference and not frozen:
            model = with_reference(
                estimate.problem,
                model,
                lambda part: compress(self.data, part, settings),
                weighting_of(estimate),
            )
        train, there = (compress(m, model, settings) for m in (self.data, self.test))
        if frozen:
            train, there = (rows.beside(estimate.theta) for rows in (train, there))
        squares = _squares(estimate, frozen, effects, train, there)
        return np.asarray(np.sqrt(squares / np.maximum(there.joint_rows(), 1)))


@dataclass(frozen=True)
class OnFolds:
    """Errors on outer folds: which of the picks of the whole search are justified without each of them,
    with which shapes and sizes, is searched anew."""

    found: Found

    def errors(self, picks: Sequence[Pick]) -> HeldOut:
        stage, now = self.found.state.stage, self.found.estimate
        given, first = stage, self.found.first
        if first is not now:
            rows = with_estimate(stage.rows, first)
            columns = model_columns(rows, first, stage.frozen)
            given = replace(stage, rows=rows, columns=columns, residual=rows.residual)
        total = np.zeros((len(picks) + 1, stage.rows.n))
        same, before = np.zeros_like(total), np.zeros(stage.rows.n)
        for train, own in self._searched:
            total += _matched(now, stage, picks, own, train)
            same += _left_out(now, stage, picks, train)
            before += _left_out(first, given, (), train)[0]
        count = np.maximum(stage.rows.keep.sum(axis=0), 1)
        told = _told(picks, np.sqrt(same / count))
        return HeldOut(np.sqrt(before / count), np.sqrt(total / count), "folds", *told)

    @cached_property
    def _searched(self) -> list[tuple[NDArray[np.bool_], tuple[Pick, ...]]]:
        """Of each fold the rows (M,) outside of it, and what a search in those picks."""
        stage = self.found.state.stage
        outer, keys = stage.labels.fold % _OUTER, _looked_for(self.found.state.picks)
        out = []
        for f in np.unique(outer):
            train = outer != f
            start = SearchState.start(_stage_on(stage, train, keys))
            out.append((train, climbed(start, thorough=False).picks))
        return out


def _squares(
    estimate: Estimate, frozen: bool, effects: Sequence[Effect], train: Regression, there: Regression
) -> Array:
    """(steps + 1, n) squared errors on the rows ``there`` of the model with the first effects, fitted to
    the rows ``train`` at each step; of a frozen model both are what it leaves."""
    ends = np.cumsum([train.p - sum(len(e.parameters) for e in effects), *map(_size, effects)])
    out = []
    for k, end in enumerate(ends):
        wanted = np.arange(train.p) < end
        theta = fitted_parameters(estimate, effects[:k], train.keeping(wanted), frozen)
        out.append(there.keeping(wanted).joint_losses(theta))
    return np.array(out)


def _size(effect: Effect) -> int:
    return len(effect.parameters)


def _left_out(
    estimate: Estimate, stage: Stage, picks: Sequence[Pick], train: NDArray[np.bool_]
) -> Array:
    """(steps + 1, n) squared errors on the stage's other rows."""
    effects, rows = [p.candidate.effect for p in picks], stage.rows
    columns = [stage.columns, *(spread_columns(rows, effect) for effect in effects)]
    own = () if stage.frozen else estimate.model.effects
    parameters = tuple(p for effect in (*own, *effects) for p in effect.parameters)
    torque = stage.residual.copy()
    if not stage.frozen:
        torque += (stage.columns @ estimate.theta).T
    rows_of = np.concatenate([np.concatenate(columns, axis=2), torque.T[:, :, None]], axis=2)
    blocks = (TimeBlock(0, 0.0, 0.0), TimeBlock(0, 0.0, 0.0))
    factors = []
    for j in range(rows.n):
        for block, mine in enumerate((train, ~train)):
            kept = rows_of[j][mine & rows.keep[:, j]]
            indices = np.arange(len(parameters))
            factors.append(Factor(j, block, indices, triangular([kept]), len(kept)))
    both = Regression(parameters, rows.n, blocks, tuple(factors), oversampling=1.0)
    return _squares(estimate, stage.frozen, effects, both.select([0]), both.select([1]))


def _matched(
    estimate: Estimate,
    stage: Stage,
    picks: Sequence[Pick],
    own: Sequence[Pick],
    train: NDArray[np.bool_],
) -> Array:
    """(steps + 1, n) squared errors left out, at each step with those of a fold's ``own`` picks that are
    the same effect on the same joint as a pick up to there: a fold finds them in another order."""
    step: dict[Key, int] = {}
    for k, pick in enumerate(picks):
        step.setdefault(pick.candidate.key, k)
    same = sorted((p for p in own if p.candidate.key in step), key=lambda p: step[p.candidate.key])
    steps = np.array([step[p.candidate.key] for p in same], int)
    squares = _left_out(estimate, stage, same, train)
    return squares[np.searchsorted(steps, np.arange(len(picks) + 1), side="left")]


def _told(picks: Sequence[Pick], ladder: Array) -> tuple[tuple[bool, ...], tuple[bool, ...]]:
    """Of each pick whether the error falls on a joint on which it acts, and whether it rises on all."""
    steps = [(pick, ladder[k], ladder[k + 1]) for k, pick in enumerate(picks)]
    return tuple(_falls(*step) for step in steps), tuple(_rises(*step) for step in steps)


def _falls(pick: Pick, before: Array, after: Array) -> bool:
    acts = _acts(pick)
    return bool(np.any(after[acts] < (1.0 - _FALLS) * before[acts]))


def _rises(pick: Pick, before: Array, after: Array) -> bool:
    acts = _acts(pick)
    return bool(np.all(after[acts] > (1.0 + _FALLS) * before[acts]))


def _acts(pick: Pick) -> list[int] | slice:
    effect = pick.candidate.effect
    return slice(None) if effect.whole_robot else list(effect.joints)


def _looked_for(picks: Sequence[Pick]) -> frozenset[Key]:
    """The picks' effects on their joints, and the plainer ones without which they are not looked for."""
    effects = [(p.candidate.effect, p.candidate.key[1]) for p in picks]
    plainer = {(name, joint) for effect, joint in effects for name in effect.refines}
    return frozenset(plainer | {p.candidate.key for p in picks})


def _stage_on(stage: Stage, train: NDArray[np.bool_], keys: frozenset[Key]) -> Stage:
    """The same stage with some of the rows, all others switched off, and some of the candidates."""
    off = ~train[:, None] | ~stage.rows.keep
    rows = stage.rows.with_masked(off)
    labels = replace(stage.labels, count=informative(rows, stage.noise))
    return replace(stage, rows=rows, labels=labels, candidacy=replace(stage.candidacy, keys=keys))
