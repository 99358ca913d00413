"""What explains the torques of all runs together.

Order, signs, units, clock and mounting belong to the logger: one search over the rows of
all runs finds them, and each has to hold in every run. What belongs to one run (its
load, a zero, or a fault of its log alone) is claimed with that run named.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks.certainty import certain
from sdp_vs_penalty.checks.constants import GAP, NO_DYNAMICS
from sdp_vs_penalty.checks.explain import (
    NOT_REPAIRED,
    graded,
    issue_of_difference,
    issue_of_span,
    issues_of_all,
    repair_of,
)
from sdp_vs_penalty.checks.issue import Issue, make_refusal
from sdp_vs_penalty.checks.position_units import unit_asked_for
from sdp_vs_penalty.checks.problem_units import problem_units
from sdp_vs_penalty.checks.report import Report
from sdp_vs_penalty.checks.residual import (
    EVENT,
    EVENT_WIDTH,
    unexplained_torque,
    unrelated_torque,
)
from sdp_vs_penalty.checks.torque_size import (
    kind_of_torque,
    not_in_newton_metres,
    torque_magnitude,
)
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.kinds import KINDS, SHOWN_BY_A_POOR_MOTION, list_faults, order
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.race import Claim, Race, RaceOutcome
from sdp_vs_penalty.race.rows import RegressionData
from sdp_vs_penalty.results.remedy import Change

#: Currents have no gains of their own that torques would show.
UNSCALED = ("torque channel kind",)
#: What changes within a run.
TWO_ARMS = "two arms"
#: Of torques that are none of the arm's motors, nothing else is said.
NO_TORQUE = "external torque"


def judge_dynamics(problem: Problem, reports: Sequence[Report]) -> list[Report]:
    """Explain the torques of all runs together: search for faults of the logger, and of
    single runs.

    Parameters
    ----------
    problem : Problem
        Of the robot that was logged.
    reports : sequence of Report
        Of all runs, with their facts.

    Returns
    -------
    list of Report
        The same with explanations, and each run as it would be repaired.
    """
    units = [*problem_units(problem)]
    if units:
        return [with_issues(report, units) for report in reports]
    judge = LoggerJudge(problem, reports)
    return judge.judge() if judge.logs else judge.reports


class LoggerJudge:
    """Judge the dynamics of all runs that one logger recorded of one arm.

    reports : of all runs, with their facts; logs : by the run's number, the rows of
    those whose dynamics can be judged; only_in : by the run's number, what is repaired
    in that run alone; issues_of_one : by the run's number, the issues of that run
    alone; clock_shifts : by the run's number, the time [s] by which its clock is put
    forward in the log of all runs together.
    """

    def __init__(self, problem: Problem, reports: Sequence[Report]) -> None:
        """Filter the rows of each run whose dynamics can be judged; a run too short for
        the filters gets an issue instead.

        reports : of all runs, with their facts.
        """
        self.problem = problem
        self.reports = [*reports]
        self.logs: dict[int, Likelihood] = {}
        for k, report in enumerate(reports):
            if not has_dynamics(report):
                continue
            try:
                self.logs[k] = self.rows_of(report.repaired_all)
            except InputError as error:
                issue = make_refusal(
                    "too little data", error, certain("the filters need more")
                )
                self.reports[k] = with_issues(report, [issue])
        as_logged = LogTransform.unchanged(problem.robot.n, problem.robot.gravity)
        self.only_in = dict.fromkeys(self.logs, as_logged)
        self.is_poor_motion = False
        self.clock_shifts: dict[int, float] = {}

    def rows_of(self, run: Measurements) -> Likelihood:
        """Return the filtered rows of one run, to fit arms to. Raises InputError for a
        run shorter than the filters need."""
        data = RegressionData.from_run(
            self.problem, run, self.problem.preprocessing.resolve(run)
        )
        return Likelihood(self.problem, data)

    def judge(self) -> list[Report]:
        """Hold the race of all explanations; return the reports with what it says.

        If the torques are no measured ones (a controller's gravity model), that is the
        only explanation.
        """
        logs = [*self.logs.values()]
        common = Likelihood.of_all_runs(logs)
        not_measured = [*kind_of_torque(common)]
        if not_measured:
            for number in self.logs:
                report = self.reports[number]
                self.reports[number] = with_issues(report, not_measured)
            return self.reports
        shifts = common.data.clock_shifts
        self.clock_shifts = dict(zip(self.logs, shifts, strict=True))
        reports = [self.reports[number] for number in self.logs]
        kinds = KINDS
        self.is_poor_motion = all(report.has_poor_motion for report in reports)
        if self.is_poor_motion:
            kinds = SHOWN_BY_A_POOR_MOTION
        elif any(report.lockstep is not None for report in reports):
            # Channels that move in proportion look the same.
            kinds = tuple(kind for kind in KINDS if kind is not order)
        race = Race(logs, kinds, self.is_poor_motion)
        verdict = race.run()
        self._report(common, verdict)
        for number in self.logs:
            report = self.reports[number]
            if command := report.repaired_all.unit_command:
                asked = unit_asked_for(race.all, verdict.fit, command)
                self.reports[number] = with_issues(report, asked)
        return self.reports

    def _report(self, common: Likelihood, verdict: RaceOutcome) -> None:
        """Add the explanations to the reports of all runs.

        They are what the race says, the size of the torques, and the torque that stays
        unexplained. If the size shows that the channels hold no motor torque, only that
        and the unexplained torque are reported. If it shows another unit of all
        torques, gains and units of single torques are left out.
        """
        net = verdict.told(common)
        runs = [
            (self.reports[number].run, log, self._of_run(number, net))
            for number, log in self.logs.items()
        ]
        stated = issues_of_all(common, verdict, net, runs)
        facts = [f.kind for report in self.reports for f in report.issues]
        size = []
        unit = next(iter(self.reports)).repaired_all.torque_unit
        if unit:
            size = [not_in_newton_metres(unit)]
        elif "torque in counts" not in facts:
            size = [*torque_magnitude(common, net)]
        if any(issue.kind == NO_TORQUE for issue in size):
            for number, log in self.logs.items():
                left = [*unrelated_torque(log.fit(net))]
                self.reports[number] = with_issues(self.reports[number], size + left)
            return
        is_rated = "torque in counts" in facts  # each channel has a size of its own
        if is_rated or any(issue.kind in UNSCALED for issue in size):
            stated = [f for f in stated if f.kind not in ("torque gain", "torque unit")]
        for number in self.logs:
            differences = self._differences(number, verdict)
            self._report_run(number, stated, differences, size, net)

    def _differences(self, number: int, verdict: RaceOutcome) -> list[Issue]:
        """List the issues about what differs in one run, or from an instant of it on;
        its log is repaired where a change of the log undoes that."""
        log = self.logs[number]
        place = [*self.logs].index(number)
        issues = []
        for claim in verdict.differences():
            part = claim.hypothesis.part
            if part is None or part.run not in (None, place):
                continue
            if part.until is not None:
                begin, end = (self._time_in_run(number, x) for x in part.ends)
                if begin is not None and end is not None:
                    issue = issue_of_span(log, claim, begin, end)
                    at, (first, last) = issue.figures["t"], issue.figures["span"]
                    cut = _cut_around(self.reports[number], at, last - first)
                    issue = replace(issue, changes=(cut,))
                    issues.append(graded(issue, verdict, [claim]))
                continue
            repair = repair_of(claim)
            if part.after is None:
                issue = issue_of_difference(log, claim, self.reports[number].run)
                issues.append(graded(issue, verdict, [claim]))
                if repair is not None:
                    self.only_in[number] = self.only_in[number].followed_by(repair)
            else:
                issue = graded(_two_arms(log, claim, part.after), verdict, [claim])
                cuts = _cuts_at(self.reports[number], part.after)
                issues.append(replace(issue, changes=cuts))
        are_two = [issue for issue in issues if issue.kind == TWO_ARMS][:1]
        return are_two if issues[:1] == are_two else issues

    def _report_run(
        self,
        number: int,
        stated: Sequence[Issue],
        differences: Sequence[Issue],
        size: Sequence[Issue],
        net: LogTransform,
    ) -> None:
        """Add the explanations to one run's report, and repair its run.

        Explanations that a fact of the run covers already are left out.

        Parameters
        ----------
        number : int
            Number of the run, from 0.
        stated : sequence of Issue
            Faults that all runs share.
        differences : sequence of Issue
            What differs in this run.
        size : sequence of Issue
            Issues about the size of the torques.
        net : LogTransform
            The repair that all runs share.
        """
        log = self.logs[number]
        report = self.reports[number]
        net = self._of_run(number, net)
        repaired = self.only_in[number].followed_by(net)
        if self.only_in[number] != log.as_logged:
            # Rows are judged as the difference from the other runs is undone.
            net = repaired
        # What is done twice to a run, as its sign turned in all runs and here again, is
        # not done.
        left = list_faults(log, repaired)
        faults = {(fault.kind, j) for fault in left for j in fault.joints or (-1,)}
        of_log = [
            issue
            for issue in (*self._said_of_run(number, stated), *differences)
            if not issue.apply
            or faults.intersection(
                (issue.kind, j - 1) for j in issue.figures["joints"] or (0,)
            )
        ]
        # Of a motion of few directions what is left says nothing.
        unexplained = [] if self.is_poor_motion else [*unexplained_torque(log, net)]
        if any(x.kind in (TWO_ARMS, EVENT, *NOT_REPAIRED) for x in differences):
            unexplained = [f for f in unexplained if f.kind != EVENT]
        unexplained = [
            replace(f, changes=(_cut_around(report, f.figures["t"]),))
            if f.kind == EVENT
            else f
            for f in unexplained
        ]
        explanations = [*of_log, *size, *unexplained]
        new = [
            issue for issue in explanations if not is_explained_by_a_fact(issue, report)
        ]
        # Repaired by the search first, then by what is left unexplained (events).
        run = repaired.apply(report.repaired_all)
        for issue in (*differences, *size, *unexplained):
            if issue.repair is not None and not (issue in differences and issue.apply):
                run = issue.repair(run)
        self.reports[number] = replace(
            report,
            issues=(*report.issues, *new),
            repaired_all=run,
            unexplained=log.fit(net).unexplained,
            corrected=_kinds_corrected(report.issues, of_log),
            gravity=net.gravity if log.spare_share > 0.0 else None,
        )

    def _time_in_run(self, number: int, t: float) -> float | None:
        """Return the instant t [s] of the log of all runs together by the clock of run
        ``number``; None where it lies in another run."""
        shift = self.clock_shifts[number]
        of_run = self.logs[number].data.motion.t
        is_inside = of_run[0] <= t - shift <= of_run[-1]
        return t - shift if is_inside else None

    def _of_run(self, number: int, net: LogTransform) -> LogTransform:
        """Return the repair of all runs as it holds in one of them: without the steps
        of other runs, and with the instants of its own by its own clock."""
        events = []
        for event in net.events:
            if event.at is None:
                events.append(event)
            elif (at := self._time_in_run(number, event.at)) is not None:
                events.append(replace(event, at=at))
        return replace(net, events=tuple(events))

    def _said_of_run(self, number: int, stated: Sequence[Issue]) -> list[Issue]:
        """Return the issues of all runs that concern one of them: no step of another
        run, and the instants of its own by its own clock."""
        said = []
        for issue in stated:
            figures = dict(issue.figures)
            if "t" in figures:
                at = self._time_in_run(number, figures["t"])
                if at is None:
                    continue
                figures["t"] = at
                issue = replace(
                    issue,
                    what=issue.what.format(t=at),
                    where=issue.where.format(t=at),
                    figures=figures,
                    changes=_cuts_at(self.reports[number], at),
                )
            said.append(issue)
        return said


def _two_arms(log: Likelihood, claim: Claim, t: float) -> Issue:
    """Return the issue that a run ends with another arm than it begins with, from the
    instant t [s] on: a load was picked up, or the file holds the logs of two arms."""
    name = f"the part from t = {t:.4g} s on"
    issue = issue_of_difference(log, claim, name)
    place = f"t = {t:.4g} s"
    if issue.figures["joints"]:
        place = f"{issue.where}, {place}"
    return replace(
        issue,
        kind=TWO_ARMS,
        where=place,
        remedy="cut the run there and use each part by itself",
        apply="",
        repair=None,
        figures={**issue.figures, "t": t},
    )


def _kinds_corrected(
    facts: Sequence[Issue], explanations: Sequence[Issue]
) -> tuple[str, ...]:
    """Return the kinds of issue that the fit of one arm to a run is corrected for, each
    once.

    They are the facts that have a repair, and what the search found wrong with the log.
    Notes are none: laws of friction are the arm's. Another load or arm stays in the rows.
    """
    repaired = [issue for issue in facts if issue.repair is not None]
    found = [issue for issue in explanations if issue.kind not in NOT_REPAIRED]
    kinds = [x.kind for x in [*repaired, *found] if x.severity != "note"]
    return tuple(dict.fromkeys(kinds))


def with_issues(report: Report, issues: Sequence[Issue]) -> Report:
    """Return the report with more issues behind its own.

    Returns
    -------
    Report
        With these issues as well.
    """
    return replace(report, issues=(*report.issues, *issues))


def has_dynamics(report: Report) -> bool:
    """Whether the dynamics of a run can be judged: torques were logged, and no fact
    rules it out.

    Returns
    -------
    bool
        Whether they can be judged.
    """
    stops = any(f.kind in NO_DYNAMICS for f in report.issues)
    return report.repaired_all.torque_logged and not stops


def is_explained_by_a_fact(issue: Issue, report: Report) -> bool:
    """Whether a fact of the run already explains an issue: all its joints are clipped,
    or a one-off event lies where rows are missing."""
    if issue.kind == EVENT:
        return _is_near_gap(report.repaired_all, issue.figures["t"])
    clipped: set[int] = set()
    for fact in report.issues:
        if fact.kind == "saturation":
            clipped.update(fact.figures["joints"])
    joints = issue.figures.get("joints", ())
    return bool(joints) and clipped.issuperset(joints)


def _is_near_gap(run: Measurements, t: float) -> bool:
    """Whether rows are missing within a second of an instant [s]."""
    steps = np.diff(run.t)
    is_gap = steps > GAP * np.median(steps)
    near = np.abs(run.t[1:] - t) < 1.0
    return bool(np.any(is_gap & near))


def _cut_around(report: Report, at: float, width: float = EVENT_WIDTH) -> Change:
    """Return the change that leaves out what happens once about an instant [s] of a
    run's clock."""
    span = [at - 0.5 * width, at + 0.5 * width]
    words = f"leave {width:.2g} s around {at:.4g} s of {report.run} out"
    return Change("cut", words, {"run": report.run, "spans": [span]})


def _cuts_at(report: Report, at: float) -> tuple[Change, ...]:
    """Return the changes that leave out what a run holds after an instant [s] of its
    clock, or before it: the longer part stays first."""
    begin, end = report.repaired_all.t[[0, -1]].tolist()
    parts = [("after", [at, end]), ("before", [begin, at])]
    parts.sort(key=lambda part: part[1][1] - part[1][0])
    return tuple(
        Change(
            "cut",
            f"leave what comes {word} {at:.4g} s of {report.run} out",
            {"run": report.run, "spans": [span]},
        )
        for word, span in parts
    )
