"""The block bootstrap of the certified estimate: how far parameters that are held by physics and priors
move when other stretches of the same motion had been measured.

Intervals of :mod:`uncertainty` are of least squares, cut where constraints begin. Here blocks of time
are drawn anew (Kuensch, Annals of Statistics 1989) and each draw is solved and certified as the estimate
itself is. In the coordinates in which all rows together have the identity for their products, G_b are
those of block b, and a draw that holds it w_b times has the factor chol(sum_b w_b G_b) R: no row is
looked at again, and no digit is lost, since the sum of all G_b is at most one.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas

from sdp_vs_penalty.data.files import Source
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.pose import PoseOptions, pose
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.estimator import Estimator
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.estimators.sdp_fit import PosedSdp
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.partial import visible
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.solvers.objective import Objective
from sdp_vs_penalty.solvers.verified import TIGHT


def bootstrap(
    problem: str | Path | Problem,
    measurements: Source,
    draws: int = 200,
    method: str | Estimator = DEFAULT_METHOD,
    *,
    effects: str | Sequence[str] | Sequence[Effect] | None = None,
    seed: int = 0,
) -> pandas.DataFrame:
    """Certified estimates from ``draws`` resamples of the blocks of time, a twentieth of a run each: a
    row a draw, of each parameter a column [SI], and "gap", the certified one relative to the loss.

    problem, measurements, method, effects : as :func:`~sdp_vs_penalty.estimation.identify.identify`
    takes them; shape constants and the joints' weights stay those of all measurements. Raises
    InputError as it does, and for a method that is no torque SDP.
    """
    estimator = make_estimator(method)
    if not isinstance(estimator, LmiSdp):
        raise InputError(f"method {estimator.name} is not drawn anew", "choose lmi-sdp, or one named so")
    posed = pose(problem, measurements, PoseOptions(effects, seed=seed))
    task, regression = posed.task, posed.regression
    objective, constraints = estimator.posed(task)
    data, sdp = objective.least_squares, PosedSdp(task, objective, constraints, estimator.solver)
    first = sdp.fit(objective, estimator.accuracy)
    p, count = len(task.bound), len(regression.blocks)
    whole = np.vstack([np.column_stack([data.R, data.rho]), np.append(np.zeros(p), data.residual_norm)])
    U, V = visible(whole)
    grams, into = np.zeros((count, V.shape[1], V.shape[1])), U.T @ whole
    for joint, indices, blocks, rows in regression.by_joint():
        seen = task.weights[joint] * rows @ V[np.append(indices, p)]
        grams[blocks] += seen.swapaxes(1, 2) @ seen
    # A direction that no drawn block shows keeps what rounding is worth.
    priors = np.eye(V.shape[1]) * (1.0 + len(V) * np.finfo(float).eps) - grams.sum(axis=0)
    found, rng = np.empty((draws, p + 1)), np.random.default_rng(seed)
    for row in found:
        times = rng.multinomial(count, np.full(count, 1.0 / count))
        rows = np.linalg.cholesky(priors + np.tensordot(times, grams, 1)).T @ into
        drawn = LeastSquares(rows[:, :p], rows[:, p], 0.0, float(rows[:, p] @ rows[:, p]), data.rows)
        fit = sdp.fit(Objective(drawn, objective.entropy), 0.5 * TIGHT, near=first)
        row[:] = np.append(task.model.with_known(fit.theta), fit.gap)
    return pandas.DataFrame(found, columns=[*(q.name for q in task.model.parameters), "gap"])
