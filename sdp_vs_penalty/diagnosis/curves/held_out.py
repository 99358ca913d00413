"""The error of a joint on data left out, before a curve and with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.curves.choose import Fitted, Look
from sdp_vs_penalty.diagnosis.curves.curve import table_effect
from sdp_vs_penalty.diagnosis.curves.smooth import fold_coefficients
from sdp_vs_penalty.diagnosis.library import spread_columns
from sdp_vs_penalty.diagnosis.stage import model_columns, white_rows
from sdp_vs_penalty.diagnosis.state import SearchState
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.measured_curve import MeasuredCurve
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.signals.segments import SegmentedRuns

Array = NDArray[np.float64]
#: A test run's rows with the model attached, and the model.
TestRun = tuple[SegmentedRuns, Estimate]


class HeldOutCurves:
    """Curves that are added one after the other to the model and what was named.

    Parameters are those of least squares on white rows; in a fold a curve's values come from the other
    folds too. All is done on sums of products, fold by fold.
    """

    def __init__(self, state: SearchState, test: TestRun | None = None) -> None:
        self.state, stage = state, state.stage
        self.test = None if test is None else test[0]
        effects = state.effects
        self.raw = _beside(stage.columns, stage.rows, effects)
        M = len(stage.rows.t)
        white, self.target = white_rows(stage.rows, stage.noise, self.raw, stage.residual)
        self.white = state.base.weighting.apply_all(white)
        self.target = state.base.weighting.apply_all(self.target)
        self.folds = [stage.labels.fold != f for f in np.unique(stage.labels.fold)]
        if test is not None:
            self.folds = [np.ones(M, bool)]
            self.there = _beside(model_columns(test[0], test[1], stage.frozen), test[0], effects)
        # Per fold the columns of the curves so far, (n, M, c), and on the test run.
        none = np.zeros((stage.rows.n, M, 0))
        self.curves = [none for _ in self.folds]
        self.curves_there = np.zeros((stage.rows.n, 0 if self.test is None else len(self.test.t), 0))

    def added(self, found: Fitted, effect: MeasuredCurve, look: Look) -> tuple[float, float]:
        """Root mean square error of the curve's joint without it and with it."""
        before = self._rmse(found.joint)
        stage = self.state.stage
        if self.test is not None:
            self.curves = [np.concatenate([self.curves[0], spread_columns(stage.rows, effect)], axis=2)]
            there = spread_columns(self.test, effect)
            self.curves_there = np.concatenate([self.curves_there, there], axis=2)
            return before, self._rmse(found.joint)
        f, points = found, look.variables.supported(found.basis)
        each = fold_coefficients(look.fit, f.Z, f.C, f.factors, f.smooth.P, f.joint)
        for k, c in enumerate(each):
            values = f.basis.at(*points.T) @ c
            own = table_effect(effect.robot, f.joint, f.basis.of, points, values)
            column = spread_columns(stage.rows, own)
            self.curves[k] = np.concatenate([self.curves[k], column], axis=2)
        return before, self._rmse(found.joint)

    def _rmse(self, joint: int) -> float:
        stage, weighting = self.state.stage, self.state.base.weighting
        n, keep = stage.rows.n, stage.rows.keep[:, joint]
        total = count = 0.0
        for train, curves in zip(self.folds, self.curves, strict=True):
            used, columns = np.tile(train, n), self.white
            if curves.shape[2]:
                white, _ = white_rows(stage.rows, stage.noise, curves, stage.residual)
                columns = np.hstack([columns, weighting.apply_all(white)])
            columns = columns[used]
            theta = _least_squares(columns, self.target[used])
            if self.test is None:
                columns, out = np.concatenate([self.raw[joint], curves[joint]], axis=1), keep & ~train
                left = stage.residual[:, joint] - columns @ theta
            else:
                columns = np.concatenate([self.there[joint], self.curves_there[joint]], axis=1)
                left, out = self.test.residual[:, joint] - columns @ theta, self.test.keep[:, joint]
            total += float(np.sum(left[out] ** 2))
            count += float(out.sum())
        return float(np.sqrt(total / max(count, 1.0)))


def _beside(columns: Array, rows: SegmentedRuns, effects: list[Effect]) -> Array:
    return np.concatenate([columns, *(spread_columns(rows, e) for e in effects)], axis=2)


def _least_squares(columns: Array, target: Array) -> Array:
    """The smallest solution, from sums of products."""
    norms = np.linalg.norm(columns, axis=0)
    unit = np.where(norms > 1e-12 * norms.max(initial=0.0), norms, np.inf)
    gram = (columns / unit).T @ (columns / unit)
    values, vectors = np.linalg.eigh(gram)
    good = values > 1e-11 * values[-1]
    part = vectors[:, good]
    return np.asarray(part @ ((part.T @ ((columns / unit).T @ target)) / values[good]) / unit)
