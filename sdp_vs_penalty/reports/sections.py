"""The sections of the report, but for those about the parameters."""

from collections.abc import Sequence
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.comparison import Comparison, still_missing
from sdp_vs_penalty.diagnosis.where_it_fails import sentences
from sdp_vs_penalty.effects.model import JointColumns
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.verdict import changes
from sdp_vs_penalty.formatting import number, plain_unit
from sdp_vs_penalty.reports import markup
from sdp_vs_penalty.reports.markup import Material, figure, table, text
from sdp_vs_penalty.reports.plots import POINTS, Curves, missing_figure, shifts, torque_figure, trace
from sdp_vs_penalty.robot.arrays import Array

#: What :func:`judged_row` says after the model's name; possible : its links can exist, within bounds.
JUDGED_HEADS = ("verdict", "error %", "worst/noise", "possible", "thinnest mm", "gap")


def judged_row(c: Comparison) -> list[str]:
    """One model on the judged runs, as text."""
    certificate = c.estimate.certificate
    over = None if c.noise_floor is None else float((c.rmse / c.noise_floor).max())
    thin, gap = certificate.smallest_thickness, certificate.gap
    cells = [c.name, c.verdict.grade, number(c.relative_error_percent), number(over)]
    cells += ["yes" if certificate.worst <= 1e-9 else "no", number(thin and 1e3 * thin)]
    return [*cells, "-" if gap is None else f"{gap:.0e}"]


def verdict(material: Material) -> str:
    """How good the last model is, what became of each joint's error, and each model in a line."""
    said, first, last = material.verdict, material.comparisons[0], material.comparisons[-1]
    several = len(material.comparisons) > 1
    body = f'<p class="verdict {said.grade.replace(" ", "-")}">{markup.marked(said.headline)}</p>'
    if several and (changed := changes(first.rmse, last.rmse, last.noise_floor)):
        body += f"<p><b>{escape(changed[0].upper() + changed[1:])}</b></p>"
    floor = None if last.noise_floor is None else last.noise_floor.tolist()
    after = last.rmse.tolist() if several else None
    body += markup.bars(first.rmse.tolist(), after, floor, material.last.robot.torque_units)
    lines = [(line.about, line.grade, line.text) for line in said.lines]
    body += table(("verdict", "grade", "why"), lines, numbers_from=3)
    if said.remark:
        body += text(said.remark)
    body += table(("model", *JUDGED_HEADS), list(map(judged_row, material.comparisons)), numbers_from=2)
    m = material.measurements
    seconds = sum(float(run.t[-1] - run.t[0]) for run in m.runs())
    body += text(
        f"{material.last.robot.name}, {formatting.count(material.last.robot.n, 'joint')}. Judged on "
        f"{formatting.count(len(m.names), 'run')}, {len(m.t)} samples, {seconds:.3g} s: "
        f"{', '.join(m.names)}. Measured and modelled torques passed the same low-pass at "
        f"{material.comparisons[0].band_hz:.3g} Hz."
    )
    return body


def torques(material: Material) -> str:
    """Measured and modelled torque of each joint, and what is left."""
    shade: dict[str, Any] = {"line": {"width": 0}, "showlegend": False, "hoverinfo": "skip"}
    units, first = material.last.robot.torque_units, material.judged[material.first_name]
    moved = shifts([run.motion.t for run, _ in first])
    modelled = [{name: each[k][1] for name, each in material.judged.items()} for k in range(len(first))]
    runs = [
        Curves(run.motion.t + shift, run.torque, of)
        for (run, _), shift, of in zip(first, moved, modelled, strict=True)
    ]
    failing = material.failures[material.first_name]
    causes = [c for c in markup.SHADES if any(s.cause == c for f in failing for s in f.stretches)]
    body = text(
        "Left: measured and modelled torque. Right: the errors on the same time axis. Click a name to "
        f"hide it, drag to look closer. Grey band: where 95 % of the errors of {material.last_name} "
        "should lie, given its parameters' uncertainty and what it left of its own training runs."
    )
    body += markup.legend(causes)
    bands = _bands(material, moved)
    for j, unit in enumerate(units):
        plot = torque_figure(runs, j, unit)
        for t, half in bands:  # around a zero error, beside the errors
            for bound, fill in ((half[:, j], None), (-half[:, j], "tonexty")):
                filled = {"fill": fill, "fillcolor": "rgba(128,128,128,0.25)", **shade}
                plot.add(trace("scatter", x=t, y=bound, **filled), 1)
        placed = [
            (s.start + shift, s.stop + shift, s.cause)
            for s in failing[j].stretches
            for run, shift in zip(material.measurements.runs(), moved, strict=True)
            if s.run.startswith(run.names[0]) and run.t[0] <= s.start <= run.t[-1]
        ]
        plot.update_layout(shapes=markup.shades(placed))
        plot.update_axes("x", 1, matches="x")
        body += figure(plot, group="torques")
    return body


