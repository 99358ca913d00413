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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.ladder import climbed
from sdp_vs_penalty.diagnosis.library import Key, spread_columns
from sdp_vs_penalty.diagnosis.refit import fitted_parameters, model_beside, weighting_of
from sdp_vs_penalty.diagnosis.rows import with_estimate
from sdp_vs_penalty.diagnosis.search import Found
from sdp_vs_penalty.diagnosis.stage import Stage, model_columns
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
from sdp_vs_penalty.signals.segments import SegmentedRuns, segmented
from sdp_vs_penalty.signals.stillness import SLOW, STILL

#: What lowers its joints' errors by less than this share, summed over them, does not pay ...
_PAYS = 0.001
#: ... and where the noise is a guess: evidence counts the model's own error then.
_PAYS_GUESSED = 0.003
#: What lowers no joint's error by this share is minor where the noise is a guess: from fold to fold the
#: change by small findings spreads by half of that and more (0.5 to 5 % of 4 findings).
MINOR = 0.01
#: Outer folds at most: the search is repeated without each of them.
_OUTER = 5


@dataclass(frozen=True)
class HeldOut:
    """before (n,) : RMSE of each joint with the shape constants that the model was given; ladder
    (steps + 1, n) : with those that the search adopted, before the first effect and after each; source :
    "test" or "folds"; pays (steps,) : whether an effect lowers the errors of the joints that it acts on,
    on rows from which its size was not estimated (the test run's, or folds left out) and that are
    evidence; minor (steps,) : whether beside all others it lowers none of them by more than chance
    would; moving (n,) : RMSE of those rows after the last effect."""

    before: Array
    ladder: Array
    source: str
    pays: tuple[bool, ...]
    minor: tuple[bool, ...]
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
        _, evidence, every = (
            _rmse(x, rows.joint_rows())
            for x, rows in zip(_ladder(found.estimate, frozen, effects, split), split.there, strict=True)
        )

        def squares(chosen: Sequence[int]) -> Array:
            return _squares(found.estimate, frozen, [effects[k] for k in chosen], split)

        before = every[0] if found.first is found.estimate else self._before
        told = _told(picks, squares, found.state.stage.noise.source == RESIDUAL)
        return HeldOut(before, every, "test", *told, evidence[-1])

    @cached_property
    def _kept(self) -> _Kept:
        return _Kept()

    def _splits(self, effects: Sequence[Effect]) -> list[_Split]:
        return [self._split(self.found.estimate, effects)]

    @cached_property
    def _before(self) -> Array:
        """(n,) errors of the model as it was given."""
        first, own = self.found.first, self._split(self.found.first, ())
        squares = _squares(first, self.found.state.stage.frozen, (), own)[-1]
        return _rmse(squares, own.there[-1].joint_rows())

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
        return _Split.of(effects, train, there)

    @cached_property
    def _cells(self) -> _Cells:
        """Which rows of the test run are evidence."""
        rows = segmented(self.test, self.found.estimate.preprocessing)
        kinds = _kinds(rows, self.found.state.stage.noise.source == RESIDUAL)
        return _Cells({k: (rows.t[m], kinds[m]) for k in set(rows.run) if (m := rows.run == k).any()})


def _kinds(rows: SegmentedRuns, guessed: bool) -> NDArray[np.intp]:
    """(M, n) kind of each row: 0 the joint slides, 1 it is slow, 2 it stands still and that is no
    evidence, because the noise is a ``guessed`` one."""
    return np.where(guessed & (rows.still > STILL), 2, rows.slow > SLOW).astype(np.intp)


