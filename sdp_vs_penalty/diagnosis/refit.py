"""A model with effects more, fitted as ``add`` fits it: by the model's own method, under its problem's
constraints, to compressed rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.constraints.constraint import ConstraintSet
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.estimator import Estimator, Progress, Task, no_progress
from sdp_vs_penalty.estimators.task import joint_weights, make_task, with_plausible
from sdp_vs_penalty.regression.regression import Regression
from sdp_vs_penalty.robot.arrays import Array


def model_beside(estimate: Estimate, new: Sequence[Effect], changes: bool = False) -> Model:
    """The estimate's model, held fixed, with effects more that refer to it; changes : of its own too."""
    every = (*estimate.model.effects, *new)
    model = replace(estimate.model, effects=every, reference=None, changes=changes)
    if not model.needs_reference:
        return model
    known = estimate.theta if estimate.model.reference is None else estimate.model.reference
    return replace(model, reference=np.append(known, np.zeros(len(model.parameters) - len(known))))


def estimator_beside(estimate: Estimate) -> Estimator:
    """The method that fits new effects to what a model leaves that is held fixed: a payload is a body,
    whatever the model was made by."""
    estimator = estimate.estimator
    return estimator if hasattr(estimator, "solver") else make_estimator(DEFAULT_METHOD)


def task_beside(
    estimate: Estimate, own: Model, left: Regression, seed: int = 0, progress: Progress = no_progress
) -> Task:
    """What fits only the new effects ``own``, under their own constraints; left : what the model leaves,
    in their columns."""
    problem, weights = estimate.problem, np.ones(estimate.robot.n)
    for _ in range(2):
        data = with_plausible(left.least_squares(weights), own, left.oversampling)
        weights = joint_weights(left, np.linalg.lstsq(data.R, data.rho, rcond=1e-9)[0])
    return Task(
        own,
        data,
        ConstraintSet(problem.constraints(own).convex),
        problem.parameter_bound(own),
        problem.nominal(own),
        problem.box,
        None,
        seed,
        progress,
    )


def fitted_parameters(
    estimate: Estimate, effects: Sequence[Effect], rows: Regression, frozen: bool
) -> Array:
    """(p,) parameters of the estimate's model with ``effects`` more, from rows in its columns; frozen :
    of the effects alone, from rows of what the model leaves."""
    if frozen and not effects:
        return np.zeros(0)
    own = tuple(effects) if frozen else (*estimate.model.effects, *effects)
    model = Model(estimate.robot, own, gains=estimate.model.gains)
    if frozen:
        task, method = task_beside(estimate, model, rows), estimator_beside(estimate)
    else:
        task = make_task(estimate.problem, model, rows, estimate.weighting)
        method = estimate.estimator
    return np.asarray(method.fit(task).theta, float)
