"""Are these measurements any good? Issues with what, where, how sure and what to do.

:func:`check` is the verb. Checks run in the order in which their issues have to be mended (clock,
units, signs and order, gravity, delay), each on data in which what was found before is mended, so
that one mistake is reported once and does not hide the next.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import show
from sdp_vs_penalty.check import (
    clock,
    dynamics,
    excitation,
    gravity,
    residual,
    samples,
    scale,
    signals,
    steps,
)
from sdp_vs_penalty.check.evidence import Evidence
from sdp_vs_penalty.check.issue import Issue
from sdp_vs_penalty.check.physics import Physics
from sdp_vs_penalty.check.rows import physics_of
from sdp_vs_penalty.data.files import check_usable
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import beside_range, check_plausible, check_torque
from sdp_vs_penalty.data.sources import Source, as_measurements
from sdp_vs_penalty.errors import InputError, other_robot
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.show import Shown, Summary, Table
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.runs import moving_joints

__all__ = ["Issue", "Report", "check"]

#: Rows that the dynamics are judged on: enough for any arm, few enough to answer at once.
_ROWS = 1000
#: ... and those for events, which are short.
_EVENT_ROWS = 2000
#: Samples that are looked at as a whole, and those of each window of a longer run.
_MOST, _WINDOW = 1 << 18, 1 << 16
#: Issues with what all runs of an arm share.
_OF_THE_ARM = ("encoder offset", "gravity direction")
#: Kind and place of an issue.
Key = tuple[str, str]
#: Band in which one-off events are looked for, in cut-offs of the states.
_WIDER = 3.0


@dataclass(frozen=True, repr=False)
class Report(Shown):
    """issues : of one run, the gravest first; mended : the run with every repair made, those that are
    only likely included, as later checks see it; fixed : with the certain ones only; unexplained :
    share of the torques' energy that the arm's dynamics leave over, after mending.
    """

    run: str
    issues: tuple[Issue, ...]
    mended: Measurements
    fixed: Measurements
    unexplained: float | None

    @property
    def meaningless(self) -> bool:
        """Whether to identify from these data as they are would mean nothing."""
        return any(f.severity == "error" for f in self.issues)

    @property
    def problems(self) -> tuple[Issue, ...]:
        """Errors and warnings, without notes."""
        return tuple(f for f in self.issues if f.severity != "note")

    @property
    def verdict(self) -> str:
        """How many problems there are, and how well the arm's dynamics explain the torque."""
        found = show.count(len(self.problems), "problem")
        if self.unexplained is None:
            return f"{self.run}: {found}; nothing to identify from"
        share = 100.0 * self.unexplained**0.5
        return f"{self.run}: {found}; the arm's dynamics leave {share:.2g} % of the torque unexplained"

    def _summary(self) -> Summary:
        return self.verdict, [(f.severity, f.what) for f in self.issues]

    def _table(self) -> Table | None:
        rows = [(f.kind, f.where, f.certainty, f.remedy) for f in self.issues]
        return (("kind", "where", "certainty", "remedy"), rows) if rows else None

    def changes(self, name: str) -> str:
        """What a repaired copy of the file of this name differs in from it, and what is left to do."""
        done = [f for f in self.issues if f.mends]
        left = [f for f in self.problems if not f.mends]
        lines = [f"Repaired copy of {name}, in the order of repair:" if done else f"Copy of {name}:"]
        lines += [f"- {f.kind} ({f.where}): {f.what} Done: {f.remedy}. ({f.certainty})" for f in done]
        lines += [] if done else ["- nothing was changed"]
        lines += ["Not repaired:"] if left else []
        lines += [f"- {f.kind} ({f.where}): {f.what} To do: {f.remedy}." for f in left]
        return "\n".join(lines) + "\n"

    def to_dict(self) -> dict[str, Any]:
        return {
            "run": self.run,
            "meaningless": self.meaningless,
            "unexplained_percent": None if self.unexplained is None else 100.0 * self.unexplained**0.5,
            "findings": [f.to_dict() for f in self.issues],
        }


