"""A law tried in spans of time: its evidence, and how it stands beside others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sdp_vs_penalty.diagnosis.constants import EVIDENCE_TO_ADD, UNCERTAIN
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, WhiteFit, margin
from sdp_vs_penalty.diagnosis.passing.laws import Law
from sdp_vs_penalty.diagnosis.passing.spans import Cells
from sdp_vs_penalty.robot.arrays import Array, Mask

#: Share of the error in its spans that a cause has to explain: more than it leaves.
_MOST = 0.5
#: Times the largest error of the model elsewhere that the error in its spans has to be.
_LARGER = 1.0
#: Chance that the largest errors of a log lie together as they do, if cells of time erred
#: independently. Neighbouring cells err alike: at a correlation of .5 noise alone is below
#: it in 5 of 100 logs, at .8 in 25. The other conditions of a cause come on top.
_CHANCE = 0.01


@dataclass(frozen=True, eq=False)
class PassingTrial:
    """A law with its spans, fitted beside the model and its effects."""

    #: The law.
    law: Law
    #: The cells of time.
    cells: Cells
    #: (C,) flags of the cells in which the law acts, 0 or 1.
    x: Array
    #: The fit with the law.
    fit: WhiteFit
    #: The law as a term beside the model, with its evidence and parameters [SI].
    term: ScoredEffect
    #: (k, k) covariance of the parameters.
    covariance: Array
    #: Share of the error in its spans that the law explains.
    share: float
    #: Mean square of the error in the spans, over the largest one elsewhere
    #: (:class:`Standing`).
    over_elsewhere: float
    #: Probability that cells with large errors lie together by chance as they do
    #: (:class:`Standing`).
    chance: float
    #: (3,) point at which a force acts, in the link's frame [m].
    point: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def fitted_law(self) -> Law:
        """The law whose columns the parameters belong to: a force at its point."""
        return self.law.at_point(self.point) if self.law.kind == "force" else self.law

    @property
    def size(self) -> float:
        """The mass [kg], the force [N], or the torque [N m or N]."""
        if self.law.kind == "force":
            return float(np.linalg.norm(self.term.beta))
        return float(self.term.beta[0])

    @property
    def std(self) -> float:
        """The standard deviation of the size."""
        along = np.zeros(len(self.term.beta))
        along[0] = 1.0
        if self.law.kind == "force":
            along = self.term.beta / max(self.size, 1e-12)
        return float(np.sqrt(along @ self.covariance @ along))

    @property
    def is_far_off(self) -> bool:
        """Whether a load's centre of mass lies farther away than the arm is long."""
        if self.law.kind != "load":
            return False
        reach = float(np.sum(self.law.effect.robot.link_reach()))
        return bool(np.linalg.norm(self.term.beta[1:]) > reach * abs(self.size))

    @property
    def stands_out(self) -> bool:
        """Whether it has evidence, and the error in its spans is larger than any that
        the model makes elsewhere."""
        return self.term.evidence > EVIDENCE_TO_ADD and self.over_elsewhere > _LARGER

    @property
    def errs_apart(self) -> bool:
        """Whether the error in its spans is larger than any elsewhere, by more than
        chance: so it is before its edges are known to less than a cell."""
        return self.over_elsewhere > _LARGER and self.chance < _CHANCE

    @property
    def is_proven(self) -> bool:
        """Whether it stands out by more than chance, explains more than it leaves, and
        has a size whose standard deviation is below a fifth of it, as confident
        findings have."""
        return (
            self.stands_out
            and self.errs_apart
            and self.share > _MOST
            and self.std < UNCERTAIN * abs(self.size)
            and not self.is_far_off
        )


