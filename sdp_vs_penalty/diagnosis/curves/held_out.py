"""The error of a joint on data left out, before a curve and with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import special

from sdp_vs_penalty.diagnosis.curves.fitted import Fitted, Look
from sdp_vs_penalty.diagnosis.curves.formula import LawFit, of_amplitudes
from sdp_vs_penalty.diagnosis.curves.smooth import Factors, fold_coefficients
from sdp_vs_penalty.diagnosis.library import spread_columns
from sdp_vs_penalty.diagnosis.stage import model_columns, stretches, white_rows
from sdp_vs_penalty.diagnosis.state import SearchState
from sdp_vs_penalty.effects.measured_curve import MeasuredCurve
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import RESIDUAL, Noise
from sdp_vs_penalty.signals.segments import SegmentedRuns

Labels = NDArray[np.intp]
#: A test run's rows with the model attached, and the model.
TestRun = tuple[SegmentedRuns, Estimate]
#: Stretches of a motion that are left out in turn, and how sure it must be that the error falls.
_FOLDS, _SURE = 5, 0.95
#: Share of the joint's error energy beyond noise that a curve takes there: what leaves most of it is not
#: the law that is missing, and beside links that give way is as likely none.
_MOST = 0.5


@dataclass(frozen=True)
class CurveErrors:
    """Root mean square error of a curve's joint without it and with it, on a test run or on folds;
    lowers : whether on folds most of it beyond the noise goes, not by chance, and it falls on a test
    run."""

    before: float
    after: float
    lowers: bool

    def share(self, floor: float) -> float:
        """Of the squared error above the noise's ``floor``, what the curve takes."""
        excess = self.before**2 - floor**2
        return float(np.clip((self.before**2 - self.after**2) / max(excess, 1e-300), 0.0, 1.0))


@dataclass(frozen=True)
class _Added:
    """A curve of a joint: its torque (M, F) on the rows by the values that each fold has from the
    others, (M,) by those of all, and there (M',) on the test run."""

    joint: int
    folds: Array
    every: Array
    there: Array


