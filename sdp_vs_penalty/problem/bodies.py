"""Where each link's mass can be: from its geometry, stated bounds, its inertial, or the kinematics.

Generous on purpose, because a body that is too small makes the truth infeasible. The margins: 20 % and
3 cm around geometry (a shell leaves cables and screws out), twice the ellipsoid of uniform density that
has a link's inertial, and balls around the joints that it bears and the corners of its bounds, of at
least 10 cm, or 1 m where nothing but the joints is known.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.problem.constants import INERTIAL_MARGIN, LEAST_UNKNOWN
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.body import Body, around, balls
from sdp_vs_penalty.robot.geometry import Geometry
from sdp_vs_penalty.robot.robot import Robot

#: Half axes of the body over those of the ellipsoid around the link's geometry, and a layer on it [m].
GEOMETRY_MARGIN, LAYER = 1.2, 0.03
#: Radius of a link where nothing tells it: this share of its reach, at least so much [m].
RADIUS_SHARE, LEAST_RADIUS = 0.5, 0.1
#: Geometry smaller than this marks a place [m]; one larger than so many robots is not in metres.
MARKER, ROBOTS = 0.01, 3.0


def link_bodies(
    robot: Robot, centres: Array, given: Array, geometry: Sequence[Geometry | None] | None = None
) -> tuple[Body, ...]:
    """The body of each link in its frame, from the best that is known of it.

    centres (n, 3, 2) : bounds on the centre of mass [m], infinite where there is none; given (n, 10) :
    standard parameters that came with the robot, zeros where none did.
    """
    reach = robot.link_reach()
    largest = ROBOTS * max(float(reach.sum()), 1.0)
    out = []
    for k in range(robot.links):
        shape = None if geometry is None else _usable(geometry[k], largest)
        own = _uniform_ellipsoid(given[k], largest)
        corners = np.array(np.meshgrid(*centres[k])).reshape(3, -1).T
        radius = max(RADIUS_SHARE * reach[k], LEAST_RADIUS)
        if shape is not None:
            cloud = shape.points if own is None else np.concatenate([shape.points, own])
            volume = shape.volume if shape.volume > 0.0 else None
            out.append(around(cloud, "geometry", GEOMETRY_MARGIN, LAYER, volume))
        elif np.all(np.isfinite(corners)):
            places = np.concatenate([corners, joint_places(robot, k)])
            out.append(around(balls(places, radius), "bounds"))
        elif own is not None:
            wide = own.mean(axis=0) + INERTIAL_MARGIN * (own - own.mean(axis=0))
            places = balls(np.concatenate([joint_places(robot, k), own]), LEAST_RADIUS)
            out.append(around(np.concatenate([wide, places]), "inertial"))
        else:
            wide = max(reach[k], LEAST_UNKNOWN)
            out.append(around(balls(joint_places(robot, k), wide), "kinematics"))
    return tuple(out)


def joint_places(robot: Robot, link: int) -> Array:
    """(k, 3) the link frame's origin and the joints that a link bears, its own too, over their strokes.

    A frame may sit anywhere on its joint's axis: the link begins where the axis leaves the parent's.
    """
    carrier = robot.link_joints[link]
    own = robot.tree[carrier]
    into = np.linalg.inv(own.link_frame)
    before = float(own.axis @ own.placement[:3, :3].T @ own.placement[:3, 3])
    places: list[Array] = [-s * own.axis for s in (before, *_stroke(own.kind, own.lower, own.upper))]
    for child in robot.tree:
        if child.parent == carrier:
            along = child.placement[:3, :3] @ child.axis
            places += [
                child.placement[:3, 3] + s * along for s in _stroke(child.kind, child.lower, child.upper)
            ]
    return np.concatenate([np.zeros((1, 3)), np.array(places) @ into[:3, :3].T + into[:3, 3]])


def _stroke(kind: str, lower: float, upper: float) -> list[float]:
    ends = [x for x in (lower, upper) if kind == "prismatic" and np.isfinite(x)]
    return [0.0, *ends]


def _usable(shape: Geometry | None, largest: float) -> Geometry | None:
    if shape is None:
        return None
    extent = float(np.ptp(shape.points, axis=0).max())
    farthest = float(np.linalg.norm(shape.points, axis=1).max())
    return shape if extent > MARKER and farthest < largest else None


def _uniform_ellipsoid(link: Array, largest: float) -> Array | None:
    """(6, 3) the ends of the axes of the ellipsoid of uniform density with these parameters (10,)."""
    pseudo = inertia.pseudo_inertia(link)
    if not link[0] > 0.0:
        return None
    centre = pseudo[:3, 3] / link[0]
    size, axes = np.linalg.eigh(pseudo[:3, :3] / link[0] - np.outer(centre, centre))
    ends = np.sqrt(5.0 * np.maximum(size, 0.0)) * axes
    if size[0] < -1e-6 * abs(size[-1]) or np.abs(centre).max() + ends.max() > largest:
        return None  # no body has these
    return np.concatenate([centre + ends.T, centre - ends.T])
