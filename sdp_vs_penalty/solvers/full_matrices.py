"""Psd cones as all d^2 entries of a matrix, for solvers that read matrices so (CVXOPT, SDPA, QICS)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from sdp_vs_penalty.solvers.conic import Cone, ConicProblem
from sdp_vs_penalty.solvers.rewrite import Rewritten


def full_matrices(problem: ConicProblem) -> tuple[Rewritten, dict[str, object]]:
    """Rows of psd cones become d^2 entries; with the sizes of the cones under CVXOPT's names.

    The rewritten problem keeps the cones of the original: its rows no longer match Cone.rows. A
    solver may return any matrix; back takes its lower triangle, which is what CVXOPT fills.
    """
    maps, backs = [], []
    for cone in problem.cones:
        if cone.kind == "psd":
            out, home = _expand(cone)
            maps.append(out)
            backs.append(home)
        else:
            maps.append(sparse.identity(cone.rows, format="csr"))
            backs.append(maps[-1])
    out = sparse.block_diag(maps, format="csr")
    home = sparse.block_diag(backs, format="csr")
    made = replace(problem, A=sparse.csc_matrix(out @ problem.A), b=out @ problem.b)
    dims: dict[str, object] = {
        "l": sum(c.size for c in problem.cones if c.kind == "nonnegative"),
        "q": [c.size for c in problem.cones if c.kind == "soc"],
        "s": [c.size for c in problem.cones if c.kind == "psd"],
    }
    return Rewritten(made, lambda x, z: (x, home @ z)), dims


def _expand(cone: Cone) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """From svec to all entries (column-major; symmetric, so row-major too), and from those to svec."""
    d = cone.size
    j, i = np.tril_indices(d)  # svec runs over (i, j), i <= j, column by column
    k = np.arange(len(i))
    root = np.sqrt(2.0)
    value = np.where(i == j, 1.0, 1.0 / root)
    off = i != j
    out = sparse.csr_matrix(
        (
            np.concatenate([value, value[off]]),
            (np.concatenate([i * d + j, (j * d + i)[off]]), np.concatenate([k, k[off]])),
        ),
        (d * d, len(k)),
    )
    # Column-major: entry (row j, column i) of the lower triangle stands at i * d + j.
    home = sparse.csr_matrix((np.where(i == j, 1.0, root), (k, i * d + j)), (len(k), d * d))
    return out, home
