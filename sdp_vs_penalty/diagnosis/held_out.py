"""The error that falls along the ladder, on data that no choice has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.ladder import climbed
from sdp_vs_penalty.diagnosis.library import spread_columns
from sdp_vs_penalty.diagnosis.rows import diagnosis_rows
from sdp_vs_penalty.diagnosis.stage import Stage, informative, model_columns
from sdp_vs_penalty.diagnosis.state import Pick, SearchState
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.segments import SegmentedRuns

Array = NDArray[np.float64]

#: By this share an error falls, rather than merely not rising.
_FALLS = 0.001
#: Outer folds at most: the search is repeated without each of them.
_OUTER = 3


@dataclass(frozen=True)
class HeldOut:
    """ladder (steps + 1, n) : RMSE of each joint before the first effect and after each; source :
    "test" or "folds"; holds (steps,) : whether the error of a joint on which an effect acts falls on
    data from which its size was not estimated (the test run, or folds left out)."""

    ladder: Array
    source: str
    holds: tuple[bool, ...]


def held_out_errors(
    estimate: Estimate,
    state: SearchState,
    test: Measurements | None,
    settings: Preprocessing,
) -> HeldOut:
    """Errors on the test run; without one, on outer folds: the search is repeated without each."""
    stage, picks = state.stage, state.picks
    if test is not None:
        rows = diagnosis_rows(test, estimate, settings)
        base = model_columns(rows, estimate, stage.frozen)
        squares = _ladder(stage, picks, np.ones(len(stage.rows.t), bool), rows, base, rows.residual)
        ladder = np.sqrt(squares / np.maximum(rows.keep.sum(axis=0), 1))
        return HeldOut(ladder, "test", _holds(picks, ladder))
    total = np.zeros((len(picks) + 1, stage.rows.n))
    outer = stage.labels.fold % _OUTER
    same = np.zeros_like(total)
    for f in np.unique(outer):
        train = outer != f
        again = climbed(SearchState.start(_stage_on(stage, train)), thorough=False)
        squares = _left_out(stage, again.picks, train)
        # The procedure's k-th step; where it stopped earlier, its last.
        at = np.minimum(np.arange(len(picks) + 1), len(squares) - 1)
        total += squares[at]
        same += _left_out(stage, picks, train)
    count = np.maximum(stage.rows.keep.sum(axis=0), 1)
    return HeldOut(np.sqrt(total / count), "folds", _holds(picks, np.sqrt(same / count)))


def _left_out(stage: Stage, picks: Sequence[Pick], train: NDArray[np.bool_]) -> Array:
    return _ladder(stage, picks, train, stage.rows, stage.columns, stage.residual, only=~train)


def _holds(picks: Sequence[Pick], ladder: Array) -> tuple[bool, ...]:
    return tuple(_falls(p, ladder[k], ladder[k + 1]) for k, p in enumerate(picks))


def _falls(pick: Pick, before: Array, after: Array) -> bool:
    effect = pick.candidate.effect
    acts = slice(None) if effect.whole_robot else list(effect.joints)
    return bool(np.any(after[acts] < (1.0 - _FALLS) * before[acts]))


def _stage_on(stage: Stage, train: NDArray[np.bool_]) -> Stage:
    """The same stage with some of the rows: all others are switched off."""
    rows = _switched_off(stage, train)
    return replace(stage, rows=rows, labels=replace(stage.labels, count=informative(rows)))


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
