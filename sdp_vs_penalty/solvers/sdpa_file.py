"""Sparse SDPA (.dat-s): Borchers, SDPLIB, Optimization Methods and Software 1999."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem


def sdpa_text(problem: ConicProblem) -> str:
    """Sparse SDPA: minimise c^T x subject to sum_i x_i F_i - F_0 >= 0, blocks in order of the cones."""
    sizes = [-c.size if c.kind == "nonnegative" else c.size for c in problem.cones]
    lines = [
        '"physically consistent identification of robot dynamics, by sdp-vs-penalty"',
        f"{len(problem.q)} = mDIM",
        f"{len(sizes)} = nBLOCK",
        " ".join(str(s) for s in sizes),
        " ".join(f"{x:.17g}" for x in problem.q),
    ]
    block, i, j, factor = _entries(problem.cones)
    constant = -problem.b * factor
    for row in np.flatnonzero(constant):
        lines.append(f"0 {block[row]} {i[row]} {j[row]} {constant[row]:.17g}")
    matrix = sparse.csc_matrix(problem.A)
    for k in range(matrix.shape[1]):
        for at in range(matrix.indptr[k], matrix.indptr[k + 1]):
            row = matrix.indices[at]
            value = -matrix.data[at] * factor[row]
            if value != 0.0:
                lines.append(f"{k + 1} {block[row]} {i[row]} {j[row]} {value:.17g}")
    return "\n".join(lines) + "\n"


def _entries(cones: tuple[Cone, ...]) -> tuple[Array, Array, Array, Array]:
    """For each row its block, row and column (from 1) and the factor that turns svec into entries."""
    block, i, j, factor = [], [], [], []
    for number, cone in enumerate(cones, start=1):
        if cone.kind == "psd":
            column, row = np.tril_indices(cone.size)
            weight = np.where(row == column, 1.0, 1.0 / np.sqrt(2.0))
        else:
            row = column = np.arange(cone.size)
            weight = np.ones(cone.size)
        block.append(np.full(len(row), number))
        i.append(row + 1)
        j.append(column + 1)
        factor.append(weight)
    return tuple(np.concatenate(x) for x in (block, i, j, factor))  # type: ignore[return-value]
