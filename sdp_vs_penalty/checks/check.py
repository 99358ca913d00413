"""How a log is judged: first the facts of each run, then what explains its torques.

:func:`check` is the verb. docs/checks.md has one paragraph for each function here, in
the order of the code.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.checks import residual
from sdp_vs_penalty.checks.certainty import READ, stated
from sdp_vs_penalty.checks.constants import RUN
from sdp_vs_penalty.checks.dynamics import judge_dynamics, with_issues
from sdp_vs_penalty.checks.facts import channels, magnitude, mended, standing, stuck
from sdp_vs_penalty.checks.facts.lockstep import LockstepMotion
from sdp_vs_penalty.checks.facts.repetition import find_overlaps
from sdp_vs_penalty.checks.glance import RunSummary
from sdp_vs_penalty.checks.issue import (
    FACT,
    Issue,
    Left,
    gravest_first,
    leave_out,
    left_to_judge,
    make_refusal,
    mended_unasked,
    no_surer,
)
from sdp_vs_penalty.checks.long_runs import issues_of_run, windows_of
from sdp_vs_penalty.checks.position_units import units_as_facts
from sdp_vs_penalty.checks.report import Report
from sdp_vs_penalty.checks.torque_size import gains_are_by_size
from sdp_vs_penalty.checks.velocity import find_wrong_velocities
from sdp_vs_penalty.data.files import Source, as_measurements, check_usable
from sdp_vs_penalty.data.hypotheses.by_arm import likeliest_scale
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import (
    check_plausible,
    check_torque,
    far_outside,
    radians_per_percent,
)
from sdp_vs_penalty.errors import InputError, other_robot
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.race.race import HeldRaces
from sdp_vs_penalty.results.remedy import Change
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.threads import on_one_thread


@on_one_thread
@checked_arguments
def check(
    problem: str | Path | Problem,
    measurements: Source,
    preprocessing: Preprocessing | None = None,
    *,
    thorough: bool = True,
) -> list[Report]:
    """Report what is wrong with measurements, one report a run.

    The measurements need not be usable: clock and numbers are checked as well. Runs are
    of one arm and one logger, and are judged together.

    Parameters
    ----------
    problem : str, Path or Problem
        A built-in name, a folder with a problem.toml, a URDF file, or a Problem.
    measurements : path, arrays, DataFrame, Measurements, list of these
        What :func:`~sdp_vs_penalty.data.files.as_measurements` takes: t (N,) s, q (N,
        n) rad or m, tau (N, n) N m or N.
    preprocessing : Preprocessing, optional
        Filter settings; default: the problem's.
    thorough : bool
        Also judge the excitation. Without it, only what would make an identification
        wrong is looked for: this is what `identify` does by itself.

    Returns
    -------
    list of Report
        Of each run its issues, the gravest first, and the run as it would be repaired.

    Raises
    ------
    InputError
        Where robot and measurements differ in their number of joints, or every torque
        is zero.

    Examples
    --------
    >>> from sdp_vs_penalty import check, simulate
    >>> runs = simulate("two_link", seed=1)
    >>> [report.errors_and_warnings for report in check("two_link", runs.test)]
    [()]
    """
    problem = as_problem(problem, "check(problem=...)")
    measurements = as_measurements(
        measurements,
        problem.robot.n,
        problem.channel_names,
        "check(measurements=...)",
        usable=False,
    )
    if preprocessing is not None:
        problem = replace(problem, preprocessing=preprocessing)
    return check_runs(problem, measurements.runs(), thorough)


def check_runs(
    problem: Problem,
    runs: Sequence[Measurements],
    thorough: bool = True,
    are_plausible: bool = False,
    races: HeldRaces | None = None,
) -> list[Report]:
    """Check runs that have been read; of a long run, judge windows.

    runs : single runs of one logger; are_plausible : whether their positions are known to
    be possible for this robot; races : those held for other copies of the runs, which a
    repair checks again. InputError where a run has another number of joints, or no torque.
    """
    for run in runs:
        if len(run.t):
            check_torque(run)
        if run.n != problem.robot.n:
            raise other_robot(run.n, problem.robot.n, run.names[0])
    # A report for each window of each run; a run that is not long is one window.
    by_run = [_facts_of_windows(problem, run) for run in runs]
    windows = [*chain.from_iterable(by_run)]
    for k, issue in find_overlaps([w.as_logged for w in windows]):
        windows[k] = with_issues(windows[k], [issue])
    windows = judge_dynamics(problem, windows, races or HeldRaces())
    windows = [judge_ranges(problem, report, are_plausible) for report in windows]
    windows = without_consequences(windows)
    if thorough:
        windows = [judge_excitation(problem, report) for report in windows]
    windows = [
        replace(w, repaired_unasked=mended_unasked(w.as_logged, w.issues))
        for w in windows
    ]
    reports, first = list[Report](), 0
    for run, of_run in zip(runs, by_run, strict=True):
        end = first + len(of_run)
        report = _report_of_run(run, windows[first:end])
        issues = _with_last_resort(report, len(runs) > 1)
        reports.append(replace(report, issues=gravest_first(issues)))
        first = end
    return reports


def without_consequences(reports: Sequence[Report]) -> list[Report]:
    """Return the reports of one logger without explanations that nothing mends, while
    columns are in doubt: read in a wrong unit, order or sign, they make an arm of other
    masses, loads or friction. What remains of these is said when the columns are right.
    """
    of_columns = [x for r in reports for x in r.issues if x.is_of_columns]
    if not any(x.severity == "error" or x.is_likely for x in of_columns):
        return [*reports]
    return [
        replace(report, issues=tuple(x for x in report.issues if not x.may_follow))
        for report in reports
    ]


def _with_last_resort(report: Report, has_others: bool) -> list[Issue]:
    """Return the issues of a run. If there are other runs, errors and differences from the
    others that have no remedy advise to leave this run out."""
    if not has_others:
        return [*report.issues]
    issues = []
    for issue in report.issues:
        is_grave = issue.severity == "error" or issue.stays_in_rows
        if is_grave and not issue.remedies:
            issue = replace(issue, changes=(leave_out(report.run),))
        issues.append(issue)
    return issues


def _facts_of_windows(problem: Problem, run: Measurements) -> list[Report]:
    """Return one report with the facts of a run; of a long run, one for each window.

    A long run with unusable rows has a single report, which refuses it.
    """
    windows = windows_of(run)
    if len(windows) > 1:
        try:
            check_usable(run.names[0], run)
        except InputError as error:
            issue = make_refusal("unusable rows", error, READ, left=Left.FACTS)
            return [Report(run.names[0], (issue,), run, run)]
    return [judge_facts(problem, window) for window in windows]


def judge_facts(problem: Problem, run: Measurements) -> Report:
    """Report the facts of a run, and repair those that can be repaired.

    No fact is surer than the repairs before it: a fact that appears only after an uncertain
    repair is likely at most.
    """
    report = _facts_of(problem, run)
    if all(f.repair is None or f.is_stood_on for f in report.issues):
        return report
    sure = _facts_of(problem, run, only_sure=True)
    return replace(report, issues=no_surer(report.issues, sure.issues))


def _facts_of(problem: Problem, run: Measurements, only_sure: bool = False) -> Report:
    """Report the facts of a run, with the run as their repairs leave it; only_sure :
    without uncertain repairs.

    Facts are read from rows, clock and channels. An arm is fitted only to a torque that
    stays at one value, looks like a magnitude, or carries no noise. The rules run in
    order, each on the run as the rules before have repaired it. They stop early if no
    rows, no numbers or too few rows are left.
    """
    if not len(run.t):
        error = InputError("there are no rows", "log the motion", run.names[0])
        issue = make_refusal("no rows", error, READ, left=Left.NOTHING)
        return Report(run.names[0], (issue,), run, run)
    issues, glance = mended(run, problem, only_sure)
    work = glance.run
    report = Report(run.names[0], tuple(issues), work, run, original=run)
    if left_to_judge(issues) is Left.NOTHING:
        return report
    if len(work.t) < RUN:
        error = InputError(f"fewer than {RUN} usable rows", "record longer", report.run)
        sure = stated("too few rows")
        issues.append(make_refusal("too little data", error, sure, left=Left.FACTS))
        return replace(report, issues=tuple(issues))
    issues += [*standing.find_idle_joints(glance)]
    lockstep = LockstepMotion.find_in(glance)
    if glance.moving.any():
        issues += [
            *([] if lockstep is None else [lockstep.issue()]),
            *find_wrong_velocities(glance),
        ]
        if work.torque_logged:
            issues += stuck.find_bad_torque_channels(glance)
            issues += magnitude.find_magnitudes(glance)
            issues += magnitude.find_model_torques(glance)
            if work.gains_by_size:
                issues.append(gains_are_by_size(work.gains_by_size))
            if not work.is_unit_stated:
                issues += channels.find_torques_in_counts(glance)
        if left_to_judge(issues) > Left.FACTS:
            issues += channels.find_coarse_sampling(glance)
    filters = None if glance.filtered is None else glance.filtered.settings
    return replace(report, issues=tuple(issues), lockstep=lockstep, filters=filters)


def judge_ranges(
    problem: Problem, report: Report, is_plausible: bool = False
) -> Report:
    """Compare positions with the joints' ranges, and report those that leave them.

    Positions that `identify` refuses are an error. is_plausible : whether they are known
    to be possible for this robot.
    """
    issues = [*report.issues]
    is_unit_said = any(f.position_unit is not None for f in issues)
    is_explained = is_unit_said or any(f.of_positions == "zero" for f in issues)
    if len(report.repaired_all.t) >= RUN and not is_explained:
        glance = RunSummary(report.repaired_all, problem)
        issues += [*channels.find_positions_outside_range(glance)]
    if not any(f.severity == "error" for f in issues):
        issues = _with_range_error(problem, report, issues, is_plausible)
    return replace(report, issues=tuple(issues))


def _with_range_error(
    problem: Problem, report: Report, issues: Sequence[Issue], is_plausible: bool
) -> list[Issue]:
    """Return the issues, with an error if positions are impossible for this robot, or if
    the torques show that they are in another unit.

    If positions are impossible, explanations by the arm's torques are left out, but for
    those that make the positions possible.
    """
    run = report.as_logged
    impossible = None
    try:
        if not is_plausible:
            check_plausible(problem.robot, run)
    except InputError as error:
        impossible = error
    if any(f.position_unit is not None for f in issues):
        percent = radians_per_percent(problem.robot, run.q)
        joints = enumerate(problem.robot.joints, 1)
        rails = {j for j, joint in joints if joint.kind == "prismatic"}
        return units_as_facts(issues, impossible is not None, percent, rails)
    if impossible is None:
        return [*issues]
    far = far_outside(problem.robot, run.q)
    certainty = stated("`identify` refuses it")
    refused = make_refusal("position range", impossible, certainty, far)
    repairs = _explanations_of_positions(problem, report, issues)
    if repairs:
        what = "the positions are not possible for this robot as they are logged."
        refused = replace(refused, what=what, remedy=repairs[0].remedy)
    elif unit := likeliest_scale(problem.robot, run, problem.channel_names.links):
        scale = {"run": run.names[0], "scale": {"q": unit}}
        change = Change("read", f"read q in {unit}", scale)
        refused = replace(refused, changes=(change, *refused.changes))
    return [*(f for f in issues if f.nature == FACT), refused, *repairs]


def _explanations_of_positions(
    problem: Problem, report: Report, issues: Sequence[Issue]
) -> list[Issue]:
    """List the explanations whose repairs change positions and make them possible for the
    robot; none where the repaired run is as impossible."""
    try:
        check_plausible(problem.robot, report.repaired_all)
    except InputError:
        return []
    return [f for f in issues if f.apply and f.changes_positions]


def judge_excitation(problem: Problem, report: Report) -> Report:
    """Report the base parameters that the motion of a repaired run does not determine.

    The report stays as it is if the dynamics of the run were not judged.
    """
    if report.unexplained is None:
        return report
    gravity = report.gravity or problem.robot.gravity
    run = report.repaired_all
    known = problem.preprocessing.resolve(run)
    rows = FilteredRuns.filtering(run, known)
    issues = residual.not_excited(problem.with_gravity(gravity), rows)
    return replace(report, issues=(*report.issues, *issues))


def _report_of_run(run: Measurements, windows: Sequence[Report]) -> Report:
    """Merge the reports of a run's windows into one report of the run.

    The unexplained share is the mean of the windows'. A long run is not repaired: its
    repaired copies are the run itself.
    """
    if len(windows) == 1:
        return windows[0]
    shares = [w.unexplained for w in windows if w.unexplained is not None]
    return Report(
        run=run.names[0],
        issues=tuple(issues_of_run([(w.run, w.issues) for w in windows])),
        repaired_all=run,
        repaired_unasked=run,
        unexplained=float(np.mean(shares)) if shares else None,
        gravity=next((w.gravity for w in windows if w.gravity is not None), None),
        corrected=tuple(dict.fromkeys(x for w in windows for x in w.corrected)),
    )
