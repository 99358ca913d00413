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
from scipy import stats

from sdp_vs_penalty.diagnosis.block_test import BlockSums, flip_threshold, wald_exponent
from sdp_vs_penalty.diagnosis.candidates import Candidates, Hypothesis
from sdp_vs_penalty.diagnosis.fit import Fit, Rows, Weighting, independent
from sdp_vs_penalty.diagnosis.library import Key, Library
from sdp_vs_penalty.diagnosis.rows import DiagnosisRows
from sdp_vs_penalty.signals.autoregression import ORDER, autoregression
from sdp_vs_penalty.signals.noise import Noise

Array = NDArray[np.float64]

FALSE_CLAIM = 2e-3
MIN_GAIN = 15.0
MIN_SHARE = 0.004
#: Evidence (twice a log Bayes factor, per unit of residual variance) by which a rival must fall
#: short to be told apart: odds of 150 to 1.
TOLD_APART = 10.0
#: Residual variance over that of the noise from which the evidence is not taken at its word.
MISFIT = 1.3
#: How many hypotheses a step tries to add, how many steps there are.
_TRIES = 3
_STEPS = 40


@dataclass(frozen=True)
class Pick:
    """A hypothesis that was added; gain : its cross-validated gain; exponent : of its Wald test;
    rivals : hypotheses that it could not be told apart from when it was added."""

    hypothesis: Hypothesis
    gain: float
    exponent: float
    rivals: tuple[Hypothesis, ...]


