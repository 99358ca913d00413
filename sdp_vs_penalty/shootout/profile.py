"""Performance profiles of Dolan and More (Math. Program. 2002), by class of problem and by accuracy.

For each solver the share of a class's problems that it brought to an accuracy, within a factor of the
fastest solver that did. A run counts by its figures, whatever it was asked for: objective error and
violation at most ten times the accuracy, and a claim of success; or infeasibility, rightly claimed.
"""

from __future__ import annotations

import importlib.util
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.files import write_bytes
from sdp_vs_penalty.shootout.judge import SLACK
from sdp_vs_penalty.shootout.results import Row

#: Solvers in the figure: those that were right most often.
_CURVES = 11


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
    asked = at_accuracy(rows, accuracy)
    problems = sorted({r["problem"] for r in rows})
    solvers = sorted({r["solver"] for r in asked})
    seconds = np.full((len(problems), len(solvers)), np.inf)
    for r in asked:
        if reached(r, accuracy):
            seconds[problems.index(r["problem"]), solvers.index(r["solver"])] = max(r["seconds"], 1e-6)
    best = seconds.min(axis=1, initial=np.inf)
    solved = np.isfinite(best)
    out = {}
    for k, solver in enumerate(solvers):
        ratios = np.sort(seconds[solved, k] / best[solved])
        finite = np.isfinite(ratios)
        shares = np.arange(1, len(ratios) + 1) / max(len(problems), 1)
        out[solver] = (ratios[finite], shares[finite])
    return out


def plot_profile(rows: Sequence[Row], path: Path) -> bool:
    """SVG: standard problems above, ill-conditioned ones below, an accuracy a column.

    False where matplotlib (extra [plot]) is absent.
    """
    if importlib.util.find_spec("matplotlib") is None:
        return False
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    shown = _shown(rows)
    parts = {
        "standard": [r for r in rows if "ill-conditioned" not in r["group"]],
        "ill-conditioned": [r for r in rows if "ill-conditioned" in r["group"]],
    }
    parts = {name: part for name, part in parts.items() if part}
    columns = accuracies(rows) or [1e-8]
    with plt.rc_context({"svg.hashsalt": "shootout", "font.size": 9}):
        figure, axes = plt.subplots(
            len(parts), len(columns), figsize=(3.2 * len(columns) + 1.6, 2.8 * len(parts)),
            squeeze=False, sharex=True, sharey=True, layout="constrained",
        )  # fmt: skip
        for down, (name, part) in enumerate(parts.items()):
            for across, accuracy in enumerate(columns):
                panel = axes[down][across]
                curves = profile(part, accuracy)
                for solver, style in shown.items():
                    ratios, shares = curves.get(solver, (np.zeros(0), np.zeros(0)))
                    if len(ratios):
                        ends = np.append(ratios, 1e5), np.append(shares, shares[-1])
                        panel.step(*ends, where="post", label=solver, **style)
                panel.set_title(f"{name}, {accuracy:.0e}")
                panel.grid(alpha=0.3)
        axes[0][0].set(xscale="log", xlim=(0.9, 1e4), ylim=(0.0, 1.03))
        for panel in axes[-1]:
            panel.set_xlabel("time over the fastest that was right")
        for panel in axes[:, 0]:
            panel.set_ylabel("share of problems got right")
        named = {t: h for a in axes.flat for h, t in zip(*a.get_legend_handles_labels(), strict=True)}
        order = [solver for solver in shown if solver in named]
        figure.legend([named[s] for s in order], order, loc="outside right upper", frameon=False)
        file = io.BytesIO()
        figure.savefig(file, format="svg", metadata={"Date": None})
        plt.close(figure)
    write_bytes(path, file.getvalue())
    return True


def _shown(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """The solvers by themselves that get most right, best first, and how each is drawn."""
    right: dict[str, int] = {}
    for r in rows:
        if not r["solver"].endswith((" certified", " untuned")):
            right[r["solver"]] = right.get(r["solver"], 0) + reached(r, r["accuracy"])
    runs = {s: sum(r["solver"] == s for r in rows) for s in right}
    best = sorted(right, key=lambda s: (-right[s] / runs[s], s))[:_CURVES]
    ours = {"lmi-sdp": {"color": "black", "linewidth": 2.2, "zorder": 3}}
    styles = [{"color": f"C{k % 10}", "linestyle": "-" if k < 10 else "--"} for k in range(len(best))]
    return {s: ours.get(s, style) for s, style in zip(best, styles, strict=True)}
