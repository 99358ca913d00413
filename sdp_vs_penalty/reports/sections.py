"""The sections of the report: a context each, which its template lays out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.store import AppendableArray
from sdp_vs_penalty.diagnosis.comparison import Comparison, predicted
from sdp_vs_penalty.diagnosis.finding import Finding
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.open_findings import (
    findings_not_added,
    still_missing,
    verdict_beside,
)
from sdp_vs_penalty.diagnosis.sizes_in_model import with_sizes_of
from sdp_vs_penalty.diagnosis.where_it_fails import SHARES, Failures, sentences
from sdp_vs_penalty.effects import effects_in_words
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import JointColumns
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.uncertainty import counts
from sdp_vs_penalty.estimation.verdict import Verdict
from sdp_vs_penalty.exporters.friction_table import friction_curves
from sdp_vs_penalty.ranges.allowed import allowed_set
from sdp_vs_penalty.ranges.band import band_of
from sdp_vs_penalty.ranges.table import ranges_of, training_of
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.render import charts, pieces, tables, words
from sdp_vs_penalty.results.issue import IssueInWords
from sdp_vs_penalty.results.remedy import Remedy
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.signals.filtered import FilteredRun
from sdp_vs_penalty.simulation.follow import Following

Context = dict[str, Any]


@dataclass(frozen=True)
class JudgedRun:
    """One run behind its filters, as a model explains it."""

    #: Name of the run.
    name: str
    #: Filtered motion at M instants.
    motion: Motion
    #: (M, n) measured torque [N m or N].
    torque: Array
    #: (M, n) modelled torque [N m or N].
    modelled: Array
    #: (m,) rows at which the model's band is drawn.
    shown: Indices
    #: Columns of each joint at these rows.
    columns: list[JointColumns]

    @classmethod
    def from_run(cls, run: FilteredRun, estimate: Estimate) -> JudgedRun:
        """Compute a run's modelled torque and the columns for the model's band.

        The run is read in chunks, because the columns of all rows would not fit into
        memory; they are kept at a few evenly spread rows only.

        Parameters
        ----------
        run : FilteredRun
            The run behind its filters.
        """
        count = sum(len(states.t) for states in run.states())
        shown = charts.spread_rows(count)
        # Arrays of a long run lie in temporary files, out of the process's memory.
        states = {name: AppendableArray() for name in ("t", "q", "dq", "ddq")}
        torque = AppendableArray()
        modelled = AppendableArray()
        chunks_with_shown = list[list[JointColumns]]()
        first = 0
        for rows in run.rows(estimate.model):
            for name, array in states.items():
                array.append(getattr(rows.motion, name))
            torque.append(rows.torque)
            modelled.append(predicted(rows, estimate.theta))
            last = first + len(rows.torque)
            inside = shown[(shown >= first) & (shown < last)] - first
            chunks_with_shown.append(
                [JointColumns(c.indices, c.columns[inside]) for c in rows.columns]
            )
            first = last
        columns_of_joints = []
        for chunks in zip(*chunks_with_shown, strict=True):
            values = np.concatenate([chunk.columns for chunk in chunks])
            columns_of_joints.append(JointColumns(chunks[0].indices, values))
        motion = Motion(
            t=states["t"].array(),
            q=states["q"].array(),
            dq=states["dq"].array(),
            ddq=states["ddq"].array(),
        )
        return cls(
            name=run.run.names[0],
            motion=motion,
            torque=torque.array(),
            modelled=modelled.array(),
            shown=shown,
            columns=columns_of_joints,
        )


@dataclass(frozen=True)
class ReportData:
    """Everything that the sections show, computed once."""

    #: Models by name, in the order in which effects were added; the last one is shown in
    #: detail.
    models: Mapping[str, Estimate]
    #: Runs on which the models are judged.
    measurements: Measurements
    #: Each model, judged on these runs.
    comparisons: Sequence[Comparison]
    #: Runs behind their filters, by model.
    judged: Mapping[str, Sequence[JudgedRun]]
    #: Error analysis of the first and of the last model, by name.
    failures: Mapping[str, Failures]
    #: Result of Issue.to_dict() for each issue, by run.
    checks: Mapping[str, Sequence[IssueInWords]]
    #: The last model run forward, or the sentence why it cannot be.
    forward: Following | str
    #: Commands that made this report.
    commands: Sequence[str]
    #: Diagnosis of one of the models; None where there is none.
    diagnosis: Diagnosis | None = None

    @property
    def last(self) -> Estimate:
        """The last model, which the report shows in detail."""
        return list(self.models.values())[-1]

    @property
    def verdict(self) -> Verdict:
        """The verdict on the last model.

        It includes what the diagnosis says is missing and how a forward simulation
        went.
        """
        forward_verdict = "" if isinstance(self.forward, str) else self.forward.verdict
        return self.verdict_of(self.comparisons[-1], forward_verdict)

    def verdict_of(self, compared: Comparison, forward: str = "") -> Verdict:
        """Return the verdict on a model, with what the diagnosis found that it lacks,
        and with the sentence on a forward simulation, if there was one."""
        return verdict_beside(self.diagnosis, compared, forward)

    @property
    def name(self) -> str:
        """The name of the last model."""
        return self.comparisons[-1].name

    @property
    def units(self) -> tuple[str, ...]:
        """The torque unit of each joint, "N*m" or "N"."""
        return self.last.torque_units

    @property
    def sized_diagnosis(self) -> Diagnosis | None:
        """The diagnosis, with sizes from the last model for the effects that it
        contains.
        """
        if self.diagnosis is None:
            return None
        return with_sizes_of(self.diagnosis, self.last)


@dataclass(frozen=True)
class Section:
    """A section of the report."""

    #: Heading of the section.
    title: str
    #: Name of the section in the document and of its template, html/<anchor>.html.
    anchor: str
    #: Computes from the report's data what the template shows.
    context: Callable[[ReportData], Context]


def verdict(data: ReportData) -> Context:
    """Return the context of the first section: the verdict on the models.

    It says which joint fails, when and why, and what adding effects did, in words and
    one chart; then how good the last model is, and a row for each model.
    """
    first = data.comparisons[0]
    last = data.comparisons[-1]
    is_alone = len(data.comparisons) == 1
    record = data.verdict
    change = "" if is_alone else words.describe_addition(first, last)
    joint = first.worst_joint
    finding = words.shown_finding(data.diagnosis, joint)
    cause = words.shown_cause(finding, data.failures[first.name], joint)
    rows = [
        (compared.name, data.verdict_of(compared).grade, compared.facts())
        for compared in data.comparisons
    ]
    return {
        "grade": record.grade.replace(" ", "-"),
        "headline": record.headline,
        "story": words.describe_worst(first, cause, is_past=not is_alone),
        "change": change,
        "on_the_arm": words.on_the_arm_of(data.sized_diagnosis),
        "picture": pieces.figure(
            _error_plot(data, joint, cause, finding),
            words.picture_title(first, last, joint, cause),
            300,
        ),
        "bars": pieces.bars(
            first.rmse,
            None if is_alone else last.rmse,
            last.noise_floor,
            data.units,
            last.kind_of_error,
            torque=last.torque_rms,
        ),
        "lines": [*map(str, record.lines[1:])],  # the first one is the headline
        "remark": record.remark,
        "models": pieces.framed(tables.model_table(rows)),
        "robot": data.last.robot.name,
        "joints": formatting.count(data.last.robot.n, "joint"),
        "runs": formatting.count(len(data.measurements.names), "run"),
        "samples": len(data.measurements.t),
        "seconds": first.facts()["judged_seconds"].text,
        "names": ", ".join(data.measurements.names),
        "scope": first.facts()["scope"].text,
    }


def _error_plot(
    data: ReportData, joint: int, cause: str, finding: Finding | None
) -> Any:
    """Plot the error of a joint (from 1) against its cause, of the first and of the last
    model; ``finding`` is the one that it shows."""
    first = data.comparisons[0]
    last = data.comparisons[-1]
    failure = data.failures[first.name][joint - 1]
    return charts.cause_figure(
        first.signals,
        None if first is last else last.signals,
        joint=joint,
        cause=cause,
        units=data.units,
        position_units=data.last.robot.position_units,
        floor=last.noise_floor,
        waves=words.shown_waves(failure, finding),
    )


def torques(data: ReportData) -> Context:
    """Return the context of the section on torques: a figure for each joint.

    Measured and modelled torque stand on the left, the error with its 95 % band on the
    right; shades mark where the first model fails.
    """
    first = data.comparisons[0].name
    failing = data.failures[first]
    moved = charts.shifts([run.motion.t for run in data.judged[first]])
    runs = _torque_curves(data, moved)
    bands = _bands(data, moved)
    figures = []
    for j, unit in enumerate(data.units):
        plot = charts.torque_figure(runs, j, unit)
        for t, half in bands:  # around a zero error, beside the errors
            plot.add_band(t, -half[:, j], half[:, j], 1)
        stretches = _stretches(data, failing, j, moved)
        plot.update_layout(shapes=pieces.shades(stretches))
        plot.update_axes("x", 1, matches="x")
        figures.append(pieces.figure(plot, group="torques"))
    seen = {s.cause for failure in failing for s in failure.stretches}
    causes = [cause for cause in pieces.SHADES if cause in seen]
    legend = pieces.legend(causes)
    return {"name": data.name, "legend": legend, "figures": figures}


def _torque_curves(data: ReportData, moved: Sequence[float]) -> list[charts.Curves]:
    """Return each run's measured torque and that of every model; runs stand one after
    another, each clock ``moved`` by an offset [s]."""
    first = data.judged[data.comparisons[0].name]
    curves = []
    for k, (run, shift) in enumerate(zip(first, moved, strict=True)):
        modelled = {name: runs[k].modelled for name, runs in data.judged.items()}
        t = run.motion.t + shift
        curves.append(charts.Curves(t, run.torque, modelled))
    return curves


def _stretches(
    data: ReportData, failing: Failures, j: int, moved: Sequence[float]
) -> list[tuple[float, float, str]]:
    """Return where joint j (from 0) fails: begin [s], end [s] and cause.

    Times are those of the figure's axis, on which the runs follow each other: each
    run's clock is ``moved`` by an offset [s].
    """
    first_model = data.comparisons[0].name
    placed = []
    for stretch in failing[j].stretches:
        for run, shift in zip(data.judged[first_model], moved, strict=True):
            t = run.motion.t
            if stretch.run.startswith(run.name) and t[0] <= stretch.start <= t[-1]:
                begin, end = stretch.start + shift, stretch.stop + shift
                placed.append((begin, end, stretch.cause))
    return placed


def _bands(data: ReportData, moved: Sequence[float]) -> list[tuple[Array, Array]]:
    """Return the last model's 95 % band around a zero error, for each run.

    It combines the parameters' uncertainty with the torque's noise. For each run:
    instants (m,) [s] on the figure's axis and half the band's width (m, n) there.
    """
    plant = data.comparisons[-1].estimate  # without its drives
    uncertainty = plant.uncertainty
    bands = []
    for run, shift in zip(data.judged[data.name], moved, strict=True):
        t = run.motion.t[run.shown] + shift
        _, model_std = uncertainty.band(plant.theta, run.columns)
        total_std = np.hypot(model_std, uncertainty.torque_noise)
        bands.append((t, NORMAL_95 * total_std))
    return bands


def history(data: ReportData) -> Context:
    """Return the context of the section on the models: what each added, and its
    errors.
    """
    steps = []
    before = None
    for name, estimate in data.models.items():
        new = words.new_effects(before, estimate)
        added = effects_in_words(new) or "the same effects"
        steps.append((name, estimate.method, len(estimate.theta), added))
        before = estimate
    last = data.comparisons[-1]
    facts = {x.name: x.facts() for x in data.comparisons}
    if len(facts) == 1:
        facts = {"": last.facts()}
    errors = tables.joint_table(facts, data.units)
    heads = ("model", "method", "parameters", "new effects")
    changes = ""
    if len(data.comparisons) > 1:
        changes = words.describe_change(data.comparisons[0], last)
    return {
        "changes": changes,
        "steps": pieces.framed(Table(heads, steps, words=(0, 1, 3))),
        "errors": pieces.framed(errors),
        "noise_unknown": words.noise_unknown(last),
    }


def run_forward(data: ReportData) -> Context:
    """Return the context of the section on forward simulation with the last model.

    It shows errors after one step, after 0.1 s, and of free runs from the first state.
    If the model cannot be simulated, the section shows the reason ("refusal").
    """
    following = data.forward
    if isinstance(following, str):
        return {"name": data.name, "refusal": following}
    is_cut = any(free.cut for free in following.free)
    return {
        "name": data.name,
        "refusal": "",
        "verdict": following.verdict,
        "table": pieces.framed(following.table()),
        "explained": following.explained,
        "is_cut": is_cut,
        "figures": [] if is_cut else _motion_figures(following, data.name),
    }


def _motion_figures(following: Following, name: str) -> list[Any]:
    """Draw measured and simulated position of each joint, one run after another."""
    moved = charts.shifts([free.simulated.t for free in following.free])
    runs = [
        charts.Curves(free.simulated.t + shift, free.measured, {name: free.simulated.q})
        for free, shift in zip(following.free, moved, strict=True)
    ]
    return [
        pieces.figure(charts.torque_figure(runs, j, unit), group="forward")
        for j, unit in enumerate(following.units)
    ]


def causes_of_error(data: ReportData) -> Context:
    """Return the context of the section on causes: which cause explains how much error.

    A heat map for the first and for the last model, and a sentence for each joint. The
    errors are those of the comparison, as in the whole report: the analysis of causes
    leaves rows out, so that its own errors differ in the third digit.
    """
    shares = pieces.found_shares(data.diagnosis, data.last.robot.n)
    maps = []
    for name, failing in data.failures.items():
        rows = pieces.heat_rows(failing, shares)
        maps.append(pieces.heat_map(name, rows, len(failing)))
        shares = {}  # the diagnosis is of the first model: the last one gets no findings
    errors = data.comparisons[-1].rmse
    lines = [
        (
            f.joint,
            " ".join(sentences(f, unit)),
            formatting.number(float(error)),
            formatting.number(f.noise_floor),
        )
        for f, unit, error in zip(
            data.failures[data.name], data.units, errors, strict=True
        )
    ]
    heads = ("joint", f"where {data.name} errs", "error", "noise floor")
    return {
        "shares": SHARES,
        "maps": maps,
        "table": pieces.framed(Table(heads, lines, words=(0, 1))),
    }


def findings(data: ReportData) -> Context:
    """Return the context of the section on what the diagnosis found.

    - "words": every sentence; None without a diagnosis.
    - "missing": what the last model still lacks.
    - "cards": a card with a picture for each finding whose torque is certain;
      "weak_cards", which are folded: for each other finding.
    - "bars": for a report of one model, each joint's error on held-out data before and
      after adding what helps.
    - "curves": a figure for each measured curve of missing torque.
    - "remedies": what to do, a sentence each.
    """
    diagnosis = data.sized_diagnosis
    if diagnosis is None:
        return {"words": None}
    described = words.describe_diagnosis(diagnosis, data.units)
    missing = still_missing(diagnosis, data.last) if diagnosis.effects else ""
    bars = None
    is_alone = len(data.comparisons) == 1  # else the first section has these bars
    if diagnosis.effects and is_alone:
        floor = diagnosis.noise_floor.tolist() if diagnosis.noise_known else None
        bars = pieces.bars(
            diagnosis.held_out_rmse_before,
            diagnosis.left_error,
            floor,
            data.units,
            scope="on data left out",
        )
    # The figures of curves show where the modelled torque of the rows lies.
    motions = [
        replace(run.motion, torque=run.modelled) for run in data.judged[data.name]
    ]
    curves = []
    for curve, words_of_curve in zip(diagnosis.curves, described.curves, strict=True):
        plot = charts.missing_figure(curve, data.units, motions)
        caption = formatting.sentence(words_of_curve)
        curves.append(pieces.figure(plot, caption, 360))
    cards, weak_cards = list[dict[str, Any]](), list[dict[str, Any]]()
    for first in (group.first for group in diagnosis.offers.groups):
        words_of_first = described.findings[first.number - 1]
        picture = _picture_of_finding(data, diagnosis, first)
        card = {"words": words_of_first, "picture": picture}
        (cards if first.torque_is_certain else weak_cards).append(card)
    weak = [f for f in diagnosis.effects if not f.torque_is_certain]
    not_added = findings_not_added(replace(diagnosis, effects=tuple(weak)), data.last)
    # "All that helps" may be a single finding: its remedy is then listed once.
    remedies = dict[str, Remedy]()
    for remedy in diagnosis.remedies:
        if remedy.is_advisable:
            remedies.setdefault(remedy.change.words, remedy)
    return {
        "words": described,
        "cards": cards,
        "weak_cards": weak_cards,
        "weak_title": words.weak_title(len(weak), len(weak) - len(not_added)),
        "missing": missing,
        "name": data.name,
        "bars": bars,
        "curves": curves,
        "remedies": [
            words.describe_remedy(remedy, diagnosis.offers.outcome_of(remedy))
            for remedy in remedies.values()
        ],
    }


def _picture_of_finding(
    data: ReportData, diagnosis: Diagnosis, finding: Finding
) -> Any:
    """Draw the error that the card of a finding is about, against its cause, before and
    after adding effects.

    "" for a finding whose torque is not certain.
    """
    if not finding.torque_is_certain:
        return ""
    joint, acting = diagnosis.offers.shown_of(finding)
    failures = data.failures[data.comparisons[0].name]
    cause = words.shown_cause(acting, failures, joint)
    return pieces.figure(_error_plot(data, joint, cause, acting), height=250)


def parameters(data: ReportData) -> Context:
    """Return the context of the section on parameters: base and standard, with
    intervals.
    """
    uncertainty = data.last.uncertainty
    runs = ", ".join(map(str, data.last.provenance.get("runs", [])))
    names = base_rows(data.last.model, data.last.problem.independent).sums
    base = tables.parameter_table(data.last.base_entries, names)
    standard = tables.parameter_table(data.last.entries)
    return {
        "name": data.name,
        "runs": runs or "unknown runs",
        "n_base": len(uncertainty.base),
        "base_counts": counts(uncertainty.base),
        "n_standard": len(uncertainty.standard),
        "standard_counts": counts(uncertainty.standard),
        "base": pieces.framed(base),
        "standard": pieces.framed(standard),
    }


def ranges(data: ReportData) -> Context:
    """Return the context of the section on what the data allow: the masses' ranges, and
    each joint's torque within its band on the first run."""
    estimate = data.last
    try:
        training, floor = training_of(estimate, None)
    except InputError as error:
        return {"missing": str(error)}
    allowed = allowed_set(training, estimate.theta, floor)
    run = data.judged[data.name][0]
    columns = [c.dense_columns(len(estimate.theta)) for c in run.columns]
    shown = run.shown
    band = band_of(allowed, run.motion.t[shown], columns, run.torque[shown])
    reach = band.half_width_with_error
    low, high = band.centre - reach, band.centre + reach
    figures = [
        pieces.figure(
            charts.band_figure(band.t, y, low[:, j], high[:, j]),
            f"Joint {j + 1}, measured torque [{data.units[j]}] over time [s].",
            250,
        )
        for j, y in enumerate(band.measured.T)
    ]
    found = ranges_of(training, estimate.theta, allowed)
    return {
        "missing": "",
        "table": pieces.framed(found.table()),
        "run": run.name,
        "band": pieces.framed(band.table()),
        "figures": figures,
    }


