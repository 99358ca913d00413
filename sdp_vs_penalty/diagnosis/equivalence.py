"""Equivalence sets across kinds of effects: what could replace a finding.

Rivals are looked for among all effects on a finding's joints, with any number of
constants: a payload beside a gain, a tilt beside a spring, one delay of all joints
beside delays of single ones. A rival has to pass two tests on torque:

- it explains these rows as well, within 6 (odds of 20 to 1) and 4 % of what is
  explained (the accuracy of a law); a rival with more coefficients pays for what chance
  makes of each;
- it predicts data left out as well, within 1 % of the sum of the joints' log errors.

A finding is confident only if no rival passes both.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial

from sdp_vs_penalty.diagnosis.constants import (
    EVIDENCE_TO_DISTINGUISH,
    LAW_TOLERANCE,
    MINOR,
    PROMISING,
)
from sdp_vs_penalty.diagnosis.explanation import Explanation
from sdp_vs_penalty.diagnosis.held_out import (
    HeldOut,
    HeldOutData,
    least_squares_parameters,
)
from sdp_vs_penalty.diagnosis.library import Batch, Key
from sdp_vs_penalty.diagnosis.linear_fit import HeldLaw, ScoredEffect, WhiteFit
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.estimation.certificate import NOT_CERTIFIED
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.export import files_without_place


@dataclass(frozen=True)
class _Group:
    """One or several findings that one candidate may replace."""

    #: The findings.
    terms: tuple[ScoredEffect, ...]
    #: All other findings.
    others: tuple[ScoredEffect, ...]
    #: The fit of the model with all other findings.
    fit: WhiteFit
    #: Drop of the deviance that the findings bring.
    deviance_drop: float
    #: Effective number of coefficients and constants of the findings.
    freedom: float
    #: Number of correlated rows that count as one.
    rows_worth_one: float

    @property
    def deviance_margin(self) -> float:
        """The shortfall in deviance below which a rival counts as equally good.

        margin = 6 v + 4 % dD: an evidence of 6 (odds of 20 to 1), times the number v of
        correlated rows that count as one, plus the accuracy of laws (LAW_TOLERANCE),
        times the deviance drop dD of the findings to replace.
        """
        smallest_difference = EVIDENCE_TO_DISTINGUISH * self.rows_worth_one
        return smallest_difference + LAW_TOLERANCE * self.deviance_drop

    def is_rival(self, other: ScoredEffect) -> bool:
        """Return whether another effect explains these rows as well as the group.

        Its deviance drop has to come within ``deviance_margin`` of the group's. From it
        the drop that chance brings is subtracted: v for each coefficient that the other
        effect has more, where v correlated rows count as one.
        """
        n_more = max(other.freedom - self.freedom, 0.0)
        drop_by_chance = n_more * self.rows_worth_one
        return other.drop - drop_by_chance > self.deviance_drop - self.deviance_margin


def with_equivalence_sets(explanation: Explanation, judge: HeldOutData) -> Explanation:
    """Add to each finding its rivals: the effects that explain the data as well.

    A rival has to explain the searched rows as well as the finding, and to predict the
    data left out as well.

    Parameters
    ----------
    explanation
        The findings beside the model.
    judge
        The data left out: a test run, or folds of the training run.

    Returns
    -------
    Explanation
        The same findings with their rivals.
    """
    search = explanation.search
    full = search.score.fit(search.nuisances.with_law_misfits(search.terms), search.fit)
    tried = [(group, _tried_in_place(search, group)) for group in _groups(search, full)]
    pairs = [
        (group, rival)
        for group, terms in tried
        for rival in terms
        if group.is_rival(rival)
    ]
    no_place = {
        term: files_without_place(term.form.effect, explanation.estimate)
        for term in search.terms
    }
    laws = {
        group.terms[0]: law
        for group, terms in tried
        if len(group.terms) == 1
        for law in _nearest_held(terms, no_place[group.terms[0]], explanation.estimate)
    }
    if not (pairs or laws):
        return explanation
    # ``held_out`` addresses effects by number: first the findings, then the rivals, then
    # the laws that files hold.
    rivals_and_laws = [*(rival for _, rival in pairs), *laws.values()]
    all_terms = [*explanation.terms, *rivals_and_laws]
    effects = [t.form.effect for t in all_terms]
    theta = explanation.estimate.theta
    estimate = replace(explanation.first, theta=theta, certificate=NOT_CERTIFIED)
    held_out = judge.held_out_errors(search.data.rows, effects, estimate)
    # By finding: one rival of each key (effect, joint), the first of those with it.
    rivals_by_term = {t: dict[Key, ScoredEffect]() for t in search.terms}
    first_rival = len(explanation.terms)
    for number, (group, rival) in enumerate(pairs, start=first_rival):
        if _predicts_as_well(explanation, held_out, group, number):
            for term in group.terms:
                rivals_by_term[term].setdefault(rival.key, rival)
    held = {}
    for number, (term, law) in enumerate(laws.items(), first_rival + len(pairs)):
        lacking = files_without_place(law.form.effect, explanation.estimate)
        files = tuple(name for name in no_place[term] if name not in lacking)
        held[term] = HeldLaw(law.text, files, held_out.errors([number]))
    out = copy(search)
    out.terms = [
        replace(term, rivals=tuple(rivals.values()), held_law=held.get(term))
        for term, rivals in rivals_by_term.items()
    ]
    return replace(explanation, search=out)


def _nearest_held(
    tried: Sequence[ScoredEffect], no_place_in: Sequence[str], estimate: Estimate
) -> list[ScoredEffect]:
    """Return the candidate that explains most of those for which one of these files,
    which have no place for a finding, has a place; nothing without one."""
    held = [
        term
        for term in tried
        if not {*no_place_in} <= {*files_without_place(term.form.effect, estimate)}
    ]
    return sorted(held, key=lambda term: -term.drop)[:1]


def _predicts_as_well(
    explanation: Explanation, held_out: HeldOut, group: _Group, rival: int
) -> bool:
    """Return whether a rival predicts data left out as well as the group that it
    replaces.

    It does if the sum over joints of log(error) rises by less than MINOR (1 %) when it
    replaces the group. Both models are fitted by least squares.

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
    all_numbers = range(len(explanation.terms))
    others = [k for k in all_numbers if explanation.terms[k].text not in replaced]
    choices = all_numbers, [*others, rival]
    return held_out.change(*choices, None, least_squares_parameters).rise < MINOR


