"""Figure 6: torque errors of physics engines against the identified model."""

from __future__ import annotations

from typing import Any

import numpy as np

from sdp_vs_penalty.paper.figures.engine_panels import (
    draw_engines,
    engines_title,
    legend_in_last,
    present,
)
from sdp_vs_penalty.paper.figures.style import new_figure, title
from sdp_vs_penalty.paper.tables.engine_runs import sinusoidal_runs
from sdp_vs_penalty.paper.tables.study import Study

NUMBER = 6
PROBLEM = "panda"

#: Left out at the start [s], where the acceleration jumps from rest.
_START = 0.05


def draw(study: Study) -> Any:
    n, results = study.problem.robot.n, sinusoidal_runs(study)
    figure, axes = new_figure((n + 1) // 2, 2, 7.0, sharex=True)
    draw_engines(axes, study, results, lambda run, j: run.error[:, j], "torque error")
    for j in range(n):
        runs = present(results)
        largest = max((float(np.abs(run.error[run.t > _START, j]).max()) for run in runs), default=1.0)
        # Linear around zero, logarithmic beyond: one engine's errors are far above the others'.
        axes.flat[j].set_yscale(
            "symlog", linthresh=max(1e-3 * 10 ** np.floor(np.log10(largest / 1e-2)), 1e-5)
        )
        axes.flat[j].set_ylim(-1.5 * largest, 1.5 * largest)
    legend_in_last(axes)
    title(figure, engines_title("Torque of the engine less that of the identified model", results))
    return figure
