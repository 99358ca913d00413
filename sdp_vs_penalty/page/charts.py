"""The page's charts as what plotly's script takes; the figures are those of the report."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.effects.curve_variable import Variable
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.reports.figure import Figure, trace
from sdp_vs_penalty.reports.pictures import shades
from sdp_vs_penalty.reports.plots import (
    COLOURS,
    Curves,
    envelope,
    friction_figure,
    missing_figure,
    residual_figure,
    scatter_rows,
    signal_title,
    styled,
    torque_figure,
)
from sdp_vs_penalty.robot.arrays import Array


def torque_chart(
    run: Curves,
    joint: int,
    units: Sequence[str],
    span: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """Measured and modelled torque of one joint (from 0), and below it what is left.

    span : the seconds to look at; a long run shows more detail there.
    """
    t, unit, cut = run.t - run.t[0], units[joint], slice(None)
    ranges = {}
    if span is not None:
        edge = 0.25 * (span[1] - span[0])  # so that curves leave the picture
        cut = slice(*np.searchsorted(t, (span[0] - edge, span[1] + edge)))
        ranges = {"range": list(span)}
    measured = run.torque[cut, joint]
    both = [(m[cut, joint], measured - m[cut, joint]) for m in run.modelled.values()]
    values = [envelope(t[cut], y) for y in (measured, *(y for pair in both for y in pair))]
    axes = {"xaxis": ranges, "xaxis2": ranges}
    axes |= {"yaxis": _title(f"joint {joint + 1} [{unit}]"), "yaxis2": _title(f"left [{unit}]")}
    return _filled(_torque_frame(tuple(run.modelled)), values, axes)


def data_chart(read: Mapping[str, Any], units: Sequence[str]) -> dict[str, Any]:
    """Positions, velocities and torques of all joints on one time axis; what the check would put in
    place of a measured value, as crosses."""
    shown = ["q", "dq", *["torque"] * bool(np.any(read["torque"]))]  # a log may hold none
    plot = Figure(rows=len(shown), gap=0.04)
    t = read["t"] - read["t"][0]
    for row, name in enumerate(shown):
        for j in range(len(units)):
            line = {"color": COLOURS[j % len(COLOURS)], "width": 1.2}
            named = {"name": f"joint {j + 1}", "legendgroup": f"{j}", "showlegend": row == 0}
            plot.add(trace("scatter", x=t, y=read[name][:, j], line=line, **named), row)
            there = read.get(f"repaired_{name}")
            if there is None or not (rows := np.isfinite(there[:, j])).any():
                continue
            cross: dict[str, Any] = {"mode": "markers", "name": f"joint {j + 1}, repaired"}
            cross["marker"] = {"symbol": "x", "size": 5, "color": COLOURS[j % len(COLOURS)]}
            plot.add(trace("scatter", x=t[rows], y=there[rows, j], legendgroup=f"{j}", **cross), row)
    kinds = "/".join(dict.fromkeys("m" if unit == "N" else "rad" for unit in units))
    torques = "/".join(dict.fromkeys(units))
    titles = (f"q [{kinds}]", f"dq [{kinds}/s]", f"tau [{torques}]")
    for row, said in enumerate(titles[: len(shown)]):
        plot.update_axes("y", row, title=said)
    plot.update_axes("x", len(shown) - 1, title="time [s]")
    return _ready(styled(plot, 460))


def with_shades(made: dict[str, Any], stretches: Sequence[tuple[float, float, str]]) -> dict[str, Any]:
    """A torque chart with the stretches in which the error is large, by cause."""
    return {**made, "layout": {**made["layout"], "shapes": shades(stretches, ("x", "x2"))}}


@lru_cache(32)
def _torque_frame(names: tuple[str, ...]) -> dict[str, Any]:
    zeros = np.zeros((2, 1))
    run = Curves(np.zeros(2), zeros, dict.fromkeys(names, zeros))
    return _ready(styled(torque_figure([run], 0, "", beside=False), 420))


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


def friction_chart(curve: Mapping[str, Any], joint: int, unit: str) -> dict[str, Any]:
    """Friction of a joint (from 0) over its velocity; curve : velocity, torque, half."""
    v, torque, half = (np.asarray(curve[name]) for name in ("velocity", "torque", "half"))
    values = [(v, torque + half), (v, torque - half), (v, torque)]
    return _filled(_friction_frame(unit), values, {"yaxis": _title(f"joint {joint + 1} [{unit}]")})


@lru_cache(8)
def _friction_frame(unit: str) -> dict[str, Any]:
    return _ready(styled(friction_figure([0.0], [0.0], [0.0], 0, unit), 300))


def missing_chart(curve: Curve, units: Sequence[str], read: Mapping[str, Any]) -> dict[str, Any]:
    """A measured curve with its band, and where the rows of a recording lie."""
    over = [Variable.parse(v) for v in curve.of]
    along = []
    if all(v.word != "temp" for v in over):  # a recording holds none
        motion = Motion(read["t"], read["q"], read["dq"], read["ddq"], read["modelled"])
        along = [v.along(motion) for v in over]
    return _ready(styled(missing_figure(curve, units, along), 260))


def residual_chart(
    reads: Sequence[Mapping[str, Any]],
    joint: int,
    signal: str,
    unit: str,
    floor: float | None,
    span: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """What one or two models leave of a joint's torque against one of SIGNALS, the last one's reversals
    ringed; span : only these seconds of the run."""
    read = reads[-1]
    t = read["t"] - read["t"][0]
    cut = slice(None) if span is None else slice(*np.searchsorted(t, span))
    if len(t[cut]) < 2:
        cut = slice(None)
    x = np.asarray(t if signal == "t" else read[signal][:, joint])[cut]
    lefts = [_error(r, joint)[cut] for r in reads]
    keep, turns = scatter_rows(read["dq"][cut, joint])
    values = [(x[keep], left[keep]) for left in lefts] + [(x[turns], lefts[-1][turns])]
    title = f"error of joint {joint + 1} [{unit}]"
    axes = {"xaxis": _title(signal_title(signal, unit)), "yaxis": _title(title)}
    return _filled(_residual_frame(floor, len(reads) > 1), values, axes)


def _error(read: Mapping[str, Any], joint: int) -> Array:
    return np.asarray(read["torque"][:, joint] - read["modelled"][:, joint])


@lru_cache(32)
def _residual_frame(floor: float | None, two: bool) -> dict[str, Any]:
    zeros = np.zeros(2)
    plot = residual_figure(zeros, zeros, zeros, floor, zeros if two else None)
    return _ready(styled(plot, 320))


def merged(first: Curves, last: Curves) -> Curves:
    """The same run with the curves of two models."""
    return Curves(first.t, first.torque, {**first.modelled, **last.modelled})


def _title(text: str) -> dict[str, Any]:
    return {"title": {"text": text}}


def _filled(
    frame: dict[str, Any], values: Iterable[tuple[Array, Array]], axes: Mapping[str, dict[str, Any]]
) -> dict[str, Any]:
    """A chart with other curves and axes: plotly's objects take twenty times as long as its data."""
    layout = {
        **frame["layout"],
        **{name: {**frame["layout"][name], **axis} for name, axis in axes.items()},
    }
    data = [
        {**trace, "x": _short(x), "y": _short(y)}
        for trace, (x, y) in zip(frame["data"], values, strict=True)
    ]
    return {**frame, "layout": layout, "data": data}


def _short(values: ArrayLike) -> list[float]:
    """Six significant digits of each.

    >>> _short([0.12345678, -3e-9, 0.0])
    [0.123457, -3e-09, 0.0]
    """
    x = np.asarray(values, float)
    with np.errstate(divide="ignore"):
        size = np.floor(np.log10(np.abs(x)))
    scale = 10.0 ** np.where(np.isfinite(size), 5.0 - size, 0.0).clip(-300.0, 300.0)
    return (np.round(x * scale) / scale).tolist()


def _ready(plot: Figure) -> dict[str, Any]:
    """Plain lists; to be zoomed in time only."""
    plot.update_layout(margin={"l": 58, "r": 8, "t": 34, "b": 42}, dragmode="zoom")
    plot.update_axes("y", fixedrange=True)
    for made in plot.data:
        for axis in {"x", "y"} & made.keys():
            values = made[axis]
            words = len(values) > 0 and isinstance(values[0], str)
            made[axis] = list(values) if words else _short(values)
    data: dict[str, Any] = json.loads(plot.to_json())
    return {**data, "config": {"displayModeBar": False, "responsive": True}}
