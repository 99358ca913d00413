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
from sdp_vs_penalty.estimation.sandwich import NORMAL_95
from sdp_vs_penalty.report.plots import POINTS, Curves, ladder_figure, torque_figure
from sdp_vs_penalty.report.section import JOINT_HEIGHT, Material, Section, figure, number, table, text
from sdp_vs_penalty.robot.arrays import Array


def summary(material: Material) -> Section:
    """One line a model: its error, its constraints, its certificate."""
    rows = []
    for name, comparison in zip(material.models, material.comparisons, strict=True):
        estimate = material.models[name]
        worst = estimate.certificate.worst
        rows.append(
            (
                name,
                estimate.method,
                len(estimate.theta),
                f"{comparison.relative_error_percent:.3f} %",
                new_motion(comparison.new_motion_share),
                "every constraint holds" if worst == 0.0 else f"violated by {worst:.2g}",
                number(estimate.certificate.gap, 2),
            )
        )
    m = material.measurements
    seconds = sum(float(run.t[-1] - run.t[0]) for run in m.runs())
    body = text(
        f"{material.last.robot.name}, {show.count(material.last.robot.n, 'joint')}. Judged on "
        f"{show.count(len(m.names), 'run')}, {len(m.t)} samples, {seconds:.3g} s: "
        f"{', '.join(m.names)}. Measured and modelled torques passed the same low-pass at "
        f"{material.comparisons[0].band_hz:.3g} Hz."
    )
    heads = (
        "model",
        "method",
        "parameters",
        "relative error",
        "new motion",
        "constraints",
        "certified gap",
    )
    verdict = material.verdict
    lines = [(line.about, line.grade, line.text) for line in verdict.lines]
    body = (
        f'<p class="verdict {verdict.grade.replace(" ", "-")}">{escape(verdict.headline)}</p>'
        + table((material.last_name, "grade", "why"), lines, numbers_from=3)
        + body
    )
    return Section("summary", "Summary", body + table(heads, rows, numbers_from=2))


def torques(material: Material) -> Section:
    """Measured and modelled torque of each joint, and what is left."""
    from plotly.graph_objects import Scatter

    shade: dict[str, Any] = {"line": {"width": 0}, "showlegend": False, "hoverinfo": "skip"}
    n, units = material.last.robot.n, material.last.robot.torque_units
    runs = [
        Curves(
            run.motion.t,
            run.torque,
            {
                name: predicted(material.rows[name][index], estimate.theta)
                for name, estimate in material.models.items()
            },
        )
        for index, run in enumerate(next(iter(material.rows.values())))
    ]
    body = text(
        "Left: measured and modelled torque. Right: the residuals. Click a name to hide it, drag to "
        f"look closer. Shaded: where 95 % of the errors of {material.last_name} should lie, given its "
        "parameters' uncertainty and what it left of its own training runs."
    )
    bands = _bands(material)
    for j in range(n):
        plot = torque_figure(runs, j, units[j])
        for t, half in bands:  # around a zero error, beside the errors
            for bound, fill in ((half[:, j], None), (-half[:, j], "tonexty")):
                band = Scatter(x=t, y=bound, fill=fill, fillcolor="rgba(128,128,128,0.25)", **shade)
                plot.add_trace(band, row=1, col=2)
        body += figure(plot, "", JOINT_HEIGHT, "torques")
    return Section("torques", "Measured against modelled", body)


def _bands(material: Material) -> list[tuple[Array, Array]]:
    """Of each run instants (m,) on the figures' axis and half the last model's band (m, n) there."""
    last, known = material.last, material.last.uncertainty
    bands, start = [], 0.0
    for rows in material.rows[material.last_name]:
        t = rows.motion.t - rows.motion.t[0] + start
        keep = np.unique(np.linspace(0, len(t) - 1, min(len(t), POINTS)).astype(int))
        few = [JointColumns(c.indices, c.columns[keep]) for c in rows.columns]
        half = NORMAL_95 * np.hypot(known.band(last.theta, few)[1], known.noise)
        bands.append((t[keep], half))
        start = float(t[-1]) + 1.0
    return bands


def ladder(material: Material) -> Section:
    """The error of every joint, model by model, above the noise."""
    names = list(material.models)
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
    if len(names) > 1:
        errors = [c.rmse for c in material.comparisons]
        plot = ladder_figure(names, errors, material.last.robot.torque_units)
        body += figure(plot, "RMS error of each joint from model to model.", 380)
    body += table([*heads, "noise floor"], rows)
    if floor is None:
        body += text("No motion repeats in these runs: the noise floor is unknown.")
    return Section("ladder", "From model to model", body)


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
    """What the error of the last model looks like, joint by joint."""
    rows = []
    for f in material.failures:
        said = " ".join(sentences(f, material.last.robot.torque_units[f.joint - 1]))
        rows.append((str(f.joint), said, number(f.rmse), number(f.noise_floor)))
    heads = ("joint", "where", "RMS error", "noise floor")
    body = text(
        f"How much of the error of {material.last_name} a smooth function of each quantity explains on "
        "held-out data, and where it is large. `sdp-vs-penalty diagnose` names causes."
    )
    return Section("failures", "Where it fails", body + table(heads, rows, numbers_from=2))
