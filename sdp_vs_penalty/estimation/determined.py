"""Which parameters the data determine, and which the prior: who alone would know them better.

Of a linear function a^T theta the data alone know the variance a^T H^-1 a, H = R^T R in units of the
residual variance (infinite where no torque shows it), the prior alone a^T H_prior^-1 a. H_prior is one
independent measurement a link: 1/2 P0^-1 (x) P0^-1, the curvature of the entropic pull at the nominal
robot P0, and of the joints' own parameters one over their scale squared. The data's share of what both
know, prior variance over the sum of the two, decides: above one half the parameter is from the data.
For a method without a prior the rest is where its answer is an accident of the bounds.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg

from sdp_vs_penalty.estimation.constants import DATA_SHARE
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import DEFAULT_ENTROPY
from sdp_vs_penalty.estimators.task import sample_variance
from sdp_vs_penalty.regression.base_parameters import BaseParameters
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array

DATA = "data"


def record(task: Task, theta: Array, base: BaseParameters, rest: str) -> dict[str, Any]:
    """For the details of an estimate: the parameters that the data leave open, and all base parameters
    with name, value, nominal value and who determines them.

    rest : what decides where the data do not (:attr:`Estimator.rest`).
    """
    own, base_own = np.split(
        data_share(task, np.vstack([np.eye(len(theta)), base.rows])) > DATA_SHARE, [len(theta)]
    )
    values = zip(base.names, base.rows @ theta, base.rows @ task.nominal, base_own, strict=True)
    open_ones = [p.name for p, seen in zip(task.model.parameters, own, strict=True) if not seen]
    return {
        "undetermined": dict.fromkeys(open_ones, rest),
        "base_parameters": [
            {
                "name": name,
                "value": float(value),
                "nominal": float(nominal),
                "source": DATA if seen else rest,
            }
            for name, value, nominal, seen in values
        ],
    }


def data_share(task: Task, rows: Array) -> Array:
    """(b,) the data's share of the information on linear functions, rows (b, p), of theta: 0 to 1."""
    half = _prior_factor(task)
    # In coordinates z = half theta the prior is the identity: H becomes A^T A.
    into = scipy.linalg.solve_triangular(half, np.eye(len(half)), lower=False)
    a = rows @ into
    _, s, vt = np.linalg.svd(task.data.R @ into, full_matrices=True)
    information = np.zeros(len(half))
    information[: len(s)] = s**2
    weight = (a @ vt.T) ** 2
    # Information of the data in a direction that no torque shows, in the prior's.
    data, prior = weight @ (1.0 / np.maximum(information, 1e-12)), weight.sum(axis=1)
    return np.asarray(prior / (prior + data))


def _prior_factor(task: Task) -> Array:
    """(p, p) upper triangular U with U^T U the prior's information."""
    p = len(task.bound)
    variance = max(sample_variance(task), 1e-18 * task.data.tau_squared) or 1.0
    scale = np.full(p, np.inf) if task.joint_scale is None else task.joint_scale
    out = np.diag(np.sqrt(variance) / np.where(np.isfinite(scale), scale, task.bound))
    for indices, p0 in zip(task.links, inertia.pseudo_inertia(task.prior_links), strict=True):
        root = np.linalg.inv(np.linalg.cholesky(p0))
        whitened = (root @ inertia.PSEUDO_INERTIA_BASIS @ root.T).reshape(10, 16)
        # -log det has the curvature |P0^-1 dP|^2 / 2 beside |R theta|^2.
        information = 0.5 * DEFAULT_ENTROPY * variance * (whitened @ whitened.T)
        out[np.ix_(indices, indices)] = _upper(information)
    return out


def _upper(information: Array) -> Array:
    """U (d, d) with U^T U = information, balanced first: masses and moments differ by 1e6."""
    size = np.sqrt(np.diagonal(information))
    return np.asarray(scipy.linalg.cholesky(information / np.outer(size, size)) * size)
