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

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, triangle, unsvec

#: Kinds of cones in the order of SCS and CVXOPT.
KINDS = ("zero", "nonnegative", "soc", "psd", "exp")


class NotApplicableError(ValueError):
    """The problem has a cone that the solver lacks and that cannot be rewritten."""


@dataclass(frozen=True)
class Rewritten:
    """A problem and back(x, z), from its solutions to those of the problem it came
    from.

    constant : the objective of that problem less that of this one.
    """

    problem: ConicProblem
    back: Callable[[Array, Array], tuple[Array, Array]]
    constant: float = 0.0

    def then(self, step: Callable[[ConicProblem], Rewritten]) -> Rewritten:
        """One more step.

        Parameters
        ----------
        step : callable
            What rewrites this problem.

        Returns
        -------
        Rewritten
            The problem after both, with the way back through both.
        """
        following = step(self.problem)

        def back(x: Array, z: Array) -> tuple[Array, Array]:
            return self.back(*following.back(x, z))

        return Rewritten(following.problem, back, self.constant + following.constant)


def unchanged(problem: ConicProblem) -> Rewritten:
    """A problem that needs no rewriting.

    Parameters
    ----------
    problem : ConicProblem
        What is to be solved.

    Returns
    -------
    Rewritten
        The same problem.
    """
    return Rewritten(problem, lambda x, z: (x, z))


def suited(
    problem: ConicProblem,
    kinds: Collection[str],
    order: Sequence[str] = (),
) -> Rewritten:
    """A problem as a solver can take it.

    Parameters
    ----------
    problem : ConicProblem
        What is to be solved.
    kinds : collection of str
        Cones of the solver, and "quadratic" where it takes such an objective.
    order : sequence of str
        In which it wants the cones; none: any.

    Returns
    -------
    Rewritten
        The other problem, with the way back from its solutions.

    Raises
    ------
    NotApplicableError
        Where a cone is left that the solver lacks.
    """
    form = unchanged(problem)
    if "quadratic" not in kinds:
        # Ten rows share one matrix where only these are left: many small ones are
        # cheaper.
        form = form.then(lambda p: linear_objective(p, None if "soc" in kinds else 10))
    if "zero" not in kinds:
        form = form.then(without_equalities)
    if "soc" not in kinds:
        form = form.then(arrows)
    kinds_left = {cone.kind for cone in form.problem.cones}
    if lacking := sorted(kinds_left - set(kinds)):
        raise NotApplicableError(f"the solver has no {', '.join(lacking)} cone")
    return form.then(lambda p: reorder(p, order)) if order else form


def quadratic_factor(problem: ConicProblem) -> scipy.sparse.csr_matrix:
    """A factor of the quadratic objective.

    Parameters
    ----------
    problem : ConicProblem
        P holds the upper triangle only.

    Returns
    -------
    (k, m) sparse
        G with 1/2 x^T P x = 1/2 |G x|^2.
    """
    P = scipy.sparse.csc_matrix(problem.P)
    diagonal = P.diagonal()
    if P.nnz == np.count_nonzero(diagonal):
        nonzero = np.flatnonzero(diagonal)
        ones = np.arange(len(nonzero))
        shape = (len(nonzero), P.shape[0])
        entries = (np.sqrt(diagonal[nonzero]), (ones, nonzero))
        return scipy.sparse.csr_matrix(entries, shape)
    full = P.toarray()
    values, vectors = np.linalg.eigh(full + np.triu(full, 1).T)
    significant = values > 1e-15 * values[-1]
    roots = np.sqrt(values[significant])
    return scipy.sparse.csr_matrix(roots[:, None] * vectors[:, significant].T)


