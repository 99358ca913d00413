"""Log-Cholesky variables, an augmented Lagrangian and L-BFGS: what one writes without an SDP solver.

Each link's 4x4 demand P (with a minimum thickness that of the demand) is L L^T in units of an interior
point, L lower triangular, the logarithms of its diagonal variables: consistent by construction (Rucker,
Wensing, "Smooth parameterization of rigid-body inertia", RA-L 2022). Every other demand h(theta) >= 0 is
imposed by f + 1/(2 c) sum(max(0, u - c h)^2 - u^2), u <- max(0, u - c h) (Nocedal, Wright, Numerical
Optimization, 2nd ed., section 17.4), minimised by SciPy's L-BFGS-B, conditioned anew in each round.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.judge import Answer, no_answer

ROWS, COLUMNS = np.tril_indices(4)
DIAGONAL = ROWS == COLUMNS
#: Logarithms of a factor's diagonal end here, in units of an interior point.
_LOGARITHM = 25.0
#: Least curvature, in shares of the unconstrained loss: smaller ones stretch no variable further.
_CURVATURE = 0.1
#: Rounds of multipliers; the first weight c of the demands, its growth, and where it ends.
_ROUNDS, _WEIGHT, _GROWTH, _HEAVIEST = 60, 10.0, 10.0, 1e2
#: A demand's violation has to fall to this share in a round, or c grows (Nocedal, Wright, 17.4).
_FALL = 0.25


def options(accuracy: float) -> dict[str, Any]:
    """What L-BFGS-B is told, by the names of SciPy's documentation: gtol of the scaled gradient."""
    return {"maxcor": 50, "maxiter": 1000, "maxfun": 2000, "ftol": 0.0, "gtol": 1e-2 * accuracy}


@dataclass(frozen=True)
class LogCholesky:
    """theta (p,) of variables (n,): ten a link, then the other parameters in units of ``scale``.

    links : the demand P of each link; maps (links, 16, 10) from P to its parameters; corners (links, 4)
        units of L's rows; indices (links, 10) and others : where the parameters stand.
    """

    links: tuple[Constraint, ...]
    maps: Array
    corners: Array
    indices: Any
    others: Any
    scale: Array

    @classmethod
    def at(cls, demands: Sequence[Constraint], inside: Array) -> LogCholesky:
        """The chart in which the strictly feasible ``inside`` has factors with rows of length one."""
        found: dict[int, Constraint] = {}
        for c in demands:
            whole = c.cone == "psd" and c.constant.shape == (4, 4) and len(c.indices) == 10
            if whole and (c.family == "minimum thickness" or int(c.indices[0]) not in found):
                found[int(c.indices[0])] = c
        links = tuple(found.values())
        maps = np.array([np.linalg.pinv(c.coefficients.reshape(10, 16)) for c in links])
        corners = np.array([np.sqrt(np.diagonal(c.value(inside))) for c in links])
        indices = np.array([c.indices for c in links], np.intp).reshape(-1, 10)
        others = np.setdiff1d(np.arange(len(inside)), indices)
        scale = np.maximum(np.abs(inside[others]), 1e-2)
        return cls(links, maps.reshape(-1, 16, 10), corners.reshape(-1, 4), indices, others, scale)

    def variables(self, theta: Array) -> Array:
        """(n,) of a strictly feasible theta (p,). LinAlgError for another."""
        units = self.corners[:, :, None] * self.corners[:, None, :]
        values = np.array([c.value(theta) for c in self.links]).reshape(-1, 4, 4)
        entries = np.linalg.cholesky(values / units)[:, ROWS, COLUMNS]
        entries[:, DIAGONAL] = np.log(entries[:, DIAGONAL])
        return np.concatenate([entries.ravel(), theta[self.others] / self.scale])

    def theta(self, x: Array) -> tuple[Array, Array]:
        """theta (p,) and the factors L (links, 4, 4) of the variables (n,)."""
        count = 10 * len(self.links)
        entries = x[:count].reshape(-1, 10).copy()
        entries[:, DIAGONAL] = np.exp(np.clip(entries[:, DIAGONAL], -_LOGARITHM, _LOGARITHM))
        factors = np.zeros((len(entries), 4, 4))
        factors[:, ROWS, COLUMNS] = entries
        factors *= self.corners[:, :, None]
        theta = np.empty(self.indices.size + len(self.others))
        constant = np.array([c.constant for c in self.links]).reshape(-1, 16)
        flat = (factors @ factors.transpose(0, 2, 1)).reshape(-1, 16) - constant
        theta[self.indices] = np.einsum("ke,kei->ki", flat, self.maps)
        theta[self.others] = x[count:] * self.scale
        return theta, factors

    def slope(self, factors: Array, gradient: Array) -> Array:
        """(n,) the gradient in the variables, from that in theta (p,)."""
        matrix = np.einsum("kei,ki->ke", self.maps, gradient[self.indices]).reshape(-1, 4, 4)
        pull = (matrix + matrix.transpose(0, 2, 1)) @ factors
        entries = (pull * self.corners[:, :, None])[:, ROWS, COLUMNS]
        entries[:, DIAGONAL] *= factors[:, range(4), range(4)] / self.corners
        return np.concatenate([entries.ravel(), gradient[self.others] * self.scale])


