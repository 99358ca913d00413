"""Figure 10: internal wrenches of the 2R: real, feasible, unfeasible, and all that are possible."""

from __future__ import annotations

from typing import Any

import numpy as np

from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.paper.figures.style import BLACK, ORANGE, RED, SKY, new_figure, title
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.wrenches import COMPONENTS, UNITS, wrench_study

_NAMES = dict(zip(COMPONENTS, ("$f_x$", "$f_y$", "$f_z$", "$n_x$", "$n_y$", "$n_z$"), strict=True))


def draw(study: Study) -> Any:
    w = wrench_study(study)
    n = study.problem.robot.n
    figure, axes = new_figure(len(COMPONENTS), n, 8.6, sharex=True)
    unfeasible = [w.wrenches(study, r.links) for r in (*w.boxed[:3], *w.unbounded[:3])]
    for j in range(n):
        for k, component in enumerate(COMPONENTS):
            axis = axes[k, j]
            axis.fill_between(
                w.t,
                w.intervals.lower_bound[:, j, k],
                w.intervals.upper_bound[:, j, k],
                color=SKY,
                alpha=0.45,
                linewidth=0,
                label="all feasible with equal torques (certified)",
            )
            for values in (*w.feasible.values(), *w.penalty_runs):
                axis.plot(w.t, values[:, j, k], color=ORANGE, linewidth=0.6, label="feasible estimates")
            for values in unfeasible:
                axis.plot(
                    w.t, values[:, j, k], color=RED, linewidth=0.8, linestyle=":", label="unfeasible"
                )
            axis.plot(w.t, w.true[:, j, k], color=BLACK, linewidth=1.4, label="p_real")
            # Room around the interval; unfeasible wrenches may leave it by orders of magnitude.
            low, high = w.intervals.lower[:, j, k].min(), w.intervals.upper[:, j, k].max()
            axis.set_ylim(low - 0.3 * (high - low), high + 0.3 * (high - low))
            what = " = torque" if component == "nz" else ""
            axis.set_ylabel(f"{_NAMES[component]}{what} [{plain_unit(UNITS[k])}]")
            axis.margins(x=0)
        axes[0, j].set_title(f"joint {j + 1}")
        axes[-1, j].set_xlabel("time [s]")
    figure.align_ylabels()
    handles, labels = axes[0, 0].get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    figure.legend(unique.values(), unique.keys(), loc="outside lower center", ncols=4, frameon=False)
    worst = max((float(np.abs(v).max()) for v in unfeasible), default=0.0)
    title(
        figure,
        "Internal wrenches of the 2R in the joint frames; unfeasible parameters make the same torques "
        f"and leave the\npanels (worst here {worst:.1e}; without bounds there is no largest)",
    )
    return figure
