"""The page's charts, which are the report's figures."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sdp_vs_penalty.colours import PALETTE
from sdp_vs_penalty.diagnosis.comparison import Signals
from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.diagnosis.finding import Finding, Retune
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.where_it_fails import UNNAMED
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.page.model_step import ModelStep
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.render import charts
from sdp_vs_penalty.render.charts import Curves, Figure
from sdp_vs_penalty.render.pieces import shades
from sdp_vs_penalty.render.words import shown_cause, shown_waves
from sdp_vs_penalty.robot.arrays import Array


def torque_chart(
    run: Curves,
    joint: int,
    units: Sequence[str],
    span: tuple[float, float] | None = None,
    stretches: Sequence[tuple[float, float, str]] = (),
) -> dict[str, Any]:
    """Draw measured and modelled torque of one joint, and below them the error.

    Parameters
    ----------
    run : Curves
        Time (M,) [s], measured torque (M, n) and modelled torque by model.
    joint : int
        Index of the joint, from 0.
    units : sequence of str
        Torque unit of each joint.
    span : (float, float), optional
        Seconds to show; a quarter of their length is drawn on either side as well.
    stretches : sequence of (begin, end, cause)
        Seconds in which the error is large; they are shaded by cause.

    Returns
    -------
    dict
        The figure as JSON for plotly's script.
    """
    t = run.t
    cut = slice(None)
    if span is not None:
        edge = 0.25 * (span[1] - span[0])  # so that curves leave the picture
        low, high = np.searchsorted(t, (span[0] - edge, span[1] + edge))
        cut = slice(min(low, len(t) - 1), max(high, low + 1))
    part = Curves(
        t[cut], run.torque[cut], {name: m[cut] for name, m in run.modelled.items()}
    )
    plot = charts.torque_figure([part], joint, units[joint], side_by_side=False)
    plot.update_layout(shapes=shades(stretches))
    if span is not None:
        plot.update_axes("x", range=list(span))
    return ready(plot, 420)


def data_chart(
    read: Mapping[str, Any],
    units: Sequence[str],
    shows_repairs: bool,
    position_unit: str = "",
    torque_unit: str = "",
) -> dict[str, Any]:
    """Draw positions, velocities and torques of all joints on one time axis.

    Parameters
    ----------
    read : mapping
        t (M,) [s]; q, dq, torque (M, n); repaired_q, repaired_torque (M, n), which the
        data check would put in their place: NaN, or drawn as a cross where a repair is
        offered (``shows_repairs``).
    units : sequence of str
        Torque unit of each joint; "N" marks a prismatic one.
    position_unit, torque_unit : str
        Units of positions and torques as they are logged, where these are others.

    Returns
    -------
    dict
        The figure as JSON for plotly's script. A log without torque has two panels.
    """
    shown = ["q", "dq"]
    if np.any(read["torque"]):  # a log may hold none
        shown.append("torque")
    plot = Figure(rows=len(shown), gap=0.08)
    t = read["t"]
    repaired = {
        name: read.get(f"repaired_{name}", np.nan * read["q"]) for name in shown
    }
    for row, name in enumerate(shown):
        for j in range(len(units)):
            colour = PALETTE[j % len(PALETTE)]
            named = {"name": f"joint {j + 1}", "legendgroup": f"{j}"}
            look: dict[str, Any] = {"line": {"color": colour, "width": 1.2}}
            look |= {"showlegend": row == 0} | named
            plot.add("scatter", row, x=t, y=read[name][:, j], **look)
            rows = np.isfinite(repaired[name][:, j]) & shows_repairs
            if rows.any():
                marker = {"symbol": "x", "size": 5, "color": colour}
                look = {"mode": "markers", "marker": marker}
                if rows.mean() > 0.5:  # all of a curve, not single values
                    look = {"mode": "lines", "line": {"color": colour, "width": 4}}
                look |= named | {"name": f"joint {j + 1}, corrected"}
                look["showlegend"] = False
                plot.add("scatter", row, x=t[rows], y=repaired[name][rows, j], **look)
        span = _span_without_spikes(read[name], repaired[name])
        plot.update_axes("y", row, range=span)
    usual = dict.fromkeys("m" if unit == "N" else "rad" for unit in units)
    kinds = [position_unit] if position_unit else [*usual]
    torques = [torque_unit] if torque_unit else [*dict.fromkeys(units)]
    titles = (
        f"Position<br>[{' or '.join(kinds)}]",
        f"Velocity<br>[{' or '.join(f'{kind}/s' for kind in kinds)}]",
        f"Torque<br>[{' or '.join(torques)}]",
    )
    for row, title in enumerate(titles[: len(shown)]):
        plot.update_axes("y", row, title=title)
    plot.update_axes("x", len(shown) - 1, title="time [s]")
    return ready(plot, 460)


#: Between these percentiles measured values stay in the picture.
_USUAL = (2.0, 98.0)


def _span_without_spikes(raw: Array, repaired: Array) -> list[float] | None:
    """Return the axis range of a signal (M, n) without the values that the check repairs:
    spikes would press everything else into a line. None where it repairs nothing."""
    if not np.isfinite(repaired).any():
        return None
    mended = np.where(np.isfinite(repaired), repaired, raw)
    shown = [np.nanmin(mended), np.nanmax(mended), *np.nanpercentile(raw, _USUAL)]
    low, high = min(shown), max(shown)
    room = 0.1 * (high - low)
    return [low - room, high + room]


def asked_span(event: Any) -> tuple[float, float] | bool | None:
    """Return the time span that a plotly_relayout event asks for.

    None for the full run (zoom reset), False if the event asks for no span at all.

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
    curve: Curve, units: Sequence[str], read: Mapping[str, Any]
) -> dict[str, Any]:
    """Draw a measured curve of missing torque with its band, and where a run's rows
    lie.

    The rows are left out for a curve over temperature, which recordings do not hold.
    """
    t = read["t"] + read["begin"]  # the curve's clock is the log's
    motion = Motion(t, read["q"], read["dq"], read["ddq"], read["modelled"])
    warm = any(v.startswith("temp") for v in curve.of)  # a recording holds none
    return ready(charts.missing_figure(curve, units, [] if warm else [motion]), 260)


