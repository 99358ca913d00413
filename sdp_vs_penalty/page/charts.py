"""The page's charts as what plotly's script takes; the figures are those of the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sdp_vs_penalty.plots import Curves, ladder_figure, styled, torque_figure


def torque_chart(
    runs: Sequence[Curves], joint: int, units: Sequence[str], narrow: bool
) -> dict[str, Any]:
    """Measured and modelled torque of one joint (from 0), and below it what is left."""
    plot = torque_figure(runs, [joint], units, beside=False)
    return _ready(styled(plot, 380 if narrow else 420), narrow)


def ladder_chart(
    names: Sequence[str], rmse: Sequence[Sequence[float]], units: Sequence[str], narrow: bool
) -> dict[str, Any]:
    """The error of every joint from model to model."""
    plot = ladder_figure([f"{k}" for k in range(1, len(names) + 1)], rmse, units)
    plot.update_xaxes(title_text="model", type="category")
    return _ready(styled(plot, 320 if narrow else 360), narrow)


def merged(first: Sequence[Curves], last: Sequence[Curves]) -> list[Curves]:
    """The same runs with the curves of two models."""
    return [
        Curves(a.t, a.torque, {**a.modelled, **b.modelled}) for a, b in zip(first, last, strict=True)
    ]


def _ready(plot: Any, narrow: bool) -> dict[str, Any]:
    """Plain lists; on a narrow screen a finger scrolls the page and not the chart."""
    plot.update_layout(margin={"l": 58, "r": 8, "t": 34, "b": 42}, dragmode=False if narrow else "zoom")
    plot.update_yaxes(fixedrange=True)
    plot.update_xaxes(fixedrange=narrow)
    data = plot.to_dict()
    for trace, made in zip(data["data"], plot.data, strict=True):
        for axis in ("x", "y"):
            values = made[axis]
            trace[axis] = [v if isinstance(v, str) else float(f"{v:.6g}") for v in values]
    data["layout"].pop("template", None)
    data["config"] = {"displayModeBar": False, "responsive": True}
    return data
