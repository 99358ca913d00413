"""Log-Cholesky variables, an augmented Lagrangian and L-BFGS: what one writes without
an SDP solver.

Each link's 4x4 demand P (that of the minimum thickness, if there is one) is L L^T in units
of an interior point. The variables are the entries of the lower triangle L, with logarithms on
its diagonal: every value of them is consistent (Rucker, Wensing, "Smooth parameterization of rigid-body
inertia", RA-L 2022). Every other demand is imposed by the shifted penalty of
``estimators/penalty.py``, of one weight (Nocedal, Wright, Numerical Optimization,
section 17.4), minimised by SciPy's L-BFGS-B, conditioned anew in each round.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from sdp_vs_penalty.estimators.penalty import ShiftedPenalty, largest_change
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.shootout.instances import Instance
from sdp_vs_penalty.shootout.judge import Answer, no_answer

#: Least logarithm of a factor's diagonal, in units of an interior point: below it doubles
#: resolve nothing. Its negative is the greatest one.
_SMALLEST_LOGARITHM = float(np.log(np.finfo(float).eps))
#: Weight of the penalty; 100 fails on the Panda.
_WEIGHT = 10.0
#: Rounds of minimisation and update of the shifts, at most.
_ROUNDS = 60


def options(accuracy: float) -> dict[str, Any]:
    """Return the options of SciPy's L-BFGS-B for a relative accuracy.

    Parameters
    ----------
    accuracy : float
        Relative accuracy that is asked for; gtol, of the scaled gradient, is a
        hundredth.

    Returns
    -------
    dict
        Options by the names of SciPy's documentation.
    """
    return {
        "maxcor": 50,
        "maxiter": 1000,
        "maxfun": 2000,
        "ftol": 0.0,
        "gtol": 1e-2 * accuracy,
    }


class Chart:
    """Variables (n,) of which every value is a theta (p,) with consistent links: ten a
    link, then the other parameters in units of their size.

    - ``start`` (n,): the variables of a strictly feasible point, ``inside``.
    - ``indices`` (links, 10) and ``others`` (k,): places of the links' and of the other
      parameters in theta.
    - ``shift`` (links, 16) and ``maps`` (links, 16, 10): from a link's demand P to its
      parameters.
    - ``corners`` (links, 4, 1): units of the rows of P's factor.
    """

    #: Places of a factor's entries, by row, and of its diagonal.
    lower = np.tril_indices(4)
    diagonal = np.arange(4)

    def __init__(self, demands: Sequence[Constraint], inside: Array) -> None:
        """Set up the variables, so that ``start`` stands for the point ``inside``.

        A link's 4x4 demand is P = L L^T with a lower triangular L. Its ten variables
        are the entries of L, scaled so that the rows have length 1 at ``inside``, with
        logarithms on the diagonal. ``inside`` (p,) is strictly feasible.

        Parameters
        ----------
        demands : sequence of Constraint
            All constraints; those of 4x4 matrices define the links' variables.

        Raises
        ------
        LinAlgError
            If ``inside`` is not strictly feasible.
        """
        # Which parameters in theta (p,) are those of links (links, 10), which others.
        links = _link_demands(demands)
        self.indices = np.array([c.indices for c in links], np.intp).reshape(-1, 10)
        self.others = np.setdiff1d(np.arange(len(inside)), self.indices)
        self.scale = np.maximum(np.abs(inside[self.others]), 1e-2)
        self.shift = np.array([c.constant for c in links]).reshape(-1, 16)
        # A link's P is linear in its ten parameters; the maps invert that.
        maps = [np.linalg.pinv(c.coefficients.reshape(10, 16)) for c in links]
        self.maps = np.array(maps).reshape(-1, 16, 10)
        values = np.array([c.value(inside) for c in links]).reshape(-1, 4, 4)
        # Divided by these roots, P has a unit diagonal, and L rows of length 1.
        roots = np.sqrt(np.diagonal(values, axis1=1, axis2=2))
        self.corners = roots[:, :, None]
        factors = np.linalg.cholesky(values / (self.corners * roots[:, None, :]))
        logarithms = np.log(factors[:, self.diagonal, self.diagonal])
        factors[:, self.diagonal, self.diagonal] = logarithms
        of_links = factors[:, *self.lower].ravel()
        of_others = inside[self.others] / self.scale
        self.start = np.concatenate([of_links, of_others])

    def theta(self, x: Array) -> tuple[Array, Array]:
        """Compute the parameters theta from the variables x.

        For each link, x holds the lower triangle of L with logarithms on the diagonal;
        the link's parameters are the linear map of L L^T minus a constant.

        Parameters
        ----------
        x : (n,) array
            Variables: ten for each link, then the other parameters in units of their
            size.

        Returns
        -------
        tuple of ((p,) array, (links, 4, 4) array)
            Parameters in SI units, and the factors L.
        """
        count = self.indices.size
        factors = np.zeros((len(self.indices), 4, 4))
        factors[:, *self.lower] = x[:count].reshape(-1, 10)
        # Logarithms end where doubles do, so that no step overflows.
        logarithms = factors[:, self.diagonal, self.diagonal]
        pivots = np.exp(np.clip(logarithms, _SMALLEST_LOGARITHM, -_SMALLEST_LOGARITHM))
        factors[:, self.diagonal, self.diagonal] = pivots
        factors *= self.corners  # back from the units of the start
        demands = factors @ factors.transpose(0, 2, 1)
        flat = demands.reshape(-1, 16) - self.shift
        theta = np.empty(len(x))
        # k: link; e: entry of its 4x4 matrix; i: one of its ten parameters.
        theta[self.indices] = np.einsum("ke,kei->ki", flat, self.maps)
        theta[self.others] = x[count:] * self.scale
        return theta, factors

    def slope(self, factors: Array, gradient: Array) -> Array:
        """Compute the gradient in the variables from the gradient in theta by the chain
        rule.

        With G = df/dP of a link's matrix P = L L^T, it is df/dL = (G + G^T) L; a
        logarithm's derivative is that of its diagonal entry times the entry.

        The gradient is (p,) in the parameters and (n,) in the variables; ``factors``
        (links, 4, 4) hold L of each link.
        """
        # k: link; e: entry of its 4x4 matrix; i: one of its ten parameters.
        of_links = np.einsum("kei,ki->ke", self.maps, gradient[self.indices])
        matrix = of_links.reshape(-1, 4, 4)
        symmetric = matrix + matrix.transpose(0, 2, 1)
        pull = symmetric @ factors * self.corners
        pivots = factors[:, self.diagonal, self.diagonal] / self.corners[:, :, 0]
        pull[:, self.diagonal, self.diagonal] *= pivots
        of_others = gradient[self.others] * self.scale
        return np.concatenate([pull[:, *self.lower].ravel(), of_others])


def _link_demands(demands: Sequence[Constraint]) -> list[Constraint]:
    """Return the 4x4 matrix constraint of each link that its variables are built on.

    A link (recognised by the index of its first parameter) may have two: physical
    consistency, and a minimum thickness. The latter implies the former and is returned.
    """
    by_first_index: dict[int, Constraint] = {}
    for c in sorted(demands, key=lambda c: c.family == "minimum thickness"):
        if c.constant.shape == (4, 4) and len(c.indices) == 10:
            by_first_index[int(c.indices[0])] = c
    return list(by_first_index.values())


@dataclass(frozen=True)
class Round:
    """One minimisation of the augmented Lagrangian with fixed shifts, over z (n,), where
    the variables are x + T z."""

    #: The problem.
    instance: Instance
    #: Map from the variables to theta.
    chart: Chart
    #: Penalty of the demands that the variables do not fulfil by themselves.
    penalty: ShiftedPenalty
    #: Shifts, one array for each part of the penalty.
    shifts: list[Array]
    #: Weight of the penalty.
    weight: float
    #: (n,) variables at which the minimisation starts.
    x: Array

    @cached_property
    def turn(self) -> Array:
        """(n, n) matrix T that scales the variables: T^T H T = 1 for the Gauss-Newton
        matrix H of the augmented Lagrangian at x.

        L-BFGS works with z in x + T z, where all curvatures are about 1. Curvatures of
        H below 1 / weight are raised to that, so that no variable is stretched further.
        """
        scale = self.penalty.theta_scale
        theta, factors = self.chart.theta(self.x)
        _, slopes = self.penalty.rows(theta / scale, self.shifts, self.weight)
        # The penalty is a sum of squares without the factor 1/2: H = 2 J^T J.
        rows = np.sqrt(2.0) * slopes / scale
        in_variables = np.array([self.chart.slope(factors, row) for row in rows])
        values, vectors = np.linalg.eigh(in_variables.T @ in_variables)
        return vectors / np.sqrt(np.maximum(values, 1.0 / self.weight))

    def value_and_slope(self, z: Array) -> tuple[float, Array]:
        """Return the augmented Lagrangian and its gradient at the scaled variables.

        Parameters
        ----------
        z : (n,) array
            Scaled step from the variables x: the point is x + T z.

        Returns
        -------
        tuple of (float, (n,) array)
            Value, in units of the loss, and gradient in z.
        """
        penalty = self.penalty
        theta, factors = self.chart.theta(self.x + self.turn @ z)
        value = self.instance.problem.value(theta) / penalty.loss_scale
        slope = self.instance.problem.gradient(theta) / penalty.loss_scale
        scaled = theta / penalty.theta_scale
        moved = penalty.shifted(scaled, self.shifts, self.weight)
        for part, shift, push in zip(penalty.parts, self.shifts, moved, strict=True):
            rise = np.vdot(push, push) - np.vdot(shift, shift)
            value += 0.5 * float(rise) / self.weight
            slope -= push.ravel() @ part.jacobian(theta) / penalty.theta_scale
        in_variables = self.turn.T @ self.chart.slope(factors, slope)
        # Overflow counts as a huge value, from which the line search steps back.
        return (value if np.isfinite(value) else 1e300), in_variables


def solve(instance: Instance, accuracy: float) -> Answer:
    """Minimise the augmented Lagrangian in rounds, from the interior point.

    Each round minimises in the log-Cholesky variables x with fixed shifts (multipliers
    over the weight of the penalty), then updates the shifts. An optimum is claimed if
    gradient, violation and change of the shifts are within the accuracy.

    Parameters
    ----------
    accuracy : float
        Relative accuracy that is asked for.

    Returns
    -------
    Answer
        Without multipliers: the variables keep the links' matrices positive, so that
        those have none.
    """
    inside = instance.interior
    if inside is None:
        return no_answer(instance, "no interior point to start from")
    # Matrix constraints hold by construction; the penalty imposes all others.
    others = ConstraintSet(tuple(c for c in instance.sent if c.cone != "psd"))
    penalty = ShiftedPenalty(
        instance.task, replace(instance.problem, constraints=others), inside
    )
    chart = Chart(instance.sent, inside)
    x = chart.start
    shifts = [np.zeros_like(part.values(inside)) for part in penalty.parts]
    message = ""
    claims = "inaccurate"
    for _ in range(_ROUNDS):
        stage = Round(instance, chart, penalty, shifts, _WEIGHT, x)
        solution = scipy.optimize.minimize(
            stage.value_and_slope,
            np.zeros(len(x)),
            method="L-BFGS-B",
            jac=True,
            options=options(accuracy),
        )
        x = x + stage.turn @ solution.x
        message = str(solution.message)
        theta, _ = chart.theta(x)
        moved = penalty.shifted(theta / penalty.theta_scale, shifts, _WEIGHT)
        violation = largest_change(moved, shifts) / _WEIGHT
        shifts = moved
        if max(violation, float(np.abs(solution.jac).max())) <= accuracy:
            claims = "optimal"
            break
    theta, _ = chart.theta(x)
    return Answer(theta, claims, message)
