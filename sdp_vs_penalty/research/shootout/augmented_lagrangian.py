"""Log-Cholesky variables, an augmented Lagrangian and L-BFGS: what one writes without an SDP solver.

Each link's 4x4 demand P (with a minimum thickness that of the demand) is L L^T in units of an interior
point, L lower triangular, the logarithms of its diagonal variables: consistent by construction (Rucker,
Wensing, "Smooth parameterization of rigid-body inertia", RA-L 2022). Every other demand h(theta) >= 0 is
imposed by f + 1/(2 c) sum(max(0, u - c h)^2 - u^2), u <- max(0, u - c h) (Nocedal, Wright, Numerical
Optimization, 2nd ed., section 17.4), minimised by SciPy's L-BFGS-B, conditioned anew in each round.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize

from sdp_vs_penalty.research.shootout.instance import Instance
from sdp_vs_penalty.research.shootout.judge import Answer, no_answer
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint

#: Logarithms of a factor's diagonal end here, in units of an interior point.
_LOGARITHM = 25.0
#: Least curvature, in shares of the unconstrained loss: smaller ones stretch no variable further.
_CURVATURE = 0.1
#: Rounds of multipliers, and the weight c of the demands (100 fails on the Panda).
_ROUNDS, _WEIGHT = 60, 10.0


def options(accuracy: float) -> dict[str, Any]:
    """What L-BFGS-B is told, by the names of SciPy's documentation: gtol of the scaled gradient."""
    return {"maxcor": 50, "maxiter": 1000, "maxfun": 2000, "ftol": 0.0, "gtol": 1e-2 * accuracy}


class Chart:
    """theta (p,) of variables (n,): ten a link, then the other parameters in units of their size inside.

    rows (m, p), constant (m,), cones : the demands that the chart does not fulfil, each in units of its
    size at the strictly feasible ``inside``, where the links' factors have rows of length one and which
    ``start`` are the variables of. LinAlgError where it is not inside.
    """

    def __init__(self, demands: Sequence[Constraint], inside: Array) -> None:
        found: dict[int, Constraint] = {}
        for c in demands:
            whole = c.cone == "psd" and c.constant.shape == (4, 4) and len(c.indices) == 10
            if whole and (c.family == "minimum thickness" or int(c.indices[0]) not in found):
                found[int(c.indices[0])] = c
        links = found.values()
        values = np.array([c.value(inside) for c in links]).reshape(-1, 4, 4)
        self.shift = np.array([c.constant for c in links]).reshape(-1, 16)
        #: (links, 16, 10) from each demand to its parameters, and units (links, 4) of its factor's rows.
        self.maps = np.array([np.linalg.pinv(c.coefficients.reshape(10, 16)) for c in links]).reshape(
            -1, 16, 10
        )
        self.corners = np.sqrt(np.diagonal(values, axis1=1, axis2=2))
        self.lower = np.tril_indices(4)
        self.indices = np.array([c.indices for c in links], np.intp).reshape(-1, 10)
        self.others = np.setdiff1d(np.arange(len(inside)), self.indices)
        self.scale = np.maximum(np.abs(inside[self.others]), 1e-2)
        rows, constants, self.cones = [np.zeros((0, len(inside)))], [np.zeros(0)], []
        for c in (c for c in demands if c.cone != "psd"):
            size = np.maximum(np.abs(c.value(inside)), 1e-6)
            if c.cone == "soc":
                self.cones.append((c, float(size[0])))
                continue
            rows.append(np.zeros((len(c.constant), len(inside))))
            rows[-1][:, c.indices] = c.coefficients.T / size[:, None]
            constants.append(c.constant / size)
        self.rows, self.constant = np.concatenate(rows), np.concatenate(constants)
        factors = np.linalg.cholesky(values / (self.corners[:, :, None] * self.corners[:, None, :]))
        factors[:, range(4), range(4)] = np.log(factors[:, range(4), range(4)])
        both = factors[:, *self.lower].ravel(), inside[self.others] / self.scale
        self.start = np.concatenate(both)

    def theta(self, x: Array) -> tuple[Array, Array]:
        """theta (p,) and the factors L (links, 4, 4) of the variables (n,)."""
        count = self.indices.size
        factors = np.zeros((len(self.indices), 4, 4))
        factors[:, *self.lower] = x[:count].reshape(-1, 10)
        logarithms = np.clip(factors[:, range(4), range(4)], -_LOGARITHM, _LOGARITHM)
        factors[:, range(4), range(4)] = np.exp(logarithms)
        factors *= self.corners[:, :, None]
        theta = np.empty(count + len(self.others))
        flat = (factors @ factors.transpose(0, 2, 1)).reshape(-1, 16) - self.shift
        theta[self.indices] = np.einsum("ke,kei->ki", flat, self.maps)
        theta[self.others] = x[count:] * self.scale
        return theta, factors

    def slope(self, factors: Array, gradient: Array) -> Array:
        """(n,) the gradient in the variables, from that in theta (p,)."""
        matrix = np.einsum("kei,ki->ke", self.maps, gradient[self.indices]).reshape(-1, 4, 4)
        pull = (matrix + matrix.transpose(0, 2, 1)) @ factors * self.corners[:, :, None]
        pull[:, range(4), range(4)] *= factors[:, range(4), range(4)] / self.corners
        return np.concatenate([pull[:, *self.lower].ravel(), gradient[self.others] * self.scale])

    def demands(self, theta: Array) -> tuple[Array, Array]:
        """h (m,) of what the chart does not fulfil, and its Jacobian (m, p)."""
        h, slopes = [self.rows @ theta + self.constant], [self.rows]
        for c, size in self.cones:
            value = c.value(theta)
            length = np.sqrt(value[1:] @ value[1:] + 1e-24)
            h.append(np.array([value[0] - length]) / size)
            wide = np.zeros((1, len(theta)))
            wide[0, c.indices] = c.coefficients @ np.append(1.0, -value[1:] / length) / size
            slopes.append(wide)
        return np.concatenate(h), np.concatenate(slopes)


