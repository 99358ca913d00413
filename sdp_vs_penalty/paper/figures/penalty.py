"""The penalised objective's global optimum over its weight, with the runs of annealing; the
published links beside the certified optimum of the authors' own objective."""

from typing import Any

import numpy as np
import pandas

from sdp_vs_penalty.paper.figures import style
from sdp_vs_penalty.paper.figures.style import legend_below, new_figure
from sdp_vs_penalty.paper.tables.penalty import Retrieval

#: Colour and dashes of the certified optima, inside the box and without it.
_BOXED = {"color": style.BLACK, "linestyle": "-", "marker": ".", "markersize": 3}
_FREE = _BOXED | {"color": style.BLUE, "linestyle": "--"}
#: Where a violation of zero is drawn [kg m^2, kg or m].
_NONE = 1e-8


def draw_global_optima(
    optima: pandas.DataFrame, runs: pandas.DataFrame, title: str
) -> Any:
    """Draw objective and worst violation over the penalty's weight.

    Lines are certified optima, dots are runs of annealing.

    Parameters
    ----------
    optima : DataFrame
        Rows of the table of global optima, a problem a column.
    runs : DataFrame
        Where every run of a search ends (annealing_runs.csv).

    Returns
    -------
    matplotlib.figure.Figure
    """
    problems = list(optima.groupby(["data", "problem"], sort=False))
    figure, axes = new_figure(2, len(problems), 5.2, sharex=True)
    for column, ((data, name), rows) in zip(axes.T, problems, strict=True):
        is_drawn = (runs["data"] == data) & (runs["problem"] == name)
        _problem(column, rows, runs[is_drawn & (runs["search"] == "annealing")])
        column[0].set_title(f"{data} run, {name}, {rows.iloc[0]['rows']} rows")
    axes[0, 0].set_ylabel("objective over feasible\noptimum [%]")
    axes[1, 0].set_ylabel("worst violation\n[kg m$^2$, kg or m]")
    legend_below(figure, axes[0, 0], n_columns=2)
    figure.suptitle(title)
    return figure


def _problem(column: Any, rows: pandas.DataFrame, annealed: pandas.DataFrame) -> None:
    """Draw one problem: the rows of its optima, and its runs of annealing."""
    objective, violation = column
    first = rows.iloc[0]

    def above(values: pandas.Series) -> Any:
        """Objectives above the feasible optimum's loss [%]."""
        return 100.0 * (values.astype(float) / first["feasible_loss"] - 1.0)

    xi = rows["xi"]
    objective.plot(xi, above(rows["lower_bound"]), label="certified optimum", **_BOXED)
    without = "certified, without the box on inertias"
    objective.plot(xi, above(rows["free_optimum"]), label=without, **_FREE)
    _dots(objective, annealed, above(annealed["objective"]))
    objective.set_yscale("symlog", linthresh=1.0)
    objective.yaxis.set_major_formatter("{x:g}")
    objective.axhline(0.0, color=style.GREY, linewidth=0.6)
    for key, look in (("worst_violation", _BOXED), ("free_worst_violation", _FREE)):
        violation.plot(xi, rows[key].astype(float).clip(lower=_NONE), **look)
    worst = annealed["worst_violation"].astype(float).clip(lower=_NONE)
    _dots(violation, annealed, worst)
    violation.set_yscale("log")
    ticks = [_NONE, 1e-6, 1e-4, 1e-2, 1.0]
    violation.set_yticks(ticks, ["none", "1e-6", "1e-4", "0.01", "1"])
    violation.set_ylim(0.5 * _NONE, 20.0)
    for axis in column:
        axis.set_xscale("symlog", linthresh=0.1)
        axis.set_xticks([0, 0.1, 1, 10, 100, 1000], [0, 0.1, 1, 10, 100, 1000])
        axis.set_xlim(-0.02, 1500.0)  # room for the dots at both ends
        axis.axvspan(0.0, 40.0, color=style.GREY, alpha=0.15, linewidth=0)
        exact = "exact from here on (largest multiplier)"
        axis.axvline(first["exact_weight"], color=style.RED, linestyle=":", label=exact)
    violation.set_xlabel("weight xi (grey: the paper's)")


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
        residual = found.residual(theta)
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
