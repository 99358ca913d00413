"""Log-Cholesky variables, an augmented Lagrangian and L-BFGS: what one writes without
an SDP solver.

Each link's 4x4 demand P (with a minimum thickness that of the demand) is L L^T in units
of an interior point, L lower triangular, the logarithms of its diagonal variables:
consistent by construction (Rucker, Wensing, "Smooth parameterization of rigid-body
inertia", RA-L 2022). Every other demand is imposed by the shifted penalty of
``estimators/penalty.py``, of one weight (Nocedal, Wright, Numerical Optimization,
section 17.4), minimised by SciPy's L-BFGS-B, conditioned anew in each round.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize

from sdp_vs_penalty.estimators.penalty import ShiftedPenalty
from sdp_vs_penalty.research.shootout.instances import Instance
from sdp_vs_penalty.research.shootout.judge import Answer, no_answer
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet

#: Logarithms of a factor's diagonal end here, in units of an interior point: at what
#: doubles resolve.
_LEAST = float(np.log(np.finfo(float).eps))


def options(accuracy: float) -> dict[str, Any]:
    """What L-BFGS-B is told, by the names of SciPy's documentation: gtol of the scaled
    gradient."""
    return {
        "maxcor": 50,
        "maxiter": 1000,
        "maxfun": 2000,
        "ftol": 0.0,
        "gtol": 1e-2 * accuracy,
    }


class Chart:
    """theta (p,) of variables (n,): ten a link, then the other parameters in units of
    their size at the strictly feasible ``inside``, where the links' factors have rows
    of length one and which ``start`` are the variables of. LinAlgError where it is not
    inside."""

    def __init__(self, demands: Sequence[Constraint], inside: Array) -> None:
        ordered = sorted(demands, key=lambda c: c.family == "minimum thickness")
        full_rank = (
            c for c in ordered if c.constant.shape == (4, 4) and len(c.indices) == 10
        )
        links = {int(c.indices[0]): c for c in full_rank}.values()
        self.indices = np.array([c.indices for c in links], np.intp).reshape(-1, 10)
        self.others = np.setdiff1d(np.arange(len(inside)), self.indices)
        self.scale = np.maximum(np.abs(inside[self.others]), 1e-2)
        #: From each demand to its parameters: less a shift (links, 16), by a map
        #: (links, 16, 10).
        self.shift = np.array([c.constant for c in links]).reshape(-1, 16)
        maps = [np.linalg.pinv(c.coefficients.reshape(10, 16)) for c in links]
        self.maps, self.lower = np.array(maps).reshape(-1, 16, 10), np.tril_indices(4)
        values = np.array([c.value(inside) for c in links]).reshape(-1, 4, 4)
        #: (links, 4, 1) units of the factors' rows.
        self.corners = np.sqrt(np.diagonal(values, axis1=1, axis2=2))[:, :, None]
        factors = np.linalg.cholesky(
            values / (self.corners * self.corners.transpose(0, 2, 1))
        )
        factors[:, range(4), range(4)] = np.log(factors[:, range(4), range(4)])
        both = factors[:, *self.lower].ravel(), inside[self.others] / self.scale
        self.start = np.concatenate(both)

    def theta(self, x: Array) -> tuple[Array, Array]:
        """theta (p,) and the factors L (links, 4, 4) of the variables (n,)."""
        count = self.indices.size
        factors = np.zeros((len(self.indices), 4, 4))
        factors[:, *self.lower] = x[:count].reshape(-1, 10)
        factors[:, range(4), range(4)] = np.exp(
            np.clip(factors[:, range(4), range(4)], _LEAST, -_LEAST)
        )
        factors *= self.corners
        theta = np.empty(len(x))
        flat = (factors @ factors.transpose(0, 2, 1)).reshape(-1, 16) - self.shift
        theta[self.indices] = np.einsum("ke,kei->ki", flat, self.maps)
        theta[self.others] = x[count:] * self.scale
        return theta, factors

    def slope(self, factors: Array, gradient: Array) -> Array:
        """(n,) the gradient in the variables, from that in theta (p,)."""
        matrix = np.einsum("kei,ki->ke", self.maps, gradient[self.indices]).reshape(
            -1, 4, 4
        )
        pull = (matrix + matrix.transpose(0, 2, 1)) @ factors * self.corners
        pull[:, range(4), range(4)] *= (
            factors[:, range(4), range(4)] / self.corners[:, :, 0]
        )
        return np.concatenate(
            [pull[:, *self.lower].ravel(), gradient[self.others] * self.scale]
        )


def solve(instance: Instance, accuracy: float) -> Answer:
    """Minimise from the interior point; no multipliers come back, since a chart has
    none for its links.

    Claims an optimum where slope, violation and complementarity are within accuracy.
    """
    inside = instance.interior
    if inside is None:
        return no_answer(instance, "no interior point to start from")
    others = ConstraintSet(tuple(c for c in instance.sent if c.cone != "psd"))
    penalty = ShiftedPenalty(instance.task, instance.data, others, inside)
    chart = Chart(instance.sent, inside)
    scale = penalty.theta_scale
    size = penalty.loss_scale
    x = chart.start
    shifts = [np.zeros_like(part.values(inside)) for part in penalty.parts]
    # Of the demands (100 fails on the Panda); its inverse is the least curvature:
    # smaller ones stretch no variable further.
    weight = 10.0
    message = ""
    claims = "inaccurate"

    def lagrangian(z: Array) -> tuple[float, Array]:
        theta, factors = chart.theta(x + turn @ z)
        value = instance.objective.value(theta) / size
        slope = instance.objective.gradient(theta) / size
        moved = penalty.shifted(theta / scale, shifts, weight)
        for part, shift, push in zip(penalty.parts, shifts, moved, strict=True):
            value += 0.5 * float(np.vdot(push, push) - np.vdot(shift, shift)) / weight
            slope -= push.ravel() @ part.jacobian(theta) / scale
        return (value if np.isfinite(value) else 1e300), turn.T @ chart.slope(
            factors, slope
        )

    for _ in range(60):  # rounds of multipliers
        # T (n, n) with T' H T = 1 for the Gauss-Newton matrix H: steps of L-BFGS are
        # taken in T^-1 x.
        theta, factors = chart.theta(x)
        rows = np.sqrt(2.0) * penalty.rows(theta / scale, shifts, weight)[1] / scale
        turned = np.array([chart.slope(factors, row) for row in rows])
        values, vectors = np.linalg.eigh(turned.T @ turned)
        turn = vectors / np.sqrt(np.maximum(values, 1.0 / weight))
        optimiser_options: dict[str, Any] = {
            "method": "L-BFGS-B",
            "jac": True,
            "options": options(accuracy),
        }
        solution = minimize(lagrangian, np.zeros(len(x)), **optimiser_options)
        x = x + turn @ solution.x
        message = str(solution.message)
        moved = penalty.shifted(chart.theta(x)[0] / scale, shifts, weight)
        changes = (
            np.abs(a - b).max(initial=0.0) for a, b in zip(moved, shifts, strict=True)
        )
        worst = max(changes, default=0.0) / weight
        shifts = moved
        if max(worst, float(np.abs(solution.jac).max())) <= accuracy:
            claims = "optimal"
            break
    return Answer(chart.theta(x)[0], claims, message)
