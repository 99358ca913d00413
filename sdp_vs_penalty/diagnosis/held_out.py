"""The error that falls along the ladder, on data that no choice has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.ladder import climbed
from sdp_vs_penalty.diagnosis.library import Key, spread_columns
from sdp_vs_penalty.diagnosis.rows import diagnosis_rows, with_estimate
from sdp_vs_penalty.diagnosis.search import Found
from sdp_vs_penalty.diagnosis.stage import Stage, informative, model_columns
from sdp_vs_penalty.diagnosis.state import Pick, SearchState
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.segments import SegmentedRuns

Array = NDArray[np.float64]

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


def held_out_errors(
    found: Found,
    test: Measurements | None,
    settings: Preprocessing,
) -> HeldOut:
    """Errors on the test run; without one, on outer folds: which of the picks are justified without each
    of them, with which shapes and sizes, is searched anew."""
    stage, picks = found.state.stage, found.state.picks
    given = stage if found.first is found.estimate else _stage_of(stage, found.first)
    if test is not None:
        runs = diagnosis_rows(test, found.estimate, settings)
        everything = np.ones(len(stage.rows.t), bool)

        def on_test(model: Estimate, stage: Stage, picks: Sequence[Pick]) -> Array:
            rows = with_estimate(runs, model)
            base = model_columns(rows, model, stage.frozen)
            squares = _ladder(stage, picks, everything, rows, base, rows.residual)
            return np.asarray(np.sqrt(squares / np.maximum(rows.keep.sum(axis=0), 1)))

        ladder = on_test(found.estimate, stage, picks)
        before = ladder[0] if given is stage else on_test(found.first, given, ())[0]
        return HeldOut(before, ladder, "test", *_told(picks, ladder))
    total = np.zeros((len(picks) + 1, stage.rows.n))
    outer, keys = stage.labels.fold % _OUTER, _looked_for(picks)
    same, before = np.zeros_like(total), np.zeros(stage.rows.n)
    for f in np.unique(outer):
        train = outer != f
        again = climbed(SearchState.start(_stage_on(stage, train, keys)), thorough=False)
        total += _matched(stage, picks, again.picks, train)
        same += _left_out(stage, picks, train)
        before += _left_out(given, (), train)[0]
    count = np.maximum(stage.rows.keep.sum(axis=0), 1)
    ladder = np.sqrt(total / count)
    return HeldOut(np.sqrt(before / count), ladder, "folds", *_told(picks, np.sqrt(same / count)))


def _stage_of(stage: Stage, estimate: Estimate) -> Stage:
    """The same stage with the columns of another model."""
    rows = with_estimate(stage.rows, estimate)
    columns = model_columns(rows, estimate, stage.frozen)
    return replace(stage, rows=rows, columns=columns, residual=rows.residual)


def _matched(
    stage: Stage, picks: Sequence[Pick], own: Sequence[Pick], train: NDArray[np.bool_]
) -> Array:
    """(steps + 1, n) squared errors left out, at each step with those of a fold's ``own`` picks that are
    the same effect on the same joint as a pick up to there: a fold finds them in another order."""
    step: dict[Key, int] = {}
    for k, pick in enumerate(picks):
        step.setdefault(pick.candidate.key, k)
    same = sorted((p for p in own if p.candidate.key in step), key=lambda p: step[p.candidate.key])
    steps = np.array([step[p.candidate.key] for p in same], int)
    squares = _left_out(stage, same, train)
    return squares[np.searchsorted(steps, np.arange(len(picks) + 1), side="left")]


def _left_out(stage: Stage, picks: Sequence[Pick], train: NDArray[np.bool_]) -> Array:
    return _ladder(stage, picks, train, stage.rows, stage.columns, stage.residual, only=~train)


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
    rows = _switched_off(stage, train)
    labels = replace(stage.labels, count=informative(rows))
    return replace(stage, rows=rows, labels=labels, candidacy=replace(stage.candidacy, keys=keys))


def _switched_off(stage: Stage, train: NDArray[np.bool_]) -> SegmentedRuns:
    return stage.rows.with_masked(np.repeat(~train[:, None], stage.rows.n, axis=1) | ~stage.rows.keep)


def _ladder(
    stage: Stage,
    picks: Sequence[Pick],
    train: NDArray[np.bool_],
    rows: SegmentedRuns,
    base: Array,
    residual: Array,
    only: NDArray[np.bool_] | None = None,
) -> Array:
    """(steps + 1, n) squared errors on rows, parameters fitted to the white training rows."""
    keep = rows.keep if only is None else rows.keep & only[:, None]
    columns = [stage.columns, *(spread_columns(stage.rows, p.candidate.effect) for p in picks)]
    there = [base, *(spread_columns(rows, p.candidate.effect) for p in picks)]
    masked = _switched_off(stage, train)
    out = []
    for k in range(len(picks) + 1):
        theta = stage.least_squares(np.concatenate(columns[: k + 1], axis=2), masked, balanced=True)
        predicted = np.concatenate(there[: k + 1], axis=2) @ theta
        out.append(np.sum(keep * (residual - predicted.T) ** 2, axis=0))
    return np.array(out)
