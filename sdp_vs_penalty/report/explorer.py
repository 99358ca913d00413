"""The sections of the report that show the error itself: against any signal, and as measured curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdp_vs_penalty.diagnosis.comparison import predicted
from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.effects.curve_variable import Variable
from sdp_vs_penalty.report.plots import (
    COLOURS,
    SIGNALS,
    correlation_figure,
    ladder_figure,
    missing_figure,
    noise_band,
    scatter_rows,
)
from sdp_vs_penalty.report.section import Material, Section, figure, number, table, text
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.show import plain_unit
from sdp_vs_penalty.signals.preprocessing import Rows


def explorer(material: Material) -> Section:
    """Error and signals of each joint against each other and in time, and the error's correlations."""
    n, units = material.last.robot.n, material.last.robot.torque_units
    body = text(
        "Measured less modelled torque (error) and the signals of one joint, each model in its colour; "
        "below, the error in time. Reversals of the joint are ringed; the band is 1.96 noise floors "
        "wide to either side, where the noise is known. Drag over points: the same instants stand out "
        "in the other panel; a double click ends that."
    )
    said = "Choose the joint, the run and what the two axes show above the figure."
    body += figure(_scatter(material, n, units), said, 470)
    body += text(
        "Correlation of the error with itself and with the joint's velocity at later instants; grey: "
        "where 95 % of the correlations of unrelated signals lie, 1.96 / sqrt(N)."
    )
    body += figure(_correlations(material, n), "Choose the joint above the figure.", 380)
    return Section("explorer", "Where it fails, seen", body)


