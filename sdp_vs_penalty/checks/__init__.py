"""Are these measurements any good? Issues with what, where, how sure and what to do.

:func:`check` is the verb. Rules about rows and clock come first (one table); then one likelihood of
the arm's dynamics judges compositions of transformations of the log (transformations.py), and what is
reported is the net repair, each number once. Several runs are compared with each other at last.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks import residual, rules
from sdp_vs_penalty.checks.constants import RUN
from sdp_vs_penalty.checks.issue import FACT, Issue
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.long_runs import is_long, issues_of_run, windows_of
from sdp_vs_penalty.checks.regression_data import RegressionData
from sdp_vs_penalty.checks.repair import LogTransform
from sdp_vs_penalty.checks.rules import RunSummary, mended
from sdp_vs_penalty.checks.search import RepairSearch
from sdp_vs_penalty.data.files import Source, as_measurements, check_usable
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import check_plausible, check_torque, far_outside
from sdp_vs_penalty.errors import InputError, other_robot
from sdp_vs_penalty.formatting import Shown, Summary, Table
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.signals.filtered import FilteredRun, FilteredRuns, joined
from sdp_vs_penalty.signals.preprocessing import Preprocessing

__all__ = ["Issue", "Report", "check"]

#: Issues that say in which unit positions are.
POSITION_UNITS = "positions in degrees", "position unit"


@dataclass(frozen=True, repr=False)
class Report(Shown):
    """issues : of one run, the gravest first; repaired_all : the run with every repair made,
    those that are only likely included; repaired_certain : with the certain ones only; unexplained
    : share of the torques' energy that the arm's dynamics leave over, after mending,
    None where there is nothing to fit; arm : the rows and their net repair, where these
    had samples to spare for its parameters.
    """

    run: str
    issues: tuple[Issue, ...]
    repaired_all: Measurements
    repaired_certain: Measurements
    unexplained: float | None = None
    arm: tuple[Likelihood, LogTransform] | None = field(
        default=None, compare=False, repr=False
    )

    @property
    def meaningless(self) -> bool:
        """Whether nothing sensible can be identified from these data: a fact says so."""
        return any(f.severity == "error" for f in self.issues)

    @property
    def is_long(self) -> bool:
        """Whether windows stand for the run: it is not repaired then."""
        return is_long(self.repaired_all)

    @property
    def errors_and_warnings(self) -> tuple[Issue, ...]:
        """Errors and warnings, without notes."""
        return tuple(f for f in self.issues if f.severity != "note")

    @property
    def verdict(self) -> str:
        """How many problems there are, and how well the arm's dynamics explain the
        torque."""
        problem_count = formatting.count(len(self.errors_and_warnings), "problem")
        if self.unexplained is None:
            why = (
                "nothing to identify from"
                if self.repaired_all.torque_logged
                else "no torque was logged"
            )
            return f"{self.run}: {problem_count}; {why}"
        share = 100.0 * self.unexplained**0.5
        return (
            f"{self.run}: {problem_count}; the arm's dynamics leave {share:.2g} % of the torque"
            " unexplained"
        )

    def _summary(self) -> Summary:
        return self.verdict, [(f.severity, f.what) for f in self.issues]

    def _table(self) -> Table | None:
        rows = [(f.kind, f.where, f.certainty, f.remedy) for f in self.issues]
        return (("kind", "where", "certainty", "remedy"), rows) if rows else None

    def changes(self, name: str) -> str:
        """What a repaired copy of the file of this name differs in from it, and what is
        left to do."""
        done = [f for f in self.issues if f.mends]
        left = [f for f in self.errors_and_warnings if not f.mends]
        lines = [
            (
                f"Repaired copy of {name}, in the order of repair:"
                if done
                else f"Copy of {name}:"
            )
        ]
        lines += [
            f"- {f.kind} ({f.where}): {f.what} Done: {f.remedy}. ({f.certainty})"
            for f in done
        ]
        lines += [] if done else ["- nothing was changed"]
        lines += ["Not repaired:"] if left else []
        lines += [f"- {f.kind} ({f.where}): {f.what} To do: {f.remedy}." for f in left]
        return "\n".join(lines) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        return {
            "run": self.run,
            "meaningless": self.meaningless,
            "unexplained_percent": (
                None if self.unexplained is None else 100.0 * self.unexplained**0.5
            ),
            "findings": [f.to_dict() for f in self.issues],
        }


def check(
    problem: str | Path | Problem,
    measurements: Source,
    preprocessing: Preprocessing | None = None,
    *,
    thorough: bool = True,
) -> list[Report]:
    """One report a run. The measurements need not be usable: clock and numbers are
    checked as well.

    problem : a built-in name, a folder, a URDF file, or a Problem; measurements : whatever
        :func:`~sdp_vs_penalty.data.files.as_measurements` takes; preprocessing : filters other than
        the problem's.
    thorough : also look at the excitation; without, only for what would make an identification wrong
        (what `identify` does by itself).
    Raises InputError where robot and measurements differ in their number of joints, or every torque
    is zero.
    """
    problem = as_problem(problem, "check(problem=...)")
    measurements = as_measurements(
        measurements,
        problem.robot.n,
        problem.robot.joint_names,
        "check(measurements=...)",
        usable=False,
    )
    check_torque(measurements)
    if measurements.n != problem.robot.n:
        raise other_robot(measurements.n, problem.robot.n, measurements.names[0])
    settings = preprocessing or problem.preprocessing
    windows: list[Report] = []
    of_run: list[tuple[Measurements, slice]] = []
    for run in measurements.runs():
        first = len(windows)
        windows += _check_windows(problem, run, settings, thorough)
        of_run.append((run, slice(first, len(windows))))
    windows = of_one_arm(windows)
    reports = [_report_of_run(run, windows[part]) for run, part in of_run]
    return [replace(r, issues=_gravest_first(r.issues)) for r in reports]


def _check_windows(
    problem: Problem, run: Measurements, settings: Preprocessing, thorough: bool
) -> list[Report]:
    """A report of the run, or one of each window of a long run whose rows are usable."""
    windows = windows_of(run)
    if len(windows) > 1:
        try:
            check_usable(run.names[0], run)
        except InputError as error:
            issue = _stopped("unusable rows", error, "certain: read from the file")
            return [Report(run.names[0], (issue,), run, run)]
    return [_check_run(problem, window, settings, thorough) for window in windows]


def _report_of_run(run: Measurements, windows: Sequence[Report]) -> Report:
    """One report of a run from those of its windows.

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
        repaired_certain=run,
        unexplained=sum(shares) / len(shares) if shares else None,
        arm=next((w.arm for w in windows if w.arm is not None), None),
    )


