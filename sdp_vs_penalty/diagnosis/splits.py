"""Rows to fit to and rows to judge on, in the columns of a model and of effects; the errors there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.library import spread_columns
from sdp_vs_penalty.diagnosis.refit import fitted_parameters
from sdp_vs_penalty.diagnosis.stage import Stage
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.regression.regression import Factor, Regression, TimeBlock, triangular
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import RESIDUAL
from sdp_vs_penalty.signals.segments import SegmentedRuns
from sdp_vs_penalty.signals.stillness import SLOW, STILL


@dataclass(frozen=True)
class Split:
    """Rows in the columns of a model and of effects, or of what a frozen model leaves in those of the
    effects: ``train`` to fit to, ``there`` to judge on, by sliding, by all that is evidence and by all;
    known : squared errors with some of the effects."""

    effects: tuple[Effect, ...]
    train: Regression
    there: tuple[Regression, ...]
    known: dict[tuple[int, ...], Array] = field(default_factory=dict, init=False)

    @classmethod
    def of(cls, effects: Sequence[Effect], train: Regression, kinds: Regression) -> Split:
        return cls(tuple(effects), train, tuple(kinds.select(range(k)) for k in (1, 2, 3)))


def kinds_of(rows: SegmentedRuns, guessed: bool) -> NDArray[np.intp]:
    """(M, n) kind of each row: 0 the joint slides, 1 it is slow, 2 it stands still and that is no
    evidence, because the noise is a ``guessed`` one."""
    return np.where(guessed & (rows.still > STILL), 2, rows.slow > SLOW).astype(np.intp)


@dataclass(frozen=True)
class Cells:
    """A cell a kind of rows; kinds : by run, instants (M,) and kinds (M, n) there."""

    kinds: Mapping[int, tuple[Array, NDArray[np.intp]]]
    places = ((0, 0.0, 0.0),) * 3

    def cell(self, run: int, t: Array) -> NDArray[np.intp]:
        if run not in self.kinds:
            return np.zeros(len(t), np.intp)
        at, kinds = self.kinds[run]
        return kinds[np.clip(np.searchsorted(at, t), 0, len(at) - 1)]


def left_out(
    estimate: Estimate,
    stage: Stage,
    effects: Sequence[Effect],
    train: NDArray[np.bool_],
    shaped: Sequence[Effect] = (),
) -> Split:
    """The stage's rows to fit to, and all others to judge on; shaped : the effects with the constants
    that the rows to fit to show, if others than their own."""
    rows = stage.rows
    columns = [stage.columns, *(spread_columns(rows, effect) for effect in shaped or effects)]
    own = () if stage.frozen else estimate.model.effects
    parameters = tuple(p for effect in (*own, *effects) for p in effect.parameters)
    torque = stage.residual.copy()
    if not stage.frozen:
        torque += (stage.columns @ estimate.theta).T
    rows_of = np.concatenate([np.concatenate(columns, axis=2), torque.T[:, :, None]], axis=2)
    kinds = 1 + kinds_of(rows, stage.noise.source == RESIDUAL)
    kinds[train] = 0
    blocks = tuple(TimeBlock(0, 0.0, 0.0) for _ in range(4))
    factors = []
    for j in range(rows.n):
        for block in range(4):
            kept = rows_of[j][(kinds[:, j] == block) & rows.keep[:, j]]
            indices = np.arange(len(parameters))
            factors.append(Factor(j, block, indices, triangular([kept]), len(kept)))
    both = Regression(parameters, rows.n, blocks, tuple(factors), oversampling=1.0)
    return Split.of(effects, both.select([0]), both.select([1, 2, 3]))


class KeptSplits:
    """The splits of the effects that were first asked for, which later ones are among."""

    def __init__(self) -> None:
        self.splits: list[Split] = []

    def of(
        self, effects: Sequence[Effect], made: Callable[[Sequence[Effect]], list[Split]]
    ) -> list[Split]:
        have = {id(e) for s in self.splits[:1] for e in s.effects}
        if not self.splits or not have.issuperset(map(id, effects)):
            self.splits = made(effects)
        return self.splits


def squared_errors(estimate: Estimate, frozen: bool, own: Sequence[Effect], split: Split) -> Array:
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


def ladder_of(estimate: Estimate, frozen: bool, effects: Sequence[Effect], split: Split) -> Array:
    """(3, steps + 1, n) the same of the model with the first effects, one step after the other."""
    steps = range(len(effects) + 1)
    return np.stack([squared_errors(estimate, frozen, effects[:k], split) for k in steps], axis=1)


def rmse(squares: Array, rows: NDArray[np.int64]) -> Array:
    return np.asarray(np.sqrt(squares / np.maximum(rows, 1)))
