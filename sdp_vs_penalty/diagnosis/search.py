"""The search: effects are added and dropped while the score says so."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence, Set
from copy import copy
from functools import partial

import numpy as np

from sdp_vs_penalty.diagnosis.constants import (
    EVIDENCE_TO_ADD,
    MAX_CANDIDATES_REFINED,
    PROMISING,
)
from sdp_vs_penalty.diagnosis.evidence import EvidenceScorer
from sdp_vs_penalty.diagnosis.library import Batch, Candidate, Key, Library, may_join
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, WhiteFit, margin
from sdp_vs_penalty.diagnosis.nuisances import Nuisances
from sdp_vs_penalty.diagnosis.refine import Judge, refine_constants
from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.effects.model import depends
from sdp_vs_penalty.effects.plain_words import effect_in_words
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.robot.arrays import Array


def search(
    data: WhiteData, library: Library, progress: Progress = no_progress
) -> Search:
    """Find the effects that a model lacks, by forward selection with dropping.

    The evidence J of an effect is twice the logarithm of the odds that it acts. In each
    step the simplest of the best candidates with J > 10 (odds of 150 to 1; Kass,
    Raftery 1995) is added: candidates within 6 (odds of 20 to 1) plus 4 % of the best
    one's J tie, and the one with fewest constants and joints is taken. Effects that
    fall to J <= 10 beside the others are dropped.

    Parameters
    ----------
    data
        The log's rows in units of their noise, and the model's own columns on them.
    library
        All candidates: every effect on every joint, at a grid of shape constants.
    progress
        Is called with a short text whenever an effect is added.

    Returns
    -------
    Search
        The finished search: its ``terms`` are the effects found, its ``fit`` is the fit
        of the model with them.
    """
    out = Search(data, library)
    out.run(progress)
    return out


class Search:
    """A search for missing effects over one library of candidates.

    A candidate is an effect on a joint (or on the robot) with values of its shape
    constants, such as a Stribeck velocity; its laws are its discrete variants. After
    :meth:`run`, ``terms`` are the effects found and ``fit`` is the fit of the model
    with them; ``bare`` is the fit of the model alone.
    """

    def __init__(
        self, data: WhiteData, library: Library, like: Search | None = None
    ) -> None:
        """Prepare a search that has chosen no effect yet.

        Parameters
        ----------
        data
            The log's rows in units of their noise, with the model's columns on them.
        like
            An earlier search with another model. If its white rows are equal, its
            orthonormal basis of the model's columns is used again.
        """
        self.data = data
        self.library = library
        self.score: EvidenceScorer = EvidenceScorer(
            data,
            len(library.laws),
            library.laws,
            like=None if like is None else like.score,
        )
        # White columns by the effect's text: those that depend on the model, and those
        # that follow from the motion alone, which searches with other models share.
        self._columns_of_model = dict[str, dict[int, Array]]()
        self._columns_of_motion = dict[str, dict[int, Array]]()
        if like is not None and like._has_columns_of_motion(data):
            self._columns_of_motion = like._columns_of_motion
        self.terms: list[ScoredEffect] = []
        #: The model's own effects with other constants, which these rows' model has.
        self.constants: tuple[ScoredEffect, ...] = ()
        #: Whether columns follow the findings; a second law of one cause waits for that.
        self.is_referred = False
        self.has_waiting = False
        #: Candidates that were added once and did not keep enough evidence.
        self.refused = set[Key]()
        #: Effects that were found with a size that contradicts their constants: they
        #: stand in for another effect.
        self.barred = set[Key]()
        self.bare = self.score.fit(())
        self.fit = self.bare
        self.nuisances = Nuisances(data, self.bare)

    @property
    def criterion(self) -> float:
        """Criterion of Bayes and Schwarz (BIC) of the fit with the effects found.

        It is the deviance plus log N for each of their coefficients, with the N rows of
        all joints.
        """
        findings = [t for t in self.terms if not t.form.replaces_own_constant]
        n_coefficients = sum(t.form.n_coefficients for t in findings)
        price = np.log(self.data.y.size)
        return float(self.fit.own_deviance + n_coefficients * price)

    def with_terms(self, terms: Sequence[ScoredEffect]) -> Search:
        """Return a copy of the search with other effects chosen, and their fit."""
        out = copy(self)
        out.terms = [*terms]
        out.fit = out.score.fit(out.terms)
        return out

    def _has_columns_of_motion(self, data: WhiteData) -> bool:
        """Return whether columns that follow from the motion are the same on other data.

        They are weighted by the noise, and the signs of velocities in them turn round
        over the model's widths.
        """
        own = self.data.estimate.model.sign_width
        return self.data.noise is data.noise and own == data.estimate.model.sign_width

    # What a candidate is worth.

    def columns(self, form: Candidate) -> dict[int, Array]:
        """Return a candidate's white columns, (M rows, k coefficients) by joint from 0.

        White columns are weighted so that the noise has variance 1. They are computed
        once for each set of shape constants; the effect's text is the key under which
        they are kept.
        """
        text = form.text
        known = self._known_columns(form)
        if text not in known:
            known[text] = self.data.columns(form.effect)
        return known[text]

    def _known_columns(self, form: Candidate) -> dict[str, dict[int, Array]]:
        """Return the store in which a candidate's white columns are kept, by text."""
        if depends(form.effect):
            return self._columns_of_model
        return self._columns_of_motion

    def evidence_of(self, fit: WhiteFit, form: Candidate) -> ScoredEffect:
        """Score a candidate as an addition to a fit.

        The result holds its evidence J, its coefficients and the squares of torque that
        it explains.
        """
        return self.score.evidence_of(fit, form, self.columns(form))

    def beside(
        self, term: ScoredEffect, others: Sequence[ScoredEffect]
    ) -> ScoredEffect:
        """Score a chosen effect again, in a fit with other effects and all nuisances.

        Nuisances are columns of small errors of friction laws that are tolerated.
        """
        fit = self.score.fit(self.nuisances.with_law_misfits(others), self.fit)
        return self.score.evidence_of(fit, term.form, term.columns)

    def refined(
        self, fit: WhiteFit, start: ScoredEffect, fixed: Set[str] = frozenset()
    ) -> ScoredEffect:
        """Return a candidate with the shape constants that give it the most evidence.

        The evidence is that of adding the candidate to ``fit``. The optimisation begins
        at ``start``; the constants named in ``fixed`` keep their values.
        """
        return refine_constants(self.judge_beside(fit), start, fixed)

    def judge_beside(self, fit: WhiteFit) -> Judge:
        """Return what scores candidates as additions to a fit."""

        def drop(form: Candidate) -> float:
            """Return the drop of the deviance by a candidate."""
            return self.score.deviance_drop_of(fit, form, self.columns(form))

        return Judge(partial(self.evidence_of, fit), drop)

    # Which candidates there are beside a fit.

    def top_candidates(
        self, fit: WhiteFit, terms: Sequence[ScoredEffect]
    ) -> list[ScoredEffect]:
        """List the most promising candidates to add to a fit, the best first.

        The library is screened on its grid of shape constants, and the constants of
        promising candidates are refined. Each candidate (an effect on a joint) is
        listed with the law, its discrete variant, that has the most evidence.

        Parameters
        ----------
        fit
            The fit to which the candidates are added.
        terms
            The effects chosen already; they are no candidates again.
        """
        screened = self.screened(fit, terms, self.refused | self.barred)
        top = max((t.evidence for t in screened), default=0.0)
        # The threshold is low, since refining may raise the evidence much: a friction
        # width (say) far from the grid's values explains little there, and nearly all
        # where it is right.
        threshold = 0.5 * top - 3.0 * EVIDENCE_TO_ADD
        promising = [
            t
            for t in screened
            if threshold < t.evidence or t.form.replaces_own_constant
        ]
        ranked = [self.refined(fit, t) for t in promising]
        ranked.sort(key=lambda t: -t.evidence)
        return _best_law_of_each_candidate(ranked)

    def screened(
        self,
        fit: WhiteFit,
        terms: Sequence[ScoredEffect],
        excluded: Set[Key],
        is_tried: Callable[[Batch], bool] = lambda batch: True,
    ) -> list[ScoredEffect]:
        """Score the candidates that explain most, each law at its best grid point.

        A cheap score of all candidates (the drop of the weighted squared error less log
        N for each coefficient) chooses up to MAX_CANDIDATES_REFINED candidates. Only
        these are scored by the evidence J, each with all its laws (discrete variants).

        Parameters
        ----------
        fit
            The fit to which candidates are added.
        terms
            The effects that it holds already.
        excluded
            Keys of what is no candidate.
        is_tried
            Which batches are looked at.
        """
        # By law: cheap score, candidate at its best grid point, and white columns.
        best = dict[Hashable, tuple[float, Candidate, dict[int, Array]]]()
        picked = [t.form for t in terms]
        for batch in filter(is_tried, self.library.batches):
            scores = self.score.screened(fit, batch)
            explaining = np.flatnonzero(scores > 0.0).tolist()
            forms = [batch.forms[f] for f in explaining]
            is_allowed = may_join(forms, picked, self.data.estimate.model)
            for f, form, allowed in zip(explaining, forms, is_allowed, strict=True):
                if form.key in excluded or not allowed:
                    continue
                score = float(scores[f])
                law = form.discrete_choice
                if law not in best or score > best[law][0]:
                    best[law] = (score, form, batch.columns(f))
        ranked = sorted(best.values(), key=lambda entry: -entry[0])
        judged = []
        for form, columns in _keep_best_candidates(ranked):
            # The columns are kept for later calls of :meth:`columns`.
            self._known_columns(form).setdefault(form.text, columns)
            judged.append(self.score.evidence_of(fit, form, columns))
        return judged

    def simplest(self, ranked: Sequence[ScoredEffect]) -> ScoredEffect | None:
        """Return the simplest of the candidates that are about as good as the best one.

        "About as good" is within J = 6 (odds of 20 to 1) plus 4 % of the best one's
        evidence: laws of friction are no more accurate. All evidences use the best
        one's estimate of how many correlated rows count as one; otherwise the errors of
        these estimates would decide. Left out is a candidate that refines another one
        of these (presliding friction refines Coulomb friction, say).

        Parameters
        ----------
        ranked
            The candidates, the best first.

        Returns
        -------
        ScoredEffect or None
            The simplest one; None if there are no candidates.
        """
        if not ranked:
            return None
        best = ranked[0]
        least = best.evidence - margin(best.evidence)
        tied = [t for t in ranked if t.evidence_with_worth_of(best) > least]
        unrefined = [t for t in tied if not any(t.form.refines(u.form) for u in tied)]

        def rank(t: ScoredEffect) -> tuple[tuple[int, int, bool], float]:
            """Return the sorting key: the simplest first, then the highest evidence."""
            return simplicity(t.form), -t.evidence_with_worth_of(best)

        return min(unrefined, key=rank)

    def contradicts_itself(self, term: ScoredEffect) -> bool:
        """Return whether no model may hold an effect with these parameters.

        They exceed the effect's range (:attr:`Effect.largest_parameter`), or belong to
        another machine than its shape constants (:meth:`Effect.contradicts_itself`).
        """
        effect = term.form.effect
        if np.any(np.abs(term.beta) > effect.largest_parameter):
            return True
        inertias = self.data.rows.mean_inertias
        return effect.contradicts_itself(term.beta, float(inertias[effect.joints[0]]))

    # The steps.

    def run(self, progress: Progress = no_progress) -> list[ScoredEffect]:
        """Add and drop effects until nothing changes; return the effects.

        In each step the best candidate is added, and effects that have become weak are
        dropped. A candidate that is dropped as soon as it is added, or that leads back
        to a set of effects that the search has had before, is refused from then on.
        Effects that contradict themselves at the end are barred, and the search goes on
        without them.
        """
        known_sets = set[tuple[str, ...]]()
        # Each candidate is added and dropped once at most.
        for _ in range(3 * len(self.library.laws)):
            addition = self.best_addition()
            if addition is None:
                self.terms = self.beside_each_other()
                if self._bar_contradictions():
                    continue
                break
            progress(f"{len(self.terms) + 1}: {effect_in_words(addition.text)}")
            # One cause has one law: the general one takes the place of its special case.
            others = [t for t in self.terms if not addition.form.replaces(t.form)]
            after = self.drop_weak([*others, addition])
            keys_after = tuple(sorted(str(t.key) for t in after))
            stays = addition.key in {t.key for t in after}
            if keys_after in known_sets or not stays:
                self.refused.add(addition.key)
                continue
            self.terms = after
            known_sets.add(keys_after)
        self.fit = self.score.fit(self.terms)
        return self.terms

    def _bar_contradictions(self) -> bool:
        """Take out the effects that contradict themselves, for good; return whether
        there was one.
        """
        stand_ins = [t for t in self.terms if self.contradicts_itself(t)]
        self.barred |= {t.key for t in stand_ins}
        self.terms = [t for t in self.terms if t not in stand_ins]
        return bool(stand_ins)

    def best_addition(self) -> ScoredEffect | None:
        """Return the effect to add next, or None if no candidate has enough evidence.

        It is the simplest of the best candidates with J > EVIDENCE_TO_ADD. Candidates
        are added to a fit with the effects chosen so far and with small tolerated
        errors of these effects' laws. A law that generalises one of the model's effects
        waits if a constant of that effect explains half as much: both are laws of one cause,
        and the constants of other effects are refined beside it. A second law of that cause
        waits until the constant is re-estimated beside the first, in columns that follow it.
        """
        self.fit = self.score.fit(self.nuisances.with_law_misfits(self.terms), self.fit)
        candidates = self.top_candidates(self.fit, self.terms)

        strong = [
            t
            for t in candidates
            if t.evidence > (0.0 if self.is_refined(t.form) else EVIDENCE_TO_ADD)
        ]
        constants = [t for t in strong if t.form.replaces_own_constant]

        def waits(law: ScoredEffect) -> bool:
            """Return whether a law of the same cause as one of these constants explains
            less than twice as much."""
            return any(
                law.form.generalises(own.form)
                and own.evidence > PROMISING * law.evidence
                for own in constants
            )

        first = [t for t in strong if self.is_referred or not self._is_second(t.form)]
        self.has_waiting = len(first) < len(strong)
        return self.simplest([t for t in first if not waits(t)])

    @property
    def all_constants(self) -> list[ScoredEffect]:
        """The model's own effects with the constants that were found last."""
        found = [t for t in self.terms if t.form.replaces_own_constant]
        return [*{t.key: t for t in (*self.constants, *found)}.values()]

    def is_refined(self, own: Candidate) -> bool:
        """Return whether a finding is a finer form of one of the model's own effects."""
        return own.replaces_own_constant and any(
            t.form.refines(own) for t in self.terms
        )

    def _is_second(self, form: Candidate) -> bool:
        """Return whether a finding refines the same own effect of the model as a
        candidate, one with a constant to estimate anew."""
        joint = form.key[1]
        return any(
            t.key[1] == joint and (name, joint) in self.data.own_effects
            for t in self.terms
            for name in {*form.effect.refines} & {*t.form.effect.refines}
        )

    def drop_weak(
        self, terms: Sequence[ScoredEffect], on: Set[int] = frozenset()
    ) -> list[ScoredEffect]:
        """Drop the effects that have too little evidence once all others are in the fit.

        Effects are judged in the order of the list, the oldest first: of two that
        explain the same torque the newer one stays. An effect with J <= EVIDENCE_TO_ADD
        is dropped at once, before the next is judged. A second pass follows if anything
        has changed. The effects that stay are returned.

        Parameters
        ----------
        terms
            The chosen effects, the newest last.
        on
            Joints (from 0) on which shape constants are refined again before an effect
            is judged. Default: the joints of the newest effect.
        """
        terms = list(terms)
        if not on and terms:
            on = terms[-1].joints
        fit_of_all = self.score.fit(self.nuisances.with_law_misfits(terms), self.fit)
        for _ in range(2):
            has_changed = False
            for term in list(terms):
                others = [t for t in terms if t is not term]
                # The fit without the effect; it starts from the fit of all effects,
                # which is faster.
                around = self.nuisances.with_law_misfits(others)
                fit = self.score.fit(around, fit_of_all)
                if term.joints & on:  # at least one common joint
                    judged = self.score.evidence_of(fit, term.form, term.columns)
                    judged = self.refined(fit, judged)
                else:
                    judged = self._judged_on_other_joints(fit, term)
                if judged.evidence <= EVIDENCE_TO_ADD:
                    terms = others
                    has_changed = True
                    continue
                terms[terms.index(term)] = judged
                if judged.text != term.text:  # its shape constants have changed
                    has_changed = True
                    all_terms = self.nuisances.with_law_misfits(terms)
                    fit_of_all = self.score.fit(all_terms, fit_of_all)
            if not has_changed:
                break
        return terms

    def _judged_on_other_joints(
        self, fit: WhiteFit, term: ScoredEffect
    ) -> ScoredEffect:
        """Score an effect again after effects of other joints have changed.

        The full score is computed only if the drop of the deviance alone does not show
        that the effect stays, with three times the evidence that this takes.
        """
        if not term.form.replaces_own_constant:
            judged = self.score.with_drop_beside(fit, term)
            if judged.evidence > 3.0 * EVIDENCE_TO_ADD:
                return judged
        return self.score.evidence_of(fit, term.form, term.columns)

    def score_jointly(
        self, group: Sequence[ScoredEffect], others: Sequence[ScoredEffect]
    ) -> list[ScoredEffect]:
        """Score the effects of a group in sequence, so that their evidences add up.

        Effect i of the group is scored as an addition to ``others`` and to the effects
        0 to i - 1 of the group: torque that two of them can explain is counted once.
        """
        return [
            self.beside(term, [*others, *group[:i]]) for i, term in enumerate(group)
        ]

    def without_refuted(self) -> Search:
        """Return a copy of the search with the chosen effects judged beside each other,
        without those that the rows speak against, the one with the least evidence first.

        Beside the other findings and the present constants a finding may have no torque
        left.
        """
        out = self.with_terms(self.terms)
        while True:
            out.terms = out.beside_each_other()
            refuted = [t for t in out.terms if not t.evidence > 0.0]
            if not refuted:
                return out
            weakest = min(refuted, key=lambda t: t.evidence)
            out = out.with_terms([t for t in out.terms if t is not weakest])

    def beside_each_other(self) -> list[ScoredEffect]:
        """Return the chosen effects, each judged beside all others."""
        return [
            self.beside(term, [t for t in self.terms if t is not term])
            for term in self.terms
        ]


