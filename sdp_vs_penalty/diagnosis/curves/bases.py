"""Splines of which a measured curve is made, the variables that it may run over, and
its fit to one joint's white rows (weighted so that the noise is independent with
variance 1).

With z the white columns of the splines, Q the orthonormal columns of the model's fit
and r its residual, everything follows from D = z'z - (Q'z)'Q'z and s = z'r: the
coefficients are c = (D + P)^-1 s with the penalty P = lambda S + z'z / N. S is the
roughness of the splines (Eilers, Marx 1996), z'z / N a prior worth one row. The score
is the evidence J of :mod:`..evidence` with the effective degrees of freedom tr (D +
P)^-1 D in the place of k; lambda maximises it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product

import numpy as np
import scipy

from sdp_vs_penalty.diagnosis.constants import ABSORBED_CURVE, COARSENING_ROWS
from sdp_vs_penalty.diagnosis.evidence import EvidenceScorer
from sdp_vs_penalty.diagnosis.linear_fit import ColumnProducts, WhiteFit
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.measured_curve import Variable
from sdp_vs_penalty.effects.transmission import list_joint_combinations
from sdp_vs_penalty.regression.evidence import price
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.segments import SegmentedRuns

_DEGREE = 3
#: The variable that is the sign of a velocity.
_SIGN = "sign(dq)"
#: A variable that changes by less has no range [in its unit].
_NO_CHANGE = 1e-6
#: Splines along one variable, and along each of a pair.
_SPLINES_ALONE = 32
_SPLINES_OF_PAIR = 9


@dataclass(frozen=True)
class Axis:
    """Cubic B-splines of one variable over a range, constant outside of it.

    For the sign of a velocity there are two functions instead: 1 and the sign.
    """

    #: The variable of the splines.
    variable: Variable
    #: Lower end of the range, in the variable's unit.
    low: float
    #: Upper end of the range, in the variable's unit.
    high: float
    #: Number of functions.
    count: int

    @property
    def is_sign(self) -> bool:
        """Whether the variable is the sign of a velocity, which is -1 or 1."""
        return self.variable.word == _SIGN

    def columns(self, x: Array) -> Array:
        """Return the values (N, count) of the B-splines at N values of the variable.

        Parameters
        ----------
        x
            (N,) values in the variable's unit, clipped to the range from low to high.
            For the sign of a velocity they are -1, 0 or 1, and the two functions are 1
            and x.
        """
        if self.is_sign:
            return np.column_stack([np.ones_like(x), x])

        # B-splines of SciPy end before the last knot: the upper end is moved below it.
        just_below = self.high - 1e-9 * (self.high - self.low)
        inside = np.clip(x, self.low, just_below)
        step = (self.high - self.low) / (self.count - _DEGREE)
        knots = self.low + step * np.arange(-_DEGREE, self.count + 1)
        return scipy.interpolate.BSpline.design_matrix(inside, knots, _DEGREE).toarray()

    @property
    def points(self) -> Array:
        """Points (P,) at which a curve is tabulated, in the variable's unit.

        They are the knots of the splines and three points between each two; of a sign
        -1 and 1.
        """
        if self.is_sign:
            return np.array([-1.0, 1.0])
        return np.linspace(self.low, self.high, 4 * (self.count - _DEGREE) + 1)


@dataclass(frozen=True)
class Basis:
    """Splines over one variable, or all products of the splines of two variables."""

    #: The splines of each variable.
    axes: tuple[Axis, ...]

    @property
    def variable_names(self) -> tuple[str, ...]:
        """The names of the variables, such as ("q1", "dq1")."""
        return tuple(a.variable.name for a in self.axes)

    def evaluate(self, *values: Array) -> Array:
        """Return all K basis functions (N, K) at N points, from the values (N,) of each
        variable in the order of ``axes``.

        Of one variable they are its splines. Of two they are all products of a spline
        of the first with a spline of the second; the second's index runs fastest.
        """
        return _products(
            [axis.columns(x) for axis, x in zip(self.axes, values, strict=True)]
        )

    @property
    def coarser(self) -> Basis:
        """A basis with two thirds of the splines (6 instead of 9) along each variable
        of a pair, for a fast first comparison.

        A basis over one variable has 32 splines, and is returned unchanged.
        """
        two_thirds = 2 * _SPLINES_OF_PAIR // 3
        return Basis(
            tuple(
                replace(axis, count=two_thirds)
                if axis.count == _SPLINES_OF_PAIR
                else axis
                for axis in self.axes
            )
        )

    @property
    def points(self) -> Array:
        """(P, number of variables) all points of the grid at which a curve is
        tabulated; the last variable runs fastest.
        """
        return np.array(list(product(*(a.points for a in self.axes))))


@lru_cache
def _roughness(axes: tuple[tuple[int, bool], ...]) -> Array:
    """Return the penalty matrix of a P-spline surface: the sum of the penalties along
    each variable (Eilers, Marx 1996).

    The penalty along one variable is I (x) (D2' D2 + c D1' D1) (x) I over its trace,
    where (x) is the Kronecker product, and D1, D2 are first and second differences of
    the coefficients. c is (2 pi / count)^2 for a single variable (more than
    _SPLINES_OF_PAIR splines), else 0. With it, first differences count as much as
    second ones for a wave as long as the range, and where measurements are few the
    curve levels off instead of going on straight. A sign has no penalty.

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
    size = int(np.prod(counts))
    out = np.zeros((size, size))
    for k, (count, is_sign) in enumerate(axes):
        if is_sign:
            continue
        D1 = np.diff(np.eye(count), 1, axis=0)
        D2 = np.diff(np.eye(count), 2, axis=0)
        c = 0.0 if count <= _SPLINES_OF_PAIR else (2.0 * np.pi / count) ** 2
        penalty = D2.T @ D2 + c * D1.T @ D1
        # Splines of the variables before this one, and of those behind it.
        before = np.eye(int(np.prod(counts[:k])))
        after = np.eye(int(np.prod(counts[k + 1 :])))
        along_axis = np.kron(np.kron(before, penalty), after)
        out += along_axis / np.trace(along_axis)
    out.setflags(write=False)  # the cache returns the same array to every caller
    return out


