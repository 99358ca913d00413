"""Positions in degrees, of all revolute joints or of one of them; or of all in per cent of
their ranges."""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.data.plausibility import radians_per_percent
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, joints_text, prior_of_one_of
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis

#: Scales of positions are 1, -1 (a sign), or a unit's [-]: below this it is a unit.
_BELOW_ANY_OTHER_SCALE = 0.1
_RADIANS_PER_DEGREE = float(np.radians(1.0))


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield degrees of all revolute joints, and of each single joint that moves beyond a
    turn; per cent of all. Nothing where no joint moves beyond a turn [rad]."""
    log, now = evidence.log, fit.chain
    largest = np.abs(now.positions(log.data.motion.q)).max(axis=0)  # (n,)
    beyond_a_turn = [j for j in log.revolute if largest[j] > 2.0 * np.pi]
    if not beyond_a_turn:
        return
    in_degrees = now.with_multiplied("scale", log.revolute, _RADIANS_PER_DEGREE)
    revolute = tuple(log.revolute)
    yield Hypothesis("positions in degrees", revolute, prior_of_one_of(1), in_degrees)
    percent = radians_per_percent(log.problem.robot, log.data.motion.q)
    if percent is not None:
        in_percent = now
        for j, (scale, middle) in percent.items():
            in_percent = in_percent.with_multiplied("scale", (j,), scale)
            in_percent = in_percent.with_entries("zero", (j,), now.zero[j] + middle)
        joints = tuple(percent)
        kind = "positions in per cent"
        yield Hypothesis(kind, joints, prior_of_one_of(1), in_percent)
    if log.n == 1:
        return  # the only joint is all joints
    for j in beyond_a_turn:
        chain = now.with_multiplied("scale", (j,), _RADIANS_PER_DEGREE)
        yield Hypothesis("position unit", (j,), prior_of_one_of(log.n), chain)


def list_faults(log: Likelihood, chain: LogTransform) -> Iterator[Fault]:
    """Yield one fault about all joints in degrees, and one about all in per cent."""
    sizes = np.abs(chain.scale)
    is_in_unit = sizes < _BELOW_ANY_OTHER_SCALE
    is_in_degrees = is_in_unit & np.isclose(sizes, _RADIANS_PER_DEGREE, rtol=1e-6)
    joints = tuple(np.flatnonzero(is_in_degrees).tolist())
    if joints:
        without = chain.with_multiplied("scale", joints, 1.0 / _RADIANS_PER_DEGREE)
        logged = without.positions(log.data.motion.q)[:, joints]
        is_all = joints == tuple(log.revolute)
        channels = ", ".join(f"q{j + 1}" for j in joints)
        yield Fault(
            kind="positions in degrees" if is_all else "position unit",
            joints=joints,
            what=f"the position of {joints_text(joints)} is in degrees: it reaches"
            f" {np.abs(logged).max():.4g}.",
            remedy=f"multiply {channels} (and dq) by pi / 180",
            without=without,
            place=channels,
        )
    percent = radians_per_percent(log.problem.robot, log.data.motion.q) or {}
    joints = tuple(np.flatnonzero(is_in_unit & ~is_in_degrees).tolist())
    if joints:
        without = chain
        for j in joints:
            scale, middle = percent[j]
            without = without.with_multiplied("scale", (j,), 1.0 / scale)
            without = without.with_entries("zero", (j,), chain.zero[j] - middle)
        yield Fault(
            kind="positions in per cent",
            joints=joints,
            what=f"the positions of {joints_text(joints)} are in per cent of each"
            " joint's range, from -100 to 100, as LeRobot writes them.",
            remedy="multiply q (and dq) by a hundredth of half of the range",
            without=without,
            place=", ".join(f"q{j + 1}" for j in joints),
        )
