"""From what a search leaves to findings: which joints, instead of which stand-ins, with which band."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sdp_vs_penalty.diagnosis.curves.bases import Variables
from sdp_vs_penalty.diagnosis.curves.choose import FoundCurve, cost, search_curves
from sdp_vs_penalty.diagnosis.curves.curve import CURVE, Curve
from sdp_vs_penalty.diagnosis.curves.fitted import unmeasured
from sdp_vs_penalty.diagnosis.curves.formula import written
from sdp_vs_penalty.diagnosis.curves.held_out import Judge, TestRun, known_floor
from sdp_vs_penalty.diagnosis.findings import Finding
from sdp_vs_penalty.diagnosis.ladder import TOLD_APART
from sdp_vs_penalty.diagnosis.parsimony import LAW
from sdp_vs_penalty.diagnosis.stage import MISFIT
from sdp_vs_penalty.diagnosis.state import SearchState
from sdp_vs_penalty.diagnosis.verdict import Remainder
from sdp_vs_penalty.effects.curve_variable import Variable
from sdp_vs_penalty.effects.effect import Effect, follows_alone
from sdp_vs_penalty.signals.noise import RESIDUAL


@dataclass(frozen=True)
class Measured:
    """curves, in the order of adding; replaced : places of the picks for which they stand instead."""

    curves: tuple[Curve, ...] = ()
    replaced: frozenset[int] = frozenset()


def measured_curves(
    state: SearchState, left: Remainder, doubted: Sequence[int] = (), test: TestRun | None = None
) -> Measured:
    """The curves of those joints on which the search leaves error that repeats, or that it doubts, and
    those that stand instead of two findings or more.

    left : what is known of the rest; where nothing repeats, so that nothing is, all joints are looked
    at. doubted : joints (from 0) whose findings are no physical causes. test : filtered rows of a test
    run with the model attached, for the held-out errors; without one they are those of folds. What a
    search without curves has named on such a joint is kept, unless curves without it explain the joint
    better by the Bayesian information criterion (Schwarz 1978) and no worse on data left out, but for
    chance where every curve is a law; where what follows the position is doubted, unless curves explain
    it up to its noise.
    """
    rows, model = state.stage.rows, state.stage.candidacy.model
    variables = Variables(rows, model.robot, [*model.effects, *state.effects])
    doubtful = {*doubted, *_not_seen_to_repeat(state, variables)}
    nothing_known = state.stage.noise.source == RESIDUAL
    unexplained = doubtful.union(range(rows.n) if nothing_known else left.joints)
    joints = sorted(unexplained.union(_several(state)))
    if not joints:
        return Measured()
    places = list(range(len(state.picks)))
    judge, every, replaced = Judge.of(state, test), list[Curve](), set[int]()
    for joint in joints:
        told: _Searched = state, [], judge.beside(state)
        if joint in unexplained:  # else nothing is left beside what was named
            told = search_curves(state, variables, joint, judge)
        named = [p.candidate for p, _ in zip(state.picks, places, strict=False)]
        # What acts on other joints as well is not replaced by a curve of this one.
        acting = state.stage.candidates.acting
        own = [k for k, h in enumerate(named) if acting[h.key] == {joint} == set(h.effect.joints)]
        if joint in doubtful:  # a function of the position in parts; what else is named stays
            own = [k for k in own if follows_alone(named[k].effect, "q")] or own
        if own and (instead := _instead(state, variables, joint, own, judge, told, joint in doubtful)):
            told = instead
            replaced |= {places[k] for k in own}
            places = [place for k, place in enumerate(places) if k not in own]
        state, found, judge = told
        every += map(_told, found)
    return Measured(tuple(every), frozenset(replaced))


#: A state with the curves of a joint, these, and what judges them.
_Searched = tuple[SearchState, list[FoundCurve], Judge]


def _instead(
    state: SearchState,
    variables: Variables,
    joint: int,
    own: Sequence[int],
    judge: Judge,
    told: _Searched,
    doubted: bool,
) -> _Searched | None:
    """The curves that stand in the place of a joint's ``own`` picks, if that is better than ``told``."""
    beside, found, judged = told
    bare = state.with_picks([p for k, p in enumerate(state.picks) if k not in own])
    shown = _followed([state.effects[k] for k in own], joint)
    alone, instead, other = search_curves(bare, variables, joint, judge, shown)
    better = cost(beside, joint, found) - cost(alone, joint, instead) > TOLD_APART
    if all(f.law for f in instead):
        better = better and not judged.surely_below(other, joint)
    else:  # a shape that nothing recognises has no credit of its own
        better = better and other.error(joint) <= judged.error(joint)
    if doubted and _explains(alone, joint):
        better |= other.error(joint) <= np.sqrt(MISFIT) * judged.error(joint)
    if not better or any(_renamed(state, own, f) for f in instead):
        return None
    return (alone, instead, other) if instead else None


