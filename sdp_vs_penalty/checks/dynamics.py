"""What explains the torques of all runs together.

Order, signs, units, clock and mounting belong to the logger: one search over the rows of
all runs finds them, and each has to hold in every run. What belongs to one run (its
load, a zero, or a fault of its log alone) is claimed with that run named.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from sdp_vs_penalty.checks.certainty import stated
from sdp_vs_penalty.checks.constants import GAP
from sdp_vs_penalty.checks.explain import (
    SOMETHING_ELSE,
    graded,
    issue_of_difference,
    issue_of_span,
    issues_of_all,
    repair_of,
)
from sdp_vs_penalty.checks.issue import (
    Issue,
    Left,
    left_to_judge,
    make_refusal,
    with_rival_effects,
)
from sdp_vs_penalty.checks.position_units import unit_asked_for
from sdp_vs_penalty.checks.problem_units import problem_units
from sdp_vs_penalty.checks.report import Report
from sdp_vs_penalty.checks.residual import unexplained_torque, unrelated_torque
from sdp_vs_penalty.checks.torque_size import (
    gains_by_size,
    kind_of_torque,
    not_in_newton_metres,
    torque_magnitude,
)
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence
from sdp_vs_penalty.race.kinds import KINDS, SHOWN_BY_A_POOR_MOTION, list_faults, order
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.race import Claim, HeldRaces, RaceOutcome
from sdp_vs_penalty.race.rows import RegressionData
from sdp_vs_penalty.results.remedy import Change


def judge_dynamics(
    problem: Problem, reports: Sequence[Report], races: HeldRaces
) -> list[Report]:
    """Explain the torques of all runs together: search for faults of the logger, and of
    single runs.

    Parameters
    ----------
    problem : Problem
        Of the robot that was logged.
    reports : sequence of Report
        Of all runs, with their facts.
    races : HeldRaces
        Those held for other copies of the runs.

    Returns
    -------
    list of Report
        The same with explanations, and each run as it would be repaired.
    """
    units = [*problem_units(problem)]
    if units:
        return [with_issues(report, units) for report in reports]
    judge = LoggerJudge(problem, reports)
    return judge.judge(races) if judge.logs else judge.reports


class LoggerJudge:
    """Judge the dynamics of all runs that one logger recorded of one arm.

    reports : of all runs, with their facts; logs : by the run's number, the rows of
    those whose dynamics can be judged; is_poor_motion : whether the motion of all has
    few directions.
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
            run = report.repaired_all
            has_dynamics = left_to_judge(report.issues) > Left.FACTS
            if not has_dynamics or not run.torque_logged:
                continue
            try:
                filters = report.filters or problem.preprocessing.resolve(run)
                data = RegressionData.from_run(problem, run, filters)
            except InputError as error:
                too_little = stated("the filters need more")
                issue = make_refusal("too little data", error, too_little)
                self.reports[k] = with_issues(report, [issue])
            else:
                self.logs[k] = Likelihood(problem, data)
        self.is_poor_motion = all(reports[k].has_poor_motion for k in self.logs)

    @cached_property
    def common(self) -> Likelihood:
        """The rows of all runs, one after the other."""
        return Likelihood.of_all_runs([*self.logs.values()])

    def judge(self, races: HeldRaces) -> list[Report]:
        """Hold the race of all explanations; return the reports with what it says.

        races : those held for other copies of the runs.

        If the torques are no measured ones (a controller's gravity model), that is the
        only explanation.
        """
        not_measured = [*kind_of_torque(self.common)]
        if not_measured:
            return [
                with_issues(report, not_measured) if k in self.logs else report
                for k, report in enumerate(self.reports)
            ]
        kinds = KINDS
        if self.is_poor_motion:
            kinds = SHOWN_BY_A_POOR_MOTION
        elif any(self.reports[k].lockstep is not None for k in self.logs):
            # An exchange of channels that move in proportion cannot be seen.
            kinds = tuple(kind for kind in KINDS if kind is not order)
        verdict = races.hold([*self.logs.values()], kinds, self.is_poor_motion)
        self._report(verdict)
        for number in self.logs:
            report = self.reports[number]
            if report.repaired_all.unit_command:
                evidence = Evidence(self.common.with_all_laws)
                asked = unit_asked_for(evidence, verdict.fit)
                self.reports[number] = with_issues(report, asked)
        return self.reports

    def _report(self, verdict: RaceOutcome) -> None:
        """Add the explanations to the reports of all runs.

        They are what the race says, the size of the torques, and the torque that stays
        unexplained. Facts and the size say what is left to be judged (:class:`Left`):
        of channels that hold no motor torque only the size and the unexplained torque
        are reported, and no gains where the torques are in another unit.
        """
        net = verdict.without_usual(self.common)
        runs = [
            (self.reports[number].run, log, self._of_run(number, net))
            for number, log in self.logs.items()
        ]
        left = left_to_judge(f for k in self.logs for f in self.reports[k].issues)
        size = []
        first = self.reports[0].repaired_all
        if first.is_unit_stated:
            gains = gains_by_size(self.common, net, first.torque_unit)
            size = [not_in_newton_metres(self.problem, first, gains)]
        elif left is Left.ALL:
            # Runs that differ from the others have issues of their own: they are left out.
            parts = [claim.hypothesis.part for claim in verdict.differences()]
            differ = {part.run for part in parts if part is not None}
            alike = [x for place, x in enumerate(runs) if place not in differ] or runs
            common = self.common
            if len(alike) < len(runs):
                common = Likelihood.of_all_runs([log for _, log, _ in alike])
            fits = [log.fit(of_run) for _, log, of_run in alike]
            size = [*torque_magnitude(common, net, fits)]
        left = min(left, left_to_judge(size))
        if left is Left.FACTS:
            for number, log in self.logs.items():
                alone = [*size, *unrelated_torque(log.fit(net))]
                self.reports[number] = with_issues(self.reports[number], alone)
            return
        has_gains = left is Left.ALL
        stated = issues_of_all(self.common, verdict, net, runs, has_gains)
        for number in self.logs:
            self._report_run(number, stated, verdict, size, net, has_gains)

    def _differences(
        self, number: int, verdict: RaceOutcome, supposed: str
    ) -> tuple[list[Issue], LogTransform]:
        """List the issues about what differs in one run, or from an instant of it on.

        Also return the transform that undoes those differences that a change of the run's
        log can undo.
        """
        log, run = self.logs[number], self.reports[number].run
        place = [*self.logs].index(number)
        issues: list[Issue] = []
        undone = log.as_logged
        for claim in verdict.differences():
            part = claim.hypothesis.part
            if part is None or part.run not in (None, place):
                continue
            if part.until is not None:
                begin, end = (self._time_in_run(number, t) for t in part.ends)
                if begin is None or end is None:
                    continue
                issue = issue_of_span(log, claim, begin, end)
            elif part.after is not None:
                issue = _change(log, claim, part.after, supposed)
            else:
                issue = issue_of_difference(log, claim, run, supposed)
                repair = repair_of(claim)
                if repair is not None and issue.repair is not None:
                    undone = undone.followed_by(repair)
            issues.append(graded(issue, verdict, [claim]))
            if part.until is None and part.after is not None and len(issues) == 1:
                break  # the run holds two logs: all else differs for that
        return issues, undone

    def _report_run(
        self,
        number: int,
        stated: Sequence[Issue],
        verdict: RaceOutcome,
        size: Sequence[Issue],
        net: LogTransform,
        has_gains: bool,
    ) -> None:
        """Add the explanations to one run's report, and repair its run.

        Explanations that a fact of the run covers already are left out.

        Parameters
        ----------
        number : int
            Number of the run, from 0.
        stated : sequence of Issue
            Faults that all runs share.
        verdict : RaceOutcome
            With what differs in this run.
        size : sequence of Issue
            Issues about the size of the torques.
        net : LogTransform
            The repair that all runs share.
        has_gains : bool
            Whether the channels have known gains; else the user is asked for them, and
            they may explain what is left.
        """
        log = self.logs[number]
        report = self.reports[number]
        supposed = "" if has_gains else ", were the torques in N m"
        differences, undone = self._differences(number, verdict, supposed)
        net = self._of_run(number, net)
        repaired = undone.followed_by(net)
        if undone != log.as_logged:
            # Rows are judged as the difference from the other runs is undone.
            net = repaired
        # A fault of all runs may be undone by the difference of this run, as a sign that
        # is turned twice: it is no fault of this run. A fault without joints counts as one
        # of joint 0.
        faults_left = {
            (fault.kind, joint)
            for fault in list_faults(log, repaired)
            for joint in [j + 1 for j in fault.joints] or [0]
        }
        of_log = []
        for issue in (*self._said_of_run(number, stated), *differences):
            joints = issue.joints or (0,)
            if not issue.apply or faults_left & {(issue.kind, j) for j in joints}:
                of_log.append(issue)
        # One arm for all rows leaves what a difference explains that no repair undoes; a
        # motion of few directions cannot show what it leaves.
        differs = any(x.repair is None or x.span is not None for x in differences)
        unexplained: list[Issue] = []
        if not (self.is_poor_motion or (differs and verdict.is_well_explained)):
            unexplained = [*unexplained_torque(log, net, has_gains, not differs)]
        if not verdict.is_well_explained:
            unexplained = [
                with_rival_effects(x, [SOMETHING_ELSE]) if x.span is not None else x
                for x in unexplained
            ]
        new = [
            replace(issue, changes=issue.changes or _cuts(report, issue))
            for issue in (*of_log, *size, *unexplained)
            if not is_explained_by_a_fact(issue, report)
        ]
        # The race's repair comes first, then the repairs of single issues (events). The
        # race's repair already holds those of differences that have a word for --apply.
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
        shift = self.common.data.clock_shifts[[*self.logs].index(number)]
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

    def _said_of_run(self, number: int, stated: Sequence[Issue]) -> Iterator[Issue]:
        """Yield the issues of all runs that concern one of them: no step of another
        run, and the instants of its own by its own clock."""
        for issue in stated:
            if issue.at is None:
                yield issue
            elif (at := self._time_in_run(number, issue.at)) is not None:
                yield replace(
                    issue,
                    what=issue.what.format(t=at),
                    where=issue.where.format(t=at),
                    at=at,
                )