def _products(columns: Sequence[Array]) -> Array:
    """Return the products (N, k1 k2 ...) of each column of the first array (N, k1) with
    each column of the second (N, k2), and so on.

    The column of the last array runs fastest.
    """
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


def list_variables(
    j: int, robot: Robot, has_temperature: bool = False
) -> list[tuple[Variable, ...]]:
    """List the single variables, and pairs of variables, over which a curve of a joint
    may run.

    Single ones come first: the joint's position, velocity, acceleration, torque and
    direction, then time, then positions and velocities of other joints and of coupled
    ones.

    ``j`` counts from 0.

    Parameters
    ----------
    has_temperature
        Whether the log has temperatures, so that the joint's temperature is a variable.

    Returns
    -------
    list of tuple of Variable
        One or two variables each, such as (q2,) or (q2, dq2).
    """
    other_joints = [i for i in range(robot.n) if i != j]
    singles = [Variable(word, j) for word in _SINGLE]
    if has_temperature:
        singles.append(Variable("temp", j))
    singles.append(Variable("t"))
    for i in other_joints:
        singles += [Variable("q", i), Variable("dq", i)]
    singles += _coupled_variables(j, robot)
    out: list[tuple[Variable, ...]] = [(variable,) for variable in singles]
    out += [(Variable(a, j), Variable(b, j)) for a, b in _PAIRS]
    for i in other_joints:
        out += [(Variable(a, i), Variable(b, j)) for a, b in _MIXED_PAIRS]
    return out


