"""Table "triangle": what the triangle inequalities buy.

Sousa and Cortesao (IJRR 2014) demand of a link that mass and inertia about its centre of
mass are positive, by the matrix inequality

    [[J, S(h)^T], [S(h), m 1]] >= 0,    h = m c,  S(h) x = h x x,

J the inertia about the link's frame. A body's principal moments also obey D3 <= D1 + D2,
which the pseudo-inertia contains and this does not (Wensing et al. 2018).
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdpPlain
from sdp_vs_penalty.paper.penalised_optimum import PenalisedOptimum, PenalisedProblem
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import Row, StudyTable, notes, register_table
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Indices
from sdp_vs_penalty.robot.constraint import Constraint, linear
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem


@dataclass(frozen=True)
class WithoutTriangle(LmiSdpPlain):
    """The torque SDP with Sousa and Cortesao's matrix in place of the pseudo-inertia."""

    name = "lmi-sdp-without-triangle"
    description = (
        "torque SDP with positive masses and inertias, without triangle inequalities"
    )
    table_place: ClassVar[int | None] = None
    solver: str | None = "clarabel"  # our own takes matrices of order four at most

    def posed(self, task: Task) -> ConvexProblem:
        """Return the torque loss, and the demands with the weaker matrix."""
        problem = super().posed(task)
        others = problem.constraints.with_families(lambda x: x != "pseudo-inertia")
        weaker = [
            positive_inertia(f"link {k}", link)
            for k, link in enumerate(task.links, start=1)
        ]
        return replace(problem, constraints=others.plus(weaker))


def positive_inertia(name: str, link: Indices) -> Constraint:
    """Return the constraint [[J, S(h)^T], [S(h), m 1]] >= 0 of a link.

    link : (10,) indices of its standard parameters.
    """
    basis = np.zeros((10, 6, 6))
    basis[0, 3:, 3:] = np.eye(3)
    # S(h): column k is h x e_k, h the places 1 to 3.
    basis[1:4, 3:, :3] = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)
    basis[1:4, :3, 3:] = basis[1:4, 3:, :3].swapaxes(1, 2)
    basis[4:, :3, :3] = inertia.inertia_matrix(np.eye(6))
    return linear("positive inertia", name, link, basis, np.zeros((6, 6)), "psd")


@register_table("triangle", "panda", slow=True)
def triangle(study: Study) -> StudyTable:
    """Triangle table: what the triangle inequalities change."""
    methods = {
        "pseudo-inertia (4x4)": LmiSdpPlain(),
        "Sousa and Cortesao (6x6)": WithoutTriangle(),
    }
    data = study.whole[-1]
    problem = PenalisedProblem(study.task(data), two_step=False)
    rows = list[Row]()
    for name, method in methods.items():
        result = study.estimated(method, data)
        loss = study.task(data).data.loss(result.theta)
        violated = problem.triangle(result.theta)
        row: Row = {
            "demand": name,
            "loss": loss,
            "gap": result.certificate.gap,
            "above_percent": 100.0 * (loss / (rows[0]["loss"] if rows else loss) - 1.0),
            "links_violated": int(np.sum(violated > PenalisedOptimum.tolerance)),
            "worst_triangle_violation": float(violated.max()),
            "unseen_error_percent": None,
            "data": data.label,
        }
        if study.run is not None:
            row["unseen_error_percent"] = study.unseen(method).relative_error_percent
        rows.append(row)
    return StudyTable(
        f"What the triangle inequalities change, {study.problem.title}",
        rows,
        notes("triangle", n=len(study.task(data).links)),
        digits=5,
    )