class Search:
    """The ladder's state; one instance a diagnosis (or an outer fold of one).

    base (n M, p) and target (n M,) : white columns of the model and the white residual; known :
    effects that the model has, by joint.
    """

    def __init__(
        self,
        rows: DiagnosisRows,
        noise: Noise,
        labels: Rows,
        base: Array,
        target: Array,
        white: Library,
        known: frozenset[Key],
        seed: int,
    ) -> None:
        self.rows, self.noise, self.labels, self.seed = rows, noise, labels, seed
        self.basis, self.target, self.white = independent(base), target, white
        self.candidates, self.known = Candidates(rows, noise, white), known
        self.picks: list[Pick] = []
        n = rows.n
        inner = [[p[ORDER:] for p in one if len(p) > 2 * ORDER] for one in self.candidates.pieces]
        self.weighting = Weighting(np.ones(n), np.zeros((n, ORDER)), tuple(map(tuple, inner)))
        self.settle()

    def settle(self) -> None:
        """Bring the joints' levels and everything that depends on them up to date with the picks."""
        for _ in range(2):
            fit = self.fit(base=self._base(self.weighting))
            level = np.sqrt(np.maximum(fit.joint_chi2 / fit.degrees, 1.0))
            self.weighting = replace(self.weighting, level=level)
        self.base = self._base(self.weighting)
        self.scaled = self.weighting.library(self.white)

    def _base(self, weighting: Weighting) -> Fit:
        return Fit.of(self.labels, self.basis, self.target, weighting)

    def fit(self, without: int | None = None, base: Fit | None = None) -> Fit:
        """The model with the picks so far, all of them or all but one."""
        out = self.base if base is None else base
        for k, pick in enumerate(self.picks):
            if k != without:
                out = out.extended(out.scaled(pick.hypothesis.columns))
        return out

    def coloured(self, best: Hypothesis | None = None) -> tuple[Fit, Library]:
        """Fit and library with the colour taken out of the error that stays unexplained even with the
        ``best`` hypothesis so far."""
        fit = self.fit()
        if best is not None:
            fit = fit.extended(fit.scaled(best.columns))
        n = self.rows.n
        white = fit.residual.reshape(n, -1) * self.weighting.level[:, None]
        colour = np.zeros((n, ORDER))
        for j in range(n):
            if self.weighting.level[j] ** 2 > MISFIT:
                colour[j] = autoregression(white[j], self.weighting.pieces[j])[0]
        weighting = replace(self.weighting, level=np.ones(n), colour=colour)
        for _ in range(2):
            fit = self.fit(base=self._base(weighting))
            level = np.sqrt(np.maximum(fit.joint_chi2 / fit.degrees, weighting.floor))
            weighting = replace(weighting, level=level)
        return self.fit(base=self._base(weighting)), weighting.library(self.white)

    def contenders(self, fit: Fit, scaled: Library) -> list[Hypothesis]:
        """The most plausible hypotheses beside the picks, best first."""
        picked = [p.hypothesis for p in self.picks]
        return self.candidates.contenders(fit, scaled, picked, self.known)

    def run(self, thorough: bool = True) -> list[Pick]:
        """Add until nothing more is justified; ``thorough`` re-examines earlier picks on the way."""
        for _ in range(_STEPS):
            pick = self.next()
            if pick is None:
                break
            self.picks.append(pick)
            self.settle()
            if thorough and len(self.picks) > 1:
                self.reexamine()
        return self.picks

    def next(self) -> Pick | None:
        """The best acceptable hypothesis, with what it cannot be told apart from.

        While even the best leaves error that is not noise, the choice is made with that error's own
        colour taken out: otherwise whatever is slow, like the error, would win.
        """
        fit, scaled = self.fit(), self.scaled
        contenders = self.contenders(fit, scaled)
        if contenders and self._left(fit, contenders[0]) > MISFIT:
            fit, scaled = self.coloured(contenders[0])
            contenders = self.contenders(fit, scaled)
        if not contenders:
            return None
        threshold = flip_threshold(fit, scaled, self.seed + len(self.picks))
        for hypothesis in contenders[:_TRIES]:
            pick = self.accepted(fit, scaled, hypothesis, threshold)
            if pick is None:
                continue
            rivals = self.rivals(fit, scaled, hypothesis, contenders)
            plain = _plain_form(hypothesis, rivals)
            simpler = None if plain is None else self.accepted(fit, scaled, plain, threshold)
            if plain is not None and simpler is not None:
                return replace(simpler, rivals=self.rivals(fit, scaled, plain, contenders))
            return replace(pick, rivals=rivals)
        return None

    def accepted(
        self, fit: Fit, scaled: Library, hypothesis: Hypothesis, threshold: float
    ) -> Pick | None:
        """The pick, if the hypothesis passes every test."""
        k = len(hypothesis.beta)
        joints = self._joints(fit, hypothesis)
        freedom = max(fit.degrees[joints].sum() - k, 1.0)
        level2 = fit.weighting.level**2
        rest = float(np.sum((fit.joint_chi2 / level2)[joints])) - hypothesis.chi2
        noise = float(np.sum((fit.degrees * fit.weighting.floor / level2)[joints]))
        rest = max(rest, noise) / freedom  # luck with the noise is no evidence
        # The noise's spectrum at the hypothesis's frequencies is known to a relative variance of
        # 2 ORDER / degrees only (Berk, Annals of Statistics 1974).
        known = float(self.noise.degrees[joints].sum()) / ORDER
        p = stats.f.sf(hypothesis.chi2 / k / rest, k, min(freedom, known))
        if not p < FALSE_CLAIM / max(self.white.size, 1):
            return None
        sums = BlockSums.of(fit, fit.partialled(fit.scaled(hypothesis.columns)), k)
        exponent = float(wald_exponent(sums)[0])
        if exponent < threshold:
            return None
        gain = float(self.candidates.block_gains(fit, scaled, hypothesis).sum())
        excess = np.maximum(fit.joint_chi2 - fit.degrees * fit.weighting.floor, 0.0) / level2
        if gain < MIN_GAIN or gain < MIN_SHARE * excess.sum():
            return None
        return Pick(hypothesis, gain, exponent, ())

    def rivals(
        self, fit: Fit, scaled: Library, chosen: Hypothesis, contenders: Sequence[Hypothesis]
    ) -> tuple[Hypothesis, ...]:
        """Hypotheses that these data do not tell from the chosen one.

        By evidence; where error remains that nothing explains, evidence is too sure of itself, and
        the difference of the cross-validated gains, block by block, has to exceed 2 sigma as well.
        """
        others = [h for h in contenders if h.key != chosen.key and h.evidence > 0.0]
        close = [h for h in others if chosen.evidence - h.evidence < TOLD_APART]
        if self._left(fit, chosen) > MISFIT:
            own = self.candidates.block_gains(fit, scaled, chosen)
            for h in others:
                if h in close:
                    continue
                gains = self.candidates.block_gains(fit, scaled, h)
                apart = own - gains
                sigma = float(np.sqrt(len(apart) * apart.var()))
                if gains.sum() > 0.5 * own.sum() and apart.sum() < 2.0 * sigma:
                    close.append(h)
        with_chosen = fit.extended(fit.scaled(chosen.columns))
        return tuple(h for h in close if self._stands_for(with_chosen, h))

    def _stands_for(self, with_chosen: Fit, h: Hypothesis) -> bool:
        """Whether a rival explains the same: once the chosen one is in the model, it is not needed."""
        again = self.candidates.solve(with_chosen, h.key, h.effect, h.columns)
        return again.chi2 < 0.5 * h.chi2

    def _joints(self, fit: Fit, hypothesis: Hypothesis) -> NDArray[np.intp]:
        return np.flatnonzero(fit.rows.joint_sums(np.sum(hypothesis.columns**2, axis=1)) > 0.0)

    def _left(self, fit: Fit, hypothesis: Hypothesis) -> float:
        """Residual variance (1: noise alone) where the hypothesis acts, once it is added."""
        left = fit.residual - fit.partialled(fit.scaled(hypothesis.columns)) @ hypothesis.beta
        joints = self._joints(fit, hypothesis)
        noise = fit.degrees * fit.weighting.floor
        return float(fit.chi2_of(left)[joints].sum() / noise[joints].sum())

    def reexamine(self) -> None:
        """Drop picks that have become useless; exchange those that something else explains better,
        now that the newest one has taken its share of the same joints' error."""
        fit, scaled = self.coloured()
        newest = self._joints(fit, self.picks[-1].hypothesis)
        base = self._base(fit.weighting)
        for k in reversed(range(len(self.picks))):
            fit = self.fit(without=k, base=base)
            pick = self.picks[k]
            h = pick.hypothesis
            chosen, rivals = self.candidates.hypothesis(fit, h.key, h.effect, h.columns), pick.rivals
            if k < len(self.picks) - 1 and len(np.intersect1d(newest, self._joints(fit, h))):
                chosen, rivals = self._again(fit, scaled, k)
            gain = float(self.candidates.block_gains(fit, scaled, chosen).sum())
            if gain < MIN_GAIN:
                del self.picks[k]
            else:
                self.picks[k] = replace(pick, hypothesis=chosen, gain=gain, rivals=rivals)
        self.settle()

    def _again(self, fit: Fit, scaled: Library, k: int) -> tuple[Hypothesis, tuple[Hypothesis, ...]]:
        """The best hypothesis in the place of pick k, given all others."""
        kept = self.picks
        self.picks = kept[:k] + kept[k + 1 :]
        contenders = self.contenders(fit, scaled)
        self.picks = kept
        old = kept[k].hypothesis
        own = self.candidates.tuned(
            fit, self.candidates.hypothesis(fit, old.key, old.effect, old.columns)
        )
        same = next((h for h in contenders if h.key == old.key), None)
        if same is not None:
            own = same if same.chi2 > own.chi2 else replace(own, evidence=same.evidence)
        best = contenders[0] if contenders else own
        if best.key != own.key and best.evidence > own.evidence + TOLD_APART:
            own = best
        rivals = self.rivals(fit, scaled, own, contenders)
        plain = _plain_form(own, rivals)
        if plain is None:
            return own, rivals
        return plain, self.rivals(fit, scaled, plain, contenders)


def _plain_form(chosen: Hypothesis, rivals: Sequence[Hypothesis]) -> Hypothesis | None:
    """The rival that the chosen one refines (a power law near 1: viscous friction), if there is one:
    where data do not tell them apart, the plain law is named."""
    own = [h for h in rivals if h.key[1] == chosen.key[1] and h.key[0] in chosen.effect.refines]
    return max(own, key=lambda h: h.evidence, default=None)
