"""What a search has come to, as one value: its picks and everything that follows from them."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sdp_vs_penalty.diagnosis.block_test import above_chance
from sdp_vs_penalty.diagnosis.candidates import MOST, Candidate
from sdp_vs_penalty.diagnosis.fit import Weighting, WhiteFit
from sdp_vs_penalty.diagnosis.library import Key, Library
from sdp_vs_penalty.diagnosis.stage import MISFIT, Stage
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.autoregression import ORDER, autoregression
from sdp_vs_penalty.signals.noise import Noise

#: By this share levels may still change when they are settled.
_SETTLED = 1e-3


@dataclass(frozen=True)
class Pick:
    """A candidate that was added; gain : its cross-validated gain; exponent : of its Wald test;
    rivals : candidates that it could not be told apart from when it was added."""

    candidate: Candidate
    gain: float
    exponent: float
    rivals: tuple[Candidate, ...]


@dataclass(frozen=True)
class SearchState:
    """picks : in the order of adding; base : the model alone, on rows weighted as the picks leave
    them; next_pick : what is to be added, once that is known.

    A search goes from state to state: nothing in one changes.
    """

    stage: Stage
    picks: tuple[Pick, ...]
    base: WhiteFit
    next_pick: list[Pick | None] = field(default_factory=list, init=False, repr=False, compare=False)

    @classmethod
    def start(cls, stage: Stage) -> SearchState:
        """Before anything is picked."""
        return _settled(stage, (), stage.plain_weighting, np.ones(stage.rows.n))

    def with_picks(self, picks: Sequence[Pick]) -> SearchState:
        """These picks instead, the joints' levels settled anew: a joint whose error they do not
        explain counts by that error."""
        return _settled(self.stage, tuple(picks), self.base.weighting, np.ones(self.stage.rows.n))

    def without(self, k: int) -> SearchState:
        """All picks but one, on rows weighted as before."""
        return replace(self, picks=self.picks[:k] + self.picks[k + 1 :])

    @property
    def effects(self) -> list[Effect]:
        """What was picked."""
        return [p.candidate.effect for p in self.picks]

    @property
    def scaled(self) -> Library:
        """The library, weighted like the rows."""
        return self.base.weighted(self.stage.white)

    @cached_property
    def fit(self) -> WhiteFit:
        """The model with all picks."""
        return self.base.extended(*(pick.candidate.columns for pick in self.picks))

    @cached_property
    def residual(self) -> Array:
        """(M, n) what the model with all picks leaves, not whitened [N m or N]."""
        return self.stage.residual_beside(self.effects)

    def coloured(self, best: Candidate | None = None) -> SearchState:
        """The same picks, with the colour taken out of the error that stays unexplained even with the
        ``best`` candidate so far."""
        fit, weighting = self.fit, self.base.weighting
        if best is not None:
            fit = fit.extended(best.columns)
        n = self.stage.rows.n
        white = fit.residual.reshape(n, -1) * weighting.level[:, None]
        colour = np.zeros((n, ORDER))
        for j in range(n):
            if weighting.level[j] ** 2 > MISFIT:
                colour[j] = autoregression(white[j], weighting.pieces[j])[0]
        weighting = replace(weighting, level=np.ones(n), colour=colour)
        return _settled(self.stage, self.picks, weighting, weighting.noise_variance)

    def contenders(
        self, most: int = MOST, on: Set[int] | None = None, only: Key | None = None
    ) -> list[Candidate]:
        """The most plausible candidates beside the picks, best first, their shapes refined: ``most`` of
        them, those that act ``on`` any of these joints (None: all), ``only`` this one (None: any)."""
        picked = [p.candidate for p in self.picks]
        stage = self.stage
        return stage.candidates.contenders(self.fit, self.scaled, picked, stage.known, most, on, only)

    def best_family(self) -> tuple[float, Key] | None:
        """What one law explains, on each joint by itself and summed over the joints, of those laws the
        one that explains most, and where it explains most."""
        stage, picked = self.stage, [p.candidate for p in self.picks]
        families = stage.candidates.families(self.fit, self.scaled, picked, stage.known)
        if not families:
            return None
        name, own = max(families.items(), key=lambda f: sum(f[1].values()))
        return sum(own.values()), (name, max(own, key=lambda j: own[j]))

    @property
    def eligible(self) -> frozenset[Key]:
        """What may be added to the picks."""
        picked = [p.candidate for p in self.picks]
        return frozenset(self.stage.candidates.eligible(picked, self.stage.known))

    def above_chance(self, exponent: float) -> bool:
        """Whether an exponent exceeds what random signs of the blocks make of all that may be added."""
        fit, scaled, seed = self.fit, self.scaled, self.stage.seed + len(self.picks)
        scores = self.stage.candidates.scores(fit, scaled)
        return above_chance(fit, scaled, scores, self.eligible, seed, exponent)

    def release(self) -> None:
        """Forget what is large and can be made again: another state takes this one's place."""
        self.stage.release()
        (vars(self).pop("fit", None) or self.base).release()

    def with_noise(self, noise: Noise) -> SearchState:
        """The same picks with another idea of the noise."""
        return self.on(self.stage.with_noise(noise))

    def on(self, stage: Stage, but: Set[int] = frozenset()) -> SearchState:
        """The same picks on another stage, ``but`` those that act on any of these joints, their columns
        worked out anew."""
        picks = []
        for pick in self.picks:
            if but and but & stage.candidates.acting[pick.candidate.key]:
                continue
            columns = stage.candidates.white_columns(pick.candidate.effect)
            picks.append(replace(pick, candidate=replace(pick.candidate, columns=columns)))
        return SearchState.start(stage).with_picks(picks)


def _settled(stage: Stage, picks: tuple[Pick, ...], weighting: Weighting, least: Array) -> SearchState:
    """The joints' levels brought up to date with the picks; ``least`` (n,) : each one's smallest
    variance."""
    columns = [pick.candidate.columns for pick in picks]
    for _ in range(2):
        fit = stage.levelled(weighting, columns)
        level = np.sqrt(np.maximum(fit.joint_chi2 / fit.degrees, least))
        if np.allclose(level, weighting.level, rtol=_SETTLED, atol=0.0):
            out = SearchState(stage, picks, stage.fit(weighting))
            if fit.rows is stage.labels:
                vars(out)["fit"] = fit  # known already
            return out
        weighting = replace(weighting, level=level)
    return SearchState(stage, picks, stage.fit(weighting))
