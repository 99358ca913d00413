"""What the verbs print: words and tables of render/, laid out for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.cli import console
from sdp_vs_penalty.cli.console import out, paragraph, say
from sdp_vs_penalty.diagnosis.comparison import Comparison
from sdp_vs_penalty.errors import printable
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.gains import channel_gains, drive_gains, loop_gains
from sdp_vs_penalty.estimation.verdict import Verdict
from sdp_vs_penalty.render import tables

if TYPE_CHECKING:  # `identify` needs no diagnosis
    from sdp_vs_penalty.checks.issue import Issue
    from sdp_vs_penalty.checks.report import Report
    from sdp_vs_penalty.diagnosis.findings import Diagnosis, Finding
    from sdp_vs_penalty.diagnosis.where_it_fails import Failures
    from sdp_vs_penalty.render.words import DiagnosisWords


def estimate(
    result: Estimate,
    fit: Comparison | None,
    seconds: float,
) -> None:
    """What was identified, how well it fits, and what the certificate says of it.

    fit : against the measurements that it came from; None for a black box's answers.
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
    certificate(result)
    gains(result)
    links = tables.link_table(result, centres=False)
    if links is not None:
        console.table(links)
    if fit is not None:
        comparison([fit], result.robot.torque_units, "Error on these measurements")


def gains(result: Estimate) -> None:
    """Gains of torque channels, of servos in place of a torque, and of loops."""
    if channels := channel_gains(result):
        words = [f"{gain.value:.3f} ± {gain.spread}" for gain in channels]
        say(
            "gains of the torque channels, from the known load (± 95 %):"
            f" {', '.join(words)}"
        )
    if law := result.details.get("servo"):
        servo(result, law)
    if loop := result.details.get("loop"):
        servo_loop(result, loop)


def servo_loop(result: Estimate, loop: dict[str, Any]) -> None:
    """How much of the logged torque the servos' loop makes, and its gains."""
    shares = ", ".join(map(formatting.percent, loop["share"]))
    delay = formatting.milli(loop["delay"], "s", 2)
    say(f"the servos' law, {delay} late, makes {shares} of the joints' logged torque")
    _gains("Gains, of the logged torque", loop_gains(result))


def servo(result: Estimate, law: dict[str, Any]) -> None:
    """The law of the servos that stood for a torque, its gains, and what sets the
    scale."""
    delay = "no delay"
    if law["delay"] > 0.0:
        delay = f"commands act {formatting.milli(law['delay'], 's', 2)} late"
    say(f"servo law, in place of a torque: {law['law']}, {delay}")
    if law["held_out"]:
        errors = [f"{name} {error:.4g}" for name, error in law["held_out"].items()]
        say(f"error of each law on data left out, over the least: {', '.join(errors)}")
    say(f"scale: {law['scale']}")
    if law.get("motion"):
        units = result.robot.position_units
        distances = [
            formatting.milli(distance, unit)
            for distance, unit in zip(law["motion"], units, strict=True)
        ]
        say(
            "motion simulated from the command, RMS from the measured:"
            f" {', '.join(distances)}"
        )
    _gains("Gains; kd holds viscous friction too", list(drive_gains(result)))


def _gains(title: str, entries: Sequence[Any]) -> None:
    rows = [(gain.name, gain.value, gain.spread, gain.unit) for gain in entries]
    console.table(tables.gain_table(title, rows))


def verdict(record: Verdict, name: str = "") -> None:
    """The grade with its reason, the weakest of three lines, then the other two."""
    headline = f"{name}: {record.headline}" if name else record.headline
    say(headline, style="bold")
    for line in record.lines[1:]:
        paragraph(f"{line.about} ({line.grade}): {line.text}")
    if record.remark:
        paragraph(record.remark)


def certificate(result: Estimate) -> None:
    """What the certificate says, a line each; which bounds the estimate lies on; how
    many parameters the data determine, and which base parameters the prior decides."""
    entries = list(result.certificate.summary())
    if bounds := result.details.get("on_bounds"):
        advice = f"{', '.join(bounds)}: widen the bounds, or measure more"
        entries.append(("on their bounds", advice))
    entries += result.determined_by_data
    console.details(entries)
    for remark in filter(None, (result.certificate.not_found, result.unweighed)):
        paragraph(remark)


def comparison(
    results: Sequence[Comparison],
    units: Sequence[str],
    title: str = "Error (RMS)",
    names: Sequence[str] = (),
) -> None:
    """One row a joint: error beside the noise floor, and R2 of a single model, of
    several how the first became the last.

    Several models are columns [1], [2], ... so that figures stay readable in a narrow
    terminal, or have ``names``.
    """
    last = results[-1]
    is_alone = len(results) == 1
    is_numbered = not is_alone and not names
    heads = list(names) or ["error"]
    if is_numbered:
        heads = [f"error [{k}]" for k, _ in enumerate(results, start=1)]
    table = tables.error_table(
        heads,
        [result.rmse for result in results],
        last.noise_floor,
        units,
        r2=last.r2 if is_alone else (),
        title=f"{title} below {last.facts()['band'].text}",
    )
    console.table(table)
    if is_numbered:
        for k, result in enumerate(results, start=1):
            say(f"[{k}] {result.name}")


