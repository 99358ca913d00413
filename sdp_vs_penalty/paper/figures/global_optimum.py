"""The penalised objective's global optimum over its weight, with the runs of annealing."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas

from sdp_vs_penalty.paper.figures import style
from sdp_vs_penalty.paper.figures.style import legend_below, new_figure
from sdp_vs_penalty.paper.tables.global_optimum import Certified


def draw_global_optima(
    searched: Sequence[Certified], runs: pandas.DataFrame, title: str
) -> Any:
    """Draw objective and worst violation over the penalty's weight.

    Lines are certified optima, dots are runs of annealing.

    Parameters
    ----------
    searched : sequence of Certified
        The problems, one for each column.
    runs : DataFrame
        Where every run of a search ends (annealing_runs.csv).

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, axes = new_figure(2, len(searched), 5.2, sharex=True)
    for column, problem in zip(axes.T, searched, strict=True):
        annealed = runs[
            (runs["data"] == problem.label)
            & (runs["problem"] == problem.name)
            & (runs["search"] == "annealing")
        ]
        _draw_objective(column[0], problem, annealed)
        _draw_violation(column[1], problem, annealed)
        column[0].set_title(f"{problem.label} run, {problem.name}, {problem.rows} rows")
        for axis in column:
            axis.set_xscale("symlog", linthresh=0.1)
            axis.set_xticks([0, 0.1, 1, 10, 100, 1000], [0, 0.1, 1, 10, 100, 1000])
            axis.set_xlim(-0.02, 1500.0)  # room for the dots at both ends
            axis.axvspan(0.0, 40.0, color=style.GREY, alpha=0.15, linewidth=0)
            axis.axvline(
                problem.exact_by_theory,
                color=style.RED,
                linestyle=":",
                label="exact from here on (largest multiplier)",
            )
        column[1].set_xlabel("weight xi (grey: the paper's)")
    axes[0, 0].set_ylabel("objective over feasible\noptimum [%]")
    axes[1, 0].set_ylabel("worst violation\n[kg m$^2$, kg or m]")
    legend_below(figure, axes[0, 0], n_columns=2)
    figure.suptitle(title)
    return figure


def _draw_objective(axis: Any, problem: Certified, annealed: pandas.DataFrame) -> None:
    """Draw how far objectives lie above the feasible optimum's loss [%], over the
    penalty's weight: certified optima as lines, runs of annealing as dots."""
    base = problem.feasible_loss
    # Values, colour and dashes of each line, by its label.
    lines = {
        "certified optimum": ([x.lower for x in problem.boxed], style.BLACK, "-"),
        "certified, without the box on inertias": (
            [x.value for x in problem.free],
            style.BLUE,
            "--",
        ),
    }
    for label, (values, color, line) in lines.items():
        excess = 100.0 * (np.array(values) / base - 1.0)
        axis.plot(
            problem.weights,
            excess,
            marker=".",
            markersize=3,
            color=color,
            linestyle=line,
            label=label,
        )
    # The runs of annealing as dots.
    _dots(axis, annealed, 100.0 * (annealed["objective"].astype(float) / base - 1.0))
    axis.set_yscale("symlog", linthresh=1.0)
    axis.yaxis.set_major_formatter("{x:g}")
    axis.axhline(0.0, color=style.GREY, linewidth=0.6)


def _draw_violation(axis: Any, problem: Certified, annealed: pandas.DataFrame) -> None:
    """Draw the worst violation over the weight, on a logarithmic scale.

    A violation of zero is drawn at 1e-8.
    """
    none = 1e-8  # where "none" is drawn [kg m^2, kg or m]
    boxed = [np.nan if x.best is None else x.best.worst for x in problem.boxed]
    free = [x.worst for x in problem.free]
    for values, color, line in ((boxed, style.BLACK, "-"), (free, style.BLUE, "--")):
        worst = np.maximum(values, none)
        axis.plot(
            problem.weights,
            worst,
            color=color,
            linestyle=line,
            marker=".",
            markersize=3,
        )
    _dots(axis, annealed, annealed["worst_violation"].astype(float).clip(lower=none))
    axis.set_yscale("log")
    ticks = [1e-8, 1e-6, 1e-4, 1e-2, 1.0]
    axis.set_yticks(ticks, ["none", "1e-6", "1e-4", "0.01", "1"])
    axis.set_ylim(0.5 * none, 20.0)


def _dots(axis: Any, annealed: pandas.DataFrame, values: pandas.Series) -> None:
    """Draw a dot for every run of annealing at every weight."""
    n_runs = annealed["run"].nunique()
    n_evaluations = annealed["evaluations"].max()
    axis.plot(
        annealed["xi"],
        values,
        linestyle="",
        marker="o",
        markersize=3.5,
        color=style.ORANGE,
        alpha=0.6,
        label=f"annealing: {n_runs} runs, at most {n_evaluations} evaluations a weight",
    )
