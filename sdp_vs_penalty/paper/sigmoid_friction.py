"""The sigmoid friction of the paper's Table I, fitted joint by joint beside the rigid model.

    f(dq) = phi_1 / (1 + exp(-phi_2 (dq + phi_3))) - phi_1 / (1 + exp(-phi_2 phi_3))

(Gaz et al. 2019, eq. 12), phi_1 [N m], phi_2 [s/rad], phi_3 [rad/s]; zero at rest. The base
parameters pi of the links and all phi are fitted together to W pi + f = tau, because a rigid part
fitted without friction would have swallowed some of it. phi_1 (N) and pi enter linearly, so that the
problem in phi_2, phi_3 alone (variable projection) has few local minima: a coarse grid starts it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats
from scipy.special import expit

from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.preprocessing import Rows

#: The rows of a data set in the columns of any model: filtered, or exact where states are known.
RowsOf = Callable[[Model], Rows]

#: Bounds of phi_2 [s/rad] and phi_3 [rad/s]: beyond, the sigmoid is a line or a jump to any data.
_SLOPE_RANGE, _SHIFT_RANGE = (0.1, 500.0), (-0.5, 0.5)


class SigmoidLinearised(Effect):
    """f / phi_1 and its derivatives by phi_2 and phi_3 at given phi: three columns a joint.

    Not in the library of effects: its columns belong to one step of :func:`fit_sigmoid`.
    """

    name = "sigmoid_linearised"
    equation = "s(dq) - s(0), s(v) = 1 / (1 + exp(-phi_2 (v + phi_3)))"
    explanation = "One step of the fit of Table I."
    reference = "Gaz et al., RA-L 2019, eq. 12"

    def __init__(self, robot: Robot, shapes: Array) -> None:
        """shapes (n, 2): phi_2, phi_3 of each joint."""
        super().__init__(robot)
        self.slopes_and_shifts = shapes

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"sigmoid{k}_{j + 1}", "", self.name, j + 1)
            for j in range(self.robot.n)
            for k in range(3)
        )

    def blocks(self, motion: Motion) -> list[Block]:
        out = []
        for j, (slope, shift) in enumerate(self.slopes_and_shifts):
            moving, rest = expit(slope * (motion.dq[:, j] + shift)), expit(slope * shift)
            d_moving, d_rest = moving * (1.0 - moving), rest * (1.0 - rest)
            by_slope = d_moving * (motion.dq[:, j] + shift) - d_rest * shift
            by_shift = slope * (d_moving - d_rest)
            columns = np.column_stack([moving - rest, by_slope, by_shift])
            out.append(Block(j, 3 * j + np.arange(3), columns))
        return out


@dataclass(frozen=True)
class SigmoidFit:
    """phi (n, 3) with standard deviations (n, 3); pi (b,) base parameters fitted with them.

    lower, upper (n, 3) : 95 % intervals; rmse (n,) of the residual [N m].
    """

    phi: Array
    std: Array
    lower: Array
    upper: Array
    pi: Array
    rmse: Array

    @property
    def hardly_identifiable(self) -> NDArray[np.bool_]:
        """(n, 3) where the interval contains zero: the data do not even say the sign."""
        return np.asarray((self.lower <= 0.0) & (self.upper >= 0.0))

    @property
    def at_bound(self) -> NDArray[np.bool_]:
        """(n,) where phi_2 ran into the end of its range: a step, whose interval means nothing."""
        return np.asarray(self.phi[:, 1] > 0.99 * _SLOPE_RANGE[1])


def exact_rows(motion: Motion, torque: Array) -> RowsOf:
    """Rows of known states (simulation), not filtered."""
    return lambda model: Rows(motion, torque, model.columns(motion))


def fit_sigmoid(problem: Problem, rows_of: RowsOf, oversampling: float = 1.0) -> SigmoidFit:
    """Fit pi and phi together; joints are weighted by the residuals of a first pass.

    oversampling : rows per independent sample, for the intervals. Raises InputError where the rows
    are too few.
    """
    data = _Data.of(problem, rows_of)
    if len(data.torque) / oversampling < data.rigid.shape[2] + 3:
        raise InputError("Too few samples to fit rigid model and sigmoid friction", "record longer")
    n = problem.robot.n
    # What rounding leaves, so that data without noise are not weighted by rounding.
    rounding = 1e-12 * float(np.abs(data.torque).max())
    weights, shapes = np.ones(n), data.start()
    for _ in range(2):
        shapes = data.minimise(shapes, weights)
        _, residual, _ = data.project(shapes, weights)
        rms = np.sqrt(np.mean((residual / weights) ** 2, axis=0)) + rounding
        weights = float(np.exp(np.mean(np.log(rms)))) / rms
    linear, residual, probes = data.project(shapes, weights)
    phi = np.column_stack([linear[-n:], shapes])
    std = data.deviations(phi, probes, weights, residual, oversampling)
    dof = max(residual.size / oversampling - len(linear) - 2 * n, 1.0)
    half = stats.t.ppf(0.975, dof) * std
    rmse = np.sqrt(np.mean((residual / weights) ** 2, axis=0))
    return SigmoidFit(phi, std, phi - half, phi + half, linear[:-n], rmse)


@dataclass(frozen=True)
class _Data:
    """rigid (M, n, b), torque (M, n), and the way to the sigmoid's columns at other shapes."""

    robot: Robot
    rows_of: RowsOf
    rigid: Array
    torque: Array

    @classmethod
    def of(cls, problem: Problem, rows_of: RowsOf) -> Self:
        model = problem.model("rigid_body")
        rows = rows_of(model)
        wide = np.zeros((len(rows.torque), problem.robot.n, len(model.parameters)))
        for j, columns in enumerate(rows.columns):
            wide[:, j, columns.indices] = columns.columns
        kept = list(base_parameters(model, problem.independent)[1])
        return cls(problem.robot, rows_of, wide[:, :, kept], rows.torque)

    def probes(self, shapes: Array) -> Array:
        """(M, n, 3) columns of :class:`SigmoidLinearised`."""
        columns = self.rows_of(Model(self.robot, (SigmoidLinearised(self.robot, shapes),))).columns
        return np.stack([c.columns for c in columns], axis=1)

    def project(self, shapes: Array, weights: Array) -> tuple[Array, Array, Array]:
        """Best (pi, phi_1), weighted residual (M, n), and the columns, for given phi_2, phi_3."""
        probes = self.probes(shapes)
        columns = np.concatenate([self.rigid, _diagonal(probes[:, :, 0])], axis=2) * weights[:, None]
        flat = columns.reshape(-1, columns.shape[2])
        target = (self.torque * weights).ravel()
        linear = np.asarray(np.linalg.lstsq(flat, target, rcond=None)[0], float)
        return linear, (target - flat @ linear).reshape(self.torque.shape), probes

    def start(self) -> Array:
        """The slope of a coarse grid with the smallest residual, for all joints alike; no shift."""
        n, weights = self.robot.n, np.ones(self.robot.n)
        # Slopes phi_2 [s/rad] at which the search starts.
        candidates = [np.tile([slope, 0.0], (n, 1)) for slope in (4.0, 10.0, 25.0)]
        return min(candidates, key=lambda s: float(np.sum(self.project(s, weights)[1] ** 2)))

    def minimise(self, shapes: Array, weights: Array) -> Array:
        """phi_2, phi_3 (n, 2) of least weighted residual, by Gauss-Newton in the projected problem."""
        n = self.robot.n
        seen: dict[bytes, tuple[Array, Array, Array]] = {}

        def at(x: Array) -> tuple[Array, Array, Array]:
            if x.tobytes() not in seen:
                seen.clear()
                seen[x.tobytes()] = self.project(_unpack(x), weights)
            return seen[x.tobytes()]

        def jacobian(x: Array) -> Array:
            linear, _, probes = at(x)
            return -self._shape_slopes(linear[-n:], probes, weights, x)

        low = np.tile([np.log(_SLOPE_RANGE[0]), _SHIFT_RANGE[0]], n)
        high = np.tile([np.log(_SLOPE_RANGE[1]), _SHIFT_RANGE[1]], n)
        start = np.column_stack([np.log(shapes[:, 0]), shapes[:, 1]]).ravel()
        found = optimize.least_squares(
            lambda x: at(x)[1].ravel(),
            start,
            jacobian,
            bounds=(low, high),
            x_scale="jac",
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
            max_nfev=100,
        )
        return _unpack(found.x)

    def _shape_slopes(self, amplitude: Array, probes: Array, weights: Array, x: Array) -> Array:
        """Kaufman's Jacobian of the fit by (log phi_2, phi_3): what the linear part cannot follow."""
        n, slope = self.robot.n, np.exp(x[::2])
        by_slope = _diagonal(probes[:, :, 1] * amplitude * slope)
        by_shift = _diagonal(probes[:, :, 2] * amplitude)
        both = np.stack([by_slope, by_shift], axis=-1).reshape(*by_slope.shape[:2], 2 * n)
        both = (both * weights[:, None]).reshape(-1, 2 * n)
        columns = np.concatenate([self.rigid, _diagonal(probes[:, :, 0])], axis=2) * weights[:, None]
        q = np.linalg.qr(columns.reshape(len(both), -1))[0]
        return np.asarray(both - q @ (q.T @ both))

    def deviations(
        self, phi: Array, probes: Array, weights: Array, residual: Array, oversampling: float
    ) -> Array:
        """(n, 3) standard deviations of phi from the Jacobian of the whole fit."""
        n, b = self.robot.n, self.rigid.shape[2]
        own = probes * np.stack([np.ones(n), phi[:, 0], phi[:, 0]], axis=1)
        parts = [_diagonal(own[:, :, k]) for k in range(3)]
        jacobian = np.concatenate([self.rigid, *parts], axis=2) * weights[:, None]
        flat = jacobian.reshape(-1, jacobian.shape[2])
        # Rows that repeat each other count that often in J^T J, which the division here takes back.
        variance = float(np.sum(residual**2)) / max(residual.size / oversampling - flat.shape[1], 1.0)
        size = np.linalg.norm(flat, axis=0)
        inverse = np.linalg.pinv((flat / size).T @ (flat / size), hermitian=True)
        spread = np.sqrt(variance * np.diagonal(inverse)) / size
        return np.asarray(spread[b:].reshape(3, n).T)


def _unpack(x: Array) -> Array:
    return np.column_stack([np.exp(x[::2]), x[1::2]])


def _diagonal(columns: Array) -> Array:
    """(M, n, n) with each joint's column (M, n) on its own rows."""
    return np.asarray(columns[:, :, None] * np.eye(columns.shape[1]))


def residual_rms(problem: Problem, parts: Sequence[RowsOf], fit: SigmoidFit) -> Array:
    """RMSE (n,) [N m] of a fit on other rows."""
    squares, count = np.zeros(problem.robot.n), 0
    for rows_of in parts:
        data = _Data.of(problem, rows_of)
        sigmoid = data.probes(fit.phi[:, 1:])[:, :, 0] * fit.phi[:, 0]
        residual = data.torque - data.rigid @ fit.pi - sigmoid
        squares += np.sum(residual**2, axis=0)
        count += len(residual)
    return np.sqrt(squares / count)
