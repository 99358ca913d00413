"""The published links beside the certified optimum of the authors' own objective."""

from typing import Any

import numpy as np

from sdp_vs_penalty.paper.figures import style
from sdp_vs_penalty.paper.figures.style import legend_below, new_figure
from sdp_vs_penalty.paper.tables.retrieved import Retrieval


def draw_retrieved(found: Retrieval) -> Any:
    """Draw the objective of both, and how far each coefficient is from its target.

    Parameters
    ----------
    found : Retrieval
        The objective, p_hat and the optimum.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, axes = new_figure(1, 2, 3.2, width_ratios=(1, 3))
    totals, each = axes[0]
    looks = {
        "p_hat (published)": (found.p_hat, style.ORANGE),
        "certified optimum": (found.best.theta, style.BLACK),
    }
    for k, (label, (theta, color)) in enumerate(looks.items()):
        residual = found.objective.residual(theta)
        totals.bar(k, 1e3 * float(residual @ residual), color=color)
        places = np.arange(len(residual)) + 0.4 * (k - 0.5)
        each.bar(places, np.abs(residual), 0.4, color=color, label=label)
    totals.axhline(1e3 * found.best.lower, color=style.RED, linestyle=":")
    totals.set_xticks([0, 1], ["p_hat", "optimum"])
    totals.set_ylabel("objective [1e-3], dotted:\ncertified lower bound")
    each.set_xlabel("base parameter that the authors' retrieval keeps")
    each.set_ylabel("distance from its target\n[kg m, kg m$^2$]")
    legend_below(figure, each, n_columns=2)
    return figure
