"""Which curve explains what is left on a joint: the search over variables and pairs of them.

A curve is added only if all of these hold, as for effects that have a name (:mod:`..ladder`):

- the F test's p is below FALSE_CLAIM divided by the number of curves that were looked at;
- its blocks agree more than the 99th percentile of the largest agreement over all curves when the
  signs of the blocks are drawn at random;
- its cross-validated gain is above MIN_GAIN and above MIN_SHARE of the excess over the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from sdp_vs_penalty.diagnosis.candidates import Candidate
from sdp_vs_penalty.diagnosis.curves import smooth as splines
from sdp_vs_penalty.diagnosis.curves.bases import Basis, Variables, pairs_of
from sdp_vs_penalty.diagnosis.curves.curve import table_effect
from sdp_vs_penalty.diagnosis.curves.smooth import Factors, Smooth, agreement, block_scores
from sdp_vs_penalty.diagnosis.fit import WhiteFit
from sdp_vs_penalty.diagnosis.ladder import FALSE_CLAIM, MIN_GAIN, MIN_SHARE, TOLD_APART
from sdp_vs_penalty.diagnosis.state import Pick, SearchState
from sdp_vs_penalty.effects.measured_curve import MeasuredCurve
from sdp_vs_penalty.signals.autoregression import ORDER
from sdp_vs_penalty.signals.noise import RESIDUAL

Array = NDArray[np.float64]

#: How many curves of a joint are looked at closely, draws of signs, and curves a joint at most.
_CLOSE, _SIGNS, MOST = 8, 400, 3
#: A curve over fewer variables is preferred to one that contains it up to so many standard deviations
#: of the difference of their gains.
_SIMPLER = 2.0


@dataclass(frozen=True)
class Fitted:
    """A curve of one joint: its basis, white columns Z (M, k) with C = Q'Z, factors, fit and gain."""

    joint: int
    basis: Basis
    Z: Array
    C: Array
    factors: Factors
    smooth: Smooth
    gains: Array

    @property
    def gain(self) -> float:
        return float(self.gains.sum())

    @property
    def coefficients(self) -> Array:
        """(k,) of what the model's own columns cannot make."""
        return np.asarray(splines.identifiable(self.factors) @ self.smooth.c)


class Look:
    """What a state leaves, ready to be compared with curves."""

    def __init__(self, state: SearchState, variables: Variables) -> None:
        self.state, self.variables, self.fit = state, variables, state.fit
        self.noise, self.rows = state.stage.noise, state.stage.rows
        fit = self.fit
        self.overlap = fit.rows.block_sums(fit.Q * fit.residual[:, None])

    def white(self, columns: Array, joint: int) -> Array:
        """(M, k) columns of one joint, white and weighted like the rows."""
        gain = 1.0 if self.rows.gains is None else self.rows.gains[joint]
        pieces = self.rows.pieces(joint)
        return self.fit.weighting.apply(self.noise.whiten(gain * columns, joint, pieces), joint)

    def fitted(self, basis: Basis, joint: int, fine: bool, columns: Array | None = None) -> Fitted:
        """A curve on exact columns where ``fine``, with its gains."""
        if columns is None:
            columns = self.variables.exact(basis, joint) if fine else self.variables.coarse(basis)
        Z = self.white(columns, joint)
        factors, C = Factors.of(self.fit, Z, joint)
        found = splines.smooth(factors, basis.penalties, fine)
        gains = np.zeros(0)
        if fine:
            gains = splines.held_out_gains(self.fit, Z, C, factors, found.P, joint)
        return Fitted(joint, basis, Z, C, factors, found, gains)


def best_curve(look: Look, joints: Sequence[int], taken: Sequence[Fitted], seed: int) -> Fitted | None:
    """The most convincing curve of any of the joints (from 0); None where none passes."""
    candidates, agreements = _screened(look, joints, taken)
    if not candidates:
        return None
    threshold, stand = _flipped(agreements, seed)
    close: list[Fitted] = []
    for j in joints:
        mine = [k for k, c in enumerate(candidates) if c.joint == j and stand[k] > threshold]
        mine.sort(key=lambda k: -candidates[k].smooth.evidence)
        for k in _closest(mine, candidates):
            found = look.fitted(candidates[k].basis, j, fine=True)
            if _accepted(look.fit, found, len(candidates), look.noise.degrees[j]):
                close.append(found)
    return _chosen(close) if close else None


