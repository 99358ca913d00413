"""The error of a joint on data left out, before a curve and with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import special

from sdp_vs_penalty.diagnosis.curves.fitted import Fitted, Look
from sdp_vs_penalty.diagnosis.curves.formula import LawFit, of_amplitudes
from sdp_vs_penalty.diagnosis.curves.smooth import fold_coefficients, identifiable
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
class Judge:
    """Curves that are added one after the other to the model and what was named.

    Parameters are those of least squares on white rows; in a fold a curve's values come from the other
    folds too. Directions that the other folds hardly determine stay with the model's parameters, by a
    prior that is worth one row: with none, links run away as `add`, under its constraints, never lets
    them, and a curve gets the credit for holding them. Folds are fifths of
    every motion, each in one piece: in a short stretch an error is much like before and after it.
    Folds decide; a test run is what is reported, and may only refuse.

    fold, cell (M,) : of the rows, a cell being a fold of one motion;
    raw (n, M, p), white (n M, p) : columns of the model and of what was named; grams (F, p, p), pulls
    (F, p) : of each fold's white rows, among them and with the target; curves : per fold those (n, M, c)
    of the curves; there, curves_there : on the test run; all_curves : as they are there from all folds.
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
    curves: tuple[Array, ...]
    all_curves: Array
    there: Array
    curves_there: Array

    @classmethod
    def of(cls, state: SearchState, test: TestRun | None) -> Judge:
        n, M = state.stage.rows.n, len(state.stage.rows.t)
        none = np.zeros((n, M, 0))
        fold, cell = stretches(state.stage.rows, _FOLDS)
        there = np.zeros((n, 0 if test is None else len(test[0].t), 0))
        blank = np.zeros(0)
        curves = (none,) * len(np.unique(fold))
        bare = cls(state, test, fold, cell, none, blank, blank, blank, blank, curves, none, there, there)
        return bare.beside(state)

    def beside(self, state: SearchState) -> Judge:
        """The same curves beside what another state has named."""
        stage, weighting = state.stage, state.base.weighting
        effects = [e for e in state.effects if not isinstance(e, MeasuredCurve)]

        def columns(own: Array, rows: SegmentedRuns) -> Array:
            return np.concatenate([own, *(spread_columns(rows, e) for e in effects)], axis=2)

        raw = columns(stage.columns, stage.rows)
        white, target = white_rows(stage.rows, stage.noise, raw, stage.residual)
        there = self.there
        if self.test is not None:
            there = columns(model_columns(*self.test, stage.frozen), self.test[0])
        white, target = weighting.apply_all(white), weighting.apply_all(target)
        every = np.tile(self.fold, stage.rows.n)
        parts = [(white[mine], target[mine]) for f in np.unique(self.fold) for mine in [every == f]]
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

    def tried(
        self, found: Fitted, effect: MeasuredCurve, look: Look, law: LawFit | None = None
    ) -> tuple[Judge, CurveErrors]:
        """With one more curve, or what its law makes of it, and what that does to the error of its
        joint."""
        rows, f = self.state.stage.rows, found
        if law is None:
            design = f.Z, f.C, f.factors, f.smooth.P
            # What the model's columns make comes out at random in a fold, and as large as rounding
            # lets it.
            grid = f.basis.at(*look.variables.supported(f.basis).T)
            grid = grid @ identifiable(f.factors, f.smooth.P)
        else:
            design = of_amplitudes(law, f, look)
            grid = law.law.columns(f.basis.points, law.constants)
        parts = fold_coefficients(look.fit, *design, f.joint, self.fold)
        tables = [effect.valued(grid @ c) for c in parts]

        def joined(old: Array, rows: SegmentedRuns, new: MeasuredCurve) -> Array:
            return np.concatenate([old, spread_columns(rows, new)], axis=2)

        after = replace(
            self,
            curves=tuple(joined(c, rows, t) for c, t in zip(self.curves, tables, strict=True)),
            all_curves=joined(self.all_curves, rows, effect),
        )
        lowers = _falls(self._squares(f.joint), after._squares(f.joint))
        out = CurveErrors(self.error(f.joint), after.error(f.joint), lowers)
        if out.share(known_floor(self.state.stage.noise, f.joint)) < _MOST:
            out = replace(out, lowers=False)
        if self.test is not None:
            after = replace(after, curves_there=joined(self.curves_there, self.test[0], effect))
            before, rest = self._there(f.joint), after._there(f.joint)
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
        stage, left = self.state.stage, np.zeros(len(self.fold))
        for k, (f, curves) in enumerate(zip(np.unique(self.fold), self.curves, strict=True)):
            out = self.fold == f
            columns = np.concatenate([self.raw[joint], curves[joint]], axis=1)[out]
            left[out] = stage.residual[out, joint] - columns @ self._parameters(curves, k)
        return np.asarray(
            np.bincount(self.cell, np.where(stage.rows.keep[:, joint], left, 0.0) ** 2), float
        )

    def _there(self, joint: int) -> float:
        """Root mean square error on the test run."""
        assert self.test is not None
        rows = self.test[0]
        theta = self._parameters(self.all_curves)
        columns = np.concatenate([self.there[joint], self.curves_there[joint]], axis=1)
        left = (rows.residual[:, joint] - columns @ theta)[rows.keep[:, joint]]
        return float(np.sqrt(np.mean(left**2))) if len(left) else 0.0

    def _parameters(self, curves: Array, but: int | None = None) -> Array:
        """(p + c,) from all rows ``but`` those of one fold (its place), with the prior that is worth one
        of them."""
        stage, folds, p = self.state.stage, np.unique(self.fold), self.white.shape[1]
        others = [k for k in range(len(folds)) if k != but]
        train = np.isin(self.fold, folds[others])
        gram = np.zeros((p + curves.shape[2],) * 2)
        pull = np.zeros(len(gram))
        gram[:p, :p], pull[:p] = self.grams[others].sum(axis=0), self.pulls[others].sum(axis=0)
        if curves.shape[2]:
            white, _ = white_rows(stage.rows, stage.noise, curves, stage.residual)
            own = self.state.base.weighting.apply_all(white)
            own = own * np.tile(train, stage.rows.n)[:, None]
            gram[:p, p:], gram[p:, p:], pull[p:] = self.white.T @ own, own.T @ own, own.T @ self.target
            gram[p:, :p] = gram[:p, p:].T
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
