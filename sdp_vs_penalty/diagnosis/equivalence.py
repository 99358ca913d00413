"""Equivalence sets across kinds: what would do as well in the place of a finding.

Rivals are looked for among all effects on any joints, whatever number of constants they
have: a payload beside a gain, a tilt beside a spring, one delay of all joints beside the
delays of single ones. Two questions are asked of each, both about torque:

- does it explain these rows as well, to within odds of 20 to 1 and 4 % of what is
  explained (a law is right to that share), each of its coefficients costing what chance
  makes of one;
- does it predict motion that was left out as well, to within 1 % of the sum of the
  joints' log errors.

What fails one of these is told from the finding. A finding is confident only where
nothing is left in its set.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sdp_vs_penalty.diagnosis.constants import (
    EVIDENCE_TO_DISTINGUISH,
    LAW_TOLERANCE,
    MAX_CANDIDATES_REFINED,
    MINOR,
)
from sdp_vs_penalty.diagnosis.explanation import Explanation
from sdp_vs_penalty.diagnosis.held_out import HeldOut, HeldOutData, harm
from sdp_vs_penalty.diagnosis.library import Batch, Candidate, may_join
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, WhiteFit
from sdp_vs_penalty.diagnosis.refine import refine_constants
from sdp_vs_penalty.diagnosis.search import Search

#: Share of what a finding explains from which a candidate is refined, whose constants
#: stand on a coarse grid.
_PROMISING = 0.5


@dataclass(frozen=True)
class _Group:
    """Findings that one candidate may stand in the place of.

    terms : the findings; others : all other findings; fit : of the model and the others;
    drop : of the deviance by the terms; squares : of the weighted torque that they
    explain; freedom : coefficients and constants that the rows determine; worth : rows
    that are worth one.
    """

    terms: tuple[ScoredEffect, ...]
    others: tuple[ScoredEffect, ...]
    fit: WhiteFit
    drop: float
    squares: float
    freedom: float
    worth: float

    @property
    def margin(self) -> float:
        """By how much less a rival may lower the deviance."""
        return EVIDENCE_TO_DISTINGUISH * self.worth + LAW_TOLERANCE * self.drop

    def is_rival(self, other: ScoredEffect) -> bool:
        """Whether these rows do not tell another effect from the terms."""
        more = max(other.freedom - self.freedom, 0.0) * self.worth
        return other.drop - more > self.drop - self.margin


def with_equivalence_sets(explanation: Explanation, judge: HeldOutData) -> Explanation:
    """The findings, each with what neither these rows nor motion left out tell from it."""
    search = explanation.search
    groups = _groups(search)
    rivals = [(g, r) for g in groups for r in _rivals_on_rows(search, g)]
    if not rivals:
        return explanation
    effects = [t.form.effect for t in (*explanation.terms, *(r for _, r in rivals))]
    estimate = replace(explanation.first, theta=explanation.estimate.theta)
    held_out = judge.held_out_errors(search.data.rows, effects, estimate)
    found = {id(t): list(t.rivals) for t in search.terms}
    for k, (group, rival) in enumerate(rivals, start=len(explanation.terms)):
        if _predicts_as_well(explanation, held_out, group, k):
            for term in group.terms:
                found[id(term)].append(rival)
    out = copy(search)
    out.terms = [
        replace(t, rivals=_one_a_candidate(found[id(t)])) for t in search.terms
    ]
    return replace(explanation, search=out)


def _one_a_candidate(rivals: Sequence[ScoredEffect]) -> tuple[ScoredEffect, ...]:
    """The first of each candidate."""
    by_key = {r.key: r for r in reversed(rivals)}
    return tuple(reversed(by_key.values()))


def _predicts_as_well(
    explanation: Explanation,
    held_out: HeldOut,
    group: _Group,
    rival: int,
) -> bool:
    """Whether errors on data left out are no larger with a rival in the place of a group;
    rival : where it stands among the effects."""
    replaced = {t.text for t in group.terms}
    before = range(len(explanation.terms))
    after = [k for k in before if explanation.terms[k].text not in replaced]
    error_before = held_out.least_squares_errors(before)
    error_after = held_out.least_squares_errors([*after, rival])
    return harm(error_before, error_after) < MINOR


def _groups(search: Search) -> list[_Group]:
    """Each finding alone, and those of one effect on several joints together."""
    terms = search.terms
    names = [t.key[0] for t in terms]
    same = [[t for t in terms if t.key[0] == n] for n in dict.fromkeys(names)]
    together = [tuple(g) for g in same if len(g) > 1]
    full = search.score.fit(search.nuisances.with_law_misfits(terms), search.fit)
    groups = [*((t,) for t in terms), *together]
    return [_judge_group(search, full, g) for g in groups]


def _judge_group(
    search: Search,
    full: WhiteFit,
    terms: tuple[ScoredEffect, ...],
) -> _Group:
    """What some findings explain beside all others; full : a fit with all columns."""
    others = [t for t in search.terms if t not in terms]
    beside = search.nuisances.with_law_misfits(others)
    fit = search.score.fit(beside, full)
    judged = [
        search.score.evidence_of(
            fit,
            t.form,
            t.columns,
        )
        for t in terms
    ]
    after = search.score.fit([*beside, *terms], full)
    left = after.residual * (after.level / fit.level)[:, None]
    squares = float(np.sum(fit.residual**2) - np.sum(left**2))
    drop = judged[0].drop
    if len(terms) > 1:
        drop = float(fit.deviance(fit.rss) - fit.deviance(after.rss))
    return _Group(
        terms=terms,
        others=tuple(others),
        fit=fit,
        drop=drop,
        squares=squares,
        freedom=sum(t.freedom for t in judged),
        worth=max(t.rows_worth_one for t in judged),
    )


def _rivals_on_rows(search: Search, group: _Group) -> list[ScoredEffect]:
    """The candidates that these rows do not tell from a group."""
    judge = partial(search.evidence_of, group.fit)
    out = []
    for form in _promising(search, group):
        rival = refine_constants(judge, judge(form))
        if group.is_rival(rival):
            out.append(rival)
    return out


def _promising(search: Search, group: _Group) -> list[Candidate]:
    """The best form of each law that explains enough of what the group does."""
    best = dict[Hashable, tuple[float, Candidate]]()
    for batch in search.library.batches:
        if not _acts_where(group, batch):
            continue
        explained, _ = search.score.explained(group.fit, batch)
        for f in _that_may_stand(search, group, batch):
            share = float(explained[f]) / max(group.squares, 1e-300)
            form = batch.forms[f]
            most, _ = best.get(form.discrete_choice, (_PROMISING, form))
            if share > most:
                best[form.discrete_choice] = share, form
    ranked = sorted(best.values(), key=lambda pair: -pair[0])
    return [form for _, form in ranked[:MAX_CANDIDATES_REFINED]]


def _acts_where(group: _Group, batch: Batch) -> bool:
    """Whether candidates act on a joint of a single finding, or on all joints of several
    findings."""
    if batch.forms[0].replaces_own_constant:
        return False
    joints = frozenset[int]().union(*(t.joints for t in group.terms))
    if len(group.terms) > 1:
        return joints <= {*batch.joints}
    return bool(joints & {*batch.joints})


def _that_may_stand(
    search: Search,
    group: _Group,
    batch: Batch,
) -> list[int]:
    """Which candidates of a batch may stand in the place of a group."""
    present = {t.key for t in search.terms}
    picked = [t.form for t in group.others]
    free = may_join(batch.forms, picked, search.data.estimate.model)
    return [
        f for f, form in enumerate(batch.forms) if free[f] and form.key not in present
    ]