def solve(instance: Instance, accuracy: float) -> Answer:
    """Minimise from the interior point; no multipliers come back, since a chart has none for its links.

    Claims an optimum where slope, violation and complementarity are within accuracy.
    """
    inside = instance.interior
    if inside is None:
        return no_answer(instance, "no interior point to start from")
    data = instance.data
    size = max(data.loss(instance.task.ols), 1e-9 * data.tau_squared, 1e-300)
    chart = Chart(instance.sent, inside)
    x, u = chart.start, np.zeros(len(chart.demands(inside)[0]))
    message, claims = "", "inaccurate"

    def lagrangian(z: Array, x: Array, turn: Array, u: Array) -> tuple[float, Array]:
        theta, factors = chart.theta(x + turn @ z)
        h, slopes = chart.demands(theta)
        push = np.maximum(0.0, u - _WEIGHT * h)
        value = instance.objective.value(theta) / size + 0.5 * float(push @ push - u @ u) / _WEIGHT
        gradient = instance.objective.gradient(theta) / size - push @ slopes
        return (value if np.isfinite(value) else 1e300), turn.T @ chart.slope(factors, gradient)

    for _ in range(_ROUNDS):
        turn = _conditioner(chart, x, data.R / np.sqrt(size), u)
        told: dict[str, Any] = {"args": (x, turn, u), "options": options(accuracy)}
        found = minimize(lagrangian, np.zeros(len(x)), method="L-BFGS-B", jac=True, **told)
        x, message = x + turn @ found.x, str(found.message)
        h, _ = chart.demands(chart.theta(x)[0])
        u = np.maximum(0.0, u - _WEIGHT * h)
        worst = float(np.abs(np.minimum(h, u / _WEIGHT)).max(initial=0.0))
        if max(worst, float(np.abs(found.jac).max())) <= accuracy:
            claims = "optimal"
            break
    return Answer(chart.theta(x)[0], claims, message)


def _conditioner(chart: Chart, x: Array, R: Array, u: Array) -> Array:
    """T (n, n) with T' H T = 1 for the Gauss-Newton matrix H of the Lagrangian at x: steps of L-BFGS are
    taken in T^-1 x."""
    theta, factors = chart.theta(x)
    h, slopes = chart.demands(theta)
    rows = np.concatenate([np.sqrt(2.0) * R, np.sqrt(_WEIGHT) * slopes[u - _WEIGHT * h > 0.0]])
    turned = np.array([chart.slope(factors, row) for row in rows])
    values, vectors = np.linalg.eigh(turned.T @ turned)
    return np.asarray(vectors / np.sqrt(np.maximum(values, _CURVATURE)))
