"""What determines a parameter: the data, the prior, or bounds.

Of a linear function a^T theta the data alone know the variance a^T H^-1 a, H = R^T R in
units of the residual variance (infinite where no torque shows it), the prior alone a^T
H_prior^-1 a. H_prior is one independent measurement a link: 1/2 P0^-1 (x) P0^-1, the
curvature of the entropic pull at the nominal robot P0, and of the joints' own
parameters one over their scale squared. It is from the data where their variance is the
smaller one.
"""

from typing import Any

import numpy as np
import scipy

from sdp_vs_penalty.estimation.model_file import BaseEntry
from sdp_vs_penalty.estimators.estimator import Task, sample_variance
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.regression.base_parameters import BaseParameters
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, Mask

DATA = "data"


def parameter_sources(
    task: Task, theta: Array, base: BaseParameters, undetermined_by: str, nominal: Array
) -> dict[str, Any]:
    """Return what determines each standard and base parameter, as fields of
    :class:`~sdp_vs_penalty.estimation.model_file.Details`.

    Parameters
    ----------
    undetermined_by : str
        What decides where the data do not: "prior" or "bounds"
        (:attr:`Estimator.undetermined_by`).
    nominal : (p,) array
        Parameters as the robot's file states them.

    Returns
    -------
    dict
        "undetermined": source by name of each standard parameter that the data do not
        determine; "base_parameters": BaseEntry of each.
    """
    # Standard parameters are linear functions of theta, too: first them, then the base.
    rows = np.vstack([np.eye(len(theta)), base.rows])
    names = [*(p.name for p in task.model.parameters), *base.names]
    entries = []
    for name, is_determined, value, stated_value in zip(
        names,
        is_data_determined(task, rows).tolist(),
        (rows @ theta).tolist(),
        (rows @ nominal).tolist(),
        strict=True,
    ):
        source = DATA if is_determined else undetermined_by
        if name in task.model.known:
            source = "given"
        entry = BaseEntry(name, value, stated_value, source)  # type: ignore[arg-type]
        entries.append(entry)
    standard = entries[: len(theta)]
    return {
        "undetermined": {
            entry.name: entry.source for entry in standard if entry.source != DATA
        },
        "base_parameters": tuple(entries[len(theta) :]),
    }


def is_data_determined(task: Task, rows: Array) -> Mask:
    """Return whether the data determine linear functions of theta better than the
    prior.

    The data alone know a' theta with the variance a' H^-1 a, H = R' R over the residual
    variance; the prior with a' H_prior^-1 a. H_prior is one measurement a link (the
    curvature of the entropic pull at the nominal pseudo-inertia P0), and 1 / scale^2
    for the parameters of joints. The data determine the function if their variance is
    smaller.

    Returns
    -------
    (b,) array of bool
        True where the data determine a function.
    """
    variance = max(sample_variance(task), 1e-18 * task.data.tau_squared) or 1.0
    scale = task.bound if task.joint_scale is None else task.joint_scale
    # Root of the prior's information: upper triangular, half^T half = H_prior.
    half = np.diag(np.sqrt(variance) / np.where(np.isfinite(scale), scale, task.bound))
    for indices, p0 in zip(
        task.links, inertia.pseudo_inertia(task.prior_links), strict=True
    ):
        root = np.linalg.inv(np.linalg.cholesky(p0))
        whitened = (root @ inertia.PSEUDO_INERTIA_BASIS @ root.T).reshape(10, 16)
        # -log det has the curvature |P0^-1 dP|^2 / 2 beside |R theta|^2.
        curvature = 0.5 * LmiSdp.entropy * variance * (whitened @ whitened.T)
        # Unit diagonal before the factorisation: masses and moments differ by 1e6.
        size = np.sqrt(np.diagonal(curvature))
        upper = scipy.linalg.cholesky(curvature / np.outer(size, size)) * size
        half[np.ix_(indices, indices)] = upper
    # In coordinates z = half theta the prior's information is the identity, and that of
    # the data A^T A with A = R half^-1.
    inverse_half = scipy.linalg.solve_triangular(half, np.eye(len(half)), lower=False)
    _, s, vt = np.linalg.svd(task.data.R @ inverse_half, full_matrices=True)
    information = np.zeros(len(half))  # of the data, along each singular direction
    information[: len(s)] = s**2
    weight = (rows @ inverse_half @ vt.T) ** 2
    # Directions that no torque shows have next to no information: 1e-12 of the prior's.
    variance_by_data = weight @ (1.0 / np.maximum(information, 1e-12))
    variance_by_prior = weight.sum(axis=1)
    return variance_by_data < variance_by_prior
