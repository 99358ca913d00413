"""The table of rules about clock and rows, each on the run as those before have mended it."""

from __future__ import annotations

from sdp_vs_penalty.checks.clock_rules import CLOCK_RULES, missing
from sdp_vs_penalty.checks.glance import Glance
from sdp_vs_penalty.checks.issue import Issue
from sdp_vs_penalty.checks.row_rules import ROW_RULES
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.robot import Robot

#: Rows below which nothing but missing numbers is looked for, and those for rules about a motion.
_FEWEST, _MOTION = 3, 30


def mended(
    run: Measurements, robot: Robot, standstill: float
) -> tuple[list[Issue], Measurements, Measurements]:
    """The issues of a run's rows and clock; the run with all of them mended, and with the certain
    ones.
    """
    issues: list[Issue] = []
    fixed, glance = run, Glance(run, robot, standstill)
    for rule in (*CLOCK_RULES, *ROW_RULES):
        rows = len(glance.run.t)
        if rule is not missing and (rows < _FEWEST or (rule in ROW_RULES and rows < _MOTION)):
            break
        if rule in ROW_RULES and not glance.moving.any():
            break
        issue = rule(glance)
        if issue is None:
            continue
        issues.append(issue)
        if issue.repair is not None:
            # What is only likely is mended for the rules that follow, whose rows are counted there.
            fixed = issue.repair(fixed) if issue.mends and len(fixed.t) == rows else fixed
            glance = Glance(issue.repair(glance.run), robot, standstill)
    return issues, glance.run, fixed
