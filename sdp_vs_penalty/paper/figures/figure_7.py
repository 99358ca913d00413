"""Figure 7: where the end effector goes in physics engines: position and orientation errors."""

from __future__ import annotations

from typing import Any

from sdp_vs_penalty.paper.figures.engine_panels import engines_title, present
from sdp_vs_penalty.paper.figures.style import LOOKS, legend_below, new_figure, title
from sdp_vs_penalty.paper.tables.engine_runs import measured_runs, sinusoidal_runs
from sdp_vs_penalty.paper.tables.study import Study

NUMBER = 7
PROBLEM = "panda"

#: Errors below this are rounding and are drawn here [m, rad].
_ROUNDING = 1e-16


def draw(study: Study) -> Any:
    groups = {"sinusoids (simulated)": sinusoidal_runs(study)}
    if study.measured is not None:
        groups["motion of the real run"] = measured_runs(study)
    figure, axes = new_figure(2, len(groups), 4.6, sharex="col", sharey="row")
    for k, (name, results) in enumerate(groups.items()):
        for run in present(results):
            for axis, values, unit in ((axes[0, k], run.position, 1e3), (axes[1, k], run.angle, 1e3)):
                axis.semilogy(
                    run.t + 0.5 * run.followed.step,
                    unit * (values + _ROUNDING),
                    label=run.engine,
                    **LOOKS[run.engine],
                )
        axes[0, k].set_title(name)
        axes[1, k].set_xlabel("time [s]")
        axes[0, k].margins(x=0)
    axes[0, 0].set_ylabel("position error [mm]")
    axes[1, 0].set_ylabel("orientation error [mrad]")
    legend_below(figure, axes[0, 0])
    title(
        figure, engines_title("Last joint's frame from where the commands put it", groups.popitem()[1])
    )
    return figure
