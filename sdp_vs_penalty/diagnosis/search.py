"""The search: effects are added, exchanged and dropped while the score says so."""

from __future__ import annotations

from collections.abc import Hashable, Sequence, Set
from copy import copy
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from sdp_vs_penalty.diagnosis.constants import (
    EVIDENCE_TO_ADD,
    EVIDENCE_TO_DISTINGUISH,
    LAW_TOLERANCE,
    MAX_CANDIDATES_REFINED,
)
from sdp_vs_penalty.diagnosis.evidence import EvidenceScorer
from sdp_vs_penalty.diagnosis.library import (
    Batch,
    Candidate,
    Key,
    Library,
    may_join,
)
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, WhiteFit
from sdp_vs_penalty.diagnosis.nuisances import Nuisances
from sdp_vs_penalty.diagnosis.refine import refine_constants
from sdp_vs_penalty.diagnosis.rules import ALL_RULES, Rules
from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.robot.arrays import Array


def search(
    data: WhiteData,
    library: Library,
    rules: Rules = ALL_RULES,
    progress: Progress = no_progress,
) -> Search:
    """Forward selection with exchange: effects are added while J > 10.

    Those are odds of 150 to 1 (Kass, Raftery 1995). Of candidates within 6 (odds of 20
    to 1) and 4 % of the best the simplest is named: the fewest constants and joints. One
    effect is exchanged for another that is as good and simpler, or likelier, and stays
    beside all nuisances; effects of one kind for one that acts on all their joints. One
    without enough evidence beside all others goes.
    """
    out = Search(data, library, rules)
    out.run(progress)
    return out