def _closest(order: Sequence[int], candidates: Sequence[Fitted]) -> list[int]:
    """The best, the best of each number of variables among them."""
    single = [k for k in order if len(candidates[k].basis.axes) == 1]
    pairs = [k for k in order if len(candidates[k].basis.axes) == 2]
    return [*single[: _CLOSE // 2], *pairs[: _CLOSE // 2]]


def _screened(
    look: Look, joints: Sequence[int], taken: Sequence[Fitted]
) -> tuple[list[Fitted], list[Array]]:
    candidates, agreements = [], []
    for j in joints:
        own = {t.basis.of for t in taken if t.joint == j}
        for of in pairs_of(j, look.rows.n, look.variables.warm):
            basis = look.variables.basis(of)
            if basis is None or basis.of in own:
                continue
            found = look.fitted(basis, j, fine=False)
            A = found.factors.D + found.smooth.P
            if found.smooth.evidence > 0.0:
                scores = block_scores(look.fit, found.Z, found.C, j, look.overlap)
                candidates.append(found)
                agreements.append(agreement(scores, A))
    return candidates, agreements


def _flipped(agreements: Sequence[Array], seed: int) -> tuple[float, Array]:
    """The threshold of agreement, and the agreement of each candidate."""
    B = len(agreements[0])
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (_SIGNS, B))
    largest = np.full(_SIGNS, -np.inf)
    for G in agreements:
        largest = np.maximum(largest, np.sum((signs @ G) * signs, axis=1))
    return float(np.quantile(largest, 0.99)), np.array([G.sum() for G in agreements])


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
    """The largest gain; a curve that it contains instead, where that gains about as much."""
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
    apart = best.gains - simple.gains
    sigma = float(np.sqrt(len(apart) * apart.var()))
    return bool(apart.sum() < max(TOLD_APART, min(_SIMPLER * sigma, 0.1 * best.gain)))


#: What a function of a variable is a function of as well.
_FINER = {"abs(ddq)": "ddq", "sign(dq)": "dq"}


def _contains(large: Basis, small: Basis) -> bool:
    """Whether every curve over the one is a curve over the other."""
    have = {a.variable for a in large.axes}
    return large.of != small.of and all(
        a.variable in have or (_FINER.get(a.variable[0], ""), a.variable[1]) in have for a in small.axes
    )


def effect_of(look: Look, found: Fitted) -> MeasuredCurve:
    """The curve as an effect: a table of its values."""
    robot = look.state.stage.candidacy.model.robot
    points = look.variables.supported(found.basis)
    values = found.basis.at(*points.T) @ found.coefficients
    return table_effect(robot, found.joint, found.basis.of, points, values)


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
    state: SearchState, variables: Variables, joints: Sequence[int], seed: int
) -> tuple[SearchState, list[tuple[Fitted, MeasuredCurve, Look]]]:
    """Curves one after the other, each refitted once what it explains no longer counts as error."""
    found: list[tuple[Fitted, MeasuredCurve, Look]] = []
    open_joints = list(joints)
    while open_joints:
        taken = [f for f, _, _ in found]
        look = Look(state, variables)
        best = best_curve(look, open_joints, taken, seed + len(found))
        if best is None:
            break
        later = with_curve(state, effect_of(look, best), best.gain)
        look = Look(replace(later, picks=later.picks[:-1]), variables)
        best = look.fitted(best.basis, best.joint, fine=True)
        effect = effect_of(look, best)
        state = with_curve(replace(later, picks=later.picks[:-1]), effect, best.gain)
        found.append((best, effect, look))
        if sum(f.joint == best.joint for f, _, _ in found) >= MOST:
            open_joints.remove(best.joint)
    return state, found
