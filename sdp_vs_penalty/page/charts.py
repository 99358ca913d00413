"""The page's charts as what plotly's script takes; the figures are those of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.report.plots import (
    SIGNALS,
    Curves,
    band_figure,
    friction_figure,
    ladder_figure,
    residual_figure,
    styled,
    torque_figure,
)


def torque_chart(
    run: Curves,
    joint: int,
    units: Sequence[str],
    span: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """Measured and modelled torque of one joint (from 0), and below it what is left.

    span : the seconds to look at; a long run shows more detail there.
    """
    edge = 0.0 if span is None else 0.25 * (span[1] - span[0])  # so that curves leave the picture
    wider = None if span is None else (span[0] - edge, span[1] + edge)
    plot = torque_figure([run], [joint], units, beside=False, span=wider)
    if span is not None:
        plot.update_xaxes(range=list(span))
    return _ready(styled(plot, 420))


def asked_span(event: Any) -> tuple[float, float] | bool | None:
    """What a plotly_relayout event asks for: a stretch of time, everything (None), or neither (False).

    >>> asked_span({"xaxis2.range[0]": 1, "xaxis2.range[1]": 2.5})
    (1.0, 2.5)
    """
    if not isinstance(event, dict):
        return False
    for axis in ("xaxis", "xaxis2"):
        if event.get(f"{axis}.autorange"):
            return None
        ends = [event.get(f"{axis}.range[{k}]") for k in (0, 1)]
        if all(isinstance(end, int | float) for end in ends):
            low, high = (float(end) for end in ends if end is not None)
            return low, high
    return False


def ladder_chart(
    names: Sequence[str],
    rmse: Sequence[Sequence[float]],
    units: Sequence[str],
    floor: Sequence[float | None],
) -> dict[str, Any]:
    """The error of every joint from model to model, over its noise where that is known of all."""
    numbers, known = [f"{k}" for k in range(1, len(names) + 1)], [f for f in floor if f]
    if len(known) == len(units):
        over = [[e / f for e, f in zip(errors, known, strict=True)] for errors in rmse]
        plot = ladder_figure(numbers, over, ["noise floors"] * len(units))
        plot.update_yaxes(title_text="RMS error / noise floor").add_hline(1.0, line_dash="dot")
    else:
        plot = ladder_figure(numbers, rmse, units)
    plot.update_traces(line_shape="hvh")
    plot.update_xaxes(title_text="model", type="category")
    return _ready(styled(plot, 360))


def friction_chart(curve: Mapping[str, Any], joint: int, unit: str) -> dict[str, Any]:
    """Friction of a joint (from 0) over its velocity; curve : velocity, torque, half."""
    return _ready(styled(friction_figure(**curve, joint=joint, unit=unit), 300))


def missing_chart(curve: Curve, units: Sequence[str]) -> dict[str, Any]:
    """A measured curve of one variable with its band."""
    plot = band_figure(curve.x, curve.torque, curve.lower, curve.upper)
    plot.update_xaxes(title_text=curve.of[0])
    plot.update_yaxes(title_text=f"joint {curve.joint} [{units[curve.joint - 1]}]")
    return _ready(styled(plot, 260))


def residual_chart(
    read: Mapping[str, Any], joint: int, signal: str, unit: str, floor: float | None
) -> dict[str, Any]:
    """What is left of one joint's torque against one of SIGNALS."""
    x = read[signal] if signal == "t" else read[signal][:, joint]
    left, dq = read["torque"][:, joint] - read["modelled"][:, joint], read["dq"][:, joint]
    plot = residual_figure(x, left, dq, floor)
    plot.update_xaxes(title_text=SIGNALS[signal])
    plot.update_yaxes(title_text=f"error of joint {joint + 1} [{unit}]")
    return _ready(styled(plot, 320))


def merged(first: Curves, last: Curves) -> Curves:
    """The same run with the curves of two models."""
    return Curves(first.t, first.torque, {**first.modelled, **last.modelled})


def _ready(plot: Any) -> dict[str, Any]:
    """Plain lists; to be zoomed in time only."""
    plot.update_layout(margin={"l": 58, "r": 8, "t": 34, "b": 42}, dragmode="zoom")
    plot.update_yaxes(fixedrange=True)
    data = plot.to_dict()
    for trace, made in zip(data["data"], plot.data, strict=True):
        for axis in ("x", "y"):
            values = made[axis]
            trace[axis] = [v if isinstance(v, str) else float(f"{v:.6g}") for v in values]
    data["layout"].pop("template", None)
    data["config"] = {"displayModeBar": False, "responsive": True}
    return data
