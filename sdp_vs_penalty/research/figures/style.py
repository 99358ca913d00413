"""How figures look: print size, the colour-blind-safe palette of Okabe and Ito, lines
that also differ in pattern, so that they survive a black-and-white printer."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.robot.arrays import Array

#: Okabe, Ito, "Color universal design" (2008).
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, RED, PURPLE, GREY = "#0072B2", "#D55E00", "#CC79A7", "#999999"

#: One look a role, the same in every figure. What is drawn first is thick, what comes
#: on top is thin or has gaps, each in another place, so that lines that coincide all
#: stay visible.
LOOKS: dict[str, dict[str, Any]] = {
    "measured": {"color": BLACK, "linewidth": 2.0},
    "model": {"color": "#bbbbbb", "linewidth": 3.5},
    "ols": {"color": ORANGE, "linewidth": 1.2},
    "lmi-sdp": {"color": SKY, "linewidth": 1.0},
    "penalty": {"color": RED, "linewidth": 0.9, "linestyle": (0, (4, 3))},
    "p_hat": {"color": GREEN, "linewidth": 0.9, "linestyle": (0, (1, 1))},
    "delta": {"color": PURPLE, "linewidth": 0.9, "linestyle": (0, (6, 2, 1, 2))},
    "penalty, two-step": {"color": ORANGE, "linewidth": 0.9, "linestyle": (2, (4, 3))},
    "SDP": {"color": SKY, "linewidth": 1.2},
    "MuJoCo": {"color": BLUE, "linewidth": 1.3, "linestyle": (0, (5, 10))},
    "DART": {"color": ORANGE, "linewidth": 1.3, "linestyle": (5, (5, 10))},
    "ODE": {"color": GREEN, "linewidth": 1.3, "linestyle": (10, (5, 10))},
    "Bullet": {"color": PURPLE, "linewidth": 0.6},
}


def new_figure(
    rows: int, columns: int, height: float, **options: Any
) -> tuple[Any, Any]:
    """A figure of page width and its axes (rows, columns), with this package's
    settings."""
    import matplotlib.pyplot as plt

    plt.style.use(Path(__file__).with_name("paper.mplstyle"))
    # Full width of a two-column page [inch].
    return plt.subplots(rows, columns, figsize=(7.16, height), squeeze=False, **options)


def draw_torques(
    axes: Any,
    t: Array,
    known: Array,
    name: str,
    estimates: Mapping[str, Array],
    scale: float = 1.0,
) -> None:
    """A known torque (M, n) of each joint and estimates of it by method on the left
    axes (n, 2), what these are off, times ``scale``, on the right."""
    for j, (left, right) in enumerate(axes):
        left.plot(t, known[:, j], label=name, **LOOKS["measured"])
        for method, torque in estimates.items():
            left.plot(t, torque[:, j], label=method, **LOOKS[method])
            right.plot(t, scale * (torque - known)[:, j], label=method, **LOOKS[method])


def label_joints(axes: Any, units: Sequence[str], what: str) -> None:
    """Joint number and unit on the left of each row; time below the last row."""
    for j, unit in enumerate(units):
        axes[j, 0].set_ylabel(f"joint {j + 1}\n{what} [{plain_unit(unit)}]")
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    axes[0, 0].figure.align_ylabels(axes[:, 0])


def legend_below(figure: Any, axis: Any) -> None:
    """One legend for the whole figure, under the axes, each label once."""
    handles, labels = axis.get_legend_handles_labels()
    handle_by_label = dict(zip(labels, handles, strict=True))
    figure.legend(
        handle_by_label.values(),
        handle_by_label,
        loc="outside lower center",
        ncols=min(len(handle_by_label), 5),
    )
