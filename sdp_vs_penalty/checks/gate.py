"""The check that comes before identification and diagnosis: errors of the log refuse,
everything else is a remark."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks.check import check_runs
from sdp_vs_penalty.checks.issue import EXPLANATION, FACT, Issue
from sdp_vs_penalty.checks.report import Report, list_remedies
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError, RepairableError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.problem.check_command import CheckCommand
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.version import __version__


@dataclass(frozen=True)
class Gate:
    """Who hears what the check says before a verb, and what a user can do then."""

    #: Hears warnings, a sentence each.
    warn: Callable[[str], Any]
    #: How to go on all the same, in words before the verb.
    otherwise: str = "pass check=False to"
    #: How a user checks these runs; None: by the files that are passed.
    command: CheckCommand | None = None
    #: What is checked in place of the runs: the recordings that they are cut from.
    runs: Measurements | None = None


def raise_on_errors(
    problem: Problem,
    measurements: Measurements,
    verb: str,
    gate: Gate,
    gains: bool = False,
    are_plausible: bool = False,
) -> dict[str, tuple[Issue, ...]]:
    """Check runs before identification or diagnosis: raise on errors, warn of the rest.

    Only the fast part of the check is done: excitation is not judged.

    Parameters
    ----------
    problem : Problem
        Of the robot that was logged.
    verb : str
        What comes after the check.
    gate : Gate
        Who hears it.
    gains : bool
        Whether that work determines the torque channels' gains, so that the check need
        not.
    are_plausible : bool
        Whether positions are known to be possible for this robot.

    Returns
    -------
    dict
        Issues by the run's hash.

    Raises
    ------
    InputError
        Where that work would be meaningless: a fact says so.
    """
    runs = (gate.runs or measurements).runs()
    reports = check_runs(problem, runs, thorough=False, are_plausible=are_plausible)
    issues = [
        (report.run, issue)
        for report in reports
        for issue in report.errors_and_warnings
        if not (gains and issue.is_gain)
    ]
    _raise_on_first_error(issues, f"{gate.otherwise} {verb} anyway", reports)
    for run, issue in issues:
        if issue.nature == FACT:
            gate.warn(f"{issue.severity}: {run}: {issue.what} (details: `check`)")
    explanations = [(run, f) for run, f in issues if f.nature == EXPLANATION]
    if explanations:
        line = explanations_in_a_line(gate.command, explanations)
        gate.warn(f"warning: {line}")
    return issues_by_run(reports, gate.runs or measurements)


def issues_by_run(
    reports: Sequence[Report], measurements: Measurements
) -> dict[str, tuple[Issue, ...]]:
    """Return the issues of runs, by the run's hash; empty where a report is
    about several runs."""
    runs = measurements.runs()
    return {
        run.data_hash: report.issues for run, report in zip(runs, reports, strict=True)
    }


def _raise_on_first_error(
    issues: Sequence[tuple[str, Issue]], otherwise: str, reports: Sequence[Report]
) -> None:
    """Raise an InputError for the first error among the issues, with the number of the
    others; nothing without errors.

    issues : each with its run's name; otherwise : how to go on all the same, in words.
    A repairable issue raises a RepairableError, which names all repairs of the reports, as
    the check's next step does.
    """
    errors = [(run, issue) for run, issue in issues if issue.severity == "error"]
    if not errors:
        return
    run, issue = errors[0]
    others = ""
    if len(errors) > 1:
        others = f"; {formatting.count(len(errors) - 1, 'more error')}"
    what = f"{issue.what.rstrip('.')}: {issue.remedy}{others} (details: `check`)"
    asking = [x.repaired_all.unit_command for x in reports if x.run == run]
    if any(x.verb == "read" for x in issue.changes) and any(asking):
        remedy = f"{otherwise}, or name the unit"
        raise InputError(what, remedy, run, f"`{asking[0]}`")
    if not (issue.offers_fix or (issue.apply and not issue.can_fix)):
        raise InputError(what, f"correct the log, or {otherwise}", run)
    repairs = (x.change for x in list_remedies(reports) if x.change.verb == "transform")
    apply = next(repairs).arguments["apply"]
    raise RepairableError(what, f"repair the log, or {otherwise}", run, apply)


def explanations_in_a_line(
    command: CheckCommand | None, explanations: Sequence[tuple[str, Issue]]
) -> str:
    """Put the explanations of a log into one line.

    It says what the log looks like, that it is taken as it is, and which command tries
    the repair of all runs, which are judged together.

    Parameters
    ----------
    command : CheckCommand or None
        Of these runs; None: the line names `check` alone.
    explanations : sequence of (str, Issue)
        Each with its run's name.
    """
    first = explanations[0][0]
    texts = list(dict.fromkeys(issue.what.rstrip(".") for _, issue in explanations))
    others = ""
    if len(texts) > 1:
        others = f" (and {formatting.count(len(texts) - 1, 'more such thing')})"
    apply = list(dict.fromkeys(f.apply for _, f in explanations if f.apply))
    line, how = "check", "says more"
    if command is not None:
        words = command.words
        if apply:
            words = command.applying(apply).repair_words
            how = "tries the repair, and shows both errors"
        line = formatting.command(*words)
    return (
        f"{first}: it looks as if {texts[0]}{others}. The log is taken as it is;"
        f" `{line}` {how}"
    )


def needs_check(estimate: Estimate, measurements: Measurements) -> bool:
    """Whether runs have to be checked before work with a model that was identified from
    runs.

    Parameters
    ----------
    estimate : Estimate
        The model, whose provenance has the hash of its runs and their issues.
    measurements : Measurements
        The runs of the work.

    Returns
    -------
    bool
        False for the model's own runs if the user has left the check out, or if this
        version of the check has found neither an error nor a warning in them.
    """
    if consented(estimate, measurements):
        return False
    provenance = estimate.provenance
    issues_by_run = estimate.issues_by_run
    is_of_this_version = provenance["versions"].get("sdp_vs_penalty") == __version__
    # Runs are judged together: the result holds for exactly these.
    is_of_these_runs = provenance["data_hash"] == measurements.data_hash and all(
        run.data_hash in issues_by_run for run in measurements.runs()
    )
    if not (provenance.get("checked") and is_of_this_version and is_of_these_runs):
        return True
    return any(
        issue.severity in ("error", "warning")
        for issues in issues_by_run.values()
        for issue in issues
    )


def consented(estimate: Estimate, measurements: Measurements) -> bool:
    """Whether a model was identified from the same runs without the check."""
    provenance = estimate.provenance
    return (
        provenance["data_hash"] == measurements.data_hash
        and provenance.get("checked") is False
    )
