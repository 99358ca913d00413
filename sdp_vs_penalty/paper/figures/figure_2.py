"""Figure 2: the validation trajectories."""

from __future__ import annotations

from typing import Any

from sdp_vs_penalty.paper.figures.style import BLUE, ORANGE, label_joints, new_figure, title
from sdp_vs_penalty.paper.tables.study import Study

NUMBER = 2
PROBLEM = "panda"


def draw(study: Study) -> Any:
    n, judged = study.problem.robot.n, study.judged
    figure, axes = new_figure(n, len(judged), 1.15 * n + 0.6, sharex="col", sharey="row")
    for k, data in enumerate(judged):
        assert data.test is not None
        run = data.test.runs()[0]
        t = run.t - run.t[0]
        for j, joint in enumerate(study.problem.robot.joints):
            axes[j, k].plot(t, run.q[:, j], color=BLUE, linewidth=1.0, label="position")
            for limit in (joint.lower, joint.upper):
                axes[j, k].axhline(
                    limit, color=ORANGE, linestyle="--", linewidth=0.8, label="joint limit"
                )
            axes[j, k].margins(x=0)
        first = (
            f"first of {len(data.test.runs())}"
            if len(data.test.runs()) > 1
            else "held out of the real run"
        )
        axes[0, k].set_title(f"{data.label} ({first})")
    label_joints(axes, study.problem.robot.position_units, "position")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles[:2], labels[:2], loc="outside lower center", ncols=2, frameon=False)
    title(figure, "Validation trajectories (the paper's own are not public)")
    return figure
