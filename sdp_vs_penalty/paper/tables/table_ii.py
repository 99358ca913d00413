"""Table II: the exciting trajectory, published, as commanded, and better conditioned
ones."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from sdp_vs_penalty.estimation.excitation import Excitation, Limits, Regressor, excite
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import Row, StudyTable, notes, register_table


@register_table("II", "panda")
def exciting_trajectory(study: Study) -> StudyTable:
    """Table II: the exciting trajectory, published, as commanded, and better
    conditioned ones.

    A trajectory excites the parameters better the smaller the condition number of its
    regressor is.

    Parameters
    ----------
    study : Study
        The robot's data sets and every method's estimate, computed on demand.

    Returns
    -------
    StudyTable
        Rows of coefficients (a_k, b_k, q_0 of each joint) and of condition numbers, of the
        published trajectory and of trajectories optimised by this program.
    """
    published = study.problem.published["table_II"]
    paper = study.experiment.trajectory
    optimum = optimised(study)
    columns = list(published[0])
    # The coefficients as printed.
    rows: list[Row] = [{**row, "trajectory": "published"} for row in published]

    def add(name: str, trajectory: str, values: Iterable[float]) -> None:
        """Add a row: its name, then one value for each joint (or one value alone)."""
        cells = dict(zip(columns, (name, *map(float, values)), strict=False))
        rows.append({**cells, "trajectory": trajectory})

    optimised_trajectories = {
        name: excitation.trajectory for name, excitation in optimum.items()
    }
    for which, trajectory in optimised_trajectories.items():
        for letter, harmonics in (("a", trajectory.a), ("b", trajectory.b)):
            for k, values in enumerate(harmonics.T, start=1):
                add(f"{letter}_{k}", which, values)
        add("q_0", which, trajectory.q_0)
    trajectories = {"published": paper, **optimised_trajectories}
    # Condition numbers of the regressor along each trajectory.
    for label, effects in (("links", "rigid_body"), ("links and friction", None)):
        regressor = Regressor.from_problem(study.problem, effects)
        for which, trajectory in trajectories.items():
            number = regressor.condition(trajectory)
            add(f"condition number ({label})", which, [number])
    return StudyTable(
        f"Table II: exciting trajectory of {study.problem.title}",
        rows,
        notes(
            "II",
            harmonics=paper.a.shape[1],
            over_pi=paper.frequency / np.pi,
            paper=paper,
        ),
        digits=5,
        caption=(
            "Published coefficients, and trajectories optimised by this program;"
            " nothing here is measured."
        ),
    )


def optimised(study: Study) -> dict[str, Excitation]:
    """Optimise the paper's exciting trajectory, within two sets of limits.

    Parameters
    ----------
    study : Study
        The robot's data sets and every method's estimate, computed on demand.

    Returns
    -------
    dict of str to Excitation
        Within the extremes of the paper's trajectory, and within the robot's limits.
    """
    paper = study.experiment.trajectory
    problem = study.problem
    limits = {
        "within the paper's extremes": Limits.from_trajectory(paper),
        "within the robot's limits": Limits.from_robot(problem.robot),
    }
    settings: dict[str, Any] = {
        "iterations": study.effort.iterations,
        "progress": study.progress,
    }
    return {
        name: excite(problem, limits=limit, start=paper, **settings)
        for name, limit in limits.items()
    }
