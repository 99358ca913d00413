"""Equivalence sets across kinds of effects: what could replace a finding.

Rivals are looked for among all effects on any joints, with any number of constants: a
payload beside a gain, a tilt beside a spring, one delay of all joints beside delays of
single ones. A rival has to pass two tests on torque:

- it explains these rows as well, within 6 (odds of 20 to 1) and 4 % of what is
  explained (the accuracy of a law); a rival with more coefficients pays for what chance
  makes of each;
- it predicts data left out as well, within 1 % of the sum of the joints' log errors.

A finding is confident only if no rival passes both.
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
    """One or several findings that one candidate may replace.

    terms : the findings; others : all other findings; fit : of the model with the
    others; drop : fall of the deviance by the terms; squares : of the weighted torque
    that they explain; freedom : effective number of coefficients and constants; worth :
    number of correlated rows that count as one.
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
        """Difference in deviance [no unit] within which a rival explains as much as the
        group.

        It is 6 (odds of 20 to 1) times the number of rows that count as one, plus 4 %
        of what the group explains.
        """
        return EVIDENCE_TO_DISTINGUISH * self.worth + LAW_TOLERANCE * self.drop

    def is_rival(self, other: ScoredEffect) -> bool:
        """Return whether these rows cannot tell another effect from the group.

        The other effect pays for its additional coefficients, one unit of deviance each
        (times the number of correlated rows that count as one), and may then explain
        less by at most :attr:`margin`.
        """
        more = max(other.freedom - self.freedom, 0.0) * self.worth
        return other.drop - more > self.drop - self.margin


def with_equivalence_sets(explanation: Explanation, judge: HeldOutData) -> Explanation:
    """Find the rivals of each finding: effects that all data confuse with it.

    A rival fits the searched rows as well, and predicts the data left out as well.

    Parameters
    ----------
    explanation
        The findings beside the model.
    judge
        The data left out.

    Returns
    -------
    Explanation
        The same findings with their rivals.
    """
    search = explanation.search
    pairs = list[tuple[_Group, ScoredEffect]]()
    for group in _groups(search):
        pairs += [(group, rival) for rival in _rivals_on_rows(search, group)]
    if not pairs:
        return explanation
    # On data left out effects have numbers: the explanation's first, then the rivals.
    all_terms = [*explanation.terms, *(rival for _, rival in pairs)]
    effects = [t.form.effect for t in all_terms]
    estimate = replace(explanation.first, theta=explanation.estimate.theta)
    held_out = judge.held_out_errors(search.data.rows, effects, estimate)
    rivals_by_term = {t: list(t.rivals) for t in search.terms}
    for number, (group, rival) in enumerate(pairs, start=len(explanation.terms)):
        if _predicts_as_well(explanation, held_out, group, number):
            for term in group.terms:
                rivals_by_term[term].append(rival)
    out = copy(search)
    out.terms = [
        replace(term, rivals=_one_a_candidate(rivals))
        for term, rivals in rivals_by_term.items()
    ]
    return replace(explanation, search=out)


def _one_a_candidate(rivals: Sequence[ScoredEffect]) -> tuple[ScoredEffect, ...]:
    """Keep the first rival of each key (effect and joint), in order."""
    by_key = {r.key: r for r in reversed(rivals)}
    return tuple(reversed(by_key.values()))


def _predicts_as_well(
    explanation: Explanation,
    held_out: HeldOut,
    group: _Group,
    rival: int,
) -> bool:
    """Return whether a rival predicts data left out as well as the group that it
    replaces.

    The sum of the joints' log errors may rise by less than MINOR (1 %).

    Parameters
    ----------
    explanation
        All constants and findings; their numbers in ``held_out`` come first.
    held_out
        Errors on data left out of any selection of effects, by number.
    group
        The findings that the rival replaces.
    rival
        Number of the rival among the effects of ``held_out``.
    """
    replaced = {t.text for t in group.terms}
    before = range(len(explanation.terms))
    after = [k for k in before if explanation.terms[k].text not in replaced]
    error_before = held_out.least_squares_errors(before)
    error_after = held_out.least_squares_errors([*after, rival])
    return harm(error_before, error_after) < MINOR