def _scatter(material: Material, n: int, units: tuple[str, ...] | list[str]) -> Any:
    from plotly.graph_objects import Scatter
    from plotly.subplots import make_subplots

    plot = make_subplots(rows=2, cols=1, row_heights=[0.65, 0.35], vertical_spacing=0.14)
    runs = next(iter(material.rows.values()))
    errors = {
        name: [r.torque - predicted(r, estimate.theta) for r in material.rows[name]]
        for name, estimate in material.models.items()
    }
    said = {"error": f"error [{', '.join(dict.fromkeys(map(plain_unit, units)))}]", **SIGNALS}
    # Of each trace of the upper panel what it shows when a signal is chosen for an axis.
    shown: dict[str, list[Array]] = {name: [] for name in ("error", *SIGNALS)}
    upper: list[int] = []
    for j in range(n):
        for k, run in enumerate(runs):
            signals = {name: _signal(run, name, j) for name in SIGNALS}
            keep, turns = scatter_rows(signals["dq"])
            for m, (name, left) in enumerate(errors.items()):
                colour, y = COLOURS[m % len(COLOURS)], left[k][:, j]
                looks: list[tuple[Any, int, dict[str, Any]]] = [
                    (keep, 1, {"size": 3}),
                    (turns, 1, {"size": 8, "symbol": "circle-open"}),
                    (keep, 2, {"size": 2}),
                ]
                for rows, panel, look in looks:
                    x = signals["q" if panel == 1 else "t"][rows]
                    called = f"{name}, reversals" if rows is turns else name
                    called += f", run {k + 1}" if len(runs) > 1 else ""
                    marker = {**look, "color": colour}
                    trace = Scatter(x=x, y=y[rows], mode="markers", name=called, marker=marker)
                    trace.update(visible=j == 0, showlegend=panel == 1)
                    plot.add_trace(trace, row=panel, col=1)
                    if panel == 1:
                        upper.append(len(plot.data) - 1)
                        for signal, values in {**signals, "error": y}.items():
                            shown[signal].append(values[rows])
    floor, of_run, points = material.comparisons[-1].noise_floor, 3 * len(errors), len(plot.data)
    bands = [[] if floor is None else noise_band(1.96 * floor[j], "y2") for j in range(n)]
    above = [] if floor is None else [_band(runs, j, 1.96 * floor[j]) for j in range(n)]
    upper += range(points, points + n if above else points)
    grey: dict[str, Any] = {"mode": "lines", "line_width": 0, "fill": "toself", "hoverinfo": "skip"}
    for j, (across, up) in enumerate(above):
        trace = Scatter(x=across["q"], y=up["error"], fillcolor="rgba(128,128,128,0.2)", **grey)
        plot.add_trace(trace.update(visible=j == 0, showlegend=False), row=1, col=1)
    joints = []
    for j, band in enumerate(bands):
        every = range(j * len(runs), (j + 1) * len(runs))
        for places in [every, *([k] for k in every if len(runs) > 1)]:
            visible = [k // of_run in places for k in range(points)]
            visible += [k == j for k in range(len(plot.data) - points)]
            label = f"joint {j + 1}" + (f", run {places[0] % len(runs) + 1}" if places != every else "")
            joints.append(
                {"label": label, "method": "update", "args": [{"visible": visible}, {"shapes": band}]}
            )

    def axis(which: str) -> list[dict[str, Any]]:
        return [
            {
                "label": word,
                "method": "update",
                "args": [
                    {which: [*shown[s], *(band[which == "y"].get(s, [None] * 4) for band in above)]},
                    {f"{which}axis.title.text": word},
                    upper,
                ],
            }
            for s, word in said.items()
        ]

    menus: list[dict[str, Any]] = [
        {"buttons": buttons, "active": active, "x": 0.34 * k, "y": 1.18, "xanchor": "left"}
        for k, (buttons, active) in enumerate([(joints, 0), (axis("x"), 1), (axis("y"), 0)])
    ]
    # The script of the page marks what is selected in one panel in the other as well.
    plot.update_layout(shapes=bands[0], updatemenus=menus, dragmode="select", meta={"linked": 3})
    plot.update_yaxes(title_text=said["error"])
    plot.update_xaxes(title_text=SIGNALS["q"], row=1, col=1)
    plot.update_xaxes(title_text=SIGNALS["t"], row=2, col=1)
    return plot


def _band(runs: Sequence[Rows], joint: int, half: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """The corners of a noise's band for each signal across, and where the error stands up; elsewhere it
    is none."""
    values = {name: np.concatenate([_signal(run, name, joint) for run in runs]) for name in SIGNALS}
    return (
        {name: np.array([x.min(), x.max(), x.max(), x.min()]) for name, x in values.items()},
        {"error": half * np.array([1.0, 1.0, -1.0, -1.0])},
    )


def _signal(run: Rows, name: str, joint: int) -> Array:
    """(M,) of SIGNALS along a run."""
    if name == "t":
        return run.motion.t
    values: Array = run.torque if name == "torque" else getattr(run.motion, name)
    return values[:, joint]


def _correlations(material: Material, n: int) -> Any:
    at = int(np.argmax([len(r.torque) for r in material.rows[material.last_name]]))
    runs = {name: material.rows[name][at] for name in material.models}
    lefts = {name: r.torque - predicted(r, material.models[name].theta) for name, r in runs.items()}
    motion = runs[material.last_name].motion
    plots = [
        correlation_figure(motion.t, {name: left[:, j] for name, left in lefts.items()}, motion.dq[:, j])
        for j in range(n)
    ]
    for plot in plots[1:]:
        plots[0].add_traces(plot.update_traces(visible=False).data)
    each = 2 * len(runs)
    buttons = [
        {
            "label": f"joint {j + 1}",
            "method": "restyle",
            "args": [{"visible": [k // each == j for k in range(each * n)]}],
        }
        for j in range(n)
    ]
    menu = {"buttons": buttons, "x": 0.0, "y": 1.2, "xanchor": "left"}
    return plots[0].update_layout(updatemenus=[menu])


def findings(material: Material) -> Section:
    """What a diagnosis says is missing: verdict, and a row a finding."""
    found = material.diagnosis
    if found is None:
        note = "No diagnosis was given. Name one with --findings findings.json."
        return Section("findings", "What is missing", text(note))
    rows = []
    for f in found.effects:
        joint = f.joints[0] - 1 if f.joints else 0
        fall = (f.held_out_rmse_before[joint], f.held_out_rmse_after[joint])
        rows.append(
            (
                f.effect,
                ", ".join(map(str, f.joints)) or "all",
                f.confidence,
                f"{number(f.size)} ± {number(f.std, 2)} {plain_unit(f.unit)}",
                ", ".join(f.indistinguishable_from) or "-",
                *(number(x, 3) for x in fall),
                number(found.noise_floor[joint], 3),
            )
        )
    heads = (
        "effect",
        "joint",
        "confidence",
        "size",
        "not told from",
        "held-out RMSE",
        "with it",
        "noise floor",
    )
    body = text(found.headline)
    if rows:
        names = ["model", *(f"+ {k}. {row[0]} {row[1]}" for k, row in enumerate(rows, start=1))]
        errors = [found.effects[0].held_out_rmse_before, *(f.held_out_rmse_after for f in found.effects)]
        plot = ladder_figure(names, errors, material.last.robot.torque_units)
        body += figure(plot, "Held-out RMS error of each joint, finding by finding.", 380)
        body += table(heads, rows, numbers_from=5)
    body += "".join(text(remark) for remark in (found.beside, *found.remarks) if remark)
    return Section("findings", "What is missing", body)


def curves(material: Material) -> Section:
    """What a diagnosis measured without a name: each curve with its band and where the data lie."""
    if material.diagnosis is None or not material.diagnosis.curves:
        note = "No measured curves. Name a diagnosis that has some with --findings findings.json."
        return Section("curves", "Missing torque without a name", text(note))
    body = ""
    units = material.last.robot.torque_units
    for curve in material.diagnosis.curves:
        said = curve.sentence(units)
        plot = missing_figure(curve, units, _along(curve, material))
        body += figure(plot, f"{said[0].upper()}{said[1:]}", 360)
    return Section("curves", "Missing torque without a name", body)


def _along(curve: Curve, material: Material) -> list[Array]:
    """Each variable of a curve along the judged runs."""
    parts = []
    for rows in material.rows[material.last_name]:
        motion = replace(rows.motion, torque=predicted(rows, material.last.theta))
        parts.append([Variable.parse(v).along(motion) for v in curve.of])
    return [np.concatenate(values) for values in zip(*parts, strict=True)]
