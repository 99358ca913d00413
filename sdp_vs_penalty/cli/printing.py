"""What the verbs print: words and tables of render/, laid out for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from sdp_vs_penalty import formatting
from sdp_vs_penalty.cli import console
from sdp_vs_penalty.cli.console import out, paragraph, say
from sdp_vs_penalty.diagnosis.comparison import Comparison
from sdp_vs_penalty.errors import printable
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.gains import channel_gains, drive_gains, loop_gains
from sdp_vs_penalty.estimation.verdict import Verdict
from sdp_vs_penalty.render import tables
from sdp_vs_penalty.signals.noise import said_before

if TYPE_CHECKING:  # `identify` needs no diagnosis
    from sdp_vs_penalty.api.remedies import Files
    from sdp_vs_penalty.checks.issue import Issue
    from sdp_vs_penalty.checks.report import Report
    from sdp_vs_penalty.diagnosis.finding import Finding
    from sdp_vs_penalty.diagnosis.findings import Diagnosis
    from sdp_vs_penalty.diagnosis.where_it_fails import Failures
    from sdp_vs_penalty.estimation.model_file import ServoFields
    from sdp_vs_penalty.problem.check_command import CheckCommand
    from sdp_vs_penalty.ranges.table import Ranges
    from sdp_vs_penalty.render.words import DiagnosisWords


def estimate(
    result: Estimate,
    fit: Comparison | None,
    seconds: float,
    ranges: Ranges | None = None,
) -> None:
    """Print what was identified, how well it fits, and what the certificate says.

    Parameters
    ----------
    fit : Comparison or None
        With the measurements that it came from; None for a black box's answers.
    seconds : float
        How long the identification took [s].
    ranges : Ranges, optional
        Between which values the masses can lie.
    """
    runs = formatting.count(len(result.provenance["runs"]), "run")
    error = ""
    if fit is not None:
        error = f", {fit.facts()['relative_error'].text} error"
    say(
        f"{result.problem.name} by {result.method} from"
        f" {result.provenance['samples']} samples of {runs}: {len(result.theta)}"
        f" parameters{error}, {seconds:.1f} s",
        style="bold",
    )
    if fit is not None:
        verdict(fit.verdict)
    if ranges is not None:
        allowed(ranges)
    certificate(result)
    gains(result)
    range_texts = None if ranges is None else {r.name: r.text for r in ranges.ranges}
    links = tables.link_table(result, centres=False, ranges=range_texts)
    if links is not None:
        console.table(links)
    if fit is not None:
        comparison(
            [fit],
            result.torque_units,
            "Error (RMS) of the modelled torque on these measurements",
        )


def allowed(ranges: Ranges) -> None:
    """Print what data and physics allow: the table, and what it rests on."""
    console.table(ranges.table())
    for note in ranges.notes():
        paragraph(note)


def gains(result: Estimate) -> None:
    """Print the gains of torque channels, servos and control loops, if any were
    estimated.
    """
    if channels := channel_gains(result):
        values = [f"{gain.value:.3f} ± {gain.spread}" for gain in channels]
        say(
            "gains of the torque channels, from the known load (± 95 %):"
            f" {', '.join(values)}"
        )
    if law := result.report.servo:
        servo(result, law)
    if loop := result.report.loop:
        shares = ", ".join(map(formatting.percent, loop.share))
        delay = formatting.milli(loop.delay, "s", 2)
        say(
            f"the servos' law, {delay} late, makes {shares} of the joints' logged torque"
        )
        console.table(
            tables.gain_table("Gains, of the logged torque", loop_gains(result))
        )


def servo(result: Estimate, law: ServoFields) -> None:
    """Print the servo law that replaced a logged torque, its gains, and what sets the
    scale.

    law : the law in words, its delay [s], errors of other laws, and the scale.
    """
    from sdp_vs_penalty.render.words import drive_torque_sentence

    delay = "no delay"
    if law.delay > 0.0:
        delay = f"commands act {formatting.milli(law.delay, 's', 2)} late"
    say(f"servo law, in place of a torque: {law.law}, {delay}")
    if law.held_out:
        errors = [f"{name} {error:.4g}" for name, error in law.held_out.items()]
        say(f"error of each law on data left out, over the least: {', '.join(errors)}")
    say(f"scale: {law.scale}")
    if law.motion:
        units = result.robot.position_units
        distances = [
            formatting.milli(distance, unit)
            for distance, unit in zip(law.motion, units, strict=True)
        ]
        say(
            "motion simulated from the command, RMS from the measured:"
            f" {', '.join(distances)}"
        )
    title = "Gains; kd holds viscous friction too"
    console.table(tables.gain_table(title, drive_gains(result)))
    paragraph(drive_torque_sentence(result))


def verdicts(results: Sequence[Comparison]) -> None:
    """Print the verdict on each of several models; how rough the noise is is said
    once.
    """
    for number, result in enumerate(results):
        verdict(result.verdict, result.name, is_first=number == 0)


def verdict(record: Verdict, name: str = "", is_first: bool = True) -> None:
    """Print a verdict: the grade with its reason, then the other two criteria.

    ``is_first`` is whether no other verdict on the same measurements stands before it.
    """
    headline = f"{name}: {record.headline}" if name else record.headline
    say(headline if is_first else said_before(headline), style="bold")
    for line in record.lines[1:]:
        text = line.text if is_first else said_before(line.text)
        paragraph(f"{line.about} ({line.grade}): {text}")
    if record.remark:
        paragraph(record.remark)


def certificate(result: Estimate) -> None:
    """Print what the certificate says, bounds that are reached, and what data
    determine.
    """
    entries = list(result.certificate.summary())
    entries += [*result.held_by_bounds, *result.determined_by_data]
    console.details(entries)
    for remark in filter(None, (result.certificate.not_found, result.unweighed)):
        paragraph(remark)


def comparison(
    results: Sequence[Comparison],
    units: Sequence[str],
    title: str = "Error (RMS) of the modelled torque",
    names: Sequence[str] = (),
) -> None:
    """Print the facts of each joint, and of several models those of each.

    Several models are columns [1], [2], ..., so that the table fits a narrow terminal,
    unless ``names`` are given.
    """
    last = results[-1]
    is_numbered = len(results) > 1 and not names
    heads = list(names) or [""]
    if is_numbered:
        heads = [f"[{k}]" for k, _ in enumerate(results, start=1)]
    models = {head: one.facts() for head, one in zip(heads, results, strict=True)}
    title = f"{title} {last.facts()['scope'].text}"
    console.table(tables.joint_table(models, units, title))
    if is_numbered:
        rows = [
            (f"[{k}] {one.name}", one.verdict.grade, one.facts())
            for k, one in enumerate(results, start=1)
        ]
        console.table(tables.model_table(rows))


def where_it_fails(
    failures: Failures, judged: Comparison, is_last: bool = False
) -> None:
    """Print where a model's error is large, and what it depends on there; ``is_last``: as
    the last of several."""
    from sdp_vs_penalty.render.words import describe_failures

    shares = "shares of the error on data left out; causes overlap"
    model = f"{judged.name}, the last of these models," if is_last else judged.name
    say(f"Where {model} fails ({shares})", style="italic")
    for line in describe_failures(failures, judged.errors.exceeds_noise):
        paragraph(line)


def all_figures(failures: Failures, judged: Comparison) -> None:
    """Print all facts of a comparison, and of the analysis of where the error is large.

    The errors are those of the comparison, as everywhere else: the analysis leaves rows
    out, and its errors differ in the third digit.
    """
    errors = map(float, judged.rmse)
    relative_failures = [
        replace(f, rmse=x) for f, x in zip(failures, errors, strict=True)
    ]
    console.table(tables.failure_table(relative_failures))
    console.table(judged.fact_table())


def diagnosis(
    result: Diagnosis,
    units: Sequence[str],
    model: Path | str,
    has_findings: bool,
    verbose: bool = False,
) -> None:
    """Print a diagnosis: the verdict, the findings with the decreasing error, and the
    rest.

    Parameters
    ----------
    units : sequence of str
        Torque unit of each joint.
    model : Path or str
        File of the diagnosed model.
    has_findings : bool
        Whether there is anything to add.
    verbose : bool
        Whether to print weak findings at the end as well.
    """
    from sdp_vs_penalty.diagnosis.sentences import unexplained_torque
    from sdp_vs_penalty.render.words import describe_diagnosis

    words = describe_diagnosis(result, units, str(model))
    effects = result.effects if verbose else result.worth_showing
    say(words.verdict, style="bold")
    if unexplained_torque(result) or not has_findings:
        paragraph(words.advice)
    for constant in words.constants:
        paragraph(f"{constant.title_with_doubt}: {constant.sentences}")
    if result.effects:
        _findings(result, words, units, effects)
    for curve in words.curves:
        paragraph(f"curve: {curve}")
    say(words.left)
    for event in words.events:
        say(event)
    if words.invisible:
        paragraph(
            "not identifiable from these runs (absorbed by existing parameters):"
            f" {', '.join(words.invisible)}"
        )
    for remark in words.remarks:
        paragraph(remark)
    for number, finding in enumerate(words.findings[: len(effects)], start=1):
        if finding.test:
            say(f"To test finding {number}, record: {finding.test}")


def _findings(
    result: Diagnosis,
    words: DiagnosisWords,
    units: Sequence[str],
    shown: Sequence[Finding],
) -> None:
    """Print the table of errors, and a paragraph for each finding that is shown.

    Findings that are not shown are named in one line.
    """
    from sdp_vs_penalty.render.words import errors_that_rise, finding_table

    console.table(finding_table(result, shown, units))
    if rises := errors_that_rise(result, shown):
        paragraph(rises)
    if words.shared_doubt:
        paragraph(words.shared_doubt)
    for group in result.offers.groups:
        if group.place >= len(shown):
            continue
        finding = words.findings[group.place]
        size = f": {finding.size_and_constants}" * bool(finding.size_and_constants)
        title = f"{group.first.number}. {finding.title_with_doubt}"
        paragraph(f"{title}{size}. {finding.sentences}")
    if more := words.findings[len(shown) :]:
        paragraph(f"further weak candidates: {'; '.join(f.title for f in more)}")


def before_after(
    before: Comparison, after: Comparison, units: Sequence[str], what: str
) -> None:
    """Print how each joint's error changed, the verdict on the new model, and both
    errors.

    what : the data that both are judged on, in words.
    """
    from sdp_vs_penalty.render.words import describe_change

    say(f"On {what}: {describe_change(before, after)}", style="bold")
    verdict(after.verdict)
    comparison([before, after], units, names=("before", "after"))
    errors = [c.facts()["relative_error"].text for c in (before, after)]
    say(f"all joints together: {errors[0]} error before, {errors[1]} after")


def checks(reports: Sequence[Report], command: CheckCommand) -> None:
    """Print the issues of the data check: those that all runs share first, then each
    run's.

    command : the check of these runs, for the commands of other readings of a file.
    """
    from sdp_vs_penalty.api.remedies import Files

    files = Files(command, blank="UNIT")
    common = []
    if len(reports) > 1:
        first, *others = reports
        common = [
            issue
            for issue in first.by_cause
            if all(_has(report.by_cause, issue) for report in others)
        ]
    if common:
        say(f"All {len(reports)} runs", style="bold")
        for issue in common:
            _issue(issue, files)
    for report in reports:
        say(report.verdict, style="bold")
        for issue in report.by_cause:
            if not _has(common, issue):
                _issue(issue, files)


def _has(issues: Sequence[Issue], issue: Issue) -> bool:
    """Whether an issue with the same place and text is among these."""
    return any((f.where, f.what) == (issue.where, issue.what) for f in issues)


#: Of an issue's severity.
_COLOURS = {"error": "red", "warning": "yellow", "note": "dim"}


def _issue(issue: Issue, files: Files) -> None:
    """Print an issue: severity and kind, what it is, how sure it is, and what to do;
    other readings of the file with their command, by ``files``."""
    from rich.markup import escape

    from sdp_vs_penalty.api.remedies import Files, command_of

    word = f"[{_COLOURS[issue.severity]}]{issue.severity}[/]"
    nature = "" if issue.nature == "fact" else " [dim]explanation[/]"
    kind = escape(printable(issue.kind))
    where = escape(printable(issue.where))
    out().print(f"  {word}{nature} {kind} ({where})")
    tries = " (--fix does it)" if issue.offers_fix else ""
    if issue.apply and not issue.can_fix:
        tries = f" (--fix with --apply {issue.apply} tries it)"
    texts = [
        issue.what,
        f"How sure: {issue.certainty}.",
        f"What to do: {issue.remedy}{tries}.",
    ]
    for rival in issue.rivals:
        if rival.apply or rival.gravity:
            tries = f" (--apply {rival.apply})" if rival.apply else ""
            texts.append(f"Or, as likely: {rival.remedy}{tries}.")
    for text in texts:
        say(f"    {text}")
    first = Files(replace(files.check, runs=files.check.runs[:1]), blank="UNIT")
    for change in issue.changes:
        words = None
        if "run" in change.arguments and "spans" not in change.arguments:
            words = command_of(change, files)
        elif change.verb == "read":  # each run by itself: the first is the example
            words = command_of(change, first)
        if words is not None:
            printed = formatting.command(*words)
            say(f"    To {change.words}: {printed}")