@dataclass(frozen=True)
class _Demands:
    """h (m,) of all demands that the chart does not fulfil, each in its own unit, and their slopes."""

    linear: Array
    constant: Array
    cones: tuple[tuple[Constraint, float], ...]

    @classmethod
    def of(cls, demands: Sequence[Constraint], inside: Array) -> _Demands:
        rows, constants, cones = [np.zeros((0, len(inside)))], [np.zeros(0)], []
        for c in demands:
            size = np.maximum(np.abs(c.value(inside)), 1e-6)
            if c.cone == "soc":
                cones.append((c, float(size[0])))
                continue
            wide = np.zeros((len(c.constant), len(inside)))
            wide[:, c.indices] = c.coefficients.T
            rows.append(wide / size[:, None])
            constants.append(c.constant / size)
        return cls(np.concatenate(rows), np.concatenate(constants), tuple(cones))

    def at(self, theta: Array) -> tuple[Array, Array]:
        """h (m,) and its Jacobian (m, p)."""
        h, slopes = [self.linear @ theta + self.constant], [self.linear]
        for c, size in self.cones:
            value = c.value(theta)
            length = np.sqrt(value[1:] @ value[1:] + 1e-24)
            normal = np.append(1.0, -value[1:] / length)
            wide = np.zeros((1, len(theta)))
            wide[0, c.indices] = c.coefficients @ normal / size
            h.append(np.array([(value[0] - length) / size]))
            slopes.append(wide)
        return np.concatenate(h), np.concatenate(slopes)


def solve(instance: Instance, accuracy: float) -> Answer:
    """Minimise from the interior point; no multipliers come back, since a chart has none for its links.

    Claims an optimum where slope, violation and complementarity are within accuracy.
    """
    start = time.perf_counter()
    inside = instance.interior
    if inside is None:
        return no_answer(instance, "no interior point to start from", 0.0)
    data = instance.data
    size = max(data.loss(instance.task.ols), 1e-9 * data.tau_squared, 1e-300)
    chart = LogCholesky.at(instance.sent, inside)
    fulfilled = {(c.family, c.name) for c in chart.links}
    rest = [c for c in instance.sent if c.cone != "psd" and (c.family, c.name) not in fulfilled]
    demands = _Demands.of(rest, inside)
    u, weight, worst = np.zeros(len(demands.at(inside)[0])), _WEIGHT, np.inf
    x = chart.variables(inside)
    ready, steps, message, claims = time.perf_counter(), 0, "", "inaccurate"

    def lagrangian(z: Array, x: Array, turn: Array, u: Array, weight: float) -> tuple[float, Array]:
        theta, factors = chart.theta(x + turn @ z)
        h, slopes = demands.at(theta)
        push = np.maximum(0.0, u - weight * h)
        value = instance.objective.value(theta) / size + 0.5 * float(push @ push - u @ u) / weight
        gradient = instance.objective.gradient(theta) / size - push @ slopes
        return (value if np.isfinite(value) else 1e300), turn.T @ chart.slope(factors, gradient)

    for _ in range(_ROUNDS):
        turn = _conditioner(chart, demands, x, data.R / np.sqrt(size), u, weight)
        found = minimize(
            lagrangian, np.zeros(len(x)), (x, turn, u, weight), "L-BFGS-B", jac=True,
            options=options(accuracy),
        )  # fmt: skip
        x, message, steps = x + turn @ found.x, str(found.message), steps + int(found.nit)
        h, _ = demands.at(chart.theta(x)[0])
        u = np.maximum(0.0, u - weight * h)
        before, worst = worst, float(np.abs(np.minimum(h, u / weight)).max(initial=0.0))
        if max(worst, float(np.abs(found.jac).max())) <= accuracy:
            claims = "optimal"
            break
        if worst > max(accuracy, _FALL * before):
            weight = min(_GROWTH * weight, _HEAVIEST)
    seconds = time.perf_counter() - ready
    return Answer(chart.theta(x)[0], claims, message, steps, ready - start, seconds)


def _conditioner(
    chart: LogCholesky, demands: _Demands, x: Array, R: Array, u: Array, weight: float
) -> Array:
    """T (n, n) with T' H T = 1 for the Gauss-Newton matrix H of the Lagrangian at x: steps of L-BFGS are
    taken in T^-1 x."""
    theta, factors = chart.theta(x)
    h, slopes = demands.at(theta)
    rows = np.concatenate([np.sqrt(2.0) * R, np.sqrt(weight) * slopes[u - weight * h > 0.0]])
    turned = np.array([chart.slope(factors, row) for row in rows])
    values, vectors = np.linalg.eigh(turned.T @ turned)
    return np.asarray(vectors / np.sqrt(np.maximum(values, _CURVATURE)))
