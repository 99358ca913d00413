"""Joints and torques that count the other way: the torque's sign, the position's, or
both."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product

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
#: Patterns are tried where friction drives joints by so much (natural logarithm).
_FRICTION_DRIVES = -12.0


def with_signs(chain: LogTransform, kind: str, joints: tuple[int, ...]) -> LogTransform:
    """Return a transform that changes signs of joints (from 0), of a kind of SIGNS."""
    for name in SIGNS[kind]:
        chain = chain.with_multiplied(name, joints, -1.0)
    return chain


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield other signs: of all torques, of each torque, of positions of an arm that is
    poorly explained, and of sets: of torques where friction drives joints, and of joints
    of such an arm, whose mirror image may stand upside down."""
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
                yield Hypothesis(kind, (j,), prior, with_signs(now, kind, (j,)))
    patterns = ["torque sign"] * (fit.physics <= _FRICTION_DRIVES)
    patterns += ["joint sign"] * is_poor
    if not 2 < len(log.joints) <= _MOST_JOINTS:
        return
    # Joints that count the other way are as many single mistakes, or one mistake: another
    # convention, of 2^n.
    odds_of_convention = -c.LOG_ODDS_AGAINST_FAULT - n * float(np.log(2.0))
    for kind, size in product(patterns, range(2, len(log.joints))):
        for joints in combinations(log.joints, size):
            odds = max(size * prior, odds_of_convention)
            yield Hypothesis(kind, joints, odds, with_signs(now, kind, joints))


def list_faults(log: Likelihood, chain: LogTransform) -> Iterator[Fault]:
    """Yield a fault for each position whose sign is changed alone, one about all joints
    whose position and torque are, and one about all other torques."""
    is_q_turned = np.array(chain.scale) < 0.0
    is_tau_turned = np.array(chain.gain) < 0.0
    for j in np.flatnonzero(is_q_turned & ~is_tau_turned).tolist():
        yield Fault(
            kind="position sign",
            joints=(j,),
            what=f"the position of joint {j + 1} has the wrong sign.",
            remedy=f"flip the sign of q{j + 1} (and dq{j + 1})",
            without=with_signs(chain, "position sign", (j,)),
        )
    if joints := tuple(np.flatnonzero(is_q_turned & is_tau_turned).tolist()):
        count = "counts" if len(joints) == 1 else "count"
        channels = [f"{x}{j + 1}" for j in joints for x in ("q", "dq", "tau")]
        yield Fault(
            kind="joint sign",
            joints=joints,
            what=f"{joints_text(joints)} {count} the other way, position and torque alike.",
            remedy=f"flip the signs of {formatting.words(channels)}",
            without=with_signs(chain, "joint sign", joints),
        )
    if joints := tuple(np.flatnonzero(is_tau_turned & ~is_q_turned).tolist()):
        where = "every joint" if len(joints) == log.n else joints_text(joints)
        yield Fault(
            kind="torque sign",
            joints=joints,
            what=f"the torque of {where} has the wrong sign.",
            remedy=f"flip the sign of {', '.join(f'tau{j + 1}' for j in joints)}",
            without=with_signs(chain, "torque sign", joints),
        )
