"""Which curve explains what is left on a joint: the search over variables and pairs of them.

A curve is added only if all of these hold, as for effects that have a name (:mod:`..ladder`):

- the F test's p is below FALSE_CLAIM divided by the number of curves that were looked at;
- its blocks agree more than the 99th percentile of the largest agreement over all curves when the
  signs of the blocks are drawn at random;
- its cross-validated gain, or that of a law that it may be, is above MIN_GAIN and above MIN_SHARE of the
  excess over the noise: where a stretch is left out, a law goes on and splines do not.

Of those that lower the error on data left out the least information criterion is added (Schwarz 1978),
each beside the noise that it leaves: before, what a better one explains is noise to every other.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import special

from sdp_vs_penalty.diagnosis.candidates import Candidate
from sdp_vs_penalty.diagnosis.curves.bases import Basis, Variables
from sdp_vs_penalty.diagnosis.curves.fitted import Fitted, Look, Screened, band, effect_of
from sdp_vs_penalty.diagnosis.curves.formula import LawFit, Recognised, law_of, recognised
from sdp_vs_penalty.diagnosis.curves.held_out import CurveErrors, Judge
from sdp_vs_penalty.diagnosis.fit import WhiteFit
from sdp_vs_penalty.diagnosis.ladder import FALSE_CLAIM, MIN_GAIN, MIN_SHARE, TOLD_APART
from sdp_vs_penalty.diagnosis.state import Pick, SearchState
from sdp_vs_penalty.effects.measured_curve import MeasuredCurve
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.autoregression import ORDER
from sdp_vs_penalty.signals.noise import RESIDUAL

#: How many curves of a joint are looked at closely, how many of these are tried on data left out, draws
#: of signs, and curves a joint at most.
_CLOSE, _TRIED, _SIGNS, _MOST = 8, 3, 400, 3
#: A curve's share of the error is foreseen before levels are brought up to date with it, which changes
#: the share by less than what lies between that from which it counts and this one. What leaves so many
#: times as much as another one, and so much more, is not looked at beside it.
_LIKELY, _WORSE, _APART = 0.25, 4.0, 0.2
#: Laws of each curve by which its variables are chosen.
_LAWS = 3


@dataclass(frozen=True)
class FoundCurve:
    """A curve as an effect, what it was fitted to, and what it does to the error on data left out; law :
    that it is; whole : whether the effect is the law's; seed : of its band's draws."""

    fitted: Fitted
    effect: MeasuredCurve
    look: Look
    held_out: CurveErrors
    seed: int
    law: LawFit | None = None
    whole: bool = False

    @cached_property
    def half(self) -> Array:
        """(P,) half the width of its band, where measurements lie."""
        return band(self.look, self.fitted, self.seed)

    @property
    def freedom(self) -> float:
        """Constants of its law, or where that is not all its effective degrees of freedom."""
        return float(self.law.size) if self.law is not None and self.whole else self.fitted.smooth.edf


@dataclass(frozen=True)
class _Close:
    """A curve that is looked at closely, with the laws that it may be."""

    fitted: Fitted
    look: Look

    @cached_property
    def laws(self) -> list[Recognised]:
        return recognised(self.fitted, self.look, _LAWS, exact=False)

    @property
    def farther(self) -> Recognised | None:
        """The law that gains most on data left out, where that is more than it does itself."""
        best = max(self.laws, key=lambda r: r.gain, default=None)
        return best if best and best.gain > self.fitted.gain else None

    def foreseen(self, judge: Judge) -> float:
        """Share of the joint's error beyond noise that it, or that law, takes on data left out, with the
        levels as they are."""
        f, law = self.fitted, self.farther
        share = judge.foreseen(f.factors, f.smooth.P, f.columns @ f.projector)
        other = 0.0 if law is None else judge.foreseen(law.factors, law.P, law.columns)
        return max(share, other)

    def gains(self, least: float) -> bool:
        """Whether it gains more on data left out, or a law of it does."""
        return self.fitted.gain > least or any(r.gain > least for r in self.laws)

    @cached_property
    def cost(self) -> float:
        """The information criterion, by effective degrees of freedom or by the constants of a law."""
        f = self.fitted
        told = [(f.smooth.chi2, f.smooth.edf), *((r.fit.chi2, float(r.fit.size)) for r in self.laws)]
        gains = self.look.fit.joint_gains(f.joint, np.array([chi2 for chi2, _ in told]))
        freedom = np.array([size for _, size in told])
        return float(np.min(freedom * np.log(f.factors.count) - gains))


def _convincing(
    look: Look, joint: int, taken: Sequence[Fitted], seed: int, shown: Set[tuple[str, ...]]
) -> list[_Close]:
    """The curves of a joint (from 0) that pass, the likely ones first."""
    looked, candidates = _screened(look, joint, taken)
    if not candidates:
        return []
    threshold, stand = _flipped([c.agreeing for c in candidates], seed)
    passed = zip(candidates, stand > threshold, strict=True)
    likely = [c for c, agrees in passed if agrees or c.basis.of in shown]
    likely.sort(key=lambda c: -c.evidence)
    closest = [c for n in (1, 2) for c in [c for c in likely if len(c.basis.axes) == n][: _CLOSE // 2]]
    least = _least_gain(look.fit, joint)
    fine = (look.fitted(c.basis, joint, c.weight) for c in closest)
    shown_to_be = (f for f in fine if _significant(look, f, looked))
    close = [c for f in shown_to_be if (c := _Close(f, look)).gains(least)]
    return sorted(close, key=lambda c: c.cost)


def _screened(look: Look, joint: int, taken: Sequence[Fitted]) -> tuple[int, list[Screened]]:
    """How many curves were looked at, and those with evidence."""
    own, kinds = {t.basis.of for t in taken}, dict[object, list[Basis]]()
    for of in look.variables.of(joint):
        basis = look.variables.basis(of)
        if basis is not None and basis.of not in own:
            kinds.setdefault(basis.kind, []).append(basis)
    found = [c for bases in kinds.values() for c in look.screened(bases, joint)]
    return sum(map(len, kinds.values())), found


def _flipped(agreeing: Sequence[Array], seed: int) -> tuple[float, Array]:
    """The threshold of agreement, and the agreement of each candidate, each over the 99th percentile of
    its own when signs are random: one of many splines has a shorter tail than one of a few."""
    B = len(agreeing[0])
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (_SIGNS, B))
    drawn = np.array([np.sum((signs @ G) * signs, axis=1) for G in agreeing])
    own = np.maximum(np.quantile(drawn, 0.99, axis=1), 1e-300)
    largest = np.max(drawn / own[:, None], axis=0)
    return float(np.quantile(largest, 0.99)), np.array([G.sum() for G in agreeing]) / own


def _significant(look: Look, found: Fitted, tests: int) -> bool:
    j, edf = found.joint, max(found.smooth.edf, 1.0)
    least, before = _in_weighted(look.fit, j)
    freedom = max(look.fit.degrees[j] - edf, 1.0)
    rest = max(before - found.smooth.chi2, least) / freedom
    known = float(look.noise.degrees[j]) / ORDER
    return bool(
        special.fdtrc(edf, min(freedom, known), found.smooth.chi2 / edf / rest) < FALSE_CLAIM / tests
    )


def _least_gain(fit: WhiteFit, joint: int) -> float:
    least, before = _in_weighted(fit, joint)
    return max(MIN_GAIN, MIN_SHARE * max(before - least, 0.0))


def _in_weighted(fit: WhiteFit, j: int) -> tuple[float, float]:
    """Of a joint's weighted rows the squares of the noise alone, and of what is left."""
    level2 = fit.weighting.level[j] ** 2
    return float(fit.weighting.noise_variance[j] * fit.degrees[j] / level2), float(
        fit.joint_chi2[j] / level2
    )


