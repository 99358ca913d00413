"""The arm's links as ellipsoids, for the pictures of report and page."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot


def link_ellipsoid(link: Array) -> Array | None:
    """Points on the surface of a link's ellipsoid of uniform density, in the link frame.

    Parameters
    ----------
    link : (10,) array
        Standard parameters m [kg], m c [kg m], Ixx, Ixy, ..., Izz [kg m^2].

    Returns
    -------
    (3, k) array or None
        Points [m]; None for a link without mass or thickness.
    """
    body = half_axes(link)
    if body is None:
        return None
    half, axes, com = body
    polar = np.linspace(0.0, np.pi, 14)
    azimuth = np.linspace(0.0, 2.0 * np.pi, 28)
    u, v = np.meshgrid(polar, azimuth)
    unit_sphere = np.stack(
        [
            np.sin(u) * np.cos(v),
            np.sin(u) * np.sin(v),
            np.cos(u),
        ]
    ).reshape(3, -1)
    # Stretch the sphere along the ellipsoid's axes, then move it to the centre.
    along_axes = half[:, None] * (axes.T @ unit_sphere)
    return np.asarray(axes @ along_axes + com[:, None], float)


def half_axes(link: Array) -> tuple[Array, Array, Array] | None:
    """Half axes, directions and centre of a link's ellipsoid of uniform density.

    A solid ellipsoid of mass m with half axes a has the second moment
    Sigma_c = m diag(a^2) / 5 about its centre, so a = sqrt(5 eigenvalues(Sigma_c) / m).

    Parameters
    ----------
    link : (10,) array
        Standard parameters m [kg], m c [kg m], Ixx, Ixy, ..., Izz [kg m^2].

    Returns
    -------
    tuple or None
        Half axes (3,) [m], their directions (3, 3) as columns of a rotation, and the
        centre (3,) [m] in the link frame; None for a link without mass or thickness.
    """
    mass = link[0]
    # Eigenvalues of Sigma_c / m in increasing order.
    values, axes = np.linalg.eigh(inertia.second_moment(link))
    if mass <= 0.0 or values[0] <= 0.0:
        return None
    rotation = axes * np.sign(np.linalg.det(axes))  # right-handed
    return np.sqrt(5.0 * values), rotation, link[1:4] / mass


def drawn_arm(robot: Robot, links: Iterable[Array]) -> dict[str, Any]:
    """Joints and link ellipsoids of a robot as plain data, for a 3D view.

    Parameters
    ----------
    robot : Robot
        The kinematic tree.
    links : iterable of (10,) arrays
        Standard parameters of each link that has a joint, in the robot's order.

    Returns
    -------
    dict
        ``joints``: parent, position [m] and axis of motion of each; ``bodies``: link,
        joint, half axes [m] and placement (4, 4) of each ellipsoid. Links without one
        are left out.
    """
    bodies = []
    for k, (joint, link) in enumerate(zip(robot.link_joints, links, strict=False)):
        body = half_axes(link)
        if body is None:
            continue
        half, axes, com = body
        pose_in_link = np.block(
            [
                [axes, com[:, None]],
                [np.zeros(3), np.ones(1)],
            ]
        )
        place = robot.tree[joint].link_frame @ pose_in_link
        bodies.append(
            {
                "link": k,
                "joint": joint,
                "half": half,
                "place": place,
            }
        )
    joints = [
        {
            "parent": joint_of_tree.parent,
            "at": joint_of_tree.placement[:3, 3],
            "axis": joint_of_tree.axis,
        }
        for joint_of_tree in robot.tree
    ]
    return {"bodies": bodies, "joints": joints}
