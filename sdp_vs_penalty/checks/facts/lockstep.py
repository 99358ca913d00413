"""Joints that move in proportion to each other, and how many directions a motion has.

What the motion has is a value of a run's report; the issue is written from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from sdp_vs_penalty.checks.certainty import stated
from sdp_vs_penalty.checks.constants import LOCKSTEP
from sdp_vs_penalty.checks.glance import RunSummary
from sdp_vs_penalty.checks.issue import Issue, joints_text, make_issue
from sdp_vs_penalty.results.remedy import Change
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one

#: Share of the variance that the counted directions of a motion hold [-].
_SHARE_OF_VARIANCE = 0.999


@dataclass(frozen=True)
class LockstepMotion:
    """A motion in which joints move in proportion to each other."""

    #: Groups of joints (from 0) that move in proportion.
    groups: tuple[tuple[int, ...], ...]
    #: Number of joints that move.
    moving: int
    #: Number of independent directions of the joints' positions.
    rank: int

    @property
    def is_poor(self) -> bool:
        """Whether the motion has at most half as many directions as moving joints."""
        return 2 * self.rank <= self.moving

    @classmethod
    def find_in(cls, glance: RunSummary) -> Self | None:
        """Return the lockstep of a run, with at least one group of two joints; None where
        no joints move in proportion."""
        moving = np.flatnonzero(glance.moving)
        if len(moving) < 2:
            return None
        q = glance.run.q[:, moving]
        together = lockstep_groups(q)
        if not together:
            return None
        groups = tuple(tuple(int(moving[k]) for k in group) for group in together)
        return cls(groups, len(moving), motion_rank(q))

    def issue(self) -> Issue:
        """Return the warning that nothing shows which torque or channel belongs to
        which joint of a group.

        Returns
        -------
        Issue
            A fact, with the rank of the motion among its figures.
        """
        names = "; ".join(joints_text(group) for group in self.groups)
        return make_issue(
            kind="lockstep motion",
            joints=sorted(j for group in self.groups for j in group),
            what=f"{names} move in proportion (|correlation| above {LOCKSTEP:g}): the"
            f" motion of {self.moving} joints has {self.rank} directions. Their order"
            " cannot be told, nor what belongs to which of them.",
            certainty=stated("read from the positions"),
            remedy="move each joint by a signal of its own",
            changes=(Change("record", "record a motion that excites every joint"),),
            figures={
                "rank": self.rank,
                "moving": self.moving,
                "groups": [[j + 1 for j in group] for group in self.groups],
            },
        )


def lockstep_groups(q: Array) -> list[list[int]]:
    """List groups of columns of positions q (N, n) [rad, m] that move in proportion.

    The columns of a group correlate by more than LOCKSTEP with its first one, whatever
    the sign. No column is in two groups; groups of one are left out.

    Returns
    -------
    list of list of int
        Numbers of the columns of each group.
    """
    z = _standardised(q)
    correlation = z.T @ z / len(z)
    is_proportional = np.abs(correlation) > LOCKSTEP
    groups: list[list[int]] = []
    remaining = list(range(q.shape[1]))
    while remaining:
        first = remaining[0]
        group = [k for k in remaining if k == first or is_proportional[first, k]]
        remaining = [k for k in remaining if k not in group]
        if len(group) > 1:
            groups.append(group)
    return groups


def motion_rank(q: Array) -> int:
    """Return the number of principal directions that hold 99.9 % of the variance of
    positions q (N, n) [rad, m], each joint scaled to variance 1."""
    power = np.linalg.svd(_standardised(q), compute_uv=False) ** 2
    shares = np.cumsum(power) / power.sum()
    return int(np.searchsorted(shares, _SHARE_OF_VARIANCE) + 1)


def _standardised(q: Array) -> Array:
    """Return positions q (N, n) about their means, each joint scaled to variance 1."""
    return (q - q.mean(axis=0)) / nonzero_or_one(np.std(q, axis=0))
