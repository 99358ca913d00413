"""Few, believable findings: what two picks say that one would, and what speaks against a pick."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.diagnosis.ladder import (
    MIN_GAIN,
    TOLD_APART,
    accepted,
    accepted_beside,
    gain_of,
    joints_of,
    reexamined,
)
from sdp_vs_penalty.diagnosis.library import Key
from sdp_vs_penalty.diagnosis.scoring import evidence
from sdp_vs_penalty.diagnosis.stage import MISFIT
from sdp_vs_penalty.diagnosis.state import Pick, SearchState
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.signals.stillness import SLOW

#: An effect of which the model absorbs more than this share cannot be seen.
INVISIBLE = 0.999
#: Of a pick's energy, the share that its correlation with another must take for its size to be theirs
#: together: standard deviations are then sqrt(1 / (1 - 0.8)) = 2.2 times as large as alone.
CORRELATED = 0.8
#: Share of a larger effect's gain up to which a smaller one on its joints may be that law's own error: a
#: law of friction holds to about a tenth of its torque.
LAW = 0.01
#: ... and of a law that the smaller one refines: what bends it in another way is nearly the same.
FINER_LAW = 0.03
#: ... and up to which it is taken for a part of that law, where both change the same friction.
PART = 0.005
#: Share of the model's own friction by which its law may be wrong, as tanh is where it turns round.
SLIGHT = 0.05
#: How many times what a pick explains may be left on its joint: with more, the error without a name
#: falls by less than a tenth, and the pick is a part of that error rather than a name for it.
UNNAMED = 4.0


def merged(state: SearchState) -> SearchState:
    """Pairs of picks that say the same replaced by one candidate that explains as much.

    A sigmoid of 200 N m beside a Stribeck friction of -200 N m is neither: it is what their difference
    looks like. One law with the evidence of both, or nearly, is named instead.
    """
    tried: set[frozenset[str]] = set()
    state = _joint_by_joint(state)
    while True:
        pair = next((p for p in _pairs(state) if _texts(state, p) not in tried), None)
        if pair is None:
            return state
        tried.add(_texts(state, pair))
        state = _one_for(state, *pair) or state


def _joint_by_joint(state: SearchState) -> SearchState:
    """The search with laws of one joint each in the place of those that joints share, of all or of one,
    where as few explain as much: (q4 + q5)^2 and (q4 - q5)^2 are the kinetic energies of two rotors,
    one a joint; on parallel axes that of (q2 - q3)^2 is one rotor beside the links'."""
    shared = [p for p in state.picks if p.candidate.effect.joins and p.candidate.key[1] is not None]
    for group in [shared, *([p] for p in shared if len(shared) > 1)]:
        if group and (found := _by_singles(state, group)):
            return _joint_by_joint(found)
    return state


def _by_singles(state: SearchState, group: list[Pick]) -> SearchState | None:
    """The search with as many laws of one joint each in the place of these picks, if as good."""
    singles = others = state.with_picks([p for p in state.picks if p not in group])
    joints = frozenset(j for p in group for j in p.candidate.effect.joints)
    for _ in group:
        found = (
            h for h in singles.contenders(on=joints) if len(singles.stage.candidates.acting[h.key]) == 1
        )
        pick = next((p for h in found if (p := accepted(singles, h))), None)
        if pick is None:
            break
        singles = singles.with_picks((*singles.picks, pick))
    fit, own = others.fit, singles.picks[len(others.picks) :]
    if not own:
        return None
    before, after = (
        evidence(
            fit.likelihood_gain(fit.extended(*(p.candidate.columns for p in picks)).joint_chi2),
            sum(p.candidate.columns.shape[1] for p in picks),
        )
        for picks in (group, own)
    )
    return reexamined(singles) if after > before - TOLD_APART else None


def _texts(state: SearchState, pair: tuple[int, int]) -> frozenset[str]:
    return frozenset(state.picks[k].candidate.effect.text for k in pair)


def _pairs(state: SearchState) -> list[tuple[int, int]]:
    """Correlated picks on the same single joint, and causes of the whole robot beside what a rival of
    the whole robot would explain: a tilt beside a spring, both of a wrong geometry."""
    every = [(a, b) for b in range(len(state.picks)) for a in range(b)]
    joints = [p.candidate.key[1] for p in state.picks]
    alike = [
        _taken(state, a, b) > CORRELATED
        if joints[a] is not None and joints[a] == joints[b]
        else None in (joints[a], joints[b]) and bool(_of_whole_robot(state, a, b))
        for a, b in every
    ]
    return [pair for pair, same in zip(every, alike, strict=True) if same]


def _of_whole_robot(state: SearchState, a: int, b: int) -> list[Key]:
    """The rivals of two picks that are causes of the whole robot."""
    rivals = (r for k in (a, b) for r in state.picks[k].rivals)
    return list(dict.fromkeys(r.key for r in rivals if r.key[1] is None))


def _one_for(state: SearchState, a: int, b: int) -> SearchState | None:
    """The search with one pick in the place of two, if one does."""
    without = state.without(b).without(a)
    one, other = (state.picks[k].candidate for k in (a, b))
    both = without.fit.extended(one.columns, other.columns)
    gain = without.fit.likelihood_gain(both.joint_chi2)
    needed = float(evidence(gain, one.columns.shape[1] + other.columns.shape[1])) - TOLD_APART
    if one.key[1] is not None and one.key[1] == other.key[1]:
        found = without.contenders(on=frozenset([one.key[1]]))[:1]
    else:
        found = [c for key in _of_whole_robot(state, a, b) for c in without.contenders(only=key)]
    for candidate in found:
        if candidate.evidence > needed:
            pick = accepted_beside(without, candidate)
            return without.with_picks((*without.picks, pick)) if pick else None
    return None


