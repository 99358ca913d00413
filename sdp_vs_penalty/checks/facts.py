"""The rules about rows, clock and channels in the order of mending."""

from collections.abc import Callable, Iterator
from functools import partial

from sdp_vs_penalty.checks.channels import degrees, never_a_number, wrapped
from sdp_vs_penalty.checks.clock import (
    backwards,
    change_of_rate,
    coarse_stamps,
    jumps,
    repeated_time,
    time_unit,
    uneven,
)
from sdp_vs_penalty.checks.constants import RUN
from sdp_vs_penalty.checks.glance import RunSummary
from sdp_vs_penalty.checks.issue import Issue
from sdp_vs_penalty.checks.rows import (
    end_stops,
    frozen,
    held_rows,
    interpolated_rows,
    lost_rows,
    missing,
    repeated_run,
    spikes,
    zeros,
)
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.robot import Robot

#: In the order of mending; all but the first ask of RUN rows in which something moves.
RULES: tuple[Callable[[RunSummary], Iterator[Issue]], ...] = (
    never_a_number,
    missing,
    time_unit,
    backwards,
    coarse_stamps,
    repeated_time,
    change_of_rate,
    uneven,
    jumps,
    wrapped,
    degrees,
    held_rows,
    repeated_run,
    end_stops,
    interpolated_rows,
    zeros,
    spikes,
    lost_rows,
    partial(frozen, word="position", name="q"),
    partial(frozen, word="torque", name="t"),
)


def mended(
    run: Measurements,
    robot: Robot,
    standstill: float,
) -> tuple[list[Issue], Measurements, Measurements]:
    """What the rules about rows, clock and channels say, each of the run as those
    before have mended it.

    Parameters
    ----------
    run : Measurements
        As logged.
    robot : Robot
        Whose joints have ranges.
    standstill : float
        Share of its speed below which the robot stands still.

    Returns
    -------
    issues : list of Issue
        In the order of mending.
    repaired_all, repaired_certain : Measurements
        The run with all of them mended, and with the certain ones.
    """
    issues: list[Issue] = []
    fixed = run
    glance = RunSummary(run, robot, standstill)
    for rule in RULES:
        if any(issue.kind == "channel without numbers" for issue in issues):
            break
        if rule not in (never_a_number, missing) and (
            len(glance.run.t) < RUN or not glance.moving.any()
        ):
            break
        for issue in rule(glance):
            issues.append(issue)
            if issue.repair is not None:
                # What is only likely is mended for the rules that follow, and deletes
                # no row.
                fixed = issue.repair(fixed) if issue.mends else fixed
                glance = RunSummary(issue.repair(glance.run), robot, standstill)
    return issues, glance.run, fixed
