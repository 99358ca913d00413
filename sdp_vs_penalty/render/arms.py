"""The arm's links as ellipsoids and surfaces, for the pictures of the page."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot


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


def simplified(triangles: Array, most: int = 3000) -> Array:
    """Reduce the number of triangles of a surface, keeping its shape approximately.

    Corners in the same cell of a grid are merged; the grid gets coarser until few
    enough triangles are left.

    Parameters
    ----------
    triangles : (m, 3, 3) array
        Corners of m triangles [m].

    Returns
    -------
    (k, 3, 3) array
        At most ``most`` triangles, without those that have collapsed.
    """
    triangles = np.asarray(triangles, float)
    corners = triangles.reshape(-1, 3)
    size = float(np.ptp(corners, axis=0).max()) if len(corners) else 0.0
    n_cells = 256
    simple = triangles
    while len(simple) > most and n_cells >= 2:
        cells = np.round((corners - corners.min(axis=0)) / max(size, 1e-12) * n_cells)
        _, index = np.unique(cells.astype(np.int64), axis=0, return_inverse=True)
        index = index.reshape(-1)
        counts = np.bincount(index)
        centres = np.column_stack(
            [np.bincount(index, corners[:, k]) / counts for k in range(3)]
        )
        faces = index.reshape(-1, 3)
        differ = np.all(faces != np.roll(faces, 1, axis=1), axis=1)
        _, first = np.unique(np.sort(faces[differ], axis=1), axis=0, return_index=True)
        simple = centres[faces[differ][first]]
        n_cells = n_cells * 2 // 3
    return simple


def binary_stl(triangles: Array) -> bytes:
    """Write triangles as a binary STL file, which browsers draw.

    Parameters
    ----------
    triangles : (m, 3, 3) array
        Corners of m triangles [m].

    Returns
    -------
    bytes
        80 bytes of header, the number of triangles, then normal and corners of each.
    """
    kind = np.dtype(
        [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    facets = np.zeros(len(triangles), kind)
    edges = np.diff(triangles, axis=1)
    normals = np.cross(edges[:, 0], edges[:, 1])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facets["normal"] = normals / np.maximum(lengths, 1e-30)
    facets["corners"] = triangles
    return bytes(80) + np.uint32(len(triangles)).tobytes() + facets.tobytes()


def drawn_arm(robot: Robot, links: Iterable[Array]) -> dict[str, Any]:
    """Return joints and link ellipsoids of a robot as plain data, for a 3D view.

    Parameters
    ----------
    links : iterable of (10,) arrays
        Standard parameters of each link that has a joint, in the robot's order.

    Returns
    -------
    dict
        ``joints``: parent, position [m] and axis of motion of each; ``bodies``: link,
        joint, half axes [m] and placement (4, 4) of each ellipsoid. A link without mass
        or thickness has no ellipsoid.
    """
    bodies = []
    for k, (joint, link) in enumerate(zip(robot.link_joints, links, strict=False)):
        body = half_axes(link)
        if body is None:
            continue
        half, axes, com = body
        pose_in_link = np.block([[axes, com[:, None]], [np.zeros(3), np.ones(1)]])
        place = robot.tree[joint].link_frame @ pose_in_link
        bodies.append({"link": k, "joint": joint, "half": half, "place": place})
    joints = [
        {
            "parent": joint_of_tree.parent,
            "at": joint_of_tree.placement[:3, 3],
            "axis": joint_of_tree.axis,
        }
        for joint_of_tree in robot.tree
    ]
    return {"bodies": bodies, "joints": joints}