def believable(state: SearchState) -> SearchState:
    """The search without picks that are a part of something larger, the smallest first: of a law of the
    same friction, the model's own as well, or of error on their joints that has no name."""
    for pick in sorted(state.picks, key=lambda p: p.gain):
        k = next(m for m, p in enumerate(state.picks) if p is pick)
        if _part_of_a_law(state, k) or _drowned(state, k) or _plain_again(state, k):
            state = state.with_picks(state.without(k).picks)
    return state


def seen_sliding(state: SearchState) -> SearchState:
    """The search without picks that are not friction and that do not show while their joints slide:
    where dry friction turns round its laws hold only approximately, whatever that resembles."""
    if not any(e.signless for e in state.effects):
        return state
    stage = state.stage
    rows = stage.rows.with_masked((stage.rows.slow > SLOW) | ~stage.rows.keep)
    sliding = state.on(stage.on(rows))
    while True:
        gains = {k: gain_of(sliding, k) for k, effect in enumerate(sliding.effects) if effect.signless}
        k = min(gains, key=lambda k: gains[k], default=None)
        if k is None or gains[k] >= MIN_GAIN:
            return state
        state, sliding = (s.with_picks(s.without(k).picks) for s in (state, sliding))


def correlated(state: SearchState, k: int) -> tuple[Pick, ...]:
    """Other picks on the joints of pick k that take most of its energy."""
    return tuple(state.picks[m] for m in _beside(state, k) if _taken(state, k, m) > CORRELATED)


def _beside(state: SearchState, k: int) -> list[int]:
    """The other picks that act on a joint of pick k."""
    own = joints_of(state.fit, state.picks[k].candidate)
    acting = ((m, joints_of(state.fit, p.candidate)) for m, p in enumerate(state.picks) if m != k)
    return [m for m, joints in acting if np.intersect1d(own, joints).size]


def overshadowed(state: SearchState, k: int) -> Pick | None:
    """A larger pick on the joints of pick k whose own error that may be."""
    others = (state.picks[m] for m in _beside(state, k))
    larger = max(others, key=lambda p: p.gain, default=None)
    if larger is None or state.picks[k].gain >= _own_error(state.picks[k], larger) * larger.gain:
        return None
    return larger


def bent(estimate: Estimate, effect: Effect, size: float) -> str:
    """The model's own friction that an effect of this size bends by less than its law holds to."""
    units = {p.joint: p.unit for p in effect.parameters[effect.sized_by]}
    for own, indices in zip(estimate.model.effects, estimate.model.indices, strict=True):
        for parameter, index in zip(own.parameters, indices, strict=True):
            alike = own.name in effect.refines and units.get(parameter.joint) == parameter.unit
            if alike and abs(size) < SLIGHT * abs(estimate.theta[index]):
                return own.name
    return ""


def _part_of_a_law(state: SearchState, k: int) -> bool:
    """Whether pick k is a small change of the friction that a much larger one changes, too."""
    pick, larger = state.picks[k], overshadowed(state, k)
    if larger is None or pick.gain >= PART * larger.gain:
        return False
    one, other = (p.candidate.effect for p in (pick, larger))
    return not {one.name, *one.refines}.isdisjoint({other.name, *other.refines})


def _plain_again(state: SearchState, k: int) -> bool:
    """Whether pick k is a finer form of a law of which the model's own law makes nearly all: a power of
    0.998 beside viscous friction, large and opposite."""
    columns = state.base.scaled(state.picks[k].candidate.columns)
    left = np.sum(state.base.partialled(columns) ** 2)
    finer = bool(state.picks[k].candidate.effect.refines)
    return bool(finer and left < (1.0 - INVISIBLE) * np.sum(columns**2))


def _drowned(state: SearchState, k: int) -> bool:
    """Whether most of what pick k explains is on joints on which far more than that is left."""
    fit = state.fit
    least, level2 = fit.degrees * fit.weighting.noise_variance, fit.weighting.level**2
    left = np.where(fit.joint_chi2 > MISFIT * least, fit.joint_chi2 - least, 0.0)
    explained = np.maximum(state.without(k).fit.joint_chi2 - fit.joint_chi2, 0.0)
    told = np.sum(np.where(UNNAMED * explained > left, explained, 0.0) / level2)
    return bool(told < 0.5 * np.sum(explained / level2))


def _own_error(pick: Pick, larger: Pick) -> float:
    """Share of a larger pick's gain that its law may leave to the other."""
    return FINER_LAW if larger.candidate.effect.name in pick.candidate.effect.refines else LAW


def _taken(state: SearchState, k: int, m: int) -> float:
    """Share of pick k's energy, beside all other picks, that pick m takes."""
    others = tuple(p for i, p in enumerate(state.picks) if i not in (k, m))
    fit = replace(state, picks=others).fit
    mine, its = (fit.partialled(fit.scaled(state.picks[i].candidate.columns)) for i in (k, m))
    energy = float(np.sum(mine**2))
    if energy == 0.0:
        return 1.0
    q = np.linalg.qr(its)[0]
    return float(np.sum((q.T @ mine) ** 2)) / energy
