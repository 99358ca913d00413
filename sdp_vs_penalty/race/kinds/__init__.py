"""The hypotheses about a log, one file each.

``propose(evidence, fit)`` yields the hypotheses beside what a fit has already;
``list_faults(log, transform)`` the faults that a transform corrects, in words.
"""

from types import ModuleType

from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.fault import Fault
from sdp_vs_penalty.race.kinds import (
    carried,
    clock_rate,
    delay,
    effort,
    events,
    friction,
    gain,
    gear,
    mounting,
    of_one_part,
    order,
    position_scale,
    position_unit,
    saturation,
    several_joints,
    sign,
    weight,
    zero,
)
from sdp_vs_penalty.race.likelihood import Likelihood

#: What is tried, in the order of the words.
KINDS: tuple[ModuleType, ...] = (
    position_unit,
    position_scale,
    clock_rate,
    sign,
    order,
    carried,
    mounting,
    weight,
    events,
    gain,
    gear,
    delay,
    zero,
    saturation,
    effort,
    of_one_part,
    several_joints,
    friction,
)
#: Whose changes belong to all rows, or have parts of their own: not tried in one run.
NOT_OF_ONE_RUN = (carried, saturation, effort, of_one_part, several_joints, friction)
#: What a motion shows whose directions are half as many as its joints.
SHOWN_BY_A_POOR_MOTION = position_unit, sign, mounting, events


def list_faults(log: Likelihood, transform: LogTransform) -> list[Fault]:
    """List the faults of all kinds that a transform corrects."""
    faults: list[Fault] = []
    for kind in KINDS:
        if hasattr(kind, "list_faults"):
            faults += kind.list_faults(log, transform)
    return faults
