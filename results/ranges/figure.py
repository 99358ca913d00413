"""A bar a link: between which masses the Panda's links can lie, and what was published.

python results/ranges/figure.py [--out ranges.svg]
"""

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
matplotlib.rcParams["svg.hashsalt"] = "ranges"
import matplotlib.pyplot as plt
import numpy as np

from sdp_vs_penalty import find_ranges, identify
from sdp_vs_penalty.problem import measured_runs

HERE = Path(__file__).parent


def main() -> None:
    """Draw the figure of the Panda's measured run."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path, default=HERE / "ranges.svg")
    given = parser.parse_args()
    (run,) = measured_runs("panda").values()
    model = identify("panda", run, check=False)
    penalty = identify("panda", run, "penalty", check=False)
    found = find_ranges(model, kinds=["consistency"]).ranges[:7]
    published = {row["parameter"]: row for row in model.problem.published["table_VIII"]}
    _, axes = plt.subplots(figsize=(7.0, 3.2), layout="constrained")
    most = 11.0
    for k, r in enumerate(found):
        low, high = np.clip(r.under["consistency"], 0.0, most)
        axes.barh(k, high - low, left=low, height=0.6, color="#d8dee6", zorder=1)
        width = min(r.greatest.value, most) - r.least.value
        axes.barh(k, width, left=r.least.value, height=0.6, color="#8fb3d9", zorder=2)
    marks = {
        "published, p_hat": (
            "k",
            "D",
            [float(published[r.name]["p_hat"]) for r in found],
        ),
        "published, delta": (
            "k",
            "x",
            [float(published[r.name]["delta"]) for r in found],
        ),
        "our SDP": ("#1a5fb4", "o", model.links[:, 0]),
        "our penalty": ("#c64600", "s", penalty.links[:, 0]),
        "nominal": ("#777777", "|", [r.nominal for r in found]),
    }
    for label, (color, marker, masses) in marks.items():
        axes.scatter(
            masses, range(7), c=color, marker=marker, s=28, label=label, zorder=3
        )
    axes.set(yticks=range(7), yticklabels=[f"link {k + 1}" for k in range(7)])
    axes.set(xlabel="mass [kg]", xlim=(-0.2, most))
    axes.invert_yaxis()
    axes.legend(loc="lower right", fontsize=8)
    axes.set_title(
        "Mass that data and constraints (dark), data and consistency alone (light) allow",
        fontsize=9,
    )
    plt.savefig(given.out, metadata={"Date": None})


if __name__ == "__main__":
    main()