def arm(data: ReportData) -> Context:
    """Return the context of the section on links: their table, and what to know of it."""
    links = tables.link_table(data.last)
    if links is None:
        return {"links": None}
    return {"caveats": words.caveats(data.last), "links": pieces.framed(links)}


def friction(data: ReportData) -> Context:
    """Return the context of the section on friction: torque over velocity for each
    joint.
    """
    figures = []
    for curve, unit in zip(friction_curves(data.last), data.units, strict=False):
        plot = charts.friction_figure(
            velocity=curve.velocity,
            torque=curve.torque,
            half=NORMAL_95 * curve.std,
            joint=curve.joint,
            unit=unit,
        )
        figures.append(pieces.figure(plot, "", 250))
    return {"figures": figures}


def certificate(data: ReportData) -> Context:
    """Return the context of the section on the certificate.

    It holds the bounds that this program computes, independently of the solver.
    """
    return {
        "about": words.CERTIFICATE,
        "table": pieces.framed(tables.certificate_table(data.models)),
    }


def data_check(material: ReportData) -> Context:
    """Return the context of the section on the data check: the issues of each run."""
    runs = [
        {
            "name": run,
            "is_clean": all(issue.severity == "note" for issue in issues),
            "issues": issues,
            "remedies": [
                words.describe_remedy(remedy)
                for issue in issues
                for remedy in issue.remedies
            ],
        }
        for run, issues in material.checks.items()
    ]
    return {"runs": runs}


