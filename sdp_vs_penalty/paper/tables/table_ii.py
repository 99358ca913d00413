"""Table II: the exciting trajectory, published, as commanded, and better conditioned
ones."""

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

    def add(name: str, trajectory: str, *values: float) -> None:
        """Add a row: its name, then one value for each joint (or one value alone)."""
        rows.append(
            {
                **dict(zip(columns, (name, *values), strict=False)),
                "trajectory": trajectory,
            }
        )

    # Coefficients of the optimised trajectories: a_k and b_k of each harmonic, and q_0.
    for which, excitation in optimum.items():
        best_trajectory = excitation.trajectory
        for letter, values in (
            ("a", best_trajectory.a),
            ("b", best_trajectory.b),
            ("q", best_trajectory.q_0[:, None]),
        ):
            for k, column in enumerate(values.T):
                add(
                    f"{letter}_{k if letter == 'q' else k + 1}",
                    which,
                    *map(float, column),
                )
    trajectories = {
        "published": paper,
        **{name: e.trajectory for name, e in optimum.items()},
    }
    # Condition numbers of the regressor along each trajectory.
    for label, effects in (("links", "rigid_body"), ("links and friction", None)):
        regressor = Regressor.from_problem(study.problem, effects)
        for which, trajectory in trajectories.items():
            add(f"condition number ({label})", which, regressor.condition(trajectory))
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
    how: dict[str, Any] = {
        "iterations": study.effort.iterations,
        "progress": study.progress,
    }
    return {
        name: excite(problem, limits=limit, start=paper, **how)
        for name, limit in limits.items()
    }
