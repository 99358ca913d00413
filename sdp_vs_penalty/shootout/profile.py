"""Performance profiles of Dolan and More (Math. Program. 2002), by class of problem and by accuracy.

For each solver the share of a class's problems that it brought to an accuracy, within a factor of the
fastest solver that did. A run counts by its figures, whatever it was asked for: objective error and
violation at most ten times the accuracy, and a claim of success; or infeasibility, rightly claimed.
"""

from __future__ import annotations

import importlib.util
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sdp_vs_penalty.files import write_bytes
from sdp_vs_penalty.shootout.judge import SLACK
from sdp_vs_penalty.shootout.results import Row


def reached(row: Row, accuracy: float) -> bool:
    """Whether a run claims success rightly at this accuracy."""
    if row["claimed"] != "optimal":
        return bool(row["claimed"] == "infeasible" and row["class"] == "right")
    if not np.isfinite(row["lower"]):
        return False
    return bool(max(row["objective_error"], row["violation"]) <= SLACK * accuracy)


def at_accuracy(rows: Sequence[Row], accuracy: float) -> list[Row]:
    """The runs asked for this accuracy, and those of contestants that cannot be asked."""
    return [r for r in rows if r["settings"] == "default" or r["accuracy"] == accuracy]


def accuracies(rows: Sequence[Row]) -> list[float]:
    """What was asked for, loose to tight."""
    return sorted({r["accuracy"] for r in rows if r["settings"] != "default"}, reverse=True)


def profile(rows: Sequence[Row], accuracy: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Of each solver (ratios, shares): the corners of its step."""
    asked, count = at_accuracy(rows, accuracy), len({r["problem"] for r in rows})
    right = [(r["solver"], r["problem"], max(r["seconds"], 1e-6)) for r in asked if reached(r, accuracy)]
    best: dict[str, float] = {}
    for _, problem, seconds in right:
        best[problem] = min(seconds, best.get(problem, np.inf))
    out = {}
    for solver in sorted({r["solver"] for r in asked}):
        ratios = np.sort([seconds / best[p] for name, p, seconds in right if name == solver])
        out[solver] = ratios, np.arange(1, len(ratios) + 1) / count
    return out


def plot_profile(rows: Sequence[Row], path: Path, least: float = 0.8) -> bool:
    """SVG of the solvers that ran on this share of the problems at least, an accuracy a panel; False
    without matplotlib."""
    if importlib.util.find_spec("matplotlib") is None:
        return False
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    asked = accuracies(rows) or [1e-8]
    ran = {(r["solver"], r["problem"]) for r in rows if not r["solver"].endswith(" certified")}
    count = Counter(solver for solver, _ in ran)
    shown = sorted(s for s, k in count.items() if k >= least * max(count.values()))
    with plt.rc_context({"svg.hashsalt": "shootout", "font.size": 9}):
        size = (3.2 * len(asked) + 1.6, 3.4)
        figure, axes = plt.subplots(1, len(asked), figsize=size, sharey=True, layout="constrained")
        for panel, accuracy in zip(np.atleast_1d(axes), asked, strict=True):
            curves = profile(rows, accuracy)
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
