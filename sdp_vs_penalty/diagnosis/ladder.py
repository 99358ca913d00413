"""The search: add the best candidate, refine its shape, re-examine earlier ones, repeat.

A candidate is an effect on a joint. It is added only if all of these hold:

- the F test's p is below FALSE_CLAIM divided by the number of columns that were searched;
- its block-robust Wald statistic exceeds the 99th percentile of the maximum over all that could be
  added instead when the signs of the blocks are drawn at random;
- its cross-validated gain is above MIN_GAIN (in units of white chi-square) and above MIN_SHARE of
  the excess over the noise at the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from sdp_vs_penalty.diagnosis.block_test import BlockSums, wald_exponent
from sdp_vs_penalty.diagnosis.candidates import Candidate
from sdp_vs_penalty.diagnosis.fit import WhiteFit
from sdp_vs_penalty.diagnosis.library import Key, spread_columns
from sdp_vs_penalty.diagnosis.stage import MISFIT
from sdp_vs_penalty.diagnosis.state import Pick, SearchState
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.autoregression import ORDER
from sdp_vs_penalty.signals.noise import RESIDUAL, Noise

FALSE_CLAIM = 2e-3
MIN_GAIN = 15.0
MIN_SHARE = 0.004
#: Evidence (twice a log Bayes factor, per unit of residual variance) by which a rival must fall
#: short to be told apart: odds of 150 to 1.
TOLD_APART = 10.0
#: Below this correlation of their torques one cause of the whole robot undoes another.
_OPPOSED = -0.5
#: How many candidates a step tries to add, how many steps there are.
_TRIES = 3
#: How many are refined to see what the best of them would leave.
_LOOKED_AT = 3
_STEPS = 40
#: How often the noise is estimated anew where only the residual shows it.
_ROUNDS = 12


def search_through(start: SearchState) -> SearchState:
    """The end of the search, from wherever it stands.

    Where only the residual shows the noise, it begins as what the model leaves beside the best
    explanation and is known better after each round. Its colour hides what resembles it; when
    nothing more is found with it, one more look takes the noise as white, until that repeats itself.
    """
    if start.stage.noise.source != RESIDUAL:
        return climbed(start)
    best = [] if start.picks else [h.effect for h in _with_white_noise(start).contenders()[:1]]
    state = climbed(_in_place_of(start, start.stage.noise_beside([*start.effects, *best])))
    tried = set[frozenset[Key]]()
    for _ in range(_ROUNDS):
        found = len(state.picks)
        state = climbed(_with_noise_beside(state))
        if len(state.picks) == found:
            plain = climbed(_with_white_noise(state))
            keys = frozenset(p.candidate.key for p in plain.picks)
            if len(plain.picks) == found or keys in tried:
                plain.release()
                break
            tried.add(keys)
            state = plain
    return _with_noise_beside(state)


def _with_noise_beside(state: SearchState) -> SearchState:
    """The same picks with the noise as what is left beside them, in the place of this state."""
    return _in_place_of(state, state.stage.noise_beside(state.effects))


def _with_white_noise(state: SearchState) -> SearchState:
    """The same picks with white noise as large as what is left beside them, in its place."""
    noise = state.stage.noise_beside(state.effects)
    return _in_place_of(state, replace(noise, ar=np.zeros_like(noise.ar), sigma=noise.floor))


def _in_place_of(state: SearchState, noise: Noise) -> SearchState:
    out = state.with_noise(noise)
    state.release()
    return out


def climbed(state: SearchState, thorough: bool = True) -> SearchState:
    """Add until nothing more is justified; ``thorough`` re-examines earlier picks on the way, those on
    the same joints, and all of them at the end."""
    checked = -1
    for _ in range(_STEPS):
        pick = next_pick(state)
        if pick is not None:
            state = state.with_picks((*state.picks, pick))
            if thorough and len(state.picks) > 1:
                state = reexamined(state)
            continue
        if not thorough or len(state.picks) < 2 or checked == len(state.picks):
            break
        before, state = state.picks, reexamined(state, everything=True)
        checked = len(state.picks)
        pairs = zip(before, state.picks, strict=False)
        if checked == len(before) and all(a.candidate.columns is b.candidate.columns for a, b in pairs):
            break  # nothing was missing beside these
    return state


def by_gain(state: SearchState) -> SearchState:
    """The same picks, those that gain most first; a finer form of an effect comes after the plainer.

    What joints share is no finer form of any small effect on one of them: a wrist's gears come first.
    """
    picks = sorted(state.picks, key=lambda p: -p.gain)
    for pick in list(picks):
        plainer = [k for k, p in enumerate(picks) if _says_so(pick.candidate, p.candidate)]
        place = picks.index(pick)
        if plainer and max(plainer) > place:
            picks.insert(max(plainer), picks.pop(place))
    return state.with_picks(picks)


def refines(finer: Candidate, plainer: Candidate) -> bool:
    """Whether one candidate is a finer form of another: its effect says so, or it lets joints share what
    the other has one of them do alone (a rotor on the difference of two joints, beside links that are
    free, is the rotor of one of them)."""
    if finer.effect.joins and not plainer.effect.joins:
        return plainer.key[1] in finer.effect.joints and not plainer.effect.whole_robot
    return _says_so(finer, plainer)


def _says_so(finer: Candidate, plainer: Candidate) -> bool:
    """Whether an effect declares that it is a finer form of another, on the same joint."""
    return plainer.key[1] == finer.key[1] and plainer.key[0] in finer.effect.refines


def next_pick(state: SearchState) -> Pick | None:
    """The best acceptable candidate, with what it cannot be told apart from.

    While even the best leaves error that is not noise, the choice is made with that error's own
    colour taken out: otherwise whatever is slow, like the error, would win. Worked out once a state.
    """
    if not state.next_pick:
        state.next_pick.append(_looked_for(state))
    return state.next_pick[0]


def _looked_for(state: SearchState) -> Pick | None:
    first = state.contenders(_LOOKED_AT)
    if first and _left(state.fit, first[0]) > MISFIT:
        state = state.coloured(first[0])
    contenders = state.contenders()
    if not contenders:
        return None
    ordered = [*_mostly(state, contenders[0]), *_joint_by_joint(state, contenders)]
    for candidate in ordered[:_TRIES]:
        pick = accepted(state, candidate)
        if pick is None:
            continue
        rivals = rivals_of(state, candidate, contenders)
        plain = _plain_form(candidate, rivals)
        simpler = None if plain is None else accepted(state, plain)
        if plain is not None and simpler is not None:
            return replace(simpler, rivals=rivals_of(state, plain, contenders))
        return replace(pick, rivals=rivals)
    return None


def _mostly(state: SearchState, first: Candidate) -> list[Candidate]:
    """The effect on one joint that says most of what a cause of the whole robot does, if one does: a
    zero that is 3 degrees off beside joints that are mounted a millimetre elsewhere."""
    name = first.effect.mostly
    found = [h for j in range(state.fit.rows.n) if name for h in state.contenders(only=(name, j))]
    best = max(found, key=lambda h: h.chi2, default=None)
    return [] if best is None or not _says_most(best, first) else [best]


def _says_most(own: Candidate, whole: Candidate) -> bool:
    """Whether an effect on one joint is what a cause of the whole robot mostly is."""
    return own.key[0] == whole.effect.mostly and own.chi2 > 0.5 * whole.chi2


def _joint_by_joint(state: SearchState, contenders: Sequence[Candidate]) -> Sequence[Candidate]:
    """The same behind the best member of a family, where the first is of the whole robot and one law on
    each joint by itself explains more: what all joints have in common looks like one cause (friction
    that bends before it slides, on every joint, like a filter of all channels)."""
    first = contenders[0]
    family = state.best_family() if first.key[1] is None else None
    if family is None or family[0] < first.evidence + TOLD_APART:
        return contenders
    return [*state.contenders(only=family[1]), *contenders]


def accepted(state: SearchState, candidate: Candidate, lucky: bool = True) -> Pick | None:
    """The pick, if the candidate passes every test, the cheapest first; lucky : the last of them is
    against random signs."""
    fit, stage, k = state.fit, state.stage, len(candidate.beta)
    joints = joints_of(fit, candidate)
    freedom = max(fit.degrees[joints].sum() - k, 1.0)
    level2, least = fit.weighting.level**2, fit.degrees * fit.weighting.noise_variance
    rest = float(np.sum((fit.joint_chi2 / level2)[joints])) - candidate.chi2
    noise = float(np.sum((least / level2)[joints]))
    rest = max(rest, noise) / freedom  # luck with the noise is no evidence
    # The noise's spectrum at the candidate's frequencies is known to a relative variance of
    # 2 ORDER / degrees only (Berk, Annals of Statistics 1974).
    known = float(stage.noise.degrees[joints].sum()) / ORDER
    p = special.fdtrc(k, min(freedom, known), candidate.chi2 / k / rest)
    if not p < FALSE_CLAIM / max(stage.white.size, 1):
        return None
    sums = BlockSums.of(fit, fit.partialled(fit.scaled(candidate.columns)), k)
    exponent = float(wald_exponent(sums)[0])
    gain = float(_block_gains(state, candidate).sum())
    excess = np.maximum(fit.joint_chi2 - least, 0.0) / level2
    if gain < MIN_GAIN or gain < MIN_SHARE * excess.sum():
        return None
    if (lucky and not state.above_chance(exponent)) or _cancels(state, candidate):
        return None
    return Pick(candidate, gain, exponent, ())


def _cancels(state: SearchState, candidate: Candidate) -> bool:
    """Whether a cause of the whole robot undoes one that was picked: a torque that is filtered by
    8 ms and yet 7 ms early is neither, only what the two leave of each other."""
    whole, rows = candidate.key[1] is None, state.stage.rows
    for k in (k for k, p in enumerate(state.picks) if whole and p.candidate.key[1] is None):
        pair, fit = (state.picks[k].candidate, candidate), state.without(k).fit
        columns = fit.partialled(np.hstack([fit.scaled(h.columns) for h in pair]))
        beta = np.linalg.lstsq(columns, fit.residual, rcond=None)[0]
        parts = np.split(beta, [len(pair[0].beta)])
        # As torques, of which slow ones count most: white, only what is sharp in them would.
        one, other = (
            spread_columns(rows, h.effect) @ b / rows.torque.std(axis=0)[:, None]
            for h, b in zip(pair, parts, strict=True)
        )
        if np.vdot(one, other) < _OPPOSED * np.linalg.norm(one) * np.linalg.norm(other):
            return True
    return False


def accepted_beside(state: SearchState, candidate: Candidate) -> Pick | None:
    """The pick in its own right: with what random signs of the blocks make of all others, and rivals."""
    pick = accepted(state, candidate)
    if pick is None:
        return None
    joints = frozenset(joints_of(state.fit, candidate).tolist())
    return replace(pick, rivals=rivals_of(state, candidate, state.contenders(on=joints)))


def rivals_of(
    state: SearchState, chosen: Candidate, contenders: Sequence[Candidate]
) -> tuple[Candidate, ...]:
    """Candidates that these data do not tell from the chosen one.

    By evidence; where error remains that nothing explains, evidence is too sure of itself, and
    the difference of the cross-validated gains, block by block, has to exceed 2 sigma as well.
    """
    others = [h for h in contenders if h.key != chosen.key and h.evidence > 0.0]
    close = [h for h in others if chosen.evidence - h.evidence < TOLD_APART]
    if _left(state.fit, chosen) > MISFIT:
        own = _block_gains(state, chosen)
        for h in others:
            # Out of sample a candidate gains no more than in it.
            if h in close or h.chi2 < 0.5 * own.sum():
                continue
            gains = _block_gains(state, h)
            apart = own - gains
            sigma = float(np.sqrt(len(apart) * apart.var()))
            if gains.sum() > 0.5 * own.sum() and apart.sum() < 2.0 * sigma:
                close.append(h)
    # A rival explains the same: once the chosen one is in the model, it is not needed.
    with_chosen = state.fit.extended(chosen.columns)
    solve = state.stage.candidates.solve
    return tuple(h for h in close if solve(with_chosen, h.key, h.effect, h.columns).chi2 < 0.5 * h.chi2)


def reexamined(state: SearchState, everything: bool = False) -> SearchState:
    """Picks that have become useless dropped; those that something else explains better exchanged,
    now that the newest one has taken its share of the same joints' error.

    everything : picks on other joints as well, which the newest one hardly concerns."""
    coloured, picks = state.coloured(), state.picks
    newest = joints_of(state.fit, picks[-1].candidate)
    for k in reversed(range(len(picks))):
        pick, h = picks[k], picks[k].candidate
        last, touched = k == len(picks) - 1, np.intersect1d(newest, joints_of(state.base, h)).size > 0
        if not touched and not everything:
            continue
        others = replace(coloured, picks=picks).without(k)
        again = touched and not last
        chosen, rivals = _again(others, h) if again else (_judged(others, h), pick.rivals)
        gain = float(_block_gains(others, chosen).sum())
        if gain < MIN_GAIN:
            picks = others.picks
        else:
            pick = replace(pick, candidate=chosen, gain=gain, rivals=rivals)
            picks = (*picks[:k], pick, *picks[k + 1 :])
    return state.with_picks(picks)


def reshaped(state: SearchState) -> SearchState:
    """The same picks, the shape constants of each refined anew beside all others."""
    for k, pick in enumerate(state.picks):
        others = state.without(k)
        own = others.stage.candidates.tuned(others.fit, _judged(others, pick.candidate))
        state = state.with_picks((*state.picks[:k], replace(pick, candidate=own), *state.picks[k + 1 :]))
    return state


def _again(others: SearchState, old: Candidate) -> tuple[Candidate, tuple[Candidate, ...]]:
    """The best candidate in the place of an old one, given all other picks."""
    contenders = others.contenders(on=frozenset(joints_of(others.fit, old).tolist()))
    own = others.stage.candidates.tuned(others.fit, _judged(others, old))
    same = next((h for h in contenders if h.key == old.key), None)
    if same is not None:
        own = same if same.chi2 > own.chi2 else replace(own, evidence=same.evidence)
    best = next(iter(_mostly(others, contenders[0])), contenders[0]) if contenders else own
    better = best.key != own.key and best.evidence > own.evidence + TOLD_APART
    if better and not _says_most(own, best) and not _cancels(others, best):
        own = best
    rivals = rivals_of(others, own, contenders)
    plain = _plain_form(own, rivals)
    return (own, rivals) if plain is None else (plain, rivals_of(others, plain, contenders))


def gain_of(state: SearchState, k: int) -> float:
    """What pick k is worth beside all others, on rows that do not fit it."""
    others = state.without(k)
    return float(_block_gains(others, _judged(others, state.picks[k].candidate)).sum())


def _judged(state: SearchState, h: Candidate) -> Candidate:
    """The same candidate beside other picks."""
    return state.stage.candidates.judged(state.fit, h.key, h.effect, h.columns)


def _block_gains(state: SearchState, candidate: Candidate) -> Array:
    return state.stage.candidates.block_gains(state.fit, state.scaled, candidate)


def joints_of(fit: WhiteFit, candidate: Candidate) -> NDArray[np.intp]:
    """On which joints a candidate acts."""
    return np.flatnonzero(fit.rows.joint_sums(np.sum(candidate.columns**2, axis=1)) > 0.0)


def _left(fit: WhiteFit, candidate: Candidate) -> float:
    """Residual variance (1: noise alone) where the candidate acts, once it is added."""
    left = fit.residual - fit.partialled(fit.scaled(candidate.columns)) @ candidate.beta
    joints = joints_of(fit, candidate)
    noise = fit.degrees * fit.weighting.noise_variance
    return float(fit.chi2_of(left)[joints].sum() / noise[joints].sum())


def _plain_form(chosen: Candidate, rivals: Sequence[Candidate]) -> Candidate | None:
    """The rival that the chosen one refines (a power law near 1: viscous friction), if there is one:
    where data do not tell them apart, the plain law is named."""
    own = [h for h in rivals if refines(chosen, h)]
    return max(own, key=lambda h: h.evidence, default=None)
