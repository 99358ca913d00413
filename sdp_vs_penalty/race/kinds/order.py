"""Channels of other joints: positions, torques, or both exchanged."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, joints_text, prior_of_one_of
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis

#: By kind: the fields of a transform that hold the channels' order, the channels in
#: words, the names of their columns, and what a repair is of.
_KINDS: dict[str, tuple[tuple[str, ...], str, str, str]] = {
    "joint order": (
        ("order", "tau_order"),
        *("positions and torques", "q, dq and tau", "joint"),
    ),
    "position order": (("order",), "the positions", "q and dq", "q"),
    "torque order": (("tau_order",), "the torques", "tau", "tau"),
}


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield exchanged channels of each pair of moving joints: torques always, positions and
    both if one of the pair is poorly explained.

    If any joint is, all joints in reverse order are one hypothesis too: a log that counts
    from the wrist.
    """
    current, poor = fit.transform, fit.is_poorly_explained
    joints = tuple(evidence.log.joints)
    if len(joints) > 3 and poor.any():
        for kind, (fields, *_) in _KINDS.items():
            from_the_wrist = {name: getattr(current, name)[::-1] for name in fields}
            reverse = replace(current, **from_the_wrist)
            yield Hypothesis(kind, joints, prior_of_one_of(1), reverse)
    prior = prior_of_one_of(evidence.log.n * (evidence.log.n - 1) // 2)
    for pair in combinations(joints, 2):
        for kind, (fields, *_) in _KINDS.items():
            if kind == "torque order" or poor[list(pair)].any():
                yield Hypothesis(kind, pair, prior, current.with_swap(*pair, *fields))


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield a fault for the joints whose channels the transform exchanges: one if positions
    and torques have the same order, else one for positions and one for torques."""
    is_same = transform.order == transform.tau_order
    kinds = ["joint order"] if is_same else ["position order", "torque order"]
    for kind in kinds:
        fields, words, columns, channel = _KINDS[kind]
        order = getattr(transform, fields[0])
        changed = tuple(np.flatnonzero(np.array(order) != np.arange(log.n)).tolist())
        if not changed:
            continue
        assignment = ""
        if len(changed) > 2:
            places = [f"column {order[j] + 1} is joint {j + 1}'s" for j in changed]
            assignment = f": {', '.join(places)}"
        yield Fault(
            kind=kind,
            in_doubt=kind,
            is_of_columns=True,
            joints=changed,
            what=f"{words} of {joints_text(changed)} are swapped{assignment}.",
            remedy=f"rename the columns of {columns}",
            without=transform.with_defaults(*fields),
            repaired_by=("order", channel),
        )
