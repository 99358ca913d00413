"""Constraints of an identification problem as arrays for :mod:`primal_dual`: small
cones together."""

import math
from copy import copy
from typing import Self

import numpy as np
from scipy import sparse

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import ConstraintSet, StackedCones, group_cones
from sdp_vs_penalty.solvers.objective import Entropy
from sdp_vs_penalty.solvers.rewrite import NotApplicableError

#: Order of the largest matrix; smaller ones are padded with ones on the diagonal.
ORDER = 4
#: Up to so many entries a product with the whole matrix takes less than the call of a
#: sparse one.
_DENSE = 1 << 16


class SmallCones:
    """Non-negative rows and 4x4 blocks, prepared for any data in the same parameters
    theta (p,).

    Slacks (rows + 16 blocks,) = constant + slack_map theta: those of all rows, of the
    entropy's links, of further blocks. weight (blocks,) : of -log det; linear (p,) :
    the slope of its trace term. curvature turns y / s of the rows and the Kronecker
    products of S^-1 and Z of the blocks into the entries ``places`` of H (p, p), lower
    triangle column by column. home (e, rows + 16 blocks) : from multipliers to those of
    the constraints' entries, zero where another constraint implies one.
    """

    def __init__(
        self, entropy: Entropy | None, constraints: ConstraintSet, p: int
    ) -> None:
        """Raises NotApplicableError for cones of an order above four."""
        links = entropy.links if entropy is not None and entropy.weight > 0.0 else ()
        barred = {
            ("pseudo-inertia", *link.indices.tolist()) for link in links
        }  # by their log det
        place_by_size = {
            c
            for c in constraints.essential
            if (c.family, *c.indices.tolist()) not in barred
        }
        groups = (*constraints.groups, *group_cones(links))
        start = 0
        parts = []
        for number, group in enumerate(groups):
            members = np.arange(len(group.places))
            turn = 1
            if number < len(constraints.groups):
                members = np.flatnonzero(
                    [constraints.convex[k] in place_by_size for k in group.places]
                )
                turn = 0 if group.cone == "nonnegative" else 2
            image, ones = _image(group.cone, group.constant.shape[1])
            parts.append((turn, image, ones, start + image.shape[1] * members))
            start += group.constant.size
        parts.sort(key=lambda part: part[0])  # rows, links, others
        none = np.zeros(0, np.intp)
        first = 0
        row = [none]
        column = [none]
        value = [np.zeros(0)]
        for _, image, _, begins in parts:
            entry, of = np.nonzero(image)
            row.append(
                (first + len(image) * np.arange(len(begins))[:, None] + entry).ravel()
            )
            column.append((begins[:, None] + of).ravel())
            value.append(np.tile(image[entry, of], len(begins)))
            first += len(image) * len(begins)
        cones = StackedCones.from_groups(groups)
        where = np.concatenate(row), np.concatenate(column)
        image = sparse.csr_matrix((np.concatenate(value), where), (first, start))
        self.rows = sum(
            ones.size * len(begins) for turn, _, ones, begins in parts if turn == 0
        )
        self.constant = image @ cones.constant
        self.constant += np.concatenate(
            [np.zeros(0), *(np.tile(x[2], len(x[3])) for x in parts)]
        )
        self.home = image[:, : len(constraints.entries.constant)].T.tocsr()
        self.weight, self.linear = (
            np.zeros((first - self.rows) // ORDER**2),
            np.zeros(p),
        )
        self._count = len(links)
        if entropy is not None and links:
            self._weigh(entropy)
        shape = (start, p)
        slack_map = image @ sparse.csr_matrix(
            (cones.value, (cones.row, cones.column)), shape
        )
        curvature = _curvature(slack_map, self.rows)
        self.places = np.flatnonzero(np.diff(curvature.indptr))
        self.curvature = curvature[self.places]
        small = math.prod(slack_map.shape) <= _DENSE
        self.slack_map: Array | sparse.csr_matrix = (
            slack_map.toarray() if small else slack_map
        )
        self.adjoint: Array | sparse.csr_matrix = slack_map.T.tocsr()
        if small:
            self.adjoint = np.ascontiguousarray(slack_map.T.toarray())

    def _weigh(self, entropy: Entropy) -> None:
        """Set weight and linear term of the prior."""
        self.weight = np.zeros_like(self.weight)
        self.weight[: self._count] = entropy.weight
        slope = entropy.entries.adjoint(
            entropy.nominal_terms[0].ravel(), len(self.linear)
        )
        self.linear = entropy.weight * slope

    def with_entropy(self, entropy: Entropy | None) -> Self:
        """The same cones with another weight and nominal robot of a prior on the same
        links; as they are without one."""
        if not self._count:
            return self
        assert entropy is not None
        assert entropy.weight > 0.0
        cones = copy(self)
        cones._weigh(entropy)
        return cones

    def multipliers(self, flat: Array) -> tuple[Array, Array | None]:
        """(e,) of the constraints' entries, and of each link of the entropy the slope S
        (links, 4, 4) with which -log det is bounded; flat (rows + 16 blocks,)."""
        links = np.count_nonzero(self.weight)
        slopes = flat[self.rows : self.rows + links * ORDER**2].reshape(
            -1, ORDER, ORDER
        )
        return self.home @ flat, slopes / self.weight[0] if links else None


def _image(cone: str, d: int) -> tuple[Array, Array]:
    """From a cone's entries to its slacks, and what is added: itself, or a 4x4 matrix
    with ones beside a smaller one; of a second-order cone the arrow."""
    if cone == "nonnegative":
        return np.eye(d), np.zeros(d)
    if d > ORDER:
        raise NotApplicableError(f"no matrices and cones of order {d}")
    at = np.arange(ORDER**2).reshape(ORDER, ORDER)
    entry = np.arange(d)
    image = np.zeros((ORDER**2, d * d if cone == "psd" else d))
    if cone == "psd":
        image[at[:d, :d].ravel(), np.arange(d * d)] = 1.0
    else:
        image[at[0, :d], entry] = image[at[:d, 0], entry] = image[
            np.diagonal(at)[:d], 0
        ] = 1.0
    return image, np.asarray(np.diag(np.arange(ORDER) >= d).ravel(), float)


def _curvature(slack_map: sparse.csr_matrix, rows: int) -> sparse.csr_matrix:
    """(p^2, rows + 256 blocks): of <F_i, S^-1 F_j Z> = sum F_i[a, b] F_j[c, d]
    (S^-1)[a, c] Z[d, b] with which factor each product of S^-1 and Z counts at (j, i),
    i >= j."""
    part = slack_map.tocoo()
    p = slack_map.shape[1]
    block, entry = np.divmod(part.row - rows, ORDER**2)
    block, entry = np.where(
        part.row < rows, [part.row, 0 * entry], [rows + block, entry]
    )
    count = np.bincount(block)[block]
    begins = np.searchsorted(block, block)
    one = np.repeat(np.arange(len(block)), count)
    other = np.arange(len(one)) - np.repeat(np.cumsum(count) - count - begins, count)
    used = part.col[one] >= part.col[other]
    one = one[used]
    other = other[used]
    (a, b), (c, d) = np.divmod(entry[one], ORDER), np.divmod(entry[other], ORDER)
    product = block[one] + (ORDER**4 - 1) * np.maximum(block[one] - rows, 0)
    product = product + ((a * ORDER + c) * ORDER + d) * ORDER + b
    wide = rows + (slack_map.shape[0] - rows) * ORDER**2
    value = part.data[one] * part.data[other]
    return sparse.csr_matrix(
        (value, (part.col[other] * p + part.col[one], product)), (p * p, wide)
    )
