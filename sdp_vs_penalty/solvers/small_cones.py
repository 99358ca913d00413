"""Constraints of an identification problem as arrays for :mod:`primal_dual`: small cones together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Alike, ConstraintSet, Entries, alike
from sdp_vs_penalty.solvers.objective import Entropy
from sdp_vs_penalty.solvers.rewrite import NotApplicableError

#: Order of the largest matrix; smaller ones are padded with ones on the diagonal.
ORDER = 4
#: Up to so many entries a product with the whole matrix takes less than the call of a sparse one.
_DENSE = 1 << 16
#: Rows, columns and values of a sparse matrix.
_Triplets = tuple[NDArray[np.intp], NDArray[np.intp], Array]


@dataclass(frozen=True)
class SmallCones:
    """Non-negative rows and 4x4 blocks, prepared for any data in the same parameters theta (p,).

    Slacks (rows + 16 blocks,) = constant + slack_map theta: those of all rows, of the entropy's links,
    of further blocks. weight (blocks,) : of -log det; linear (p,) : the slope of its trace term.
    curvature turns y / s of the rows and the Kronecker products of S^-1 and Z of the blocks into the
    entries ``places`` of H (p, p), lower triangle column by column. home (e, rows + 16 blocks) : from
    multipliers to those of the constraints' entries, zero where another constraint implies one.
    """

    rows: int
    linear: Array
    weight: Array
    constant: Array
    slack_map: Array | sparse.csr_matrix
    adjoint: Array | sparse.csr_matrix
    curvature: sparse.csr_matrix
    places: NDArray[np.intp]
    home: sparse.csr_matrix

    @classmethod
    def of(cls, entropy: Entropy | None, constraints: ConstraintSet, p: int) -> SmallCones:
        """Raises NotApplicableError for cones of an order above four."""
        links = entropy.links if entropy is not None and entropy.weight > 0.0 else ()
        barred = {("pseudo-inertia", *link.indices.tolist()) for link in links}  # by their log det
        chosen = [c for c in constraints.essential if (c.family, *c.indices.tolist()) not in barred]
        found = alike(chosen)
        rows = [kind for kind in found if kind.cone == "nonnegative"]
        others = [kind for kind in found if kind.cone != "nonnegative"]
        kinds = [*rows, *map(_matrices, (*alike(links), *others))]
        entries, linear = Entries.of(kinds), np.zeros(p)
        count = sum(kind.constant.size for kind in rows)
        weight = np.zeros((len(entries.constant) - count) // ORDER**2)
        if entropy is not None and links:
            weight[: len(links)] = entropy.weight
            linear = entropy.weight * entropy.entries.adjoint(entropy.nominal_terms[0].ravel(), p)
        pairs, wide = list[_Triplets](), 0
        for kind in kinds:
            pairs.append((_row_pairs if kind.cone == "nonnegative" else _block_pairs)(kind, wide, p))
            wide += kind.constant.size * (1 if kind.cone == "nonnegative" else ORDER**2)
        curvature = _sparse(pairs, (p * p, wide))
        places = np.flatnonzero(np.diff(curvature.indptr))
        back, own, start = list[_Triplets](), {}, 0
        for kind in constraints.groups:
            for k in kind.places.tolist():
                own[constraints.convex[k]], start = start, start + constraints.convex[k].constant.size
        first = 0
        for kind in (*rows, *others):
            if kind.cone != "nonnegative":
                first = max(first, count + len(links) * ORDER**2)
            where = np.array([own[chosen[k]] for k in kind.places.tolist()])
            back.append(_homeward(kind, where, first))
            first += len(where) * (kind.constant.shape[1] if kind.cone == "nonnegative" else ORDER**2)
        shape = (len(entries.constant), p)
        slack_map = _sparse([(entries.row, entries.column, entries.value)], shape)
        small = math.prod(shape) <= _DENSE
        return cls(
            count,
            linear,
            weight,
            entries.constant,
            slack_map.toarray() if small else slack_map,
            np.ascontiguousarray(slack_map.T.toarray()) if small else slack_map.T.tocsr(),
            curvature[places],
            places,
            _sparse(back, (start, len(entries.constant))),
        )

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
    size = kind.constant.shape[1]
    if size > ORDER:
        raise NotApplicableError(f"no matrices and cones of order {size}")

    def padded(values: Array, lead: int, rest: float) -> Array:
        out = np.zeros((*values.shape[:lead], ORDER, ORDER))
        out[..., range(size, ORDER), range(size, ORDER)] = rest
        if kind.cone == "psd":
            out[..., :size, :size] = values
        else:
            out[..., range(size), range(size)] = values[..., :1]
            out[..., 0, 1:size] = out[..., 1:size, 0] = values[..., 1:]
        return out

    constant, coefficients = padded(kind.constant, 1, 1.0), padded(kind.coefficients, 2, 0.0)
    return Alike("psd", kind.places, kind.indices, constant, coefficients)


def _homeward(kind: Alike, where: NDArray[np.intp], start: int) -> _Triplets:
    """Entries of constraints, from ``where`` (g,) on, and the multipliers (from ``start`` on) that they
    are made of; a second-order cone's of its arrow."""
    size = kind.constant.shape[1]
    entry = own = np.arange(size)
    value, width = np.ones(size), size
    if kind.cone == "psd":
        i, j = (x.ravel() for x in np.indices((size, size)))
        entry, own, value, width = i * size + j, i * ORDER + j, np.ones(size**2), ORDER**2
    elif kind.cone == "soc":
        entry, own = np.append(0 * own, own[1:]), np.append(own * (ORDER + 1), own[1:])
        value, width = np.repeat([1.0, 2.0], [size, size - 1]), ORDER**2
    first = start + width * np.arange(len(where))
    every = where[:, None] + entry, first[:, None] + own, np.tile(value, (len(where), 1))
    return every[0].ravel(), every[1].ravel(), every[2].ravel()


def _row_pairs(kind: Alike, start: int, p: int) -> _Triplets:
    """Place in H, row, and a_i a_j with which y / s of the row (from ``start`` on) counts there."""
    both = kind.coefficients[:, :, None] * kind.coefficients[:, None]
    member, i, j, entry = np.nonzero(both)
    row, column = kind.indices[member, i], kind.indices[member, j]
    lower = row >= column
    where = start + member * kind.constant.shape[1] + entry
    return (column * p + row)[lower], where[lower], both[member, i, j, entry][lower]


def _block_pairs(kind: Alike, start: int, p: int) -> _Triplets:
    """The same for <F_i, S^-1 F_j Z> = sum F_i[a, b] F_j[c, d] (S^-1)[a, c] Z[d, b]."""
    g, k = kind.indices.shape
    flat = kind.coefficients.reshape(g, k, -1)
    own, entry = np.nonzero(np.any(flat != 0.0, axis=0))
    one, other = (x.ravel() for x in np.indices((len(own), len(own))))
    (a, b), (c, d) = np.divmod(entry[one], ORDER), np.divmod(entry[other], ORDER)
    where = ((a * ORDER + c) * ORDER + d) * ORDER + b
    row, column = kind.indices[:, own[one]], kind.indices[:, own[other]]
    value = flat[:, own[one], entry[one]] * flat[:, own[other], entry[other]]
    used = (row >= column) & (value != 0.0)
    where = start + np.arange(g)[:, None] * ORDER**4 + where
    return (column * p + row)[used], where[used], value[used]
