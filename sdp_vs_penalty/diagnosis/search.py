"""The search: terms are added, exchanged and dropped while the score says so."""

from __future__ import annotations

from collections.abc import Hashable, Sequence, Set
from copy import copy
from dataclasses import replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.candidates import STEPS, Candidate, Key, Library, may_join
from sdp_vs_penalty.diagnosis.constants import (
    EVIDENCE_TO_ADD,
    EVIDENCE_TO_DISTINGUISH,
    LAW_TOLERANCE,
    MAX_CANDIDATES_REFINED,
)
from sdp_vs_penalty.diagnosis.nuisances import Nuisance, law_misfit_columns
from sdp_vs_penalty.diagnosis.remaining import least_squares_refit
from sdp_vs_penalty.diagnosis.score import EvidenceScorer, ScoredEffect, WhiteFit
from sdp_vs_penalty.diagnosis.whitening import WhiteData, whitened, with_estimate
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.shapes import ShapeEstimate, at_end
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.robot.arrays import Array

#: Times that a constant that is as large as its effect follows it: what is left of an
#: error falls by the share of the effect that is not of first order, a quarter for the
#: softest gears.
_SIZED = 3


class Search:
    """Forward selection with exchange over one library; afterwards ``terms`` and
    ``fit``."""

    def __init__(self, data: WhiteData, library: Library) -> None:
        self.data = data
        self.library = library
        self.score = EvidenceScorer(data, len(library.laws), library.laws)
        self._kept: dict[str, dict[int, Array]] = {}
        self._distorted: dict[str, list[tuple[int, Array, Array]]] = {}
        self.terms: list[ScoredEffect] = []
        #: Candidates that had not enough left once they had joined.
        self.refused = set[Key]()
        #: Terms that are part of the torque to which columns refer.
        self.in_reference = set[Key]()
        self.fit = self.bare = self.score.fit(())

    # What a form is worth.

    def columns(self, form: Candidate) -> dict[int, Array]:
        """White columns by joint; kept while the search lasts."""
        text = form.effect.text
        if text not in self._kept:
            self._kept[text] = self.data.columns(form.effect)
        return self._kept[text]

    def evidence_of(self, fit: WhiteFit, form: Candidate) -> ScoredEffect:
        return self.score.evidence_of(fit, form, self.columns(form))

    def beside(
        self, term: ScoredEffect, others: Sequence[ScoredEffect]
    ) -> ScoredEffect:
        """A term judged anew beside others, with the rivals that it had."""
        fit = self.score.fit(self.with_nuisances(term, others), self.fit)
        return replace(
            self.score.evidence_of(fit, term.form, term.columns), rivals=term.rivals
        )

    def refined(
        self, fit: WhiteFit, start: ScoredEffect, fixed: Set[str] = frozenset()
    ) -> ScoredEffect:
        """Each continuous shape constant but the fixed ones in turn where the score is
        highest, on a lattice of its scale: the same values come back in every step of
        the search."""
        best = start
        for name in start.form.effect.searched:
            if name not in fixed:
                best = self._along(fit, best, name)
        sized = best.form.effect.sized_shape
        # A constant that is as large as its effect, such as a delay's, is made so.
        for _ in range(
            _SIZED if sized and sized not in fixed and len(best.beta) else 0
        ):
            effect = best.form.effect
            value = float(f"{effect.as_sized(float(best.beta[0])):.6g}")
            if effect.shapes[sized].complaint(value):
                break
            best = self.evidence_of(fit, best.form.with_shape(**{sized: value}))
        return best

    def _along(self, fit: WhiteFit, start: ScoredEffect, name: str) -> ScoredEffect:
        effect = start.form.effect
        shape = effect.shapes[name].on(effect.robot.joints[effect.joints[0]].kind)
        if shape.bounds is None:
            return start
        low, high = start.form.bounds(name) or shape.bounds
        linear = shape.scale == "linear"
        there, back = (float, float) if linear else (np.log, np.exp)
        starts = type(effect).starts(effect.robot, effect.joints[0])
        u = there(effect.shape[name])
        grid = sorted({float(there(s[name])) for s in starts if name in s})
        spacing = (
            np.min(np.diff(grid))
            if len(grid) > 1
            else abs(u) + 1e-3
            if linear
            else np.log(2.0)
        )
        terms_by_step = {0.0: start}

        def at(x: float) -> ScoredEffect:
            if x not in terms_by_step:
                value = float(f"{back(u + x * spacing):.6g}")
                if low <= value <= high:
                    terms_by_step[x] = self.evidence_of(
                        fit, start.form.with_shape(**{name: value})
                    )
                else:
                    terms_by_step[x] = replace(start, drop=-np.inf)
            return terms_by_step[x]

        def score(x: float) -> float:
            return at(x).evidence_with_worth_of(start)

        x = step = 0.0
        for step in STEPS:
            while (best := max((x, x - step, x + step), key=score)) != x:
                x = best
        less = score(x + -step)
        middle = score(x + 0.0)
        more = score(x + step)
        if less - 2.0 * middle + more < 0.0 and np.isfinite(
            less + more
        ):  # the top of a parabola
            top = 0.5 * (less - more) / (less - 2.0 * middle + more)
            x = max((x, x + step * round(16.0 * top) / 16.0), key=score)
        return at(x)

    # Which forms there are beside a fit.

    def with_misfits(
        self, terms: Sequence[ScoredEffect]
    ) -> list[ScoredEffect | Nuisance]:
        """Terms, and what the laws of those that explain much may get wrong."""
        return [
            *terms,
            *(
                m
                for t in terms
                if LAW_TOLERANCE * t.evidence > EVIDENCE_TO_DISTINGUISH
                for m in self.misfits(t)
            ),
        ]

    def with_nuisances(
        self, term: ScoredEffect, others: Sequence[ScoredEffect]
    ) -> list[ScoredEffect | Nuisance]:
        """Beside what a term has to show: others, what their laws get wrong, and what
        is tolerated."""
        return [*self.with_misfits(others), *self.tolerated(term, others)]

    def tolerated(
        self, term: ScoredEffect, others: Sequence[ScoredEffect]
    ) -> list[Nuisance]:
        """As much of what is in every machine as is plausible, where neither says it."""
        named_effects = {
            term.form.effect.form_of,
            term.key[0],
            *(t.key[0] for t in others),
        }
        return [m for name, m in self.tolerances.items() if name not in named_effects]

    @cached_property
    def tolerances(self) -> dict[str, Nuisance]:
        forms = (f for b in self.library.batches for f in b.forms if f.effect.tolerance)
        return {
            f.key[0]: Nuisance(f"misfit of {f.key[0]}", self.columns(f), f.plausible)
            for f in forms
        }

    def misfits(self, term: ScoredEffect) -> list[Nuisance]:
        """By joint; none of another constant of the model's own effect."""
        if term.form.replaces_own_constant:
            return []
        if term.text not in self._distorted:
            columns = law_misfit_columns(self.data, term.form.effect, term.beta)
            self._distorted[term.text] = [
                (j, z, self._beyond_model({j: z})) for j, z in columns.items()
            ]
        expected = LAW_TOLERANCE * np.maximum(term.squares, 1e-200)
        return [
            Nuisance(
                f"misfit of {term.text} on {j}",
                {j: z},
                np.sqrt(expected[j] / len(s) / s),
            )
            for j, z, s in self._distorted[term.text]
        ]

    def _beyond_model(self, columns: dict[int, Array]) -> Array:
        """(k,) squares of what the model leaves of white columns."""
        T = (
            self.bare.residual_of(self.bare.scaled(columns))
            * self.bare.level[:, None, None]
        )
        return np.maximum(np.sum(T**2, axis=(0, 1)), 1e-200)

    def top_candidates(
        self,
        fit: WhiteFit,
        terms: Sequence[ScoredEffect],
        on: frozenset[int] | None = None,
        beyond: float = 0.0,
        exact_joints: bool = False,
    ) -> list[ScoredEffect]:
        """The most likely form of each candidate, refined, the best first; on : some of
        whose joints, or all of them and no others (``exact_joints``); beyond : what has to be
        reached, nearly, to be of use."""
        terms_found = self._screened(fit, [t.form for t in terms], on, exact_joints)
        top = max((t.evidence for t in terms_found), default=0.0)
        # A width that is far from those on the grid says little there, and all where it
        # is right.
        threshold = 0.5 * max(top, beyond) - 3.0 * EVIDENCE_TO_ADD
        useful = (
            t
            for t in terms_found
            if threshold < t.evidence or t.form.replaces_own_constant
        )
        ranked = sorted(
            (self.refined(fit, t) for t in useful), key=lambda t: -t.evidence
        )
        first = {t.key: t for t in reversed(ranked)}
        best = {
            t.key: t
            for t in sorted(
                ranked, key=lambda t: t.evidence_with_worth_of(first[t.key])
            )
        }
        return [t for t in ranked if best[t.key] is t]

    def _screened(
        self,
        fit: WhiteFit,
        picked: Sequence[Candidate],
        on: frozenset[int] | None,
        exact_joints: bool,
    ) -> list[ScoredEffect]:
        """The best form of each law on the grids, of so many candidates that take most."""
        best: dict[tuple[Hashable, ...], tuple[float, Candidate, dict[int, Array]]] = {}
        for batch in self.library.batches:
            joints = frozenset(batch.joints)
            if on is not None and not (on == joints if exact_joints else on & joints):
                continue
            values = self.score.screened(fit, batch)
            free = may_join(batch.forms, picked, self.data.estimate.model)
            for f in np.argsort(-values)[: np.count_nonzero(values > 0.0)]:
                form = batch.forms[f]
                if on is None and form.key in self.refused:
                    continue
                if free[f] and values[f] > best.get(form.discrete_choice, (0.0,))[0]:
                    best[form.discrete_choice] = (
                        float(values[f]),
                        form,
                        batch.columns(int(f)),
                    )
        ranked = sorted(best.values(), key=lambda b: -b[0])
        close = list(dict.fromkeys(form.key for _, form, _ in ranked))[
            :MAX_CANDIDATES_REFINED
        ]
        forms_found = [(form, z) for _, form, z in ranked if form.key in close]
        for form, columns in forms_found:
            self._kept.setdefault(form.effect.text, columns)
        return [
            self.score.evidence_of(fit, form, columns) for form, columns in forms_found
        ]

    @staticmethod
    def simplest(ranked: Sequence[ScoredEffect]) -> ScoredEffect | None:
        """Of terms, the best first, the simplest that is as good as the best."""
        if not ranked:
            return None
        best = ranked[0]
        margin = EVIDENCE_TO_DISTINGUISH + LAW_TOLERANCE * ranked[0].evidence
        tied = [
            t for t in ranked if best.evidence - t.evidence_with_worth_of(best) < margin
        ]
        plain = [t for t in tied if not any(t.form.refines(u.form) for u in tied)]
        return min(
            plain, key=lambda t: (simplicity(t.form), -t.evidence_with_worth_of(best))
        )

    # The steps.

    def refine_and_drop(
        self, terms: Sequence[ScoredEffect], on: Set[int] = frozenset()
    ) -> list[ScoredEffect]:
        """The constants of each term on such joints (default: the newest one's) again
        beside all others; a term that has not enough left goes."""
        terms = list(terms)
        newest = on or (terms[-1].joints if terms else frozenset[int]())
        full = self.score.fit(self.with_misfits(terms), self.fit)
        for _ in range(2):
            moved = False
            for term in list(terms):
                others = [t for t in terms if t != term]
                fit = self.score.fit(self.with_nuisances(term, others), full)
                again = self.score.evidence_of(fit, term.form, term.columns)
                if term.joints & newest:
                    again = self.refined(fit, again)
                if again.evidence <= EVIDENCE_TO_ADD:
                    terms = others
                    moved = True
                    continue
                if again.text != term.text:
                    moved = True
                terms[terms.index(term)] = replace(again, rivals=term.rivals)
                if again.text != term.text:
                    full = self.score.fit(self.with_misfits(terms), full)
            if not moved:
                break
        return terms

    def score_jointly(
        self, group: Sequence[ScoredEffect], other_terms: Sequence[ScoredEffect]
    ) -> list[ScoredEffect]:
        """Terms judged together: each beside the rest and those before it."""
        return [self.beside(g, [*other_terms, *group[:i]]) for i, g in enumerate(group)]

    def exchange_one(self, terms: Sequence[ScoredEffect]) -> list[ScoredEffect] | None:
        """One term for another where that is as good and simpler, or better, or one for
        several; else None, and every term knows its rivals."""
        with_rivals = []
        for group in [*([t] for t in terms), *self.mergeable_groups(terms)]:
            other_terms = [t for t in terms if t not in group]
            on = frozenset[int]().union(*(t.joints for t in group))
            fit = self.score.fit(self.with_nuisances(group[0], other_terms), self.fit)
            judged = self.score_jointly(group, other_terms)
            J = sum(t.evidence for t in judged)
            now = judged[0]
            candidates_found = self.top_candidates(
                fit, other_terms, on, J, exact_joints=len(group) > 1
            )
            if self.in_reference.issuperset(
                t.key for t in group
            ):  # they would explain themselves
                candidates_found = [
                    t for t in candidates_found if not t.form.effect.needs_torque
                ]
            if len(group) == 1:
                with_rivals.append(
                    replace(now, rivals=self.equivalent(now, candidates_found))
                )
            other = self.simplest(
                [t for t in candidates_found if t.evidence > EVIDENCE_TO_ADD]
            )
            if other is None or other.key in {t.key for t in group}:
                continue
            old = group[0].form
            margin = EVIDENCE_TO_ADD + LAW_TOLERANCE * max(J, 0.0)
            its = (
                other.evidence if len(group) > 1 else other.evidence_with_worth_of(now)
            )
            ranks = (simplicity(other.form), -its), (simplicity(old), -J)
            simpler = len(group) > 1 or (
                not other.form.refines(old) and ranks[0] < ranks[1]
            )
            if J + margin < its or (
                J - margin < its and (simpler or old.refines(other.form))
            ):
                after = self.refine_and_drop([*other_terms, other])
                if any(
                    t.key == other.key for t in after
                ):  # beside what is tolerated, too
                    return after
        self.terms = with_rivals
        return None

    def mergeable_groups(
        self, terms: Sequence[ScoredEffect]
    ) -> list[list[ScoredEffect]]:
        """Groups of terms of one effect that may be one candidate that acts on all of
        their joints."""
        sets = {frozenset(b.joints) for b in self.library.batches if len(b.joints) > 1}
        out = list[list[ScoredEffect]]()
        for name in dict.fromkeys(t.key[0] for t in terms):
            same = [
                t
                for t in terms
                if t.key[0] == name and not t.form.replaces_own_constant
            ]
            groups = [*combinations(same, 2), *([same] if len(same) > 2 else [])]
            out += [
                list(g)
                for g in groups
                if frozenset().union(*(t.joints for t in g)) in sets
            ]
        return out

    @staticmethod
    def equivalent(
        term: ScoredEffect, candidates_found: Sequence[ScoredEffect]
    ) -> tuple[ScoredEffect, ...]:
        """The forms that these rows do not tell from a term."""
        near = (
            t
            for t in candidates_found
            if t.key != term.key and not t.form.replaces_own_constant
        )
        return tuple(
            t
            for t in near
            if t.evidence_with_worth_of(term) > term.evidence - EVIDENCE_TO_DISTINGUISH
        )

    def run(self, progress: Progress = no_progress) -> list[ScoredEffect]:
        """Add, exchange, drop until nothing changes."""
        states_before = set[tuple[str, ...]]()
        for _ in range(
            3 * len(self.library.laws)
        ):  # each joins, gives way and goes once at most
            self.fit = self.score.fit(self.with_misfits(self.terms), self.fit)
            candidates_found = self.top_candidates(self.fit, self.terms)
            best = self.simplest(
                [t for t in candidates_found if t.evidence > EVIDENCE_TO_ADD]
            )
            if best is not None:
                progress(f"{len(self.terms) + 1}: {best.form.effect.text}")
            after = (
                self.refine_and_drop([*self.terms, best])
                if best
                else self.exchange_one(self.terms)
            )
            if after is None:
                break
            state = tuple(sorted(str(t.key) for t in after))
            if best is not None and (
                state in states_before or all(t.key != best.key for t in after)
            ):
                self.refused.add(best.key)
                continue
            self.terms = after
            if state in states_before:
                break
            states_before.add(state)
        self.fit = self.score.fit(self.terms)
        return self.terms

    # The same search beside something else.

    def beside_model(
        self,
        estimate: Estimate,
        without: NDArray[np.bool_] | None = None,
        thetas: Sequence[Array] = (),
    ) -> Search:
        """The same findings beside another model, in the columns that this one makes;
        without : rows (M, n) that are no evidence; thetas : the terms' parameters
        beside it, if not their own."""
        data = self.data
        pairs = zip(self.terms, thetas or [t.beta for t in self.terms], strict=True)
        terms_with_torque = [
            (t, theta) for t, theta in pairs if not t.form.effect.needs_torque
        ]
        rows = with_estimate(
            data.rows,
            estimate,
            [(t.form.effect, theta) for t, theta in terms_with_torque],
        )
        if without is not None:
            rows = replace(
                rows, masked=rows.masked | without if rows.masked.size else without
            )
        data = whitened(rows, data.noise, estimate, data.frozen)
        out = Search(data, self.library)
        out.in_reference = {t.key for t, _ in terms_with_torque}
        out.terms = [
            replace(t, columns=data.columns(t.form.effect)) for t in self.terms
        ]
        out.fit = out.score.fit(out.terms)
        return out

    @property
    def delays_torque(self) -> bool:
        """Whether something makes torque late, a term or the model: all of it, also
        what terms make."""
        effects = [
            *(t.form.effect for t in self.terms),
            *self.data.estimate.model.effects,
        ]
        return bool(self.terms) and any(
            e.needs_torque and e.has_memory for e in effects
        )

    def refer_to_current_model(self) -> Search:
        """The same findings in columns that refer to the model beside them (a step of
        Gauss and Newton): to its parameters there, and to their torque. Fitted without
        them it has taken a part of that; of play in a gear 14 % of the size were left
        out."""
        data = self.data
        estimate = self.data.estimate
        theta = least_squares_refit(data, [t.form.effect for t in self.terms])[0]
        ends = data.raw.shape[2] + np.cumsum(
            [0, *(t.form.n_coefficients for t in self.terms)]
        )
        own_theta, *thetas = np.split(theta, ends[:-1])
        return self.beside_model(
            estimate if data.frozen else replace(estimate, theta=own_theta),
            thetas=thetas,
        )

    def drop_disfavoured(self, terms: Sequence[ScoredEffect]) -> Search:
        """The search with some of its terms only, each judged beside those; where there
        is evidence against some, the one against which it is most goes, and the rest is
        judged again."""
        out = copy(self)
        while True:
            out.fit = out.score.fit(out.with_misfits(terms), self.fit)
            out.terms = [out.beside(t, [x for x in terms if x != t]) for t in terms]
            weakest = min(out.terms, key=lambda t: t.evidence, default=None)
            if weakest is None or weakest.evidence > 0.0:
                break
            terms = [t for t in out.terms if t is not weakest]
        out.fit = out.score.fit(out.terms)
        return out


def changed(own_terms: Sequence[ScoredEffect], model: Model) -> list[ShapeEstimate]:
    """The constants of terms that stand in the place of a model's own effects, beside
    the model's."""
    out = []
    for t in own_terms:
        (joint,), new = t.joints, t.form.effect
        old = next(e for e in model.effects if e.name == new.name and joint in e.joints)
        for key in (k for k in new.estimated if new.shape[k] != old.shape[k]):
            value = new.shape[key]
            ends = np.log(t.form.bounds(key) or (0.0, np.inf))
            end = at_end(float(np.log(value)), *ends.tolist())
            out.append(
                ShapeEstimate(
                    new.name,
                    joint,
                    key,
                    old.shape[key],
                    value,
                    gain=t.evidence,
                    at_end=end,
                )
            )
    return out


def simplicity(form: Candidate) -> tuple[int, int, bool]:
    """Fewest constants, fewest joints, what refines nothing else."""
    return (
        form.n_coefficients + form.constants,
        len(form.effect.joints),
        bool(form.effect.refines),
    )
