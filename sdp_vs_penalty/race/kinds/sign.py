"""Joints and torques that count the other way: the torque's sign, the position's, or
both."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.constants import LOG_ODDS_AGAINST_FAULT
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
#: Patterns are tried where friction drives joints by so much (natural logarithm).
_FRICTION_DRIVES = -12.0


def with_sign(chain: LogTransform, kind: str, joint: int) -> LogTransform:
    """Return a transform that changes the sign of one joint (from 0), of a kind of SIGNS."""
    for name in SIGNS[kind]:
        chain = chain.with_multiplied(name, (joint,), -1.0)
    return chain


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield other signs: of all torques, of each torque, of positions of an arm that is
    poorly explained, and of sets of torques where friction drives joints."""
    log, now, n = evidence.log, fit.chain, evidence.log.n
    every = tuple(range(n))
    turned = now.with_multiplied("gain", every, -1.0)
    yield Hypothesis("torque sign", every, prior_of_one_of(1), turned)
    upside_down = tuple(-g for g in now.gravity)
    both = replace(turned, gravity=upside_down)
    yield Hypothesis("gravity direction", every, 2.0 * prior_of_one_of(1), both)
    prior = prior_of_one_of(n)
    is_poor = bool(fit.is_poorly_explained.any())
    for j in log.joints:
        for kind in SIGNS:
            is_tried = n > 1 if kind == "torque sign" else is_poor
            if is_tried:
                yield Hypothesis(kind, (j,), prior, with_sign(now, kind, j))
    are_few = 2 < len(log.joints) <= _MOST_JOINTS
    if not are_few or fit.physics > _FRICTION_DRIVES:
        return
    # Joints that count the other way are as many single mistakes, or one mistake: another
    # convention, of 2^n.
    odds_of_convention = -LOG_ODDS_AGAINST_FAULT - n * float(np.log(2.0))
    for size in range(2, len(log.joints)):
        for joints in combinations(log.joints, size):
            odds = max(size * prior, odds_of_convention)
            pattern = now.with_multiplied("gain", joints, -1.0)
            yield Hypothesis("torque sign", joints, odds, pattern)


def list_faults(log: Likelihood, chain: LogTransform) -> Iterator[Fault]:
    """Yield a fault for each position whose sign is changed, alone or with its torque,
    and one about all other torques whose sign is."""
    is_q_turned = np.array(chain.scale) < 0.0
    is_tau_turned = np.array(chain.gain) < 0.0
    for j in np.flatnonzero(is_q_turned).tolist():
        number = j + 1
        right_q = chain.with_multiplied("scale", (j,), -1.0)
        if is_tau_turned[j]:
            yield Fault(
                kind="joint sign",
                joints=(j,),
                what=f"joint {number} counts the other way, position and torque alike.",
                remedy=f"flip the signs of q{number}, dq{number} and tau{number}",
                without=right_q.with_multiplied("gain", (j,), -1.0),
            )
        else:
            yield Fault(
                kind="position sign",
                joints=(j,),
                what=f"the position of joint {number} has the wrong sign.",
                remedy=f"flip the sign of q{number} (and dq{number})",
                without=right_q,
            )
    joints = tuple(np.flatnonzero(is_tau_turned & ~is_q_turned).tolist())
    if joints:
        where = "every joint" if len(joints) == log.n else joints_text(joints)
        yield Fault(
            kind="torque sign",
            joints=joints,
            what=f"the torque of {where} has the wrong sign.",
            remedy=f"flip the sign of {', '.join(f'tau{j + 1}' for j in joints)}",
            without=chain.with_multiplied("gain", joints, -1.0),
        )
