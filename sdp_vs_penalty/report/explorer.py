"""The sections of the report that show the error itself: against any signal, and as measured curves."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sdp_vs_penalty.diagnosis.comparison import predicted
from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.effects.curve_variable import Variable
from sdp_vs_penalty.report.plots import (
    COLOURS,
    SIGNALS,
    ladder_figure,
    missing_figure,
    noise_band,
    scatter_rows,
)
from sdp_vs_penalty.report.section import Material, Section, figure, number, table, text
from sdp_vs_penalty.robot.arrays import Array

#: Lags of a correlation.
_LAGS = 40


def explorer(material: Material) -> Section:
    """The error of each joint against a signal, and its correlations; joint and signal are chosen."""
    n, units = material.last.robot.n, material.last.robot.torque_units
    body = text(
        "Measured less modelled torque of one joint against a signal of it. Reversals of the joint are "
        "ringed; the band is 1.96 noise floors wide to either side, where the noise is known."
    )
    body += figure(_scatter(material, n, units), "Choose joint and signal above the figure.", 460)
    body += text(
        "Correlation of the error with itself and with the joint's velocity at later instants; grey: "
        "where 95 % of the correlations of unrelated signals lie, 1.96 / sqrt(N)."
    )
    body += figure(_correlations(material, n), "Choose the joint above the figure.", 380)
    return Section("explorer", "Where it fails, seen", body)


def _scatter(material: Material, n: int, units: tuple[str, ...] | list[str]) -> Any:
    from plotly.graph_objects import Figure, Scatter

    plot = Figure()
    runs = next(iter(material.rows.values()))
    signals = {
        name: np.concatenate(
            [
                np.repeat(r.motion.t[:, None], n, axis=1)
                if name == "t"
                else (r.torque if name == "torque" else getattr(r.motion, name))
                for r in runs
            ]
        )
        for name in SIGNALS
    }
    xs: dict[str, list[Array]] = {name: [] for name in SIGNALS}
    for j in range(n):
        keep, turns = scatter_rows(signals["dq"][:, j])
        for m, (name, estimate) in enumerate(material.models.items()):
            left = np.concatenate([r.torque - predicted(r, estimate.theta) for r in material.rows[name]])
            for rows, symbol in ((keep, "circle"), (turns, "circle-open")):
                marker = {"size": 3 if symbol == "circle" else 8, "symbol": symbol}
                plot.add_trace(
                    Scatter(
                        x=signals["q"][rows, j],
                        y=left[rows, j],
                        mode="markers",
                        name=name if symbol == "circle" else f"{name}, reversals",
                        marker={**marker, "color": COLOURS[m % len(COLOURS)]},
                        visible=j == 0,
                    )
                )
                for signal in SIGNALS:
                    xs[signal].append(signals[signal][rows, j])
    traces = len(plot.data) // n
    floor = material.comparisons[-1].noise_floor
    shows: list[dict[str, Any]] = []
    for j in range(n):
        bands = [] if floor is None else noise_band(1.96 * floor[j])
        visible = [k // traces == j for k in range(len(plot.data))]
        axis = {"yaxis.title.text": f"error of joint {j + 1} [{units[j]}]", "shapes": bands}
        shows.append(
            {"label": f"joint {j + 1}", "method": "update", "args": [{"visible": visible}, axis]}
        )
    moves = [
        {"label": said, "method": "update", "args": [{"x": xs[s]}, {"xaxis.title.text": said}]}
        for s, said in SIGNALS.items()
    ]
    plot.update_layout(
        shapes=shows[0]["args"][1]["shapes"],
        updatemenus=[
            {"buttons": shows, "x": 0.0, "y": 1.18, "xanchor": "left"},
            {"buttons": moves, "x": 0.2, "y": 1.18, "xanchor": "left"},
        ],
    )
    plot.update_yaxes(title_text=f"error of joint 1 [{units[0]}]")
    plot.update_xaxes(title_text=SIGNALS["q"])
    return plot


def correlation(a: Array, b: Array, lags: int = _LAGS) -> Array:
    """(lags + 1,) of a(t) with b(t + lag), normalised by the lengths of both."""
    a, b = a - a.mean(), b - b.mean()
    scale = np.sqrt((a @ a) * (b @ b))
    if scale == 0.0:
        return np.zeros(lags + 1)
    return np.array([float(a[: len(a) - k] @ b[k:]) for k in range(lags + 1)]) / scale


def _correlations(material: Material, n: int) -> Any:
    from plotly.graph_objects import Figure, Scatter

    plot = Figure()
    # Filtered rows are oversampled twice: every second one is a sample of its own.
    longest = max(material.rows[material.last_name], key=lambda r: len(r.torque))
    left = (longest.torque - predicted(longest, material.last.theta))[::2]
    dq, t = longest.motion.dq[::2], longest.motion.t[::2]
    lags = min(_LAGS, len(t) // 4)
    x = np.arange(lags + 1) * float(np.median(np.diff(t)))
    for j in range(n):
        for name, other, colour in (
            ("with itself", left[:, j], COLOURS[0]),
            ("with the velocity", dq[:, j], COLOURS[1]),
        ):
            y = correlation(left[:, j], other, lags)
            line = {"color": colour}
            plot.add_trace(Scatter(x=x, y=y, name=name, mode="lines+markers", line=line, visible=j == 0))
    buttons = [
        {
            "label": f"joint {j + 1}",
            "method": "restyle",
            "args": [{"visible": [k // 2 == j for k in range(2 * n)]}],
        }
        for j in range(n)
    ]
    plot.update_layout(
        shapes=noise_band(1.96 / np.sqrt(max(len(t), 1))),
        updatemenus=[{"buttons": buttons, "x": 0.0, "y": 1.2, "xanchor": "left"}],
    )
    plot.update_xaxes(title_text="lag [s]")
    plot.update_yaxes(title_text="correlation", range=[-1.05, 1.05])
    return plot


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
                f"{number(f.size)} ± {number(f.std, 2)} {f.unit}",
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
    body += "".join(text(remark) for remark in found.remarks)
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
