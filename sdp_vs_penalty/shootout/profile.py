"""Performance profiles of Dolan and More (Math. Program. 2002), by class of problem and by accuracy.

For each solver the share of a class's problems that it brought to an accuracy, within a factor of the
fastest solver that did. A run counts by its figures, whatever it was asked for: objective error and
violation at most ten times the accuracy, and a claim of success; or infeasibility, rightly claimed.
"""

import importlib.util
import io
from pathlib import Path

import numpy as np
import pandas

from sdp_vs_penalty.files import write_bytes
from sdp_vs_penalty.shootout.judge import SLACK


def reached(runs: pandas.DataFrame, accuracy: float) -> pandas.Series:
    """Whether each run claims success rightly at this accuracy."""
    error = runs[["objective_error", "violation"]].max(axis=1)
    near = np.isfinite(runs["lower"]) & (error <= SLACK * accuracy)
    refuted = (runs["claimed"] == "infeasible") & (runs["class"] == "right")
    return refuted | (runs["claimed"] == "optimal") & near


def at_accuracy(runs: pandas.DataFrame, accuracy: float) -> pandas.DataFrame:
    """The runs asked for this accuracy, and those of contestants that cannot be asked."""
    return runs[(runs["settings"] == "default") | (runs["accuracy"] == accuracy)]


def accuracies(runs: pandas.DataFrame) -> list[float]:
    """What was asked for, loose to tight; 1e-8 where nobody could be asked."""
    asked = runs.loc[runs["settings"] != "default", "accuracy"].unique()
    return sorted(asked, reverse=True) or [1e-8]


def profile(runs: pandas.DataFrame, accuracy: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Of each solver (ratios, shares): the corners of its step."""
    asked, count = at_accuracy(runs, accuracy), runs["problem"].nunique()
    right = asked[reached(asked, accuracy)]
    seconds = right["seconds"].clip(lower=1e-6)
    ratio = seconds / seconds.groupby(right["problem"]).transform("min")
    steps = {s: np.sort(ratio[right["solver"] == s]) for s in sorted(asked["solver"].unique())}
    return {solver: (x, np.arange(1, len(x) + 1) / count) for solver, x in steps.items()}


def plot_profile(runs: pandas.DataFrame, path: Path, least: float = 0.8) -> bool:
    """SVG of the solvers that ran on this share of the problems at least, an accuracy a panel; False
    without matplotlib."""
    if importlib.util.find_spec("matplotlib") is None:
        return False
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    asked = accuracies(runs)
    alone = runs[~runs["solver"].str.endswith(" certified")]
    count = alone.groupby("solver")["problem"].nunique()
    shown = sorted(count.index[count >= least * count.max()])
    with plt.rc_context({"svg.hashsalt": "shootout", "font.size": 9}):
        size = (3.2 * len(asked) + 1.6, 3.4)
        figure, axes = plt.subplots(1, len(asked), figsize=size, sharey=True, layout="constrained")
        for panel, accuracy in zip(np.atleast_1d(axes), asked, strict=True):
            curves = profile(runs, accuracy)
            for k, solver in enumerate(shown):
                ratios, shares = curves.get(solver, (np.zeros(0), np.zeros(0)))
                ends = np.append(ratios, 1e5), np.append(shares, shares[-1:] if len(shares) else 0.0)
                style = {"color": f"C{k % 10}", "linestyle": "-" if k < 10 else "--"}
                width = 2.2 if solver == "lmi-sdp" else 1.2
                panel.step(*ends, where="post", label=solver, linewidth=width, **style)
            panel.set(xscale="log", xlim=(0.9, 1e4), ylim=(0.0, 1.03), title=f"{accuracy:.0e}")
            panel.set_xlabel("time over the fastest that was right")
            panel.grid(alpha=0.3)
        np.atleast_1d(axes)[0].set_ylabel("share of problems got right")
        handles = np.atleast_1d(axes)[0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside right upper", frameon=False)
        file = io.BytesIO()
        figure.savefig(file, format="svg", metadata={"Date": None})
        plt.close(figure)
    write_bytes(path, file.getvalue())
    return True
