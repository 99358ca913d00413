"""The error that falls along the ladder, on data that no choice has seen.

At each step the model is fitted as ``add`` would fit it, by its own method under its problem's
constraints, and on a test run it is judged on the rows on which ``compare`` judges it. Whether a finding
holds there is told by the rows that are evidence for or against it: where nothing repeats, those during
which the joint moves (:mod:`~sdp_vs_penalty.signals.stillness`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.ladder import climbed, reshaped
from sdp_vs_penalty.diagnosis.library import Key
from sdp_vs_penalty.diagnosis.refit import model_beside, weighting_of
from sdp_vs_penalty.diagnosis.rows import with_estimate
from sdp_vs_penalty.diagnosis.search import Found
from sdp_vs_penalty.diagnosis.splits import (
    Cells,
    KeptSplits,
    Split,
    kinds_of,
    ladder_of,
    left_out,
    rmse,
    squared_errors,
)
from sdp_vs_penalty.diagnosis.stage import Stage, model_columns
from sdp_vs_penalty.diagnosis.state import Pick, SearchState
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.pose import with_reference
from sdp_vs_penalty.regression.regression import compress, compress_cells
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import RESIDUAL
from sdp_vs_penalty.signals.segments import segmented

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
class _Judge(ABC):
    """What the picks of a search are worth on data left out."""

    found: Found

    @abstractmethod
    def errors(self, picks: Sequence[Pick]) -> HeldOut:
        """All that there is to say."""

    @abstractmethod
    def _splits(self, effects: Sequence[Effect]) -> list[Split]:
        """The data, in the columns of these effects at least."""

    def pays(self, picks: Sequence[Pick]) -> tuple[bool, ...]:
        """The same as in :meth:`errors`, known before the rest."""
        return _told(picks, self._squares(picks), self._guessed)[0]

    def _squares(self, picks: Sequence[Pick]) -> Callable[[Sequence[int]], Array]:
        """(3, n) squared errors with some of the picks."""
        now, frozen = self.found.estimate, self.found.state.stage.frozen
        effects = [p.candidate.effect for p in picks]
        splits = self._kept.of(effects, self._splits)
        return lambda chosen: np.sum(
            [squared_errors(now, frozen, [effects[k] for k in chosen], s) for s in splits], axis=0
        )

    @property
    def _guessed(self) -> bool:
        return self.found.state.stage.noise.source == RESIDUAL

    @cached_property
    def _kept(self) -> KeptSplits:
        return KeptSplits()


@dataclass(frozen=True)
class OnTest(_Judge):
    """Errors on a test run of models fitted to the runs that were searched."""

    data: Measurements
    test: Measurements

    def errors(self, picks: Sequence[Pick]) -> HeldOut:
        found, effects = self.found, [p.candidate.effect for p in picks]
        told = _told(picks, self._squares(picks), self._guessed)
        (split,) = self._kept.splits
        ladder = ladder_of(found.estimate, found.state.stage.frozen, effects, split)
        _, evidence, every = (
            rmse(x, rows.joint_rows()) for x, rows in zip(ladder, split.there, strict=True)
        )
        before = every[0] if found.first is found.estimate else self._before
        return HeldOut(before, every, "test", *told, evidence[-1])

    def _splits(self, effects: Sequence[Effect]) -> list[Split]:
        return [self._split(self.found.estimate, effects)]

    @cached_property
    def _before(self) -> Array:
        """(n,) errors of the model as it was given."""
        first, own = self.found.first, self._split(self.found.first, ())
        squares = squared_errors(first, self.found.state.stage.frozen, (), own)[-1]
        return rmse(squares, own.there[-1].joint_rows())

    def _split(self, estimate: Estimate, effects: Sequence[Effect]) -> Split:
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
        return Split.of(effects, train, there)

    @cached_property
    def _cells(self) -> Cells:
        """Which rows of the test run are evidence."""
        rows = segmented(self.test, self.found.estimate.preprocessing)
        kinds = kinds_of(rows, self._guessed)
        return Cells({k: (rows.t[m], kinds[m]) for k in set(rows.run) if (m := rows.run == k).any()})


@dataclass(frozen=True)
class OnFolds(_Judge):
    """Errors on outer folds: which of the picks of the whole search are justified without each of them,
    with which shapes and sizes, is searched anew."""

    def errors(self, picks: Sequence[Pick]) -> HeldOut:
        stage, now, squares = self.found.state.stage, self.found.estimate, self._squares(picks)
        folds = zip(self._searched, self._kept.splits, strict=True)
        total = np.sum([_matched(now, stage.frozen, picks, own, s) for (_, own, _), s in folds], axis=0)
        keep, guessed = stage.rows.keep, self._guessed
        count, evident = keep.sum(axis=0), (keep & (kinds_of(stage.rows, guessed) < 2)).sum(axis=0)
        moving = rmse(squares(range(len(picks)))[1], evident)
        told = _told(picks, squares, guessed)
        before = rmse(self._before, count)
        return HeldOut(before, rmse(total, count), "folds", *told, moving)

    def _splits(self, effects: Sequence[Effect]) -> list[Split]:
        """By fold, in the columns of its own picks as well; shape constants that all rows have chosen
        would flatter the picks: they are those of the rows outside of the fold."""
        state, now, out = self.found.state, self.found.estimate, list[Split]()
        for train, own, there in self._searched:
            shaped = {id(a): b for a, b in zip(state.effects, there, strict=True)}
            every = {id(e): e for e in (*effects, *(p.candidate.effect for p in own))}
            chosen = [shaped.get(key, e) for key, e in every.items()]
            out.append(left_out(now, state.stage, list(every.values()), train, chosen))
        return out

    @cached_property
    def _before(self) -> Array:
        """(n,) squared errors of the model as it was given."""
        stage, first = self.found.state.stage, self.found.first
        if first is not self.found.estimate:
            rows = with_estimate(stage.rows, first)
            columns = model_columns(rows, first, stage.frozen)
            stage = replace(stage, rows=rows, columns=columns, residual=rows.residual)
        splits = [left_out(first, stage, (), train) for train, *_ in self._searched]
        return np.asarray(
            np.sum([squared_errors(first, stage.frozen, (), s)[-1] for s in splits], axis=0)
        )

    @cached_property
    def _searched(self) -> list[tuple[NDArray[np.bool_], tuple[Pick, ...], list[Effect]]]:
        """Of each fold the rows (M,) outside of it, what a search in those picks, and the effects of the
        whole search with the constants that those show."""
        state = self.found.state
        outer, keys = state.stage.labels.fold % _OUTER, _looked_for(state.picks)
        out = []
        for f in np.unique(outer):
            train = outer != f
            stage = _stage_on(state.stage, train, keys)
            own = climbed(SearchState.start(stage), thorough=False).picks
            out.append((train, own, reshaped(state.on(stage)).effects))
        return out


def _matched(
    estimate: Estimate, frozen: bool, picks: Sequence[Pick], own: Sequence[Pick], split: Split
) -> Array:
    """(steps + 1, n) squared errors on all rows left out, at each step with those of a fold's ``own``
    picks that stand for a pick up to there (:func:`_stands_for`): it finds them in another order."""
    steps = np.array([_stands_for(p, picks) for p in own], int)
    order = [k for k in np.argsort(steps, kind="stable") if steps[k] < len(picks)]
    effects = [own[k].candidate.effect for k in order]
    squares = ladder_of(estimate, frozen, effects, split)[-1]
    return squares[np.searchsorted(steps[order], np.arange(len(picks) + 1), side="left")]


def _stands_for(own: Pick, picks: Sequence[Pick]) -> int:
    """Which of the picks a fold's own one is: the same effect on the same joint, of several (waves,
    laws of one gear) that of the nearest constants; their number where it is none."""
    shape = own.candidate.effect.shape

    def away(k: int) -> tuple[int, float]:
        effect, forms, near = picks[k].candidate.effect, 0, 0.0
        for name, value in effect.shape.items():
            if effect.shapes[name].bounds is None:
                forms += value != shape.get(name)
            elif name in shape:
                near += abs(value - shape[name]) / (abs(shape[name]) + 1e-300)
        return forms, near

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
