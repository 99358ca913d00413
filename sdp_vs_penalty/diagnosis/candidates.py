"""What a search can add: every candidate, its shape constants chosen, and how well it explains."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.fit import WhiteFit
from sdp_vs_penalty.diagnosis.golden_section import highest
from sdp_vs_penalty.diagnosis.library import Batch, Candidacy, Key, Library, spread_columns
from sdp_vs_penalty.diagnosis.scoring import (
    Beside,
    Scores,
    Solved,
    averaged,
    cross_validate,
    effective,
    evidence,
    passive,
    score_library,
    signed,
)
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import Noise
from sdp_vs_penalty.signals.segments import SegmentedRuns

#: How many candidates a step looks at closely, and the share of the best one's evidence that they need
#: on a coarse grid of shapes; those that are close are looked at whatever their number.
_CONTENDERS, _FAR, _CLOSE = 8, 0.3, 0.7
#: ... and how many if they are close.
MOST = 3 * _CONTENDERS
#: How often a shape constant is made as large as the effect is with it.
_SIZED = 2
#: Folds for what depends on time: every so many blocks of time.
_TIME_FOLDS = 5


@dataclass(frozen=True)
class Candidate:
    """One effect on one joint with its best shape: chi2 it takes from the scaled residual, beta (k,),
    evidence against nothing, columns : white (n M, k)."""

    key: Key
    effect: Effect
    chi2: float
    beta: Array
    evidence: float
    columns: Array

    @property
    def signed(self) -> bool:
        return signed(self.effect)


class Candidates:
    """The library on white rows, with the means to solve for, refine and cross-validate any of it; it
    is made when something of it is first asked for."""

    def __init__(self, rows: SegmentedRuns, noise: Noise, candidacy: Candidacy) -> None:
        self.rows, self.noise, self.candidacy = rows, noise, candidacy
        self.pieces = [rows.pieces(j) for j in range(rows.n)]
        self._scored: tuple[WhiteFit, Set[int] | None, Scores] | None = None
        self._coarsely: tuple[WhiteFit, Set[int] | None, Array] | None = None
        self._tuned: tuple[WhiteFit | None, dict[int, Candidate]] = None, {}
        self._columns: dict[tuple[str, int, tuple[float, ...]], Array] = {}

    @cached_property
    def white(self) -> Library:
        return self.candidacy.white(self.noise, self.rows)

    @property
    def by_key(self) -> dict[Key, list[int]]:
        """The groups of each candidate."""
        return self.candidacy.by_key

    @property
    def acting(self) -> dict[Key, frozenset[int]]:
        """The joints on which each candidate acts."""
        return self.candidacy.acting

    def eligible(self, picked: Sequence[Candidate], known: frozenset[Key]) -> list[Key]:
        """What may be added beside those ``picked`` and what the model has (``known``): nothing twice,
        a finer form only where what it refines is there."""
        keys = {h.key for h in picked if not h.effect.several}
        present = {h.key for h in picked} | known
        out = []
        for key, members in self.by_key.items():
            refines = self.white.groups[members[0]].effect.refines
            if key not in keys and (not refines or any((name, key[1]) in present for name in refines)):
                out.append(key)
        return out

    def contenders(
        self,
        fit: WhiteFit,
        scaled: Library,
        picked: Sequence[Candidate],
        known: frozenset[Key],
        most: int = MOST,
        on: Set[int] | None = None,
        only: Key | None = None,
    ) -> list[Candidate]:
        """The most plausible candidates beside those ``picked`` and what the model has (``known``),
        shapes refined, best first. most : so many at most; on : only those on these joints or several;
        only : this one alone.
        """
        plausible = self._plausible(fit, scaled, picked, known, on)
        coarse = [
            (v, key, values)
            for key, (v, values) in plausible.items()
            if (on is None or on & self.acting[key]) and (only is None or only == key)
        ]
        best = coarse[0][0] if coarse else 0.0
        close = [c for k, c in enumerate(coarse) if c[0] > (_FAR if k < _CONTENDERS else _CLOSE) * best]
        found = []
        for v, key, values in close[:most]:
            forms = (self.refined(fit, g, v) for g in self._best_forms(self.by_key[key], values))
            found.append(max(forms, key=lambda h: h.chi2))
        return sorted(found, key=lambda h: -h.evidence)

    def _plausible(
        self,
        fit: WhiteFit,
        scaled: Library,
        picked: Sequence[Candidate],
        known: frozenset[Key],
        on: Set[int] | None = None,
    ) -> dict[Key, tuple[float, Array]]:
        """Evidence on the grids of shapes, averaged and of each member, the most plausible first."""
        if self._coarsely is None or self._coarsely[0] is not fit or self._coarsely[1] != on:
            self._coarsely = fit, on, self._coarse(fit, scaled, on)
        evidence = self._coarsely[2].copy()
        evidence[[g for h in picked for g in self.candidacy.written.get(h.effect.text, ())]] = 0.0
        values = evidence[np.concatenate([np.zeros(0, np.intp), *self.by_key.values()])]
        sizes = np.array([len(members) for members in self.by_key.values()], np.intp)
        parts = np.split(values, np.cumsum(sizes)[:-1]) if len(sizes) else []
        each = dict(zip(self.by_key, zip(averaged(values, sizes), parts, strict=True), strict=True))
        found = ((key, each[key]) for key in self.eligible(picked, known))
        return dict(sorted(((k, v) for k, v in found if v[0] > 0.0), key=lambda f: -f[1][0]))

    def families(
        self, fit: WhiteFit, scaled: Library, picked: Sequence[Candidate], known: frozenset[Key]
    ) -> dict[str, dict[int, float]]:
        """By name, the evidence on each joint of the laws that act on one joint each."""
        out: dict[str, dict[int, float]] = {}
        for (name, joint), (value, _) in self._plausible(fit, scaled, picked, known).items():
            if joint is not None:
                out.setdefault(name, {})[joint] = value
        return out

    def _best_forms(self, members: Sequence[int], values: Array) -> list[int]:
        """Where to refine from: the most plausible member, and that of the next best form (the choices
        among which nothing refines), which a coarse grid may treat unfairly."""
        best: dict[tuple[float, ...], int] = {}
        for m in np.argsort(-values):
            effect = self.white.groups[members[m]].effect
            form = tuple(v for k, v in effect.shape.items() if effect.shapes[k].bounds is None)
            best.setdefault(form, int(m))
        top = float(values.max(initial=0.0))
        refines = any(s.bounds for s in self.white.groups[members[0]].effect.shapes.values())
        forms = [m for m in best.values() if values[m] > 0.5 * top][: 2 if refines else 1]
        return [members[m] for m in forms or [int(np.argmax(values))]]

    def scores(self, fit: WhiteFit, scaled: Library, on: Set[int] | None = None) -> Scores:
        """Of all groups, or of those on these joints or several; the last are kept."""
        if self._scored is None or self._scored[0] is not fit or self._scored[1] != on:
            self._scored = fit, on, score_library(fit, scaled, on)
        return self._scored[2]

    def _coarse(self, fit: WhiteFit, scaled: Library, on: Set[int] | None = None) -> Array:
        """(G,) evidence of all groups, zero of those that were not asked for; one on a single joint is
        taken to change that joint's error only."""
        scores = self.scores(fit, scaled, on)
        out = np.zeros(len(scores.chi2))
        bounded = self.candidacy.bounded
        parts = zip(scaled.batches, scores.batches, scaled.grams, bounded, strict=True)
        for batch, solved, gram, limited in parts:
            if solved is None:
                continue
            chi2, k = scores.chi2[batch.groups], batch.columns.shape[1]
            if batch.joint is None:
                out[batch.groups] = self._spread_evidence(fit, batch, gram, scores, solved)
                continue
            if k > 1:
                self._with_signs(chi2, solved, limited)
            out[batch.groups] = np.where(chi2 > k, evidence(fit.joint_gains(batch.joint, chi2), k), 0.0)
        return out

    @staticmethod
    def _with_signs(chi2: Array, solved: Solved, limited: NDArray[np.bool_]) -> None:
        """chi2 (G,) of a batch on one joint, as far as the signs of its parameters allow: what is
        plausible with the wrong signs only would stand in the way of all others."""
        for place in np.flatnonzero(np.any(limited & (solved.beta < 0.0), axis=1)):
            chi2[place] = passive(solved.gram[place], solved.pull[place])[0]

    @staticmethod
    def _spread_evidence(
        fit: WhiteFit, batch: Batch, gram: Array, scores: Scores, solved: Solved
    ) -> Array:
        """(G,) evidence of a batch that acts on several joints; gram (n, G, k, k) : of its columns."""
        k, out = batch.columns.shape[1], np.zeros(len(batch.groups))
        likely = np.flatnonzero(scores.chi2[batch.groups] > k)
        if likely.size:
            beta = solved.beta[likely]
            after = scores.spread.left(fit, batch.columns[likely], gram[:, likely], beta)
            freedom = effective(solved.gram[likely[0]], batch.known)
            out[likely] = evidence(fit.likelihood_gain(after), freedom)
        return out

    def refined(self, fit: WhiteFit, g: int, averaged: float) -> Candidate:
        """The candidate of a group, its shape constants moved to where they explain most; those of the
        last fit are kept. What a free shape costs is in ``averaged``, the evidence over the grid."""
        if self._tuned[0] is not fit:
            self._tuned = fit, {}
        if g not in self._tuned[1]:
            group = self.white.groups[g]
            columns = self.white.columns(group).reshape(len(fit.residual), -1)
            start = self.judged(fit, group.key, group.effect, columns)
            best = self.tuned(fit, start)
            self._tuned[1][g] = replace(best, evidence=best.evidence - start.evidence)
        best = self._tuned[1][g]
        return replace(best, evidence=averaged + best.evidence)

    def tuned(self, fit: WhiteFit, start: Candidate, fixed: frozenset[str] = frozenset()) -> Candidate:
        """The candidate with every continuous shape constant refined in turn, but the fixed ones."""
        best = start
        for name in start.effect.searched:
            if name not in fixed and start.effect.shapes[name].bounds is not None:
                best = self._refine_one(fit, best, name)
        if best.effect.sized_shape and best.effect.sized_shape not in fixed:
            for _ in range(_SIZED):
                best = self._as_sized(fit, best)
        return self.judged(fit, best.key, best.effect, best.columns)

    def _refine_one(self, fit: WhiteFit, start: Candidate, name: str) -> Candidate:
        robot, value = start.effect.robot, start.effect.shape[name]
        constant = start.effect.shapes[name].on(robot.joints[start.effect.joints[0]].kind)
        assert constant.bounds is not None
        low, high = constant.bounds
        if name == start.effect.beyond_turning:
            low = max(low, self.rows.segments[0].motion.width(start.effect.joints[0]))
        linear = constant.scale == "linear"
        half = 0.6 * self._spacing(start.effect, name) if linear else 0.0
        a, b = (value - half, value + half) if linear else (value / 2.2, value * 2.2)
        a, b = max(a, low), min(b, high)
        best = (start.chi2, start.effect)

        def value_at(x: float) -> float:
            nonlocal best
            effect = start.effect.with_shape(**{name: float(x if linear else np.exp(x))})
            chi2 = self._chi2(fit, effect)
            best = max(best, (chi2, effect), key=lambda found: found[0])
            return chi2

        highest(value_at, *((a, b) if linear else (np.log(a), np.log(b))))
        if best[1] is start.effect:
            return start
        return self.solve(fit, start.key, best[1], self.white_columns(best[1]))

    def _as_sized(self, fit: WhiteFit, start: Candidate) -> Candidate:
        """The candidate with the shape constant that is its size."""
        effect = start.effect
        value = effect.as_sized(float(start.beta[0]))
        if effect.shapes[effect.sized_shape].complaint(value):
            return start
        sized = effect.with_shape(**{effect.sized_shape: value})
        return self.solve(fit, start.key, sized, self.white_columns(sized))

    @staticmethod
    def _spacing(effect: Effect, name: str) -> float:
        """Between neighbours of those constants that a search starts from."""
        starts = sorted({s[name] for s in type(effect).starts(effect.robot, effect.joints[0])})
        return float(np.min(np.diff(starts))) if len(starts) > 1 else 1.0

    def _chi2(self, fit: WhiteFit, effect: Effect) -> float:
        """What an effect takes from the squared residual; one joint's from that joint's rows alone."""
        if effect.whole_robot or effect.spreads or len(effect.joints) != 1:
            return self.solve(fit, (effect.name, None), effect, self.white_columns(effect)).chi2
        joint = effect.joints[0]
        which = effect.name, joint, tuple(effect.shape.values())
        white = self._columns.get(which)
        if white is None:
            white = self.noise.whiten(self.rows.column(effect, joint), joint, self.pieces[joint])
            self._columns[which] = white
        own = {joint: fit.weighting.apply(white, joint)}
        return Beside.on(fit, own, white.shape[1]).solved(effect)[0]

    def white_columns(self, effect: Effect) -> Array:
        """(n M, k) white columns of any effect."""
        raw = spread_columns(self.rows, effect)
        white = np.stack([self.noise.whiten(raw[j], j, self.pieces[j]) for j in range(self.rows.n)])
        return white.reshape(-1, raw.shape[2])

    def solve(self, fit: WhiteFit, key: Key, effect: Effect, columns: Array) -> Candidate:
        chi2, beta = Beside.of(fit, columns).solved(effect)
        return Candidate(key, effect, chi2, beta, 0.0, columns)

    def judged(self, fit: WhiteFit, key: Key, effect: Effect, columns: Array) -> Candidate:
        beside, known = Beside.of(fit, columns), effect.plausible
        chi2, beta = beside.solved(effect)
        freedom = len(beta) if known is None else effective(beside.gram, known)
        value = float(evidence(fit.likelihood_gain(beside.left(fit, beta)), freedom))
        return Candidate(key, effect, chi2, beta, value, columns)

    def block_gains(self, fit: WhiteFit, scaled: Library, candidate: Candidate) -> Array:
        """(B,) cross-validated gains, the shape chosen anew in each fold."""
        n, M = fit.rows.n, len(fit.rows.block)
        shapes = [fit.scaled(candidate.columns)]
        members = self.by_key.get(candidate.key, [])
        if len(members) <= 12:
            shapes += [
                scaled.columns(self.white.groups[g]).reshape(n * M, -1)
                for g in members
                if self.white.groups[g].k == len(candidate.beta)
            ]
        # What follows the clock differs from run to run: it is judged between, not after, its data.
        by_time = candidate.effect.follows_clock
        fold = fit.rows.block % _TIME_FOLDS if by_time else fit.rows.fold
        return cross_validate(fit, shapes, candidate.signed, fold, candidate.effect.plausible)
