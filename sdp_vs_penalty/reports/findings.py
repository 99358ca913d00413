"""The section of the report about a diagnosis: what was found, by name and as measured curves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.diagnosis.comparison import predicted, still_missing
from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.effects.curve_variable import Variable
from sdp_vs_penalty.reports.pictures import bars
from sdp_vs_penalty.reports.plots import missing_figure
from sdp_vs_penalty.reports.section import Material, Section, figure, number, table, text
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.show import plain_unit


def findings(material: Material) -> Section:
    """What a diagnosis says: verdict, what the last model still lacks, a row a finding, each curve."""
    found = material.diagnosis
    if found is None:
        note = "No diagnosis was given. Name one with `--findings findings.json`."
        return Section("findings", "What is missing", text(note))
    title = "What was found"
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
    told = f": {found.headline}" if found.effects else ""
    body = text(f"In the model that was diagnosed{told}" if told else found.headline)
    body += text(f"In {material.last_name}: {still_missing(found, material.last)}") if told else ""
    if rows:
        first, last = found.effects[0].held_out_rmse_before, found.effects[-1].held_out_rmse_after
        floor = found.noise_floor.tolist() if found.noise_known else None
        body += text("Held-out error of each joint before all findings and with all of them:")
        body += bars(list(first), list(last), floor, material.last.robot.torque_units)
        body += table(heads, rows, numbers_from=5)
    body += "".join(text(remark) for remark in (found.beside, *found.remarks) if remark)
    units = material.last.robot.torque_units
    for curve in found.curves:
        said = curve.sentence(units)
        plot = missing_figure(curve, units, _along(curve, material))
        body += figure(plot, f"{said[0].upper()}{said[1:]}", 360)
    return Section("findings", title, body)


def _along(curve: Curve, material: Material) -> list[Array]:
    """Each variable of a curve along the judged runs."""
    parts = []
    for rows in material.rows[material.last_name]:
        theta = material.plants[material.last_name].theta
        motion = replace(rows.motion, torque=predicted(rows, theta))
        parts.append([Variable.parse(v).along(motion) for v in curve.of])
    return [np.concatenate(values) for values in zip(*parts, strict=True)]
