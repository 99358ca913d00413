"""Which joints of a tree follow others: mimic joints of a URDF, or formulas of a problem."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.joint import Joint, Mechanism
from sdp_vs_penalty.robot.transmission import parse_formula

#: A joint that follows: the joint that it follows, by name, multiplier and offset.
Follower = tuple[str, float, float]


def following(
    tree: Sequence[Joint], followers: dict[str, Follower], massless: Sequence[int]
) -> tuple[tuple[Joint, ...], Mechanism | None]:
    """The joints that move by themselves, and how the tree follows them; None where nothing does.

    Raises InputError for a joint that follows itself, through others or not, or none of the tree.
    """
    names = [joint.name for joint in tree]
    free = [k for k, name in enumerate(names) if name not in followers]
    if not followers and not massless:
        return tuple(tree), None
    matrix, offset = np.zeros((len(tree), len(free))), np.zeros(len(tree))
    for k, name in enumerate(names):
        at, ratio, shift, seen = name, 1.0, 0.0, {name}
        while at in followers:
            leader, multiplier, constant = followers[at]
            shift += ratio * constant
            ratio *= multiplier
            if leader in seen:
                raise InputError(f"joint {name!r} mimics itself through others", "correct its <mimic>")
            if leader not in names:
                raise InputError(
                    f"joint {at!r} mimics {leader!r}, which is no moving joint of the robot",
                    "correct its <mimic>",
                )
            seen.add(leader)
            at = leader
        matrix[k, free.index(names.index(at))], offset[k] = ratio, shift
    return tuple(tree[k] for k in free), Mechanism(tuple(tree), matrix, offset, tuple(massless))


def mimics(
    elements: Sequence[Any], numbers: Callable[[Any, str, Sequence[float]], list[float]]
) -> dict[str, Follower]:
    """The <mimic> of each <joint> element that has one; numbers : reads an attribute's numbers."""
    out = {}
    for joint in elements:
        element = joint.find("mimic")
        if element is not None:
            (multiplier,), (offset,) = (
                numbers(element, name, (default,))
                for name, default in (("multiplier", 1.0), ("offset", 0.0))
            )
            out[joint.get("name")] = (str(element.get("joint")), multiplier, offset)
    return out


def parse_mechanism(
    tree: Sequence[Joint], formulas: Sequence[str], massless: Sequence[int] = ()
) -> tuple[tuple[Joint, ...], Mechanism]:
    """Each tree joint's position as a formula of those that move by themselves: "q1", "-q2 + 0.1".

    massless : links without mass, by their number in the tree from 1. Raises InputError.
    """
    if len(formulas) != len(tree):
        raise InputError(
            f"mechanism: {len(formulas)} formulas, the tree has {len(tree)} joints", "write one a joint"
        )
    rows = np.array([parse_formula(text, len(tree)) for text in formulas])
    used = np.flatnonzero(rows[:, :-1].any(axis=0))
    n = int(used.max(initial=-1)) + 1
    own = []
    for k in range(n):
        same = [i for i, row in enumerate(rows) if np.array_equal(row, np.eye(len(rows) + 1)[k])]
        if not same:
            raise InputError(f"mechanism: no joint is q{k + 1} itself", f'write "q{k + 1}" for one')
        own.append(same[0])
    if not all(1 <= k <= len(tree) for k in massless):
        raise InputError(
            "mechanism: massless names a link that is not there", f"choose from 1 to {len(tree)}"
        )
    places = tuple(sorted({k - 1 for k in massless}))
    return tuple(tree[k] for k in own), Mechanism(tuple(tree), rows[:, :n], rows[:, -1], places)
