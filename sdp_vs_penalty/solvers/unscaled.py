"""The same problem as users write it: no centre, no scaling of parameters or cones.

    gram   minimise theta^T (R^T R) theta - 2 rho^T R theta, whose constant rho^T rho is left out
    rows   minimise |z|^2 subject to R theta - z = rho

What :func:`conic.least_squares_sdp` does better, the shootout's ill-conditioned instances show.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import sparse

from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, svec
from sdp_vs_penalty.solvers.identification import Placed, SdpProblem


def gram_sdp(
    data: LeastSquares, constraints: Sequence[Constraint], precision: Any = float
) -> SdpProblem:
    """The bare quadratic form; precision : of the Gram matrix's sums (float, numpy.float32)."""
    R, rho = data.R.astype(precision), data.rho.astype(precision)
    P = np.triu(2.0 * (R.T @ R).astype(float))
    q = -2.0 * (R.T @ rho).astype(float)
    offset = float(data.rho @ data.rho) + data.residual_norm**2
    return _posed(sparse.csc_matrix(P), q, [], np.zeros(0), constraints, len(q), offset)


def rows_sdp(data: LeastSquares, constraints: Sequence[Constraint]) -> SdpProblem:
    """The residual as variables of their own, one for each row of R."""
    r, p = data.R.shape
    P = sparse.diags(np.concatenate([np.zeros(p), np.full(r, 2.0)])).tocsc()
    equal = sparse.hstack([sparse.csr_matrix(data.R), -sparse.identity(r)])
    return _posed(P, np.zeros(p + r), [equal], data.rho, constraints, p, data.residual_norm**2)


def _posed(
    P: sparse.csc_matrix,
    q: Array,
    equal: list[Any],
    right: Array,
    constraints: Sequence[Constraint],
    p: int,
    offset: float,
) -> SdpProblem:
    blocks, b = list(equal), [right]
    cones = [Cone("zero", len(right))] if len(right) else []
    placed, start = [], len(right)
    for c in constraints:
        psd = c.cone == "psd"
        constant = svec(c.constant) if psd else c.constant
        columns = svec(c.coefficients) if psd else c.coefficients
        k, row = np.nonzero(columns)
        shape = (len(constant), len(q))
        blocks.append(sparse.csr_matrix((-columns[k, row], (row, c.indices[k])), shape))
        b.append(constant)
        cones.append(Cone(c.cone, len(c.constant)))
        d = len(c.constant)
        placed.append(Placed(c, start, np.eye(d) if psd else np.ones(d)))
        start += len(constant)
    conic = ConicProblem(P, q, sparse.csc_matrix(sparse.vstack(blocks)), np.concatenate(b), tuple(cones))
    return SdpProblem(conic, np.zeros(p), np.ones(p), 1.0, tuple(placed), offset)