def _coupled_variables(j: int, robot: Robot) -> list[Variable]:
    """List the coupled positions and velocities of joint j (from 0) and a second joint.

    Each is a weighted sum such as q4 + 0.5 q5, with the ratios of a transmission that
    this robot may have.
    """
    out = []
    for first in range(j + 1):
        for ratios in list_joint_combinations(robot, first):
            if len(ratios) != 2 or j not in ratios:
                continue
            one, other = ratios
            ratio = ratios[other] / ratios[one]
            out += [Variable(word, one, other, ratio) for word in ("q", "dq")]
    return out


class Variables:
    """The values of all variables on the rows of a log, low-passed, and spline bases
    over them.
    """

    def __init__(self, rows: SegmentedRuns, robot: Robot) -> None:
        """Keep the rows and the robot; values of variables are computed at their first
        use.

        ``on_rows(variable)`` returns low-passed values (M,), and ``keep`` (M,) flags
        the rows in which the log counts on some joint.

        Parameters
        ----------
        rows
            Filtered rows of the log.
        """
        self.rows = rows
        self.robot = robot
        self.keep = np.asarray(rows.keep.any(axis=1), bool)
        self.has_temperature = all(
            s.motion.temperature is not None for s in rows.segments
        )
        # Low-passed values (M,) of a variable on all rows, in its unit.
        self.on_rows = lru_cache(lambda variable: self._filtered(variable.along))
        # Splines (M, count) of one variable at these values.
        self._splines = lru_cache(
            lambda axis: axis.columns(self.on_rows(axis.variable))
        )

    def _filtered(self, dense: Callable[[Motion], Array]) -> Array:
        """Return a quantity on the M filtered rows of all segments, (M,) or (M, k):
        low-passed as the torque is, then resampled.

        ``dense`` maps a motion with N samples to the quantity, (N,) or (N, k).
        """
        return np.concatenate(
            [s.low_pass @ dense(s.motion) for s in self.rows.segments]
        )

    def basis(self, of: tuple[Variable, ...]) -> Basis | None:
        """Return splines over the ranges that these one or two variables have in the
        log.

        None if one of them does not change.
        """
        axes = []
        n_continuous = sum(variable.word != _SIGN for variable in of)
        count = _SPLINES_OF_PAIR if n_continuous > 1 else _SPLINES_ALONE
        for variable in of:
            if variable.word == _SIGN:
                axes.append(Axis(variable, low=-1.0, high=1.0, count=2))
                continue
            x = self.on_rows(variable)[self.keep]
            # As many digits as a written effect has.
            low = float(f"{x.min():.6g}")
            high = float(f"{x.max():.6g}")
            if not high - low > _NO_CHANGE:
                return None
            axes.append(Axis(variable, low, high, count))
        return Basis(tuple(axes))

    def approximate_splines(self, basis: Basis) -> Array:
        """Return the basis functions (M, K) of the filtered variables, f(filtered x).

        They approximate :meth:`filtered_splines`, filtered f(x), and are faster: for a
        first comparison of bases.
        """
        return _products([self._splines(a) for a in basis.axes])

    def filtered_splines(self, basis: Basis) -> Array:
        """Return the basis functions (M, K) along the motion, low-passed as the torque
        was.
        """
        return self.filtered_law(basis, lambda x: basis.evaluate(*x.T))

    def filtered_law(self, basis: Basis, law: Callable[[Array], Array]) -> Array:
        """Return the columns (M, m) of a function of the variables, low-passed as the
        torque was.

        Parameters
        ----------
        law
            Maps points (N, number of variables) to columns (N, m).
        """

        def along(motion: Motion) -> Array:
            """Return the columns (N, m) at the N samples of a motion, unfiltered."""
            values = [axis.variable.along(motion) for axis in basis.axes]
            return law(np.column_stack(values))

        return self._filtered(along)

    def points_near_motion(self, basis: Basis) -> Array:
        """Return those points (P, number of variables) of a basis's grid that the
        motion has come near.
        """
        return basis.points[self.is_near_motion(basis, self.keep)]

    def is_near_motion(self, basis: Basis, which: Mask) -> Mask:
        """Return for each point of a basis's grid whether some rows of the motion come
        near it.

        Near is within one step of the grid; for a sign, within 0.2 of it. For a pair
        both variables have to be near in the same row.

        Parameters
        ----------
        basis
            The basis with P grid points.
        which
            (M,) flags the rows of the log that count.

        Returns
        -------
        (P,) bool array
        """
        near = [np.ones((int(which.sum()), 1))]
        for axis in basis.axes:
            points = axis.points
            step = (points[-1] - points[0]) / (len(points) - 1)
            reach = 0.2 if axis.is_sign else 1.001 * step
            values = self.on_rows(axis.variable)[which]
            is_near = np.abs(values[:, None] - points) <= reach
            near.append(is_near.astype(float))
        # Rows that are near a point of the first axis and of the second at once; of a
        # single axis, the first factor is the column of ones.
        first, second = near[-2:]
        n_rows_near = first.T @ second
        return np.asarray(n_rows_near > 0.0).ravel()