@dataclass(frozen=True)
class _Cells:
    """A cell a kind of rows; kinds : by run, instants (M,) and kinds (M, n) there."""

    kinds: Mapping[int, tuple[Array, NDArray[np.intp]]]
    places = ((0, 0.0, 0.0),) * 3

    def cell(self, run: int, t: Array) -> NDArray[np.intp]:
        if run not in self.kinds:
            return np.zeros(len(t), np.intp)
        at, kinds = self.kinds[run]
        return kinds[np.clip(np.searchsorted(at, t), 0, len(at) - 1)]


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

        def squares(chosen: Sequence[int]) -> Array:
            own = [effects[k] for k in chosen]
            return np.sum([_squares(now, frozen, own, split) for split in splits], axis=0)

        keep, guessed = stage.rows.keep, stage.noise.source == RESIDUAL
        count, evident = keep.sum(axis=0), (keep & (_kinds(stage.rows, guessed) < 2)).sum(axis=0)
        moving = _rmse(squares(range(len(picks)))[1], evident)
        pays, minor = _told(picks, squares, guessed)
        # Shapes that all rows have chosen flatter: the search without a fold has to find it as well.
        falls = 0.5 * np.log(total[:-1] / total[1:])
        worth = [np.max(fall[_acts(pick)]) for pick, fall in zip(picks, falls, strict=True)]
        minor = tuple(m or (guessed and w <= MINOR) for m, w in zip(minor, worth, strict=True))
        before = _rmse(self._before, count)
        return HeldOut(before, _rmse(total, count), "folds", pays, minor, moving)

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
        return np.asarray(np.sum([_squares(first, stage.frozen, (), s)[-1] for s in splits], axis=0))

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
    effects: ``train`` to fit to, ``there`` to judge on, by sliding, by all that is evidence and by all;
    known : squared errors with some of the effects."""

    effects: tuple[Effect, ...]
    train: Regression
    there: tuple[Regression, ...]
    known: dict[tuple[int, ...], Array] = field(default_factory=dict, init=False)

    @classmethod
    def of(cls, effects: Sequence[Effect], train: Regression, kinds: Regression) -> _Split:
        return cls(tuple(effects), train, tuple(kinds.select(range(k)) for k in (1, 2, 3)))


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
    """(3, n) squared errors on the rows to judge on of the model with these effects, of those split."""
    chosen = tuple(k for k, e in enumerate(split.effects) if any(e is x for x in own))
    if chosen not in split.known:
        sizes = [len(e.parameters) for e in split.effects]
        picked = np.repeat(np.isin(np.arange(len(sizes)), chosen), sizes)
        wanted = np.concatenate([np.ones(split.train.p - len(picked), bool), picked])
        own = [split.effects[k] for k in chosen]  # in the order of the columns
        theta = fitted_parameters(estimate, own, split.train.keeping(wanted), frozen)
        split.known[chosen] = np.array([x.keeping(wanted).joint_losses(theta) for x in split.there])
    return split.known[chosen]


def _ladder(estimate: Estimate, frozen: bool, effects: Sequence[Effect], split: _Split) -> Array:
    """(3, steps + 1, n) the same of the model with the first effects, one step after the other."""
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
    kinds = 1 + _kinds(rows, stage.noise.source == RESIDUAL)
    kinds[train] = 0
    blocks = tuple(TimeBlock(0, 0.0, 0.0) for _ in range(4))
    factors = []
    for j in range(rows.n):
        for block in range(4):
            kept = rows_of[j][(kinds[:, j] == block) & rows.keep[:, j]]
            indices = np.arange(len(parameters))
            factors.append(Factor(j, block, indices, triangular([kept]), len(kept)))
    both = Regression(parameters, rows.n, blocks, tuple(factors), oversampling=1.0)
    return _Split.of(effects, both.select([0]), both.select([1, 2, 3]))


def _matched(
    estimate: Estimate,
    stage: Stage,
    picks: Sequence[Pick],
    own: Sequence[Pick],
    train: NDArray[np.bool_],
) -> Array:
    """(steps + 1, n) squared errors on all rows left out, at each step with those of a fold's ``own``
    picks that stand for a pick up to there (:func:`_stands_for`): it finds them in another order."""
    steps = np.array([_stands_for(p, picks) for p in own], int)
    order = [k for k in np.argsort(steps, kind="stable") if steps[k] < len(picks)]
    effects = [own[k].candidate.effect for k in order]
    squares = _ladder(estimate, stage.frozen, effects, _left_out(estimate, stage, effects, train))[-1]
    return squares[np.searchsorted(steps[order], np.arange(len(picks) + 1), side="left")]


def _stands_for(own: Pick, picks: Sequence[Pick]) -> int:
    """Which of the picks a fold's own one is: the same effect on the same joint, of several (waves,
    laws of one gear) that of the nearest constants; their number where it is none."""
    shape = own.candidate.effect.shape

    def away(k: int) -> tuple[int, float]:
        effect = picks[k].candidate.effect
        forms, sizes = [n for n in effect.shape if effect.shapes[n].bounds is None], set(shape)
        near = (
            abs(effect.shape[n] - shape[n]) / (abs(shape[n]) + 1e-300)
            for n in sizes.difference(forms)
            if n in effect.shape
        )
        return sum(effect.shape[n] != shape.get(n) for n in forms), sum(near)

    same = [k for k, p in enumerate(picks) if p.candidate.key == own.candidate.key]
    return min(same, key=away, default=len(picks))


def _told(
    picks: Sequence[Pick], squares: Callable[[Sequence[int]], Array], guessed: bool = False
) -> tuple[tuple[bool, ...], tuple[bool, ...]]:
    """Of each pick whether it pays, by the errors of its joints together, and whether it is minor, by
    that which falls most; guessed : the noise, so that model error counts as evidence."""
    paying = _kept(picks, squares, np.sum, _PAYS_GUESSED if guessed else _PAYS)
    major = paying
    if guessed and len(paying) == len(picks):
        major = _kept(picks, squares, np.max, MINOR)
    return tuple(k in paying for k in range(len(picks))), tuple(
        k not in major for k in range(len(picks))
    )


def _kept(
    picks: Sequence[Pick],
    squares: Callable[[Sequence[int]], Array],
    together: Callable[[Array], Any],
    least: float,
) -> list[int]:
    """The picks by which errors fall enough, where they stand or beside all others that are kept: some
    need a later one."""
    kept = list(range(len(picks)))

    def falls(k: int, others: Sequence[int], beside: Sequence[int]) -> float:
        effect, joints = picks[k].candidate.effect, _acts(picks[k])
        before, after = (squares(c) for c in (others, beside))
        # No law of friction holds where it turns round: what is not friction is told by sliding.
        kind = 0 if effect.signless and before[0, joints].all() else 1
        before, after = (np.maximum(x[kind, joints], 1e-300) for x in (before, after))
        return float(together(0.5 * np.log(before / after)))

    share = [falls(k, kept[:k], kept[: k + 1]) for k in kept]
    for k in sorted((k for k in kept if share[k] <= least), key=lambda k: share[k]):
        others = [m for m in kept if m != k]
        if falls(k, others, kept) <= least:
            kept = others
    return kept


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
    stage = stage.on(stage.rows.with_masked(off))
    return replace(stage, candidacy=replace(stage.candidacy, keys=keys))