def _groups(search: Search, full: WhiteFit) -> list[_Group]:
    """List the groups of findings that one candidate may replace.

    Each finding is a group by itself. All findings of one effect on several joints are
    a further group: one delay of the robot, say, may replace delays of the joints.
    ``full`` is a fit with all findings, whose columns are used again.
    """
    terms = search.terms
    terms_by_effect = dict[str, list[ScoredEffect]]()
    for term in terms:
        terms_by_effect.setdefault(term.key[0], []).append(term)
    groups: list[tuple[ScoredEffect, ...]] = [(term,) for term in terms]
    groups += [tuple(same) for same in terms_by_effect.values() if len(same) > 1]
    return [_judge_group(search, full, group) for group in groups]


def _judge_group(
    search: Search, full: WhiteFit, terms: tuple[ScoredEffect, ...]
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
    deviance_drop = judged[0].drop
    if len(terms) > 1:
        with_terms = search.score.fit([*terms_beside, *terms], full)
        deviance_drop = float(fit.own_deviance - fit.deviance(with_terms.rss))
    return _Group(
        terms=terms,
        others=tuple(others),
        fit=fit,
        deviance_drop=deviance_drop,
        freedom=sum(t.freedom for t in judged),
        rows_worth_one=max(t.rows_worth_one for t in judged),
    )


def _tried_in_place(search: Search, group: _Group) -> list[ScoredEffect]:
    """List the candidates that explain half as much of the searched rows as a group
    before their constants are refined, with refined constants."""
    present = {t.key for t in search.terms}
    screened = search.screened(
        group.fit, group.others, present, partial(_acts_there, group)
    )
    single = [t.form for t in group.terms] if len(group.terms) == 1 else []
    return [
        search.refined(group.fit, t)
        for t in screened
        if t.drop > PROMISING * group.deviance_drop
        and not any(t.form.generalises(finding) for finding in single)
    ]


def _acts_there(group: _Group, batch: Batch) -> bool:
    """Return whether candidates are effects that act on a joint of a single finding, or
    on all joints of several findings."""
    if batch.forms[0].replaces_own_constant:
        return False
    joints = frozenset[int]().union(*(t.joints for t in group.terms))
    if len(group.terms) > 1:
        return joints <= {*batch.joints}
    return not joints.isdisjoint(batch.joints)