def failing_stretches(
    model: ModelStep, run: str, j: int, read: Mapping[str, Any]
) -> list[tuple[float, float, str]]:
    """List the stretches of a run in which a joint's error is large, as far as a curve is
    drawn there: none is at standstill.

    Parameters
    ----------
    model : ModelStep
        The model, with its failures.
    run : str
        Name of the run, perhaps with the seconds of its part: "run1, 3 to 9 s".
    j : int
        Index of the joint, from 0.
    read : mapping
        t (M,), the instants of the curve [s] on the run's clock, which is 0 at "begin" of
        the log's.

    Returns
    -------
    list of (begin [s], end [s], cause)
        On the run's clock.
    """
    if not model.failures:
        return []
    recording = run.partition(", ")[0]
    begin, end = read["t"][[0, -1]]
    spans = [
        (x["start"] - read["begin"], x["stop"] - read["begin"], x["cause"])
        for x in model.failures[j]["stretches"]
        if x["run"].partition(", ")[0] == recording
    ]
    return [
        (float(max(start, begin)), float(min(stop, end)), cause)
        for start, stop, cause in spans
        if start < end and stop > begin
    ]


def finding_chart(
    session: Session, diagnosis: Diagnosis, found: Finding | Retune
) -> dict[str, Any] | None:
    """Draw the error that the card of a finding, or of a constant to re-estimate, is
    about, against its cause, before and after adding it.

    "After" is the model with everything that helps; it is left out for what is not.
    None if the runs are too short to name a cause.
    """
    step = session.diagnosed
    if not step.failures or not step.pictures:
        return None
    read = session.arrays(step.pictures)
    reads = [{**read, "torque": read["measured"], "modelled": read["before"]}]
    if found.torque_is_certain and "after" in read:
        reads.append({**reads[0], "modelled": read["after"]})
    joint, finding = diagnosis.offers.shown_of(found)
    failures = step.where_it_fails
    cause = shown_cause(finding, failures, joint)
    waves = shown_waves(failures[joint - 1], finding)
    return cause_chart(session, step, reads, joint - 1, cause, waves, 270)