#: Weights of the roughness that are tried, relative to the data's.
_WEIGHTS = 10.0 ** np.arange(-5.0, 5.5, 1.0)


@dataclass(frozen=True)
class CurveColumns:
    """The white columns of a curve's k functions on one joint's rows, beside a fit."""

    #: The fit of the model and of effects.
    fit: WhiteFit
    #: Number of the joint, from 0.
    joint: int
    #: (M, k) z, the white columns over the joint's level.
    scaled: Array
    #: (k, k) D, products of the columns with each other, beside the fit's columns.
    gram_left: Array
    #: (k,) s, products of the columns with the residual, beside the fit's columns.
    with_residual: Array
    #: (k, k) products z'z of the columns alone.
    gram: Array
    #: Degrees of freedom of the joint's residual: its rows less its share of the rank.
    degrees: float
    #: v, number of correlated rows that count as one.
    rows_worth_one: float

    @classmethod
    def from_columns(
        cls,
        score: EvidenceScorer,
        fit: WhiteFit,
        white: Array,
        joint: int,
        robust: bool = True,
    ) -> CurveColumns:
        """Compute the products of a curve's columns z with each other and with the
        residual r of a fit, after projection off the fit's columns.

        With Q (M, r) an orthonormal basis of the fit's columns: D = z'z - (Q'z)'(Q'z),
        and s = z'r, since r has no part in Q. v, the number of correlated rows that
        count as one, comes from the residual after a fit of the curve, c = (D + z'z /
        N)^-1 s.

        Parameters
        ----------
        score
            The scorer, which knows the clusters of correlated rows.
        fit
            The fit of the model with some effects.
        white
            (M, k) columns of the curve's functions, weighted so that the noise is
            independent with variance 1 (white).
        joint
            Joint (from 0) whose torque the curve explains.
        robust
            True: v is estimated from clusters of rows. False: rows count as
            independent, v = 1. N / COARSENING_ROWS is added in both cases, since no law
            is exact.
        """
        scaled = white / fit.level[joint]
        products = ColumnProducts.from_columns(fit, {joint: scaled})
        gram = scaled.T @ scaled
        gram_left = products.gram_left
        with_residual = products.with_residual
        degrees = float(fit.degrees[joint])
        rows_worth_one = 1.0
        if robust and len(with_residual):
            ridge = 1e-9 * np.trace(gram) * np.eye(len(gram))
            inverse = np.linalg.inv(gram_left + gram / degrees + ridge)
            freedom = max(float(np.trace(inverse @ gram_left)), 1.0)
            left = products.residual  # of the columns
            residual = fit.residual - left @ (inverse @ with_residual)
            rows_worth_one = score.rows_worth_one(left, residual, inverse, freedom)
        return cls(
            fit=fit,
            joint=joint,
            scaled=scaled,
            gram_left=gram_left,
            with_residual=with_residual,
            gram=gram,
            degrees=degrees,
            rows_worth_one=rows_worth_one + degrees / COARSENING_ROWS,
        )

    def score(self, drop: Array, freedom: Array, looked: int) -> Array:
        """Return the evidence J of curves that lower the squared error of this joint.

        J = dD / v - freedom log(N / v) - 2 log(looked), where dD is the drop of the
        deviance (-2 log likelihood), N the number of rows, and v the number of
        correlated rows that count as one. The terms subtracted are the price of
        coefficients, and of the choice among bases.

        Parameters
        ----------
        drop
            (...) drop of the weighted squared error of the joint.
        freedom
            (...) effective number of coefficients of each curve.
        looked
            Number of bases among which the curve was chosen.

        Returns
        -------
        (...) array
            The evidence of each curve.
        """
        fit = self.fit
        j = self.joint
        # (..., n) squared errors of all joints, of which only this one's falls.
        rss = np.repeat(fit.rss[None], np.size(drop), axis=0)
        rss = rss.reshape(*np.shape(drop), -1)
        # ``drop`` is in units of the fit's level (its RMS residual).
        rss[..., j] = np.maximum(fit.rss[j] - drop * fit.level[j] ** 2, 0.0)
        deviance_drop = fit.own_deviance - fit.deviance(rss)
        v = self.rows_worth_one
        return deviance_drop / v - price(freedom, self.degrees, v, max(looked, 1))

    def without_fold(self, fold: Indices, penalty: Array) -> Array:
        """Fit the curve's coefficients (F, k), F times, each time without the rows of
        one fold.

        The fit's own columns Q are fitted again on the same rows, together with the
        curve's columns z: the normal equations are [[Q'Q + prior, Q'z], [z'Q, z'z + P]].
        A prior that is worth one row holds the coefficients of Q near their values on
        all rows.

        Parameters
        ----------
        fold
            (M,) the fold of each row.
        penalty
            (k, k) P, the penalty of the curve's coefficients.
        """
        fit = self.fit
        Q = fit.basis  # (n, M, r) in the rows of each of n joints
        r = Q.shape[2]
        k = len(penalty)
        worth_one_row = 1.0 / self.degrees
        curve = np.zeros((*Q.shape[:2], k))
        curve[self.joint] = self.scaled
        # (n, M, r + k + 1): the fit's columns, the curve's, and the torque.
        columns = np.concatenate([Q, curve, fit.target[:, :, None]], axis=2)
        prior = np.zeros((r + k, r + k))
        prior[:r, :r] = worth_one_row * np.eye(r) + fit.precision
        prior[r:, r:] = penalty
        # Coefficients of Q on all rows, near which the prior holds them.
        held_near = np.concatenate([worth_one_row * fit.along_torque, np.zeros(k)])
        out = []
        for number in np.unique(fold):
            others = columns[:, fold != number].reshape(-1, r + k + 1)
            products = others.T @ others
            gram = products[:-1, :-1] + prior
            pull = products[:-1, -1] + held_near
            out.append(np.linalg.solve(gram, pull)[r:])
        return np.array(out)


