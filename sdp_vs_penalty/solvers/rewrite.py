"""The same conic problem for solvers that lack a quadratic objective, equalities or
second-order cones.

Each step is a change of rows and columns with its way back: x and z of the rewritten
problem become x and z of the original, so that a solver is judged on the problem that
was posed.

    quadratic    1/2 |L^T x|^2 <= t    as    |(t - 1, sqrt(2) L^T x)| <= t + 1, in groups of rows
    equality     a_j x_j + ... = b     solved for variables that no other equality holds
    soc          |u| <= s              as    [[s, u^T], [u, s 1]] >= 0 (arrow matrix)
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from sdp_vs_penalty.robot.arrays import Array, Indices, nonzero_or_one
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, triangle, unsvec

#: Kinds of cones in the order of SCS and CVXOPT.
KINDS = ("zero", "nonnegative", "soc", "psd", "exp")


class NotApplicableError(ValueError):
    """The problem has a cone that the solver lacks and that cannot be rewritten."""


@dataclass(frozen=True)
class Rewritten:
    """A rewritten problem, and the way back to the problem it came from."""

    #: The rewritten problem.
    problem: ConicProblem
    #: back(x, z): from its solutions to those of the problem it came from.
    back: Callable[[Array, Array], tuple[Array, Array]]
    #: Objective of the problem it came from, less that of this one.
    constant: float = 0.0

    def then(self, step: Callable[[ConicProblem], Rewritten]) -> Rewritten:
        """Apply one more rewriting step to the problem.

        Returns
        -------
        Rewritten
            Problem after both steps, with the way back through both.
        """
        following = step(self.problem)

        def back(x: Array, z: Array) -> tuple[Array, Array]:
            return self.back(*following.back(x, z))

        return Rewritten(following.problem, back, self.constant + following.constant)


def unchanged(problem: ConicProblem) -> Rewritten:
    """Return a problem as a rewriting that changes nothing."""
    return Rewritten(problem, lambda x, z: (x, z))


def suited(
    problem: ConicProblem, kinds: Collection[str], order: Sequence[str] = ()
) -> Rewritten:
    """Rewrite a problem for a solver that lacks some cones.

    A quadratic objective becomes linear with second-order cones, equalities are
    substituted, and second-order cones become arrow matrices.

    Parameters
    ----------
    kinds : collection of str
        Cones of the solver, and "quadratic" if it takes a quadratic objective.
    order : sequence of str
        Order of the cones that the solver wants; empty: any.

    Returns
    -------
    Rewritten
        Equivalent problem, with the way back from its solutions.

    Raises
    ------
    NotApplicableError
        If a cone remains that the solver lacks.
    """
    form = unchanged(problem)
    if "quadratic" not in kinds:
        # One cone for the whole objective; if cones become matrices, one for each ten
        # rows, since many small matrices are cheaper.
        rows_a_cone = None if "soc" in kinds else 10
        form = form.then(lambda p: linear_objective(p, rows_a_cone))
    if "zero" not in kinds:
        form = form.then(without_equalities)
    if "soc" not in kinds:
        form = form.then(arrows)
    remaining_kinds = {cone.kind for cone in form.problem.cones}
    lacking = sorted(remaining_kinds - set(kinds))
    if lacking:
        raise NotApplicableError(f"the solver has no {', '.join(lacking)} cone")
    if order:
        form = form.then(lambda p: reorder(p, order))
    return form


def quadratic_factor(problem: ConicProblem) -> scipy.sparse.csr_matrix:
    """Return a factor of the quadratic objective.

    Parameters
    ----------
    problem : ConicProblem
        Its P holds the upper triangle only.

    Returns
    -------
    (k, m) sparse
        G with 1/2 x^T P x = 1/2 |G x|^2.
    """
    P = scipy.sparse.csc_matrix(problem.P)
    diagonal = P.diagonal()
    # A diagonal P: G holds the roots of its nonzero entries, one a row.
    if P.nnz == np.count_nonzero(diagonal):
        nonzero = np.flatnonzero(diagonal)
        row_numbers = np.arange(len(nonzero))
        shape = (len(nonzero), P.shape[0])
        entries = (np.sqrt(diagonal[nonzero]), (row_numbers, nonzero))
        return scipy.sparse.csr_matrix(entries, shape)
    # Any other P = D V diag(values) V^T D: G = diag(sqrt(values)) V^T D. D gives P a
    # diagonal of ones, so that no unit of a variable makes its part insignificant.
    size = np.sqrt(nonzero_or_one(diagonal))
    dense = P.toarray() / np.outer(size, size)
    values, vectors = np.linalg.eigh(dense + np.triu(dense, 1).T)
    significant = values > 1e-15 * values[-1]
    roots = np.sqrt(values[significant])
    return scipy.sparse.csr_matrix(roots[:, None] * vectors[:, significant].T * size)


def linear_objective(problem: ConicProblem, group: int | None = None) -> Rewritten:
    """Replace the quadratic objective by new variables t >= 1/2 |G x|^2.

    Each t has the second-order cone (t + 1, t - 1, sqrt(2) G x).

    Parameters
    ----------
    group : int or None
        Rows of G that share one variable; None: all.

    Returns
    -------
    Rewritten
        Equivalent problem, with the way back from its solutions.
    """
    if problem.P.nnz == 0:
        return unchanged(problem)
    factor = quadratic_factor(problem)
    n_rows, m = factor.shape
    size = n_rows if group is None else group
    starts = list(range(0, n_rows, size))
    n_new = len(starts)  # number of variables t, behind the m variables x
    # Blocks of rows of A in the columns [x, t].
    blocks: list[list[Any]] = [[problem.A, None]]
    constants = [problem.b]
    cones = list(problem.cones)
    for k, start in enumerate(starts):
        part = factor[start : start + size]
        size_of_part = part.shape[0]
        # b - A x is (t_k + 1, t_k - 1, sqrt(2) G x).
        minus_t = scipy.sparse.csr_matrix(([-1.0], ([0], [k])), (1, n_new))
        blocks.append([None, minus_t])
        blocks.append([None, minus_t])
        blocks.append([-np.sqrt(2.0) * part, None])
        constants.append(np.array([1.0, -1.0]))
        constants.append(np.zeros(size_of_part))
        cones.append(Cone("soc", 2 + size_of_part))
    rewritten = ConicProblem(
        scipy.sparse.csc_matrix((m + n_new, m + n_new)),
        q=np.concatenate([problem.q, np.ones(n_new)]),
        A=scipy.sparse.csc_matrix(scipy.sparse.bmat(blocks)),
        b=np.concatenate(constants),
        cones=tuple(cones),
    )

    def back(x: Array, z: Array) -> tuple[Array, Array]:
        """Return x and z of the first problem, without t and the new cones."""
        return x[:m], z[: len(problem.b)]

    return Rewritten(rewritten, back)


def _pivot_variables(equalities: Any) -> tuple[Indices, Array]:
    """Return of each equality, a row of a sparse matrix (by columns), a variable that
    occurs in no other one, and its coefficient there, both (rows,).

    Of several the last one, a residual variable (with -1): parameters stay, in a file
    too, whose reader knows where they are. Raises NotApplicableError without any.
    """
    n_entries = np.diff(equalities.indptr)  # of each column
    candidates = np.flatnonzero(n_entries == 1)
    row = equalities.indices[equalities.indptr[candidates]]
    coefficient = equalities.data[equalities.indptr[candidates]]
    # By rows, in each the last candidate first.
    order = np.lexsort((-candidates, row))
    rows, first = np.unique(row[order], return_index=True)
    if len(rows) != equalities.shape[0]:
        raise NotApplicableError("an equality holds no variable of its own")
    return candidates[order][first], coefficient[order][first]


def without_equalities(problem: ConicProblem) -> Rewritten:
    """Remove equalities: solve each for a variable that occurs in no other one.

    Parameters
    ----------
    problem : ConicProblem
        Problem with a linear objective.

    Returns
    -------
    Rewritten
        Equivalent problem, with the way back from its solutions.

    Raises
    ------
    NotApplicableError
        If an equality has no such variable.
    """
    are_equalities = [np.full(c.rows, c.kind == "zero") for c in problem.cones]
    is_equal = np.concatenate([np.zeros(0, bool), *are_equalities])
    if not is_equal.any():
        return unchanged(problem)
    # Equalities E x = e, and the rows of all other cones.
    A = scipy.sparse.csr_matrix(problem.A)
    E = scipy.sparse.csc_matrix(A[is_equal])
    e = problem.b[is_equal]
    inequalities = A[~is_equal]
    pivots, coefficient = _pivot_variables(E)
    free_columns = np.setdiff1d(np.arange(A.shape[1]), pivots)
    # x_pivot = offset - slope x_free
    slope = scipy.sparse.diags(1.0 / coefficient) @ E[:, free_columns]
    offset = e / coefficient
    inequalities = scipy.sparse.csc_matrix(inequalities)
    of_pivots = inequalities[:, pivots]
    rewritten = ConicProblem(
        scipy.sparse.csc_matrix((len(free_columns), len(free_columns))),
        q=problem.q[free_columns] - slope.T @ problem.q[pivots],
        A=scipy.sparse.csc_matrix(inequalities[:, free_columns] - of_pivots @ slope),
        b=problem.b[~is_equal] - of_pivots @ offset,
        cones=tuple(c for c in problem.cones if c.kind != "zero"),
    )

    def back(x: Array, z: Array) -> tuple[Array, Array]:
        """Return x and z of the problem with equalities."""
        full_x = np.zeros(A.shape[1])
        full_z = np.zeros(len(is_equal))
        full_x[free_columns] = x
        full_x[pivots] = offset - slope @ x
        full_z[~is_equal] = z
        # Stationarity in the pivots: q + A^T z = 0.
        full_z[is_equal] = -(problem.q[pivots] + of_pivots.T @ z) / coefficient
        return full_x, full_z

    return Rewritten(rewritten, back, float(problem.q[pivots] @ offset))


def arrows(problem: ConicProblem) -> Rewritten:
    """Replace second-order cones of size d by arrow matrices of order d.

    The matrix has the axis on its diagonal and the other entries in its first row and
    column; it is positive semidefinite exactly if the vector lies in the cone.

    Returns
    -------
    Rewritten
        Equivalent problem; the adjoint of the map brings multipliers back.
    """
    if not any(c.kind == "soc" for c in problem.cones):
        return unchanged(problem)
    maps = []  # one a cone, from its rows to those of the new cone
    cones = []
    for cone in problem.cones:
        d = cone.size
        if cone.kind != "soc":
            maps.append(scipy.sparse.identity(cone.rows, format="csr"))
            cones.append(cone)
            continue
        # Places of svec: column j of the upper triangle begins at j (j + 1) / 2.
        j = np.arange(d)
        diagonal = j * (j + 1) // 2 + j
        border = j[1:] * (j[1:] + 1) // 2
        rows = np.concatenate([diagonal, border])
        columns = np.concatenate([np.zeros(d, int), j[1:]])
        # The axis goes to all d diagonal entries; svec weights others by sqrt(2).
        values = np.repeat([1.0, np.sqrt(2.0)], [d, d - 1])
        shape = (d * (d + 1) // 2, d)
        maps.append(scipy.sparse.csr_matrix((values, (rows, columns)), shape))
        cones.append(Cone("psd", d))
    change = scipy.sparse.block_diag(maps, format="csr")
    return _mapped(replace(problem, cones=tuple(cones)), change, change.T)


def _mapped(
    problem: ConicProblem,
    row_map: scipy.sparse.csr_matrix,
    multiplier_map: scipy.sparse.csr_matrix,
) -> Rewritten:
    """Return the problem with the rows ``row_map`` A and ``row_map`` b, and the way back.

    ``row_map`` maps the rows b - A x of the old cones to those of the new ones;
    ``multiplier_map`` maps the new multipliers to the old ones. The variables x stay.
    """
    mapped = replace(
        problem, A=scipy.sparse.csc_matrix(row_map @ problem.A), b=row_map @ problem.b
    )
    return Rewritten(mapped, lambda x, z: (x, multiplier_map @ z))


def reorder(problem: ConicProblem, kinds: Sequence[str] = KINDS) -> Rewritten:
    """Sort the cones by kind; zero and nonnegative cones are merged to one each.

    Returns
    -------
    Rewritten
        Equivalent problem, with the way back from its solutions.
    """
    starts = np.cumsum([0, *(c.rows for c in problem.cones)])
    order = [np.zeros(0, np.intp)]
    cones = []
    for kind in kinds:
        of_kind = [k for k, c in enumerate(problem.cones) if c.kind == kind]
        order += [np.arange(starts[k], starts[k + 1]) for k in of_kind]
        if of_kind and kind in ("zero", "nonnegative"):
            cones.append(Cone(kind, sum(problem.cones[k].size for k in of_kind)))
        else:
            cones += [problem.cones[k] for k in of_kind]
    identity = scipy.sparse.identity(len(problem.b), format="csr")
    change = identity[np.concatenate(order)]
    return _mapped(replace(problem, cones=tuple(cones)), change, change.T)


def sizes(cones: Sequence[Cone]) -> dict[str, Any]:
    """Return the sizes of cones under the names that SCS and CVXOPT share.

    Returns
    -------
    dict
        "z" zero rows, "l" nonnegative rows, "ep" number of exponential cones, "q" sizes
        of second-order cones, "s" orders of matrices.
    """
    sizes_by_kind: dict[str, list[int]] = {kind: [] for kind in KINDS}
    for cone in cones:
        sizes_by_kind[cone.kind].append(cone.size)
    return {
        "z": sum(sizes_by_kind["zero"]),
        "l": sum(sizes_by_kind["nonnegative"]),
        "ep": len(sizes_by_kind["exp"]),
        "q": sizes_by_kind["soc"],
        "s": sizes_by_kind["psd"],
    }


def full_matrices(problem: ConicProblem) -> Rewritten:
    """Replace the svec of each psd cone by all d^2 entries of the matrix.

    Returns
    -------
    Rewritten
        Its rows no longer match Cone.rows. A solver may return any matrix; the way back
        takes its lower triangle, the only one that CVXOPT fills.
    """
    row_maps = []
    multiplier_maps = []
    for cone in problem.cones:
        d = cone.size
        rows = cone.rows
        row_map = multiplier_map = scipy.sparse.identity(rows, format="csr")
        if cone.kind == "psd":
            # Entries stand column by column: (row j, column i) of the lower triangle at
            # i * d + j.
            i, j, weight = triangle(d)
            matrices = unsvec(np.eye(rows), d)
            row_map = scipy.sparse.csr_matrix(matrices.reshape(rows, -1).T)
            places = (np.arange(rows), i * d + j)
            multiplier_map = scipy.sparse.csr_matrix((weight, places), (rows, d * d))
        row_maps.append(row_map)
        multiplier_maps.append(multiplier_map)
    return _mapped(
        problem,
        scipy.sparse.block_diag(row_maps, format="csr"),
        scipy.sparse.block_diag(multiplier_maps, format="csr"),
    )
