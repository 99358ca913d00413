"""A link that is known to be a certain part, within a tolerance of manufacture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.constraints import constraint as build
from sdp_vs_penalty.constraints.constraint import Constraint
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class CataloguePart:
    """A link known to be this part: its parameters within a share ``tolerance`` of the given ones.

    link : from 0; theta : (10,) about the link frame; the tolerance of a product of inertia or a
    first moment is that share of the part's m, m r and m r^2 with r its radius of gyration.
    """

    name: str
    link: int
    theta: Array
    tolerance: float = 0.01

    def constraint(self, task: Task) -> Constraint:
        """|theta_link - theta_part| <= tolerance, entry by entry: convex."""
        p = inertia.pseudo_inertia(self.theta)
        mass, radius = p[3, 3], np.sqrt(np.trace(p[:3, :3]) / p[3, 3])
        half = self.tolerance * mass * np.repeat([1.0, radius, radius**2], [1, 3, 6])
        eye = np.eye(10)
        constant = np.concatenate([half - self.theta, half + self.theta])
        return build.linear(
            "catalogue part", self.name, task.links[self.link], np.hstack([eye, -eye]), constant
        )
