"""Nominal links: a plausible arm, known before anything is measured; never published estimates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sdp_vs_penalty.problem.bodies import GEOMETRY_MARGIN, LAYER
from sdp_vs_penalty.problem.constants import ACTUATOR, DEFAULT_DENSITY, HOLDING, LARGEST, POWER, TUBE
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.body import Body
from sdp_vs_penalty.robot.robot import Robot

if TYPE_CHECKING:
    from sdp_vs_penalty.problem.problem import Problem

#: Smallest eigenvalue of a pseudo-inertia in units of reach and mass that counts as that of a body.
_SLENDEREST = 1e-6


def plausible_links(
    robot: Robot, given: Array, bodies: Sequence[Body] | None = None
) -> tuple[Array, tuple[str, ...]]:
    """Strictly consistent nominal links (n, 10), and where each comes from.

    Those given where they are possible ("inertial"); a given mass whose moments are not keeps its
    weight; else the link's geometry filled with :data:`DEFAULT_DENSITY` ("geometry"), else a tube with
    half of each actuator at its ends ("kinematics"). The last two are drawn, not measured.
    """
    out, sources, actuators = np.array(given, float), [], _actuators(robot)
    for i, reach in enumerate(robot.link_reach()):
        scale = np.array([reach, reach, reach, 1.0])
        scaled = inertia.pseudo_inertia(out[i]) / np.outer(scale, scale)
        mass = out[i, 0]
        if mass > 0.0 and np.linalg.eigvalsh(scaled)[0] > _SLENDEREST * mass:
            sources.append("inertial")
            continue
        body = None if bodies is None else bodies[i]
        seen = body is not None and body.source == "geometry"
        if body is not None and seen:
            second = (body.axes * _bare(body) ** 2 / 7.0) @ body.axes.T  # 5 for a ball, 9 for a box
            volume = body.volume
            if volume is None:  # the surface is open
                volume = 0.5 * (4.0 / 3.0 * np.pi * float(np.prod(_bare(body))))
            drawn = _lump(DEFAULT_DENSITY * volume, body.centre, second)
        else:
            drawn = _tube(robot, i, reach, actuators)
        known = bool(0.0 < mass < np.inf)
        sources.append("inertial" if known else "geometry" if seen else "kinematics")
        out[i] = inertia.from_pseudo_inertia(drawn * (mass / drawn[3, 3] if known else 1.0))
    return out, tuple(sources)


def _lump(mass: float, centre: Array, second: Array) -> Array:
    """(4, 4) pseudo-inertia of a mass [kg] about its centre [m] with second moments per mass [m^2]."""
    pseudo = np.empty((4, 4))
    pseudo[:3, :3] = second + np.outer(centre, centre)
    pseudo[:3, 3] = pseudo[3, :3] = centre
    pseudo[3, 3] = 1.0
    return mass * pseudo


def _actuators(robot: Robot) -> Array:
    """Mass of each joint's actuator [kg], from its torque limit, or from the arm that it has to hold
    where limits are missing or all the same (a placeholder); none for a sliding joint."""
    beyond = np.zeros(len(robot.tree))
    reach = dict(zip(robot.link_joints, robot.link_reach(), strict=True))
    for k in reversed(range(len(robot.tree))):
        ahead = [beyond[c] for c, joint in enumerate(robot.tree) if joint.parent == k]
        beyond[k] = reach.get(k, 0.0) + max(ahead, default=0.0)
    torque, limits = HOLDING * beyond**2, np.array([joint.effort for joint in robot.tree])
    turning = np.array([joint.kind != "prismatic" for joint in robot.tree])
    if np.all(np.isfinite(limits[turning])) and len(set(limits[turning].tolist())) > 1:
        torque = np.where(turning, limits, 0.0)
    return np.where(turning, ACTUATOR * np.minimum(torque, LARGEST) ** POWER, 0.0)


def _tube(robot: Robot, link: int, reach: float, actuators: Array) -> Array:
    """(4, 4) pseudo-inertia of a tube between a link's joints with half of their actuators."""
    carrier = robot.link_joints[link]
    children = [k for k, joint in enumerate(robot.tree) if joint.parent == carrier]
    places = [np.zeros(3), *(robot.tree[k].placement[:3, 3] for k in children)]
    into = np.linalg.inv(robot.tree[carrier].link_frame)
    ends = np.array(places) @ into[:3, :3].T + into[:3, 3]
    middle = 0.5 * (ends[0] + ends[1:].mean(axis=0)) if children else ends[0]
    second = 0.2 * (0.25 * reach) ** 2 * np.eye(3)
    lumps = [_lump(TUBE * reach, middle, second)]
    for k, end in zip((carrier, *children), ends, strict=True):
        lumps.append(_lump(0.5 * actuators[k], end, second))
    return np.sum(lumps, axis=0)


def _bare(body: Body) -> Array:
    """(3,) half axes of the ellipsoid around the geometry itself [m]."""
    return (body.half_axes - LAYER) / GEOMETRY_MARGIN


def ellipsoids_in_the_box(problem: Problem) -> Array:
    """Uniform solid ellipsoids that fill the centre-of-mass boxes.

    Masses share the middle of the total-mass range in proportion to the boxes' surface; half axes
    are those of the box, at least 6 cm. Links without a finite box stay zero (see plausible_links).
    """
    size = np.zeros((problem.robot.links, 3))
    centre = np.zeros_like(size)
    for link in range(problem.robot.links):
        com = np.minimum(problem.link_size(link)[1], problem.robot.link_reach()[link])
        box = problem.box[link, 1:4]
        box = np.where(np.isfinite(box), box, np.column_stack([-com, com]))
        size[link] = np.maximum(0.5 * (box[:, 1] - box[:, 0]), 0.06)
        centre[link] = box.mean(axis=1)
        for cone in problem.cones:
            # A centre inside every cone of the link: half way into the box, on the axis.
            if cone.link == link:
                centre[link, [a for a in range(3) if a != cone.axis]] = 0.0
    surface = np.sum(size * np.roll(size, 1, axis=1), axis=1)
    total = problem.total_mass
    if not np.isfinite(total[1]):
        return np.zeros((problem.robot.links, 10))
    mass = np.mean(total) * surface / surface.sum()
    mass = np.clip(mass, problem.box[:, 0, 0] + 1e-3, 0.9 * problem.box[:, 0, 1])
    out = []
    for m, c, half in zip(mass, centre, size, strict=True):
        second = m * half**2 / 5.0
        moments = second.sum() - second
        out.append([m, *c, moments[0], 0.0, moments[1], 0.0, 0.0, moments[2]])
    return inertia.standard_from_barycentric(out)
