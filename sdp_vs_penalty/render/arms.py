"""The arm's links as ellipsoids, for the pictures of report and page."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot


def link_ellipsoid(link: Array) -> Array | None:
    """(3, k) points on the uniform solid ellipsoid with these standard parameters, in
    the link frame; None for a link without mass or thickness."""
    body = half_axes(link)
    if body is None:
        return None
    half, axes, com = body
    u, v = np.meshgrid(np.linspace(0.0, np.pi, 14), np.linspace(0.0, 2.0 * np.pi, 28))
    ball = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)])
    ball = ball.reshape(3, -1)
    return np.asarray(axes @ (half[:, None] * (axes.T @ ball)) + com[:, None], float)


def half_axes(link: Array) -> tuple[Array, Array, Array] | None:
    """Half axes (3,) [m] of that ellipsoid, sqrt(5 eigenvalues of Sigma_c / m), their
    directions (3, 3) as columns, right-handed, and its centre (3,)."""
    values, axes = np.linalg.eigh(inertia.second_moment(link))
    if link[0] <= 0.0 or values[0] <= 0.0:
        return None
    return (
        np.sqrt(5.0 * values),
        axes * np.sign(np.linalg.det(axes)),
        link[1:4] / link[0],
    )


def drawn_arm(robot: Robot, links: Iterable[Array]) -> dict[str, Any]:
    """The arm in 3D: of each joint its parent and place there, of each link its joint
    and ellipsoid."""
    bodies = []
    for k, (joint, link) in enumerate(zip(robot.link_joints, links, strict=False)):
        body = half_axes(link)
        if body is None:
            continue
        half, axes, com = body
        at = np.block([[axes, com[:, None]], [np.zeros(3), np.ones(1)]])
        place = robot.tree[joint].link_frame @ at
        bodies.append({"link": k, "joint": joint, "half": half, "place": place})
    joints = [{"parent": j.parent, "at": j.placement[:3, 3]} for j in robot.tree]
    return {"bodies": bodies, "joints": joints}
