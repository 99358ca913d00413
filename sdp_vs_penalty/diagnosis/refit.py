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
    columns = [data.raw, *(spread_columns(data.rows, e) for e in effects)]
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
    white = np.stack([data.white(all_columns[j], j) for j in range(n)])
    first = theta
    target = data.y - white @ first
    level = np.ones(n)
    for _ in range(3):
        A = np.vstack([(white / level[:, None, None]).reshape(-1, p), prior])
        norms = np.linalg.norm(A, axis=0)
        is_seen = norms > 1e-12 * norms.max(initial=0.0)
        unit = np.where(is_seen, norms, np.inf)
        right_side = np.append(target / level[:, None], -prior @ first)
        step = np.linalg.lstsq(A / unit, right_side, rcond=1e-8)[0]
        theta = first + step / unit
        left = np.sum((data.y - white @ theta) ** 2, axis=1)
        variance = left / np.maximum(data.count, 1.0)
        level = np.sqrt(np.maximum(variance, 1.0 if data.known else 1e-12))
    return theta, np.asarray(torque - (all_columns @ theta).T)
