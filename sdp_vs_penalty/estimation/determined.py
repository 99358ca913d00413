"""Which parameters the data determine, and which the prior: resolution, parameter by parameter.

Beside the data's information H = R^T R stands that of the prior, sigma^2 times that of one independent
measurement a link: 1/2 P0^-1 (x) P0^-1, the curvature of the entropic pull at the nominal robot P0, and
of the joints' own parameters one over their scale squared. For a linear function a^T theta the data's
share

    a^T C H C a / a^T C a,      C = (H + H_prior)^-1,

is the share of what is known of it that the data say (the resolution of linear inverse theory: Backus,
Gilbert 1970; Tarantola 2005, sec. 3.2). Above one half it is from the data, else from the prior: for a
method without a prior that is where its answer is an accident of the bounds.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from sdp_vs_penalty.estimation.uncertainty import base_rows
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import DEFAULT_ENTROPY, sample_variance
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot import inertia

Array = NDArray[np.float64]

DATA, PRIOR = "data", "prior"
#: Share of the information from which on a parameter counts as the data's.
_HALF = 0.5


def base_record(problem: Problem, task: Task, theta: Array) -> list[dict[str, Any]]:
    """What model.json says of the base parameters: name, value, nominal value, and who determines it."""
    rows, names, _ = base_rows(problem, task.model)
    kinds = sources(task, rows)
    values = zip(names, rows @ theta, rows @ task.nominal, kinds, strict=True)
    return [
        {"name": name, "value": float(value), "nominal": float(nominal), "source": kind}
        for name, value, nominal, kind in values
    ]


def record(problem: Problem, task: Task, theta: Array) -> dict[str, Any]:
    """For the details of an estimate: the parameters that are the prior's, and all base parameters."""
    kinds = zip(task.model.parameters, sources(task), strict=True)
    return {
        "from_prior": [parameter.name for parameter, kind in kinds if kind == PRIOR],
        "base_parameters": base_record(problem, task, theta),
    }


def sources(task: Task, rows: ArrayLike | None = None) -> tuple[str, ...]:
    """Of each linear function in rows (b, p) of theta "data" or "prior"; default: of each parameter."""
    share = data_share(task, np.eye(len(task.bound)) if rows is None else np.asarray(rows, float))
    return tuple(DATA if x > _HALF else PRIOR for x in share)


def data_share(task: Task, rows: Array) -> Array:
    """(b,) the data's share of the information on linear functions, rows (b, p), of theta: 0 to 1."""
    half = _prior_factor(task)
    # In coordinates z = half theta the prior is the identity: H becomes A^T A.
    into = scipy.linalg.solve_triangular(half, np.eye(len(half)), lower=False)
    a = rows @ into
    _, s, vt = np.linalg.svd(task.data.R @ into, full_matrices=True)
    information = np.zeros(len(half))
    information[: len(s)] = s**2
    weight = (a @ vt.T) ** 2 / (1.0 + information)
    total = weight.sum(axis=1)
    return np.asarray((weight * (information / (1.0 + information))).sum(axis=1) / total)


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
