"""Figure 1: measured and estimated torques along the exciting trajectory, with errors."""

from __future__ import annotations

from typing import Any

from sdp_vs_penalty.paper.figures.style import label_joints, legend_below, new_figure, title
from sdp_vs_penalty.paper.figures.torque_panels import Torques
from sdp_vs_penalty.paper.tables.study import Study

NUMBER = 1
PROBLEM = "panda"

_METHODS = ("ols", "lmi-sdp")


def draw(study: Study) -> Any:
    data = study.measured or study.simulated
    torques = Torques.of(study, data, data.train, _METHODS)
    n = study.problem.robot.n
    figure, axes = new_figure(n, 2, 1.25 * n + 0.6, sharex=True, width_ratios=(3, 2))
    for j in range(n):
        torques.draw(j, axes[j, 0], axes[j, 1], data.label)
    label_joints(axes, study.problem.robot.torque_units, "torque")
    axes[0, 0].set_title("torque")
    axes[0, 1].set_title("error: estimated less " + data.label)
    legend_below(figure, axes[0, 0])
    errors = ", ".join(f"{m} {torques.relative_error(m):.2f} %" for m in _METHODS)
    title(
        figure,
        f"Exciting trajectory, {data.label}: relative error {errors} (the paper: 1.41 %, CLS), "
        f"below {data.preprocessing.torque_cutoff:g} Hz",
    )
    return figure
