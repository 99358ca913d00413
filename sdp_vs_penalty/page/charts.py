"""The page's charts as what plotly's script takes; the figures are those of the report."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.reports.figure import Figure, trace
from sdp_vs_penalty.reports.pictures import shades
from sdp_vs_penalty.reports.plots import (
    COLOURS,
    Curves,
    missing_figure,
    residual_figure,
    signal_title,
    styled,
    torque_figure,
)


def torque_chart(
    run: Curves,
    joint: int,
    units: Sequence[str],
    span: tuple[float, float] | None = None,
    stretches: Sequence[tuple[float, float, str]] = (),
) -> dict[str, Any]:
    """Measured and modelled torque of one joint (from 0), and below it what is left.

    span : the seconds to look at; a long run shows more detail there; stretches : where the error is
    large, by cause.
    """
    t, cut = run.t - run.t[0], slice(None)
    if span is not None:
        edge = 0.25 * (span[1] - span[0])  # so that curves leave the picture
        low, high = np.searchsorted(t, (span[0] - edge, span[1] + edge))
        cut = slice(min(low, len(t) - 1), max(high, low + 1))
    part = Curves(t[cut], run.torque[cut], {name: m[cut] for name, m in run.modelled.items()})
    plot = torque_figure([part], joint, units[joint], False, float(t[cut][0]))
    plot.update_layout(shapes=shades(stretches, ("x", "x2")))
    if span is not None:
        plot.update_axes("x", range=list(span))
    return ready(plot, 420)


def data_chart(read: Mapping[str, Any], units: Sequence[str]) -> dict[str, Any]:
    """Positions, velocities and torques of all joints on one time axis; what the check would put in
    place of a measured value, as crosses."""
    shown = ["q", "dq", *["torque"] * bool(np.any(read["torque"]))]  # a log may hold none
    plot = Figure(rows=len(shown), gap=0.04)
    t = read["t"] - read["t"][0]
    for row, name in enumerate(shown):
        for j in range(len(units)):
            colour, named = COLOURS[j % len(COLOURS)], {"name": f"joint {j + 1}", "legendgroup": f"{j}"}
            look: dict[str, Any] = {"line": {"color": colour, "width": 1.2}, "showlegend": row == 0}
            plot.add(trace("scatter", x=t, y=read[name][:, j], **look, **named), row)
            there = read.get(f"repaired_{name}")
            if there is None or not (rows := np.isfinite(there[:, j])).any():
                continue
            named["name"] += ", repaired"
            look = {"marker": {"symbol": "x", "size": 5, "color": colour}, "showlegend": False}
            look["mode"] = "markers"
            plot.add(trace("scatter", x=t[rows], y=there[rows, j], **look, **named), row)
    kinds = "/".join(dict.fromkeys("m" if unit == "N" else "rad" for unit in units))
    torques = "/".join(dict.fromkeys(units))
    titles = (f"q [{kinds}]", f"dq [{kinds}/s]", f"tau [{torques}]")
    for row, said in enumerate(titles[: len(shown)]):
        plot.update_axes("y", row, title=said)
    plot.update_axes("x", len(shown) - 1, title="time [s]")
    return ready(plot, 460)


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


def missing_chart(curve: Curve, units: Sequence[str], read: Mapping[str, Any]) -> dict[str, Any]:
    """A measured curve with its band, and where the rows of a recording lie."""
    motion = Motion(read["t"], read["q"], read["dq"], read["ddq"], read["modelled"])
    warm = any(v.startswith("temp") for v in curve.of)  # a recording holds none
    return ready(missing_figure(curve, units, [] if warm else [motion]), 260)


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
    *first, last = ((r["torque"][:, joint] - r["modelled"][:, joint])[cut] for r in reads)
    plot = residual_figure(x, last, read["dq"][cut, joint], floor, *first)
    plot.update_axes("x", title=signal_title(signal, unit))
    plot.update_axes("y", title=f"error of joint {joint + 1} [{unit}]")
    return ready(plot, 320)


def ready(plot: Figure, height: int) -> dict[str, Any]:
    """Plain JSON; to be zoomed in time only."""
    styled(plot, height).update_layout(margin={"l": 66, "r": 8, "t": 34, "b": 42}, dragmode="zoom")
    data: dict[str, Any] = json.loads(plot.update_axes("y", fixedrange=True).to_json())
    return {**data, "config": {"displayModeBar": False, "responsive": True}}
