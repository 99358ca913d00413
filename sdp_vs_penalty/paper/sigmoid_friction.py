"""The sigmoid friction of the paper's Table I, fitted joint by joint beside the rigid model.

    f(dq) = phi_1 / (1 + exp(-phi_2 (dq + phi_3))) - phi_1 / (1 + exp(-phi_2 phi_3))

(Gaz et al. 2019, eq. 12), phi_1 [N m], phi_2 [s/rad], phi_3 [rad/s]; zero at rest. The base
parameters pi of the links and all phi are fitted together to W pi + f = tau, because a rigid part
fitted without friction would have swallowed some of it. A coarse grid of phi_2 starts the search.
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
    b, n = data.rigid.shape[2], problem.robot.n
    if len(data.torque) / oversampling < b + 3:
        raise InputError("Too few samples to fit rigid model and sigmoid friction", "record longer")
    # What rounding leaves, so that data without noise are not weighted by rounding.
    rounding = 1e-12 * float(np.abs(data.torque).max())
    weights, empty = np.ones(n), np.zeros(b + n)
    grid = [
        np.concatenate([empty, np.full(n, np.log(slope)), np.zeros(n)]) for slope in (4.0, 10.0, 25.0)
    ]
    starts = [data.solved(x, weights) for x in grid]
    x = min(starts, key=lambda x: float(np.sum(data.residual(x) ** 2)))
    for _ in range(2):
        x = data.minimise(x, weights)
        rms = np.sqrt(np.mean(data.residual(x) ** 2, axis=0)) + rounding
        weights = float(np.exp(np.mean(np.log(rms)))) / rms
    x = data.solved(x, weights)
    phi = x[b:].reshape(3, n).T.copy()
    phi[:, 1] = np.exp(phi[:, 1])
    jacobian = (data.columns(x) * weights[:, None]).reshape(-1, len(x))
    size, count = np.linalg.norm(jacobian, axis=0), data.torque.size / oversampling
    # Rows that repeat each other count that often in J^T J, which the division here takes back.
    dof = max(count - len(x), 1.0)
    variance = float(np.sum((data.residual(x) * weights) ** 2)) / dof
    inverse = np.linalg.pinv((jacobian / size).T @ (jacobian / size), hermitian=True)
    std = (np.sqrt(variance * np.diagonal(inverse)) / size)[b:].reshape(3, n).T.copy()
    std[:, 1] *= phi[:, 1]  # of phi_2, from that of its logarithm
    half = stats.t.ppf(0.975, dof) * std
    rmse = np.sqrt(np.mean(data.residual(x) ** 2, axis=0))
    return SigmoidFit(phi, std, phi - half, phi + half, x[:b], rmse)


@dataclass(frozen=True)
class _Data:
    """rigid (M, n, b), torque (M, n), and the way to the sigmoid's columns at other shapes.

    x (b + 3 n,) : pi, phi_1, log phi_2, phi_3.
    """

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

    def columns(self, x: Array) -> Array:
        """(M, n, b + 3 n) derivative of the torque in x."""
        amplitude, slope, shift = x[self.rigid.shape[2] :].reshape(3, -1)
        slope = np.exp(slope)
        probes = self.probes(np.column_stack([slope, shift]))
        probes = probes * np.stack([np.ones(len(slope)), amplitude * slope, amplitude], axis=1)
        own = [probes[:, :, k, None] * np.eye(len(slope)) for k in range(3)]
        return np.concatenate([self.rigid, *own], axis=2)

    def residual(self, x: Array) -> Array:
        """(M, n) of the torque."""
        linear = x.copy()
        linear[-2 * self.robot.n :] = 0.0  # phi_2 and phi_3 act through the columns
        return np.asarray(self.torque - self.columns(x) @ linear)

    def solved(self, x: Array, weights: Array) -> Array:
        """x with pi and phi_1 of least weighted residual at its phi_2 and phi_3."""
        columns, out = self.columns(x)[:, :, : -2 * self.robot.n] * weights[:, None], x.copy()
        flat, target = columns.reshape(self.torque.size, -1), (self.torque * weights).ravel()
        out[: flat.shape[1]] = np.linalg.lstsq(flat, target, rcond=None)[0]
        return out

    def minimise(self, x: Array, weights: Array) -> Array:
        """x of least weighted residual, by Gauss-Newton within the bounds of phi_2 and phi_3."""
        n = self.robot.n
        ends = np.tile([[-np.inf], [np.inf]], len(x))
        ends[:, -2 * n : -n] = np.log(_SLOPE_RANGE)[:, None]
        ends[:, -n:] = np.array(_SHIFT_RANGE)[:, None]
        found = optimize.least_squares(
            lambda x: (self.residual(x) * weights).ravel(),
            x,
            lambda x: -(self.columns(x) * weights[:, None]).reshape(-1, len(x)),
            bounds=(ends[0], ends[1]),
            x_scale="jac",
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
            max_nfev=100,
        )
        return np.asarray(found.x)


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
