"""The relaxed retrieval: parameters with given torques and no physics, and what joints then bear.

The supplementary material of Gaz et al. (RA-L 2019) shows on a spatial 2R robot why feasibility
matters: parameters that reproduce every torque can still bear impossible loads inside the joints.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array

#: A retrieval counts as reproducing the torques below this error relative to the largest symbol.
REPRODUCED = 1e-8
#: Where the search for a parameter without bounds starts: within so many metres or kg m^2 of zero.
_OPEN_START = 1.0


@dataclass(frozen=True)
class Retrieval:
    """links (n, 10) standard parameters; error : largest |pi - pi_hat| over the largest |pi_hat|."""

    seed: int
    links: Array
    error: float


def relaxed_retrieval(problem: Problem, pi: Array, seed: int, boxed: bool) -> Retrieval:
    """Barycentric parameters p with base parameters pi (b,), without triangle inequality or shape.

    Non-linear least squares |pi(p) - pi|^2 from a random start: what the paper's retrieval is
    without its conditional constraints. boxed : keep the box bounds of the problem's tables, which
    leave the 2R's c1x, c1z, c2y, c2z open; otherwise nothing is bounded.
    """
    base, _ = base_parameters(problem.model("rigid_body"), problem.independent)
    box = problem.box.reshape(-1, 2)
    open_start = np.array([-_OPEN_START, _OPEN_START])
    start_box = (
        np.where(np.isfinite(box), box, open_start) if boxed else np.tile(open_start, (len(box), 1))
    )
    if not boxed:
        start_box[::10] = np.where(np.isfinite(box[::10]), box[::10], [0.0, _OPEN_START])  # masses
    start = np.random.default_rng(seed).uniform(start_box[:, 0], start_box[:, 1])
    size = float(np.abs(pi).max())

    def residual(p: Array) -> Array:
        links = inertia.standard_from_barycentric(p.reshape(-1, 10))
        return np.asarray((base @ links.ravel() - pi) / size)

    found = optimize.least_squares(
        residual,
        start,
        bounds=(box[:, 0], box[:, 1]) if boxed else (-np.inf, np.inf),
        x_scale="jac",
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
        max_nfev=1000,
    )
    links = inertia.standard_from_barycentric(found.x.reshape(-1, 10))
    return Retrieval(seed, links, float(np.abs(found.fun).max()))


def unfeasible_retrievals(problem: Problem, pi: Array, count: int, boxed: bool) -> Iterator[Retrieval]:
    """The first ``count`` relaxed retrievals that reproduce pi and are physically inconsistent."""
    found = 0
    for k in range(20 * count):
        retrieval = relaxed_retrieval(problem, pi, k, boxed)
        if retrieval.error > REPRODUCED or inertia.consistency_margin(retrieval.links).min() >= 0.0:
            continue
        yield retrieval
        found += 1
        if found == count:
            return
