"""Nominal links: a plausible arm, known before anything is measured; never published estimates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sdp_vs_penalty.problem.bodies import GEOMETRY_MARGIN, LAYER
from sdp_vs_penalty.problem.constants import DEFAULT_DENSITY, DEFAULT_LINEAR_DENSITY
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
    weight; else the link's geometry filled with :data:`DEFAULT_DENSITY` ("geometry"), else a slender
    ball of :data:`DEFAULT_LINEAR_DENSITY` times its reach ("kinematics").
    """
    out, sources = np.array(given, float), []
    for i, reach in enumerate(robot.link_reach()):
        scale = np.array([reach, reach, reach, 1.0])
        scaled = inertia.pseudo_inertia(out[i]) / np.outer(scale, scale)
        mass = out[i, 0]
        if mass > 0.0 and np.linalg.eigvalsh(scaled)[0] > _SLENDEREST * mass:
            sources.append("inertial")
            continue
        body = None if bodies is None else bodies[i]
        if body is not None and body.source == "geometry":
            second = (body.axes * _bare(body) ** 2 / 7.0) @ body.axes.T  # 5 for a ball, 9 for a box
            volume = body.volume
            if volume is None:  # the surface is open
                volume = 0.5 * (4.0 / 3.0 * np.pi * float(np.prod(_bare(body))))
            centre, guess = body.centre, DEFAULT_DENSITY * volume
        else:
            carrier = robot.link_joints[i]
            children = [j.placement[:3, 3] for j in robot.tree if j.parent == carrier]
            middle = np.mean(children, axis=0) / 2.0 if children else np.zeros(3)
            centre = (np.linalg.inv(robot.tree[carrier].link_frame) @ np.append(middle, 1.0))[:3]
            second = 0.2 * (0.25 * reach) ** 2 * np.eye(3)
            guess = DEFAULT_LINEAR_DENSITY * reach
        known = bool(0.0 < mass < np.inf)
        sources.append(
            "inertial" if known else "geometry" if body and body.source == "geometry" else "kinematics"
        )
        mass = mass if known else guess
        pseudo = np.empty((4, 4))
        pseudo[:3, :3] = mass * (second + np.outer(centre, centre))
        pseudo[:3, 3] = pseudo[3, :3] = mass * centre
        pseudo[3, 3] = mass
        out[i] = inertia.from_pseudo_inertia(pseudo)
    return out, tuple(sources)


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