def with_curve(state: SearchState, effect: MeasuredCurve, gain: float) -> SearchState:
    """The state with the curve among its picks; levels and a guessed noise are brought up to date."""
    picks = state.picks
    if state.stage.noise.source == RESIDUAL:
        state = state.with_noise(state.stage.noise_beside([*state.effects, effect]))
        picks = state.picks
    columns = state.stage.candidates.white_columns(effect)
    h = Candidate((effect.name, effect.joints[0]), effect, 0.0, np.ones(1), 0.0, columns)
    return state.with_picks((*picks, Pick(h, gain, 0.0, ())))


def search_curves(
    state: SearchState,
    variables: Variables,
    joint: int,
    judge: Judge,
    shown: Set[tuple[str, ...]] = frozenset(),
) -> tuple[SearchState, list[FoundCurve], Judge]:
    """Curves of a joint (from 0) one after the other, each refitted once what it explains no longer
    counts as error, as long as one lowers the error on data left out. shown : what a torque is known to
    follow, as findings passed the test of signs that follow nothing else: which function of it that is
    the other tests decide (a closed procedure, Marcus, Peritz, Gabriel 1976)."""
    found: list[FoundCurve] = []
    judge, seed = judge.beside(state), state.stage.seed
    while len(found) < _MOST:
        look = Look(state, variables)
        close = _convincing(look, joint, [f.fitted for f in found], seed + len(found), shown)
        foreseen = [(c, c.foreseen(judge)) for c in close[:_TRIED]]
        most, tried = max((share for _, share in foreseen), default=0.0), []
        least = max(_LIKELY, 1.0 - _WORSE * (1.0 - most) - _APART)
        for best in (c for c, share in foreseen if share >= least):
            later = with_curve(state, effect_of(look, best.fitted), best.fitted.gain)
            bare = replace(later, picks=later.picks[:-1])
            after, curve = _settled(Look(bare, variables, settled=True), best, judge, seed)
            if curve.held_out.lowers:
                tried.append((with_curve(bare, curve.effect, curve.fitted.gain), curve, after))
        if not tried:
            break
        state, curve, judge = _preferred(tried, joint, found)
        found.append(curve)
    return state, found, judge


