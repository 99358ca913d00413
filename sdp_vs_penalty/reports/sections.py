"""The sections of the report about how well the models predict."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from sdp_vs_penalty import show
from sdp_vs_penalty.diagnosis.comparison import predicted
from sdp_vs_penalty.diagnosis.show import new_motion
from sdp_vs_penalty.diagnosis.where_it_fails import sentences
from sdp_vs_penalty.effects.model import JointColumns
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.verdict import changes
from sdp_vs_penalty.reports.figure import trace
from sdp_vs_penalty.reports.pictures import (
    SHADES,
    bars,
    found_shares,
    heat_map,
    heat_rows,
    legend,
    shades,
)
from sdp_vs_penalty.reports.plots import POINTS, Curves, torque_figure
from sdp_vs_penalty.reports.section import (
    JOINT_HEIGHT,
    Material,
    Section,
    figure,
    marked,
    number,
    table,
    text,
)
from sdp_vs_penalty.robot.arrays import Array


def verdict(material: Material) -> Section:
    """How good the last model is, what became of each joint's error, and each model in a line."""
    said, first, last = material.verdict, material.comparisons[0], material.comparisons[-1]
    several = len(material.comparisons) > 1
    body = f'<p class="verdict {said.grade.replace(" ", "-")}">{marked(said.headline)}</p>'
    if several and (changed := changes(first.rmse, last.rmse, last.noise_floor)):
        body += f"<p><b>{escape(changed)}</b></p>"
    floor = None if last.noise_floor is None else last.noise_floor.tolist()
    after = last.rmse.tolist() if several else None
    body += bars(first.rmse.tolist(), after, floor, material.last.robot.torque_units)
    lines = [(line.about, line.grade, line.text) for line in said.lines]
    body += table((material.last_name, "grade", "why"), lines, numbers_from=3)
    if said.remark:
        body += text(said.remark)
    rows = []
    for name, comparison in zip(material.models, material.comparisons, strict=True):
        estimate = material.models[name]
        worst = estimate.certificate.worst
        rows.append(
            (
                name,
                comparison.verdict.grade,
                estimate.method,
                len(estimate.theta),
                f"{comparison.relative_error_percent:.3f} %",
                new_motion(comparison.new_motion_share),
                "every constraint holds" if worst == 0.0 else f"violated by {worst:.2g}",
                number(estimate.certificate.gap, 2),
            )
        )
    heads = ("model", "grade", "method", "parameters", "relative error", "new motion", "constraints")
    body += table((*heads, "certified gap"), rows, numbers_from=3)
    m = material.measurements
    seconds = sum(float(run.t[-1] - run.t[0]) for run in m.runs())
    body += text(
        f"{material.last.robot.name}, {show.count(material.last.robot.n, 'joint')}. Judged on "
        f"{show.count(len(m.names), 'run')}, {len(m.t)} samples, {seconds:.3g} s: "
        f"{', '.join(m.names)}. Measured and modelled torques passed the same low-pass at "
        f"{material.comparisons[0].band_hz:.3g} Hz."
    )
    return Section("verdict", "Verdict", body)


def torques(material: Material) -> Section:
    """Measured and modelled torque of each joint, and what is left."""
    shade: dict[str, Any] = {"line": {"width": 0}, "showlegend": False, "hoverinfo": "skip"}
    n, units = material.last.robot.n, material.last.robot.torque_units
    runs = [
        Curves(
            run.motion.t,
            run.torque,
            {
                name: predicted(material.rows[name][index], estimate.theta)
                for name, estimate in material.plants.items()
            },
        )
        for index, run in enumerate(next(iter(material.rows.values())))
    ]
    failing = material.failures[material.first_name]
    causes = [c for c in SHADES if any(s.cause == c for f in failing for s in f.stretches)]
    body = text(
        "Left: measured and modelled torque. Right: the errors on the same time axis. Click a name to "
        f"hide it, drag to look closer. Grey band: where 95 % of the errors of {material.last_name} "
        "should lie, given its parameters' uncertainty and what it left of its own training runs."
    )
    body += legend(causes)
    bands, starts = _bands(material), run_starts(material)
    for j in range(n):
        plot = torque_figure(runs, j, units[j])
        for t, half in bands:  # around a zero error, beside the errors
            for bound, fill in ((half[:, j], None), (-half[:, j], "tonexty")):
                filled = {"fill": fill, "fillcolor": "rgba(128,128,128,0.25)", **shade}
                plot.add(trace("scatter", x=t, y=bound, **filled), 1)
        placed = [
            (s.start + shift, s.stop + shift, s.cause)
            for s in failing[j].stretches
            for name, shift in starts.items()
            if s.run.startswith(name)
        ]
        plot.update_layout(shapes=shades(placed, ("x", "x2")))
        plot.update_axes("x", 1, matches="x")
        body += figure(plot, "", JOINT_HEIGHT, "torques")
    return Section("torques", "Where and when: measured against modelled", body)


