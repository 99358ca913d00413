"""Shape constants of the model's own effects: as candidates of a search, and as
reports.

The model's effect with another value of its constant is a candidate that replaces the
present value. Its evidence is the deviance drop from the model with the present value,
at the price of one number. It is reported as a re-estimated constant and not as a
missing effect, since it is the simpler explanation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from sdp_vs_penalty.diagnosis.constants import MINOR
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.diagnosis.finding import Retune
from sdp_vs_penalty.diagnosis.library import Candidate
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, WhiteFit
from sdp_vs_penalty.diagnosis.refine import STEPS
from sdp_vs_penalty.diagnosis.white_rows import ConstantErrors, WhiteData
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.shape import at_end
from sdp_vs_penalty.estimation.constants import TURNS
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.sensitivity import prior_deviation
from sdp_vs_penalty.estimation.shapes import (
    ShapeEstimate,
    changed_constant_in_words,
    with_shapes,
)
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot


def own_constant_candidates(data: WhiteData) -> Iterator[Candidate]:
    """Yield a candidate for each other value of a shape constant of the model's own
    effects.

    Such a candidate is the same effect on the same joint, with another Stribeck
    velocity, for example. Only constants that may be estimated vary.
    """
    for key, (effect, _) in data.own_effects.items():
        for name in effect.estimated:
            for value in _values_to_try(effect, key[1], name):
                other = effect.with_shape([key[1]], **{name: value})
                yield Candidate(key, other, replaces_own_constant=True)


def _values_to_try(effect: Effect, joint: int, name: str) -> list[float]:
    """List the values to try for a shape constant of the model, without the present
    one.

    They are the grid of the effect's class, which goes on in doubles up to the widest
    turn of friction that is tried (the last of TURNS), and two values near the present
    one, a quarter of the grid's smallest step below and above it, where they lie within
    that range: the grid alone did not find a width of 0.058 rad/s beside 0.032 rad/s.

    Parameters
    ----------
    effect
        The effect of the model.
    joint
        The joint (from 0), whose kind has a grid.
    """
    now = effect.shape[name]
    kind = effect.robot.joints[joint].kind
    grid = list(effect.shapes[name].on(kind).grid)
    high = max(grid[-1], TURNS[-1])
    while 2.0 * grid[-1] < high:
        grid.append(2.0 * grid[-1])
    ratio = min(b / a for a, b in pairwise(grid))
    near = [float(f"{now * ratio**step:.6g}") for step in (-STEPS[1], STEPS[1])]
    inside = [x for x in near if grid[0] < x < high]
    return sorted({high, *grid, *inside} - {now})


def changed_constants(
    terms: Sequence[ScoredEffect], model: Model
) -> list[ShapeEstimate]:
    """List the re-estimated shape constants that a search has found, with old and new
    value.

    Parameters
    ----------
    terms
        Findings that replace effects of the model by the same effect, on one joint,
        with another constant (such as a Stribeck velocity).
    model
        The model with the old values.

    Returns
    -------
    list of ShapeEstimate
        Values in SI units; ``at_end`` tells that the new one lies at the end of its
        range.
    """
    out = []
    for t in terms:
        (joint,) = t.joints  # the model's effects act on one joint each
        new = t.form.effect
        old = next(e for e in model.effects if e.name == new.name and joint in e.joints)
        for key in new.estimated:
            value = new.shape[key]
            if value == old.shape[key]:
                continue
            # Ranges are logarithmic; a constant without bounds has none.
            ends = np.log(t.form.bounds(key) or (0.0, np.inf))
            out.append(
                ShapeEstimate(
                    effect=new.name,
                    joint=joint + 1,
                    shape=key,
                    before=old.shape[key],
                    after=value,
                    gain=t.evidence,
                    at_end=at_end(float(np.log(value)), *ends.tolist()),
                )
            )
    return out


def with_constants(estimate: Estimate, constants: Sequence[ScoredEffect]) -> Estimate:
    """Return a model with re-estimated shape constants.

    Parameters
    ----------
    constants
        Its own effects on single joints, with other constants.
    """
    if not constants:
        return estimate
    changed = changed_constants(constants, estimate.model)
    effects = with_shapes(estimate.model.effects, changed)
    return replace(estimate, model=replace(estimate.model, effects=effects))


def constant_std(
    fit: WhiteFit, errors: Sequence[ConstantErrors], constant: ShapeEstimate
) -> float:
    """Return the standard deviation of a re-estimated shape constant, in its unit.

    To first order it is s * prior deviation / sqrt(information). The information is the
    squared norm of the torque that an error of the constant makes, without what the
    model and findings absorb.

    Parameters
    ----------
    fit
        The fit of the model with all findings.
    errors
        For each effect the white columns of torque per error of its constants, in units
        of the prior's deviation.

    Returns
    -------
    float
        Infinite if the rows hold less information than the prior.
    """
    name = constant.shape
    for derivatives, columns in errors:
        effect = derivatives.effect
        is_its = effect.name == constant.effect and constant.index in effect.joints
        if not is_its or name not in derivatives.keys:
            continue
        k = derivatives.keys.index(name)
        remaining = fit.residual_of(fit.scaled(columns))[:, :, k]
        information = float(np.sum(remaining**2))
        if information <= 1.0:
            return np.inf
        deviation = constant.after * prior_deviation(effect, name)
        return float(deviation / information**0.5)
    return np.inf


def retune(
    constant: ShapeEstimate,
    std: float,
    robot: Robot,
    before: Array,
    after: Array,
    is_harmful: bool = False,
) -> Retune:
    """Describe a re-estimated constant: confidence, errors and explanation.

    Parameters
    ----------
    constant
        With the values before and after.
    std
        Standard deviation of the value, in its unit.
    before
        (n,) errors on data left out with all findings, without the new value.
    after
        (n,) the same with it.
    is_harmful
        Whether it raises errors beside the certain findings alone.

    Returns
    -------
    Retune
        The report. It is weak if the value lies at the end of its range, does not lower
        its joint's error on data left out, or is harmful.
    """
    j = constant.index
    shape = effect_types()[constant.effect].shapes[constant.shape]
    rounded = replace(constant, after=float(f"{constant.after:.2g}"))
    change = changed_constant_in_words(rounded, shape, robot.joints[j].kind)
    was, now = float(before[j]), float(after[j])
    doubts = []
    if constant.at_end:
        doubts.append(Doubt("at_end"))
    # As of a finding: what does not lower the error on data left out is no setting.
    if now > (1.0 + MINOR) * was:
        doubts.append(Doubt("raises"))
    elif now > (1.0 - MINOR) * was:
        doubts.append(Doubt("not_held_out"))
    if is_harmful:
        doubts.append(Doubt("alone"))
    return Retune(
        **vars(replace(constant, std=std)),
        rmse_before=was,
        rmse_after=now,
        explanation=change,
        doubts=tuple(doubts),
    )
