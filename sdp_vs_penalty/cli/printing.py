"""What `identify`, `compare`, `diagnose` and `add` print."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.cli.console import details, out, paragraph, say, table
from sdp_vs_penalty.diagnosis.comparison import Comparison
from sdp_vs_penalty.errors import printable
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import LINK_HEADS, Estimate, link_rows
from sdp_vs_penalty.estimation.verdict import Verdict, changes
from sdp_vs_penalty.formatting import number, plain_unit

if TYPE_CHECKING:  # `identify` needs no diagnosis
    from sdp_vs_penalty.checks import Issue, Report
    from sdp_vs_penalty.diagnosis.findings import Diagnosis, Finding
    from sdp_vs_penalty.diagnosis.where_it_fails import JointFailure


def estimate(result: Estimate, fit: Comparison | None, seconds: float) -> None:
    """What was identified, how well it fits, and what the certificate says of it.

    fit : against the measurements that it came from; None for a black box's answers.
    """
    runs = formatting.count(len(result.provenance["runs"]), "run")
    data = f"{result.provenance['samples']} samples of {runs}"
    fitted = (
        ""
        if fit is None
        else f", relative error {number(fit.relative_error_percent)} %"
    )
    say(
        f"{result.problem.name} by {result.method} from {data}: {len(result.theta)}"
        f" parameters{fitted}, {seconds:.1f} s",
        style="bold",
    )
    if fit is not None:
        verdict(fit.verdict)
    certificate(result)
    if gains := result.details.get("gains"):
        details = (
            f"{g:.3f} ± {s:.2g}"
            for g, s in zip(gains["gain"], gains["std"], strict=True)
        )
        say(f"gains of the torque channels, from the known load: {', '.join(details)}")
    if law := result.details.get("servo"):
        servo(result, law)
    if loop := result.details.get("loop"):
        shares = ", ".join(f"{100.0 * x:.3g} %" for x in loop["share"])
        delay_words = f"{1e3 * loop['delay']:.2g} ms late"
        say(
            f"the servos' law, {delay_words}, makes {shares} of the joints' logged torque"
        )
        gains = [
            (k, g["value"], f"{NORMAL_95 * g['std']:.2g}", g["unit"])
            for k, g in loop["gains"].items()
        ]
        _gains("Gains, of the logged torque", gains)
    if links := link_rows(result):
        heads, *lines = (
            [*row[:4], *row[5:]] for row in (LINK_HEADS, *links)
        )  # no centres: too wide
        table("Links, identified and nominal", heads, lines)
    if fit is not None:
        comparison([fit], result.robot.torque_units, "RMSE on these measurements")


def servo(result: Estimate, servo_details: dict[str, Any]) -> None:
    """The law of the servos that stood for a torque, its gains, and what sets the
    scale."""
    errors = ", ".join(f"{law} {x:.4g}" for law, x in servo_details["held_out"].items())
    delay_words = (
        f"commands act {1e3 * servo_details['delay']:.2g} ms late"
        if servo_details["delay"] > 0.0
        else "no delay"
    )
    say(
        f"servo law, in place of a torque: {servo_details['law']}, {delay_words}"
        + (f" (held-out error over the least: {errors})" * bool(errors))
    )
    say(f"scale: {servo_details['scale']}")
    if servo_details.get("motion"):
        units = result.robot.position_units
        apart = (
            f"{1e3 * x:.3g} m{u}"
            for x, u in zip(servo_details["motion"], units, strict=True)
        )
        say(
            "motion simulated from the command, RMS from the measured:"
            f" {', '.join(apart)}"
        )
    model = result.model
    error = servo_details.get("scale_error", 0.0)
    # The gain that stands for the scale is as uncertain as what set it.
    parameters = zip(
        model.parameters, result.theta, result.uncertainty.std, strict=True
    )
    gains = []
    for p, x, s in (
        drive_parameters
        for drive_parameters, drive in zip(parameters, model.drives, strict=True)
        if drive
    ):
        half = NORMAL_95 * (error * x if p.name in model.known else s)
        stated = p.name in model.known
        # Where half its interval holds zero, no motion of this log tells a gain.
        spread = f"{half:.2g}" if half < abs(x) else "not determined"
        gains.append((p.name, x, "given" if stated and not error else spread, p.unit))
    _gains("Gains; kd holds viscous friction too", gains)


def _gains(title: str, gains: Sequence[tuple[str, float, str, str]]) -> None:
    rows = [
        (name, f"{x:.4g}", spread, plain_unit(unit)) for name, x, spread, unit in gains
    ]
    table(title, ["gain", "value", "+-", "unit"], rows)


def verdict(verdict_record: Verdict, name: str = "") -> None:
    """The grade with its reason, the weakest of three lines, then the other two."""
    say(
        f"{name}: {verdict_record.headline}" if name else verdict_record.headline,
        style="bold",
    )
    for line in verdict_record.lines[1:]:
        paragraph(f"{line.about} ({line.grade}): {line.text}")
    if verdict_record.remark:
        paragraph(verdict_record.remark)


def certificate(result: Estimate) -> None:
    """What the certificate says, a line each; which bounds the estimate lies on; how
    many parameters the data determine, and which base parameters the prior decides.

    Where a base parameter that should be the data's has no standard deviation, none of
    it is known.
    """
    lines = result.certificate.summary()
    name = "determined by the data"
    if bounds := result.details.get("on_bounds"):
        lines.append(
            (
                "on their bounds",
                f"{', '.join(bounds)}: widen the bounds, or measure more",
            )
        )
    base = result.details.get("base_parameters") or []
    prior = {
        b["name"]: b["source"] for b in base if b["source"] not in ("data", "given")
    }
    std = {b.name: b.std for b in result.uncertainty.base}
    blind = sum(
        b["source"] == "data" and np.isnan(std.get(b["name"], 0.0)) for b in base
    )
    if blind:
        text = (
            f"nothing is known of the intervals: {blind} of {len(base)} base parameters"
            " have none"
        )
        lines.append((name, text))
    elif base:
        sure = len(base) - len(prior)
        n_own = result.sources.count("data")
        text = (
            f"{sure} of {len(base)} base parameters, {n_own} of {len(result.theta)}"
            " standard"
        )
        lines.append((name, text))
    if prior and not blind:
        first = next(iter(prior.values()))
        lines.append(
            (f"from the {first}", f"{', '.join(prior)}; see `source` in the file")
        )
    details(*zip(*lines, strict=True))
    for remark in filter(None, (result.certificate.not_found, result.unweighed)):
        paragraph(remark)


def comparison(
    results: Sequence[Comparison],
    units: Sequence[str],
    title: str = "RMSE",
    names: Sequence[str] = (),
) -> None:
    """One row a joint: RMSE beside the noise floor, and R^2 of a single model, of
    several how the first became the last.

    Several models are columns [1], [2], ... so that figures stay readable in a narrow
    terminal, or have ``names``.
    """
    last = results[-1]
    numbered = results if len(results) > 1 and not names else []
    heads = (
        list(names)
        or [f"RMSE [{k}]" for k, _ in enumerate(numbered, start=1)]
        or ["RMSE"]
    )
    error_rows = formatting.error_table(
        heads, [r.rmse for r in results], last.noise_floor, units, last.r2
    )
    table(f"{title} below {number(last.band_hz)} Hz", *error_rows)
    for k, result in enumerate(numbered, start=1):
        say(f"[{k}] {result.name}")


def where_it_fails(
    failures: Sequence[JointFailure], units: Sequence[str], model: str
) -> None:
    """Where a model's error is large, in words: a line for each joint of which
    something can be said."""
    from sdp_vs_penalty.diagnosis.where_it_fails import dependences, sentences

    say(
        f"Where {model} fails (held-out shares of the error's variance)", style="italic"
    )
    explained = [f for f in failures if dependences(f) or f.orders]
    for f in explained:
        paragraph(f"joint {f.joint}: {' '.join(sentences(f, units[f.joint - 1]))}")
    if unexplained := [f for f in failures if f not in explained]:
        paragraph(
            f"{formatting.joints([f.joint for f in unexplained])}: {sentences(unexplained[0], '')[0]}"
        )


def failure_tables(failures: Sequence[JointFailure]) -> None:
    """All figures of :func:`where_it_fails`."""
    rows = []
    for f in failures:
        shares_of_joint = {
            "RMSE": f.rmse,
            "noise floor": f.noise_floor,
            "RMS ratio at reversals": f.reversal_lift,
        }
        shares = {"all that repeats": f.explainable_share, **f.held_out_shares}
        shares_of_joint |= {
            f"{name} [%]": None if x is None else 100.0 * x
            for name, x in shares.items()
        }
        rows.append([str(f.joint), *map(number, shares_of_joint.values())])
    title = (
        "Residual of each joint; per cent: of its variance, by a smooth function of"
        " ..., held out"
    )
    heads, *lines = zip(["", *shares_of_joint], *rows, strict=True)
    table(title, heads, lines)


def diagnosis(
    result: Diagnosis, units: Sequence[str], has_findings: bool, verbose: bool = False
) -> None:
    """The verdict, the history of effects with the falling error, and what is left.

    has_findings : whether there is anything to be added; verbose : the weak findings at the
    end as well.
    """
    from sdp_vs_penalty.diagnosis.findings import event_lines

    say(result.headline, style="bold")
    if result.unexplained_sentence or not has_findings:
        paragraph(result.advice)
    for retune in result.retuned:
        why = "; ".join(retune.remarks)
        weak = f" ({retune.rating}: {why})" if why else ""
        paragraph(f"retune {retune.explanation}{weak}")
    if result.effects:
        _findings(
            result,
            units,
            without_trailing_weak(result.effects) if not verbose else result.effects,
        )
    for curve in result.curves:
        paragraph(f"curve: {curve.sentence(units)}")
    say(result.left_sentence)
    lines = event_lines(result.events, verbose)
    for line in lines:
        say(
            line
            if len(lines) == len(result.events)
            else f"{line}; --verbose lists them"
        )
    if result.invisible:
        hidden: dict[str, list[str]] = {}
        for i in result.invisible:
            hidden.setdefault(i.effect, []).append("+".join(map(str, i.joints)))
        names = ", ".join(
            f"{k}:{'+'.join(v)}" if v[0] else k for k, v in hidden.items()
        )
        paragraph(
            "not identifiable from these runs (absorbed by existing parameters):"
            f" {names}"
        )
    for remark in result.remarks:
        paragraph(remark)


def runs_that_decide(result: Diagnosis, model: Path) -> None:
    """The runs that would tell a finding from what fits as well, or a weak one from
    nothing."""
    for k, finding in enumerate(without_trailing_weak(result.effects), start=1):
        if command := finding.telling_run(str(model), k):
            say(f"Finding {k}, the run that would tell: {command}")


def _findings(
    result: Diagnosis, units: Sequence[str], shown: Sequence[Finding]
) -> None:
    kinds = ", ".join(dict.fromkeys(map(plain_unit, units)))
    retuned = bool(result.retuned)
    title = f"Held-out RMSE [{kinds}] of each joint below {number(result.band_hz)} Hz"
    errors = [result.held_out_rmse_before, result.effects[0].held_out_rmse_before][
        : 1 + retuned
    ]
    errors += [f.held_out_rmse_after for f in shown]
    noise = "noise" if result.noise_known else "noise?"
    names = ["model", "retuned"][: 1 + retuned]
    marks = ("" if f.rating == "confident" else f" {f.rating}" for f in shown)
    names += [*(f"+ {k}.{mark}" for k, mark in enumerate(marks, start=1)), noise]
    errors_by_joint = zip(names, [*errors, result.noise_floor], strict=True)
    rows = [(name, *map(number, row)) for name, row in errors_by_joint]
    joints = [str(j + 1) for j in range(len(units))]
    table(f"{title}, refitted at each step", ("with", *joints), rows)
    physics_said: set[str] = set()
    for k, finding in enumerate(shown, start=1):
        head, _, physics = finding.explanation.partition(". ")
        physics_words = "" if finding.effect in physics_said else f". {physics}"
        if physics_words == "" and finding.indistinguishable_from:
            physics_words = (
                f". Indistinguishable from {', '.join(finding.indistinguishable_from)}"
                " in these data."
            )
        physics_said.add(finding.effect)
        why = "; ".join(finding.remarks)
        why = f" {finding.rating.capitalize()}: {why}." if why else ""
        paragraph(f"{k}. {head}{physics_words}{why}")
    if len(shown) < len(result.effects):
        more = ", ".join(f.text.partition("@")[0] for f in result.effects[len(shown) :])
        paragraph(f"further weak candidates: {more}")


def without_trailing_weak(effects: Sequence[Finding]) -> Sequence[Finding]:
    """The history without the weak findings at its end, but for the first two of them."""
    last = max((k for k, f in enumerate(effects) if f.torque_is_certain), default=-1)
    return effects[: last + 3]


def before_after(
    before: Comparison, after: Comparison, units: Sequence[str], what: str
) -> None:
    """What became of each joint's error, the verdict after, and both errors as a table."""
    sentence = changes(before.rmse, after.rmse, after.noise_floor)
    sentence = sentence or "no joint's error changed by more than 5 %."
    say(f"On {what}: {sentence}", style="bold")
    verdict(after.verdict)
    comparison([before, after], units, names=("before", "after"))
    errors = (
        number(before.relative_error_percent),
        number(after.relative_error_percent),
    )
    say(
        f"all joints together, relative error: {errors[0]} % before, {errors[1]} %"
        " after"
    )


def checks(reports: Sequence[Report]) -> None:
    """What the check says: of all runs together first, then of each."""
    first = reports[0].issues if reports else ()
    several = len(reports) > 1
    common = [
        f for f in first if several and all(_has(r.issues, f) for r in reports[1:])
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


def _issue(issue: Issue) -> None:
    """One issue: severity and kind, what, how sure, what to do."""
    from rich.markup import escape

    colours = {"error": "red", "warning": "yellow", "note": "dim"}
    word = f"[{colours[issue.severity]}]{issue.severity}[/]"
    nature = "" if issue.nature == "fact" else " [dim]explanation[/]"
    out.print(
        f"  {word}{nature} {escape(printable(issue.kind))} ({escape(printable(issue.where))})"
    )
    tries = " (--fix does it)" if issue.mends else ""
    if issue.apply:
        tries = f" (--fix with --apply {issue.apply} tries it)"
    for text in (
        issue.what,
        f"How sure: {issue.certainty}.",
        f"What to do: {issue.remedy}{tries}.",
    ):
        say(f"    {text}")
