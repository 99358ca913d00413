"""Joints and torques that count the other way: the torque's sign, the position's, or
both."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, joints_text, prior_of_one_of
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis

#: By kind: the factors of a transform that change their sign.
SIGNS = {
    "torque sign": ("gain",),
    "position sign": ("scale",),
    "joint sign": ("scale", "gain"),
}
#: Largest number of joints for which every pattern of signs is tried (2^8).
_MOST_JOINTS = 8
#: Log-odds of friction's power below which friction seems to drive joints: patterns of
#: torque signs are then tried.
_FRICTION_DRIVES = -12.0


def with_signs(
    transform: LogTransform, kind: str, joints: tuple[int, ...]
) -> LogTransform:
    """Return a transform with other signs of some joints (from 0): of the factors that
    SIGNS lists for a kind of fault."""
    for name in SIGNS[kind]:
        transform = transform.with_multiplied(name, joints, -1.0)
    return transform


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield other signs: of all torques, and of each torque.

    Signs of positions and of joints are tried if the arm is poorly explained. Patterns of
    several torques are tried if friction seems to drive joints, and patterns of several
    joints if the fit may hide several mistakes.
    """
    log, current, n = evidence.log, fit.transform, evidence.log.n
    all_joints = tuple(range(n))
    turned = current.with_multiplied("gain", all_joints, -1.0)
    yield Hypothesis("torque sign", all_joints, prior_of_one_of(1), turned)
    upside_down = tuple(-g for g in current.gravity)
    both = replace(turned, gravity=upside_down)
    yield Hypothesis("gravity direction", all_joints, 2.0 * prior_of_one_of(1), both)
    prior = prior_of_one_of(n)
    is_poor = bool(fit.is_poorly_explained.any())
    for j in log.joints:
        for kind in SIGNS:
            # The torque of an only joint is all torques.
            is_tried = n > 1 if kind == "torque sign" else is_poor
            if is_tried:
                turned_joint = with_signs(current, kind, (j,))
                is_of_joint = kind == "joint sign"
                yield Hypothesis(
                    kind, (j,), prior, turned_joint, suggests_patterns=is_of_joint
                )
    if fit.friction_evidence <= _FRICTION_DRIVES:
        yield from patterns(evidence, fit, "torque sign")
    if fit.may_be_rearranged:
        yield from patterns(evidence, fit, "joint sign")


def patterns(evidence: Evidence, fit: ViewFit, kind: str) -> Iterator[Hypothesis]:
    """Yield hypotheses that several joints at once have the other sign; kind : of SIGNS."""
    log, n = evidence.log, evidence.log.n
    if not 2 < len(log.joints) <= _MOST_JOINTS:
        return
    # Several joints that count the other way are one mistake each, or one mistake in all:
    # another convention, one of the 2^n.
    odds_of_convention = -c.LOG_ODDS_AGAINST_FAULT - n * float(np.log(2.0))
    for size in range(2, len(log.joints)):
        for joints in combinations(log.joints, size):
            odds = max(size * prior_of_one_of(n), odds_of_convention)
            yield Hypothesis(
                kind, joints, odds, with_signs(fit.transform, kind, joints)
            )


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield the faults that a transform's negative factors repair.

    There is one fault for each joint with a wrong position alone, one for all joints whose
    position and torque are wrong, and one for all with a wrong torque alone.
    """
    is_q_turned = np.array(transform.scale) < 0.0
    is_tau_turned = np.array(transform.gain) < 0.0
    for j in np.flatnonzero(is_q_turned & ~is_tau_turned).tolist():
        yield Fault(
            kind="position sign",
            in_doubt="position sign",
            is_of_columns=True,
            joints=(j,),
            what=f"the position of joint {j + 1} has the wrong sign.",
            remedy=f"flip the sign of q{j + 1} (and dq{j + 1})",
            without=with_signs(transform, "position sign", (j,)),
            repaired_by=("sign", "q"),
        )
    if joints := tuple(np.flatnonzero(is_q_turned & is_tau_turned).tolist()):
        count = "counts" if len(joints) == 1 else "count"
        channels = [f"{x}{j + 1}" for j in joints for x in ("q", "dq", "tau")]
        yield Fault(
            kind="joint sign",
            in_doubt="joint sign",
            is_of_columns=True,
            joints=joints,
            what=f"{joints_text(joints)} {count} the other way, position and torque alike.",
            remedy=f"flip the signs of {formatting.words(channels)}",
            without=with_signs(transform, "joint sign", joints),
            repaired_by=("sign", "joint"),
        )
    if joints := tuple(np.flatnonzero(is_tau_turned & ~is_q_turned).tolist()):
        where = "every joint" if len(joints) == log.n else joints_text(joints)
        yield Fault(
            kind="torque sign",
            in_doubt="torque sign",
            is_of_columns=True,
            joints=joints,
            what=f"the torque of {where} has the wrong sign.",
            remedy=f"flip the sign of {', '.join(f'tau{j + 1}' for j in joints)}",
            without=with_signs(transform, "torque sign", joints),
            repaired_by=("sign", "tau"),
        )
