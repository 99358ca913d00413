"""What the data determine, and how well: intervals for parameters and a band for torques.

The block bootstrap (Kuensch, Annals of Statistics 1989; Efron, Tibshirani 1993, ch. 8): time blocks,
not samples, are drawn again with replacement, because the error of neighbouring samples is one error.
It runs on the compressed factors, in the coordinates z of the directions V that the data show at all,
so that a draw costs one small linear system whatever the length of the runs:

    theta = theta_hat + V z,     (sum over drawn blocks of V^T R_b^T R_b V) z = sum of V^T R_b^T r_b.

The intervals are those of unconstrained least squares: what the data say by themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from sdp_vs_penalty import show
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import JointColumns, Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimators.task import joint_weights
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_parameters, base_parameters_of
from sdp_vs_penalty.regression.regression import Regression, compress, nearest_least_squares

Array = NDArray[np.float64]

#: Singular values below this share of the largest are rounding: the data do not show that direction.
_UNSEEN = 1e-9
#: A direction belongs to the visible ones up to this much of its square.
_INSIDE = 1e-6
#: What each draw keeps of the whole data, so that a draw without a direction does not explode.
_ANCHOR = 1e-6
#: Largest half-width of an interval: relative to the value, or to the largest value there could be
#: (a parameter that is zero is known well if it is known to be small).
_IDENTIFIABLE = (0.25, 0.0025)
_WEAKLY = (1.0, 0.1)

IDENTIFIABLE, WEAKLY, NOT_SEEN = "identifiable", "weakly", "not seen"


@dataclass(frozen=True)
class Interval:
    """One standard or base parameter: its estimate, what the data alone say, and a verdict.

    value : of the model; low, high : bounds of the interval, infinite where the data say nothing.
    verdict : "identifiable" (half-width up to a quarter of the value), "weakly" (up to the value), or
        "not seen"; half-widths up to 0.25 % and 10 % of the largest value that the problem's bounds
        or the measured torque allow count as well.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    verdict: str

    def to_dict(self) -> dict[str, Any]:
        bounds = [None if np.isinf(x) else x for x in (self.low, self.high)]
        return {
            "name": self.name,
            "unit": self.unit,
            "value": self.value,
            "low": bounds[0],
            "high": bounds[1],
            "verdict": self.verdict,
        }


@dataclass(frozen=True)
class Uncertainty:
    """standard : all parameters of the model; base : the combinations that make torque.

    draws : (S, p) bootstrap deviations from the model's parameters, in visible directions only;
    noise : (n,) standard deviation of the torque that the model leaves [N m, N]; level : of all
    intervals.
    """

    model: Model
    theta: Array
    standard: tuple[Interval, ...]
    base: tuple[Interval, ...]
    draws: Array
    noise: Array
    level: float

    def torque_band(self, motion: Motion, *, measured: bool = False) -> tuple[Array, Array]:
        """Lower and upper torque (N, n) around the model's prediction.

        Of the torque that the model should predict; with ``measured``, of a measured one in the same
        band of frequencies, which has the noise of :attr:`noise` as well.
        """
        return self.band(self.model.columns(motion), measured=measured)

    def band(self, columns: Sequence[JointColumns], *, measured: bool = False) -> tuple[Array, Array]:
        """The same of columns that were computed, or filtered, before."""
        count = len(columns[0].columns)
        low, high = np.empty((count, len(columns))), np.empty((count, len(columns)))
        tail = 0.5 * (1.0 - self.level)
        for j, block in enumerate(columns):
            centre = block.columns @ self.theta[block.indices]
            spread = block.columns @ self.draws[:, block.indices].T
            if measured:
                rng = np.random.default_rng(0)
                spread = spread + rng.normal(scale=self.noise[j], size=spread.shape)
            low[:, j], high[:, j] = centre + np.quantile(spread, (tail, 1.0 - tail), axis=1)
        return low, high

    def to_dict(self) -> dict[str, Any]:
        return {
            "level": self.level,
            "standard": [i.to_dict() for i in self.standard],
            "base": [i.to_dict() for i in self.base],
            "torque_noise": self.noise.tolist(),
        }


