"""Which curve explains what is left on a joint: the search over variables and pairs of them.

A curve is added only if all of these hold, as for effects that have a name (:mod:`..ladder`):

- the F test's p is below FALSE_CLAIM divided by the number of curves that were looked at;
- its blocks agree more than the 99th percentile of the largest agreement over all curves when the
  signs of the blocks are drawn at random;
- its cross-validated gain is above MIN_GAIN and above MIN_SHARE of the excess over the noise.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from sdp_vs_penalty.diagnosis.candidates import Candidate
from sdp_vs_penalty.diagnosis.curves.bases import Basis, Variables
from sdp_vs_penalty.diagnosis.curves.fitted import Fitted, Look, band, effect_of
from sdp_vs_penalty.diagnosis.curves.formula import LawFit, law_of, recognised
from sdp_vs_penalty.diagnosis.curves.held_out import CurveErrors, Judge
from sdp_vs_penalty.diagnosis.curves.smooth import agreement, block_scores
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
#: Laws of each curve by which its variables are chosen.
_LAWS = 3
#: A curve over fewer variables is preferred to one that contains it up to so many standard deviations
#: of the difference of their gains, or this share of gain and evidence.
_SIMPLER, _LITTLE = 2.0, 0.1


@dataclass(frozen=True)
class FoundCurve:
    """A curve as an effect, what it was fitted to, half its band where measurements lie (P,), its law,
    and what it does to the error on data left out; whole : whether the effect is the law's."""

    fitted: Fitted
    effect: MeasuredCurve
    look: Look
    half: Array
    law: LawFit | None
    held_out: CurveErrors
    whole: bool = False


def _convincing(
    look: Look, joint: int, taken: Sequence[Fitted], seed: int, shown: Set[tuple[str, ...]]
) -> list[Fitted]:
    """The curves of a joint (from 0) that pass, the one to be preferred first."""
    looked, candidates, agreements = _screened(look, joint, taken)
    if not candidates:
        return []
    threshold, stand = _flipped(agreements, seed)
    order = [k for k, c in enumerate(candidates) if stand[k] > threshold or c.basis.of in shown]
    order.sort(key=lambda k: -candidates[k].smooth.evidence)
    close = [look.fitted(candidates[k].basis, joint, fine=True) for k in _closest(order, candidates)]
    degrees = look.noise.degrees[joint]
    close = [c for c in close if _accepted(look.fit, c, looked, degrees)]
    if not close:
        return []
    best = _chosen(close)
    return [best, *sorted((c for c in close if c is not best), key=lambda c: -c.gain)]


