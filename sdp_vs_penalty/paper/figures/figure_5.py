"""Figure 5: torques of physics engines along sinusoidal velocities, and of the identified model."""

from __future__ import annotations

from typing import Any

from sdp_vs_penalty.paper.figures.engine_panels import (
    draw_engines,
    engines_title,
    legend_in_last,
    present,
)
from sdp_vs_penalty.paper.figures.style import LOOKS, new_figure, title
from sdp_vs_penalty.paper.tables.engine_runs import sinusoidal_runs
from sdp_vs_penalty.paper.tables.study import Study

NUMBER = 5
PROBLEM = "panda"


def draw(study: Study) -> Any:
    n, results = study.problem.robot.n, sinusoidal_runs(study)
    figure, axes = new_figure((n + 1) // 2, 2, 7.0, sharex=True)
    for run in present(results)[:1]:
        for j in range(n):
            axes.flat[j].plot(run.t, run.model[:, j], label="identified model", **LOOKS["model"])
    draw_engines(axes, study, results, lambda run, j: run.followed.torque[:, j], "torque")
    legend_in_last(axes)
    title(figure, engines_title("Torques of physics engines on sinusoidal velocities", results))
    return figure
