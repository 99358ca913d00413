"""Figures that the report and the workbench page share."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.colours import ADDED, AFTER, BEFORE, MEASURED, NEUTRAL, model_colour
from sdp_vs_penalty.diagnosis.causes import (
    ACCELERATION,
    BY_DIRECTION,
    HIGH_SPEED,
    LOAD,
    MODELLED_TORQUE,
    POSE,
    POSITION,
    REVERSAL,
    STANDSTILL,
    TORQUE_CURVATURE,
    TORQUE_RATE,
    TURN,
    VELOCITY,
    WAVES,
)
from sdp_vs_penalty.diagnosis.comparison import Signals
from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.measured_curve import Variable
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.signals.reversals import since_reversal

#: Points of a curve or a cloud: about as many as a screen shows, and quick to draw.
POINTS = 800


class Figure:
    """A figure as plain data for plotly's script.

    Methods and properties have plotly.py's names. plotly.py itself checks every property
    against its schema, which takes a tenth of a second a figure.

    ``data`` holds the traces, ``layout`` everything else; a ``title`` may be a text.
    """

    def __init__(self, columns: int = 1, rows: int = 1, gap: float = 0.12) -> None:
        """Make an empty figure with one panel or several.

        Parameters
        ----------
        columns, rows : int
            Panels next to each other, or below each other. Rows share the time axis of
            the last one.
        gap : float
            Distance between panels, as a share of the figure.
        """
        self.data = list[dict[str, Any]]()
        grid = {
            "rows": rows,
            "columns": columns,
            "pattern": "independent",
            "xgap": gap,
            "ygap": gap,
        }
        self.layout: dict[str, Any] = {"grid": grid} if rows * columns > 1 else {}
        for k in range(rows - 1):
            self.update_axes(
                "x", k, matches=f"x{_number(rows - 1)}", showticklabels=False
            )

    def add(self, kind: str, panel: int = 0, **properties: Any) -> Figure:
        """Add a trace to a panel.

        Parameters
        ----------
        kind : str
            Plotly's name of the trace type, such as "scatter".
        panel : int
            Number of the panel, from 0.
        **properties : Any
            Properties of the trace, by plotly's names.

        Returns
        -------
        Figure
            This figure, so that calls can be chained.
        """
        axes = (
            {"xaxis": f"x{_number(panel)}", "yaxis": f"y{_number(panel)}"}
            if panel
            else {}
        )
        self.data.append({"type": kind, **properties, **axes})
        return self

    def add_band(
        self, x: ArrayLike, low: ArrayLike, high: ArrayLike, panel: int = 0
    ) -> Figure:
        """Add a grey band between two curves over x (k,).

        Parameters
        ----------
        low, high : (k,) array
            Lower and upper edge of the band.
        panel : int
            Number of the panel, from 0.
        """
        edge = {
            "mode": "lines",
            "line": {"width": 0},
            "showlegend": False,
            "hoverinfo": "skip",
        }
        fill = {"fill": "tonexty", "fillcolor": "rgba(128,128,128,0.3)"}
        return self.add("scatter", panel, x=x, y=high, **edge).add(
            "scatter", panel, x=x, y=low, **fill, **edge
        )

    def update_layout(self, **changes: Any) -> Figure:
        """Change the layout; nested mappings are merged.

        Parameters
        ----------
        **changes : Any
            Properties of the layout, by plotly's names.
        """
        self.layout = _merged(self.layout, changes)
        return self

    def update_axes(self, letter: str, panel: int = 0, **changes: Any) -> Figure:
        """Change properties of one axis of a panel (from 0), by plotly's names; return
        this figure."""
        return self.update_layout(**{f"{letter}axis{_number(panel)}": changes})

    def to_json(self) -> str:
        """Return the figure as JSON for plotly's script.

        Arrays are packed in single precision, which is finer than any screen.
        """
        content = {"data": self.data, "layout": self.layout}
        return json.dumps(content, default=_packed, separators=(",", ":"))


def _number(panel: int) -> str:
    """Return plotly's suffix for the axes of a panel (from 0): "", "2", "3", ..."""
    return "" if panel == 0 else str(panel + 1)


