"""The shape constants of effects that join a model, and of the model's own beside them.

Coulomb friction that turns over 2 mrad/s and Stribeck friction, fitted one after the other, each take
what is the other's: they are found together, and what that moves has to be confirmed by motion left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.library import Form, Library
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.whitening import diagnosis_rows, prepare
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import SHAPE_FOLDS
from sdp_vs_penalty.estimation.cross_validation import cross_validate
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.shape_constants import free_constants, settled
from sdp_vs_penalty.estimation.shapes import ShapeEstimate
from sdp_vs_penalty.regression.regression import compress

#: Chance of folds that agree by luck, below which other shape constants are confirmed.
_CHANCE = 0.025
#: Standard deviations by which a constant of the model's own has to move beside what is new.
_MOVES = 2.0


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
) -> list[Effect]:
    """The effects with all constants that were not given estimated, one effect a joint where so."""
    out: list[Effect] = []
    search: Search | None = None
    for effect, fixed in zip(wanted, given, strict=True):
        if all_given(effect, fixed):
            out.append(effect)
            continue
        fixed = fixed | (set(effect.shape) - set(type(effect).shapes))
        if search is None:
            settings = estimate.preprocessing.resolve(measurements)
            rows = diagnosis_rows(measurements, estimate, settings)
            search = Search(prepare(rows, estimate, frozen), Library((), (), {}))
        joints = [None] if effect.whole_robot else effect.joints[:1] if effect.joins else effect.joints
        out += [_shaped(search, effect, joint, fixed) for joint in joints]
    return out


def _shaped(search: Search, effect: Effect, joint: int | None, fixed: frozenset[str]) -> Effect:
    """One joint's effect with the shape that scores most; given ones stay."""
    start = min(float(s.motion.t[0]) for s in search.data.rows.segments)
    given = {key: effect.shape[key] for key in fixed}
    forms = [
        Form((effect.name, joint), one) for one in effect.candidates(effect.robot, joint, start, **given)
    ]
    best = max((search.judged(search.fit, form) for form in forms), key=lambda t: t.J)
    return search.refined(search.fit, best, fixed).form.effect


def found_together(
    found: Estimate, added: Sequence[Effect], given: Sequence[frozenset[str]], measurements: Measurements
) -> tuple[Model, list[ShapeEstimate]] | None:
    """The model with its own estimated constants and those of what was ``added`` on the same joints at
    their joint optimum, and its own as `identify` states them; None where none of these moves."""
    shapes = list(map(ShapeEstimate.from_dict, found.details.get("shapes", ())))
    new = {
        (e.name, j, key)
        for e, fixed in zip(added, given, strict=True)
        if not (e.whole_robot or e.joins or e.several)
        for j in e.joints
        for key in free_constants(e)
        if key not in fixed
    }
    joints = {j for _, j, _ in new}
    own = {(s.effect, s.joint, s.shape): s for s in shapes if s.joint in joints}
    wanted = {key for key in new if key[1] in {j for _, j, _ in own}}.union(own)
    if not wanted:
        return None
    settings, weighting = found.preprocessing, found.weighting
    best = settled(found.model, wanted, lambda model: compress(measurements, model, settings), weighting)
    effects, std = best.model.effects, best.std
    values = {(e.name, j, k): v for e in effects for k, v in e.shape.items() for j in e.joints}
    if not any(abs(np.log(values[k] / s.after)) > _MOVES * std[k] for k, s in own.items()):
        return None
    out = [
        replace(s, after=values[k], std=values[k] * std[k])
        if (k := (s.effect, s.joint, s.shape)) in own
        else s
        for s in shapes
    ]
    return best.model, out


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
                folds=SHAPE_FOLDS,
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