def run_starts(material: Material) -> dict[str, float]:
    """By run what is added to its clock on the figures, where runs follow each other."""
    starts, start = {}, 0.0
    names = [run.names[0] for run in material.measurements.runs()]
    for name, rows in zip(names, material.rows[material.first_name], strict=True):
        t = rows.motion.t
        starts[name] = start - float(t[0])
        start += float(t[-1] - t[0]) + 1.0
    return starts


def _bands(material: Material) -> list[tuple[Array, Array]]:
    """Of each run instants (m,) on the figures' axis and half the last model's band (m, n) there."""
    last = material.plants[material.last_name]
    known = last.uncertainty
    bands, start = [], 0.0
    for rows in material.rows[material.last_name]:
        t = rows.motion.t - rows.motion.t[0] + start
        keep = np.unique(np.linspace(0, len(t) - 1, min(len(t), POINTS)).astype(int))
        few = [JointColumns(c.indices, c.columns[keep]) for c in rows.columns]
        half = NORMAL_95 * np.hypot(known.band(last.theta, few)[1], known.noise)
        bands.append((t[keep], half))
        start = float(t[-1]) + 1.0
    return bands


def history(material: Material) -> Section:
    """The error of every joint, model by model, above the noise."""
    heads = ["joint"]
    for c in material.comparisons:
        heads += [f"RMSE {c.name}", "R2"]
    floor = material.comparisons[-1].noise_floor
    rows = []
    for j, unit in enumerate(material.last.robot.torque_units):
        cells: list[object] = [f"{j + 1} [{show.plain_unit(unit)}]"]
        for c in material.comparisons:
            cells += [number(c.rmse[j]), number(c.r2[j])]
        rows.append([*cells, "-" if floor is None else number(floor[j])])
    totals: list[object] = ["all, relative error"]
    for c in material.comparisons:
        totals += [f"{c.relative_error_percent:.3f} %", ""]
    rows.append([*totals, ""])
    made = []
    known: set[str] = set()
    for name, estimate in material.models.items():
        new = [e.brief for e in estimate.model.effects if e.text not in known]
        made.append((name, estimate.method, ", ".join(new) or "the same effects"))
        known |= {e.text for e in estimate.model.effects}
    body = table(("model", "method", "new effects"), made, numbers_from=3)
    body += table([*heads, "noise floor"], rows)
    if floor is None:
        body += text("No motion repeats in these runs: the noise floor is unknown.")
    return Section("history", "From model to model", body)


def forward(material: Material) -> Section:
    """The last model run forward: after one sample, 0.1 s ahead, and freely from the first state."""
    title, made = "Run forward", material.forward
    if isinstance(made, str):
        return Section("forward", title, text(f"{material.last_name} cannot be simulated: {made}"))
    runs = [Curves(f.simulated.t, f.measured, {material.last_name: f.simulated.q}) for f in made.free]
    body = text(made.verdict) + table(*made.table(), numbers_from=2) + text(made.explained)
    body += text(
        "Left: measured and simulated position of the free run, until the arm leaves the measured "
        "motion. Right: its error."
        + " `report --forward` goes on to the run's end."
        * any(f.cut for f in made.free)
    )
    for j, unit in enumerate(made.units):
        body += figure(torque_figure(runs, j, unit), "", JOINT_HEIGHT, "forward")
    return Section("forward", title, body)


def failures(material: Material) -> Section:
    """Which cause explains how much of each joint's error, before and after, and in words."""
    found = found_shares(material.diagnosis, material.last.robot.n)
    body = text(
        "How much of each joint's error a function of each cause explains on held-out data, in per "
        "cent; causes that explain nothing are left out. `sdp-vs-penalty diagnose` names effects."
    )
    maps = ""
    for k, (name, failing) in enumerate(material.failures.items()):
        rows = heat_rows([f.to_dict() for f in failing], found if k == 0 else {})
        maps += heat_map(name, rows, len(failing))
    body += f'<div class="maps wide" tabindex="0">{maps}</div>'
    last = material.failures[material.last_name]
    said = [
        (
            str(f.joint),
            " ".join(sentences(f, material.last.robot.torque_units[f.joint - 1])),
            number(f.rmse),
            number(f.noise_floor),
        )
        for f in last
    ]
    heads = ("joint", f"where {material.last_name} errs", "RMS error", "noise floor")
    return Section("failures", "Why", body + table(heads, said, numbers_from=2))
