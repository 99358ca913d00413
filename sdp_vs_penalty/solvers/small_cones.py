"""Constraints of an identification problem as arrays for :mod:`primal_dual`: small cones together."""

from __future__ import annotations

import math
from dataclasses import dataclass

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


@dataclass(frozen=True)
class SmallCones:
    """Non-negative rows and 4x4 blocks, prepared for any data in the same parameters theta (p,).

    constraints : those that no other implies. Slacks (rows + 16 blocks,) = constant + slack_map theta,
    of one kind after the other: rows, then the ``linked`` kinds of blocks that are the entropy's links,
    then further blocks. weight (blocks,) : of -log det; linear (p,) : the slope of its trace term.
    curvature turns y / s of the rows and the Kronecker products of S^-1 and Z of the blocks into the
    entries ``places`` of H (p, p), lower triangle column by column.
    """

    constraints: tuple[Constraint, ...]
    kinds: tuple[Alike, ...]
    linked: int
    rows: int
    linear: Array
    weight: Array
    constant: Array
    slack_map: Array | sparse.csr_matrix
    adjoint: Array | sparse.csr_matrix
    curvature: sparse.csr_matrix
    places: NDArray[np.intp]

    @classmethod
    def of(cls, entropy: Entropy | None, constraints: ConstraintSet, p: int) -> SmallCones:
        """Raises NotApplicableError for cones of an order above four."""
        links = entropy.links if entropy is not None and entropy.weight > 0.0 else ()
        barred = {("pseudo-inertia", *link.indices.tolist()) for link in links}  # by their log det
        chosen = [c for c in constraints.essential if (c.family, *c.indices.tolist()) not in barred]
        found = alike(chosen)
        rows = [kind for kind in found if kind.cone == "nonnegative"]
        blocks = [*alike(links), *(kind for kind in found if kind.cone != "nonnegative")]
        matrices = [_matrices(kind) for kind in blocks]
        count = sum(kind.constant.size for kind in rows)
        members = [len(kind.places) for kind in blocks]
        linear, weight = np.zeros(p), np.zeros(sum(members))
        if entropy is not None and links:
            weight[: len(links)] = entropy.weight
            for link, inverse in zip(links, entropy.nominal_terms[0], strict=True):
                linear[link.indices] += entropy.weight * link.adjoint(inverse)
        ends = np.cumsum([0, *(kind.constant.size for kind in rows)])
        firsts = np.cumsum([0, *members])
        pairs = [_row_pairs(kind, int(k), p) for kind, k in zip(rows, ends[:-1], strict=True)]
        for kind, k in zip(matrices, firsts[:-1], strict=True):
            pairs.append(_block_pairs(kind, count + int(k) * ORDER**4, p))
        entries = Entries.of([*rows, *matrices])
        shape = (len(entries.constant), p)
        slack_map = sparse.csr_matrix((entries.value, (entries.row, entries.column)), shape)
        small = math.prod(shape) <= _DENSE
        none = np.zeros((2, 0), np.intp)
        row, column, value = (np.concatenate(x) for x in zip((*none, none[0]), *pairs, strict=True))
        wide = count + len(weight) * ORDER**4
        curvature = sparse.csr_matrix((value, (row, column)), (p * p, wide))
        places = np.flatnonzero(np.diff(curvature.indptr))
        return cls(
            tuple(chosen),
            (*rows, *blocks),
            len(alike(links)),
            count,
            linear,
            weight,
            entries.constant,
            slack_map.toarray() if small else slack_map,
            np.ascontiguousarray(slack_map.T.toarray()) if small else slack_map.T.tocsr(),
            curvature[places],
            places,
        )

    def multipliers(self, flat: Array) -> tuple[dict[Constraint, Array], Array | None]:
        """Of each constraint that no other implies its multiplier, and of each link of the entropy the
        slope S (links, 4, 4) with which -log det is bounded; flat (rows + 16 blocks,)."""
        own = dict[Constraint, Array]()
        slopes = np.empty((np.count_nonzero(self.weight), ORDER, ORDER))
        start = blocks = 0
        for kind in self.kinds:
            size = kind.constant.shape[1]
            rows = kind.cone == "nonnegative"
            blocks += not rows
            shape = kind.constant.shape if rows else (len(kind.places), ORDER, ORDER)
            stop = start + math.prod(shape)
            Z, start = flat[start:stop].reshape(shape), stop
            if not rows and blocks <= self.linked:
                slopes[kind.places] = Z / self.weight[0]
                continue
            if kind.cone == "soc":
                trace = np.trace(Z[:, :size, :size], axis1=1, axis2=2)
                Z = np.hstack([trace[:, None], 2.0 * Z[:, 0, 1:size]])
            elif kind.cone == "psd":
                Z = Z[:, :size, :size]
            for k, z in zip(kind.places.tolist(), Z, strict=True):
                own[self.constraints[k]] = z
        return own, slopes if self.linked else None


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
