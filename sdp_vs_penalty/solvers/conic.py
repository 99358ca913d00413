"""The standard conic form that every solver gets, and its files.

    minimise 1/2 x^T P x + q^T x   subject to   A x + s = b,  s in K = K_1 x K_2 x ...

K_i is one of "zero", "nonnegative", "soc" (axis first), "psd" (svec: upper triangle
column by column, off-diagonals times sqrt(2)), "exp" {(x, y, z): y exp(x / y) <= z}.
Files are sparse SDPA (.dat-s; Borchers, Optimization Methods and Software 1999) and the
conic benchmark format (.cbf), version 3 (H. A. Friberg, CBF format reference).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy

from sdp_vs_penalty.robot.arrays import Array, Indices


@dataclass(frozen=True)
class Cone:
    """One factor of K: its kind and size (the order d of a psd cone, else the length)."""

    kind: str
    size: int

    @property
    def rows(self) -> int:
        """Number of rows of the cone: d (d + 1) / 2 for a matrix of order d, else its
        size.
        """
        if self.kind == "psd":
            return self.size * (self.size + 1) // 2
        return self.size


@dataclass(frozen=True)
class ConicProblem:
    """Minimise 1/2 x^T P x + q^T x with b - A x in the product of cones."""

    #: (m, m) upper triangle of the quadratic objective.
    P: scipy.sparse.csc_matrix
    #: (m,) slope of the objective.
    q: Array
    #: (rows, m) coefficients of the rows.
    A: scipy.sparse.csc_matrix
    #: (rows,) constants of the rows.
    b: Array
    #: The cones, in the order of the rows.
    cones: tuple[Cone, ...]


@dataclass(frozen=True)
class Solution:
    """What a solver returned and claims; nothing here is believed before it is
    certified."""

    #: (m,) primal variables.
    x: Array
    #: (rows,) dual variables of A x + s = b, in K*.
    z: Array
    #: Meaning of the status: "optimal", "inaccurate", "infeasible", "unbounded" or
    #: "failed".
    claims: str
    #: The solver's own word.
    status: str
    #: Number of iterations.
    iterations: int
    #: Processor time of writing and reading a program's files [s].
    file_seconds: float = 0.0

    @classmethod
    def none(
        cls,
        problem: ConicProblem,
        status: str,
        claims: str = "failed",
        iterations: int = 0,
    ) -> Solution:
        """Return the Solution of a solver that gave none: NaN for every number.

        Parameters
        ----------
        problem : ConicProblem
            Problem that was to be solved.

        Returns
        -------
        Solution
            With x (m,) and z (rows,) of NaN.
        """
        x = np.full(len(problem.q), np.nan)
        z = np.full(len(problem.b), np.nan)
        return cls(x, z, claims, status, iterations)


@cache
def triangle(d: int) -> tuple[Indices, Indices, Array]:
    """Return rows, columns and weights of svec's entries.

    Returns
    -------
    tuple
        Row and column of each of the d (d + 1) / 2 entries, and its factor: 1 on the
        diagonal, sqrt(2) elsewhere.
    """
    j, i = np.tril_indices(d)  # column by column of the upper triangle
    weights = np.where(i == j, 1.0, np.sqrt(2.0))
    return i, j, weights


def svec(matrix: Array) -> Array:
    """Return the upper triangle of symmetric matrices (..., d, d), off-diagonals times
    sqrt(2).

    Returns
    -------
    (..., d (d + 1) / 2)
        Entries column by column; inner products are those of the matrices.
    """
    i, j, weight = triangle(matrix.shape[-1])
    return matrix[..., i, j] * weight


def unsvec(vector: Array, d: int) -> Array:
    """Return the symmetric matrices (..., d, d) of svec vectors (..., d (d + 1) / 2),
    the inverse of :func:`svec`."""
    i, j, weight = triangle(d)
    matrices = np.zeros((*vector.shape[:-1], d, d))
    matrices[..., i, j] = matrices[..., j, i] = vector / weight
    return matrices


CBF_NAMES = {"zero": "L=", "nonnegative": "L+", "soc": "Q", "exp": "EXP"}


def sdpa_text(problem: ConicProblem) -> str:
    """Return a problem in the sparse SDPA format, with 17 digits a number.

    The format's problem is: minimise c^T x subject to sum_i x_i F_i - F_0 >= 0, with
    blocks in the order of the cones.

    Parameters
    ----------
    problem : ConicProblem
        Problem with nonnegative and psd cones.

    Returns
    -------
    str
        Content of a .dat-s file.
    """
    # A diagonal block (nonnegative rows) has a negative size in this format.
    sizes = [-c.size if c.kind == "nonnegative" else c.size for c in problem.cones]
    lines = [
        '"physically consistent identification of robot dynamics, by sdp-vs-penalty"',
        f"{len(problem.q)} = mDIM",
        f"{len(sizes)} = nBLOCK",
        " ".join(str(s) for s in sizes),
        " ".join(f"{x:.17g}" for x in problem.q),
    ]
    block, i, j, factor = svec_entries(problem.cones)
    stacked = scipy.sparse.hstack(
        [scipy.sparse.csc_matrix(problem.b[:, None]), problem.A], "csc"
    ).tocoo()
    values = -stacked.data * factor[stacked.row]
    # A line: number of the matrix F_k, block, row, column (from 1), value.
    for row, k, value in zip(stacked.row, stacked.col, values, strict=True):
        if value != 0.0:
            lines.append(f"{k} {block[row] + 1} {i[row] + 1} {j[row] + 1} {value:.17g}")
    return "\n".join(lines) + "\n"


def cbf_text(problem: ConicProblem) -> str:
    """Return a problem in the conic benchmark format, version 3, with 17 digits a
    number.

    Returns
    -------
    str
        Content of a .cbf file: free variables x, affine cones of rows b - A x (ACOORD,
        BCOORD), psd cones by HCOORD and DCOORD.
    """
    m = len(problem.q)
    # First row of each cone, and the number of rows.
    starts = np.cumsum([0, *(c.rows for c in problem.cones)])
    # 1. Head: m free variables, and the orders of the matrices.
    lines = ["VER", "3", ""]
    lines += ["OBJSENSE", "MIN", ""]
    lines += ["VAR", f"{m} 1", f"F {m}", ""]
    is_psd = np.array([cone.kind == "psd" for cone in problem.cones], bool)
    if is_psd.any():
        sizes = [str(cone.size) for cone in problem.cones if cone.kind == "psd"]
        lines += ["PSDCON", str(len(sizes)), *sizes, ""]
    # 2. The other cones, and their rows in CBF's order.
    rows = [np.zeros(0, np.intp)]
    cones = []
    for start, cone in zip(starts, problem.cones, strict=False):
        if cone.kind != "psd":
            row_numbers = np.arange(start, start + cone.rows)
            if cone.kind == "exp":  # CBF has the reverse order: (z, y, x)
                row_numbers = row_numbers[::-1]
            rows.append(row_numbers)
            cones.append(f"{CBF_NAMES[cone.kind]} {cone.rows}")
    order = np.concatenate(rows)
    if cones:
        lines += ["CON", f"{len(order)} {len(cones)}", *cones, ""]
    return "\n".join(lines + _cbf_coefficients(problem, order)) + "\n"


def _cbf_coefficients(problem: ConicProblem, order: Indices) -> list[str]:
    """Return the coefficients of a .cbf file in CBF's order: those of the objective, of
    matrices (H, D), and of the other rows (A, B).

    CBF holds b - A x. ``order`` are the numbers of the rows that are no matrix's.
    """
    is_psd = np.array([cone.kind == "psd" for cone in problem.cones], bool)
    # Row r of the problem is entry (i[r], j[r]) of cone block[r], times factor[r].
    block, i, j, factor = svec_entries(problem.cones)
    matrix_number = (np.cumsum(is_psd) - 1)[block]  # among the matrices, by row
    minus_A = scipy.sparse.csr_matrix(-problem.A)
    b = problem.b
    psd_rows = np.flatnonzero(is_psd[block])
    of_matrices = minus_A[psd_rows].tocoo()
    r = psd_rows[of_matrices.row]
    of_others = minus_A[order].tocoo()
    with_constant = psd_rows[b[psd_rows] != 0.0]
    return [
        *_section("OBJACOORD", *_nonzero(problem.q)),
        *_section(
            "HCOORD",
            matrix_number[r],
            of_matrices.col,
            j[r],
            i[r],
            of_matrices.data * factor[r],
        ),
        *_section("ACOORD", of_others.row, of_others.col, of_others.data),
        *_section("BCOORD", *_nonzero(b[order])),
        *_section(
            "DCOORD",
            matrix_number[with_constant],
            j[with_constant],
            i[with_constant],
            b[with_constant] * factor[with_constant],
        ),
    ]


def _nonzero(values: Any) -> tuple[Any, Any]:
    """Return the indices of the nonzero values, and these values."""
    places = np.flatnonzero(values)
    return places, values[places]


def _section(name: str, *columns: Any) -> list[str]:
    """Return the lines of a section: its name, the number of entries, and the entries.

    Each entry is a line of integers and, last, a value. An empty section has no lines.
    """
    lines = [
        " ".join([*map(str, row[:-1]), f"{row[-1]:.17g}"])
        for row in zip(*(column.tolist() for column in columns), strict=True)
    ]
    return [name, str(len(lines)), *lines, ""] if lines else []


def svec_entries(cones: Sequence[Cone]) -> tuple[Any, Any, Any, Any]:
    """Return where each row of a problem is in the matrix of its cone.

    Parameters
    ----------
    cones : sequence of Cone
        Cones in the order of the rows.

    Returns
    -------
    tuple
        For each row: number of its cone, its row and column there, and the factor that
        turns svec into the matrix's entry.
    """
    parts = []
    for number, cone in enumerate(cones):
        i = j = np.arange(cone.size)
        weight = np.ones(cone.size)
        if cone.kind == "psd":
            i, j, weight = triangle(cone.size)
        numbers = np.full(len(i), number)
        parts.append((numbers, i, j, 1.0 / weight))
    return tuple(np.concatenate(x) for x in zip(*parts, strict=True))  # type: ignore[return-value]
