"""Nominal links: a plausible arm, known before anything is measured; never published estimates."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.robot import Robot

if TYPE_CHECKING:
    from sdp_vs_penalty.problem.problem import Problem

Array = NDArray[np.float64]

#: Nominal mass per length of a link about which nothing is known [kg/m].
DEFAULT_LINEAR_DENSITY = 10.0


def plausible_links(robot: Robot, given: Array) -> Array:
    """Strictly consistent nominal links: those given where they are, else a slender ball each."""
    out = np.array(given, float)
    for i, reach in enumerate(robot.link_reach()):
        scale = np.array([reach, reach, reach, 1.0])
        scaled = inertia.pseudo_inertia(out[i]) / np.outer(scale, scale)
        if out[i, 0] > 0.0 and np.linalg.eigvalsh(scaled)[0] > 1e-6 * out[i, 0]:
            continue
        children = [j.placement[:3, 3] for j in robot.joints if j.parent == i]
        centre = np.mean(children, axis=0) / 2.0 if children else np.zeros(3)
        centre = np.linalg.inv(robot.joints[i].link_frame) @ np.append(centre, 1.0)
        mass, moment = DEFAULT_LINEAR_DENSITY * reach, 0.4 * (0.25 * reach) ** 2
        out[i] = inertia.standard_from_barycentric(
            [mass, *centre[:3], *(mass * moment * np.array([1, 0, 1, 0, 0, 1]))]
        )
    return out


def ellipsoids_in_the_box(problem: Problem) -> Array:
    """Uniform solid ellipsoids that fill the centre-of-mass boxes.

    Masses share the middle of the total-mass range in proportion to the boxes' surface; half axes
    are those of the box, at least 6 cm. Links without a finite box stay zero (see plausible_links).
    """
    size = np.zeros((problem.robot.n, 3))
    centre = np.zeros_like(size)
    for link in range(problem.robot.n):
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
        return np.zeros((problem.robot.n, 10))
    mass = np.mean(total) * surface / surface.sum()
    mass = np.clip(mass, problem.box[:, 0, 0] + 1e-3, 0.9 * problem.box[:, 0, 1])
    out = []
    for m, c, half in zip(mass, centre, size, strict=True):
        second = m * half**2 / 5.0
        moments = second.sum() - second
        out.append([m, *c, moments[0], 0.0, moments[1], 0.0, 0.0, moments[2]])
    return inertia.standard_from_barycentric(out)
