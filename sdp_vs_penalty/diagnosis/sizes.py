"""How large a finding is, and how well that is known: with its shape, the kept model and gains in doubt.

Coefficients are those of least squares on white rows. Their covariance has a column for each shape
constant of each pick (:mod:`~sdp_vs_penalty.estimation.shape_constants`), and what an error of a torque
makes of them: of the gains of the channels, and of a model that is held fixed.
"""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.diagnosis.fit import WhiteFit
from sdp_vs_penalty.diagnosis.stage import Stage, model_columns
from sdp_vs_penalty.diagnosis.state import SearchState
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.shape_constants import (
    ShapeSensitivity,
    covariance_beside,
    free_constants,
)
from sdp_vs_penalty.robot.arrays import Array


def coefficients(state: SearchState, k: int, errors: Array) -> tuple[Array, Array]:
    """The parameters (c,) of pick k beside the model and all other picks, and their covariance (c, c).

    errors (n M, e) : a factor of the covariance of white rows' torque, from :func:`torque_errors`.
    """
    fit = state.without(k).fit
    fresh = fit.partialled(fit.scaled(state.picks[k].candidate.columns))
    target, known = fit.residual, state.picks[k].candidate.effect.plausible
    if known is not None:  # observations, below the rows
        fresh, target = np.vstack([fresh, np.diag(1.0 / known)]), np.append(target, 0.0 * known)
    beta = np.asarray(np.linalg.lstsq(fresh, target, rcond=1e-9)[0], float)
    constants, errors = (_weighted(fit, rows) for rows in (_constants(state, k, beta), errors))
    below = (0, len(target) - len(fit.residual)), (0, 0)
    constants, errors = np.pad(constants, below), np.pad(errors, below)
    covariance = covariance_beside(fresh, constants)
    # Constants that stay on a grid are not where the loss is least: one more step shows by how much.
    step = _response(fresh, constants, target[:, None]) - beta[:, None]
    through = np.hstack([_response(fresh, constants, errors), step])
    return beta, covariance + through @ through.T


def _weighted(fit: WhiteFit, columns: Array) -> Array:
    """Beside the model's columns, as rows are weighted."""
    return fit.partialled(fit.scaled(columns)) if columns.shape[1] else columns


def _response(columns: Array, constants: Array, errors: Array) -> Array:
    """(c, e) what errors (N, e) of the torque do to the coefficients of columns beside constants."""
    c, s = columns.shape[1], constants.shape[1]
    everything = np.hstack([columns, constants])
    information = everything.T @ everything
    information[c:, c:] += np.eye(s)
    return np.asarray(np.linalg.pinv(information, rcond=1e-12)[:c] @ (everything.T @ errors), float)


def _constants(state: SearchState, k: int, beta: Array) -> Array:
    """(n M, s) white columns of the shape constants of all picks; ``beta`` are pick k's parameters."""
    judge, parts = state.stage.candidates, []
    for i, pick in enumerate(state.picks):
        effect = pick.candidate.effect
        theta = beta if i == k else pick.candidate.beta
        if free_constants(effect):
            parts.append(judge.white_columns(ShapeSensitivity(effect, theta)))
    rows = state.stage.rows
    return np.hstack([np.zeros((rows.n * len(rows.t), 0)), *parts])


def torque_errors(stage: Stage, estimate: Estimate, gain_errors: Array) -> Array:
    """(n M, e) white rows of the torque that is in doubt before anything is searched.

    gain_errors (n, e) : a factor of the covariance of the channels' gains. A model that is held fixed
    brings its parameters' spread along, and what the same gains have made of them.
    """
    known, rows = estimate.uncertainty, stage.rows
    n, M = rows.n, len(rows.t)
    if not stage.frozen and not gain_errors.any():
        return np.zeros((n * M, 0))
    columns = model_columns(rows, estimate)
    parts = []
    for j in range(n):
        gains = -columns[j] @ known.gains
        gains[:, j] += rows.torque[:, j]
        part = gains @ gain_errors
        if stage.frozen:
            part = np.hstack([part, -columns[j] @ known.spread])
        parts.append(stage.noise.whiten(part, j, rows.pieces(j)))
    return np.concatenate(parts)
