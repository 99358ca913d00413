"""Figure 3: torques along the validation trajectories."""

from __future__ import annotations

from typing import Any

from sdp_vs_penalty.paper.figures.style import label_joints, legend_below, new_figure, title
from sdp_vs_penalty.paper.figures.torque_panels import Torques
from sdp_vs_penalty.paper.tables.study import Study

NUMBER = 3
PROBLEM = "panda"

_METHODS = ("lmi-sdp", "penalty")


def draw(study: Study) -> Any:
    n, judged = study.problem.robot.n, study.judged
    figure, axes = new_figure(n, 2 * len(judged), 1.25 * n + 0.6, sharex="col")
    notes = []
    for k, data in enumerate(judged):
        assert data.test is not None
        torques = Torques.of(study, data, data.test.runs()[0], _METHODS)
        for j in range(n):
            torques.draw(j, axes[j, 2 * k], axes[j, 2 * k + 1], "recorded")
        axes[0, 2 * k].set_title(f"{data.label}: torque")
        axes[0, 2 * k + 1].set_title(f"{data.label}: error")
        notes.append(f"{data.label} {torques.relative_error('lmi-sdp'):.2f} %")
    label_joints(axes, study.problem.robot.torque_units, "torque")
    legend_below(figure, axes[0, 0])
    title(figure, "Held-out torques; relative error of lmi-sdp: " + ", ".join(notes))
    return figure