def _best_law_of_each_candidate(ranked: Sequence[ScoredEffect]) -> list[ScoredEffect]:
    """Keep the best law of each candidate (an effect on a joint), in the same order.

    ``ranked`` has the highest evidence first. Laws are compared with one number of
    correlated rows that count as one (:meth:`ScoredEffect.evidence_with_worth_of`).
    """
    first = dict[Key, ScoredEffect]()
    best = dict[Key, ScoredEffect]()
    for term in ranked:
        reference = first.setdefault(term.key, term)
        best_so_far = best.setdefault(term.key, term)
        evidence_so_far = best_so_far.evidence_with_worth_of(reference)
        if term.evidence_with_worth_of(reference) >= evidence_so_far:
            best[term.key] = term
    return [t for t in ranked if best[t.key] is t]


def _keep_best_candidates(
    ranked: Sequence[tuple[float, Candidate, dict[int, Array]]],
) -> list[tuple[Candidate, dict[int, Array]]]:
    """Keep the first MAX_CANDIDATES_REFINED effects of a ranking, each with all laws, and
    the model's own effects of which these are finer forms.

    Parameters
    ----------
    ranked
        Triples (cheap score, candidate, its white columns by joint), the best first; an
        effect on a joint once for each of its laws.
    """
    keys_in_order = dict.fromkeys(form.key for _, form, _ in ranked)  # each once
    best_keys = set(list(keys_in_order)[:MAX_CANDIDATES_REFINED])
    best = [form for _, form, _ in ranked if form.key in best_keys]
    best_keys |= {
        own.key
        for _, own, _ in ranked
        if own.replaces_own_constant and any(form.refines(own) for form in best)
    }
    return [(form, columns) for _, form, columns in ranked if form.key in best_keys]


def simplicity(form: Candidate) -> tuple[int, int, bool]:
    """Return a sorting key of candidates, the smallest for the simplest one: by numbers to
    estimate, joints, and whether it refines a simpler effect."""
    return (
        form.n_coefficients + form.n_constants,
        len(form.effect.joints),
        bool(form.effect.refines),
    )