def uncertainty(
    problem: Problem,
    estimate: Estimate,
    measurements: Measurements,
    *,
    draws: int = 400,
    level: float = 0.95,
    seed: int = 0,
) -> Uncertainty:
    """Intervals of an estimate from the measurements that it came from.

    draws : bootstrap resamples; level : of the intervals. Raises InputError where the measurements
    make fewer than four time blocks.
    """
    regression = compress(measurements, estimate.model, estimate.preprocessing)
    return of_regression(problem, estimate.model, regression, estimate.theta, draws, level, seed)


def of_regression(
    problem: Problem,
    model: Model,
    regression: Regression,
    theta: Array | None = None,
    draws: int = 400,
    level: float = 0.95,
    seed: int = 0,
) -> Uncertainty:
    """The same from compressed data; theta defaults to least squares next to the nominal robot."""
    if not 0.0 < level < 1.0 or draws < 20:
        raise InputError(f"level {level:g} and draws {draws}: a level below 1 and at least 20 draws.")
    if len(regression.blocks) < 4:
        raise InputError(
            (
                f"The measurements contain {show.count(len(regression.blocks), 'time block')}, but "
                "intervals need 4"
            ),
            "record longer",
        )
    nominal, bound = problem.nominal(model), problem.parameter_bound(model)
    first = nearest_least_squares(regression.least_squares(), nominal, bound)
    weights = joint_weights(regression, first)
    data = regression.least_squares(weights)
    centre = nearest_least_squares(data, nominal, bound)
    visible = _visible_directions(data.R, data.column_norms)
    deviations = _bootstrap(regression, weights, centre, visible, draws, seed)
    value = centre if theta is None else np.asarray(theta, float)

    base, base_names, leading = base_rows(problem, model)
    base_units = [model.parameters[k].unit for k in leading]
    torque_size = np.sqrt(data.tau_squared) / np.where(
        data.column_norms > 0.0, data.column_norms, np.nan
    )
    standard_size = np.fmin(bound, torque_size)
    base_bound = np.abs(base) @ bound
    base_size = np.fmin(base_bound, torque_size[leading])
    tail = 0.5 * (1.0 - level)

    def intervals(
        rows: Array, names: Sequence[str], units: Sequence[str], sizes: Array
    ) -> tuple[Interval, ...]:
        spread = deviations @ rows.T
        low, high = np.quantile(spread, (tail, 1.0 - tail), axis=0)
        seen = _seen(rows, visible, data.column_norms)
        out = []
        for k, (name, unit) in enumerate(zip(names, units, strict=True)):
            own, least = float(rows[k] @ value), float(rows[k] @ centre)
            if not seen[k]:
                out.append(Interval(name, unit, own, -np.inf, np.inf, NOT_SEEN))
                continue
            half = 0.5 * float(high[k] - low[k])
            verdict = _verdict(half, abs(least), float(sizes[k]))
            # A percentile interval, turned round the least-squares value (Efron's basic bootstrap).
            out.append(Interval(name, unit, own, least - float(high[k]), least - float(low[k]), verdict))
        return tuple(out)

    rows = np.maximum(regression.joint_rows(), 1)
    noise = np.sqrt(regression.joint_losses(value) / rows)
    names, units = [p.name for p in model.parameters], [p.unit for p in model.parameters]
    return Uncertainty(
        model,
        value,
        intervals(np.eye(len(names)), names, units, standard_size),
        intervals(base, base_names, base_units, base_size),
        deviations,
        noise,
        level,
    )


def _verdict(half: float, value: float, largest: float) -> str:
    for (own, absolute), verdict in ((_IDENTIFIABLE, IDENTIFIABLE), (_WEAKLY, WEAKLY)):
        if half <= max(own * min(value, largest), absolute * largest if np.isfinite(largest) else 0.0):
            return verdict
    return NOT_SEEN


def _visible_directions(R: Array, norms: Array) -> Array:
    """(p, r) directions of theta that the data show, of about one unit of loss each."""
    seen = np.flatnonzero(norms > 0.0)
    out = np.zeros((R.shape[1], 0))
    if len(seen):
        _, s, vt = np.linalg.svd(R[:, seen] / norms[seen], full_matrices=False)
        good = s > _UNSEEN * s[0]
        out = np.zeros((R.shape[1], int(good.sum())))
        out[seen] = (vt[good] / s[good, None]).T / norms[seen, None]
    return out


