"""Rays: what shows that an end is open, a direction in which the set has no end.

A direction d shows no torque (A d = 0), keeps every constraint (its linear part lies in the
cone) and lets the function grow. No torque shows mass at the points u = (x, 1) of a link that
stand still in every pose, such as those on the first axis: these u are a subspace K of R^4,
and consistent changes of the link are P(d) = K S K^T with S >= 0. With P(d) = u u^T a linear
function grows most along the largest eigenvector of K^T G K, G its matrix on the link.

A ray is certified independently of how it was found: the model that fits best, and the one
that lies far along the ray, satisfy every constraint in exact arithmetic and fit. All models
between are consistent and fit as well, since the set is convex.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.ranges.allowed import FAR, AllowedSet
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.solvers.rigorous_bounds import certainly_feasible

#: How far along a ray the certificate reaches, in lengths of the far limits.
REACH = 1000.0
#: Poses in which a point has to stand still, and its largest motion per length, which is
#: rounding.
_POSES, _STILL = 40, 1e-9
#: Weights of the bodies beside the function: a ray keeps mass inside of them.
_BODY_WEIGHTS = (0.0, *np.geomspace(1e-3, 1e3, 13).tolist())


def certified_ray(allowed: AllowedSet, g: Array, rise: float) -> Array | None:
    """Return a direction d (p,) with g^T d = -1 along which the models whose loss rises by
    at most ``rise`` go on without end, None where none was found."""
    for d in _candidates(allowed, g):
        if is_ray(allowed, g, d, rise):
            return d / -float(g @ d)
    return None


def is_ray(allowed: AllowedSet, g: Array, d: Array, rise: float) -> bool:
    """Return whether the models whose loss rises by at most ``rise`` go on along d (p,)
    until g^T theta has fallen by REACH times what the far limits admit.

    The set is convex, so that it is enough to look at both ends of the way.
    """
    fall = -float(g @ d)
    known = list(allowed.task.model.known_values)
    if fall <= 0.0 or np.any(d[known]):
        return False
    constraints = [x for x in allowed.constraints.convex if x.family != FAR]
    length = REACH * float(np.abs(g) @ allowed.far_bound) / fall
    for theta in (allowed.fit, allowed.fit + length * d):
        residual = allowed.ball.A @ theta - allowed.ball.a
        if not residual @ residual <= allowed.limit(rise):
            return False
        if not certainly_feasible(constraints, theta):
            return False
    return True


def _candidates(allowed: AllowedSet, g: Array) -> Iterator[Array]:
    """Yield directions (p,) of mass at a point of one link that stands still in every
    pose: the point at which g^T theta falls most, then points that balance this fall
    with a place inside of the link's bodies.

    Mass at a point with homogeneous coordinates u = K v is the pseudo-inertia u u^T, and
    a linear function of it is u^T G u: the largest eigenvalue of K^T G K has the best v.
    """
    task = allowed.task
    bases = still_points(task.model.robot)
    for indices, K in zip(task.links, bases, strict=True):
        if not K.size or not np.any(g[indices]):
            continue
        fall = K.T @ _matrix(-g[indices]) @ K
        inside = K.T @ _inside_of_bodies(allowed, indices) @ K
        weights = _BODY_WEIGHTS if np.any(inside) else _BODY_WEIGHTS[:1]
        for weight in weights:
            eigenvectors = np.linalg.eigh(fall + weight * inside)[1]
            u = K @ eigenvectors[:, -1]
            u = np.where(np.abs(u) > _STILL * np.abs(u).max(), u, 0.0)
            direction = np.zeros(len(g))
            direction[indices] = inertia.from_pseudo_inertia(np.outer(u, u))
            yield direction


def _inside_of_bodies(allowed: AllowedSet, indices: Indices) -> Array:
    """Return G (4, 4), with u^T G u large for points u inside of the bodies of a link;
    the link's parameters stand at indices (10,)."""
    G = np.zeros((4, 4))
    for constraint in allowed.constraints.convex:
        is_of_link = np.array_equal(constraint.indices, indices)
        is_limit = constraint.family == FAR or np.any(constraint.constant)
        if constraint.cone == "nonnegative" and is_of_link and not is_limit:
            for row in constraint.coefficients.T:
                G += _matrix(row / np.linalg.norm(row))
    return G


def _matrix(row: Array) -> Array:
    """Return G (4, 4) with row^T theta = tr(G P(theta)) for a link's ten parameters."""
    basis = inertia.PSEUDO_INERTIA_BASIS.reshape(10, 16)
    G = (np.linalg.pinv(basis) @ row).reshape(4, 4)
    return 0.5 * (G + G.T)


def still_points(robot: Robot) -> list[Array]:
    """Return for each link a basis K (4, k) of the points, as homogeneous coordinates,
    that stand still in every pose; k = 0 without any."""
    q = robot.random_configurations(_POSES, seed=0)
    carrying = list(robot.link_joints)
    frames = np.array([robot.tree[k].link_frame for k in carrying])
    poses = robot.poses(robot.tree_state(q)[0])[:, carrying] @ frames
    # A point x (4,) of a link stands still if (pose - first pose) x = 0 in all poses.
    differences = (poses[1:] - poses[:1])[:, :, :3]
    bases = []
    for link in range(differences.shape[1]):
        rows = differences[:, link].reshape(-1, 4)
        _, sizes, axes = np.linalg.svd(rows, full_matrices=False)
        is_still = sizes <= _STILL * np.sqrt(len(rows))
        bases.append(axes[is_still].T)
    return bases
