"""The error that falls along the ladder, on data that no choice has seen.

At each step the model is fitted as ``add`` would fit it, by its own method under its problem's
constraints, and on a test run it is judged on the rows on which ``compare`` judges it. Whether a finding
holds there is told by the rows that are evidence for or against it: where nothing repeats, those during
which the joint moves (:mod:`~sdp_vs_penalty.signals.stillness`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
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
from sdp_vs_penalty.regression.regression import (
    Factor,
    Regression,
    TimeBlock,
    compress,
    compress_cells,
    triangular,
)
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import RESIDUAL
from sdp_vs_penalty.signals.segments import segmented
from sdp_vs_penalty.signals.stillness import STILL

#: What lowers its joints' errors by less than this share, summed over them, does not pay ...
_PAYS = 0.001
#: ... and where the noise is a guess: evidence counts the model's own error then.
_PAYS_GUESSED = 0.003
#: Outer folds at most: the search is repeated without each of them.
_OUTER = 5


@dataclass(frozen=True)
class HeldOut:
    """before (n,) : RMSE of each joint with the shape constants that the model was given; ladder
    (steps + 1, n) : with those that the search adopted, before the first effect and after each; source :
    "test" or "folds"; pays (steps,) : whether an effect lowers the errors of the joints that it acts on,
    on rows from which its size was not estimated (the test run's, or folds left out) and that are
    evidence; moving (n,) : RMSE of those rows after the last effect."""

    before: Array
    ladder: Array
    source: str
    pays: tuple[bool, ...]
    moving: Array


@dataclass(frozen=True)
class OnTest:
    """Errors on a test run of models fitted to the runs that were searched."""

    found: Found
    data: Measurements
    test: Measurements

    def errors(self, picks: Sequence[Pick]) -> HeldOut:
        found, effects = self.found, [p.candidate.effect for p in picks]
        frozen, (split,) = found.state.stage.frozen, self._kept.of(effects, self._splits)
        evidence, every = (
            _rmse(x, rows.joint_rows())
            for x, rows in zip(_ladder(found.estimate, frozen, effects, split), split.there, strict=True)
        )

        def squares(chosen: Sequence[int]) -> Array:
            return _squares(found.estimate, frozen, [effects[k] for k in chosen], split)[0]

        before = every[0] if found.first is found.estimate else self._before
        told = _told(picks, evidence, squares, found.state.stage.noise.source == RESIDUAL)
        return HeldOut(before, every, "test", told, evidence[-1])

    @cached_property
    def _kept(self) -> _Kept:
        return _Kept()

    def _splits(self, effects: Sequence[Effect]) -> list[_Split]:
        return [self._split(self.found.estimate, effects)]

    @cached_property
    def _before(self) -> Array:
        """(n,) errors of the model as it was given."""
        first, own = self.found.first, self._split(self.found.first, ())
        squares = _squares(first, self.found.state.stage.frozen, (), own)[1]
        return _rmse(squares, own.there[1].joint_rows())

    def _split(self, estimate: Estimate, effects: Sequence[Effect]) -> _Split:
        """The rows of both runs in the columns of the model and of all effects."""
        frozen, settings = self.found.state.stage.frozen, estimate.preprocessing
        model = model_beside(estimate, effects, changes=frozen)
        if model.needs_reference and not frozen:
            model = with_reference(
                estimate.problem,
                model,
                lambda part: compress(self.data, part, settings),
                weighting_of(estimate),
            )
        train = compress(self.data, model, settings)
        there = compress_cells(self.test, model, settings, self._cells)
        if frozen:
            train, there = (rows.beside(estimate.theta) for rows in (train, there))
        return _Split(tuple(effects), train, (there.select([0]), there))

    @cached_property
    def _cells(self) -> _Evidence:
        """Which rows of the test run are evidence: where nothing repeats, not those of standstill."""
        found = self.found
        if found.state.stage.noise.source != RESIDUAL:
            return _Evidence({})
        rows = segmented(self.test, found.estimate.preprocessing)
        return _Evidence(
            {k: (rows.t[m], rows.still[m]) for k in set(rows.run) if (m := rows.run == k).any()}
        )


@dataclass(frozen=True)
class _Evidence:
    """Two cells: the rows that are evidence, and the others; still : by run, instants (M,) and how much
    of a row there a joint stood still (M, n)."""

    still: Mapping[int, tuple[Array, Array]]
    places = ((0, 0.0, 0.0), (0, 0.0, 0.0))

    def cell(self, run: int, t: Array) -> NDArray[np.intp]:
        if run not in self.still:
            return np.zeros(len(t), np.intp)
        at, still = self.still[run]
        return np.array([np.interp(t, at, s) > STILL for s in still.T], np.intp).T


@dataclass(frozen=True)
class OnFolds:
    """Errors on outer folds: which of the picks of the whole search are justified without each of them,
    with which shapes and sizes, is searched anew."""

    found: Found

    def errors(self, picks: Sequence[Pick]) -> HeldOut:
        stage, now = self.found.state.stage, self.found.estimate
        effects, frozen = [p.candidate.effect for p in picks], stage.frozen
        splits = self._kept.of(effects, self._splits)
        total = np.sum(
            [_matched(now, stage, picks, own, train) for train, own in self._searched], axis=0
        )
        same = np.sum([_ladder(now, frozen, effects, split)[0] for split in splits], axis=0)

        def squares(chosen: Sequence[int]) -> Array:
            own = [effects[k] for k in chosen]
            return np.sum([_squares(now, frozen, own, split)[0] for split in splits], axis=0)

        keep = stage.rows.keep
        count, evident = keep.sum(axis=0), (keep & _evident(stage)).sum(axis=0)
        evidence = _rmse(same, evident)
        told = _told(picks, evidence, squares, stage.noise.source == RESIDUAL)
        return HeldOut(_rmse(self._before, count), _rmse(total, count), "folds", told, evidence[-1])

    @cached_property
    def _kept(self) -> _Kept:
        return _Kept()

    def _splits(self, effects: Sequence[Effect]) -> list[_Split]:
        stage, now = self.found.state.stage, self.found.estimate
        return [_left_out(now, stage, effects, train) for train, _ in self._searched]

    @cached_property
    def _before(self) -> Array:
        """(n,) squared errors of the model as it was given."""
        stage, first = self.found.state.stage, self.found.first
        if first is not self.found.estimate:
            rows = with_estimate(stage.rows, first)
            columns = model_columns(rows, first, stage.frozen)
            stage = replace(stage, rows=rows, columns=columns, residual=rows.residual)
        splits = [_left_out(first, stage, (), train) for train, _ in self._searched]
        return np.asarray(np.sum([_squares(first, stage.frozen, (), s)[1] for s in splits], axis=0))

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


@dataclass(frozen=True)
class _Split:
    """Rows in the columns of a model and of effects, or of what a frozen model leaves in those of the
    effects: ``train`` to fit to, ``there`` to judge on, those that are evidence and all; known : squared
    errors with some of the effects."""

    effects: tuple[Effect, ...]
    train: Regression
    there: tuple[Regression, Regression]
    known: dict[tuple[int, ...], Array] = field(default_factory=dict, init=False)


class _Kept:
    """The splits of the effects that were first asked for, which later ones are among."""

    def __init__(self) -> None:
        self.splits: list[_Split] = []

    def of(
        self, effects: Sequence[Effect], made: Callable[[Sequence[Effect]], list[_Split]]
    ) -> list[_Split]:
        have = {id(e) for s in self.splits[:1] for e in s.effects}
        if not self.splits or not have.issuperset(map(id, effects)):
            self.splits = made(effects)
        return self.splits


def _squares(estimate: Estimate, frozen: bool, own: Sequence[Effect], split: _Split) -> Array:
    """(2, n) squared errors on the rows to judge on of the model with these effects, of those split."""
    chosen = tuple(k for k, e in enumerate(split.effects) if any(e is x for x in own))
    if chosen not in split.known:
        sizes = [len(e.parameters) for e in split.effects]
        picked = np.repeat(np.isin(np.arange(len(sizes)), chosen), sizes)
        wanted = np.concatenate([np.ones(split.train.p - len(picked), bool), picked])
        theta = fitted_parameters(estimate, own, split.train.keeping(wanted), frozen)
        split.known[chosen] = np.array([x.keeping(wanted).joint_losses(theta) for x in split.there])
    return split.known[chosen]


def _ladder(estimate: Estimate, frozen: bool, effects: Sequence[Effect], split: _Split) -> Array:
    """(2, steps + 1, n) the same of the model with the first effects, one step after the other."""
    steps = range(len(effects) + 1)
    return np.stack([_squares(estimate, frozen, effects[:k], split) for k in steps], axis=1)


def _rmse(squares: Array, rows: NDArray[np.int64]) -> Array:
    return np.asarray(np.sqrt(squares / np.maximum(rows, 1)))


def _left_out(
    estimate: Estimate, stage: Stage, effects: Sequence[Effect], train: NDArray[np.bool_]
) -> _Split:
    """The stage's rows to fit to, and all others to judge on."""
    rows = stage.rows
    columns = [stage.columns, *(spread_columns(rows, effect) for effect in effects)]
    own = () if stage.frozen else estimate.model.effects
    parameters = tuple(p for effect in (*own, *effects) for p in effect.parameters)
    torque = stage.residual.copy()
    if not stage.frozen:
        torque += (stage.columns @ estimate.theta).T
    rows_of = np.concatenate([np.concatenate(columns, axis=2), torque.T[:, :, None]], axis=2)
    blocks = tuple(TimeBlock(0, 0.0, 0.0) for _ in range(3))
    factors = []
    for j in range(rows.n):
        counts = _evident(stage)[:, j]
        for block, mine in enumerate((train, ~train & counts, ~train & ~counts)):
            kept = rows_of[j][mine & rows.keep[:, j]]
            indices = np.arange(len(parameters))
            factors.append(Factor(j, block, indices, triangular([kept]), len(kept)))
    both = Regression(parameters, rows.n, blocks, tuple(factors), oversampling=1.0)
    return _Split(tuple(effects), both.select([0]), (both.select([1]), both.select([1, 2])))


def _evident(stage: Stage) -> NDArray[np.bool_]:
    """(M, n) which rows are evidence for or against a law: where nothing repeats, those of motion."""
    known = stage.noise.source != RESIDUAL
    return np.ones_like(stage.rows.keep) if known else stage.rows.still <= STILL


def _matched(
    estimate: Estimate,
    stage: Stage,
    picks: Sequence[Pick],
    own: Sequence[Pick],
    train: NDArray[np.bool_],
) -> Array:
    """(steps + 1, n) squared errors on all rows left out, at each step with those of a fold's ``own``
    picks that are the same effect on the same joint as a pick up to there: it finds them in another
    order."""
    step: dict[Key, int] = {}
    for k, pick in enumerate(picks):
        step.setdefault(pick.candidate.key, k)
    same = sorted((p for p in own if p.candidate.key in step), key=lambda p: step[p.candidate.key])
    steps = np.array([step[p.candidate.key] for p in same], int)
    effects = [p.candidate.effect for p in same]
    squares = _ladder(estimate, stage.frozen, effects, _left_out(estimate, stage, effects, train))[1]
    return squares[np.searchsorted(steps, np.arange(len(picks) + 1), side="left")]


def _told(
    picks: Sequence[Pick],
    ladder: Array,
    squares: Callable[[Sequence[int]], Array],
    guessed: bool = False,
) -> tuple[bool, ...]:
    """Of each pick whether the errors of the joints on which it acts fall by what pays. ladder
    (steps + 1, n) : with the first picks; squares : (n,) of any picks, by which those are judged beside
    all others that do not pay where they stand: some need a later one."""
    needed, steps = _PAYS_GUESSED if guessed else _PAYS, zip(picks, ladder[:-1], ladder[1:], strict=True)
    change = [_change(pick, before, after) for pick, before, after in steps]
    kept = list(range(len(picks)))
    for k in sorted((k for k in kept if change[k] >= -needed), key=lambda k: -change[k]):
        others = [m for m in kept if m != k]
        if 0.5 * _change(picks[k], squares(others), squares(kept)) >= -needed:
            kept = others
    return tuple(k in kept for k in range(len(picks)))


def _change(pick: Pick, before: Array, after: Array) -> float:
    """The logarithms' change, summed over the joints on which a pick acts."""
    before, after = (np.maximum(x[_acts(pick)], 1e-300) for x in (before, after))
    return float(np.sum(np.log(after / before)))


def _acts(pick: Pick) -> list[int] | slice:
    effect = pick.candidate.effect
    return slice(None) if effect.whole_robot or effect.spreads else list(effect.joints)


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
    return replace(stage, rows=rows, labels=labels, candidacy=stage.candidacy.only(keys))
