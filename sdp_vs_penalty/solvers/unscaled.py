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
from sdp_vs_penalty.solvers.conic import svec
from sdp_vs_penalty.solvers.identification import RowBuilder, SdpProblem


def gram_sdp(
    data: LeastSquares, constraints: Sequence[Constraint], precision: Any = float
) -> SdpProblem:
    """The bare quadratic form; precision : of the Gram matrix's sums (float, numpy.float32)."""
    R, rho = data.R.astype(precision), data.rho.astype(precision)
    P = np.triu(2.0 * (R.T @ R).astype(float))
    q = -2.0 * (R.T @ rho).astype(float)
    offset = float(data.rho @ data.rho) + data.residual_norm**2
    return _posed(RowBuilder(len(q)), len(q), sparse.csc_matrix(P), q, constraints, offset)


def rows_sdp(data: LeastSquares, constraints: Sequence[Constraint]) -> SdpProblem:
    """The residual as variables of their own, one for each row of R."""
    r, p = data.R.shape
    P = sparse.diags(np.concatenate([np.zeros(p), np.full(r, 2.0)])).tocsc()
    pieces = RowBuilder(p + r)
    pieces.rows("zero", sparse.hstack([sparse.csr_matrix(data.R), -sparse.identity(r)]), data.rho)
    return _posed(pieces, p, P, np.zeros(p + r), constraints, data.residual_norm**2)


def _posed(
    pieces: RowBuilder,
    p: int,
    P: sparse.csc_matrix,
    q: Array,
    constraints: Sequence[Constraint],
    offset: float,
) -> SdpProblem:
    placed = []
    for c in constraints:
        psd, d = c.cone == "psd", len(c.constant)
        constant, columns = (svec(x) if psd else x for x in (c.constant, c.coefficients))
        placed.append(pieces.place(c, np.eye(d) if psd else np.ones(d), constant, columns))
    return SdpProblem(pieces.problem(P, q), np.zeros(p), np.ones(p), 1.0, tuple(placed), offset)