def where_it_fails(failures: Failures, model: str) -> None:
    """Where a model's error is large, in words: a line for each joint of which
    something can be said."""
    from sdp_vs_penalty.render.words import describe_failures

    say(f"Where {model} fails (shares of the error on data left out)", style="italic")
    for line in describe_failures(failures):
        paragraph(line)


def failure_tables(failures: Failures) -> None:
    """All figures of :func:`where_it_fails`."""
    console.table(tables.failure_table(failures))


def diagnosis(
    result: Diagnosis,
    units: Sequence[str],
    model: Path | str,
    has_findings: bool,
    verbose: bool = False,
) -> None:
    """The verdict, the findings with the falling error, and what is left.

    model : the file that was diagnosed; has_findings : whether there is anything to be
    added; verbose : the weak findings at the end as well.
    """
    from sdp_vs_penalty.render.words import describe_diagnosis

    words = describe_diagnosis(result, units, str(model))
    shown = result.effects if verbose else without_trailing_weak(result.effects)
    say(words.verdict, style="bold")
    if result.unexplained_sentence or not has_findings:
        paragraph(words.advice)
    for constant in words.constants:
        paragraph(f"{constant.title}: {constant.sentences}")
    if result.effects:
        _findings(result, words, units, shown)
    for curve in words.curves:
        paragraph(f"curve: {curve}")
    say(words.left)
    _events(words, verbose)
    if words.invisible:
        paragraph(
            "not identifiable from these runs (absorbed by existing parameters):"
            f" {', '.join(words.invisible)}"
        )
    for remark in words.remarks:
        paragraph(remark)
    for number, finding in enumerate(words.findings[: len(shown)], start=1):
        if finding.test:
            say(f"To test finding {number}, record: {finding.test}")


def _events(words: DiagnosisWords, verbose: bool) -> None:
    lines = words.all_events if verbose else words.events
    hint = "" if len(lines) == len(words.all_events) else "; --verbose lists them"
    for line in lines:
        say(f"{line}{hint}")


def _findings(
    result: Diagnosis,
    words: DiagnosisWords,
    units: Sequence[str],
    shown: Sequence[Finding],
) -> None:
    """The table of errors, then a paragraph a finding; what is not shown in a line."""
    from sdp_vs_penalty.render.words import finding_table

    console.table(finding_table(result, shown, units))
    for number, finding in enumerate(words.findings[: len(shown)], start=1):
        rating = "" if finding.rating == "confident" else f" ({finding.rating})"
        paragraph(
            f"{number}. {finding.title}{rating}: {finding.size_and_constants}."
            f" {finding.sentences}"
        )
    if more := words.findings[len(shown) :]:
        paragraph(f"further weak candidates: {'; '.join(f.title for f in more)}")


def without_trailing_weak(effects: Sequence[Finding]) -> Sequence[Finding]:
    """The history without the weak findings at its end, but for the first two of them."""
    places = [k for k, f in enumerate(effects, start=1) if f.torque_is_certain]
    tail = effects[places[-1] :] if places else effects
    return [
        *effects[: places[-1] if places else 0],
        *tail[:2],
    ]


def before_after(
    before: Comparison,
    after: Comparison,
    units: Sequence[str],
    what: str,
) -> None:
    """What became of each joint's error, the verdict after, and both errors as a table."""
    from sdp_vs_penalty.render.words import describe_change

    say(f"On {what}: {describe_change(before, after)}", style="bold")
    verdict(after.verdict)
    comparison([before, after], units, names=("before", "after"))
    errors = [c.facts()["relative_error"].text for c in (before, after)]
    say(f"all joints together: {errors[0]} error before, {errors[1]} after")


def checks(reports: Sequence[Report]) -> None:
    """What the check says: of all runs together first, then of each."""
    first = reports[0].issues if reports else ()
    others = reports[1:]
    common = [
        issue
        for issue in first
        if others and all(_has(r.issues, issue) for r in others)
    ]
    if common:
        say(f"All {len(reports)} runs", style="bold")
        for issue in common:
            _issue(issue)
    for report in reports:
        say(report.verdict, style="bold")
        for issue in report.issues:
            if not _has(common, issue):
                _issue(issue)


def _has(issues: Sequence[Issue], issue: Issue) -> bool:
    """Whether the same is said already."""
    return any((f.where, f.what) == (issue.where, issue.what) for f in issues)


#: Of an issue's severity.
_COLOURS = {"error": "red", "warning": "yellow", "note": "dim"}


def _issue(issue: Issue) -> None:
    """One issue: severity and kind, what, how sure, what to do."""
    from rich.markup import escape

    word = f"[{_COLOURS[issue.severity]}]{issue.severity}[/]"
    nature = "" if issue.nature == "fact" else " [dim]explanation[/]"
    kind = escape(printable(issue.kind))
    where = escape(printable(issue.where))
    out.print(f"  {word}{nature} {kind} ({where})")
    tries = " (--fix does it)" if issue.mends else ""
    if issue.apply:
        tries = f" (--fix with --apply {issue.apply} tries it)"
    for text in (
        issue.what,
        f"How sure: {issue.certainty}.",
        f"What to do: {issue.remedy}{tries}.",
    ):
        say(f"    {text}")