def _groups(search: Search) -> list[_Group]:
    """List the groups of findings that one candidate may replace.

    They are each finding alone, and all findings of one effect on several joints
    together.
    """
    terms = search.terms
    terms_by_effect = dict[str, list[ScoredEffect]]()
    for term in terms:
        terms_by_effect.setdefault(term.key[0], []).append(term)
    groups: list[tuple[ScoredEffect, ...]] = [(term,) for term in terms]
    groups += [tuple(same) for same in terms_by_effect.values() if len(same) > 1]
    full = search.score.fit(search.nuisances.with_law_misfits(terms), search.fit)
    return [_judge_group(search, full, group) for group in groups]


def _judge_group(
    search: Search,
    full: WhiteFit,
    terms: tuple[ScoredEffect, ...],
) -> _Group:
    """Compute what a group of findings explains beside all other findings.

    Parameters
    ----------
    search
        The search with all findings.
    full
        A fit with all findings, whose columns are used again.
    terms
        The findings of the group.
    """
    others = [t for t in search.terms if t not in terms]
    terms_beside = search.nuisances.with_law_misfits(others)
    fit = search.score.fit(terms_beside, full)
    judged = [search.score.evidence_of(fit, t.form, t.columns) for t in terms]
    after = search.score.fit([*terms_beside, *terms], full)
    # The residual with the terms, weighted as that without them.
    residual_after = after.residual * (after.level / fit.level)[:, None]
    squares = float(np.sum(fit.residual**2) - np.sum(residual_after**2))
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
    """List the candidates that the searched rows cannot tell from a group of findings.

    The shape constants of promising candidates are refined before they are judged.
    """
    judge = partial(search.evidence_of, group.fit)
    out = []
    for form in _promising(search, group):
        rival = refine_constants(judge, judge(form))
        if group.is_rival(rival):
            out.append(rival)
    return out


def _promising(search: Search, group: _Group) -> list[Candidate]:
    """List the candidates that explain at least half of what the group explains.

    There are at most MAX_CANDIDATES_REFINED, the best first, with one set of shape
    constants for each law. Half (_PROMISING) is enough, since constants lie on a coarse
    grid and are refined afterwards.
    """
    best = dict[Hashable, tuple[float, Candidate]]()
    for batch in search.library.batches:
        if not _may_do_the_same(group, batch):
            continue
        explained, _ = search.score.explained(group.fit, batch)
        shares = explained / max(group.squares, 1e-300)
        for f in _that_may_stand(search, group, batch):
            form = batch.forms[f]
            share = float(shares[f])
            largest_share, _ = best.get(form.discrete_choice, (_PROMISING, form))
            if share > largest_share:
                best[form.discrete_choice] = share, form
    ranked = sorted(best.values(), key=lambda pair: -pair[0])
    return [form for _, form in ranked[:MAX_CANDIDATES_REFINED]]


def _may_do_the_same(group: _Group, batch: Batch) -> bool:
    """Return whether a batch's candidates may make a group's torque beside the model.

    A single finding may have a rival on any joint: masses that are fitted again turn a
    gain of joint 2 that is 1 % too large into one of joint 1 that is 1 % too small. For
    several findings all their joints are needed. Other values of the model's own
    constants are no rivals.
    """
    if batch.forms[0].replaces_own_constant:
        return False
    if len(group.terms) == 1:
        return True
    joints = frozenset[int]().union(*(t.joints for t in group.terms))
    return joints <= {*batch.joints}


def _that_may_stand(
    search: Search,
    group: _Group,
    batch: Batch,
) -> list[int]:
    """List the numbers (in the batch) of the candidates that may replace the group.

    Left out are effects that are among the findings already, and those that may not be
    combined with the other findings.
    """
    present = {t.key for t in search.terms}
    picked = [t.form for t in group.others]
    free = may_join(batch.forms, picked, search.data.estimate.model)
    return [
        f for f, form in enumerate(batch.forms) if free[f] and form.key not in present
    ]
