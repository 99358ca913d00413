"""What explains the torques of all runs together.

Order, signs, units, clock and mounting belong to the logger: one search over the rows of
all runs finds them, and each has to hold in every run. What belongs to one run (its
load, a zero, or a fault of its log alone) is claimed with that run named.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.certainty import certain
from sdp_vs_penalty.checks.constants import GAP, NO_DYNAMICS
from sdp_vs_penalty.checks.faults.fault import Fault
from sdp_vs_penalty.checks.faults.order import Exchange
from sdp_vs_penalty.checks.faults.sign import Sign
from sdp_vs_penalty.checks.issue import Issue
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.one_arm import NOT_REPAIRED, RunComparison, two_arms
from sdp_vs_penalty.checks.problem_units import problem_units
from sdp_vs_penalty.checks.regression_data import RegressionData
from sdp_vs_penalty.checks.repair import LogTransform
from sdp_vs_penalty.checks.report import Report
from sdp_vs_penalty.checks.residual import (
    contradicting_joints,
    unexplained_torque,
    unrelated_torque,
)
from sdp_vs_penalty.checks.run_log import RunLog
from sdp_vs_penalty.checks.search import RepairSearch
from sdp_vs_penalty.checks.torque_size import kind_of_torque, torque_magnitude
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.results.remedy import Change
from sdp_vs_penalty.signals.preprocessing import Preprocessing

#: Currents have no gains of their own that torques would show.
UNSCALED = ("torque channel kind",)
#: Of torques that are none of the arm's motors, nothing else is said.
NO_TORQUE = "external torque"


def judge_dynamics(
    problem: Problem, reports: Sequence[Report], settings: Preprocessing
) -> list[Report]:
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
    judge = LoggerJudge(problem, reports, settings)
    return judge.judge() if judge.logs else judge.reports


class LoggerJudge:
    """Judge the dynamics of all runs that one logger recorded of one arm.

    reports : of all runs, with their facts; logs : by the run's number, the rows of
    those whose dynamics can be judged; only_in : by the run's number, what is repaired
    in that run alone; issues_of_one : by the run's number, the issues of that run
    alone; clock_shifts : by the run's number, the time [s] by which its clock is put
    forward in the log of all runs together.
    """

    def __init__(
        self, problem: Problem, reports: Sequence[Report], settings: Preprocessing
    ) -> None:
        """Filter the rows of each run whose dynamics can be judged; a run too short for
        the filters gets an issue instead.

        reports : of all runs, with their facts.
        """
        self.problem = problem
        self.settings = settings
        self.reports = [*reports]
        self.logs: dict[int, Likelihood] = {}
        for k, report in enumerate(reports):
            if not has_dynamics(report):
                continue
            try:
                self.logs[k] = self.rows_of(report.repaired_all)
            except InputError as error:
                issue = Issue.of_refusal(
                    "too little data", error, certain("the filters need more")
                )
                self.reports[k] = with_issues(report, [issue])
        as_logged = LogTransform.unchanged(problem.robot.n, problem.robot.gravity)
        self.only_in = dict.fromkeys(self.logs, as_logged)
        self.issues_of_one: dict[int, list[Issue]] = {k: [] for k in self.logs}
        self.clock_shifts: dict[int, float] = {}

    def rows_of(self, run: Measurements) -> Likelihood:
        """Return the filtered rows of one run, to fit arms to. Raises InputError for a
        run shorter than the filters need."""
        data = RegressionData.of(self.problem, run, self.settings.resolve(run))
        return Likelihood(self.problem, data)

    def judge(self) -> list[Report]:
        """Search for faults of all runs and of single runs; return the reports with
        these as explanations.

        If the torques are no measured ones (a controller's gravity model), that is the
        only explanation. Otherwise faults of all runs are searched for, and then one
        fault of a single run; each repair of a single run starts the search anew.
        """
        common = Likelihood.of_all_runs([*self.logs.values()])
        not_measured = [*kind_of_torque(common)]
        if not_measured:
            for number in self.logs:
                report = self.reports[number]
                self.reports[number] = with_issues(report, not_measured)
            return self.reports
        search = self._search()
        net = search.drop_unconfirmed(search.run())
        while self._repair_one_run(net):
            search.log.clear_caches()
            search = self._search()
            net = search.drop_unconfirmed(search.run())
        self._report(search, net)
        return self.reports

    def _search(self) -> RepairSearch:
        """Return the search over the rows of all runs, as repaired so far.

        The repair of one run may change its clock: the shifts of all clocks are worked
        out anew.
        """
        logs = [*self.logs.values()]
        shifts = RegressionData.clock_shifts([log.data for log in logs])
        self.clock_shifts = dict(zip(self.logs, shifts, strict=True))
        reports = [self.reports[k] for k in self.logs]
        return RepairSearch(Likelihood.of_all_runs(logs), logs, reports)

    def _repair_one_run(self, net: LogTransform) -> bool:
        """Find what is different in one run, and repair the run if that is possible.

        Runs are compared as repaired by ``net``, the repair that all share. The
        difference becomes an issue of that run alone.

        Returns
        -------
        bool
            Whether rows were repaired, so that the search has to begin again.
        """
        numbers = [
            k
            for k, log in self.logs.items()
            if log.spare_share > 0.0 and not self.reports[k].has_poor_motion
        ]
        if len(numbers) < 2:
            return False
        runs = [
            RunLog(self.logs[k], self._of_run(k, net), self.reports[k].run)
            for k in numbers
        ]
        comparison = RunComparison(runs)
        is_one_joint = comparison.worst_error_ratio >= c.OUTLYING
        differs = (
            comparison.is_one_arm_worse(1.0)
            or comparison.has_outlying_run
            or is_one_joint
        )
        if not differs and not self._contradicts_in_some(numbers, net):
            return False
        cause = comparison.find_best_cause(lambda k: self._faults_of_one(numbers[k]))
        if cause is None:
            return False
        number = numbers[cause.difference.run]
        issue = comparison.issue(cause)
        known = [(f.kind, f.where) for f in self.issues_of_one[number]]
        if (issue.kind, issue.where) in known:
            # Its repair did not help: the loop over repairs would never end.
            return False
        self.issues_of_one[number].append(issue)
        repair = cause.log_repair(self.logs[number].as_logged)
        return repair is not None and self._try_to_repair(number, repair)

    def _contradicts_in_some(self, numbers: Sequence[int], net: LogTransform) -> bool:
        """Whether joints contradict each other in some of these runs, but not in all:
        then one of the runs has a fault of its own."""
        logs = [self.logs[k] for k in numbers]
        contradicts = [len(contradicting_joints(log, net)) > 0 for log in logs]
        return any(contradicts) and not all(contradicts)

    def _faults_of_one(self, number: int) -> list[tuple[Fault, LogTransform]]:
        """List the faults that a single run's log may have, each with its repair.

        They are all wrong signs and orders of channels, and the faults that a search in
        this run alone finds. Only single faults that `check --fix --apply` can repair
        are listed.
        """
        log = self.logs[number]
        fit = log.fit(log.as_logged)
        search = RepairSearch(log, [log], [self.reports[number]])
        of_this_run = search.run()
        repairs = [
            search.keep_only(of_this_run, fault)
            for fault in search.list_faults(of_this_run)
        ]
        for kind in (Sign(), Exchange()):
            repairs += kind.propose(log, log.as_logged, fit)
        faults = []
        for repair in dict.fromkeys(repairs):
            of_repair = search.list_faults(repair)
            if len(of_repair) == 1 and of_repair[0].apply:
                faults.append((of_repair[0], repair))
        # A long run has many windows, each with a search of its own.
        log.clear_caches()
        return faults

    def _try_to_repair(self, number: int, repair: LogTransform) -> bool:
        """Repair one run alone, and filter its rows anew; return whether enough rows
        remain."""
        only = self.only_in[number].followed_by(repair)
        run = only.apply(self.reports[number].repaired_all)
        try:
            self.logs[number] = self.rows_of(run)
        except InputError:
            return False
        self.only_in[number] = only
        return True

    def _report(self, search: RepairSearch, net: LogTransform) -> None:
        """Add the explanations to the reports of all runs.

        They are the faults that all runs share, the size of the torques, and the torque
        that stays unexplained. If the size shows that the channels hold no motor
        torque, only that and the unexplained torque are reported. If it shows another
        unit of all torques, gains and units of single torques are left out.
        """
        stated = self._said_of_all_runs(search.describe_faults(net), net)
        facts = [f.kind for report in self.reports for f in report.issues]
        size = []
        if "torque in counts" not in facts:
            size = [*torque_magnitude(search.log, net)]
        if any(issue.kind == NO_TORQUE for issue in size):
            for number, log in self.logs.items():
                left = [*unrelated_torque(log.fit(net))]
                self.reports[number] = with_issues(self.reports[number], size + left)
            return
        if any(issue.kind in UNSCALED for issue in size):
            stated = [f for f in stated if f.kind not in ("torque gain", "torque unit")]
        for number in self.logs:
            self._report_run(number, stated, size, search.has_few_directions, net)

    def _report_run(
        self,
        number: int,
        stated: Sequence[Issue],
        size: Sequence[Issue],
        is_poor_motion: bool,
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
        size : sequence of Issue
            Issues about the size of the torques.
        is_poor_motion : bool
            Whether the motion of every run has at most half as many directions as
            joints: the unexplained torque then says nothing.
        net : LogTransform
            The repair that all runs share.
        """
        log = self.logs[number]
        report = self.reports[number]
        net = self._of_run(number, net)
        stated = self._said_of_run(number, stated)
        change_of_arm = [
            replace(issue, changes=_cuts_at(report, issue.figures["t"]))
            for issue in ([] if report.has_poor_motion else two_arms(log, net))
        ]
        # Where another arm begins, a step of a torque is no separate event.
        repair = replace(net, events=()) if change_of_arm else net
        unexplained = [] if is_poor_motion else [*unexplained_torque(log, repair)]
        of_this_run = [*size, *unexplained, *change_of_arm]
        of_log = self._explanations(number, stated, net)
        explanations = [*of_log, *of_this_run]
        new = [
            issue for issue in explanations if not is_explained_by_a_fact(issue, report)
        ]
        # Repaired by the search first, then by what is left unexplained (events).
        run = self.only_in[number].followed_by(net).apply(report.repaired_all)
        for issue in of_this_run:
            if issue.repair is not None:
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
            if not isinstance(event.at, float):
                events.append(event)
            elif (at := self._time_in_run(number, event.at)) is not None:
                events.append(replace(event, at=at))
        return replace(net, events=tuple(events))

    def _said_of_all_runs(
        self, stated: Sequence[Issue], net: LogTransform
    ) -> list[Issue]:
        """Return the issues of all runs, with the size in each run where it has one of
        its own; of a single run as they are."""
        runs = [
            RunLog(log, self._of_run(number, net), self.reports[number].run)
            for number, log in self.logs.items()
        ]
        if len(runs) < 2:
            return [*stated]
        return [issue.by_run(runs) if issue.by_run else issue for issue in stated]

    def _said_of_run(self, number: int, stated: Sequence[Issue]) -> list[Issue]:
        """Return the issues of all runs that concern one of them: no step of another
        run, and the instants of its own by its own clock."""
        said = []
        for issue in stated:
            if issue.by_clock is None:
                said.append(issue)
                continue
            at = self._time_in_run(number, issue.figures["t"])
            if at is not None:
                cuts = _cuts_at(self.reports[number], at)
                said.append(replace(issue.by_clock(at), changes=cuts))
        return said

    def _explanations(
        self, number: int, stated: Sequence[Issue], net: LogTransform
    ) -> list[Issue]:
        """List the explanations that hold in one run.

        They are the faults of all runs, ``stated``, and those of this run alone. Two
        repairs may cancel: a sign that is wrong in all runs, and once more in this one,
        is right here, and neither fault is listed.
        """
        of_one = self.issues_of_one[number]
        candidates = [*stated, *of_one]
        if not any(issue.apply for issue in of_one):
            return candidates
        # Faults that are left when both repairs are composed into one.
        total = self.only_in[number].followed_by(net)
        log = self.logs[number]
        remaining = {fault.apply for fault in RepairSearch(log).list_faults(total)}
        return [
            issue for issue in candidates if not issue.apply or issue.apply in remaining
        ]


def _kinds_corrected(
    facts: Sequence[Issue], explanations: Sequence[Issue]
) -> tuple[str, ...]:
    """Return the kinds of issue that the fit of one arm to a run is corrected for, each
    once.

    They are the facts that have a repair, and what the search found wrong with the log.
    Notes are none: laws of friction are the arm's. Another load or arm stays in the rows.
    """
    repaired = [issue for issue in facts if issue.repair is not None]
    found = [issue for issue in explanations if issue.kind != NOT_REPAIRED]
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
    if issue.kind == "one-off event":
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