def _merged(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """Merge new properties into old ones, level by level; ``old`` stays as it is.

    A ``title`` given as text becomes {"text": ...}, the form that plotly's script
    reads.
    """
    out = dict(old)
    for name, value in new.items():
        if name == "title" and isinstance(value, str):
            value = {"text": value}
        if isinstance(value, Mapping):
            value = _merged(out.get(name) or {}, value)
        out[name] = value
    return out


def _packed(values: Array) -> Any:
    """Encode an array as plotly's script reads it: one-dimensional numbers as base64 of
    single-precision floats, anything else as lists.
    """
    if values.dtype.kind not in "fiu" or values.ndim != 1:
        return values.tolist()
    single_precision = np.ascontiguousarray(values, "<f4").tobytes()
    return {"dtype": "f4", "bdata": base64.b64encode(single_precision).decode()}


@dataclass(frozen=True)
class Curves:
    """Torques of one run behind the filters."""

    #: (M,) instants as they are drawn [s].
    t: Array
    #: (M, n) measured torque [N m or N].
    torque: Array
    #: (M, n) modelled torque [N m or N], by the model's name.
    modelled: Mapping[str, Array]


def envelope(x: ArrayLike, y: ArrayLike, points: int = POINTS) -> tuple[Array, Array]:
    """Thin a curve (k,) out for drawing: keep the lowest and the highest point of each
    stretch.

    Drawn with that many pixels, the thinned curve looks like the full one, as every
    peak stays.

    Parameters
    ----------
    points : int
        Largest number of points to keep.

    Returns
    -------
    tuple of arrays
        Abscissae and ordinates of the remaining points, in order.

    Examples
    --------
    >>> envelope([0, 1, 2, 3, 4, 5], [0, 9, 1, 1, -5, 1], points=4)
    (array([0., 1., 3., 4.]), array([ 0.,  9.,  1., -5.]))
    """
    x = np.asarray(x, float)
    y = np.asarray(y, float)
    if len(y) <= points:
        return x, y
    # Two points of each stretch stay; its length is rounded up.
    length = -(-2 * len(y) // points)
    padding = -len(y) % length
    stretches = np.pad(y, (0, padding), "edge").reshape(-1, length)
    extremes = np.stack([stretches.argmin(axis=1), stretches.argmax(axis=1)])
    first_rows = length * np.arange(len(stretches))
    rows = np.unique(extremes + first_rows)
    return x[rows], y[rows]


def shifts(times: Sequence[Array]) -> list[float]:
    """Return the offsets of clocks that place runs one after another on one time axis.

    Parameters
    ----------
    times : sequence of (M,) arrays
        Time stamps of each run [s].

    Returns
    -------
    list of float
        Offset of each run [s]; the runs are one second apart.
    """
    lengths = [float(t[-1] - t[0]) + 1.0 for t in times]
    return [sum(lengths[:k]) - float(t[0]) for k, t in enumerate(times)]


def torque_figure(
    runs: Sequence[Curves], joint: int, unit: str, side_by_side: bool = True
) -> Figure:
    """Draw measured and modelled torque of a joint over time, and the residuals.

    Parameters
    ----------
    runs : sequence of Curves
        The runs, drawn one after another.
    joint : int
        Index of the joint, from 0.
    unit : str
        Unit of its torque, "N*m" or "N".
    side_by_side : bool
        Whether the residuals stand to the right of the torques; else they stand below.
    """
    plot = Figure(columns=2, gap=0.16) if side_by_side else Figure(rows=2)

    def curve(
        t: Array, values: Array, name: str, colour: str, in_legend: bool, panel: int = 0
    ) -> None:
        """Draw a thinned curve over time, in the legend or not."""
        x, y = envelope(t, values)
        look = {"line": {"color": colour, "width": 2.0 if colour == MEASURED else 1.2}}
        plot.add(
            "scatter",
            panel,
            x=x,
            y=y,
            name=name,
            legendgroup=name,
            showlegend=in_legend,
            **look,
        )

    for index, run in enumerate(runs):
        measured = run.torque[:, joint]
        curve(run.t, measured, "measured", MEASURED, index == 0)
        for m, (name, modelled) in enumerate(run.modelled.items()):
            colour = model_colour(m, len(run.modelled))
            y = modelled[:, joint]
            curve(run.t, y, name, colour, index == 0)
            curve(run.t, measured - y, name, colour, False, 1)
    plot.update_axes("y", 0, title=f"joint {joint + 1} [{plain_unit(unit)}]")
    plot.update_axes("x", 1, title="time [s]")
    if side_by_side:
        return plot.update_axes("x", 0, title="time [s]")
    return plot.update_axes("y", 1, title=f"error [{plain_unit(unit)}]")


def band_figure(x: ArrayLike, y: ArrayLike, low: ArrayLike, high: ArrayLike) -> Figure:
    """Draw a curve y over x, both (k,), with a band around it.

    Parameters
    ----------
    low, high : (k,) array
        Lower and upper edge of the band.
    """
    line = {"color": AFTER}
    return (
        Figure()
        .add_band(x, low, high)
        .add("scatter", x=x, y=y, line=line, showlegend=False)
    )


def missing_figure(
    curve: Curve, units: Sequence[str], motions: Sequence[Motion]
) -> Figure:
    """Draw a measured curve of missing torque with its 95 % band, and where the rows
    lie.

    A curve over two variables is drawn by colour.

    Parameters
    ----------
    curve : Curve
        Missing torque over one or two variables.
    units : sequence of str
        Torque unit of each joint.
    motions : sequence of Motion
        The measured rows, with the modelled torque; without any, their distribution is
        left out.
    """
    variables = [Variable.parse(text) for text in curve.of]
    names = [
        f"{v} [{plain_unit(v.unit(units))}]".removesuffix(" []") for v in variables
    ]
    unit = plain_unit(units[curve.joint - 1])
    rows: list[Array] = []
    if motions:
        for variable in variables:
            values = np.concatenate([variable.along(motion) for motion in motions])
            rows.append(values[spread_rows(len(values))])
    if len(names) == 1:
        # The histogram has an axis of its own on the right.
        plot = band_figure(curve.x, curve.torque, curve.lower, curve.upper)
        for x in rows:
            plot.add(
                "histogram",
                x=x,
                yaxis="y2",
                name="rows",
                marker={"color": NEUTRAL},
                opacity=0.3,
                nbinsx=60,
            )
        axis = {"overlaying": "y", "side": "right", "title": "rows"}
        plot = plot.update_layout(yaxis2=axis)
        return plot.update_axes("x", title=names[0]).update_axes(
            "y", title=f"joint {curve.joint} [{unit}]"
        )
    plot = _curve_over_two(curve, rows, unit)
    return plot.update_axes("x", title=names[0]).update_axes("y", title=names[1])


def _curve_over_two(curve: Curve, rows: Sequence[Array], unit: str) -> Figure:
    """Draw a curve over two variables as coloured squares, and the measured rows as
    dots: ``rows`` holds both variables (k,) there, or nothing.

    ``unit`` is that of the torque. The band is shown where the mouse points.
    """
    half = 0.5 * (curve.upper - curve.lower)
    texts = [f"{t:.3g} ± {h:.2g}" for t, h in zip(curve.torque, half, strict=True)]
    marker = {
        "color": curve.torque,
        "colorscale": "RdBu",
        "symbol": "square",
        "size": 11,
        "colorbar": {"title": {"text": unit}},
    }
    plot = Figure().add(
        "scatter",
        x=curve.points[:, 0],
        y=curve.points[:, 1],
        mode="markers",
        name="missing torque and its band",
        marker=marker,
        text=texts,
    )
    if rows:
        dots = {"size": 2, "color": NEUTRAL}
        plot.add(
            "scatter", x=rows[0], y=rows[1], mode="markers", marker=dots, name="rows"
        )
    return plot


def spread_rows(n_rows: int, points: int = POINTS) -> Indices:
    """Return row numbers that are spread evenly over a run.

    Parameters
    ----------
    n_rows : int
        Number of rows of the run.
    points : int
        Largest number of rows to choose.

    Returns
    -------
    array of int
        Increasing row numbers, from 0 to n_rows - 1.
    """
    n_chosen = min(n_rows, points)
    return np.unique(np.linspace(0, n_rows - 1, n_chosen).astype(np.intp))


#: Seconds before and after a reversal that a picture shows.
_AROUND_REVERSAL = 0.4
#: Bins of the mean curve of a cloud of errors.
_BINS = 24
#: A mean curve is broken where no sample lies on this share of its range,
_GAP = 0.12
#: and on so many of the steps from row to row: where rows are farther apart, nothing is
#: missing between them. From 1 to 3 the pictures of a UR10e and two Pandas are the same;
#: without it those of the UR10e break at every instant.
_STEPS_OF_GAP = 1.5


@dataclass(frozen=True)
class CauseAxis:
    """The abscissa of an error."""

    #: (M,) quantity that the error is drawn against.
    x: Array
    #: (M,) sign by which the error is multiplied.
    sign: Array
    #: Name of the abscissa, with its unit.
    label: str
    #: Limits of x; None: those of the samples.
    limits: tuple[float, float] | None = None


def cause_axis(
    signals: Signals,
    joint: int,
    cause: str,
    position_unit: str,
    waves: float = 1.0,
    torque_unit: str = "N m",
) -> CauseAxis:
    """Choose the abscissa that shows how a joint's error depends on a cause.

    Friction errors change sign with the direction of motion, so some causes multiply
    the error by that direction.

    Parameters
    ----------
    signals : Signals
        Measured and modelled signals of the judged motion, M rows.
    joint : int
        Number of the joint, from 1.
    cause : str
        A cause of diagnosis/causes.py; any other is drawn over time.
    waves : float
        Of the cause WAVES: how many of them there are in 2 pi of the position. They are
        drawn over the period of one, since the bins of a mean are coarser.
    torque_unit : str
        Unit of the joint's torque.

    Returns
    -------
    CauseAxis
        Abscissa (M,), factor of the error (M,), and label.
    """
    j = joint - 1
    ones = np.ones(len(signals.t))
    if cause == REVERSAL:
        seconds, direction = since_reversal(signals.t, signals.dq[:, j])
        limits = (-_AROUND_REVERSAL, _AROUND_REVERSAL)
        label = "time from the nearest reversal [s]"
        return CauseAxis(seconds, direction, label, limits)
    if cause in (POSITION, POSE):
        return CauseAxis(signals.q[:, j], ones, f"position [{position_unit}]")
    if cause == BY_DIRECTION:
        label = f"position [{position_unit}]"
        return CauseAxis(signals.q[:, j], np.sign(signals.dq[:, j]), label)
    if cause in (WAVES, TURN):
        one_period = 2.0 * np.pi / (waves if cause == WAVES else 1.0)
        is_whole_turn = one_period > 6.0  # 2 pi is one
        where = "angle within a turn" if is_whole_turn else "position within one wave"
        label = f"{where} [{position_unit}]"
        return CauseAxis(signals.q[:, j] % one_period, ones, label)
    if cause in (VELOCITY, HIGH_SPEED, STANDSTILL):
        return CauseAxis(signals.dq[:, j], ones, f"velocity [{position_unit}/s]")
    if cause == ACCELERATION:
        x = np.gradient(signals.dq[:, j], signals.t)
        return CauseAxis(x, ones, f"acceleration [{position_unit}/s^2]")
    torque = signals.modelled[:, j]
    if cause == LOAD:  # friction in proportion to the load is then one straight line
        direction = np.sign(signals.dq[:, j])
        return CauseAxis(
            np.abs(torque), direction, f"load: size of torque [{torque_unit}]"
        )
    if cause == MODELLED_TORQUE:
        return CauseAxis(torque, ones, f"modelled torque [{torque_unit}]")
    if cause in (TORQUE_RATE, TORQUE_CURVATURE):
        return _axis_of_torque_change(signals.t, torque, cause, torque_unit)
    return CauseAxis(signals.t, ones, "time [s]")


def _axis_of_torque_change(t: Array, torque: Array, cause: str, unit: str) -> CauseAxis:
    """Return the first or second derivative by time of a modelled torque (M,) as an
    abscissa.

    The cause is TORQUE_RATE or TORQUE_CURVATURE; ``unit`` is that of the torque.
    """
    rate = np.gradient(torque, t)
    ones = np.ones(len(t))
    if cause == TORQUE_RATE:
        return CauseAxis(rate, ones, f"rate of the modelled torque [{unit}/s]")
    label = f"second derivative of the modelled torque [{unit}/s^2]"
    return CauseAxis(np.gradient(rate, t), ones, label)


def mean_curve(x: Array, y: Array) -> tuple[Array, Array]:
    """Mean of y over x, both (M,), in bins of about equal counts; broken where no sample
    lies.

    Rows are in their order in time: a gap is measured against the steps of x from row to
    row. Samples at one place, such as those of one instant after each reversal, share a
    bin.

    Returns
    -------
    tuple of (b,) arrays
        Mean of x and mean of y in each bin; NaN between two stretches of x.
    """
    if not len(x):
        return np.empty(0), np.empty(0)
    order = np.argsort(x)
    along = x[order]
    width = max(float(np.ptp(x)), 1e-300)
    row_step = float(np.median(np.abs(np.diff(x)))) if len(x) > 1 else 0.0
    # Where each place begins, in ``order``: numbers that differ by rounding are one.
    places = [0, *(np.flatnonzero(np.diff(along) > 1e-6 * width) + 1).tolist()]
    longest_step = max(_GAP * width, _STEPS_OF_GAP * row_step)
    gaps = [k for k in places[1:] if along[k] - along[k - 1] > longest_step]
    centres: list[float] = []
    means: list[float] = []
    for first, end in pairwise([0, *gaps, len(x)]):
        if centres:
            centres.append(np.nan)
            means.append(np.nan)
        inside = np.array([k for k in places if first <= k < end])
        middles = (inside + np.append(inside[1:], end)) / 2.0
        n_bins = max(1, round(_BINS * (end - first) / len(x)))
        bins = np.floor((middles - first) * n_bins / (end - first))
        edges = inside[1:][np.diff(bins) > 0.0] - first
        parts = np.split(order[first:end], edges)
        centres += [float(x[part].mean()) for part in parts]
        means += [float(y[part].mean()) for part in parts]
    return np.array(centres), np.array(means)


def cause_figure(
    before: Signals,
    after: Signals | None,
    *,
    joint: int,
    cause: str,
    units: Sequence[str],
    position_units: Sequence[str],
    floor: Sequence[float | None] | Array | None,
    waves: float,
) -> Figure:
    """Draw a joint's error against its cause, before and after effects were added.

    The rows are dots, their mean is a line: grey before, blue after. A dashed line is
    what the added effects model.

    Parameters
    ----------
    before, after : Signals
        Signals of the two models on the same rows; ``after`` may be None.
    joint : int
        Number of the joint, from 1.
    units, position_units : sequence of str
        Units of each joint's torque and position.
    floor : (n,) sequence or None
        RMS noise of each joint, drawn as the band that holds 95 % of it.
    waves : float
        Of the cause WAVES: how many of them there are in 2 pi of the position.
    """
    j = joint - 1
    unit = plain_unit(units[j])
    axis = cause_axis(before, joint, cause, position_units[j], waves, unit)
    inside = np.isfinite(axis.x)
    if axis.limits is not None:
        inside &= (axis.x >= axis.limits[0]) & (axis.x <= axis.limits[1])
    x = axis.x[inside]
    rows = spread_rows(len(x), POINTS // 2)
    plot = Figure()

    def cloud(error: Array, name: str, colour: str) -> None:
        """Draw rows as dots and their mean as a line, which the legend names."""
        y = (error * axis.sign)[inside]
        look = {"size": 3, "color": colour, "opacity": 0.4}
        group: dict[str, Any] = {"legendgroup": name, "name": name}
        plot.add(
            "scatter",
            x=x[rows],
            y=y[rows],
            mode="markers",
            marker=look,
            showlegend=False,
            **group,
        )
        centres, means = mean_curve(x, y)
        line = {"color": colour, "width": 5 if colour == BEFORE else 2.5}
        plot.add("scatter", x=centres, y=means, mode="lines", line=line, **group)

    if len(x):
        if after is None:
            cloud(before.residual[:, j], "mean of measured - modelled", AFTER)
        else:
            cloud(before.residual[:, j], "before", BEFORE)
        if after is not None and len(after.t) == len(before.t):
            cloud(after.residual[:, j], "after", AFTER)
            added = (after.modelled[:, j] - before.modelled[:, j]) * axis.sign
            centres, means = mean_curve(x, added[inside])
            line = {"color": ADDED, "width": 2, "dash": "9px,7px"}
            name = "added"
            plot.add("scatter", x=centres, y=means, mode="lines", line=line, name=name)
    if floor is not None and floor[j]:
        plot.update_layout(shapes=[noise_band(float(floor[j] or 0.0))])
        line = {"color": BAND, "width": 10}
        name = "within 2 times the noise"
        plot.add("scatter", x=[None], y=[None], mode="lines", line=line, name=name)
    plot.update_axes("x", title=axis.label)
    along = " along motion" if cause in (REVERSAL, BY_DIRECTION, LOAD) else ""
    title = f"joint {joint}: error{along} [{unit}]"
    return plot.update_axes("y", title=title)


#: Colour of the band of the noise.
BAND = "rgba(128,128,128,0.18)"


def noise_band(floor: float) -> dict[str, Any]:
    """Return the shape of the band that holds 95 % of a joint's noise, for plotly.

    Parameters
    ----------
    floor : float
        RMS of the noise, in the unit of the panel.

    Returns
    -------
    dict
        A rectangle over the full width of the panel.
    """
    return {
        "type": "rect",
        "xref": "paper",
        "x0": 0,
        "x1": 1,
        "yref": "y",
        "y0": -NORMAL_95 * floor,
        "y1": NORMAL_95 * floor,
        "layer": "below",
        "fillcolor": BAND,
        "line": {"width": 0},
    }


def friction_figure(
    velocity: ArrayLike, torque: ArrayLike, half: ArrayLike, joint: int, unit: str
) -> Any:
    """Draw the friction torque (k,) of a joint over its velocity, with its 95 % band.

    Parameters
    ----------
    velocity : (k,) array
        Joint velocity [rad/s or m/s].
    half : (k,) array
        Half the width of the band.
    joint : int
        Index of the joint, from 0.
    unit : str
        Unit of the torque, "N*m" or "N".
    """
    plot = band_figure(
        velocity, torque, np.subtract(torque, half), np.add(torque, half)
    )
    speed = "m/s" if unit == "N" else "rad/s"
    plot.update_axes("x", title=f"velocity [{speed}]")
    plot.update_axes("y", title=f"joint {joint + 1} [{plain_unit(unit)}]")
    return plot


def styled(plot: Any, height: int) -> Any:
    """Give a figure the colours and margins of report and page, for light and dark alike,
    and a height [px]; return it."""
    plot.update_layout(
        height=height,
        margin={"l": 55, "r": 15, "t": 30, "b": 45},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        font={"family": "system-ui, sans-serif", "color": NEUTRAL, "size": 12},
        legend={
            "itemsizing": "constant",
            "orientation": "h",
            "y": 1.0,
            "yref": "container",
            "yanchor": "top",
            "x": 0.0,
        },
        hovermode="closest",
    )
    axis = {
        "gridcolor": "rgba(128,128,128,0.25)",
        "zerolinecolor": "rgba(128,128,128,0.5)",
    }
    axis["exponentformat"] = "e"  # 5e-5 rad instead of 50µ
    # A template holds for the axes of every panel.
    return plot.update_layout(template={"layout": {"xaxis": axis, "yaxis": axis}})