@dataclass(frozen=True)
class SplineFit:
    """A spline curve of one joint, fitted beside the model."""

    #: The splines.
    basis: Basis
    #: The white columns and their products.
    columns: CurveColumns
    #: (k, k) P, penalty of the coefficients, with the roughness that was chosen.
    penalty: Array
    #: J, evidence of the curve.
    evidence: float

    @property
    def joint(self) -> int:
        """The joint (from 0) whose torque the curve explains."""
        return self.columns.joint

    @cached_property
    def solution(self) -> Array:
        """(k,) spline coefficients that minimise the penalised squared error: (D +
        P)^-1 s.

        D and s are the splines' products with each other and with the residual, beside
        the model's columns; P is the penalty.
        """
        information = self.columns.gram_left + self.penalty
        return np.asarray(np.linalg.solve(information, self.columns.with_residual))

    @cached_property
    def projector(self) -> Array:
        """(k, k) matrix V V' (z'z + P) that projects coefficients onto what the rows
        determine; z are the white columns of the splines, and D their products beside
        the model's columns.

        The columns of V are generalised eigenvectors, D v = share (z'z + P) v, with a
        share above ABSORBED_CURVE (2 %). Directions with a smaller share are those that
        the model's own columns can make, or that the penalty P alone decides.
        """
        metric = self.columns.gram + self.penalty
        shares, vectors = scipy.linalg.eigh(self.columns.gram_left, metric)
        determined = vectors[:, shares > ABSORBED_CURVE]
        return determined @ determined.T @ metric

    @property
    def coefficients(self) -> Array:
        """(k,) coefficients without the part that the model's own columns could make as
        well.
        """
        return self.projector @ self.solution