def best_of(
    trials: Sequence[PassingTrial],
) -> tuple[PassingTrial, tuple[PassingTrial, ...]]:
    """Return the likeliest of some trials, and those that the data do not tell from it.

    All are compared with the rows worth one of the trial that explains most. Trials tie
    within J = 6 plus 4 % of the best one's; of these the one with fewest numbers is
    taken.
    """
    closest = max(trials, key=lambda t: t.term.drop)
    evidence = {t: t.term.evidence_with_worth_of(closest.term) for t in trials}
    best = max(evidence.values())
    tied = [t for t in trials if best - evidence[t] < margin(best)]
    chosen = min(tied, key=lambda t: (t.law.freedom, -evidence[t]))
    return chosen, tuple(t for t in tied if t is not chosen)


def explained_share(before: Array, after: Array, acts: Mask) -> float:
    """Return the share, below 1, of the squared error in some rows that a cause
    explains.

    Parameters
    ----------
    before, after
        (n, M) weighted residual without and with the cause.
    acts
        (M,) flags: the rows in which it acts.
    """
    squares_before = float(np.sum(before[:, acts] ** 2))
    squares_after = float(np.sum(after[:, acts] ** 2))
    return 1.0 - squares_after / max(squares_before, 1e-12)


@dataclass(frozen=True)
class Standing:
    """How the error in the spans of a cause stands beside the error elsewhere."""

    #: Mean square of the error in the spans, over the largest one that the model makes
    #: elsewhere in any cell of time.
    over_elsewhere: float
    #: Probability that the cells with errors above that one lie together as they do, and
    #: on as many joints, if cells and joints err independently.
    chance: float


def standing(before: Array, after: Array, cells: Cells, x: Array) -> Standing:
    """Compare the squared error without a cause in its spans with that elsewhere.

    Some cell always errs most, so that one cell that stands out proves nothing. Of a
    cells that do, among C, all are in the spans. They lie in g groups without a gap;
    a cells that could lie anywhere are in at most g groups with the probability

        sum_{r <= g} (a-1 over r-1) (C-a+1 over r) / (C over a)

    (runs of two kinds of elements: Wald, Wolfowitz, Ann. Math. Stat. 1940). One cell
    proves something where several joints err most in it and the cause explains each:
    a further one would err so by chance with the share of the spans in all cells.

    Cells beside an edge are left out elsewhere: an edge is known to a part of a cell.

    Parameters
    ----------
    before, after
        (n, M) weighted residual without and with the cause.
    x
        (C,) the share of each cell in which the cause acts.
    """
    is_beside = np.convolve(x, np.ones(3), mode="same") > 0.0
    acts = x[cells.label] > 0.5
    if not acts.any() or is_beside.all():
        return Standing(0.0, 1.0)
    # (C, n) mean squares in each cell, joint by joint.
    without, with_cause = (
        np.array([np.mean(error[:, rows] ** 2, axis=1) for rows in cells.rows])
        for error in (before, after)
    )
    elsewhere = with_cause[~is_beside]
    largest = max(float(elsewhere.mean(axis=1).max()), 1e-12)
    stands_out = (x > 0.0) & (without.mean(axis=1) > largest)
    in_spans, left = (np.mean(error[:, acts] ** 2, axis=1) for error in (before, after))
    is_explained = left < (1.0 - _MOST) * in_spans
    n_joints = int(np.sum(is_explained & (in_spans > elsewhere.max(axis=0))))
    share = float(np.mean(x > 0.0))
    return Standing(
        over_elsewhere=float(in_spans.mean()) / largest,
        chance=chance_of_groups(stands_out) * share ** max(n_joints - 1, 0),
    )


def chance_of_groups(flags: Mask) -> float:
    """Return the probability that as many flags at random are in as few groups or
    fewer; 1 without any."""
    n_flags = int(flags.sum())
    if n_flags == 0:
        return 1.0
    n_groups = int(np.sum(np.diff(flags.astype(int), prepend=0) == 1))
    ways = sum(
        math.comb(n_flags - 1, r - 1) * math.comb(len(flags) - n_flags + 1, r)
        for r in range(1, n_groups + 1)
    )
    return ways / math.comb(len(flags), n_flags)