def _bands(material: Material, moved: Sequence[float]) -> list[tuple[Array, Array]]:
    """Of each run instants (m,) on the figures' axis and half the last model's band (m, n) there."""
    theta, known = material.plant.theta, material.plant.uncertainty
    bands = []
    for (rows, _), shift in zip(material.judged[material.last_name], moved, strict=True):
        t = rows.motion.t + shift
        keep = np.unique(np.linspace(0, len(t) - 1, min(len(t), POINTS)).astype(int))
        few = [JointColumns(c.indices, c.columns[keep]) for c in rows.columns]
        half = NORMAL_95 * np.hypot(known.band(theta, few)[1], known.torque_noise)
        bands.append((t[keep], half))
    return bands


def history(material: Material) -> str:
    """What each model added, and the error of every joint, model by model, above the noise."""
    compared, made, known = material.comparisons, [], set[str]()
    for name, estimate in material.models.items():
        new = ", ".join(e.brief for e in estimate.model.effects if e.text not in known)
        made.append((name, estimate.method, len(estimate.theta), new or "the same effects"))
        known |= {e.text for e in estimate.model.effects}
    body = table(("model", "method", "parameters", "new effects"), made, numbers_from=4)
    names, errors = [f"RMSE {c.name}" for c in compared], [c.rmse for c in compared]
    floor, units = compared[-1].noise_floor, material.last.robot.torque_units
    body += table(*formatting.error_table(names, errors, floor, units, compared[-1].r2))
    if floor is None:
        body += text("No motion repeats in these runs: the noise floor is unknown.")
    return body


def forward(material: Material) -> str:
    """The last model run forward: after one step, 0.1 s ahead, and freely from the first state."""
    made = material.forward
    if isinstance(made, str):
        return text(f"{material.last_name} cannot be simulated: {made}")
    body = text(made.verdict) + table(*made.table(), numbers_from=2) + text(made.explained)
    if any(f.cut for f in made.free):
        return body + text("`report --forward` goes on to the run's end, and shows the positions.")
    body += text("Left: measured and simulated position of the free run. Right: its error.")
    runs = [
        Curves(f.simulated.t + shift, f.measured, {material.last_name: f.simulated.q})
        for f, shift in zip(made.free, shifts([f.simulated.t for f in made.free]), strict=True)
    ]
    for j, unit in enumerate(made.units):
        body += figure(torque_figure(runs, j, unit), group="forward")
    return body


def failures(material: Material) -> str:
    """Which cause explains how much of each joint's error, before and after, and in words."""
    found = markup.found_shares(material.diagnosis, material.last.robot.n)
    body = text(
        "How much of each joint's error a function of each cause explains on held-out data, in per "
        "cent; causes that explain nothing are left out. `sdp-vs-penalty diagnose` names effects."
    )
    maps = ""
    for name, failing in material.failures.items():
        rows = markup.heat_rows([f.to_dict() for f in failing], {} if maps else found)
        maps += markup.heat_map(name, rows, len(failing))
    body += f'<div class="maps wide" tabindex="0">{maps}</div>'
    last = material.failures[material.last_name]
    units = material.last.robot.torque_units
    said = [
        (f.joint, " ".join(sentences(f, unit)), number(f.rmse, 4), number(f.noise_floor, 4))
        for f, unit in zip(last, units, strict=True)
    ]
    heads = ("joint", f"where {material.last_name} errs", "RMS error", "noise floor")
    return body + table(heads, said, numbers_from=2)


