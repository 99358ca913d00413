"""One problem solved again and again with other data, by the compiled core, with its certified bound.

What stays (constraints, prior, bounds) is handed over once; a solve takes the data's triangle alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.constraints.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.native import ITERATIONS, ORDER, structured
from sdp_vs_penalty.solvers.objective import Entropy
from sdp_vs_penalty.solvers.rewrite import NotApplicableError

#: A warm start's way towards the interior, and its complementarity as a share of the objective (of 25
#: resamples of the Panda's data each: 6 iterations instead of 13).
_INSIDE, _WARM = 0.1, 0.01


@dataclass(frozen=True)
class Certified:
    """theta (p,), feasible where ``feasible``; lower <= optimum <= value; gap relative to the loss."""

    theta: Array
    value: float
    lower: float
    gap: float
    feasible: bool
    iterations: int


@dataclass(frozen=True)
class Structured:
    """core : what is solved; judge : all constraints, for the answer; interior (p,) : inside them."""

    core: Any
    judge: Any
    interior: Array

    @classmethod
    def of(
        cls,
        entropy: Entropy | None,
        constraints: ConstraintSet,
        sent: Sequence[Constraint],
        bound: Array,
        interior: Array,
    ) -> Structured:
        """Raises NotApplicableError for cones larger than the compiled core takes."""
        linear = np.zeros(len(bound))
        links = () if entropy is None else entropy.links
        own = {tuple(link.indices.tolist()) for link in links}
        blocks = []
        if entropy is not None:
            for link, p0 in zip(entropy.links, entropy.nominal, strict=True):
                inverse = np.linalg.inv(p0)
                inverse = 0.5 * (inverse + inverse.T)
                linear[link.indices] += entropy.weight * link.adjoint(inverse)
                blocks.append((link, entropy.weight, inverse, float(np.linalg.slogdet(p0)[1])))
        core = structured(linear, bound)
        nothing = np.zeros(0)
        for link, weight, inverse, log_det in blocks:
            _add(core, link.indices, link.constant, link.coefficients, weight, inverse, log_det)
        for c in sent:
            # A log det keeps its matrix positive definite by itself.
            if c.family == "pseudo-inertia" and tuple(c.indices.tolist()) in own:
                continue
            for constant, coefficients in _matrices(c):
                _add(core, c.indices, constant, coefficients, 0.0, nothing, 0.0)
        judge = structured(linear, bound)
        for c in constraints.convex:
            for constant, coefficients in _matrices(c):
                _add(judge, c.indices, constant, coefficients, 0.0, nothing, 0.0)
        return cls(core, judge, interior)

    def solve(self, data: LeastSquares, accuracy: float = 1e-9, near: Array | None = None) -> Certified:
        """The optimum for these data and its certificate (proved; ``accuracy`` is asked for).

        near (p,) : the optimum of similar data, from which half the iterations remain.
        """
        start, warmth = self.interior, 1.0
        if near is not None:
            start, warmth = near + _INSIDE * (self.interior - near), _WARM
        theta, multipliers = np.zeros(len(start)), np.zeros((self.core.blocks, ORDER, ORDER))
        args = data.R, data.rho, data.residual_norm
        steps, _, _ = self.core.solve(*args, start, warmth, accuracy, ITERATIONS, theta, multipliers)
        lower = self.core.lower_bound(*args, theta, multipliers)
        value = self.core.value(*args, theta)
        scale = max(data.loss(theta), 1e-12 * data.tau_squared)
        gap = (value - lower) / scale if scale > 0.0 else 0.0
        return Certified(theta, value, lower, gap, self.judge.inside(theta), steps)


def _add(
    core: Any,
    indices: NDArray[np.intp],
    constant: Array,
    coefficients: Array,
    weight: float,
    inverse: Array,
    log_det: float,
) -> None:
    order = len(constant)
    room = ((0, 0), (0, ORDER - order), (0, ORDER - order))
    spread: Array = np.zeros(0)
    if order == ORDER and len(indices) == 10:  # it can hold any slope of its link
        spread = np.asarray(np.linalg.pinv(coefficients.reshape(10, -1)).T.reshape(10, ORDER, ORDER))
    core.add(
        order,
        weight,
        np.asarray(indices, np.int64),
        np.ascontiguousarray(np.pad(coefficients, room)),
        np.ascontiguousarray(np.pad(constant[None], room)),
        np.ascontiguousarray(spread),
        np.ascontiguousarray(inverse),
        log_det,
    )


def _matrices(c: Constraint) -> list[tuple[Array, Array]]:
    """Constant (d, d) and coefficients (k, d, d) of each matrix that is to be positive semidefinite."""
    if c.cone == "nonnegative":
        rows = range(len(c.constant))
        return [(c.constant[r : r + 1, None], c.coefficients[:, r, None, None]) for r in rows]
    if len(c.constant) > ORDER:
        raise NotApplicableError(f"native takes no cone {c.cone} of size {len(c.constant)}")
    if c.cone == "psd":
        return [(c.constant, c.coefficients)]

    def arrow(vectors: Array) -> Array:
        out = vectors[..., :1, None] * np.eye(vectors.shape[-1])
        out[..., 0, 1:] = out[..., 1:, 0] = vectors[..., 1:]
        return out

    return [(arrow(c.constant), arrow(c.coefficients))]