def failing_chart(session: Session, run: str) -> tuple[dict[str, Any], str]:
    """Draw the error of the joint that errs most in a run of the current model, against
    what it depends on most; return the figure and its title."""
    model = session.current
    joint, failures = model.worst_joint, model.where_it_fails
    cause = shown_cause(None, failures, joint)
    waves = shown_waves(failures[joint - 1])
    read = session.recording(model, run)
    title = f"Error of joint {joint} against {'time' if cause == UNNAMED else cause}"
    return cause_chart(session, model, [read], joint - 1, cause, waves), title


def cause_chart(
    session: Session,
    step: ModelStep,
    reads: Sequence[Mapping[str, Any]],
    j: int,
    cause: str,
    waves: float = 1.0,
    height: int = 320,
) -> dict[str, Any]:
    """Draw the torque error of one joint j (from 0) against a cause.

    Parameters
    ----------
    step : ModelStep
        The model whose noise floor is drawn.
    reads : sequence of mappings
        Arrays of the same rows (t, q, dq, torque, modelled) for one or two models.
    waves : float
        How many waves in 2 pi of the position the chart shows one of.

    Returns
    -------
    dict
        The figure as JSON for plotly's script.
    """
    names = ("t", "q", "dq", "torque", "modelled")
    before, after = (
        Signals(*(read[x] for x in names)) for read in (reads[0], reads[-1])
    )
    units = session.torque_units
    plot = charts.cause_figure(
        before,
        after if len(reads) > 1 else None,
        joint=j + 1,
        cause=cause,
        waves=waves,
        units=units,
        position_units=["m" if x == "N" else "rad" for x in session.robot["units"]],
        floor=step.comparison["noise_floor"],
    )
    return ready(plot, height)


def clock_in_words(run: str, read: Mapping[str, Any]) -> str:
    """Say where the clock of a run's pictures begins on that of its log; "" where both are
    one."""
    begin = float(read["begin"])
    at = f"{begin:.10g}"
    return (
        "" if at == "0" else f"0 s is {at} s on the clock of {run.partition(', ')[0]}."
    )


def rows_of_span(
    read: Mapping[str, Any], span: tuple[float, float] | None
) -> Mapping[str, Any]:
    """Return the arrays of a run within a time span [s]; all rows if fewer than two lie
    in it."""
    t = read["t"]
    first, last = (0, 0) if span is None else np.searchsorted(t, span)
    if last - first < 2:
        return read
    return {k: x[first:last] for k, x in read.items() if np.shape(x)[:1] == t.shape}


def ready(plot: Figure, height: int) -> dict[str, Any]:
    """Return the figure as JSON in the page's style, ``height`` pixels high.

    It can be zoomed in time only.
    """
    charts.styled(plot, height).update_layout(
        margin={"l": 66, "r": 8, "t": 34, "b": 42}, dragmode="zoom"
    )
    plot.update_layout(template={"layout": {"yaxis": {"fixedrange": True}}})
    data: dict[str, Any] = json.loads(plot.to_json())
    return {**data, "config": {"displayModeBar": False, "responsive": True}}


#: The torque error that has the last colour, in noise floors.
_LAST_COLOUR = 4


def error_scale(model: ModelStep) -> tuple[str, str]:
    """Say what the first and the last colour of :func:`torque_errors` mean."""
    is_known = model.comparison["noise_floor"] is not None
    unit = "noise of the joint" if is_known else "noise of the joint, or its own RMS"
    return "no error", f"{_LAST_COLOUR} times the {unit}"


def torque_errors(model: ModelStep, read: Mapping[str, Any]) -> Any:
    """Return the torque errors (F, n), scaled to 0 to 1, at the instants of the 3D
    poses.

    1 means four times the joint's noise floor or more. If that is unknown, the root
    mean square of the error itself takes its place.
    """
    error = np.abs(read["torque"] - read["modelled"])
    rms = np.sqrt(np.mean(error**2, axis=0))
    floors = model.comparison["noise_floor"] or np.zeros(len(rms))
    sizes = np.where(floors, floors, rms)
    scale = _LAST_COLOUR * np.maximum(sizes, 1e-12)  # no division by zero
    rows = np.searchsorted(read["t"], read["tf"]).clip(0, len(error) - 1)
    return np.round(np.clip(error[rows] / scale, 0.0, 1.0), 2)
