"""The model and some effects by least squares, whatever the fits of the search hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.diagnosis.white_rows import WhiteData, spread_columns
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import plausible_sizes
from sdp_vs_penalty.regression.linalg import min_norm_lstsq
from sdp_vs_penalty.regression.regression import triangular
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.inertia import link_sizes


def least_squares_refit(
    data: WhiteData, effects: Sequence[Effect]
) -> tuple[Array, Array]:
    """Fit the model and more effects together by weighted least squares, without
    constraints.

    Each joint's rows are divided by the RMS of its residual, which is updated three
    times. Plausible sizes of the parameters are priors. Combinations of parameters that
    the rows do not determine keep the model's values, and the links' parameters change
    by no more than a link's size where the rows hardly determine them: a tilted base
    shows moments of links that upright gravity does not.

    Parameters
    ----------
    data
        White rows (weighted so that the noise is independent with variance 1), with the
        model.
    effects
        The effects beside it, with k parameters.

    Returns
    -------
    (p + k,) array
        Parameters in SI units, the model's first; a frozen model has p = 0.
    (M, n) array
        The residual torque [N m or N], not whitened.
    """
    blocks = [data.raw, *(spread_columns(data.rows, e) for e in effects)]

    def columns_on(joint: int) -> Array:
        """Return the columns (M, p + k) of the model and the effects on a joint."""
        return np.hstack([block[joint] for block in blocks])

    n = data.n
    p = sum(block.shape[2] for block in blocks)
    own_effects = () if data.frozen else data.estimate.model.effects
    torque = data.rows.residual if data.frozen else data.rows.torque
    first = np.zeros(p)
    if not data.frozen:
        first[: data.X.shape[2]] = data.estimate.theta
    if not p:
        return first, torque
    # Rows of the prior: theta / plausible size = 0, and links = those of the model.
    precision = 1.0 / plausible_sizes((*own_effects, *effects))
    prior_target = -precision * first
    links = data.estimate.model.rigid_indices  # none in a model of friction alone
    if not data.frozen and len(links):
        precision[links] = 1.0 / link_sizes(data.estimate.problem.nominal_links).ravel()
        prior_target[links] = 0.0
    prior = np.column_stack([np.diag(precision), prior_target])
    # Steps are taken from the model's values: what no row determines stays there.
    triangles = []
    for j in range(n):
        white = data.white(columns_on(j), j)
        triangles.append(
            triangular([np.column_stack([white, data.y[j] - white @ first])])
        )
    smallest_variance = 1.0 if data.noise_is_known else 1e-12
    level = np.ones(n)
    for _ in range(3):
        scaled = [x / of_joint for x, of_joint in zip(triangles, level, strict=True)]
        rows = np.vstack([prior, *scaled])
        step = min_norm_lstsq(rows[:, :-1], rows[:, -1])
        left = [triangle[:, -1] - triangle[:, :-1] @ step for triangle in triangles]
        squares = np.array([np.sum(of_joint**2) for of_joint in left])
        variance = squares / np.maximum(data.count, 1.0)
        level = np.sqrt(np.maximum(variance, smallest_variance))
    theta = first + step
    modelled = np.column_stack([columns_on(j) @ theta for j in range(n)])
    return theta, (torque - modelled)
