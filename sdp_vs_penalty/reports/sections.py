"""The sections of the report, and what they are made of."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.comparison import Comparison, still_missing
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.where_it_fails import JointFailure, sentences
from sdp_vs_penalty.effects.model import JointColumns
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import LINK_HEADS, Estimate, link_rows, seen
from sdp_vs_penalty.estimation.uncertainty import Interval, counts
from sdp_vs_penalty.estimation.verdict import Verdict, changes
from sdp_vs_penalty.exporters.friction_table import friction_curves
from sdp_vs_penalty.formatting import number
from sdp_vs_penalty.reports import markup, plots
from sdp_vs_penalty.reports.markup import figure, table, text
from sdp_vs_penalty.reports.plots import COLOURS, MEASURED
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.filtered import Rows
from sdp_vs_penalty.simulation.follow import Following


@dataclass(frozen=True)
class ReportData:
    """Everything that the sections show, computed once.

    models : by name, in the order in which effects were added; the last one is looked
    at closely; judged : of each model the filtered rows of each run, and their modelled
    torque (M, n); failures : of the first model and of the last; checks : of each run,
    what Issue.to_dict() says; forward : the last model run forward, or the sentence why
    it cannot; commands : that made this report; diagnosis : of one of the models, where
    there is one.
    """

    models: Mapping[str, Estimate]
    measurements: Measurements
    comparisons: Sequence[Comparison]
    judged: Mapping[str, Sequence[tuple[Rows, Array]]]
    failures: Mapping[str, Sequence[JointFailure]]
    checks: Mapping[str, Sequence[Mapping[str, Any]]]
    forward: Following | str
    commands: Sequence[str]
    diagnosis: Diagnosis | None = None

    @property
    def last(self) -> Estimate:
        return list(self.models.values())[-1]

    @property
    def verdict(self) -> Verdict:
        """That of the last model."""
        forward_verdict = "" if isinstance(self.forward, str) else self.forward.verdict
        missing = (
            "" if self.diagnosis is None else still_missing(self.diagnosis, self.last)
        )
        return self.comparisons[-1].verdict_with(missing, forward_verdict)

    @property
    def name(self) -> str:
        """Of the last model."""
        return self.comparisons[-1].name


#: What :func:`judged_row` says after the model's name; possible : its links can exist,
#: within bounds.
JUDGED_HEADS = ("verdict", "error %", "worst/noise", "possible", "thinnest mm", "gap")


def judged_row(c: Comparison) -> list[str]:
    """One model on the judged runs, as text."""
    certificate = c.estimate.certificate
    over = None if c.noise_floor is None else float((c.rmse / c.noise_floor).max())
    thin = certificate.smallest_thickness
    gap = certificate.gap
    cells = [c.name, c.verdict.grade, number(c.relative_error_percent), number(over)]
    cells += ["yes" if certificate.worst <= 1e-9 else "no", number(thin and 1e3 * thin)]
    return [*cells, "-" if gap is None else f"{gap:.0e}"]


def verdict(material: ReportData) -> str:
    """How good the last model is, what became of each joint's error, and each model in
    a line."""
    verdict_record = material.verdict
    first = material.comparisons[0]
    last = material.comparisons[-1]
    several = len(material.comparisons) > 1
    body = (
        '<p class="verdict'
        f' {verdict_record.grade.replace(" ", "-")}">{markup.marked(verdict_record.headline)}</p>'
    )
    if several and (changed := changes(first.rmse, last.rmse, last.noise_floor)):
        body += f"<p><b>{escape(changed[0].upper() + changed[1:])}</b></p>"
    after = last.rmse if several else None
    units = material.last.robot.torque_units
    body += markup.bars(first.rmse, after, last.noise_floor, units)
    lines = [(line.about, line.grade, line.text) for line in verdict_record.lines]
    body += table(("verdict", "grade", "why"), lines, numbers_from=3)
    if verdict_record.remark:
        body += text(verdict_record.remark)
    body += table(
        ("model", *JUDGED_HEADS),
        list(map(judged_row, material.comparisons)),
        numbers_from=2,
    )
    m = material.measurements
    seconds = sum(float(run.t[-1] - run.t[0]) for run in m.runs())
    body += text(
        f"{material.last.robot.name},"
        f" {formatting.count(material.last.robot.n, 'joint')}. Judged on"
        f" {formatting.count(len(m.names), 'run')}, {len(m.t)} samples, {seconds:.3g}"
        f" s: {', '.join(m.names)}. Measured and modelled torques passed the same"
        f" low-pass at {material.comparisons[0].band_hz:.3g} Hz."
    )
    return body


def torques(material: ReportData) -> str:
    """Measured and modelled torque of each joint, and what is left."""
    units = material.last.robot.torque_units
    first = material.judged[material.comparisons[0].name]
    moved = plots.shifts([run.motion.t for run, _ in first])
    modelled = [
        {name: curves_by_run[k][1] for name, curves_by_run in material.judged.items()}
        for k in range(len(first))
    ]
    runs = [
        plots.Curves(run.motion.t + shift, run.torque, of)
        for (run, _), shift, of in zip(first, moved, modelled, strict=True)
    ]
    failing = material.failures[material.comparisons[0].name]
    causes = [
        c
        for c in markup.SHADES
        if any(s.cause == c for f in failing for s in f.stretches)
    ]
    body = text(
        "Left: measured and modelled torque. Right: the errors on the same time axis."
        " Click a name to hide it, drag to look closer. Grey band: where 95 % of the"
        f" errors of {material.name} should lie, given its parameters' uncertainty and"
        " what it left of its own training runs."
    )
    body += markup.legend(causes)
    bands = _bands(material, moved)
    for j, unit in enumerate(units):
        plot = plots.torque_figure(runs, j, unit)
        for t, half in bands:  # around a zero error, beside the errors
            plot.add_band(t, -half[:, j], half[:, j], 1)
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


def _bands(material: ReportData, moved: Sequence[float]) -> list[tuple[Array, Array]]:
    """Of each run instants (m,) on the figures' axis and half the last model's band (m,
    n) there."""
    plant = material.comparisons[-1].estimate  # without its drives
    theta = plant.theta
    known = plant.uncertainty
    bands = []
    for (rows, _), shift in zip(material.judged[material.name], moved, strict=True):
        t = rows.motion.t + shift
        keep = np.unique(
            np.linspace(0, len(t) - 1, min(len(t), plots.POINTS)).astype(int)
        )
        columns_kept = [JointColumns(c.indices, c.columns[keep]) for c in rows.columns]
        half = NORMAL_95 * np.hypot(
            known.band(theta, columns_kept)[1], known.torque_noise
        )
        bands.append((t[keep], half))
    return bands


def history(material: ReportData) -> str:
    """What each model added, and the error of every joint, model by model, above the
    noise."""
    compared = material.comparisons
    history_parts = []
    known = set[str]()
    for name, estimate in material.models.items():
        new = ", ".join(e.brief for e in estimate.model.effects if e.text not in known)
        history_parts.append(
            (name, estimate.method, len(estimate.theta), new or "the same effects")
        )
        known |= {e.text for e in estimate.model.effects}
    body = table(
        ("model", "method", "parameters", "new effects"), history_parts, numbers_from=4
    )
    names = [f"RMSE {c.name}" for c in compared]
    errors = [c.rmse for c in compared]
    floor = compared[-1].noise_floor
    units = material.last.robot.torque_units
    body += table(*formatting.error_table(names, errors, floor, units, compared[-1].r2))
    if floor is None:
        body += text("No motion repeats in these runs: the noise floor is unknown.")
    return body


def forward(material: ReportData) -> str:
    """The last model run forward: after one step, 0.1 s ahead, and freely from the
    first state."""
    following = material.forward
    if isinstance(following, str):
        return text(f"{material.name} cannot be simulated: {following}")
    body = (
        text(following.verdict)
        + table(*following.table(), numbers_from=2)
        + text(following.explained)
    )
    if any(f.cut for f in following.free):
        return body + text(
            "`report --forward` goes on to the run's end, and shows the positions."
        )
    body += text(
        "Left: measured and simulated position of the free run. Right: its error."
    )
    runs = [
        plots.Curves(f.simulated.t + shift, f.measured, {material.name: f.simulated.q})
        for f, shift in zip(
            following.free,
            plots.shifts([f.simulated.t for f in following.free]),
            strict=True,
        )
    ]
    for j, unit in enumerate(following.units):
        body += figure(plots.torque_figure(runs, j, unit), group="forward")
    return body


def failures(material: ReportData) -> str:
    """Which cause explains how much of each joint's error, before and after, and in
    words."""
    shares_found = markup.found_shares(material.diagnosis, material.last.robot.n)
    body = text(
        "How much of each joint's error a function of each cause explains on held-out"
        " data, in per cent; causes that explain nothing are left out. `sdp-vs-penalty"
        " diagnose` names effects."
    )
    maps = ""
    for name, failing in material.failures.items():
        rows = markup.heat_rows(
            [f.to_dict() for f in failing], {} if maps else shares_found
        )
        maps += markup.heat_map(name, rows, len(failing))
    body += f'<div class="maps wide" tabindex="0">{maps}</div>'
    last = material.failures[material.name]
    units = material.last.robot.torque_units
    table_rows = [
        (
            f.joint,
            " ".join(sentences(f, unit)),
            number(f.rmse, 4),
            number(f.noise_floor, 4),
        )
        for f, unit in zip(last, units, strict=True)
    ]
    heads = ("joint", f"where {material.name} errs", "RMS error", "noise floor")
    return body + table(heads, table_rows, numbers_from=2)


def findings(material: ReportData) -> str:
    """What a diagnosis says: verdict, what the last model still lacks, a row a finding,
    each curve."""
    diagnosis = material.diagnosis
    if diagnosis is None:
        return text("No diagnosis was given. Name one with `--findings findings.json`.")
    rows = []
    units = material.last.robot.torque_units
    for f in diagnosis.effects:
        joint = f.joints[0] - 1 if f.joints else 0
        errors = f.held_out_rmse_before, f.held_out_rmse_after, diagnosis.noise_floor
        joints = ", ".join(map(str, f.joints))
        rivals = ", ".join(f.indistinguishable_from)
        cells_of_joint = (number(x[joint]) for x in errors)
        rows.append(
            (
                f.effect,
                joints or "all",
                f.rating,
                f.size_text,
                rivals or "-",
                *cells_of_joint,
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
    )
    headline_words = f": {diagnosis.headline}" if diagnosis.effects else ""
    body = text(
        f"In the model that was diagnosed{headline_words}"
        if headline_words
        else diagnosis.headline
    )
    body += (
        text(f"In {material.name}: {still_missing(diagnosis, material.last)}")
        if headline_words
        else ""
    )
    if rows:
        first = diagnosis.held_out_rmse_before
        last = diagnosis.held_out_rmse_with_all
        floor = diagnosis.noise_floor.tolist() if diagnosis.noise_known else None
        body += text(
            "Held-out error of each joint before all findings and with all of them:"
        )
        body += markup.bars(list(first), list(last), floor, units)
        body += table((*heads, "noise floor"), rows, numbers_from=5)
    body += text(diagnosis.left_sentence)
    body += "".join(text(remark) for remark in diagnosis.remarks)
    judged = material.judged[material.name]
    motions = [replace(rows.motion, torque=modelled) for rows, modelled in judged]
    for curve in diagnosis.curves:
        sentence = curve.sentence(units)
        plot = plots.missing_figure(curve, units, motions)
        body += figure(plot, f"{sentence[0].upper()}{sentence[1:]}", 360)
    return body


def parameters(material: ReportData) -> str:
    """Base and standard parameters with intervals and verdicts."""
    known = material.last.uncertainty
    base = counts(known.base)
    standard = counts(known.standard)
    runs = (
        ", ".join(map(str, material.last.provenance.get("runs", []))) or "unknown runs"
    )
    body = text(
        f"Values and 95 % intervals are those of {material.name}, from the runs that it"
        f" was identified from ({runs}). They hold the noise, the model's own errors as"
        " far as these runs show them and the errors of estimated shape constants;"
        f" where the estimate satisfies constraints, so do they. Of {len(known.base)}"
        " base parameters (the combinations that torques determine)"
        f" {base['identifiable']} are identifiable, {base['weakly']} weakly,"
        f" {base['not seen']} not; of {len(known.standard)} standard parameters"
        f" {standard['identifiable']}, {standard['weakly']} and {standard['not seen']}."
        " Parameters that are not from the data have values of the prior (the nominal"
        " robot) or of the bounds, not measured ones."
    )
    last = material.last
    base_said = {
        b["name"]: (b["source"], b["nominal"])
        for b in last.details.get("base_parameters", [])
    }
    rows = [cells(i, *base_said.get(i.name, ())) for i in known.base]
    body += table(HEADS, rows, numbers_from=3)
    inner = table(HEADS, standard_rows(last), numbers_from=3)
    return f"{body}<details><summary>Standard parameters</summary>{inner}</details>"


#: What :func:`cells` says of a parameter.
HEADS = ("parameter", "verdict", "from", "value", "low", "high", "nominal", "unit")


def standard_rows(estimate: Estimate) -> list[tuple[str, ...]]:
    """Every parameter of a model as text, in the order of HEADS."""
    known = estimate.uncertainty.standard, estimate.sources, estimate.nominal
    return [cells(*of) for of in zip(*known, strict=True)]


def cells(i: Interval, source: str = "", nominal: float = np.nan) -> tuple[str, ...]:
    """A parameter, the ends of its 95 % interval, what determined it and its nominal
    value, as text."""
    figures = (number(seen(x), 4) for x in (i.value, i.lower, i.upper, nominal))
    return i.name, i.verdict, source, *figures, formatting.plain_unit(i.unit)


def caveats(estimate: Estimate) -> list[str]:
    """What to know before parameters are read, a sentence each; the verdict judges the
    links."""
    sources = estimate.sources
    sentences = []
    if law := estimate.details.get("servo"):
        sentence = (
            f"the servos' law ({law['law']}) stands for it. Scale: {law['scale']}."
        )
        sentences.append(f"No torque was logged: {sentence}")
    if others := [source for source in sources if source != "data"]:
        sentence = (
            f"{len(others)} of {len(sources)} standard parameters are from the"
            f" {others[0]}"
        )
        sentences.append(f"{sentence}, not from the data: do not read them one by one.")
    return sentences


def arm(material: ReportData) -> str:
    """Every link's inertia ellipsoid on the arm's skeleton in the runs' mean pose, and
    its margins."""
    estimate = material.last
    if not len(estimate.model.rigid_indices):
        return text("This model has no rigid_body effect.")
    robot = estimate.robot
    links = estimate.links
    (poses,) = robot.poses(robot.tree_state(material.measurements.q.mean(axis=0))[0])
    caption = (
        "Uniform ellipsoids with the identified masses and inertias, in the runs' mean"
        " pose. An ellipsoid that leaves the picture belongs to a link that these data"
        " hardly determine. Zero thickness (a rod or a sheet) is unphysical."
    )
    body = text(" ".join(caveats(estimate))) + table(LINK_HEADS, link_rows(estimate))
    return body + figure(_picture(robot, links, poses), caption, 460)


def friction(material: ReportData) -> str:
    """Friction by velocity with its band, a figure a joint."""
    body = text(
        "Torque of all effects that follow the velocity alone; shaded: 95 % intervals."
    )
    if not (curves := friction_curves(material.last)):
        return text("The model has no friction that follows the velocity alone.")
    for c, unit in zip(curves, material.last.robot.torque_units, strict=True):
        plot = plots.friction_figure(
            c.velocity, c.torque, NORMAL_95 * c.std, c.joint, unit
        )
        body += figure(plot, "", 250)
    return body


def _picture(robot: Robot, links: Array, poses: Array) -> plots.Figure:
    """The skeleton and an ellipsoid a link."""
    plot = plots.Figure()
    look = dict[str, Any]()
    link = {carrier: place for place, carrier in enumerate(robot.link_joints)}
    for i, joint in enumerate(robot.tree):
        begin = np.zeros(3) if joint.parent < 0 else poses[joint.parent][:3, 3]
        x, y, z = np.stack([begin, poses[i][:3, 3]]).T
        look = {"mode": "lines+markers", "showlegend": False, "hoverinfo": "skip"}
        look |= {
            "line": {"color": MEASURED, "width": 6},
            "marker": {"size": 3, "color": MEASURED},
        }
        plot.add("scatter3d", x=x, y=y, z=z, **look)
        shape = ellipsoid(links[link[i]]) if i in link else None
        if shape is None:
            continue
        frame = poses[i] @ joint.link_frame
        x, y, z = frame[:3, :3] @ shape + frame[:3, 3:]
        look = {
            "alphahull": 0,
            "color": COLOURS[i % len(COLOURS)],
            "opacity": 0.5,
            "showlegend": True,
        }
        plot.add("mesh3d", x=x, y=y, z=z, name=f"link {link[i] + 1}", **look)
    axis = {
        "title": "",
        "gridcolor": "rgba(128,128,128,0.3)",
        "backgroundcolor": "rgba(0,0,0,0)",
    }
    # The picture is as large as the arm: an ellipsoid that leaves it belongs to a link
    # whose mass and inertia are not those of one body of that size.
    joints = np.array([np.zeros(3), *(pose[:3, 3] for pose in poses)])
    room = 0.25 * max(float(np.ptp(joints, axis=0).max()), 0.2)
    low = joints.min(axis=0) - room
    high = joints.max(axis=0) + room
    ends = zip("xyz", low.tolist(), high.tolist(), strict=True)
    axes = {f"{name}axis": {**axis, "range": [a, b]} for name, a, b in ends}
    camera = {"eye": {"x": 1.3, "y": 1.3, "z": 0.6}}
    return plot.update_layout(scene={"aspectmode": "data", "camera": camera, **axes})


def ellipsoid(link: Array) -> Array | None:
    """(3, k) points on the uniform solid ellipsoid with these standard parameters, in
    the link frame; None for a link without mass or thickness."""
    if (body := half_axes(link)) is None:
        return None
    half, axes, com = body
    u, v = np.meshgrid(np.linspace(0.0, np.pi, 14), np.linspace(0.0, 2.0 * np.pi, 28))
    ball = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)]).reshape(
        3, -1
    )
    return np.asarray(axes @ (half[:, None] * (axes.T @ ball)) + com[:, None], float)


def half_axes(link: Array) -> tuple[Array, Array, Array] | None:
    """Half axes (3,) [m] of that ellipsoid, sqrt(5 eigenvalues of Sigma_c / m), their
    directions (3, 3) as columns, right-handed, and its centre (3,)."""
    values, axes = np.linalg.eigh(inertia.second_moment(link))
    if link[0] <= 0.0 or values[0] <= 0.0:
        return None
    return (
        np.sqrt(5.0 * values),
        axes * np.sign(np.linalg.det(axes)),
        link[1:4] / link[0],
    )


def certificate_rows(estimates: Sequence[Estimate]) -> list[list[str]]:
    """What is certified of each, as the command line says it: a row a figure, its name
    first."""
    summaries = [dict(e.certificate.summary()) for e in estimates]
    names = dict.fromkeys(
        name for summary_of_model in summaries for name in summary_of_model
    )
    return [
        [name, *(summary_of_model.get(name, "-") for summary_of_model in summaries)]
        for name in names
    ]


#: What the certificate says, and who computed it.
CERTIFICATE = (
    "Violations of every family of constraints, including those that a method did not"
    " receive. The lower bound is computed here from dual multipliers, independently of"
    " what a solver claims."
)


def certificate(material: ReportData) -> str:
    """Computed by this program, whoever solved the problem."""
    rows = certificate_rows(list(material.models.values()))
    return text(CERTIFICATE) + table(
        ["figure", *material.models], rows, numbers_from=len(rows[0])
    )


def data(material: ReportData) -> str:
    """What `sdp-vs-penalty check` says of the runs."""
    parts = []
    for run, issues_of_run in material.checks.items():
        parts.append(f"<h3>{escape(run)}</h3>")
        if all(f["severity"] == "note" for f in issues_of_run):
            parts.append(text("No problems found."))
        for f in (
            {name: escape(str(x)) for name, x in f.items()} for f in issues_of_run
        ):
            parts.append(
                f'<div class="finding {f["severity"]}"><b>{f["kind"]}</b>'
                f" ({f['where']}): {f['what']} "
                f"<span>How sure: {f['certainty']}. What to do:"
                f" {f['remedy']}.</span></div>"
            )
    return "".join(parts)


def provenance(material: ReportData) -> str:
    """Versions, settings, hashes, and the commands."""
    rows = []
    for name, e in material.models.items():
        settings = ", ".join(f"{k}={v}" for k, v in e.settings.items())
        p = e.preprocessing
        known = e.provenance
        facts = {
            "method": f"{e.method} ({settings})",
            "effects": ", ".join(effect.brief for effect in e.model.effects),
            "filters": (
                f"states {number(p.state_cutoff, 4)} Hz, torque"
                f" {number(p.torque_cutoff, 4)} Hz"
            ),
            "runs": ", ".join(map(str, known.get("runs", []))),
            "data hash": known.get("data_hash", ""),
            "seed": known.get("seed", ""),
            "versions": ", ".join(
                f"{k} {v}" for k, v in known.get("versions", {}).items()
            ),
        }
        rows += [(name, what, value) for what, value in facts.items()]
    body = table(("model", "what", "which"), rows, numbers_from=3)
    if material.commands:
        body += f"<pre tabindex=0>{escape(chr(10).join(material.commands))}</pre>"
    return body
