"""One problem solved again and again with other data, by the compiled core, with its certified bound.

What stays (constraints, prior, bounds) is handed over once; a solve takes the data's triangle alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.constraints.constraint import Alike, Constraint, ConstraintSet, alike
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.certificate import inverse_map
from sdp_vs_penalty.solvers.native import ITERATIONS, ORDER, said, structured
from sdp_vs_penalty.solvers.objective import Entropy
from sdp_vs_penalty.solvers.rewrite import NotApplicableError
from sdp_vs_penalty.solvers.verified import nominal_terms

#: A warm start's way towards the interior, and its complementarity as a share of the objective (of 25
#: resamples of the Panda's data each: 6 iterations instead of 13).
_INSIDE, _WARM = 0.1, 0.01
#: Share of a log det's slope that is lent to P >= 0, whose multiplier can then give way to either side
#: where the bound is polished. It costs the bound four times that of the weight, a link.
_ROOM = 1e-9
_NOTHING = np.zeros(0)


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
class Optimum:
    """theta (p,) and the multipliers (blocks, 4, 4) as the solver leaves them; status : its own word."""

    theta: Array
    multipliers: Array
    iterations: int
    status: str


@dataclass(frozen=True)
class Structured:
    """core : what is solved, blocks of the entropy's links before those ``sent``; interior (p,) : inside
    of all constraints, which judge the answer; |theta_k| <= bound_k (p,)."""

    core: Any
    entropy: Entropy | None
    constraints: ConstraintSet
    sent: tuple[Constraint, ...]
    bound: Array
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
        if entropy is not None and not entropy.weight > 0.0:
            entropy = None
        linear, own, logs = np.zeros(len(bound)), set(), []
        if entropy is not None:
            inverse, log_det = nominal_terms(entropy.nominal)
            for group in alike(entropy.links):
                own |= set(map(tuple, group.indices.tolist()))
                nominal = inverse[group.places], log_det[group.places]
                slope = np.einsum("gkab,gab->gk", group.coefficients, nominal[0])
                np.add.at(linear, group.indices, entropy.weight * slope)
                logs.append((group, entropy.weight, *nominal))
        core = structured(linear, bound)
        for log in logs:
            _add(core, *log)
        # A log det keeps its matrix positive definite by itself.
        needed = tuple(
            c for c in sent if c.family != "pseudo-inertia" or tuple(c.indices.tolist()) not in own
        )
        for group in alike(needed):
            _add(core, group)
        return cls(core, entropy, constraints, needed, bound, interior)

    @cached_property
    def judge(self) -> Any:
        """All constraints, for the answer."""
        judge = structured(np.zeros(len(self.bound)), self.bound)
        for group in alike(self.constraints.convex):
            _add(judge, group)
        return judge

    def optimum(
        self, data: LeastSquares, accuracy: float, near: Array | None = None, floor: float = 0.0
    ) -> Optimum:
        """What the interior-point method finds; ``accuracy`` is relative to the objective, of which at
        least ``floor`` counts."""
        start, warmth = self.interior, 1.0
        if near is not None:
            start, warmth = near + _INSIDE * (self.interior - near), _WARM
        theta, multipliers = np.zeros(len(start)), np.zeros((self.core.blocks, ORDER, ORDER))
        rest = max(data.residual_norm, float(np.sqrt(floor)))
        how = start, warmth, accuracy, ITERATIONS
        steps, converged, gap = self.core.solve(data.R, data.rho, rest, *how, theta, multipliers)
        return Optimum(theta, multipliers, steps, said(converged, gap))

    def solve(self, data: LeastSquares, accuracy: float = 1e-9, near: Array | None = None) -> Certified:
        """The optimum for these data and its certificate (proved; ``accuracy`` is asked for).

        near (p,) : the optimum of similar data, from which half the iterations remain.
        """
        found = self.optimum(data, accuracy, near)
        theta, args = found.theta, (data.R, data.rho, data.residual_norm)
        lower = self.core.lower_bound(*args, theta, found.multipliers)
        value = self.core.value(*args, theta)
        gap = data.gap(value, lower, theta)
        return Certified(theta, value, lower, gap, self.judge.inside(theta), found.iterations)

    def multipliers(self, found: Optimum) -> tuple[list[Array], Array | None]:
        """Of each constraint its multiplier, of each link of the entropy the slope of -log det."""
        slopes, block = None, 0
        own: dict[int, Array] = {}
        if self.entropy is not None:
            links = self.entropy.links
            slopes = np.zeros((len(links), ORDER, ORDER))
            for group in alike(links):
                slopes[group.places] = found.multipliers[block : block + len(group.places)]
                block += len(group.places)
            own = {id(link): _ROOM * Z for link, Z in zip(links, slopes, strict=True)}
            slopes *= (1.0 - _ROOM) / self.entropy.weight
        for group in alike(self.sent):
            shape = group.constant.shape
            count = shape[0] * shape[1] if group.cone == "nonnegative" else shape[0]
            Z = found.multipliers[block : block + count, : shape[1], : shape[1]]
            block += count
            if group.cone == "nonnegative":
                Z = Z[:, 0, 0].reshape(shape)
            elif group.cone == "soc":
                trace = np.trace(Z, axis1=1, axis2=2)[:, None]
                Z = np.concatenate([trace, 2.0 * Z[:, 0, 1:]], axis=1)
            own |= {id(self.sent[k]): z for k, z in zip(group.places, Z, strict=True)}
        return [own.get(id(c), np.zeros_like(c.constant)) for c in self.constraints.convex], slopes


def _add(
    core: Any, group: Alike, weight: float = 0.0, inverse: Array = _NOTHING, log_det: Array = _NOTHING
) -> None:
    """Each matrix as a block; with a weight, inverse (g, 4, 4) and log_det (g,) of the nominal ones."""
    indices, constant, coefficients = _matrices(group)
    order, width = constant.shape[1], indices.shape[1]
    wide = np.zeros((len(indices), width + 1, ORDER, ORDER))
    wide[:, :width, :order, :order], wide[:, width, :order, :order] = coefficients, constant
    holds = order == ORDER and width == 10  # any slope of its link
    for k, index in enumerate(indices.astype(np.int64)):
        spread = inverse_map(coefficients[k].tobytes()) if holds else _NOTHING
        nominal = (inverse[k], log_det[k]) if weight > 0.0 else (_NOTHING, 0.0)
        core.add(order, weight, index, wide[k, :width], wide[k, width:], spread, *nominal)


def _matrices(group: Alike) -> tuple[NDArray[np.intp], Array, Array]:
    """indices (m, k), constant (m, d, d) and coefficients (m, k, d, d) of the matrices that are to be
    positive semidefinite: one for each entry of a non-negative vector."""
    indices, constant, coefficients = group.indices, group.constant, group.coefficients
    size = constant.shape[1]
    if group.cone == "nonnegative":
        single = np.swapaxes(coefficients, 1, 2).reshape(-1, indices.shape[1], 1, 1)
        return np.repeat(indices, size, axis=0), constant.reshape(-1, 1, 1), single
    if size > ORDER:
        raise NotApplicableError(f"native takes no cone {group.cone} of size {size}")
    if group.cone == "psd":
        return indices, constant, coefficients

    def arrow(vectors: Array) -> Array:
        out = vectors[..., :1, None] * np.eye(size)
        out[..., 0, 1:] = out[..., 1:, 0] = vectors[..., 1:]
        return out

    return indices, arrow(constant), arrow(coefficients)