def check(
    problem: str | Path | Problem,
    measurements: Source,
    preprocessing: Preprocessing | None = None,
    *,
    thorough: bool = True,
) -> list[Report]:
    """One report a run. The measurements need not be usable: clock and numbers are checked as well.

    problem : a built-in name, a folder, a URDF file, or a Problem; measurements : whatever
        :func:`~sdp_vs_penalty.data.sources.as_measurements` takes; preprocessing : filters other than
        the problem's.
    thorough : also look for one-off events and at the excitation; without, only for what would make
        an identification wrong (what `identify` does by itself).
    Raises InputError where robot and measurements differ in their number of joints, or every torque
    is zero.
    """
    problem = as_problem(problem, "check(problem=...)")
    measurements = as_measurements(
        measurements, problem.robot.n, problem.robot.joint_names, "check(measurements=...)", usable=False
    )
    check_torque(measurements)
    if measurements.n != problem.robot.n:
        raise other_robot(measurements.n, problem.robot.n, measurements.names[0])
    settings = preprocessing or problem.preprocessing
    reports = [report for run in measurements.runs() for report in _unusable(run)]
    windows = [window for run in measurements.runs() for window in _windows(run)]
    return reports + of_one_arm([_check_run(problem, w, settings, thorough) for w in windows])


def of_one_arm(reports: Sequence[Report]) -> list[Report]:
    """Runs of one arm share its mounting and the zeros of its joints: what is only likely to be wrong
    with these is a warning where at least as many runs, checked to their end, do not show it."""
    found = [{(f.kind, f.where) for f in r.problems} for r in reports]
    without = contradicted(found, [r.unexplained is not None for r in reports])

    def weighed(issue: Issue) -> Issue:
        key = issue.kind, issue.where
        if issue.severity != "error" or key not in without or issue.mends:
            return issue
        sure = f"{issue.certainty.rstrip('.')}; {without[key]} of {len(reports)} runs do not show it"
        return replace(issue, severity="warning", certainty=sure)

    return [replace(r, issues=gravest_first(map(weighed, r.issues))) for r in reports]


def contradicted(found: Sequence[set[Key]], whole: Sequence[bool]) -> dict[Key, int]:
    """Issues of the arm that at least as many runs lack as show, and how many lack them.

    found : kind and place of each run's issues; whole : whether it was checked to its end, since only
    then a run can lack one.
    """
    out = {}
    for key in {key for one in found for key in one if key[0] in _OF_THE_ARM}:
        without = sum(key not in one for one, end in zip(found, whole, strict=True) if end)
        if without >= sum(key in one for one in found):
            out[key] = without
    return out


def gravest_first(issues: Iterable[Issue]) -> tuple[Issue, ...]:
    """In the order of their severity, otherwise as they came."""
    order = ("error", "warning", "note")
    return tuple(sorted(issues, key=lambda f: order.index(f.severity)))


