"""From a problem and compressed measurements to what an estimator is given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import unknown
from sdp_vs_penalty.estimators.estimator import Progress, Task, no_progress
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import LeastSquares, Regression

#: Farthest that a guessed mass is rescaled, up or down: the EMPS's carriage weighs 240 times what is
#: drawn for it.
_WRONG_BY = 1000.0


def make_task(
    problem: Problem,
    model: Model,
    regression: Regression,
    weighting: str = "noise",
    seed: int = 0,
    progress: Progress = no_progress,
) -> Task:
    """What an estimator needs to know, from a problem and compressed measurements."""
    nominal, bound = problem.nominal(model), problem.parameter_bound(model)
    links = model.rigid_indices.reshape(-1, 10)
    masses = model.with_known(nominal)[links[:, :1]]  # a link of a known mass is scaled to it
    nominal[links] *= masses / nominal[links[:, :1]]
    nominal = model.with_known(nominal)
    plain = Task(
        model,
        with_plausible(regression.least_squares(), model, regression.oversampling),
        problem.constraints(model),
        bound,
        nominal,
        problem.box,
        problem.independent,
        seed,
        progress,
        None,
        problem.body_constraints(model),
    )
    plain = replace(plain, joint_scale=joint_scale(regression, model, plain.ols))
    if weighting not in ("noise", "none"):
        raise unknown("weighting", weighting, ("noise", "none"))
    if weighting == "noise":
        data = regression.least_squares(joint_weights(regression, plain.ols))
        plain = replace(plain, data=with_plausible(data, model, regression.oversampling))
    guessed = problem.guessed_links
    total = None if np.any(guessed) else float(nominal[plain.links[:, 0]].sum())
    return replace(plain, prior=scaled_prior(plain, guessed), total=total)


def with_plausible(data: LeastSquares, model: Model, oversampling: float) -> LeastSquares:
    """The data with what the model's effects know of their parameters beforehand, each an observation
    as good as an independent row whose noise is what least squares leave."""
    if not np.isfinite(model.plausible).any():
        return data
    variance = data.residual_norm**2 / max(data.rows - data.R.shape[1], 1)
    return data.with_prior(model.plausible, oversampling * variance)


def scaled_prior(task: Task, guessed: np.ndarray) -> np.ndarray:
    """(n, 10) nominal links, guessed masses times the one factor with which they fit the torque best.

    A link of which nobody stated a mass may weigh 1 kg or 90; of all of them together the torque says
    it well. Least squares in the factor and the joints' own parameters, the other links as stated.
    """
    links = task.nominal[task.links]
    if not len(links) or not np.any(guessed):
        return links
    R, own = task.data.R, np.setdiff1d(np.arange(task.data.R.shape[1]), task.links)
    stated = R[:, task.links[~guessed].ravel()] @ links[~guessed].ravel()
    guess = R[:, task.links[guessed].ravel()] @ links[guessed].ravel()
    columns = np.column_stack([guess, R[:, own]])
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    factor = np.linalg.lstsq(columns / size, task.data.rho - stated, rcond=1e-9)[0][0] / size[0]
    out = links.copy()
    out[guessed] *= np.clip(factor, 1.0 / _WRONG_BY, _WRONG_BY) if factor > 0.0 else 1.0
    return out


def joint_scale(regression: Regression, model: Model, theta: np.ndarray) -> np.ndarray:
    """(p,) |tau_j| / |Y_jk| for parameters that are not a link's, infinite for links and idle ones.

    theta : of a first pass, whose drives' torque counts where it is larger than what was measured."""
    scale, gains = np.full(regression.p, np.inf), np.where(model.drives, theta, 0.0)
    for factor in regression.per_joint:
        norms = np.linalg.norm(factor.triangle[:, :-1], axis=0)
        drive = factor.triangle[:, :-1] @ gains[factor.indices]
        torque = float(max(np.linalg.norm(factor.triangle[:, -1]), np.linalg.norm(drive)))
        seen = (norms > 0.0) & ~np.isin(factor.indices, model.rigid_indices)
        seen &= ~model.drives[factor.indices]  # they cancel: each is many times as large as the sum
        if torque > 0.0:
            where = factor.indices[seen]
            scale[where] = np.minimum(scale[where], torque / norms[seen])
    return scale


def joint_weights(regression: Regression, theta: np.ndarray) -> np.ndarray:
    """(n,) weights sigma / sigma_j from residuals of a first pass, sigma their root mean square.

    A joint whose residual is below 1e-6 of its torque counts as that exact, so that noise-free data
    are not weighted by rounding.
    """
    rows = np.maximum(regression.joint_rows(), 1)
    torque = np.array([float(np.sum(f.triangle[:, -1] ** 2)) for f in regression.per_joint])
    variance = np.maximum(regression.joint_losses(theta), 1e-12 * torque) / rows
    if not np.any(variance > 0.0):
        return np.ones(len(rows))
    variance = np.maximum(variance, 1e-12 * variance.max())
    return np.sqrt(variance.mean() / variance)


def with_joint_prior(task: Task) -> Task:
    """The task with the pull of joint parameters to zero that ``lmi-sdp`` has, for any method."""
    if task.joint_scale is None:
        return task
    return replace(task, data=task.data.with_prior(task.joint_scale, sample_variance(task)))


def sample_variance(task: Task) -> float:
    """Residual variance of one filtered torque row in unconstrained least squares."""
    return task.data.loss(task.ols) / max(task.data.rows, 1)
