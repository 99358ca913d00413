"""Classical least squares (CLS): no constraint, the lowest loss of all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.estimators.estimator import Array, Estimator, Fit, Task
from sdp_vs_penalty.solvers.conic import Objective


@dataclass(frozen=True)
class Ols(Estimator):
    """pi_hat = argmin |W pi - tau|^2 (Gautier, Khalil; Gaz et al. 2019, eq. 13).

    Determines base parameters only; theta is the minimiser nearest to the nominal robot, and in
    general not physically consistent.
    """

    name = "ols"
    description = "classical least squares, no constraints (the paper's CLS)"

    def fit(self, task: Task) -> Fit:
        return Fit(task.ols, Objective(task.data), task.constraints)


def standard_deviations(task: Task, independent_rows: float) -> tuple[Array, Array]:
    """Base parameters pi_hat (b,) and their classical standard deviations (b,).

    C = sigma^2 (W^T W)^-1 with sigma^2 = loss / (rows - b) (Gaz et al. 2019, eq. 14), times the
    rows per independent sample: filtered rows repeat each other. Infinite for what is not excited.
    """
    base = task.base
    pi = base @ task.ols
    # W pi = Y theta for every theta: W = Y B^+.
    w = task.data.R @ np.linalg.pinv(base)
    norms = np.linalg.norm(w, axis=0)
    seen = norms > 1e-10 * norms.max()
    _, s, vt = np.linalg.svd(w[:, seen] / norms[seen], full_matrices=False)
    good = s > 1e-9 * s[0]
    dof = max(task.data.rows / independent_rows - len(pi), 1.0)
    variance = task.data.loss(task.ols) / independent_rows / dof * independent_rows
    out = np.full(len(pi), np.inf)
    spread = np.sqrt(np.sum((vt[good].T / s[good]) ** 2, axis=1)) / norms[seen]
    hidden = np.sum(vt[~good] ** 2, axis=0) > 1e-6 if (~good).any() else np.zeros(seen.sum(), bool)
    out[seen] = np.where(hidden, np.inf, np.sqrt(variance) * spread)
    return pi, out