def of_one_arm(reports: Sequence[Report]) -> list[Report]:
    """Runs of one arm share its mounting, its zeros, its gains and its load: where one
    run's differ, it is named."""
    out, with_arm = list(reports), [k for k, r in enumerate(reports) if r.arm]
    for number, issue in residual.compare_runs(
        [(*r.arm, r.run) for r in reports if r.arm]
    ):
        report = out[k := with_arm[number]]
        if (issue.kind, issue.where) not in [(f.kind, f.where) for f in report.issues]:
            out[k] = replace(report, issues=_gravest_first([*report.issues, issue]))
    return out


def _gravest_first(issues: Sequence[Issue]) -> tuple[Issue, ...]:
    """In the order of their severity, otherwise as they came."""
    grave = ("error", "warning", "note").index
    return tuple(sorted(issues, key=lambda f: grave(f.severity)))


def _check_run(
    problem: Problem, run: Measurements, settings: Preprocessing, thorough: bool
) -> Report:
    issues, work, fixed = mended(run, problem.robot, settings.standstill)
    report = Report(run.names[0], (), work, fixed)
    try:
        report = judge_dynamics(problem, report, settings, thorough)
    except InputError as error:
        issues.append(
            _stopped("too little data", error, "certain: the filters need more")
        )
    issues += report.issues
    if not any(f.severity == "error" for f in issues):
        try:
            check_plausible(problem.robot, run)
        except InputError as error:
            far, sure = (
                far_outside(problem.robot, run.q),
                "certain: `identify` refuses it",
            )
            units = [k for k, f in enumerate(issues) if f.kind in POSITION_UNITS]
            for k in units:  # the range says so, whatever the torques say
                issues[k] = replace(issues[k], nature=FACT, severity="error")
            if not units:
                issues.append(_stopped("position range", error, sure, far))
    return replace(report, issues=_gravest_first(issues))


def _stopped(
    kind: str, error: InputError, sure: str, joints: Sequence[int] = ()
) -> Issue:
    what, where = f"{error.what.rstrip('.')}.", "" if joints else "the run"
    return Issue.of(kind, "error", joints, what, sure, error.remedy, where=where)


def judge_dynamics(
    problem: Problem, report: Report, settings: Preprocessing, thorough: bool
) -> Report:
    """What a mended run's channels mean: the net repair that makes them one arm's, and
    what is left.

    Raises InputError for a run that is too short for any question."""
    run = report.repaired_all
    if len(run.t) < RUN:
        raise InputError(f"fewer than {RUN} usable rows", "record longer", run.names[0])
    glance = RunSummary(run, problem.robot, settings.standstill)
    issues = [*rules.idle(glance)]
    if not glance.moving.any():
        return replace(report, issues=tuple(issues))
    settings = settings.resolve(run)
    if not run.torque_logged:  # rows, clock and positions are all there is
        motion = joined(FilteredRun(run, settings).states())
        issues += [*rules.coarse(glance, motion, settings), *rules.beside(glance)]
        return replace(report, issues=tuple(issues))
    first = [*rules.torques(glance)]
    if any(
        i.kind == "torque magnitude" for i in first
    ):  # nothing else can be asked of such torques
        return replace(report, issues=tuple(first))
    log = Likelihood(problem, data := RegressionData.of(problem, run, settings))
    net = (search := RepairSearch(log)).run()
    if apart := list(
        residual.two_arms(log, net)
    ):  # another arm, or load, makes steps of its own
        net = replace(net, events=())
    stated = search.describe_faults(net)
    left = [
        *residual.torque_magnitude(log, net),
        *residual.unexplained_torque(log, net),
        *apart,
    ]
    if any(i.kind == "torque channel kind" for i in left):
        scales = "torque gain", "torque unit"
        stated = [
            replace(i, severity="note") if i.kind in scales else i for i in stated
        ]
    bent = [i.figures["joints"] for i in stated if i.kind == "saturation"]
    issues += [
        i for i in first if i.kind != "saturation" or i.figures["joints"] not in bent
    ]
    issues += [*stated, *rules.coarse(glance, data.motion, settings), *left]
    if not any(i.kind in ("encoder offset", "positions in degrees") for i in stated):
        issues += rules.beside(glance)
    work = net.apply(run)
    for issue in left:
        if issue.repair is not None:
            work = issue.repair(work)
    if thorough:
        moved = problem.with_gravity(net.gravity)
        issues += residual.not_excited(moved, FilteredRuns.of(work, settings))
    # A report holds the rows, not what was worked out of them.
    arm = (Likelihood(problem, data), net) if log.spare > 0.0 else None
    return Report(
        report.run,
        tuple(issues),
        work,
        report.repaired_certain,
        log.score(net).unexplained,
        arm,
    )