def findings(material: Material) -> str:
    """What a diagnosis says: verdict, what the last model still lacks, a row a finding, each curve."""
    found = material.diagnosis
    if found is None:
        return text("No diagnosis was given. Name one with `--findings findings.json`.")
    rows, units = [], material.last.robot.torque_units
    for f in found.effects:
        joint = f.joints[0] - 1 if f.joints else 0
        errors = f.held_out_rmse_before, f.held_out_rmse_after, found.noise_floor
        size = f"{number(f.size, 4)} ± {number(f.std, 2)} {plain_unit(f.unit)}"
        joints, rivals = ", ".join(map(str, f.joints)), ", ".join(f.indistinguishable_from)
        own = (number(x[joint]) for x in errors)
        rows.append((f.effect, joints or "all", f.confidence, size, rivals or "-", *own))
    heads = ("effect", "joint", "confidence", "size", "not told from", "held-out RMSE", "with it")
    told = f": {found.headline}" if found.effects else ""
    body = text(f"In the model that was diagnosed{told}" if told else found.headline)
    body += text(f"In {material.last_name}: {still_missing(found, material.last)}") if told else ""
    if rows:
        first, last = found.effects[0].held_out_rmse_before, found.effects[-1].held_out_rmse_after
        floor = found.noise_floor.tolist() if found.noise_known else None
        body += text("Held-out error of each joint before all findings and with all of them:")
        body += markup.bars(list(first), list(last), floor, units)
        body += table((*heads, "noise floor"), rows, numbers_from=5)
    body += "".join(text(remark) for remark in found.remarks)
    judged = material.judged[material.last_name]
    motions = [replace(rows.motion, torque=modelled) for rows, modelled in judged]
    for curve in found.curves:
        said = curve.sentence(units)
        plot = missing_figure(curve, units, motions)
        body += figure(plot, f"{said[0].upper()}{said[1:]}", 360)
    return body


def certificate_rows(estimates: Sequence[Estimate]) -> list[list[str]]:
    """What is certified of each, as the command line says it: a row a figure, its name first."""
    told = [dict(e.certificate.summary()) for e in estimates]
    names = dict.fromkeys(name for own in told for name in own)
    return [[name, *(own.get(name, "-") for own in told)] for name in names]


#: What the certificate says, and who computed it.
CERTIFICATE = (
    "Violations of every family of constraints, including those that a method did not receive. The "
    "lower bound is computed here from dual multipliers, independently of what a solver claims."
)


def certificate(material: Material) -> str:
    """Computed by this program, whoever solved the problem."""
    rows = certificate_rows(list(material.models.values()))
    return text(CERTIFICATE) + table(["figure", *material.models], rows, numbers_from=len(rows[0]))


def data(material: Material) -> str:
    """What `sdp-vs-penalty check` says of the runs."""
    parts = []
    for run, found in material.checks.items():
        parts.append(f"<h3>{escape(run)}</h3>")
        if all(f["severity"] == "note" for f in found):
            parts.append(text("No problems found."))
        for f in ({name: escape(str(x)) for name, x in f.items()} for f in found):
            parts.append(
                f'<div class="finding {f["severity"]}"><b>{f["kind"]}</b> ({f["where"]}): {f["what"]} '
                f"<span>How sure: {f['certainty']}. What to do: {f['remedy']}.</span></div>"
            )
    return "".join(parts)


def provenance(material: Material) -> str:
    """Versions, settings, hashes, and the commands."""
    rows = []
    for name, e in material.models.items():
        settings = ", ".join(f"{k}={v}" for k, v in e.settings.items())
        p, known = e.preprocessing, e.provenance
        said = {
            "method": f"{e.method} ({settings})",
            "effects": ", ".join(effect.brief for effect in e.model.effects),
            "filters": f"states {number(p.state_cutoff, 4)} Hz, torque {number(p.torque_cutoff, 4)} Hz",
            "runs": ", ".join(map(str, known.get("runs", []))),
            "data hash": known.get("data_hash", ""),
            "seed": known.get("seed", ""),
            "versions": ", ".join(f"{k} {v}" for k, v in known.get("versions", {}).items()),
        }
        rows += [(name, what, value) for what, value in said.items()]
    body = table(("model", "what", "which"), rows, numbers_from=3)
    if material.commands:
        body += f"<pre tabindex=0>{escape(chr(10).join(material.commands))}</pre>"
    return body
