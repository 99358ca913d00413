"""The model and some effects by least squares, whatever the fits of the search hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.diagnosis.white_rows import WhiteData, spread_columns
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import plausible_sizes
from sdp_vs_penalty.robot.arrays import Array


def least_squares_refit(
    data: WhiteData, effects: Sequence[Effect]
) -> tuple[Array, Array]:
    """(p + k,) parameters of the model and of effects beside it, and (M, n) [N m or N]
    what these leave.

    Least squares on the white rows and on what is known of sizes, joints weighted by
    what is left of them. Parameters that rows do not tell are the model's.
    """
    columns = [
        data.raw,
        *(spread_columns(data.rows, e) for e in effects),
    ]
    all_columns = np.concatenate(columns, axis=2)
    n, _, p = all_columns.shape
    own_effects = () if data.frozen else data.estimate.model.effects
    torque = data.rows.residual if data.frozen else data.rows.torque
    theta = np.zeros(p)
    if not data.frozen:
        theta[: data.raw.shape[2]] = data.estimate.theta
    if not p:
        return theta, torque
    known = plausible_sizes((*own_effects, *effects))
    prior = np.diag(1.0 / known)
    first = theta
    white = (data.white(all_columns[j], j) for j in range(n))
    triangles = [
        _triangle_of(columns, y - columns @ first)
        for columns, y in zip(white, data.y, strict=True)
    ]
    level = np.ones(n)
    for _ in range(3):
        theta = first + _weighted_step(triangles, level, prior, -prior @ first)
        left = [_left(x, theta - first) for x in triangles]
        variance = np.array(left) / np.maximum(data.count, 1.0)
        level = np.sqrt(np.maximum(variance, 1.0 if data.known else 1e-12))
    return theta, np.asarray(torque - (all_columns @ theta).T)


def _triangle_of(columns: Array, target: Array) -> Array:
    """(p + 1, p + 1) at most, the triangle of columns (M, p) beside a target (M,)."""
    both = np.column_stack([columns, target])
    return np.asarray(np.linalg.qr(both, mode="r"))


def _left(triangle: Array, step: Array) -> float:
    """Squares that parameters leave of a target."""
    return float(np.sum((triangle[:, -1] - triangle[:, :-1] @ step) ** 2))


def _weighted_step(
    triangles: Sequence[Array],
    level: Array,
    prior: Array,
    prior_target: Array,
) -> Array:
    """(p,) least squares in all joints' rows, each divided by its level, and in what is
    known beforehand; zero where nothing tells."""
    weighted = [x / v for x, v in zip(triangles, level, strict=True)]
    A = np.vstack(
        [
            *(x[:, :-1] for x in weighted),
            prior,
        ]
    )
    right_side = np.concatenate(
        [
            *(x[:, -1] for x in weighted),
            prior_target,
        ]
    )
    norms = np.linalg.norm(A, axis=0)
    is_seen = norms > 1e-12 * norms.max(initial=0.0)
    unit = np.where(is_seen, norms, np.inf)
    return np.asarray(np.linalg.lstsq(A / unit, right_side, rcond=1e-8)[0] / unit)