def _change(log: Likelihood, claim: Claim, t: float, supposed: str) -> Issue:
    """Return the issue that a run ends with another arm than it begins with, from the
    instant t [s] on: a load was picked up, or the file holds the logs of two arms."""
    name = f"the part from t = {t:.4g} s on"
    issue = issue_of_difference(log, claim, name, supposed)
    place = f"t = {t:.4g} s"
    if issue.joints:
        place = f"{issue.where}, {place}"
    return replace(
        issue,
        kind="change within the run",
        heading="",
        in_doubt="",
        of_positions=None,
        is_of_columns=False,
        where=place,
        remedy="cut the run there and use each part by itself",
        apply="",
        repair=None,
        at=t,
    )


def _kinds_corrected(
    facts: Sequence[Issue], explanations: Sequence[Issue]
) -> tuple[str, ...]:
    """Return the kinds of issue that the fit of one arm to a run is corrected for, each
    once.

    They are the facts that have a repair, and faults of the log that the race found.
    Notes do not count, nor does another load or arm, which stays in the rows.
    """
    repaired = [issue for issue in facts if issue.repair is not None]
    found = [issue for issue in explanations if not issue.stays_in_rows]
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


def is_explained_by_a_fact(issue: Issue, report: Report) -> bool:
    """Whether a fact of the run already explains an issue: those of all its joints,
    or a one-off event lies where rows are missing."""
    if issue.span is not None and issue.at is not None:
        return _is_near_gap(report.repaired_all, issue.at)
    clipped: set[int] = set()
    for fact in report.issues:
        if fact.explains_joints:
            clipped.update(fact.joints)
    return bool(issue.joints) and clipped.issuperset(issue.joints)


def _is_near_gap(run: Measurements, t: float) -> bool:
    """Whether rows are missing within a second of an instant [s]."""
    steps = np.diff(run.t)
    is_gap = steps > GAP * np.median(steps)
    near = np.abs(run.t[1:] - t) < 1.0
    return bool(np.any(is_gap & near))


def _cuts(report: Report, issue: Issue) -> tuple[Change, ...]:
    """Return the changes that leave out the part of a run that an issue is about: the
    time around an event, else what comes after the instant or what comes before it. The
    change that leaves out the shorter part is first; an issue without an instant has none.
    """
    at = issue.at
    if at is None:
        return ()
    if issue.span is not None:
        first, last = issue.span
        parts = [(f"{last - first:.2g} s around", first, last)]
    else:
        begin, end = report.repaired_all.t[[0, -1]].tolist()
        parts = [("what comes after", at, end), ("what comes before", begin, at)]
        parts.sort(key=lambda part: part[2] - part[1])
    return tuple(
        Change(
            "cut",
            f"leave {what} {at:.4g} s of {report.run} out",
            {"run": report.run, "spans": [[first, last]]},
        )
        for what, first, last in parts
    )