@dataclass(frozen=True)
class Judge:
    """Curves that are added one after the other to the model and what was named.

    Parameters are those of least squares on white rows; in a fold a curve's values come from the other
    folds too. Directions that the other folds hardly determine stay with the model's parameters, by a
    prior that is worth one row: with none, links run away as `add`, under its constraints, never lets
    them, and a curve gets the credit for holding them. Folds are fifths of
    every motion, each in one piece: in a short stretch an error is much like before and after it.
    Folds decide; a test run is what is reported, and may only refuse.

    fold, cell (M,) : of the rows, a cell being a fold of one motion;
    raw (n, M, p), white (n, M, p), target (n, M) : columns of the model and of what was named; grams
    (F, p, p), pulls (F, p) : of each fold's white rows, among them and with the target; there : raw ones
    on the test run.
    """

    state: SearchState
    test: TestRun | None
    fold: Labels
    cell: Labels
    raw: Array
    white: Array
    target: Array
    grams: Array
    pulls: Array
    there: Array
    curves: tuple[_Added, ...] = ()

    @classmethod
    def of(cls, state: SearchState, test: TestRun | None) -> Judge:
        fold, cell = stretches(state.stage.rows, _FOLDS)
        _, fold = np.unique(fold, return_inverse=True)
        blank = np.zeros(0)
        return cls(state, test, fold, cell, *(blank,) * 6).beside(state)

    def beside(self, state: SearchState) -> Judge:
        """The same curves beside what another state has named."""
        if state is self.state and len(self.raw):
            return self
        stage, weighting = state.stage, state.base.weighting
        effects = [e for e in state.effects if not isinstance(e, MeasuredCurve)]

        def columns(own: Array, rows: SegmentedRuns) -> Array:
            return np.concatenate([own, *(spread_columns(rows, e) for e in effects)], axis=2)

        raw = columns(stage.columns, stage.rows)
        white, target = white_rows(stage.rows, stage.noise, raw, stage.residual)
        there = self.there
        if self.test is not None:
            there = columns(model_columns(*self.test, stage.frozen), self.test[0])
        white = weighting.apply_all(white).reshape(raw.shape)
        target = weighting.apply_all(target).reshape(raw.shape[:2])
        folds = [self.fold == f for f in range(self.fold.max() + 1)]
        parts = [(white[:, f].reshape(-1, raw.shape[2]), target[:, f].ravel()) for f in folds]
        return replace(
            self,
            state=state,
            raw=raw,
            white=white,
            target=target,
            grams=np.array([x.T @ x for x, _ in parts]),
            pulls=np.array([x.T @ y for x, y in parts]),
            there=there,
        )

    def foreseen(self, f: Factors, P: Array, torque: Array) -> float:
        """Share of a joint's error beyond noise that columns with these factors and the penalty P take;
        torque (M, k) : of their coefficients."""
        folds = torque @ fold_coefficients(f, P, self.fold).T
        after = replace(self, curves=(*self.curves, _Added(f.joint, folds, folds[:, 0], folds[:0, 0])))
        out = CurveErrors(self.error(f.joint), after.error(f.joint), False)
        return out.share(known_floor(self.state.stage.noise, f.joint))

    def tried(
        self, found: Fitted, effect: MeasuredCurve, look: Look, law: LawFit | None = None
    ) -> tuple[Judge, CurveErrors]:
        """With one more curve, or what its law makes of it, and what that does to the error of its
        joint."""
        rows, f, j = self.state.stage.rows, found, found.joint
        if law is None:
            design = f.factors, f.smooth.P
            # What the model's columns make comes out at random in a fold, and as large as rounding
            # lets it.
            grid = f.basis.at(*look.variables.supported(f.basis).T) @ f.projector
        else:
            design = of_amplitudes(law.law, law.constants, f, look)[1:]
            grid = law.law.columns(f.basis.points, law.constants)
        tables = [effect.valued(grid @ c) for c in fold_coefficients(*design, self.fold)]
        folds, every = (np.hstack([rows.column(e, j) for e in x]) for x in (tables, [effect]))
        there = np.zeros(0) if self.test is None else self.test[0].column(effect, j)[:, 0]
        after = replace(self, curves=(*self.curves, _Added(j, folds, every[:, 0], there)))
        lowers = _falls(self._squares(j), after._squares(j))
        out = CurveErrors(self.error(j), after.error(j), lowers)
        if out.share(known_floor(self.state.stage.noise, j)) < _MOST:
            out = replace(out, lowers=False)
        if self.test is not None:
            before, rest = self._there(j), after._there(j)
            out = CurveErrors(before, rest, out.lowers and rest < before)
        return after, out

    def error(self, joint: int) -> float:
        """Root mean square on folds left out."""
        count = self.state.stage.rows.keep[:, joint].sum()
        return float(np.sqrt(self._squares(joint).sum() / max(count, 1)))

    def surely_below(self, other: Judge, joint: int) -> bool:
        """Whether the error is below that of another, and not by chance."""
        return _falls(other._squares(joint), self._squares(joint))

    def _squares(self, joint: int) -> Array:
        """(cells,) squared error, each cell left out; worked out once a joint."""
        if joint not in self._known:
            self._known[joint] = self._left_out(joint)
        return self._known[joint]

    @cached_property
    def _known(self) -> dict[int, Array]:
        return {}

    def _left_out(self, joint: int) -> Array:
        stage, p = self.state.stage, self.raw.shape[2]
        left = stage.residual[:, joint].copy()
        for k in range(len(self.grams)):
            out, theta = self.fold == k, self._parameters(k)
            left[out] -= self.raw[joint, out] @ theta[:p]
            for c, size in zip(self.curves, theta[p:], strict=True):
                left[out] -= size * c.folds[out, k] * (c.joint == joint)
        squares = np.where(stage.rows.keep[:, joint], left, 0.0) ** 2
        return np.asarray(np.bincount(self.cell, squares), float)

    def _there(self, joint: int) -> float:
        """Root mean square error on the test run."""
        assert self.test is not None
        rows, theta = self.test[0], self._parameters()
        own = [c.there * (c.joint == joint) for c in self.curves]
        left = rows.residual[:, joint] - np.column_stack([self.there[joint], *own]) @ theta
        left = left[rows.keep[:, joint]]
        return float(np.sqrt(np.mean(left**2))) if len(left) else 0.0

    def _parameters(self, but: int | None = None) -> Array:
        """(p + c,) from all rows ``but`` those of one fold, with the prior that is worth one of them."""
        stage, weighting, p = self.state.stage, self.state.base.weighting, self.raw.shape[2]
        others = [k for k in range(len(self.grams)) if k != but]
        train = self.fold != but if but is not None else np.ones(len(self.fold), bool)
        gram = np.zeros((p + len(self.curves),) * 2)
        pull = np.zeros(len(gram))
        gram[:p, :p], pull[:p] = self.grams[others].sum(axis=0), self.pulls[others].sum(axis=0)
        known: list[tuple[int, Array]] = []
        for at, c in enumerate(self.curves, p):
            torque = c.every if but is None else c.folds[:, but]
            white = stage.noise.whiten(torque, c.joint, stage.rows.pieces(c.joint))
            white = weighting.apply(white, c.joint) * train
            known.append((c.joint, white))
            gram[:p, at], pull[at] = self.white[c.joint].T @ white, self.target[c.joint] @ white
            gram[p : at + 1, at] = [white @ other * (c.joint == j) for j, other in known]
            gram[at, :at] = gram[:at, at]
        norms = np.sqrt(np.diagonal(gram))
        unit = np.where(norms > 1e-12 * norms.max(initial=0.0), norms, np.inf)
        gram = gram / unit[:, None] / unit + np.eye(len(unit)) / max(train.sum(), 1)
        return np.asarray(np.linalg.solve(gram, pull / unit) / unit)


def known_floor(noise: Noise, joint: int) -> float:
    """The noise of a joint; 0 where no motion repeats: what is taken for noise then holds the error."""
    return 0.0 if noise.source == RESIDUAL else float(noise.floor[joint])


def _falls(before: Array, after: Array) -> bool:
    """Whether squares (cells,) fall in all, and from cell to cell by a share that is not chance:
    Student's test of their logarithms, so that no stretch decides alone."""
    seen = (before > 0.0) & (after > 0.0)
    share = np.log(after[seen] / before[seen])
    if len(share) < 2 or not after.sum() < before.sum():
        return False
    spread = share.std(ddof=1) / np.sqrt(len(share))
    return bool(share.mean() < -special.stdtrit(len(share) - 1, _SURE) * spread)
