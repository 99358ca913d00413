"""The page's charts, which are the report's figures."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sdp_vs_penalty.diagnosis.comparison import Signals
from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.diagnosis.findings import Finding
from sdp_vs_penalty.diagnosis.where_it_fails import Failures
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.page.model_step import ModelStep
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.render import charts as plots
from sdp_vs_penalty.render.charts import COLOURS, POINTS, Curves, Figure
from sdp_vs_penalty.render.pieces import shades
from sdp_vs_penalty.render.words import cause_of


def torque_chart(
    run: Curves,
    joint: int,
    units: Sequence[str],
    span: tuple[float, float] | None = None,
    stretches: Sequence[tuple[float, float, str]] = (),
) -> dict[str, Any]:
    """Measured and modelled torque of one joint (from 0), and below it what is left.

    span : the seconds to look at; a long run shows more detail there; stretches : where
    the error is large, by cause.
    """
    t = run.t - run.t[0]
    cut = slice(None)
    if span is not None:
        edge = 0.25 * (span[1] - span[0])  # so that curves leave the picture
        low, high = np.searchsorted(t, (span[0] - edge, span[1] + edge))
        cut = slice(min(low, len(t) - 1), max(high, low + 1))
    part = Curves(
        t[cut],
        run.torque[cut],
        {name: m[cut] for name, m in run.modelled.items()},
    )
    plot = plots.torque_figure(
        [part],
        joint,
        units[joint],
        side_by_side=False,
    )
    plot.update_layout(shapes=shades(stretches))
    if span is not None:
        plot.update_axes("x", range=list(span))
    return ready(plot, 420)


def data_chart(read: Mapping[str, Any], units: Sequence[str]) -> dict[str, Any]:
    """Positions, velocities and torques of all joints on one time axis; what the check
    would put in place of a measured value, as crosses."""
    shown = [
        "q",
        "dq",
        *["torque"] * bool(np.any(read["torque"])),
    ]  # a log may hold none
    plot = Figure(rows=len(shown), gap=0.08)
    t = read["t"] - read["t"][0]
    for row, name in enumerate(shown):
        for j in range(len(units)):
            colour = COLOURS[j % len(COLOURS)]
            named = {"name": f"joint {j + 1}", "legendgroup": f"{j}"}
            look: dict[str, Any] = {
                "line": {"color": colour, "width": 1.2},
                "showlegend": row == 0,
            }
            plot.add(
                "scatter",
                row,
                x=t,
                y=read[name][:, j],
                **look,
                **named,
            )
            there = read.get(f"repaired_{name}")
            if there is not None and (rows := np.isfinite(there[:, j])).any():
                named["name"] += ", repaired"
                look = {
                    "marker": {"symbol": "x", "size": 5, "color": colour},
                    "showlegend": False,
                }
                plot.add(
                    "scatter",
                    row,
                    x=t[rows],
                    y=there[rows, j],
                    mode="markers",
                    **look,
                    **named,
                )
        if (span := _span_without_spikes(read, name)) is not None:
            plot.update_axes("y", row, range=span)
    kinds = "/".join(dict.fromkeys("m" if unit == "N" else "rad" for unit in units))
    titles = (
        f"q [{kinds}]",
        f"dq [{kinds}/s]",
        f"tau [{'/'.join(dict.fromkeys(units))}]",
    )
    for row, title in enumerate(titles[: len(shown)]):
        plot.update_axes("y", row, title=title)
    plot.update_axes("x", len(shown) - 1, title="time [s]")
    return ready(plot, 460)


#: Spikes that make an axis so many times longer than all else leave the picture.
_SPIKE = 3.0


def _span_without_spikes(read: Mapping[str, Any], name: str) -> list[float] | None:
    """The range of an axis where the check's repair makes it much shorter: what is
    repaired, such as spikes, would press all else into a line. None: it stays."""
    repaired = read.get(f"repaired_{name}")
    if repaired is None or not np.isfinite(repaired).any():
        return None
    raw = np.asarray(read[name])
    mended = np.where(np.isfinite(repaired), repaired, raw)
    low = float(np.nanmin(mended))
    high = float(np.nanmax(mended))
    room = 0.1 * (high - low)
    if not 0.0 < _SPIKE * (high - low) < float(np.nanmax(raw) - np.nanmin(raw)):
        return None
    return [low - room, high + room]


def asked_span(event: Any) -> tuple[float, float] | bool | None:
    """What a plotly_relayout event asks for: a stretch of time, everything (None), or
    neither (False).

    >>> asked_span({"xaxis2.range[0]": 1, "xaxis2.range[1]": 2.5})
    (1.0, 2.5)
    """
    for axis in ("xaxis", "xaxis2") if isinstance(event, dict) else ():
        if event.get(f"{axis}.autorange"):
            return None
        ends = [event.get(f"{axis}.range[{k}]") for k in (0, 1)]
        if all(isinstance(end, int | float) for end in ends):
            return float(ends[0]), float(ends[1])
    return False


def missing_chart(
    curve: Curve,
    units: Sequence[str],
    read: Mapping[str, Any],
) -> dict[str, Any]:
    """A measured curve with its band, and where the rows of a recording lie."""
    motion = Motion(
        read["t"],
        read["q"],
        read["dq"],
        read["ddq"],
        read["modelled"],
    )
    warm = any(v.startswith("temp") for v in curve.of)  # a recording holds none
    return ready(plots.missing_figure(curve, units, [] if warm else [motion]), 260)


def failing_stretches(
    model: ModelStep,
    run: str,
    j: int,
    start: float,
) -> list[tuple[float, float, str]]:
    """Where joint j (from 0) fails on a run, in its seconds since ``start``, and the
    cause."""
    if not model.failures:
        return []
    name = run.partition(", ")[0]
    return [
        (s["start"] - start, s["stop"] - start, s["cause"])
        for s in model.failures[j]["stretches"]
        if s["run"].startswith(name)
    ]


def finding_chart(session: Session, finding: Finding) -> dict[str, Any] | None:
    """The error of a finding's joint against its cause: before, after everything sure
    was added, and what that models; None where the runs are too short to say a cause."""
    step = session.diagnosed
    if not step.failures or not step.pictures:
        return None
    read = session.arrays(step.pictures)

    def signals(name: str) -> Signals:
        return Signals(
            read["t"],
            read["q"],
            read["dq"],
            read["measured"],
            read[name],
        )

    before = signals("before")
    after = signals("after")
    joint = finding.main_joint
    failures = Failures.from_dict({"units": (), "joints": step.failures})
    units = session.robot["units"]
    plot = plots.cause_figure(
        before,
        after if finding.torque_is_certain else None,
        joint=joint,
        cause=finding.seen_against or cause_of(failures, joint),
        units=units,
        position_units=["m" if unit == "N" else "rad" for unit in units],
        floor=step.comparison["noise_floor"],
    )
    return ready(plot, 270)


#: Signals that an error is drawn against, and their names.
SIGNALS = {
    "q": "position",
    "dq": "velocity",
    "ddq": "acceleration",
    "torque": "measured torque",
    "t": "time",
}


def residual_chart(
    reads: Sequence[Mapping[str, Any]],
    joint: int,
    signal: str,
    unit: str,
    floor: float | None,
    span: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """What one or two models leave of a joint's torque (joint from 0) against one of
    SIGNALS, the last one's reversals ringed; span : only these seconds of the run; in
    the band 95 % of noise lies."""
    last = reads[-1]
    t = last["t"] - last["t"][0]
    cut = _rows_of_span(t, span)
    x = np.asarray(t if signal == "t" else last[signal][:, joint])[cut]
    errors = [(r["torque"][:, joint] - r["modelled"][:, joint])[cut] for r in reads]
    rows = plots.spread_rows(len(x))
    plot = Figure()

    def dots(y: Any, name: str, colour: str) -> None:
        marker = {"size": 3, "color": colour}
        plot.add(
            "scatter",
            x=x[rows],
            y=y[rows],
            mode="markers",
            name=name,
            marker=marker,
        )

    if len(errors) > 1:  # in the colours of the torque's figure
        dots(errors[0], "error of the first model", plots.BEFORE)
    dots(errors[-1], "error", plots.AFTER)
    direction = np.sign(last["dq"][cut, joint])
    turns = np.flatnonzero(direction[1:] != direction[:-1])[:POINTS]
    rings = {"size": 8, "symbol": "circle-open", "color": COLOURS[2]}
    plot.add(
        "scatter",
        x=x[turns],
        y=errors[-1][turns],
        mode="markers",
        name="reversals",
        marker=rings,
    )
    if floor is not None:
        plot.update_layout(shapes=[plots.noise_band(floor)])
    plot.update_axes("x", title=f"{SIGNALS[signal]} [{_unit_of(signal, unit)}]")
    plot.update_axes("y", title=f"error of joint {joint + 1} [{unit}]")
    return ready(plot, 320)


def _rows_of_span(t: Any, span: tuple[float, float] | None) -> slice:
    """The rows of these seconds; all of them where there are fewer than two."""
    if span is None:
        return slice(None)
    first, last = np.searchsorted(t, span)
    return slice(first, last) if last - first >= 2 else slice(None)


def _unit_of(signal: str, unit: str) -> str:
    """Of one of SIGNALS, for a joint whose torque has this unit."""
    position = "m" if unit == "N" else "rad"
    units = {
        "q": position,
        "dq": f"{position}/s",
        "ddq": f"{position}/s^2",
        "torque": unit,
        "t": "s",
    }
    return units[signal]


def ready(plot: Figure, height: int) -> dict[str, Any]:
    """Plain JSON; to be zoomed in time only."""
    plots.styled(plot, height).update_layout(
        margin={"l": 66, "r": 8, "t": 34, "b": 42}, dragmode="zoom"
    )
    plot.update_layout(template={"layout": {"yaxis": {"fixedrange": True}}})
    data: dict[str, Any] = json.loads(plot.to_json())
    return {**data, "config": {"displayModeBar": False, "responsive": True}}


#: The torque error that has the last colour, in noise floors.
_LAST_COLOUR = 4


def error_scale(model: ModelStep) -> tuple[str, str]:
    """What the first and the last colour of :func:`torque_errors` mean."""
    is_known = None not in model.comparison["noise_floor"]
    unit = "noise" if is_known else "noise, or its own RMS"
    return "no error", f"{_LAST_COLOUR} times the {unit}"


def torque_errors(model: ModelStep, read: Mapping[str, Any]) -> Any:
    """(F, n) torque errors at the instants of the poses, 0 to 1: four times the noise
    floor, or where that is not known the error's own root mean square."""
    error = np.abs(read["torque"] - read["modelled"])
    rms = np.sqrt(np.mean(error**2, axis=0))
    floors = model.comparison["noise_floor"]
    sizes = [floor or own for floor, own in zip(floors, rms, strict=True)]
    scale = _LAST_COLOUR * np.maximum(sizes, 1e-12)
    at = np.searchsorted(read["t"], read["tf"]).clip(0, len(error) - 1)
    return np.round(np.clip(error[at] / scale, 0.0, 1.0), 2)
