"""Are these measurements any good? Issues with what, where, how sure and what to do.

:func:`check` is the verb. Rules about rows and clock come first (one table); then one likelihood of
the arm's dynamics judges compositions of transformations of the log (transformations/), and what is
reported is the net repair, each number once. Several runs are compared with each other at last.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks.constants import PARTS
from sdp_vs_penalty.checks.content import Content, content
from sdp_vs_penalty.checks.issue import Issue
from sdp_vs_penalty.checks.rules import mended
from sdp_vs_penalty.checks.several import compare
from sdp_vs_penalty.data.files import Source, as_measurements, check_usable
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import check_plausible, check_torque
from sdp_vs_penalty.data.store import PART
from sdp_vs_penalty.errors import InputError, other_robot
from sdp_vs_penalty.formatting import Shown, Summary, Table
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.signals.preprocessing import Preprocessing

__all__ = ["Issue", "Report", "check"]


@dataclass(frozen=True, repr=False)
class Report(Shown):
    """issues : of one run, the gravest first; mended : the run with every repair made, those that are
    only likely included; fixed : with the certain ones only; unexplained : share of the torques' energy
    that the arm's dynamics leave over, after mending.
    """

    run: str
    issues: tuple[Issue, ...]
    mended: Measurements
    fixed: Measurements
    unexplained: float | None
    content: Content | None = field(default=None, compare=False)

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
        found = formatting.count(len(self.problems), "problem")
        if self.unexplained is None:
            why = "nothing to identify from" if self.mended.torque_logged else "no torque was logged"
            return f"{self.run}: {found}; {why}"
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
        """Plain JSON."""
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
        :func:`~sdp_vs_penalty.data.files.as_measurements` takes; preprocessing : filters other than
        the problem's.
    thorough : also look at the excitation; without, only for what would make an identification wrong
        (what `identify` does by itself).
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
    reports: list[Report] = []
    for run in measurements.runs():
        windows = [run]
        if run.samples > PARTS * PART:  # so many windows, whose rows count from their first
            try:
                check_usable(run.names[0], run)
            except InputError as error:
                issue = _stopped("unusable rows", error, "certain: read from the file")
                reports.append(Report(run.names[0], (issue,), run, run, None))
            name, starts = run.names[0], np.linspace(0, run.samples - PART, PARTS).astype(int).tolist()
            windows = [run.rows(slice(k, k + PART), f"{name} from sample {k + 1} on") for k in starts]
        reports += [_check_run(problem, window, settings, thorough) for window in windows]
    return of_one_arm(reports)


def of_one_arm(reports: Sequence[Report]) -> list[Report]:
    """Runs of one arm share its mounting, its zeros, its gains and its load: where one run's differ,
    it is named."""
    out = list(reports)
    whole = [(k, r.content) for k, r in enumerate(out) if r.content and r.content.scene]
    whole = [(k, found) for k, found in whole if found.settled]
    for k, issue in compare([found for _, found in whole], [out[k].run for k, _ in whole]):
        odd = out[whole[k][0]]
        out[whole[k][0]] = replace(odd, issues=gravest_first((*odd.issues, issue)))
    return out


def gravest_first(issues: Iterable[Issue]) -> tuple[Issue, ...]:
    """In the order of their severity, otherwise as they came."""
    return tuple(sorted(issues, key=lambda f: ("error", "warning", "note").index(f.severity)))


def _check_run(problem: Problem, run: Measurements, settings: Preprocessing, thorough: bool) -> Report:
    issues, work, fixed = mended(run, problem.robot, settings.standstill)
    found = None
    try:
        found = content(problem, work, settings, thorough)
    except InputError as error:
        issues.append(_stopped("too little data", error, "certain: the filters need more"))
    if found is not None:
        issues += found.issues
        work, fixed = found.mend(work, certain=False), found.mend(fixed, certain=True)
    if not any(f.severity == "error" for f in issues):
        try:
            check_plausible(problem.robot, run)
        except InputError as error:
            issues.append(_stopped("position range", error, "certain: `identify` refuses it"))
    unexplained = None if found is None else found.unexplained
    return Report(run.names[0], gravest_first(issues), work, fixed, unexplained, found)


def _stopped(kind: str, error: InputError, sure: str) -> Issue:
    remedy = error.remedy or "record a longer motion"
    return Issue(kind, "error", "the run", f"{error.what.rstrip('.')}.", sure, remedy)