def linear_objective(problem: ConicProblem, group: int | None = None) -> Rewritten:
    """Bound the quadratic part by new variables, so that the objective is linear.

    Parameters
    ----------
    problem : ConicProblem
        What is to be solved.
    group : int or None
        Rows of the factor that share one variable; None: all.

    Returns
    -------
    Rewritten
        The other problem, with the way back from its solutions.
    """
    if problem.P.nnz == 0:
        return unchanged(problem)
    factor = quadratic_factor(problem)
    rows, m = factor.shape
    size = rows if group is None else group
    starts = list(range(0, rows, size))
    columns = len(starts)
    blocks: list[list[Any]] = [[problem.A, None]]
    constants = [problem.b]
    cones = list(problem.cones)
    for k, start in enumerate(starts):
        part = factor[start : start + size]
        size_of_part = part.shape[0]
        place = ([0], [k])
        top = scipy.sparse.csr_matrix(([-1.0], place), (1, columns))
        blocks.append([None, top])
        blocks.append([None, top])
        blocks.append([-np.sqrt(2.0) * part, None])
        constants.append(np.array([1.0, -1.0]))
        constants.append(np.zeros(size_of_part))
        cones.append(Cone("soc", 2 + size_of_part))
    rewritten = ConicProblem(
        scipy.sparse.csc_matrix((m + columns, m + columns)),
        np.concatenate([problem.q, np.ones(columns)]),
        scipy.sparse.csc_matrix(scipy.sparse.bmat(blocks)),
        np.concatenate(constants),
        tuple(cones),
    )

    def back(x: Array, z: Array) -> tuple[Array, Array]:
        return x[:m], z[: len(problem.b)]

    return Rewritten(rewritten, back)


def without_equalities(problem: ConicProblem) -> Rewritten:
    """Solve each equality for a variable that occurs in no other one, and substitute
    it.

    Parameters
    ----------
    problem : ConicProblem
        With a linear objective.

    Returns
    -------
    Rewritten
        The other problem, with the way back from its solutions.

    Raises
    ------
    NotApplicableError
        Where an equality has no such variable.
    """
    are_equalities = [np.full(c.rows, c.kind == "zero") for c in problem.cones]
    equal = np.concatenate(
        [
            np.zeros(0, bool),
            *are_equalities,
        ]
    )
    if not equal.any():
        return unchanged(problem)
    A = scipy.sparse.csr_matrix(problem.A)
    E = scipy.sparse.csc_matrix(A[equal])
    e = problem.b[equal]
    inequalities = A[~equal]
    lonely = np.flatnonzero(np.diff(E.indptr) == 1)
    row_of = E.indices[E.indptr[lonely]]
    value = E.data[E.indptr[lonely]]
    # The largest coefficient of each row; the residual variables' are all -1.
    order = np.lexsort((-np.abs(value), row_of))
    rows, first = np.unique(row_of[order], return_index=True)
    if len(rows) != E.shape[0]:
        raise NotApplicableError("an equality holds no variable of its own")
    pivots = lonely[order][first]
    size = value[order][first]
    free_columns = np.setdiff1d(np.arange(A.shape[1]), pivots)
    # x_pivot = offset - slope x_kept
    slope = scipy.sparse.diags(1.0 / size) @ E[:, free_columns]
    offset = e / size
    inequalities = scipy.sparse.csc_matrix(inequalities)
    of_pivots = inequalities[:, pivots]
    rewritten = ConicProblem(
        scipy.sparse.csc_matrix((len(free_columns), len(free_columns))),
        problem.q[free_columns] - slope.T @ problem.q[pivots],
        scipy.sparse.csc_matrix(inequalities[:, free_columns] - of_pivots @ slope),
        problem.b[~equal] - of_pivots @ offset,
        tuple(c for c in problem.cones if c.kind != "zero"),
    )

    def back(x: Array, z: Array) -> tuple[Array, Array]:
        full_x = np.zeros(A.shape[1])
        full_z = np.zeros(len(equal))
        full_x[free_columns] = x
        full_x[pivots] = offset - slope @ x
        full_z[~equal] = z
        # Stationarity in the pivots: q + A^T z = 0.
        full_z[equal] = -(problem.q[pivots] + of_pivots.T @ z) / size
        return full_x, full_z

    return Rewritten(rewritten, back, float(problem.q[pivots] @ offset))


