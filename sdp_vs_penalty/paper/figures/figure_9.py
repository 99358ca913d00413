"""Figure 9: torques of the 2R with parameters retrieved by penalty and by SDP, beside the true ones."""

from __future__ import annotations

from typing import Any

import numpy as np

from sdp_vs_penalty.paper.figures.style import LOOKS, label_joints, legend_below, new_figure, title
from sdp_vs_penalty.paper.tables.study import Study

NUMBER = 9
PROBLEM = "two_link"

_METHODS = ("lmi-sdp", "penalty")
_STEP = 0.02  # s


def draw(study: Study) -> Any:
    robot, x, data = study.problem.robot, study.experiment, study.simulated
    t = np.arange(0.0, x.trajectory.duration, _STEP)
    states = x.trajectory.states(t)
    true = robot.inverse_dynamics(x.links.ravel(), *states)
    figure, axes = new_figure(robot.n, 2, 4.2, sharex=True, width_ratios=(3, 2))
    gaps, worst = [], []
    for j in range(robot.n):
        axes[j, 0].plot(t, true[:, j], label="p_real", **LOOKS["true"])
    for method in _METHODS:
        result = study.result(method, data)
        links = result.theta[data.model.rigid_indices]
        torque = robot.inverse_dynamics(links, *states)
        worst.append(f"{method} {1e3 * np.abs(torque - true).max():.1f} mN m")
        if result.certificate.gap is not None:
            gaps.append(f"{method} {abs(result.certificate.gap):.0e}")
        for j in range(robot.n):
            axes[j, 0].plot(t, torque[:, j], label=method, **LOOKS[method])
            axes[j, 1].plot(t, 1e3 * (torque - true)[:, j], label=method, **LOOKS[method])
    for axis in axes.flat:
        axis.margins(x=0)
    for j in range(robot.n):
        axes[j, 1].set_ylabel("error [mN m]")
    label_joints(axes, robot.torque_units, "torque")
    legend_below(figure, axes[0, 0])
    title(
        figure,
        f"2R, identified from one noisy simulated run: largest torque errors {', '.join(worst)};\n"
        f"certified gaps {', '.join(gaps)} of the loss",
    )
    return figure
