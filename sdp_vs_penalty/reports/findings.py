"""The sections of the report about a diagnosis: what is missing, by name and as measured curves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.diagnosis.comparison import predicted
from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.effects.curve_variable import Variable
from sdp_vs_penalty.reports.plots import history_figure, missing_figure
from sdp_vs_penalty.reports.section import Material, Section, figure, number, table, text
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.show import plain_unit


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
        plot = history_figure(names, errors, material.last.robot.torque_units)
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
