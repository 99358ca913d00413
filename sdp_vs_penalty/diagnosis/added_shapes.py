"""The shape constants of effects that join a model, and of the model's own beside them.

Coulomb friction that turns over 2 mrad/s and Stribeck friction, fitted one after the other, each take
what is the other's: they are found together, and what that moves has to be confirmed by motion left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.own_shapes import beside_effect
from sdp_vs_penalty.diagnosis.rows import diagnosis_rows
from sdp_vs_penalty.diagnosis.stage import Stage, prepare
from sdp_vs_penalty.diagnosis.state import SearchState
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.cross_validation import cross_validate
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.shape_folds import FOLDS
from sdp_vs_penalty.estimation.shape_profiles import ShapeEstimate, with_shapes
from sdp_vs_penalty.estimators.task import make_task
from sdp_vs_penalty.regression.regression import compress

#: Chance of folds that agree by luck, below which other shape constants are confirmed.
_CHANCE = 0.025


def all_given(effect: Effect, given: frozenset[str]) -> bool:
    """Whether nothing is left to estimate of an effect's shape constants."""
    clock = {key for key, shape in effect.shapes.items() if shape.role == "clock"}
    # Constants that the effect has and its class has not say what it acts on, as its joints do.
    return given | (set(effect.shape) - set(type(effect).shapes)) >= clock.union(effect.searched)


def shaped_effects(
    estimate: Estimate,
    wanted: Sequence[Effect],
    given: Sequence[frozenset[str]],
    measurements: Measurements,
    frozen: bool,
    seed: int,
) -> list[Effect]:
    """The effects with all constants that were not given estimated, one effect a joint where so."""
    out: list[Effect] = []
    stage: Stage | None = None
    for effect, fixed in zip(wanted, given, strict=True):
        if all_given(effect, fixed):
            out.append(effect)
            continue
        fixed = fixed | (set(effect.shape) - set(type(effect).shapes))
        if stage is None:
            settings = estimate.preprocessing.resolve(measurements)
            rows = diagnosis_rows(measurements, estimate, settings)
            stage = prepare(rows, estimate, frozen, seed)
        joints = [None] if effect.whole_robot else effect.joints[:1] if effect.joins else effect.joints
        out += [_shaped(stage, effect, joint, fixed) for joint in joints]
    return out


def _shaped(stage: Stage, effect: Effect, joint: int | None, fixed: frozenset[str]) -> Effect:
    """One joint's effect with the shape that explains most of the residual; given ones stay."""
    fit, judge = SearchState.start(stage).fit, stage.candidates
    start = min(float(s.motion.t[0]) for s in stage.rows.segments)
    given = {key: effect.shape[key] for key in fixed}
    trials = [
        judge.judged(fit, (effect.name, joint), one, judge.white_columns(one))
        for one in effect.candidates(effect.robot, joint, start, **given)
    ]
    best = max(trials, key=lambda h: h.chi2)
    return judge.tuned(fit, best, fixed).effect


def refitted(
    estimate: Estimate, shapes: Sequence[ShapeEstimate], measurements: Measurements
) -> Estimate:
    """The model with other shape constants, refitted by least squares: what a search starts from."""
    model = replace(estimate.model, effects=with_shapes(estimate.model.effects, shapes))
    regression = compress(measurements, model, estimate.preprocessing)
    weighting = str(estimate.settings.get("weighting", "noise"))
    theta = make_task(estimate.problem, model, regression, weighting).ols
    return replace(estimate, model=model, theta=theta)


def moved_beside(
    estimate: Estimate,
    own: Sequence[Effect],
    added: Sequence[Effect],
    measurements: Measurements,
    seed: int,
) -> list[ShapeEstimate]:
    """The open constants of the model's ``own`` effects that are other ones beside what is added: found
    together, since one of the two takes what the other gets wrong."""
    open_ones = {(e.name, j, k) for e in own for k in e.shapes if k not in e.given for j in e.joints}
    pairs = [(e.name, j) for e in added for j in e.joints if j in {j for _, j, _ in open_ones}]
    if not pairs:
        return []
    rows = diagnosis_rows(measurements, estimate, estimate.preprocessing.resolve(measurements))
    state = SearchState.start(prepare(rows, estimate, False, seed))
    found = [s for name, j in pairs for s in beside_effect(estimate, state, name, j)]
    return [s for s in found if s.after != s.before and (s.effect, s.joint, s.shape) in open_ones]


def confirmed(other: Estimate, found: Estimate, measurements: Measurements) -> bool:
    """Whether folds of the motion that are left out show significantly less error with the other model's
    shape constants: by Wilcoxon's signed ranks of the folds' differences, since a few folds may hold
    most of the reversals."""
    from scipy.stats import wilcoxon

    try:
        before, after = (
            cross_validate(
                e.problem,
                measurements,
                "ols",
                effects=e.model.effects,
                preprocessing=e.preprocessing,
                folds=FOLDS,
            )
            for e in (found, other)
        )
    except InputError:  # too short to leave anything out
        return False
    level = sum(f.losses for f in before.folds)
    gains = [
        float(np.sum((a.losses - b.losses) / level))
        for a, b in zip(before.folds, after.folds, strict=True)
    ]
    return bool(wilcoxon(gains, alternative="greater").pvalue < _CHANCE)