def fit_spline(basis: Basis, columns: CurveColumns, looked: int) -> SplineFit:
    """Fit a spline curve with the weight of the roughness penalty that has most
    evidence.

    For the weight w: c = (D + prior + w roughness)^-1 s, the squared error drops by 2
    c's - c'D c, and the effective number of coefficients is tr (D + prior + w
    roughness)^-1 D.

    Parameters
    ----------
    columns
        The whitened columns z with their products beside a fit: D (k, k) with each
        other, s (k,) with the residual.
    looked
        Number of bases among which the curve is chosen.

    Returns
    -------
    SplineFit
        The curve with its evidence.
    """
    energy = np.trace(columns.gram)
    ridge = 1e-10 * energy * np.eye(len(columns.gram))
    prior = columns.gram / max(columns.degrees, 1.0) + ridge  # worth one row
    splines = tuple((axis.count, axis.is_sign) for axis in basis.axes)
    roughness = _roughness(splines) * energy
    # In the basis V of these eigenvectors D + prior is the identity and the roughness
    # is diagonal: the solution for any weight is a division.
    values, V = scipy.linalg.eigh(
        roughness, columns.gram_left + prior, check_finite=False
    )
    D = V.T @ columns.gram_left @ V
    s = V.T @ columns.with_residual
    weights = _WEIGHTS if roughness.any() else np.ones(1)
    shrinkage = 1.0 / (1.0 + weights[:, None] * np.maximum(values, 0.0))
    c = shrinkage * s  # (weights, k)
    drop = 2.0 * c @ s - np.sum((c @ D) * c, axis=1)
    freedom = shrinkage @ np.diagonal(D)
    evidence = columns.score(drop, freedom, looked)
    best = int(np.argmax(evidence))
    return SplineFit(
        basis=basis,
        columns=columns,
        penalty=prior + weights[best] * roughness,
        evidence=float(evidence[best]),
    )


def confidence_band(
    fit: SplineFit, grid: Array, seed: int, level: float = 0.95, draws: int = 300
) -> Array:
    """Return the half width (P,) of a simultaneous confidence band of a curve [N m or
    N].

    Errors of the coefficients are drawn from a normal distribution with covariance v (D
    + P)^-1 (Nychka, JASA 1988). The band is c times the standard deviation at each
    point; c is such that the share ``level`` of the drawn curves lies within it at all
    points at once.

    Parameters
    ----------
    fit
        The curve: D (k, k) are products of its columns, P their penalty, v the number
        of correlated rows that count as one.
    grid
        (P, k) basis functions at the P points of the band.
    seed
        Seed of the random draws.
    level
        Share of curves within the band.
    """
    rng = np.random.default_rng(seed)
    information = fit.columns.gram_left + fit.penalty
    values, vectors = np.linalg.eigh(information)
    # root root' is its inverse; rounding may make the smallest eigenvalues negative.
    root = vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    # v without the coarsening of the evidence, which is no error of the curve.
    v = fit.columns.rows_worth_one - fit.columns.degrees / COARSENING_ROWS
    spread = np.sqrt(max(v, 1.0))
    normal = rng.normal(size=(draws, len(information)))
    errors = spread * normal @ root.T @ fit.projector.T @ grid.T  # (draws, P)
    deviation = np.maximum(errors.std(axis=0), 1e-300)
    # Of each drawn curve the largest error, in standard deviations of its point.
    largest = np.max(np.abs(errors) / deviation, axis=1)
    return np.quantile(largest, level) * deviation
