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
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.solvers.rigorous_bounds import certainly_feasible

#: How far along a ray the certificate reaches, in lengths of the far limits.
REACH = 1000.0
#: Poses in which a point has to stand still, and its largest motion per length, which is
#: rounding.
_POSES, _STILL = 40, 1e-9
#: Weights of the bodies beside the function: a ray keeps mass inside of them.
_BODY_WEIGHTS = (0.0, *np.geomspace(1e-3, 1e3, 13).tolist())


def certified_ray(allowed: AllowedSet, g: Array, c: float) -> Array | None:
    """Return a direction d (p,) with g^T d = -1 along which the set of c has no end, None
    where none was found."""
    for d in _candidates(allowed, g):
        if is_ray(allowed, g, d, c):
            return np.asarray(d / -float(g @ d))
    return None


def is_ray(allowed: AllowedSet, g: Array, d: Array, c: float) -> bool:
    """Return whether the set of c goes on along d (p,) until g^T theta has fallen by
    REACH times what the far limits admit."""
    growth = -float(g @ d)
    known = list(allowed.task.model.known_values)
    if growth <= 0.0 or np.any(d[known]):
        return False
    near = [x for x in allowed.constraints.convex if x.family != FAR]
    lengths = REACH * float(np.abs(g) @ allowed.far_bound) / growth
    for theta in (allowed.fit, allowed.fit + lengths * d):
        residual = allowed.ball.A @ theta - allowed.ball.a
        if not residual @ residual <= allowed.limit(c):
            return False
        if not certainly_feasible(near, theta):
            return False
    return True


def _candidates(allowed: AllowedSet, g: Array) -> Iterator[Array]:
    """Yield directions (p,): mass at a point of one link that stands still, where the
    function falls most, and where it does inside of the link's bodies."""
    task = allowed.task
    spaces = still_points(task.model.robot)
    for indices, K in zip(task.links, spaces, strict=True):
        if not K.size or not np.any(g[indices]):
            continue
        falls = K.T @ _matrix(-g[indices]) @ K
        inside = np.zeros_like(falls)
        for x in allowed.constraints.convex:
            is_body = x.cone == "nonnegative" and np.array_equal(x.indices, indices)
            if is_body and x.family != FAR and not np.any(x.constant):
                for row in x.coefficients.T:
                    inside += K.T @ _matrix(row / np.linalg.norm(row)) @ K
        for weight in _BODY_WEIGHTS:
            u = K @ np.linalg.eigh(falls + weight * inside)[1][:, -1]
            u = np.where(np.abs(u) > _STILL * np.abs(u).max(), u, 0.0)
            d = np.zeros(len(g))
            d[indices] = inertia.from_pseudo_inertia(np.outer(u, u))
            yield d
            if not np.any(inside):
                break


def _matrix(row: Array) -> Array:
    """Return G (4, 4) with row^T theta = tr(G P(theta)) for a link's ten parameters."""
    basis = inertia.PSEUDO_INERTIA_BASIS.reshape(10, 16)
    G = (np.linalg.pinv(basis) @ row).reshape(4, 4)
    return np.asarray(0.5 * (G + G.T))


def still_points(robot: Robot) -> list[Array]:
    """Return for each link a basis K (4, k) of the points, as homogeneous coordinates,
    that stand still in every pose; k = 0 without any."""
    q = robot.random_configurations(_POSES, seed=0)
    carrying = list(robot.link_joints)
    frames = np.array([robot.tree[k].link_frame for k in carrying])
    poses = robot.poses(robot.tree_state(q)[0])[:, carrying] @ frames
    moved = (poses[1:] - poses[:1])[:, :, :3]
    out = []
    for link in range(moved.shape[1]):
        rows = moved[:, link].reshape(-1, 4)
        _, size, axes = np.linalg.svd(rows, full_matrices=False)
        out.append(axes[size <= _STILL * np.sqrt(len(rows))].T)
    return out