def arrows(problem: ConicProblem) -> Rewritten:
    """Second-order cones as arrow matrices.

    Parameters
    ----------
    problem : ConicProblem
        What is to be solved.

    Returns
    -------
    Rewritten
        The other problem; the adjoint of the map brings multipliers back.
    """
    if not any(c.kind == "soc" for c in problem.cones):
        return unchanged(problem)
    maps = []
    cones = []
    for cone in problem.cones:
        d = cone.size
        if cone.kind != "soc":
            maps.append(scipy.sparse.identity(cone.rows, format="csr"))
            cones.append(cone)
            continue
        j = np.arange(d)
        diagonal = j * (j + 1) // 2 + j
        border = j[1:] * (j[1:] + 1) // 2
        rows = np.concatenate([diagonal, border])
        columns = np.concatenate(
            [
                np.zeros(d, int),
                j[1:],
            ]
        )
        values = np.repeat([1.0, np.sqrt(2.0)], [d, d - 1])
        shape = (d * (d + 1) // 2, d)
        maps.append(scipy.sparse.csr_matrix((values, (rows, columns)), shape))
        cones.append(Cone("psd", d))
    change = scipy.sparse.block_diag(maps, format="csr")
    return _mapped(
        replace(problem, cones=tuple(cones)),
        change,
        change.T,
    )


def _mapped(
    problem: ConicProblem,
    change: scipy.sparse.csr_matrix,
    home: scipy.sparse.csr_matrix,
) -> Rewritten:
    """Other rows, and their multipliers brought home."""
    mapped = replace(
        problem,
        A=scipy.sparse.csc_matrix(change @ problem.A),
        b=change @ problem.b,
    )
    return Rewritten(mapped, lambda x, z: (x, home @ z))


def reorder(problem: ConicProblem, kinds: Sequence[str] = KINDS) -> Rewritten:
    """Sort the cones by kind; nonnegative and zero cones are merged.

    Parameters
    ----------
    problem : ConicProblem
        What is to be solved.
    kinds : sequence of str
        The order.

    Returns
    -------
    Rewritten
        The other problem, with the way back from its solutions.
    """
    starts = np.cumsum(
        [
            0,
            *(c.rows for c in problem.cones),
        ]
    )
    order = [np.zeros(0, np.intp)]
    cones = []
    for kind in kinds:
        mine = [k for k, c in enumerate(problem.cones) if c.kind == kind]
        order += [np.arange(starts[k], starts[k + 1]) for k in mine]
        if kind in ("zero", "nonnegative"):
            size = sum(problem.cones[k].size for k in mine)
            cones += [Cone(kind, size)] if mine else []
        else:
            cones += [problem.cones[k] for k in mine]
    same = scipy.sparse.identity(len(problem.b), format="csr")
    change = same[np.concatenate(order)]
    return _mapped(
        replace(problem, cones=tuple(cones)),
        change,
        change.T,
    )


def sizes(cones: Sequence[Cone]) -> dict[str, Any]:
    """How large the cones are.

    Parameters
    ----------
    cones : sequence of Cone
        Of a problem.

    Returns
    -------
    dict
        Under the names that SCS and CVXOPT share.
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
    """Rows of psd cones become d^2 entries.

    Parameters
    ----------
    problem : ConicProblem
        What is to be solved.

    Returns
    -------
    Rewritten
        Its rows no longer match Cone.rows. A solver may return any matrix; the
        way back takes its lower triangle, which is what CVXOPT fills.
    """
    outward = []
    homeward = []
    for cone in problem.cones:
        d = cone.size
        rows = cone.rows
        out = home = scipy.sparse.identity(rows, format="csr")
        if cone.kind == "psd":
            # Entries stand column by column: (row j, column i) of the lower triangle at
            # i * d + j.
            i, j, weight = triangle(d)
            matrices = unsvec(np.eye(rows), d)
            out = scipy.sparse.csr_matrix(matrices.reshape(rows, -1).T)
            places = (np.arange(rows), i * d + j)
            home = scipy.sparse.csr_matrix((weight, places), (rows, d * d))
        outward.append(out)
        homeward.append(home)
    return _mapped(
        problem,
        scipy.sparse.block_diag(outward, format="csr"),
        scipy.sparse.block_diag(homeward, format="csr"),
    )
