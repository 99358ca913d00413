"""What a curve may run over, the splines that it is made of, and these on one joint's
white rows.

With z the white columns of a basis, Q the fit's and r what it leaves, everything
follows from D = z'z - (Q'z)'Q'z and s = z'r: c = (D + P)^-1 s, P = lambda S + z'z / N,
S the roughness of the splines (Eilers, Marx 1996), the last term a prior worth one row.
The score is that of :mod:`..score` with the effective degrees of freedom tr (D + P)^-1
D in the place of k; lambda is where it is highest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.constants import ABSORBED_CURVE, COARSENING_ROWS
from sdp_vs_penalty.diagnosis.evidence import EvidenceScorer
from sdp_vs_penalty.diagnosis.linear_fit import WhiteFit
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.measured_curve import Variable
from sdp_vs_penalty.effects.transmission import combinations
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.segments import SegmentedRuns

_DEGREE = 3
#: Splines along one variable, and along each of a pair.
_ALONE = 32
_PAIR = 9


@dataclass(frozen=True)
class Axis:
    """Cubic B-splines of one variable between the ends of its range, held constant
    outside; of the sign of a velocity the constant and the sign itself."""

    variable: Variable
    low: float
    high: float
    count: int

    @property
    def is_sign(self) -> bool:
        return self.variable.word == "sign(dq)"

    def columns(self, x: Array) -> Array:
        """(N, count) of the splines."""
        if self.is_sign:
            return np.column_stack([np.ones_like(x), x])

        # The last knot belongs to what lies below it.
        inside = np.clip(
            x,
            self.low,
            self.high - 1e-9 * (self.high - self.low),
        )
        step = (self.high - self.low) / (self.count - _DEGREE)
        knots = self.low + step * np.arange(-_DEGREE, self.count + 1)
        return np.asarray(
            scipy.interpolate.BSpline.design_matrix(inside, knots, _DEGREE).toarray()
        )

    @property
    def points(self) -> Array:
        """Where the curve is written down: at its knots, and at three values between
        each."""
        count = 4 * (self.count - _DEGREE) + 1
        return (
            np.array([-1.0, 1.0])
            if self.is_sign
            else np.linspace(self.low, self.high, count)
        )


@dataclass(frozen=True)
class Basis:
    """Splines over one variable, or the products of those over two."""

    axes: tuple[Axis, ...]

    @property
    def of(self) -> tuple[str, ...]:
        """The variables as they are written."""
        return tuple(a.variable.name for a in self.axes)

    def at(self, *values: Array) -> Array:
        """(N, size) at given values of the variables."""
        return _products(
            [axis.columns(x) for axis, x in zip(self.axes, values, strict=True)]
        )

    @property
    def roughly(self) -> Basis:
        """A pair's with two thirds of its splines; over one variable itself."""
        coarse_axes = [
            replace(a, count=2 * _PAIR // 3) if a.count == _PAIR else a
            for a in self.axes
        ]
        return Basis(tuple(coarse_axes))

    @property
    def points(self) -> Array:
        """(P, variables) the grid on which the curve is written down."""
        return np.array(list(product(*(a.points for a in self.axes))))


@lru_cache
def _roughness(axes: tuple[tuple[int, bool], ...]) -> Array:
    """Penalty matrix of a P-spline surface: the sum of the variables' penalties (Eilers, Marx 1996).

    The penalty along one variable is I (x) (D2' D2 + c D1' D1) (x) I over its trace, with
    differences D1 and D2 of the coefficients; c = (2 pi / count)^2 for more than _PAIR
    splines, else 0. The first differences then count as much as second ones do for a wave as
    long as the range: where few measurements lie, the curve levels off instead of going on
    straight. A sign has no penalty.

    Parameters
    ----------
    axes : tuple of (int, bool)
        Of each variable the number of splines, and whether it is a sign.

    Returns
    -------
    (size, size) array
        The matrix, which is read-only; size is the product of the numbers of splines.
    """
    counts = [count for count, _ in axes]
    out = np.zeros((int(np.prod(counts)),) * 2)
    for k, (count, is_sign) in enumerate(axes):
        if not is_sign:
            first = np.diff(np.eye(count), 1, axis=0)
            second = np.diff(np.eye(count), 2, axis=0)
            level = 0.0 if count <= _PAIR else (2.0 * np.pi / count) ** 2
            penalty = second.T @ second + level * first.T @ first
            before = np.eye(int(np.prod(counts[:k])))
            after = np.eye(int(np.prod(counts[k + 1 :])))
            along_axis = np.kron(np.kron(before, penalty), after)
            out += along_axis / np.trace(along_axis)
    out.setflags(write=False)  # the cache hands the same array to everybody
    return out


def _products(columns: Sequence[Array]) -> Array:
    """(N, size) every product of one column (N, k) of each."""
    out = columns[0]
    for factor in columns[1:]:
        out = (out[:, :, None] * factor[:, None, :]).reshape(len(out), -1)
    return out


#: Variables of a joint that a curve may run over, alone and in pairs; and pairs of one of
#: another joint with one of the joint.
_SINGLE = ("q", "dq", "ddq", "abs(ddq)", "tau", "sign(dq)")
_PAIRS = (
    ("q", "dq"),
    ("q", "sign(dq)"),
    ("dq", "tau"),
    ("q", "tau"),
    ("dq", "ddq"),
    ("q", "ddq"),
    ("tau", "sign(dq)"),
    ("abs(ddq)", "sign(dq)"),
)
_MIXED_PAIRS = (("q", "q"), ("q", "dq"), ("q", "sign(dq)"), ("dq", "dq"))


def pairs_of(
    j: int,
    robot: Robot,
    warm: bool = False,
) -> list[tuple[Variable, ...]]:
    """Everything that a curve of joint j may run over, one variable first; warm : with
    temperatures."""
    others = [i for i in range(robot.n) if i != j]
    singles = [Variable(word, j) for word in _SINGLE]
    if warm:
        singles.append(Variable("temp", j))
    singles.append(Variable("t"))
    for i in others:
        singles += [Variable("q", i), Variable("dq", i)]
    singles += _coupled_variables(j, robot)
    pairs = [(Variable(a, j), Variable(b, j)) for a, b in _PAIRS]
    for i in others:
        pairs += [(Variable(a, i), Variable(b, j)) for a, b in _MIXED_PAIRS]
    return [*((v,) for v in singles), *pairs]


def _coupled_variables(j: int, robot: Robot) -> list[Variable]:
    """Positions and velocities of two joints together, one of them j, with the ratios of
    a transmission."""
    out = []
    for first in range(j + 1):
        for ratios in combinations(robot, first):
            at = [int(key[1:]) - 1 for key in ratios]
            if len(at) == 2 and j in at:
                one, other = at
                ratio = ratios[f"c{other + 1}"] / ratios[f"c{one + 1}"]
                out += [
                    Variable(
                        word,
                        one,
                        other,
                        ratio,
                    )
                    for word in ("q", "dq")
                ]
    return out


class Variables:
    """The values of all variables on the rows, filtered; and bases in their ranges."""

    def __init__(self, rows: SegmentedRuns, robot: Robot) -> None:
        self.rows = rows
        self.robot = robot
        self.keep = np.asarray(rows.keep.any(axis=1), bool)
        self.warm = all(s.motion.temperature is not None for s in rows.segments)
        self.on_rows = lru_cache(self._on_rows_of)
        self._splines = lru_cache(self._splines_of)

    def _filtered(self, dense: Callable[[Motion], Array]) -> Array:
        """(M, ...) of what is worked out along the motion."""
        return np.concatenate(
            [s.low_pass @ dense(s.motion) for s in self.rows.segments]
        )

    def _on_rows_of(self, v: Variable) -> Array:
        """(M,) low-passed."""
        return self._filtered(v.along)

    def basis(self, of: tuple[Variable, ...]) -> Basis | None:
        """None where a variable stands still."""
        axes = []
        pair = len([v for v in of if v.word != "sign(dq)"]) > 1
        for v in of:
            x = self.on_rows(v)[self.keep]
            low = float(f"{x.min():.6g}")
            high = float(f"{x.max():.6g}")
            if v.word == "sign(dq)":
                low = -1.0
                high = 1.0
                count = 2
            else:
                count = _PAIR if pair else _ALONE
            if not high - low > 1e-6:
                return None
            axes.append(Axis(v, low, high, count))
        return Basis(tuple(axes))

    def coarse(self, basis: Basis) -> Array:
        """(M, size) of the filtered variables: nearly the filtered splines."""
        return _products([self._splines(a) for a in basis.axes])

    def _splines_of(self, axis: Axis) -> Array:
        """(M, count) of one variable on the rows."""
        return axis.columns(self.on_rows(axis.variable))

    def exact(self, basis: Basis) -> Array:
        """(M, size) filtered splines."""
        return self.of_law(basis, lambda x: basis.at(*x.T))

    def of_law(
        self,
        basis: Basis,
        law: Callable[[Array], Array],
    ) -> Array:
        """(M, m) filtered columns of a law, which says them at points (P, v)."""
        return self._filtered(
            lambda m: law(np.column_stack([a.variable.along(m) for a in basis.axes]))
        )

    def supported(self, basis: Basis) -> Array:
        """(P, variables) the points of the basis's grid within a step of which the
        motion has been."""
        return basis.points[self.met(basis, self.keep)]

    def met(
        self,
        basis: Basis,
        which: NDArray[np.bool_],
    ) -> NDArray[np.bool_]:
        """Of all points of a basis's grid, those near which some of the rows (M,) lie."""
        near = [np.ones((int(which.sum()), 1))]
        for axis in basis.axes:
            points = axis.points
            step = (points[-1] - points[0]) / (len(points) - 1)
            reach = 0.2 if axis.is_sign else 1.001 * step
            is_near = np.abs(self.on_rows(axis.variable)[which, None] - points) <= reach
            near.append(is_near.astype(float))
        return np.asarray(near[-2].T @ near[-1] > 0.0).ravel()  # of a pair both at once


#: Weights of the roughness that are tried, relative to the data's.
_WEIGHTS = 10.0 ** np.arange(-5.0, 5.5, 1.0)


@dataclass(frozen=True)
class CurveColumns:
    """Weighted white columns z (M, k) of a joint beside a fit, on all of its rows: D
    (k, k), s (k,), raw = z'z; count : rows of the joint, v : how many of them are worth
    one."""

    fit: WhiteFit
    joint: int
    z: Array
    D: Array
    s: Array
    raw: Array
    count: float
    v: float

    @classmethod
    def of(
        cls,
        score: EvidenceScorer,
        fit: WhiteFit,
        white: Array,
        joint: int,
        robust: bool = True,
    ) -> CurveColumns:
        z = np.zeros((len(fit.residual[joint]), white.shape[1]))
        z[: len(white)] = white / fit.level[joint]
        C = fit.basis[joint].T @ z
        raw = z.T @ z
        D = raw - C.T @ C
        s = z.T @ fit.residual[joint]
        count = float(fit.degrees[joint])
        v = 1.0
        if robust and len(s):
            T = fit.residual_of({joint: z})
            inverse = np.linalg.inv(
                D + raw / count + 1e-9 * np.trace(raw) * np.eye(len(s))
            )
            c = inverse @ s
            freedom = max(float(np.trace(inverse @ D)), 1.0)
            v = score.rows_worth_one(
                T,
                fit.residual - T @ c,
                inverse,
                freedom,
            )
        return cls(
            fit,
            joint,
            z,
            D,
            s,
            raw,
            count,
            v + count / COARSENING_ROWS,
        )

    def score(
        self,
        drop: Array,
        freedom: Array,
        looked: int,
    ) -> Array:
        """The score of what takes ``drop`` (...) of the weighted squared error with so
        much freedom (...), of so many looked at."""
        fit = self.fit
        N = max(self.count / self.v, 3.0)
        j = self.joint
        rss = np.repeat(fit.rss[None], np.size(drop), axis=0).reshape(
            *np.shape(drop), -1
        )
        rss[..., j] = np.maximum(fit.rss[j] - drop * fit.level[j] ** 2, 0.0)
        gain = fit.deviance(fit.rss) - fit.deviance(rss)
        return np.asarray(
            gain / self.v - freedom * np.log(N) - 2.0 * np.log(max(looked, 1))
        )

    def without_fold(
        self,
        fold: NDArray[np.intp],
        P: Array,
    ) -> Array:
        """(F, k) coefficients from the rows outside of each fold (M,), the fit's
        columns refitted there."""
        Q = self.fit.basis
        y = self.fit.target
        r = self.fit.basis.shape[2]
        held = 1.0 / self.count  # a prior worth one row
        out = []
        none = np.ones(len(self.z) - len(fold), bool)
        for f in np.unique(fold):
            train = np.append(fold != f, none)
            q = np.concatenate(Q[:, train])
            G = np.zeros((r + len(self.s),) * 2)
            G[:r, :r] = q.T @ q + held * np.eye(r)
            G[:r, r:] = Q[self.joint][train].T @ self.z[train]
            G[r:, :r] = G[:r, r:].T
            G[r:, r:] = self.z[train].T @ self.z[train] + P
            training_target = y[:, train].ravel()
            # The fit's own parameters are held where they were.
            theta = np.tensordot(
                Q,
                y,
                axes=((0, 1), (0, 1)),
            )
            pull = np.concatenate(
                [
                    q.T @ training_target + held * theta,
                    self.z[train].T @ y[self.joint][train],
                ]
            )
            out.append(np.linalg.solve(G, pull)[r:])
        return np.array(out)


@dataclass(frozen=True)
class SplineFit:
    """A curve of one joint over a basis: raw (M, k) its columns, not white; P (k, k)
    the penalty; J."""

    basis: Basis
    raw: Array
    columns: CurveColumns
    P: Array
    J: float

    @property
    def joint(self) -> int:
        return self.columns.joint

    @cached_property
    def c(self) -> Array:
        """(k,) coefficients."""
        return np.asarray(np.linalg.solve(self.columns.D + self.P, self.columns.s))

    @cached_property
    def projector(self) -> Array:
        """(k, k) onto what the model's own columns cannot make, nor the smoothing alone
        decides."""
        metric = self.columns.raw + self.P
        values, vectors = scipy.linalg.eigh(self.columns.D, metric)
        significant = vectors[:, values > ABSORBED_CURVE]
        return np.asarray(significant @ significant.T @ metric)

    @property
    def coefficients(self) -> Array:
        """(k,) of what the model's own columns cannot make."""
        return np.asarray(self.projector @ self.c)


def smoothed(
    basis: Basis,
    raw: Array,
    columns: CurveColumns,
    looked: int,
) -> SplineFit:
    """The curve with the roughness that scores most."""
    gram = columns.raw / max(columns.count, 1.0) + 1e-10 * np.trace(
        columns.raw
    ) * np.eye(len(columns.s))
    rough = _roughness(tuple((a.count, a.is_sign) for a in basis.axes)) * np.trace(
        columns.raw
    )
    # In a basis in which all but the data's part of D are diagonal, for any weight.
    values, V = scipy.linalg.eigh(
        rough,
        columns.D + gram,
        check_finite=False,
    )
    D = V.T @ columns.D @ V
    s = V.T @ columns.s
    weights = _WEIGHTS if rough.any() else np.ones(1)
    w = 1.0 / (1.0 + weights[:, None] * np.maximum(values, 0.0))
    c = w * s
    J = columns.score(
        2.0 * c @ s - np.sum((c @ D) * c, axis=1),
        w @ np.diagonal(D),
        looked,
    )
    best = int(np.argmax(J))
    return SplineFit(
        basis,
        raw,
        columns,
        gram + weights[best] * rough,
        float(J[best]),
    )


def band(
    fit: SplineFit,
    grid: Array,
    seed: int,
    level: float = 0.95,
    draws: int = 300,
) -> Array:
    """(P,) half width of the band that holds ``level`` of whole curves on grid (P, k):
    draws of the coefficients, normal with the covariance v (D + P)^-1 (Nychka, JASA
    1988)."""
    rng = np.random.default_rng(seed)
    A = fit.columns.D + fit.P
    values, vectors = np.linalg.eigh(A)
    root = vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    spread = np.sqrt(max(fit.columns.v - fit.columns.count / COARSENING_ROWS, 1.0))
    errors = (
        spread * rng.normal(size=(draws, len(A))) @ root.T @ fit.projector.T @ grid.T
    )
    deviation = np.maximum(errors.std(axis=0), 1e-300)
    largest = np.max(np.abs(errors) / deviation, axis=1)
    return np.asarray(np.quantile(largest, level) * deviation)