def provenance(data: ReportData) -> Context:
    """Return the context of the section on provenance: settings, versions and
    commands.
    """
    rows = []
    for name, estimate in data.models.items():
        for what, value in _origin(estimate).items():
            rows.append((name, what, value))
    heads = ("model", "what", "which")
    return {
        "table": pieces.framed(Table(heads, rows, words=(0, 1, 2))),
        "commands": "\n".join(data.commands),
    }


def _origin(estimate: Estimate) -> dict[str, Any]:
    """Return how a model was made: method, effects, filters, runs, seed and
    versions.
    """
    filters = estimate.preprocessing
    provenance = estimate.provenance
    settings = [f"{name}={value}" for name, value in estimate.settings.items()]
    versions = [f"{name} {v}" for name, v in provenance.get("versions", {}).items()]
    cutoffs = [
        formatting.number(cutoff, 4)
        for cutoff in (filters.state_cutoff, filters.torque_cutoff)
    ]
    return {
        "method": f"{estimate.method} ({', '.join(settings)})",
        "effects": ", ".join(effect.brief for effect in estimate.model.effects),
        "filters": f"states {cutoffs[0]} Hz, torque {cutoffs[1]} Hz",
        "runs": ", ".join(map(str, provenance.get("runs", []))),
        "data hash": provenance.get("data_hash", ""),
        "seed": provenance.get("seed", ""),
        "versions": ", ".join(versions),
    }


SECTIONS = (
    Section("Verdict", "verdict", verdict),
    Section("Where and when: measured against modelled", "torques", torques),
    Section("Why", "failures", causes_of_error),
    Section("What is missing", "findings", findings),
    Section("From model to model", "history", history),
    Section("Run forward", "forward", run_forward),
    Section("Parameters", "parameters", parameters),
    Section("What the data allow", "ranges", ranges),
    Section("Links", "arm", arm),
    Section("Friction", "friction", friction),
    Section("Certificate", "certificate", certificate),
    Section("Data check", "data", data_check),
    Section("Provenance", "provenance", provenance),
)
