"""What `check --fix` writes: facts, and explanations that the user names.

A repair cannot harm: rows are dropped up to a tenth only, and before anything is written
both logs are identified on one split. What does not lower the error on motion left out
is not written. Nor is a copy in which the check finds again what was repaired.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks.issue import Issue
from sdp_vs_penalty.checks.report import Report
from sdp_vs_penalty.data.files import check_usable
from sdp_vs_penalty.data.measurements import MOST_LOST, Measurements, concatenate
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.race.race import HeldRaces
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.runs import sample_rate

#: Share of each run that both logs are identified from; the rest is left out.
TRAINED_ON = 0.7
#: A repair is repeated so many times, since a large fault may hide smaller ones.
_PASSES = 4
#: An error that rises by less is the same where a fact is repaired: other rows are left
#: out. What an explanation repairs has to lower it.
SAME_ERROR = 1.02
#: Sample rates that differ by a smaller share are the same clock's.
SAME_RATE = 0.01


@dataclass(frozen=True)
class LeftOut(JsonRecord):
    """Error on motion left out, without and with a change of the runs: of all joints'
    torque."""

    derived = ("sentence", "falls")

    #: Before the change [%]; None where nothing could be identified from the log as it
    #: is, as where no torque was logged.
    before: float | None = None
    #: After the change [%].
    after: float | None = None

    @property
    def falls(self) -> bool:
        """Whether the change lowers the error, in the digits in which it is said."""
        was, now = (
            math.inf if error is None else float(f"{error:.3g}")
            for error in (self.before, self.after)
        )
        return now < was

    @property
    def sentence(self) -> str:
        """Both errors, in words."""
        if self.before is self.after is None:
            return "No model could be identified, as logged or repaired."
        was, now = (
            "no model could be identified" if error is None else f"{error:.3g} %"
            for error in (self.before, self.after)
        )
        return (
            f"Error on motion left out, all joints together: {was} as logged, {now}"
            " repaired."
        )


@dataclass(frozen=True)
class Repaired:
    """Repaired runs, and the errors without and with the repair."""

    #: Repaired copies, in the order of the reports.
    runs: tuple[Measurements, ...]
    #: Issues that were repaired in each run.
    issues: tuple[tuple[Issue, ...], ...]
    #: Error on motion left out.
    left_out: LeftOut = LeftOut()

    @property
    def sentence(self) -> str:
        """The error on motion left out, as logged and repaired, in words."""
        if not any(self.issues):
            return "Nothing was to be repaired."
        return self.left_out.sentence


def fix_runs(
    problem: Problem,
    runs: Sequence[Measurements],
    reports: Sequence[Report],
    apply: Sequence[str] = (),
    races: HeldRaces | None = None,
) -> Repaired:
    """Repair copies of runs: facts whose repair is safe, and what the user names.

    Parameters
    ----------
    problem : Problem
        Of the robot that was logged.
    reports : sequence of Report
        What :func:`check_runs` says of them.
    apply : sequence of str
        Explanations to repair as well, by their words (``sign:tau3``).
    races : HeldRaces, optional
        Those that were held for the reports.

    Returns
    -------
    Repaired
        The copies, what was repaired, and the error on motion left out before and
        after.

    Raises
    ------
    InputError
        For a word that no report has, for a repair that drops more than a tenth of a
        run, for one after which the check finds the same again, and for one that does
        not lower the error on motion left out, unless the log is refused without it.
    """
    _check_words(reports, apply)
    repaired = [_fixed(report, apply) for report in reports]
    issues = tuple(tuple(done) for _, done in repaired)
    copies = tuple(run for run, _ in repaired)
    remaining: list[tuple[str, Issue]] = []
    if any(issues):
        copies, remaining = _checked_again(
            problem, copies, issues, races or HeldRaces()
        )
    for run, copy, report in zip(runs, copies, reports, strict=True):
        lost = 1.0 - len(copy.t) / max(len(run.t), 1)
        if lost > MOST_LOST:
            what = f"the repair would drop {100.0 * lost:.0f} % of the rows"
            raise InputError(what, "log it again: nothing was written", report.run)
    left_out = LeftOut()
    if any(issues) and all(run.torque_logged for run in runs):
        left_out = errors_left_out((problem, runs), (problem, copies))
        # A log that cannot be identified as it is is no better choice.
        if not any(f.severity == "error" for done in issues for f in done):
            _check_errors(left_out, allowed=1.0 if apply else SAME_ERROR)
    for name, issue in remaining:
        raise InputError(
            f"{issue.kind} ({issue.where}) could not be mended: the check finds it in"
            " the repaired copy, too",
            f"{issue.remedy}; nothing was written",
            name,
        )
    return Repaired(copies, issues, left_out)


#: A robot and its runs.
_Side = tuple[Problem, Sequence[Measurements]]


def errors_left_out(before: _Side, after: _Side) -> LeftOut:
    """Identify runs as they are and as they are changed, from the first 70 % of each, and
    judge both on the rest."""
    filters = _filters(after[0], after[1], before[1])
    errors = [_error_left_out(*side, filters) for side in (before, after)]
    return LeftOut(*errors)


def _check_words(reports: Sequence[Report], apply: Sequence[str]) -> None:
    """Raise an InputError for a word of `--apply` that no report offers."""
    known = {
        word
        for report in reports
        for f in report.issues
        for x in (f, *f.rivals)
        for word in x.apply.split()
    }
    for word in apply:
        if word not in known:
            offers = formatting.words(sorted(known)) if known else "there is none"
            raise InputError(f"--apply {word}: no such repair", f"choose of: {offers}")


def _check_errors(left_out: LeftOut, allowed: float) -> None:
    """Raise an InputError where a repair does not lower the error on motion left out;
    allowed : largest ratio of the two."""
    before, after = left_out.before, left_out.after
    if before is None or (after is not None and after <= before * allowed):
        return
    worse = "cannot be identified" if after is None else f"{after:.3g} %"
    raise InputError(
        "the repair does not lower the error on motion left out:"
        f" {before:.3g} % as logged, {worse} repaired",
        "leave the log as it is: nothing was written",
    )


def _fixed(report: Report, apply: Sequence[str]) -> tuple[Measurements, list[Issue]]:
    """Return the run with its facts and the named explanations repaired, and these
    issues.

    Orders of channels are repaired first: signs and gains refer to joints.
    """
    facts = [f for f in report.issues if f.can_fix]
    offered = [f for f in report.issues if not f.can_fix]
    own_words = {f.apply for f in offered}
    named: list[Issue] = []
    for issue in offered:
        # Of an issue and its rivals the one of which most words are named.
        rivals = [x for x in issue.rivals if x.apply not in own_words]
        meant = [x for x in (issue, *rivals) if x.apply and x.repair is not None]
        meant = [x for x in meant if {*x.apply.split()} <= {*apply}]
        chosen = max(meant, key=lambda x: x.apply.count(" "), default=None)
        done = [x.apply for x in named]
        if chosen is not None and (chosen is issue or chosen.apply not in done):
            named.append(chosen)
    run = report.repaired_unasked
    for issue in sorted(named, key=lambda f: not f.changes_order):
        assert issue.repair is not None
        run = issue.repair(run)
    if any(f.is_velocity_unusable for f in report.issues):
        run = replace(run, dq=None)
    return run, [*facts, *named]


def _checked_again(
    problem: Problem,
    copies: tuple[Measurements, ...],
    issues: Sequence[Sequence[Issue]],
    races: HeldRaces,
) -> tuple[tuple[Measurements, ...], list[tuple[str, Issue]]]:
    """Check repaired copies, and repair facts of the same kinds again: a large fault
    may hide smaller ones.

    Returns the copies, and what was repaired and is still found: the run's name and the
    issue.

    Parameters
    ----------
    problem
        Of the robot that was logged.
    issues
        What was repaired of each.
    """
    from sdp_vs_penalty.checks.check import check_runs

    facts = [{issue.kind for issue in done if issue.can_fix} for done in issues]
    explanations = [
        {(f.kind, f.where) for f in done if not f.can_fix} for done in issues
    ]
    for number in range(_PASSES + 1):
        reports = check_runs(problem, copies, thorough=False, races=races)
        left = [
            [f for f in report.errors_and_warnings if f.can_fix and f.kind in kinds]
            for report, kinds in zip(reports, facts, strict=True)
        ]
        if number == _PASSES or not any(left):
            break
        copies = tuple(
            report.repaired_unasked if of_run else copy
            for report, copy, of_run in zip(reports, copies, left, strict=True)
        )
    remaining: list[tuple[str, Issue]] = []
    for report, of_run, explained in zip(reports, left, explanations, strict=True):
        again = [f for f in report.issues if (f.kind, f.where) in explained]
        remaining += [(report.run, issue) for issue in (*of_run, *again)]
    return copies, remaining


def _filters(
    problem: Problem, copies: Sequence[Measurements], runs: Sequence[Measurements]
) -> Preprocessing:
    """Return the filters for both logs: those resolved for the repaired copies, since
    errors behind filters of different bands do not compare.

    Where the repair changes the clock, each log has the filters of its own rate.
    """
    settings = problem.preprocessing
    for run, copy in zip(runs, copies, strict=True):
        if abs(sample_rate(run) / sample_rate(copy) - 1.0) > SAME_RATE:
            return settings
    try:
        return settings.resolve(concatenate(copies))
    except InputError:  # what follows says that nothing can be identified
        return settings


def _error_left_out(
    problem: Problem, runs: Sequence[Measurements], filters: Preprocessing
) -> float | None:
    """Return the relative error [%] on motion left out: identified from the first 70 %
    of each run, judged on the rest; None where nothing can be identified."""
    from sdp_vs_penalty.diagnosis.comparison import compare
    from sdp_vs_penalty.estimation.build_problem import filter_runs, load_and_check
    from sdp_vs_penalty.estimation.identify import estimate_parameters

    if not all(run.torque_logged for run in runs):
        return None
    train = []
    test = []
    for run in runs:
        end = float(run.t[-1] - run.t[0])
        without_velocity = replace(run, dq=None)
        train.append(without_velocity.window(0.0, TRAINED_ON * end))
        test.append(without_velocity.window(TRAINED_ON * end, end))
    try:
        for run in runs:
            check_usable(run.names[0], run)
        data = load_and_check(problem, concatenate(train), "check --fix")
        assert isinstance(data, Measurements)
        estimate = estimate_parameters(problem, filter_runs(problem, data, filters))
        (judged,) = compare(estimate, concatenate(test))
    except InputError:
        return None
    return float(judged.relative_error_percent)
