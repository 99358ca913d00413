"""What an estimate shows of itself: its parameters as text, as a table, as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sdp_vs_penalty import show
from sdp_vs_penalty.effects.effect import Parameter
from sdp_vs_penalty.robot.arrays import Array


def parameter_rows(
    parameters: Sequence[Parameter], theta: Array, std: Array, nominal: Array, sources: Sequence[str]
) -> list[tuple[str, ...]]:
    """Name, value with its standard deviation, nominal value, who says so, unit and effect of each."""
    rows: list[tuple[str, ...]] = []
    for p, value, spread, known, source in zip(parameters, theta, std, nominal, sources, strict=True):
        plus = "" if np.isnan(spread) else f" ± {spread:.1g}"
        before = "" if np.isnan(known) else f"{known:.4g}"
        rows.append((p.name, f"{value:.4g}{plus}", before, source, p.unit, p.effect))
    return rows


def plot_parameters(parameters: Sequence[Parameter], theta: Array, std: Array, axes: Any) -> Any:
    """One panel an effect (of the rigid body the masses), a bar a parameter, two standard deviations."""
    shown: dict[str, list[int]] = {}
    for k, p in enumerate(parameters):
        if p.effect != "rigid_body" or p.name.removeprefix("m").isdigit():
            shown.setdefault(p.effect, []).append(k)
    panels = np.atleast_1d(
        show.axes(axes, 1, len(shown), figsize=(3.0 * len(shown), 2.6), layout="constrained")
    )
    for panel, (effect, indices) in zip(panels, shown.items(), strict=False):
        names = [parameters[k].name for k in indices]
        spread = 2.0 * np.nan_to_num(std[indices])
        panel.bar(names, theta[indices], yerr=spread, capsize=2)
        panel.set(title=effect, ylabel=f"[{parameters[indices[0]].unit}]")
        panel.tick_params(axis="x", labelrotation=90)
    return panels