def _seen(rows: Array, visible: Array, norms: Array) -> NDArray[np.bool_]:
    """Which linear functions (b, p) of theta the data determine: those in the span of what they show."""
    scaled = rows / np.where(norms > 0.0, norms, 1.0)
    scaled[:, norms <= 0.0] = rows[:, norms <= 0.0]
    total = np.sum(scaled**2, axis=1)
    hidden = np.any(np.abs(rows[:, norms <= 0.0]) > 0.0, axis=1)
    basis, _ = np.linalg.qr(visible * np.where(norms > 0.0, norms, 0.0)[:, None])
    inside = np.sum((scaled @ basis) ** 2, axis=1)
    return np.asarray((inside > (1.0 - _INSIDE) * total) & ~hidden & (total > 0.0))


def _bootstrap(
    regression: Regression, weights: Array, centre: Array, visible: Array, draws: int, seed: int
) -> Array:
    """(draws, p) deviations of least squares on redrawn blocks; each run keeps its number of blocks."""
    blocks = len(regression.blocks)
    r = visible.shape[1]
    grams, pulls = np.zeros((blocks, r, r)), np.zeros((blocks, r))
    for factor in regression.factors:
        scaled = weights[factor.joint] * factor.triangle
        directions = scaled[:, :-1] @ visible[factor.indices]
        residual = scaled[:, -1] - scaled[:, :-1] @ centre[factor.indices]
        grams[factor.block] += directions.T @ directions
        pulls[factor.block] += directions.T @ residual
    anchor = _ANCHOR * grams.sum(axis=0)
    rng = np.random.default_rng(seed)
    runs = np.array([block.run for block in regression.blocks])
    members = [np.flatnonzero(runs == run) for run in np.unique(runs)]
    out = np.empty((draws, len(centre)))
    for k in range(draws):
        counts = np.zeros(blocks)
        for own in members:
            np.add.at(counts, rng.choice(own, len(own)), 1.0)
        gram = np.tensordot(counts, grams, axes=1) + anchor
        z = scipy.linalg.solve(gram, counts @ pulls, assume_a="pos", check_finite=False)
        out[k] = visible @ z
    return out


def base_rows(problem: Problem, model: Model) -> tuple[Array, list[str], list[int]]:
    """(b, p) base parameters of the links, then all others; their names; the symbols that lead them."""
    p = len(model.parameters)
    rotors = [k for k, q in enumerate(model.parameters) if q.effect == "rotor_inertia"]
    others = np.setdiff1d(np.arange(p), model.rigid_indices)
    rows, leading = [np.eye(p)[others]], others.tolist()
    if len(model.rigid_indices) and rotors:
        # A rotor acts like inertia of the first links: their common combinations are what counts.
        matrix, solid, kept = base_parameters_of(model, ("rigid_body", "rotor_inertia"))
        rest = np.setdiff1d(others, rotors)
        wide = np.zeros((len(matrix), p))
        wide[:, solid] = matrix
        rows, leading = [wide, np.eye(p)[rest]], [*kept, *rest.tolist()]
    elif len(model.rigid_indices):
        try:
            matrix, kept_rigid = base_parameters(model, problem.independent)
        except InputError:  # the list was made for another direction of gravity
            matrix, kept_rigid = base_parameters(model)
        wide = np.zeros((len(matrix), p))
        wide[:, model.rigid_indices] = matrix
        rows.insert(0, wide)
        leading = [int(model.rigid_indices[k]) for k in kept_rigid] + leading
    parameters = [model.parameters[k] for k in leading]
    names = []
    stacked = np.vstack(rows)
    for row, parameter in zip(stacked, parameters, strict=True):
        alone = np.count_nonzero(row) == 1
        names.append(parameter.name if alone else f"{parameter.name} + ...")
    return stacked, names, leading


def counts(intervals: Sequence[Interval]) -> dict[str, int]:
    """How many of each verdict."""
    return {
        verdict: sum(i.verdict == verdict for i in intervals)
        for verdict in (IDENTIFIABLE, WEAKLY, NOT_SEEN)
    }


def coverage(truth: ArrayLike, intervals: Sequence[Interval]) -> float:
    """Share of the finite intervals that hold the true values: for judging intervals in simulation."""
    values = np.asarray(truth, float)
    held = [i.low <= x <= i.high for x, i in zip(values, intervals, strict=True) if np.isfinite(i.low)]
    return float(np.mean(held)) if held else 1.0
