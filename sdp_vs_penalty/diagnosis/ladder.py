"""The search: add the best hypothesis, refine its shape, re-examine earlier ones, repeat.

A hypothesis is an effect on a joint. It is added only if all of these hold:

- the F test's p is below FALSE_CLAIM divided by the number of columns that were searched;
- its block-robust Wald statistic exceeds the 99th percentile of the library's maximum when the signs
  of the blocks are drawn at random;
- its cross-validated gain is above MIN_GAIN (in units of white chi-square) and above MIN_SHARE of
  the excess over the noise at the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from sdp_vs_penalty.diagnosis.library import Group, Key, Library, spread_columns
from sdp_vs_penalty.diagnosis.rows import DiagnosisRows
from sdp_vs_penalty.diagnosis.scoring import (
    BlockSums,
    Fit,
    Scores,
    cross_validate,
    evidence,
    flip_threshold,
    score_library,
    solve_group,
    wald_exponent,
)
from sdp_vs_penalty.diagnosis.whitening import Noise, pieces_of
from sdp_vs_penalty.effects.effect import Effect

Array = NDArray[np.float64]

FALSE_CLAIM = 2e-3
MIN_GAIN = 15.0
MIN_SHARE = 0.004
#: Evidence (twice a log Bayes factor, per unit of residual variance) by which a rival must fall
#: short to be told apart: odds of 150 to 1.
TOLD_APART = 10.0
#: How many hypotheses a step looks at closely, and how many steps there are at most.
_CONTENDERS = 8
_STEPS = 40


@dataclass(frozen=True)
class Hypothesis:
    """One effect on one joint with its best shape: chi2 it takes from the residual, beta (k,),
    evidence against nothing, columns : white (n M, k)."""

    key: Key
    effect: Effect
    chi2: float
    beta: Array
    evidence: float
    columns: Array

    @property
    def signed(self) -> bool:
        return len(self.beta) == 1 and self.effect.parameters[0].lower == 0.0


@dataclass(frozen=True)
class Pick:
    """A hypothesis that was added; gain : its cross-validated gain; exponent : of its Wald test;
    rivals : hypotheses that it could not be told apart from when it was added."""

    hypothesis: Hypothesis
    gain: float
    exponent: float
    rivals: tuple[Hypothesis, ...]


class Search:
    """The ladder's state; one instance a diagnosis (or an outer fold of one)."""

    def __init__(
        self, rows: DiagnosisRows, noise: Noise, base: Fit, library: Library, white: Library, seed: int
    ) -> None:
        self.rows, self.noise, self.base, self.white, self.seed = rows, noise, base, white, seed
        self.pieces = [pieces_of(rows, j) for j in range(rows.n)]
        self.picks: list[Pick] = []
        self.start_excess = self._excess(base)
        self.by_key: dict[Key, list[int]] = {}
        for g, group in enumerate(library.groups):
            self.by_key.setdefault(group.key, []).append(g)

    def _excess(self, fit: Fit) -> float:
        return float(np.maximum(fit.joint_chi2 - fit.degrees, 0.0).sum())

    def fit(self, without: int | None = None) -> Fit:
        """The model with the picks so far, all of them or all but one."""
        out = self.base
        for k, pick in enumerate(self.picks):
            if k != without:
                out = out.extended(pick.hypothesis.columns)
        return out

    def run(self) -> list[Pick]:
        """Add until nothing more is justified."""
        for _ in range(_STEPS):
            fit = self.fit()
            pick = self.next(fit)
            if pick is None:
                break
            self.picks.append(pick)
            if len(self.picks) > 1:
                self.reexamine()
        return self.picks

    def next(self, fit: Fit) -> Pick | None:
        """The best acceptable hypothesis, with what it cannot be told apart from."""
        scores = score_library(fit, self.white)
        contenders = self.contenders(fit, scores)
        if not contenders:
            return None
        threshold = flip_threshold(fit, self.white, self.seed + len(self.picks))
        for hypothesis in contenders[:3]:
            pick = self.accepted(fit, hypothesis, threshold)
            if pick is not None:
                return replace(pick, rivals=self.rivals(fit, hypothesis, contenders))
        return None

    def accepted(self, fit: Fit, hypothesis: Hypothesis, threshold: float) -> Pick | None:
        """The pick, if the hypothesis passes every test."""
        k = len(hypothesis.beta)
        rest = self._scale(fit, hypothesis)
        freedom = self._degrees(fit, hypothesis)
        p = stats.f.sf(hypothesis.chi2 / k / rest, k, freedom)
        if not p < FALSE_CLAIM / max(self.white.size, 1):
            return None
        sums = BlockSums.of(fit, fit.partialled(hypothesis.columns), k)
        exponent = float(wald_exponent(sums)[0, 0])
        if exponent < threshold:
            return None
        gain = self.gain(fit, hypothesis)
        if gain < MIN_GAIN or gain < MIN_SHARE * self.start_excess:
            return None
        return Pick(hypothesis, gain, exponent, ())

    def gain(self, fit: Fit, hypothesis: Hypothesis) -> float:
        """Cross-validated gain, the shape chosen anew in each fold."""
        return float(self.block_gains(fit, hypothesis).sum())

    def block_gains(self, fit: Fit, hypothesis: Hypothesis) -> Array:
        n, M = fit.rows.n, len(fit.rows.block)
        shapes = [hypothesis.columns]
        for g in self.by_key.get(hypothesis.key, ()):
            group = self.white.groups[g]
            if group.k == len(hypothesis.beta) and len(self.by_key[hypothesis.key]) <= 12:
                shapes.append(self.white.columns(group).reshape(n * M, -1))
        return cross_validate(fit, shapes, hypothesis.signed)

    def contenders(self, fit: Fit, scores: Scores) -> list[Hypothesis]:
        """The most plausible hypotheses, shapes refined, best first."""
        taken = {p.hypothesis.effect.text for p in self.picks}
        keys = {p.hypothesis.key for p in self.picks if p.hypothesis.key[0] not in _SEVERAL}
        coarse: list[tuple[float, Key, int]] = []
        for key, members in self.by_key.items():
            if key in keys:
                continue
            values = np.array([evidence(scores.chi2[g], self.white.groups[g].k) for g in members], float)
            usable = [self.white.groups[g].effect.text not in taken for g in members]
            values = np.where(usable, values, 0.0)
            best = int(np.argmax(values))
            coarse.append((_averaged(values), key, members[best]))
        coarse.sort(key=lambda item: -item[0])
        coarse = [c for c in coarse if c[0] > 0.0][: 3 * _CONTENDERS]
        if not coarse:
            return []
        out = []
        for value, key, g in coarse[:_CONTENDERS] + [
            c for c in coarse[_CONTENDERS:] if c[0] > 0.7 * coarse[0][0]
        ]:
            out.append(self.refined(fit, self.white.groups[g], key, value))
        return sorted(out, key=lambda h: -h.evidence)

    def refined(self, fit: Fit, group: Group, key: Key, grid_evidence: float) -> Hypothesis:
        """The hypothesis with its shape constants moved to where they explain most."""
        columns = self.white.columns(group).reshape(len(fit.residual), -1)
        best = self._hypothesis(fit, key, group.effect, columns)
        coarse = float(evidence(best.chi2, group.k))
        names = [
            k
            for k in group.effect.shape_bounds
            if k in group.effect.shape and not (k == "T" and group.effect.shape.get("form", 0) % 2)
        ]
        for name in names:
            best = self._refine_one(fit, key, best, name)
        fine = float(evidence(best.chi2, group.k))
        return replace(best, evidence=grid_evidence + fine - coarse)

    def _refine_one(self, fit: Fit, key: Key, start: Hypothesis, name: str) -> Hypothesis:
        low, high = start.effect.shape_bounds[name]
        value = start.effect.shape[name]
        linear = name == "k"
        a, b = (value - 0.6, value + 0.6) if linear else (value / 2.2, value * 2.2)
        a, b = max(a, low), min(b, high)
        found = {value: start}

        def loss(x: float) -> float:
            shape = float(x if linear else np.exp(x))
            effect = self._with_shape(start.effect, name, shape)
            found[shape] = self._hypothesis(fit, key, effect, self.white_columns(effect))
            return -found[shape].chi2

        bounds = (a, b) if linear else (np.log(a), np.log(b))
        optimize.minimize_scalar(
            loss, bounds=bounds, method="bounded", options={"xatol": 0.01, "maxiter": 14}
        )
        return max(found.values(), key=lambda h: h.chi2)

    @staticmethod
    def _with_shape(effect: Effect, name: str, value: float) -> Effect:
        return type(effect)(effect.robot, effect.asked_joints, **{**effect.shape, name: value})

    def white_columns(self, effect: Effect) -> Array:
        """(n M, k) white columns of any effect."""
        raw = spread_columns(self.rows, effect)
        white = np.stack([self.noise.whiten(raw[j], j, self.pieces[j]) for j in range(self.rows.n)])
        return white.reshape(-1, raw.shape[2])

    def _hypothesis(self, fit: Fit, key: Key, effect: Effect, columns: Array) -> Hypothesis:
        C = fit.Q.T @ columns
        signed = columns.shape[1] == 1 and effect.parameters[0].lower == 0.0
        chi2, beta, _ = solve_group(
            columns.T @ columns - C.T @ C,
            np.sum(columns**2, axis=0),
            columns.T @ fit.residual,
            signed,
        )
        return Hypothesis(key, effect, chi2, beta, float(evidence(chi2, len(beta))), columns)

    def rivals(
        self, fit: Fit, chosen: Hypothesis, contenders: Sequence[Hypothesis]
    ) -> tuple[Hypothesis, ...]:
        """Other hypotheses of nearly the same evidence, in units of what remains unexplained."""
        limit = TOLD_APART * self._scale(fit, chosen)
        return tuple(
            h
            for h in contenders
            if h.key != chosen.key and h.evidence > 0.0 and chosen.evidence - h.evidence < limit
        )

    def _joints(self, fit: Fit, hypothesis: Hypothesis) -> NDArray[np.intp]:
        return np.flatnonzero(fit.rows.joint_sums(np.sum(hypothesis.columns**2, axis=1)) > 0.0)

    def _degrees(self, fit: Fit, hypothesis: Hypothesis) -> float:
        joints = self._joints(fit, hypothesis)
        return float(max(fit.degrees[joints].sum() - len(hypothesis.beta), 1.0))

    def _scale(self, fit: Fit, hypothesis: Hypothesis) -> float:
        """Residual variance (1: noise alone) where the hypothesis acts, once it is added."""
        joints = self._joints(fit, hypothesis)
        left = fit.joint_chi2[joints].sum() - hypothesis.chi2
        return float(max(left / self._degrees(fit, hypothesis), 1.0))

    def reexamine(self) -> None:
        """Drop picks that have become useless, exchange those that something else explains better."""
        for k in reversed(range(len(self.picks))):
            pick = self.picks[k]
            fit = self.fit(without=k)
            again = self._hypothesis(
                fit, pick.hypothesis.key, pick.hypothesis.effect, pick.hypothesis.columns
            )
            if self.gain(fit, again) < MIN_GAIN:
                del self.picks[k]
                continue
            group = Group(again.key, again.effect, None, slice(0, len(again.beta)))
            tuned = again
            for name in group.effect.shape_bounds:
                if not (name == "T" and again.effect.shape.get("form", 0) % 2):
                    tuned = self._refine_one(fit, again.key, tuned, name)
            others = self.picks[:k] + self.picks[k + 1 :]
            kept, self.picks = self.picks, others
            scores = score_library(fit, self.white)
            contenders = self.contenders(fit, scores)
            self.picks = kept
            best = contenders[0] if contenders else tuned
            same = next((h for h in contenders if h.key == again.key), None)
            own = max(tuned.evidence, -np.inf) if same is None else same.evidence
            if best.key != again.key and best.evidence > own + TOLD_APART * self._scale(fit, best):
                chosen = best
            else:
                chosen = replace(tuned, evidence=own)
            self.picks[k] = replace(
                pick,
                hypothesis=chosen,
                gain=self.gain(fit, chosen),
                rivals=self.rivals(fit, chosen, contenders),
            )


_SEVERAL = frozenset({"torque_ripple", "joint_coupling"})


def _averaged(values: Array) -> float:
    """2 log of the mean Bayes factor over shapes: what a free shape constant costs is built in."""
    top = float(values.max(initial=0.0))
    return top + 2.0 * float(np.log(np.mean(np.exp(0.5 * (values - top)))))
