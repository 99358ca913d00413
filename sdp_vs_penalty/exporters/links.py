"""A model's links as a table, as command line, page and report show them."""

import numpy as np

from sdp_vs_penalty.estimation.constants import ROUNDING
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.formatting import number
from sdp_vs_penalty.robot import inertia

LINK_HEADS = (
    "link", "mass [kg]", "nominal", "from", "centre of mass [m]", "gyration [m]", "nominal",
    "thickness [mm]",
)  # fmt: skip


def link_rows(estimate: Estimate) -> list[tuple[str, ...]]:
    """Mass, centre of mass and radius of gyration of each link beside the nominal ones, as text."""
    at = estimate.model.rigid_indices
    if not len(at):
        return []
    links, nominal = estimate.links, estimate.nominal[at].reshape(-1, 10)
    robot, thick = estimate.robot, inertia.thickness(links)
    gyration = inertia.gyration(links), inertia.gyration(nominal)
    rows = []
    for i, link in enumerate(links):
        com = link[1:4] / link[0] if link[0] > 0.0 else np.full(3, np.nan)
        rows.append(
            (
                f"{i + 1} ({robot.tree[robot.link_joints[i]].name})",
                number(link[0], 4),
                number(nominal[i, 0], 4),
                estimate.sources[at[10 * i]],
                ", ".join(number(seen(c)) for c in com),
                *(number(g[i]) for g in gyration),
                number(1e3 * thick[i]),
            )
        )
    return rows


def seen(value: float | None) -> float | None:
    """Zero for what rounding alone keeps from it."""
    return 0.0 if value is not None and abs(value) < ROUNDING else value
