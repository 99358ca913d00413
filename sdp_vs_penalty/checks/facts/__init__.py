"""What is read from a log whatever the arm, in the order of mending.

Each rule is a statistic with what it would be of a log in order: it yields issues with
the nature FACT.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks.clock import (
    find_changes_of_rate,
    find_coarse_stamps,
    find_repeated_time,
    find_stray_stamps,
    find_time_backwards,
    find_time_jumps,
    find_time_unit,
    find_uneven_stamps,
)
from sdp_vs_penalty.checks.constants import RUN
from sdp_vs_penalty.checks.facts.channels import (
    find_channels_without_numbers,
    find_wrapped_angles,
)
from sdp_vs_penalty.checks.facts.repetition import find_held_rows, find_repeated_run
from sdp_vs_penalty.checks.facts.rows import (
    find_end_stops,
    find_interpolated_rows,
    find_lost_rows,
    find_missing_numbers,
    find_spikes,
)
from sdp_vs_penalty.checks.facts.standing import find_static_poses
from sdp_vs_penalty.checks.facts.stuck import (
    find_drives_off,
    find_false_zeros,
    find_frozen_channels,
)
from sdp_vs_penalty.checks.glance import RunSummary
from sdp_vs_penalty.checks.issue import Issue, Left, left_to_judge
from sdp_vs_penalty.data.measurements import MOST_LOST, Measurements
from sdp_vs_penalty.problem.problem import Problem

#: In the order of mending; all but the first ask of RUN rows in which something moves.
FEW_ROWS = find_channels_without_numbers, find_missing_numbers, find_static_poses
#: Each rule takes the run with its clock and channels, as repaired by the rules before it,
#: and yields its issues, none if nothing is wrong.
RULES: tuple[Callable[[RunSummary], Iterator[Issue]], ...] = (
    find_channels_without_numbers,
    find_missing_numbers,
    find_static_poses,
    find_time_unit,
    find_time_backwards,
    find_coarse_stamps,
    find_repeated_time,
    find_stray_stamps,
    find_changes_of_rate,
    find_uneven_stamps,
    find_time_jumps,
    find_wrapped_angles,
    find_held_rows,
    find_repeated_run,
    find_end_stops,
    find_interpolated_rows,
    find_false_zeros,
    find_drives_off,
    find_spikes,
    find_lost_rows,
    partial(find_frozen_channels, word="position", name="q"),
    partial(find_frozen_channels, word="torque", name="t"),
)


def mended(
    run: Measurements, problem: Problem, only_sure: bool = False
) -> tuple[list[Issue], RunSummary]:
    """Apply the rules about rows, clock and channels in order, each to the run as the
    rules before have repaired it.

    Parameters
    ----------
    problem : Problem
        Of the robot: its filters say when it stands still, its arm judges torques that
        do not change.
    only_sure : bool
        Whether to mend only what other facts may stand on.

    Returns
    -------
    issues : list of Issue
        In the order of mending.
    summary : RunSummary
        Of the run as mended.
    """
    issues: list[Issue] = []
    glance = RunSummary(run, problem)
    for rule in RULES:
        if left_to_judge(issues) is Left.NOTHING:
            break
        if rule not in FEW_ROWS and (
            len(glance.run.t) < RUN or not glance.moving.any()
        ):
            break
        for issue in rule(glance):
            if issue.repair is not None and (issue.is_stood_on or not only_sure):
                glance = replace(glance, run=issue.repair(glance.run))
                lost = 1.0 - len(glance.run.t) / len(run.t)
                if issue.severity == "error" and lost > MOST_LOST:
                    share = formatting.percent(lost, 2)
                    remedy = f"{issue.remedy}, but {share} of the rows: log it again"
                    issue = replace(issue, remedy=remedy, lost_share=lost)
            issues.append(issue)
    return issues, glance
