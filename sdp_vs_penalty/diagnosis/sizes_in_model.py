"""Sizes of findings as the model that holds them has them: one estimate, one interval.

The search estimates each finding beside the others by linear algebra. What a user works
with is the model after `add`, under all constraints. So sizes are that model's wherever
one is there. The two estimates weigh rows differently, so that what both lack makes them
differ: the interval is as wide as the wider of theirs, and their difference is added,
and so is the error of the law that is tolerated.
The model itself takes this interval when findings are added, so that every place which
shows the size reads one interval: the model's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.diagnosis.conclude import physics_of
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.diagnosis.finding import Finding
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.sizes import is_insignificant, is_uncertain, size_of
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.robot.arrays import Indices

#: Share of its standard deviation below which a size is held at its bound, zero: one
#: that is free is as near to zero once in a thousand times.
_AT_BOUND = 1e-3


def with_sizes_of(diagnosis: Diagnosis, model: Estimate) -> Diagnosis:
    """Replace the sizes and intervals of a diagnosis's findings by those of a model.

    Parameters
    ----------
    model
        A model that was made by adding its findings; one that it lacks stays unchanged.
    """
    sized = tuple(size_in_model(finding, model) for finding in diagnosis.effects)
    return replace(diagnosis, effects=sized)


def size_in_model(finding: Finding, model: Estimate) -> Finding:
    """Replace a finding's size, interval and constants by those that a model has.

    A finding becomes weak if its size there may be zero, a confident one also if the
    size is less than five standard deviations from zero. The tolerated error of its law
    is no such doubt: another law changes the number, but hardly the torque. A finding
    whose torque is in doubt does not help if its size there may be zero.

    Parameters
    ----------
    model
        The model, with its covariance.

    Returns
    -------
    Finding
        Unchanged if the model lacks the effect or has no finite covariance for it.
    """
    held = effect_of(finding, model)
    if held is None:
        return finding
    effect, indices = held
    theta = model.theta[indices]
    covariance = model.uncertainty.covariance[np.ix_(indices, indices)]
    if not np.all(np.isfinite(covariance)):
        return finding
    size, std = size_of(effect, theta, covariance)
    doubts = finding.doubts
    std_without_law = max(std**2 - finding.std_of_law**2, 0.0) ** 0.5
    may_be_zero = is_insignificant(size, std_without_law)
    if abs(size) < _AT_BOUND * std:
        doubts = (*doubts, Doubt("no_torque"))
    elif may_be_zero:
        doubts = tuple(dict.fromkeys((*doubts, Doubt("insignificant"))))
    elif not doubts and is_uncertain(size, std_without_law):
        doubts = (Doubt("uncertain"),)
    is_open = any(doubt.leaves_torque_open for doubt in doubts)
    return replace(
        finding,
        shape=dict(effect.shape),
        constants=effect.constants,
        size=size,
        std=std,
        doubts=doubts,
        helps=finding.helps and not (may_be_zero and is_open),
        parameters={
            p.name: float(value)
            for p, value in zip(effect.parameters, theta, strict=True)
        },
        physics=physics_of(effect, size),
    )


def with_intervals_of_search(model: Estimate, findings: Sequence[Finding]) -> Estimate:
    """Widen a model's intervals of the findings that it holds, by what the search says.

    The standard deviation of a finding's size becomes that of two estimates of it
    (:func:`std_of_both`). A load that has to be a body keeps the model's interval: the
    search ignores that condition.

    Parameters
    ----------
    model
        The model to which the findings were added.
    findings
        The findings, with the sizes of the search.

    Returns
    -------
    Estimate
        The model with wider intervals; unchanged without findings.
    """
    factors = np.ones(len(model.theta))
    for finding in findings:
        held = effect_of(finding, model)
        if held is None or held[0].frozen_only:
            continue
        effect, indices = held
        covariance = model.uncertainty.covariance[np.ix_(indices, indices)]
        if not np.all(np.isfinite(covariance)):
            continue
        size, std = size_of(effect, model.theta[indices], covariance)
        if std > 0.0:
            sized = indices[effect.sized_by]
            factor = std_of_both(size, std, finding) / std
            factors[sized] = np.maximum(factors[sized], factor)
    if np.all(factors == 1.0):
        return model
    base = base_rows(model.model, model.problem.independent).rows
    return replace(model, uncertainty=model.uncertainty.widened(factors, base))


def std_of_both(size: float, std: float, finding: Finding) -> float:
    """Return the standard deviation of a finding's size from two estimates of it.

    Parameters
    ----------
    size
        Size in a model, in the parameter's SI unit.
    finding
        The finding, with the size of the search, and its scatter over the log.

    Returns
    -------
    float
        Root of the sum of squares of the larger standard deviation, of the difference
        of both sizes, which counts as a half width of 95 %, and of what the tolerated
        error of the law adds.
    """
    size_in_search = finding.size_in_search
    if size_in_search is None:  # findings.json of an older version
        size_in_search = finding.size
    difference = (abs(size) - abs(size_in_search)) / NORMAL_95
    of_both = np.hypot(max(std, finding.std_of_rows), difference)
    return float(np.hypot(of_both, finding.std_of_law))


def effect_of(finding: Finding, model: Estimate) -> tuple[Effect, Indices] | None:
    """Find the effect of a model that a finding is about.

    It has the finding's name, joints and law (constants with few choices). Of several
    such effects the one with most equal shape constants is returned, and of equal ones
    the last, which was added last.

    Parameters
    ----------
    finding
        The finding; its joints count from 1.

    Returns
    -------
    (Effect, int array) or None
        The effect and the indices of its parameters in theta; None if there is none.
    """
    joints = tuple(j - 1 for j in finding.joints)
    held = None
    most_equal = -1
    for effect, indices in model.model.parts:
        on_joints = () if effect.whole_robot else tuple(effect.joints)
        if effect.name != finding.effect or on_joints != joints:
            continue
        laws = effect.law_constants.items()
        if any(
            finding.shape.get(name, constant) != constant for name, constant in laws
        ):
            continue
        n_equal = sum(effect.shape.get(k) == x for k, x in finding.shape.items())
        if n_equal >= most_equal:
            held = effect, indices
            most_equal = n_equal
    return held