def _windows(run: Measurements) -> list[Measurements]:
    """A run, or of a long one the windows that are checked; their rows count from their first."""
    if run.samples <= _MOST:
        return [run]
    starts = np.linspace(0, run.samples - _WINDOW, _MOST // _WINDOW).astype(int).tolist()
    name = run.names[0]
    return [run.rows(slice(k, k + _WINDOW), f"{name} from sample {k + 1} on") for k in starts]


def _unusable(run: Measurements) -> list[Report]:
    """A report where a long run has a broken clock or numbers that are not finite, anywhere."""
    if run.samples <= _MOST:
        return []
    try:
        check_usable(run.names[0], run)
    except InputError as error:
        issue = _stopped("unusable rows", error, "certain: read from the file")
        return [Report(run.names[0], (issue,), run, run, None)]
    return []


def _check_run(problem: Problem, run: Measurements, settings: Preprocessing, thorough: bool) -> Report:
    work = _Work(problem, run, settings)
    work.mend(clock.find(run))
    unexplained = None
    try:
        unexplained = work.check_content(thorough)
    except InputError as error:
        work.found.append(_stopped("too little data", error, "certain: the filters need more"))
    if not any(f.severity == "error" for f in work.found):
        work.found += _refused(problem, run, settings, compressed=work.run is run)
    return Report(run.names[0], gravest_first(work.found), work.run, work.fixed, unexplained)


def _refused(
    problem: Problem, run: Measurements, settings: Preprocessing, compressed: bool
) -> list[Issue]:
    """What `identify` refuses of a run as it was recorded: its own calls, in its order and words.

    compressed : whether the last of them was passed already.
    """
    try:
        check_usable(run.names[0], run)
        check_plausible(problem.robot, run)
        if not compressed:
            compress(run, problem.model(), settings.resolve(run))
    except InputError as error:
        return [_stopped("not usable", error, "certain: `identify` refuses it")]
    return []


def _stopped(kind: str, error: InputError, sure: str) -> Issue:
    remedy = error.remedy or "record a longer motion"
    return Issue(kind, "error", "the run", f"{error.what.rstrip('.')}.", sure, remedy)


class _Work:
    """One run on its way through the checks: mended as far as it has come."""

    def __init__(self, problem: Problem, run: Measurements, settings: Preprocessing) -> None:
        self.problem = problem
        self.run = self.fixed = run
        self.settings = settings
        self.found: list[Issue] = []
        self._physics: dict[tuple[int, Preprocessing, int], Physics] = {}

    def mend(self, issues: Iterable[Issue]) -> None:
        for issue in issues:
            self.found.append(issue)
            if issue.repair is None:
                continue
            self.run = issue.repair(self.run)
            if issue.mends:
                self.fixed = issue.repair(self.fixed)

    def physics(self, settings: Preprocessing, rows: int = _ROWS) -> Physics:
        """The test's data of the run as it is now; made again only after something was mended."""
        key = (id(self.run), settings, id(self.problem))
        if key not in self._physics:
            self._physics = {key: physics_of(self.problem, self.run, settings, rows)}
        return self._physics[key]

    def check_content(self, thorough: bool) -> float | None:
        """Everything behind the clock; returns what stays unexplained, None where nothing moves."""
        if len(self.run.t) < 10:
            raise InputError("fewer than 10 usable rows", "record longer", self.run.names[0])
        moving = moving_joints(self.run)
        if not moving.any():
            self.mend(signals.no_motion())
            return None
        self.mend(samples.find(self.run, self.problem.robot, self.settings.standstill))
        settings = self.settings.resolve(self.run)
        stuck = list(signals.frozen(self.run, self.physics(settings)))
        if stuck:  # of a motion that is not the arm's nothing else can be asked
            self.mend(stuck)
            return None
        if beside_range(self.problem.robot, self.run.q):
            out = list(signals.implausible(self.run, self.problem.robot))
            if out[0].severity == "error":  # so far beside it that a fit would blame something else
                self.mend(out)
                return None
        before = len(self.found)
        assert settings.torque_cutoff is not None
        self.mend(dynamics.find(self.physics(settings), moving, settings.torque_cutoff))
        for issue in self.found[before:]:
            if issue.gravity is not None:
                self.problem = self.problem.with_gravity(issue.gravity)
        self.mend(signals.find(self.run, self.problem.robot, settings))
        if not any(f.kind == "encoder offset" for f in self.found):
            self.mend(signals.implausible(self.run, self.problem.robot))
        # Each on the data as the one before it has mended them.
        self.mend(scale.find(self.run, self.physics(settings), self.problem))
        physics = self.physics(settings)
        regression = compress(self.run, physics.model, settings)
        evidence = Evidence.of_regression(regression)
        named = any(f.kind == "torque not explained" for f in self.found)
        if not named and physics.determined(settings.torque_cutoff):
            self.mend(residual.find(evidence, physics, self.problem, moving, tried=True))
            if not any(f.kind == "encoder offset" for f in self.found):
                self.mend(gravity.last_joint(physics, self.problem))
        if not thorough:
            return residual.overall(evidence)
        # A knock is faster than the motion: looked for in a wider band.
        wider = replace(settings, state_cutoff=_WIDER * (settings.state_cutoff or 0.0)).resolve(self.run)
        every, _ = physics.parent or (physics, None)  # those at rest, too, as in an identification
        self.mend(excitation.find(self.problem, every))
        self.mend(excitation.hidden_errors(physics, moving))
        self.mend(steps.knock(self.physics(wider, _EVENT_ROWS).narrow))
        return residual.overall(evidence)
