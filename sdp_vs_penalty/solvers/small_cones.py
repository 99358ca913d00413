"""Constraints of an identification problem as arrays for :mod:`primal_dual`: small
cones together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Self

import numpy as np
import scipy

from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.robot.constraint import (
    ConeGroup,
    Constraint,
    ConstraintSet,
    StackedCones,
    group_cones,
)
from sdp_vs_penalty.solvers.convex_problem import Entropy
from sdp_vs_penalty.solvers.rewrite import NotApplicableError

#: Order of the largest matrix; smaller ones are padded with ones on the diagonal.
ORDER = 4
#: Up to so many entries a product with the whole matrix takes less than the call of a
#: sparse one.
_DENSE = 1 << 16


@dataclass(frozen=True)
class _ConePart:
    """Cones of one kind and size."""

    #: 0: nonnegative rows, 1: the entropy's links, 2: further blocks. Slacks are in this
    #: order.
    kind: int
    #: (slacks, d) map from a cone's entries to its slacks.
    image: Array
    #: (slacks,) constants that are added to the slacks.
    ones: Array
    #: (cones,) index among all entries where those of each cone begin.
    begins: Indices

    @property
    def n_slacks(self) -> int:
        """Number of slacks of all cones of this part."""
        return len(self.image) * len(self.begins)


class SmallCones:
    """Non-negative rows and 4x4 blocks, prepared for any data in the same parameters
    theta (p,).

    - ``constant`` + ``slack_map`` theta: the slacks (rows + 16 blocks,) of all rows, of
      the entropy's links and of further blocks, in this order.
    - ``weight`` (blocks,): factor of a block's -log det; ``linear`` (p,): the slope of
      the entropy's trace term.
    - ``curvature``: maps y / s of the rows and S^-1 (x) Z of the blocks to the entries
      ``places`` of the Hessian (p, p), lower triangle, column by column.
    - ``to_entries`` (e, rows + 16 blocks): maps multipliers to those of the constraints'
      entries, zero for one that another constraint implies.
    """

    def __init__(
        self, entropy: Entropy | None, constraints: ConstraintSet, p: int
    ) -> None:
        """Prepare the maps from theta (p,) to slacks: nonnegative rows, then 4x4
        blocks.

        Slacks = constant + slack_map theta. Smaller matrices are padded to 4x4 by ones
        on the diagonal. ``adjoint`` is slack_map^T; ``curvature`` maps products of
        slacks and multipliers to the entries ``places`` of the flat Hessian (p, p).
        Maps are dense where that is faster (fewer than _DENSE entries).

        Raises NotApplicableError for a matrix or second-order cone of an order above
        four.
        """
        links: tuple[Constraint, ...] = ()
        if entropy is not None and entropy.weight > 0.0:
            links = entropy.links
        groups = (*constraints.groups, *group_cones(links))
        parts = _parts(constraints, links, groups)
        cones = StackedCones.from_groups(groups)
        n_entries = sum(group.constant.size for group in groups)
        # Slacks = image (cones' entries) + ones on the diagonals of padded matrices.
        image = _image_of_parts(parts, n_entries)
        self.rows = sum(part.n_slacks for part in parts if part.kind == 0)
        ones = [np.tile(part.ones, len(part.begins)) for part in parts]
        self.constant = image @ cones.constant
        self.constant += np.concatenate([np.zeros(0), *ones])
        # The constraints' entries come before those of the prior's links.
        self.to_entries = image[:, : len(constraints.entries.constant)].T.tocsr()
        n_blocks = (image.shape[0] - self.rows) // ORDER**2
        self.weight = np.zeros(n_blocks)
        self.linear = np.zeros(p)
        self._n_links_with_prior = len(links)
        if entropy is not None and links:
            self._set_entropy_terms(entropy)
        places = (cones.row, cones.column)
        entries = scipy.sparse.csr_matrix((cones.value, places), (n_entries, p))
        slack_map = image @ entries
        # Of the Hessian's p^2 entries only those that some cone fills.
        curvature = _curvature(slack_map, self.rows)
        self.places = np.flatnonzero(np.diff(curvature.indptr))
        self.curvature = curvature[self.places]
        self.slack_map: Array | scipy.sparse.csr_matrix = slack_map
        self.adjoint: Array | scipy.sparse.csr_matrix = slack_map.T.tocsr()
        if math.prod(slack_map.shape) <= _DENSE:
            self.slack_map = slack_map.toarray()
            self.adjoint = np.ascontiguousarray(slack_map.T.toarray())

    def _set_entropy_terms(self, entropy: Entropy) -> None:
        """Set the prior's terms of the objective: w (tr(P_0^-1 P(theta)) - log det
        P(theta)).

        ``weight`` (blocks,) is w for the links' blocks, else zero; ``linear`` (p,) is
        the gradient of the trace term.
        """
        self.weight = np.zeros_like(self.weight)
        self.weight[: self._n_links_with_prior] = entropy.weight
        # tr(P_0^-1 P(theta)) is linear in theta.
        nominal_inverse, _ = entropy.nominal_terms
        p = len(self.linear)
        self.linear = entropy.weight * entropy.entries.adjoint(
            nominal_inverse.ravel(), p
        )

    def with_entropy(self, entropy: Entropy | None) -> Self:
        """Return the same cones with another prior on the same links.

        Parameters
        ----------
        entropy : Entropy or None
            Prior with another weight and nominal robot.

        Returns
        -------
        SmallCones
            Unchanged if the cones have no prior.
        """
        if not self._n_links_with_prior:
            return self
        assert entropy is not None
        assert entropy.weight > 0.0
        cones = copy(self)
        cones._set_entropy_terms(entropy)
        return cones

    def multipliers(self, flat: Array) -> tuple[Array, Array | None]:
        """Return the slacks' multipliers (rows + 16 blocks,) in the form of the
        constraints.

        Returns
        -------
        (e,) array
            Multipliers of the constraints' entries.
        (links, 4, 4) array or None
            For each link of the prior the matrix S that bounds its -log det; None
            without a prior.
        """
        links = np.count_nonzero(self.weight)
        end = self.rows + links * ORDER**2
        slopes = flat[self.rows : end].reshape(-1, ORDER, ORDER)
        return self.to_entries @ flat, slopes / self.weight[0] if links else None


def _parts(
    constraints: ConstraintSet, links: Sequence[Constraint], groups: Sequence[ConeGroup]
) -> list[_ConePart]:
    """Return the groups of cones in the order of the slacks.

    The order is: nonnegative rows, the links of the entropic prior, other blocks.
    Constraints that others imply are left out, and so is the pseudo-inertia of a link
    with a prior, since -log det P keeps it positive definite.
    """
    implied_by_prior = {("pseudo-inertia", *link.indices.tolist()) for link in links}
    needed = {
        constraint
        for constraint in constraints.essential
        if (constraint.family, *constraint.indices.tolist()) not in implied_by_prior
    }
    parts = []
    start = 0  # first entry of the group among all groups' entries
    for number, group in enumerate(groups):
        # The links of the prior come after the constraints' groups.
        is_of_links = number >= len(constraints.groups)
        if is_of_links:
            members = np.arange(len(group.places))
            kind = 1
        else:
            is_needed = [constraints.convex[k] in needed for k in group.places]
            members = np.flatnonzero(is_needed)
            kind = 0 if group.cone == "nonnegative" else 2
        image, ones = _image(group.cone, group.constant.shape[1])
        begins = start + image.shape[1] * members  # first entry of each cone
        parts.append(_ConePart(kind, image, ones, begins))
        start += group.constant.size
    return sorted(parts, key=lambda part: part.kind)


def _image_of_parts(
    parts: Sequence[_ConePart], n_entries: int
) -> scipy.sparse.csr_matrix:
    """Return the sparse map (slacks, entries) from the cones' entries to the slacks.

    All cones of a part have the same small map, ``part.image``; it is placed once for
    each cone, at the first entry ``part.begins`` of that cone.
    """
    # Row, column and value of each nonzero; the first items are for no parts at all.
    rows = [np.zeros(0, np.intp)]
    columns = [np.zeros(0, np.intp)]
    values = [np.zeros(0)]
    n_slacks = 0
    for part in parts:
        row, column = np.nonzero(part.image)
        n_cones = len(part.begins)
        first_rows = n_slacks + len(part.image) * np.arange(n_cones)
        rows.append((first_rows[:, None] + row).ravel())
        columns.append((part.begins[:, None] + column).ravel())
        values.append(np.tile(part.image[row, column], n_cones))
        n_slacks += part.n_slacks
    places = (np.concatenate(rows), np.concatenate(columns))
    shape = (n_slacks, n_entries)
    return scipy.sparse.csr_matrix((np.concatenate(values), places), shape)


def _image(cone: str, d: int) -> tuple[Array, Array]:
    """Return the map (slacks, entries) from a cone's entries to its slacks, and the
    constants (slacks,) that are added.

    A nonnegative row is its own slack. A matrix of order d <= 4 becomes a 4x4 matrix
    with ones on the further diagonal. A second-order cone (axis first) becomes the
    arrow matrix with the axis on its diagonal. Raises NotApplicableError for d > 4.
    """
    if cone == "nonnegative":
        return np.eye(d), np.zeros(d)
    if d > ORDER:
        raise NotApplicableError(f"no matrices and cones of order {d}")
    slack = np.arange(ORDER**2).reshape(ORDER, ORDER)  # number of each matrix entry
    n_entries = d * d if cone == "psd" else d
    entry = np.arange(n_entries)
    image = np.zeros((ORDER**2, n_entries))
    if cone == "psd":
        image[slack[:d, :d].ravel(), entry] = 1.0
    else:
        image[slack[0, :d], entry] = 1.0
        image[slack[:d, 0], entry] = 1.0
        image[np.diagonal(slack)[:d], 0] = 1.0
    is_padding = np.arange(ORDER) >= d
    return image, np.asarray(np.diag(is_padding).ravel(), float)


def _curvature(
    slack_map: scipy.sparse.csr_matrix, rows: int
) -> scipy.sparse.csr_matrix:
    """Return the sparse map (p^2, rows + 256 blocks) from products of slacks to the
    Hessian.

    H_ij = sum over blocks of <F_i, S^-1 F_j Z> = sum F_i[a, b] F_j[c, d] (S^-1)[a, c]
    Z[d, b]: an entry of the map is the factor F_i[a, b] F_j[c, d] of the product
    (S^-1)[a, c] Z[d, b] in H_ij, for i >= j, at the place (j, i). For a row the product
    is z / s. slack_map (rows + 16 blocks, p) holds the F_i.
    """
    nonzero = slack_map.tocoo()
    p = slack_map.shape[1]
    # Block of each nonzero entry (a row is a block of its own), and its place in it.
    is_row = nonzero.row < rows
    block, entry = np.divmod(nonzero.row - rows, ORDER**2)
    block = np.where(is_row, nonzero.row, rows + block)
    entry = np.where(is_row, 0, entry)
    first, second = _pairs_in_blocks(block)
    is_lower = nonzero.col[first] >= nonzero.col[second]
    first = first[is_lower]
    second = second[is_lower]
    # Place of (S^-1)[a, c] Z[d, b] among the products: rows have one, blocks 4^4 each.
    a, b = np.divmod(entry[first], ORDER)
    c, d = np.divmod(entry[second], ORDER)
    block_number = np.maximum(block[first] - rows, 0)
    product = block[first] + (ORDER**4 - 1) * block_number
    product = product + ((a * ORDER + c) * ORDER + d) * ORDER + b
    n_products = rows + (slack_map.shape[0] - rows) * ORDER**2
    value = nonzero.data[first] * nonzero.data[second]
    places = (nonzero.col[second] * p + nonzero.col[first], product)
    return scipy.sparse.csr_matrix((value, places), (p * p, n_products))


def _pairs_in_blocks(block: Indices) -> tuple[Indices, Indices]:
    """Return all pairs (first, second) of entries of one block, from the ascending block
    numbers (N,) of the entries: two arrays of numbers of entries."""
    count = np.bincount(block)[block]
    begins = np.searchsorted(block, block)
    first = np.repeat(np.arange(len(block)), count)
    first_pair = np.cumsum(count) - count
    second = np.arange(len(first)) - np.repeat(first_pair - begins, count)
    return first, second