class Search:
    """A search over one library; afterwards ``terms`` and ``fit``.

    like : a search beside another model, whose rows may be the same.
    """

    def __init__(
        self,
        data: WhiteData,
        library: Library,
        rules: Rules = ALL_RULES,
        like: Search | None = None,
    ) -> None:
        self.data = data
        self.library = library
        self.rules = rules
        self.score: EvidenceScorer = EvidenceScorer(
            data,
            len(library.laws),
            library.laws,
            rules,
            like=None if like is None else like.score,
        )
        self._columns: dict[str, dict[int, Array]] = {}
        self.terms: list[ScoredEffect] = []
        #: Candidates that had not enough left once they had joined.
        self.refused = set[Key]()
        #: Terms that are part of the torque to which columns refer.
        self.in_reference = set[Key]()
        self.fit = self.bare = self.score.fit(())
        candidates = [f for b in library.batches for f in b.forms]
        self.nuisances = Nuisances(
            data,
            self.bare,
            candidates,
            self.columns,
            rules,
        )

    # What a candidate is worth.

    def columns(self, form: Candidate) -> dict[int, Array]:
        """White columns by joint; kept while the search lasts."""
        text = form.effect.text
        if text not in self._columns:
            self._columns[text] = self.data.columns(form.effect)
        return self._columns[text]

    def evidence_of(self, fit: WhiteFit, form: Candidate) -> ScoredEffect:
        """A candidate judged beside a fit."""
        return self.score.evidence_of(fit, form, self.columns(form))

    def beside(
        self,
        term: ScoredEffect,
        others: Sequence[ScoredEffect],
    ) -> ScoredEffect:
        """A term judged anew beside others, with the rivals that it had."""
        fit = self.score.fit(self.nuisances.around(term, others), self.fit)
        judged = self.score.evidence_of(fit, term.form, term.columns)
        return replace(judged, rivals=term.rivals)

    def refined(
        self,
        fit: WhiteFit,
        start: ScoredEffect,
        fixed: Set[str] = frozenset(),
    ) -> ScoredEffect:
        """A candidate with the shape constants that explain most beside a fit."""
        return refine_constants(partial(self.evidence_of, fit), start, fixed)

    # Which candidates there are beside a fit.

    def top_candidates(
        self,
        fit: WhiteFit,
        terms: Sequence[ScoredEffect],
        on: frozenset[int] | None = None,
        beyond: float = 0.0,
        exact_joints: bool = False,
    ) -> list[ScoredEffect]:
        """The most likely form of each candidate, refined, the best first.

        on : some of whose joints, or all of them and no others (``exact_joints``);
        beyond : the evidence that has to be reached, nearly, to be of use.
        """
        screened = self._screened(
            fit,
            [t.form for t in terms],
            on,
            exact_joints,
        )
        top = max((t.evidence for t in screened), default=0.0)
        # A width that is far from those on the grid says little there, and all where it
        # is right.
        threshold = 0.5 * max(top, beyond) - 3.0 * EVIDENCE_TO_ADD
        useful = [
            t
            for t in screened
            if threshold < t.evidence or t.form.replaces_own_constant
        ]
        ranked = [self.refined(fit, t) for t in useful]
        ranked.sort(key=lambda t: -t.evidence)
        first = {t.key: t for t in reversed(ranked)}
        best = dict[Key, ScoredEffect]()
        for t in ranked:
            rival = best.setdefault(t.key, t)
            worth = first[t.key]
            if t.evidence_with_worth_of(worth) >= rival.evidence_with_worth_of(worth):
                best[t.key] = t
        return [t for t in ranked if best[t.key] is t]

    def _screened(
        self,
        fit: WhiteFit,
        picked: Sequence[Candidate],
        on: frozenset[int] | None,
        exact_joints: bool,
    ) -> list[ScoredEffect]:
        """The best form of each law on the grids, of the candidates that take most."""
        best = dict[Hashable, tuple[float, Candidate, dict[int, Array]]]()
        for batch in self.library.batches:
            if on is not None and not _acts_on(batch, on, exact_joints):
                continue
            values = self.score.screened(fit, batch)
            free = may_join(batch.forms, picked, self.data.estimate.model)
            for f in np.argsort(-values)[: np.count_nonzero(values > 0.0)]:
                form = batch.forms[f]
                if not free[f] or (on is None and form.key in self.refused):
                    continue
                if values[f] > best.get(form.discrete_choice, (0.0,))[0]:
                    columns = batch.columns(int(f))
                    best[form.discrete_choice] = float(values[f]), form, columns
        ranked = sorted(best.values(), key=lambda b: -b[0])
        return [
            self._judge_screened(fit, form, columns)
            for form, columns in _of_first_candidates(ranked)
        ]

    def _judge_screened(
        self,
        fit: WhiteFit,
        form: Candidate,
        columns: dict[int, Array],
    ) -> ScoredEffect:
        """A candidate judged in the columns that its batch has already."""
        self._columns.setdefault(form.effect.text, columns)
        return self.score.evidence_of(fit, form, columns)

    def simplest(self, ranked: Sequence[ScoredEffect]) -> ScoredEffect | None:
        """Of candidates, the best first, the simplest that is as good as the best."""
        if not ranked:
            return None
        best = ranked[0]
        margin = EVIDENCE_TO_DISTINGUISH + LAW_TOLERANCE * best.evidence
        tied = [
            t for t in ranked if best.evidence - t.evidence_with_worth_of(best) < margin
        ]
        plain = [t for t in tied if not any(t.form.refines(u.form) for u in tied)]
        simplest = min(
            plain, key=lambda t: (simplicity(t.form), -t.evidence_with_worth_of(best))
        )
        return simplest if simplest is best or self.rules.simplest else best

    # The steps.

    def run(self, progress: Progress = no_progress) -> list[ScoredEffect]:
        """Add, exchange, drop until nothing changes."""
        states_before = set[tuple[str, ...]]()
        # Each candidate joins, gives way and goes once at most.
        for _ in range(3 * len(self.library.laws)):
            best = self.best_addition()
            if best is None:
                after = self.exchange_one(self.terms)
            else:
                progress(f"{len(self.terms) + 1}: {best.form.effect.text}")
                after = self.drop_weak([*self.terms, best])
            if after is None:
                break
            state = tuple(sorted(str(t.key) for t in after))
            is_known = state in states_before
            if best is not None and (
                is_known or best.key not in {t.key for t in after}
            ):
                self.refused.add(best.key)
                continue
            self.terms = after
            if is_known:
                break
            states_before.add(state)
        self.fit = self.score.fit(self.terms)
        return self.terms

    def best_addition(self) -> ScoredEffect | None:
        """What to add next: the simplest of the best candidates that have enough
        evidence."""
        self.fit = self.score.fit(self.nuisances.with_law_misfits(self.terms), self.fit)
        candidates = self.top_candidates(self.fit, self.terms)
        return self.simplest([t for t in candidates if t.evidence > EVIDENCE_TO_ADD])

    def drop_weak(
        self,
        terms: Sequence[ScoredEffect],
        on: Set[int] = frozenset(),
    ) -> list[ScoredEffect]:
        """The terms that have enough evidence beside all others.

        The constants of each term on some joints (default: the newest one's) are refined
        again first.
        """
        terms = list(terms)
        if not on and terms:
            on = terms[-1].joints
        full = self.score.fit(self.nuisances.with_law_misfits(terms), self.fit)
        for _ in range(2):
            changed = False
            for term in list(terms):
                others = [t for t in terms if t != term]
                fit = self.score.fit(self.nuisances.around(term, others), full)
                again = self.score.evidence_of(fit, term.form, term.columns)
                if term.joints & on:
                    again = self.refined(fit, again)
                if again.evidence <= EVIDENCE_TO_ADD:
                    terms = others
                    changed = True
                    continue
                terms[terms.index(term)] = replace(again, rivals=term.rivals)
                if again.text != term.text:
                    changed = True
                    full = self.score.fit(self.nuisances.with_law_misfits(terms), full)
            if not changed:
                break
        return terms

    def score_jointly(
        self,
        group: Sequence[ScoredEffect],
        others: Sequence[ScoredEffect],
    ) -> list[ScoredEffect]:
        """Terms judged together: each beside the others and those before it."""
        return [self.beside(g, [*others, *group[:i]]) for i, g in enumerate(group)]

    def exchange_one(self, terms: Sequence[ScoredEffect]) -> list[ScoredEffect] | None:
        """One term for another that is as good and simpler, or better; or terms of one
        effect for one.

        None where nothing is exchanged; every term then knows its rivals.
        """
        with_rivals = []
        for term in terms:
            others = [t for t in terms if t != term]
            judged = self.beside(term, others)
            candidates = self._candidates_instead([term], others, judged.evidence)
            rivals = self.equivalence_set(judged, candidates)
            with_rivals.append(replace(judged, rivals=rivals))
            after = self._exchange(judged, candidates, others)
            if after is not None:
                return after
        merged = self.merge_one_effect(terms)
        if merged is None:
            self.terms = with_rivals
        return merged

    def _candidates_instead(
        self,
        group: Sequence[ScoredEffect],
        others: Sequence[ScoredEffect],
        evidence: float,
    ) -> list[ScoredEffect]:
        """What may stand in the place of a group of terms, the best first."""
        joints = frozenset[int]().union(*(t.joints for t in group))
        fit = self.score.fit(self.nuisances.around(group[0], others), self.fit)
        is_group = len(group) > 1
        out = self.top_candidates(fit, others, joints, evidence, exact_joints=is_group)
        if self.in_reference.issuperset(t.key for t in group):
            # They would explain themselves.
            out = [t for t in out if not t.form.effect.needs_torque]
        return out

    def _exchange(
        self,
        term: ScoredEffect,
        candidates: Sequence[ScoredEffect],
        others: Sequence[ScoredEffect],
    ) -> list[ScoredEffect] | None:
        """The terms with another one in the place of this one, if that is as good and
        simpler, or better."""
        other = self._best_instead([term], candidates)
        if other is None:
            return None
        J = term.evidence
        J_other = other.evidence_with_worth_of(term)
        margin = EVIDENCE_TO_ADD + LAW_TOLERANCE * max(J, 0.0)
        rank = simplicity(term.form), -J
        rank_of_other = simplicity(other.form), -J_other
        is_simpler = not other.form.refines(term.form) and rank_of_other < rank
        is_preferred = is_simpler or term.form.refines(other.form)
        is_as_good = J + margin < J_other or (J - margin < J_other and is_preferred)
        if is_as_good and self.rules.exchange:
            return self._if_it_stays(other, others)
        return None

    def merge_one_effect(
        self, terms: Sequence[ScoredEffect]
    ) -> list[ScoredEffect] | None:
        """Several terms of one effect for a candidate that acts on all of their joints,
        where that does nearly as well."""
        for group in self.mergeable_groups(terms):
            others = [t for t in terms if t not in group]
            J = sum(t.evidence for t in self.score_jointly(group, others))
            candidates = self._candidates_instead(group, others, J)
            other = self._best_instead(group, candidates)
            margin = EVIDENCE_TO_ADD + LAW_TOLERANCE * max(J, 0.0)
            if other is not None and J - margin < other.evidence:
                after = self._if_it_stays(other, others)
                if after is not None:
                    return after
        return None

    def _best_instead(
        self,
        group: Sequence[ScoredEffect],
        candidates: Sequence[ScoredEffect],
    ) -> ScoredEffect | None:
        """The simplest of the best candidates that have enough evidence, if that is
        another one."""
        enough = [t for t in candidates if t.evidence > EVIDENCE_TO_ADD]
        other = self.simplest(enough)
        if other is None or other.key in {t.key for t in group}:
            return None
        return other

    def _if_it_stays(
        self,
        other: ScoredEffect,
        others: Sequence[ScoredEffect],
    ) -> list[ScoredEffect] | None:
        """The terms with another one, if that stays beside what is tolerated, too."""
        after = self.drop_weak([*others, other])
        return after if any(t.key == other.key for t in after) else None

    def mergeable_groups(
        self, terms: Sequence[ScoredEffect]
    ) -> list[list[ScoredEffect]]:
        """Groups of terms of one effect that may be one candidate that acts on all of
        their joints."""
        batches = self.library.batches
        joint_sets = {frozenset(b.joints) for b in batches if len(b.joints) > 1}
        findings = [t for t in terms if not t.form.replaces_own_constant]
        out = list[list[ScoredEffect]]()
        for name in dict.fromkeys(t.key[0] for t in findings):
            same = [t for t in findings if t.key[0] == name]
            groups = [list(pair) for pair in combinations(same, 2)]
            if len(same) > 2:
                groups.append(same)
            for group in groups:
                if frozenset().union(*(t.joints for t in group)) in joint_sets:
                    out.append(group)
        return out if out and self.rules.merge_one_effect else []

    @staticmethod
    def equivalence_set(
        term: ScoredEffect, candidates: Sequence[ScoredEffect]
    ) -> tuple[ScoredEffect, ...]:
        """The candidates that these rows do not tell from a term: within 6 of it."""
        threshold = term.evidence - EVIDENCE_TO_DISTINGUISH
        return tuple(
            t
            for t in candidates
            if t.key != term.key
            and not t.form.replaces_own_constant
            and t.evidence_with_worth_of(term) > threshold
        )

    def drop_disfavoured(self, terms: Sequence[ScoredEffect]) -> Search:
        """The search with some of its terms only, each judged beside those.

        Where there is evidence against some, the one against which it is most goes, and
        the others are judged again.
        """
        out = copy(self)
        while True:
            out.fit = out.score.fit(out.nuisances.with_law_misfits(terms), self.fit)
            out.terms = [out.beside(t, [x for x in terms if x != t]) for t in terms]
            weakest = min(
                out.terms,
                key=lambda t: t.evidence,
                default=None,
            )
            if weakest is None or weakest.evidence > 0.0:
                break
            terms = [t for t in out.terms if t is not weakest]
        out.fit = out.score.fit(out.terms)
        return out


def _acts_on(
    batch: Batch,
    joints: frozenset[int],
    exactly: bool,
) -> bool:
    """Whether candidates change the torque of some of the joints, or of exactly these."""
    if exactly:
        return joints == frozenset(batch.joints)
    return bool(joints & frozenset(batch.joints))


def _of_first_candidates(
    ranked: Sequence[tuple[float, Candidate, dict[int, Array]]],
) -> list[tuple[Candidate, dict[int, Array]]]:
    """The forms, with their columns, of the candidates that come first."""
    keys = list(dict.fromkeys(form.key for _, form, _ in ranked))
    close = keys[:MAX_CANDIDATES_REFINED]
    return [(form, columns) for _, form, columns in ranked if form.key in close]


def simplicity(form: Candidate) -> tuple[int, int, bool]:
    """Fewest constants, fewest joints, what refines nothing else."""
    return (
        form.n_coefficients + form.constants,
        len(form.effect.joints),
        bool(form.effect.refines),
    )
