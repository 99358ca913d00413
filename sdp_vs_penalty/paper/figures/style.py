"""How figures look: print size, the colour-blind-safe palette of Okabe and Ito, lines
that also differ in pattern, so that they survive a black-and-white printer."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sdp_vs_penalty.colours import PALETTE
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.robot.arrays import Array

BLUE, RED, GREEN, PURPLE, ORANGE, SKY, _ = PALETTE
BLACK, GREY = "#000000", "#999999"

#: Resolution of PNG files [dots per inch].
DPI = 200
#: Full width of a two-column page [inch].
PAGE_WIDTH = 7.16
_PENALTY_LOOK = {"color": RED, "linewidth": 0.9, "linestyle": (0, (4, 3))}
_P_HAT_LOOK = {"color": GREEN, "linewidth": 0.9, "linestyle": (0, (1, 1))}
_DELTA_LOOK = {"color": PURPLE, "linewidth": 0.9, "linestyle": (0, (6, 2, 1, 2))}
#: One look a role, the same in every figure. What is drawn first is thick, what comes
#: on top is thin or has gaps, each in another place, so that lines that coincide all
#: stay visible.
LOOKS: dict[str, dict[str, Any]] = {
    "measured": {"color": BLACK, "linewidth": 2.0},
    "model": {"color": "#bbbbbb", "linewidth": 3.5},
    "ols": {"color": ORANGE, "linewidth": 1.2},
    "lmi-sdp": {"color": SKY, "linewidth": 1.0},
    "penalty": _PENALTY_LOOK,
    "p_hat (published links)": _P_HAT_LOOK,
    "delta (published links)": _DELTA_LOOK,
    "penalty, one-step": _PENALTY_LOOK,
    "penalty, two-step": {"color": ORANGE, "linewidth": 0.9, "linestyle": (2, (4, 3))},
    "SDP": {"color": SKY, "linewidth": 1.2},
    "MuJoCo": {"color": BLUE, "linewidth": 1.3, "linestyle": (0, (5, 10))},
    "DART": {"color": ORANGE, "linewidth": 1.3, "linestyle": (5, (5, 10))},
    "ODE": {"color": GREEN, "linewidth": 1.3, "linestyle": (10, (5, 10))},
    "Bullet": {"color": PURPLE, "linewidth": 0.6},
}


def new_figure(
    rows: int, columns: int, height: float, width: float = PAGE_WIDTH, **options: Any
) -> tuple[Any, Any]:
    """Make an empty figure in the paper's style.

    Parameters
    ----------
    height, width : float
        Size of the figure [inch].

    Returns
    -------
    figure : Figure
    axes : (rows, columns) array of Axes
    """
    import matplotlib.pyplot as plt

    plt.style.use(Path(__file__).with_name("paper.mplstyle"))
    size = (width, height)
    return plt.subplots(
        rows, columns, figsize=size, layout="constrained", squeeze=False, **options
    )


def draw_torques(
    axes: Any,
    t: Array,
    known: Array,
    name: str,
    estimates: Mapping[str, Array],
    scale: float = 1.0,
) -> None:
    """Draw torques at instants t (M,) [s] on the left axes and their errors on the
    right ones.

    Parameters
    ----------
    axes : (n, 2) array of Axes
        One row for each joint.
    known : (M, n) array
        The torque that is estimated [N m, N].
    name : str
        How the legend calls it.
    estimates : mapping of str to (M, n) array
        Estimated torques by method [N m, N].
    scale : float
        What errors are multiplied by.
    """
    for j, (left, right) in enumerate(axes):
        left.plot(t, known[:, j], label=name, **LOOKS["measured"])
        for method, torque in estimates.items():
            look = LOOKS[method]
            error = scale * (torque - known)[:, j]
            left.plot(t, torque[:, j], label=method, **look)
            right.plot(t, error, label=method, **look)


def label_joints(axes: Any, units: Sequence[str], what: str) -> None:
    """Write joint number and unit left of each row, and time below the last row.

    Parameters
    ----------
    axes : (n, k) array of Axes
        One row for each joint.
    units : sequence of str
        Unit of each joint's quantity.
    """
    for j, unit in enumerate(units):
        axes[j, 0].set_ylabel(f"joint {j + 1}\n{what} [{plain_unit(unit)}]")
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")


def legend_below(
    figure: Any, axis: Any, n_columns: int = 5, handle_length: float = 2.5
) -> None:
    """Put one legend below all axes; each label appears once.

    Parameters
    ----------
    axis : Axes
        The axes whose lines it names.
    n_columns : int
        Largest number of labels in a row.
    handle_length : float
        Length of the lines in the legend [font sizes].
    """
    handles, labels = axis.get_legend_handles_labels()
    handle_by_label = dict(zip(labels, handles, strict=True))
    figure.legend(
        handle_by_label.values(),
        handle_by_label,
        loc="outside lower center",
        ncols=min(len(handle_by_label), n_columns),
        handlelength=handle_length,
    )