_Tried = tuple[SearchState, FoundCurve, Judge]


def _preferred(tried: Sequence[_Tried], joint: int, found: Sequence[FoundCurve]) -> _Tried:
    """The least cost; of those that cannot be told apart from it the one over the fewest variables."""
    costs = [cost(state, joint, [*found, curve]) for state, curve, _ in tried]
    alike = [t for t, c in zip(tried, costs, strict=True) if c < min(costs) + TOLD_APART]
    return min(alike, key=lambda t: (len(t[1].fitted.basis.axes), t[2].error(joint)))


def cost(state: SearchState, joint: int, found: Sequence[FoundCurve]) -> float:
    """The information criterion of a joint's rows: deviance, with the noise's own variance where that is
    a guess, and the price of what explains them, a curve by its law."""
    fit = state.fit
    degrees, noise = float(fit.degrees[joint]), float(fit.weighting.noise_variance[joint])
    chi2 = float(fit.joint_chi2[joint])
    variance = max(chi2 / degrees, noise)
    guessed = state.stage.noise.source == RESIDUAL
    scale = float(state.stage.noise.sigma[joint]) ** 2 if guessed else 1.0
    curves = {f.effect.text for f in found}
    named = [p.candidate for p in state.picks if p.candidate.effect.text not in curves]
    freedom = sum(f.freedom for f in found)
    freedom += sum(len(h.beta) + len(h.effect.searched) for h in named if h.key[1] == joint)
    return degrees * np.log(variance * scale) + chi2 / variance + freedom * np.log(degrees)


def _settled(look: Look, close: _Close, judge: Judge, seed: int) -> tuple[Judge, FoundCurve]:
    """A curve once what it explains no longer counts as error, with splines as fine as there is evidence
    for, and the law that it is."""
    joint = close.fitted.joint
    fitted = look.fitted(close.fitted.basis, joint, close.fitted.smooth.weight)
    while (finer := fitted.basis.finer) is not None:
        again = look.fitted(finer, joint, fitted.smooth.weight)
        if again.smooth.evidence < fitted.smooth.evidence + TOLD_APART:
            break
        fitted = again
    effect = effect_of(look, fitted)
    after, held_out = judge.tried(fitted, effect, look)
    curve = FoundCurve(fitted, effect, look, held_out, seed)
    if not held_out.lowers:
        far = None if close.farther is None else close.farther.fit
        if far is None or not judge.tried(fitted, effect_of(look, fitted, far.at), look, far)[1].lowers:
            return after, curve
    law = law_of(recognised(fitted, look), fitted, look, lambda: curve.half)
    if law is None:
        return after, curve
    told = effect_of(look, fitted, law.at)
    by_law, errors = judge.tried(fitted, told, look, law)
    if held_out.lowers and after.surely_below(by_law, joint):  # there is more to it than the law
        return after, replace(curve, law=law)
    return by_law, replace(curve, effect=told, held_out=errors, law=law, whole=True)
