"""A factor of all positions, or of one joint's beside a torque that is right: an encoder's
counts a turn are any number, and a unit that nobody named, or one that was named wrongly,
is a factor too."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, joints_text, prior_of_one_of, times_text
from sdp_vs_penalty.race.kinds.position_unit import COUNTS, counts_a_turn, undone_unit
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis, Number, at_sizes, factor_of

#: Factors that are tried of all joints, and of one [-].
_FACTORS, _OF_A_JOINT = (1.0, 0.75, 1.35), (1.0, 0.6, 1.6)
_TURN = 2.0 * np.pi


def _number(joints: tuple[int, ...]) -> Number:
    """Return the common factor of some joints' positions."""
    return replace(factor_of("scale", joints), known_within=c.WIDEST)


def _factor_in_words(log_factor: float) -> str:
    """Write a factor, by its natural logarithm."""
    return f"a factor of {np.exp(log_factor):.4g}"


def _counts_in_words(log_count: float) -> str:
    """Write the counts a turn, by the natural logarithm of a count [rad]."""
    return f"{_TURN / np.exp(log_count):.5g}"


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield another factor of all positions, and of each joint's, of an arm that is poorly
    explained, where they are radians."""
    log, current = evidence.log, fit.transform
    is_in_radians = bool(np.all(np.abs(current.scale)[log.revolute] == 1.0))
    if not is_in_radians or len(log.revolute) < 2 or not fit.is_poorly_explained.any():
        return
    kind, of_all = "position scale", _number(tuple(log.revolute))
    yield from at_sizes(kind, prior_of_one_of(1), current, of_all, np.log(_FACTORS))
    # A joint's position that errs beside a right torque is rarer.
    prior = prior_of_one_of(1) + prior_of_one_of(log.n)
    for j in log.revolute:
        yield from at_sizes(kind, prior, current, _number((j,)), np.log(_OF_A_JOINT))


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield one fault about all revolute joints whose factor is no unit's, or one about
    each."""
    scales = np.abs(transform.scale)
    _, of_unit = undone_unit(log, transform)
    changed = [j for j in log.revolute if scales[j] != 1.0 and j not in of_unit]
    groups: list[tuple[int, ...]]
    groups = [(j,) for j in changed] if len(log.revolute) > 1 else []
    if groups and changed == log.revolute and np.ptp(scales[changed]) == 0.0:
        groups = [tuple(changed)]
    for joints in groups:
        yield _fault(log, transform, joints)


def _fault(log: Likelihood, transform: LogTransform, joints: tuple[int, ...]) -> Fault:
    """Return the fault that some joints' positions have another factor."""
    is_all = len(joints) > 1
    scale = abs(transform.scale[joints[0]])
    kind, number = "position scale", _number(joints)
    where = f"position of {joints_text(joints)} is"
    if is_all:
        where = "positions of all joints are"
    are, unit = times_text(scale), None
    if is_all and scale < c.LARGEST_COUNT:
        kind, number = f"positions in {COUNTS}", counts_a_turn(log)
        unit = COUNTS
        are = f"in counts of an encoder with {_TURN / scale:.5g} a turn"
    channels = ", ".join(f"q{j + 1}" for j in joints)
    # The sign of a position is a fault of its own.
    without = replace(
        transform,
        scale=tuple(
            math.copysign(1.0, present) if j in joints else present
            for j, present in enumerate(transform.scale)
        ),
    )
    return Fault(
        kind=kind,
        joints=joints,
        what=f"the {where} {are}.",
        remedy=f"multiply {channels} (and dq) by {scale:.5g}",
        without=without,
        number=number,
        in_words=_counts_in_words if unit else _factor_in_words,
        place=channels if is_all else "",
        repaired_by=(unit or "scale", "q"),
        position_unit=unit,
        of_positions=None if unit else "factor",
        figures={"factor": scale},
    )
