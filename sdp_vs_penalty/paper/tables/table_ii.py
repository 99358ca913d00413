"""Table II: the exciting trajectory, published, as commanded, and better conditioned ones."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.estimation.excitation import Excitation, Limits, Regressor, excite
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import Cell, Column, Table
from sdp_vs_penalty.robot.trajectory import FourierTrajectory

NAME = "II"
PROBLEMS = ("panda",)


def build(study: Study) -> Table:
    """Rows: coefficients and condition numbers of the published and of optimised trajectories."""
    published = study.problem.published["table_II"]
    paper = study.experiment.trajectory
    found = optimised(study)
    rows: list[tuple[Cell, ...]] = [(*row.values(), "published") for row in published]
    for name, excitation in found.items():
        rows += _coefficients(excitation.trajectory, name)
    rigid, whole = Regressor.of(study.problem, "rigid_body"), Regressor.of(study.problem)
    trajectories = {"published": paper, **{name: e.trajectory for name, e in found.items()}}
    blank = [None] * (paper.a.shape[0] - 1)
    for label, regressor in (("links", rigid), ("links and friction", whole)):
        for name, trajectory in trajectories.items():
            value = regressor.condition(trajectory)
            rows.append((f"condition number ({label})", value, *blank, name))
    return Table(
        NAME,
        f"Table II: exciting trajectory of {study.problem.title}",
        "Published coefficients, and trajectories optimised by this program; nothing here is measured.",
        tuple(Column(name, 5) for name in (*published[0], "trajectory")),
        tuple(rows),
        (
            f"All: L = {paper.a.shape[1]} harmonics, w_f = {paper.frequency / np.pi:.3g} pi rad/s, "
            f"{paper.duration:g} s with raised-cosine blends of {paper.blend:g} s.",
            "a_l, b_l [rad/s], q_0 [rad]. Condition numbers are of the stacked base regressor in the "
            "paper's symbols, all joints in N m; the paper prints 121.88 for its regressor with "
            "friction.",
            "within the paper's extremes: no joint leaves the range, exceeds the velocity or the "
            "acceleration that the published trajectory itself uses; within the robot's limits: "
            "Franka's position and velocity limits, accelerations that reach the velocity limit in "
            "0.25 s. Collisions are not looked at.",
        ),
    )


def optimised(study: Study) -> dict[str, Excitation]:
    """From the paper's trajectory, within its own extremes and within the robot's limits."""
    paper, problem = study.experiment.trajectory, study.problem
    limits = {
        "within the paper's extremes": Limits.of_trajectory(paper),
        "within the robot's limits": Limits.of_robot(problem.robot),
    }
    return {
        name: excite(
            problem,
            limits=limit,
            start=paper,
            iterations={"quick": 25, "paper": 150}[study.budget],
            progress=study.progress,
        )
        for name, limit in limits.items()
    }


def _coefficients(trajectory: FourierTrajectory, name: str) -> list[tuple[Cell, ...]]:
    rows: list[tuple[Cell, ...]] = []
    for letter, values in (("a", trajectory.a), ("b", trajectory.b)):
        for k, column in enumerate(values.T):
            rows.append((f"{letter}_{k + 1}", *map(float, column), name))
    rows.append(("q_0", *map(float, trajectory.q_0), name))
    return rows