def _renamed(state: SearchState, own: Sequence[int], found: FoundCurve) -> bool:
    """Whether a curve is the torque of one of the picks again, as far as any law holds."""
    others = state.with_picks([p for k, p in enumerate(state.picks) if k not in own]).fit
    curve = others.partialled(others.scaled(state.stage.candidates.white_columns(found.effect)))
    for k in own:
        named = others.partialled(others.scaled(state.picks[k].candidate.columns))
        left = curve - named @ np.linalg.lstsq(named, curve, rcond=None)[0]
        if np.sum(left**2) <= LAW * np.sum(curve**2):
            return True
    return False


def _not_seen_to_repeat(state: SearchState, variables: Variables) -> list[int]:
    """Joints (from 0) of which two findings or more follow the position alone, one of them a wave that
    the motion does not go through often enough to show that it repeats: parts of a sum, perhaps; or one
    wave of which less than one was travelled."""
    out = []
    for j in range(state.stage.rows.n):
        own = [p.candidate.effect for p in state.picks if p.candidate.key[1] == j]
        parts = [e for e in own if follows_alone(e, "q")]
        waves = [Variable("phase", j, order=e.waves) for e in parts if e.waves is not None]
        least = {} if len(parts) > 1 else {"turns": 1.0}
        if not all(variables.turned(w, **least) for w in waves):
            out.append(j)
    return out


def _several(state: SearchState) -> list[int]:
    """Joints (from 0) on which two findings or more act alone: parts of one law, perhaps."""
    acting = state.stage.candidates.acting
    alone = [acting[p.candidate.key] for p in state.picks]
    count = Counter(j for own in alone if len(own) == 1 for j in own)
    return [j for j, k in count.items() if k > 1]


def _followed(effects: Sequence[Effect], joint: int) -> frozenset[tuple[str, ...]]:
    """What all of these follow alone: the position or the velocity of their joint (from 0)."""
    words: tuple[Literal["q", "dq"], ...] = ("q", "dq")
    return frozenset(
        (Variable(w, joint).name,) for w in words if all(follows_alone(e, w, joint) for e in effects)
    )


def stood_in(findings: tuple[Finding, ...], measured: Measured) -> tuple[Finding, ...]:
    """The findings; those that curves stand instead of are weak, and cannot be told apart from one; what
    curves were measured beside belongs to them, whatever it is doubted for."""
    if not measured.curves:
        return findings
    out = []
    for k, f in enumerate(findings):
        rivals = tuple(r for r in f.indistinguishable_from if r != CURVE)
        if k in measured.replaced:
            said = (*f.remarks, "a measured curve explains the joint better without it")
            f = replace(f, confidence="weak", remarks=said)
            rivals = (*rivals, CURVE)
        out.append(replace(f, indistinguishable_from=rivals))
    return tuple(out)


def _explains(state: SearchState, joint: int) -> bool:
    """Whether what is left of a joint is little more than noise."""
    fit = state.fit
    return bool(
        fit.joint_chi2[joint] < MISFIT * fit.degrees[joint] * fit.weighting.noise_variance[joint]
    )


def _told(found: FoundCurve) -> Curve:
    """A curve as it is told."""
    f, law, half = found.fitted, found.law, found.half
    points = found.look.variables.supported(f.basis)
    torque, filled, beyond = f.basis.at(*points.T) @ f.coefficients, points[:0], np.zeros(0)
    if law is not None and found.whole:
        filled = unmeasured(f.basis, points)
        torque, beyond = law.at(points), law.at(filled)
    units = found.look.state.stage.candidacy.model.robot.torque_units
    single = points.shape[1] == 1
    return Curve(
        f.joint + 1,
        f.basis.of,
        points[:, 0] if single else points,
        torque,
        torque - half,
        torque + half,
        found.held_out.share(known_floor(found.look.noise, f.joint)),
        None if law is None else written(law, f, units),
        found.held_out.before,
        found.held_out.after,
        filled[:, 0] if single else filled,
        beyond,
    )
