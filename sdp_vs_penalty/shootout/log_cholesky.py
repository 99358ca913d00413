"""Log-Cholesky variables and an augmented Lagrangian: what one writes without an SDP solver.

Each link's 4x4 demand P (with a minimum thickness that of the demand) is L L^T in units of an interior
point, L lower triangular, the logarithms of its diagonal variables: consistent by construction (Rucker,
Wensing, "Smooth parameterization of rigid-body inertia", RA-L 2022). Every other demand is imposed as
the estimator ``penalty`` imposes all (:func:`~sdp_vs_penalty.estimators.penalty.minimise`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdp_vs_penalty.estimators.penalty import ScaledProblem, ShiftedPenalty, minimise
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.judge import Answer, no_answer

#: Logarithms of a factor's diagonal end here, in units of an interior point.
_LOGARITHM = 25.0
_LOWER = np.tril_indices(4)
_DIAGONAL = np.equal(*_LOWER)


def options(accuracy: float) -> dict[str, Any]:
    """What it is told: violation and complementarity, in scaled units."""
    return {"tolerance": accuracy}


@dataclass(frozen=True)
class Charted(ShiftedPenalty):
    """The shifted penalty as a function of the chart's variables z (p,): a link's ten stand where its
    parameters do, the others are the scaled parameters themselves.

    links : the demand P of each; backs (links, 16, 10) : from P - P(0) to its scaled parameters; corners
    (links, 4) : units of L's rows.
    """

    links: tuple[Constraint, ...]
    backs: tuple[Array, ...]
    corners: tuple[Array, ...]

    def scaled(self, z: Array) -> tuple[Array, Array]:
        """Scaled parameters x (p,) at z (p,), and dx / dz (p, p)."""
        x, slope = z.copy(), np.eye(len(z))
        for c, back, corner in zip(self.links, self.backs, self.corners, strict=True):
            own, L, change = z[c.indices], np.zeros((4, 4)), np.zeros((10, 4, 4))
            own = np.where(_DIAGONAL, np.exp(np.clip(own, -_LOGARITHM, _LOGARITHM)), own)
            L[_LOWER], change[range(10), *_LOWER] = own, np.where(_DIAGONAL, own, 1.0)
            L, change = L * corner[:, None], change * corner[:, None]
            half = change @ L.T
            x[c.indices] = (L @ L.T - c.constant).ravel() @ back
            slope[np.ix_(c.indices, c.indices)] = ((half + half.swapaxes(1, 2)).reshape(10, 16) @ back).T
        return x, slope

    def shifted(self, x: Array, shifts: Sequence[Array], weight: float) -> list[Array]:
        return super().shifted(self.scaled(x)[0], shifts, weight)

    def rows(self, x: Array, shifts: Sequence[Array], weight: float) -> tuple[Array, Array]:
        at, slope = self.scaled(x)
        r, J = super().rows(at, shifts, weight)
        return r, J @ slope


def solve(instance: Instance, accuracy: float) -> Answer:
    """Minimise from the interior point. No multipliers come back: a chart has none for its links."""
    inside = instance.interior
    if inside is None:
        return no_answer(instance, "no interior point to start from")
    demands = instance.constraints.essential
    links = tuple(c for c in demands if c.cone == "psd")
    others = ConstraintSet(tuple(c for c in demands if c.cone != "psd"))
    posed = ScaledProblem.of(instance.task, instance.data, others, inside)
    start, backs, corners = inside / posed.theta_scale, [], []
    for c in links:
        corner = np.sqrt(np.diagonal(c.value(inside)))
        factor = np.linalg.cholesky(c.value(inside) / np.outer(corner, corner))[_LOWER]
        start[c.indices] = np.where(_DIAGONAL, np.log(np.where(_DIAGONAL, factor, 1.0)), factor)
        backs.append(np.linalg.pinv(c.coefficients.reshape(10, 16)) / posed.theta_scale[c.indices])
        corners.append(corner)
    plain = posed.penalty
    charted = Charted(plain.R, plain.rho, plain.parts, links, tuple(backs), tuple(corners))
    z, _, spent = minimise(charted, start, accuracy)
    theta = posed.theta_scale * charted.scaled(z)[0]
    claims = "optimal" if spent["converged"] and spent["residual"] <= accuracy else "inaccurate"
    return Answer(theta, claims, f"residual {spent['residual']:.1e}", int(spent["stages"]))