def _closest(order: Sequence[int], candidates: Sequence[Fitted]) -> list[int]:
    """The best, the best of each number of variables among them."""
    single = [k for k in order if len(candidates[k].basis.axes) == 1]
    pairs = [k for k in order if len(candidates[k].basis.axes) == 2]
    return [*single[: _CLOSE // 2], *pairs[: _CLOSE // 2]]


def _screened(look: Look, joint: int, taken: Sequence[Fitted]) -> tuple[int, list[Fitted], list[Array]]:
    """How many curves were looked at, those with evidence, and how their blocks agree."""
    looked, candidates, agreements = 0, [], []
    own = {t.basis.of for t in taken}
    for of in look.variables.of(joint):
        basis = look.variables.basis(of)
        if basis is None or basis.of in own:
            continue
        looked += 1
        found = look.fitted(basis, joint, fine=False)
        if found.smooth.evidence > 0.0:
            scores = block_scores(look.fit, found.Z, found.C, joint, look.overlap)
            candidates.append(found)
            agreements.append(agreement(scores, found.factors.D + found.smooth.P))
    return looked, candidates, agreements


def _flipped(agreements: Sequence[Array], seed: int) -> tuple[float, Array]:
    """The threshold of agreement, and the agreement of each candidate, each over the 99th percentile of
    its own when signs are random: one of many splines has a shorter tail than one of a few."""
    B = len(agreements[0])
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (_SIGNS, B))
    drawn = np.array([np.sum((signs @ G) * signs, axis=1) for G in agreements])
    own = np.maximum(np.quantile(drawn, 0.99, axis=1), 1e-300)
    largest = np.max(drawn / own[:, None], axis=0)
    return float(np.quantile(largest, 0.99)), np.array([G.sum() for G in agreements]) / own


def _accepted(fit: WhiteFit, found: Fitted, tests: int, known: float) -> bool:
    j, edf = found.joint, max(found.smooth.edf, 1.0)
    least = fit.weighting.noise_variance[j] * fit.degrees[j]
    level2 = fit.weighting.level[j] ** 2
    before = fit.joint_chi2[j] / level2
    freedom = max(fit.degrees[j] - edf, 1.0)
    rest = max(before - found.smooth.chi2, least / level2) / freedom
    p = special.fdtrc(edf, min(freedom, float(known) / ORDER), found.smooth.chi2 / edf / rest)
    excess = max(before - least / level2, 0.0)
    return bool(p < FALSE_CLAIM / tests and found.gain > max(MIN_GAIN, MIN_SHARE * excess))


def _chosen(close: Sequence[Fitted]) -> Fitted:
    """The largest gain; a curve that it contains instead, where that gains about as much or has more
    evidence, in which what a curve may be is paid for."""
    best = max(close, key=lambda c: c.gain)
    inside = [
        c
        for c in close
        if c.joint == best.joint
        and c is not best
        and _contains(best.basis, c.basis)
        and _as_good(c, best)
    ]
    return min(inside, key=lambda c: (c.basis.size, -c.gain)) if inside else best


def _as_good(simple: Fitted, best: Fitted) -> bool:
    mine, its = simple.smooth.evidence, best.smooth.evidence
    apart = best.gains - simple.gains
    sigma = float(np.sqrt(len(apart) * apart.var()))
    close = apart.sum() < max(TOLD_APART, min(_SIMPLER * sigma, _LITTLE * best.gain))
    return bool(mine > its or (close and mine > (1.0 - _LITTLE) * its))


def _contains(large: Basis, small: Basis) -> bool:
    """Whether every curve over the one is a curve over the other."""
    have = [a.variable for a in large.axes]
    return large.of != small.of and all(a.variable.within(have) for a in small.axes)


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
    seed: int,
    judge: Judge,
    shown: Set[tuple[str, ...]] = frozenset(),
) -> tuple[SearchState, list[FoundCurve], Judge]:
    """Curves of a joint (from 0) one after the other, each refitted once what it explains no longer
    counts as error, as long as one lowers the error on data left out. shown : what a torque is known to
    follow, as findings passed the test of signs that follow nothing else: which function of it that is
    the other tests decide (a closed procedure, Marcus, Peritz, Gabriel 1976)."""
    found: list[FoundCurve] = []
    judge = judge.beside(state)
    while len(found) < _MOST:
        look = Look(state, variables)
        close = _convincing(look, joint, [f.fitted for f in found], seed + len(found), shown)
        for best in _by_law(look, close[:_TRIED]):
            later = with_curve(state, effect_of(look, best), best.gain)
            bare = replace(later, picks=later.picks[:-1])
            after, curve = _settled(bare, variables, best.basis, joint, judge, seed)
            if curve.held_out.lowers:
                state, judge = with_curve(bare, curve.effect, best.gain), after
                found.append(curve)
                break
        else:
            break
    return state, found, judge


def _settled(
    bare: SearchState, variables: Variables, basis: Basis, joint: int, judge: Judge, seed: int
) -> tuple[Judge, FoundCurve]:
    """A curve once what it explains no longer counts as error, with splines as fine as there is evidence
    for, and the law that it is."""
    look = Look(bare, variables, settled=True)
    fitted = look.fitted(basis, joint, fine=True)
    while (finer := fitted.basis.finer) is not None:
        again = look.fitted(finer, joint, fine=True)
        if again.smooth.evidence < fitted.smooth.evidence + TOLD_APART:
            break
        fitted = again
    effect = effect_of(look, fitted)
    after, held_out = judge.tried(fitted, effect, look)
    if not held_out.lowers:
        return after, FoundCurve(fitted, effect, look, np.zeros(0), None, held_out)
    half, points = band(look, fitted, seed), variables.supported(fitted.basis)
    law = law_of(recognised(fitted, look), fitted, points, half)
    if law is None:
        return after, FoundCurve(fitted, effect, look, half, None, held_out)
    told = effect_of(look, fitted, law.at)
    by_law, errors = judge.tried(fitted, told, look, law)
    if after.surely_below(by_law, joint):  # there is more to it than the law
        return after, FoundCurve(fitted, effect, look, half, law, held_out)
    return by_law, FoundCurve(fitted, told, look, half, law, errors, whole=True)


def _by_law(look: Look, close: list[Fitted]) -> list[Fitted]:
    """The curves, first the one whose law explains most for its constants (Schwarz 1978), a curve
    without a law by its effective degrees of freedom, where that is not the first by far."""
    if len(close) < 2:
        return close

    def cost(f: Fitted) -> float:
        told = [(r.fit.chi2, float(r.fit.size)) for r in recognised(f, look, _LAWS)]
        told = told or [(f.smooth.chi2, f.smooth.edf)]
        gains = look.fit.joint_gains(f.joint, np.array([chi2 for chi2, _ in told]))
        freedom = np.array([size for _, size in told])
        return float(np.min(freedom * np.log(f.factors.count) - gains))

    costs = [cost(f) for f in close]
    k = int(np.argmin(costs))
    if costs[k] > costs[0] - TOLD_APART:
        return close
    return [close[k], *(c for c in close if c is not close[k])]
