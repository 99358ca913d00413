"""Constraints of an identification problem as arrays for :mod:`primal_dual`: small cones together."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Alike, Constraint, ConstraintSet, Entries, alike
from sdp_vs_penalty.solvers.objective import Entropy
from sdp_vs_penalty.solvers.rewrite import NotApplicableError

#: Order of the largest matrix; smaller ones are padded with ones on the diagonal.
ORDER = 4
#: Up to so many entries a product with the whole matrix takes less than the call of a sparse one.
_DENSE = 1 << 16
#: Rows, columns and values of a sparse matrix.
_Triplets = tuple[NDArray[np.intp], NDArray[np.intp], Array]


class SmallCones:
    """Non-negative rows and 4x4 blocks, prepared for any data in the same parameters theta (p,).

    Slacks (rows + 16 blocks,) = constant + slack_map theta: those of all rows, of the entropy's links,
    of further blocks. weight (blocks,) : of -log det; linear (p,) : the slope of its trace term.
    curvature turns y / s of the rows and the Kronecker products of S^-1 and Z of the blocks into the
    entries ``places`` of H (p, p), lower triangle column by column. home (e, rows + 16 blocks) : from
    multipliers to those of the constraints' entries, zero where another constraint implies one.
    """

    def __init__(self, entropy: Entropy | None, constraints: ConstraintSet, p: int) -> None:
        """Raises NotApplicableError for cones of an order above four."""
        links = entropy.links if entropy is not None and entropy.weight > 0.0 else ()
        barred = {("pseudo-inertia", *link.indices.tolist()) for link in links}  # by their log det
        chosen = [c for c in constraints.essential if (c.family, *c.indices.tolist()) not in barred]
        found = alike(chosen)
        rows = [kind for kind in found if kind.cone == "nonnegative"]
        others = [kind for kind in found if kind.cone != "nonnegative"]
        kinds = [*map(_each_row, rows), *map(_matrices, (*alike(links), *others))]
        entries, linear = Entries.of(kinds), np.zeros(p)
        count = sum(kind.constant.size for kind in rows)
        weight = np.zeros((len(entries.constant) - count) // ORDER**2)
        if entropy is not None and links:
            weight[: len(links)] = entropy.weight
            linear = entropy.weight * entropy.entries.adjoint(entropy.nominal_terms[0].ravel(), p)
        pairs, wide = list[_Triplets](), 0
        for kind in kinds:
            pairs.append(_pairs(kind, wide, p))
            wide += kind.constant.size * kind.constant.shape[1] ** 2
        curvature = _sparse(pairs, (p * p, wide))
        self.places = np.flatnonzero(np.diff(curvature.indptr))
        self.curvature = curvature[self.places]
        back, own, start, first = list[_Triplets](), dict[Constraint, int](), 0, 0
        for kind in constraints.groups:
            for k in kind.places.tolist():
                own[constraints.convex[k]], start = start, start + constraints.convex[k].constant.size
        for kind in (*rows, *others):
            where = np.array([own[chosen[k]] for k in kind.places.tolist()])
            if kind.cone == "nonnegative":
                width = kind.constant.shape[1]
            else:
                first, width = max(first, count + len(links) * ORDER**2), ORDER**2
            back.append(_homeward(kind, where, first + width * np.arange(len(where))))
            first += width * len(where)
        self.home = _sparse(back, (start, len(entries.constant)))
        self.rows, self.linear, self.weight, self.constant = count, linear, weight, entries.constant
        shape = (len(entries.constant), p)
        slack_map = _sparse([(entries.row, entries.column, entries.value)], shape)
        small = math.prod(shape) <= _DENSE
        self.slack_map: Array | sparse.csr_matrix = slack_map.toarray() if small else slack_map
        self.adjoint: Array | sparse.csr_matrix = slack_map.T.tocsr()
        if small:
            self.adjoint = np.ascontiguousarray(slack_map.T.toarray())

    def multipliers(self, flat: Array) -> tuple[Array, Array | None]:
        """(e,) of the constraints' entries, and of each link of the entropy the slope S (links, 4, 4)
        with which -log det is bounded; flat (rows + 16 blocks,)."""
        links = np.count_nonzero(self.weight)
        slopes = flat[self.rows : self.rows + links * ORDER**2].reshape(-1, ORDER, ORDER)
        return self.home @ flat, slopes / self.weight[0] if links else None


def _sparse(parts: Sequence[_Triplets], shape: tuple[int, int]) -> sparse.csr_matrix:
    none = np.zeros(0, np.intp)
    row, column, value = (np.concatenate(x) for x in zip((none, none, none), *parts, strict=True))
    return sparse.csr_matrix((value, (row, column)), shape)


def _matrices(kind: Alike) -> Alike:
    """As matrices (g, 4, 4) and coefficients (g, k, 4, 4): second-order cones as arrows, and padded."""
    if (size := kind.constant.shape[1]) > ORDER:
        raise NotApplicableError(f"no matrices and cones of order {size}")
    constant = _padded(kind.cone, kind.constant)
    constant[:, range(size, ORDER), range(size, ORDER)] = 1.0
    return Alike("psd", kind.places, kind.indices, constant, _padded(kind.cone, kind.coefficients))


def _padded(cone: str, values: Array) -> Array:
    """(..., 4, 4) of matrices (..., d, d), or of second-order cones (..., d), zeros beside them."""
    size, lead = values.shape[-1], values.shape[: -2 if cone == "psd" else -1]
    out = np.zeros((*lead, ORDER, ORDER))
    if cone == "psd":
        out[..., :size, :size] = values
    else:
        out[..., range(size), range(size)] = values[..., :1]
        out[..., 0, 1:size] = out[..., 1:size, 0] = values[..., 1:]
    return out


def _each_row(kind: Alike) -> Alike:
    """Rows one by one, as matrices (g d, 1, 1) and coefficients (g d, k, 1, 1)."""
    d = kind.constant.shape[1]
    places, indices = np.repeat(kind.places, d), np.repeat(kind.indices, d, axis=0)
    coefficients = np.moveaxis(kind.coefficients, 2, 1).reshape(*indices.shape, 1, 1)
    return Alike("psd", places, indices, kind.constant.reshape(-1, 1, 1), coefficients)


def _homeward(kind: Alike, where: NDArray[np.intp], first: NDArray[np.intp]) -> _Triplets:
    """Entries of constraints, from ``where`` (g,) on, and the multipliers (from ``first`` (g,) on) that
    they are made of: the adjoint of what makes the slacks of them."""
    each = np.eye(kind.constant[0].size).reshape(-1, *kind.constant.shape[1:])
    made = each if kind.cone == "nonnegative" else _padded(kind.cone, each).reshape(len(each), -1)
    entry, own = np.nonzero(made)
    rows, columns = where[:, None] + entry, first[:, None] + own
    return rows.ravel(), columns.ravel(), np.tile(made[entry, own], len(where))


def _pairs(kind: Alike, start: int, p: int) -> _Triplets:
    """Of <F_i, S^-1 F_j Z> = sum F_i[a, b] F_j[c, d] (S^-1)[a, c] Z[d, b]: place in H, product of S^-1
    and Z (from ``start`` on), and F_i[a, b] F_j[c, d] with which it counts there."""
    (g, k), order = kind.indices.shape, kind.constant.shape[1]
    flat = kind.coefficients.reshape(g, k, -1)
    own, entry = np.nonzero(np.any(flat != 0.0, axis=0))
    one, other = (x.ravel() for x in np.indices((len(own), len(own))))
    (a, b), (c, d) = np.divmod(entry[one], order), np.divmod(entry[other], order)
    where = ((a * order + c) * order + d) * order + b
    row, column = kind.indices[:, own[one]], kind.indices[:, own[other]]
    value = flat[:, own[one], entry[one]] * flat[:, own[other], entry[other]]
    used = (row >= column) & (value != 0.0)
    where = start + np.arange(g)[:, None] * order**4 + where
    return (column * p + row)[used], where[used], value[used]
