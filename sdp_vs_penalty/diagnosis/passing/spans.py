"""When something acts: spans of time, and what a law explains in them.

Spans are unions of cells of time. The search for them begins with none, and inverts x
between two edges of cells, as long as this explains more than its edges cost.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from sdp_vs_penalty.diagnosis.linear_fit import WhiteFit
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask

#: The most inversions of spans.
_MAX_INVERSIONS = 12
#: Spans whose products are held in memory at a time.
_AT_A_TIME = 500


@dataclass(frozen=True, eq=False)
class CellProducts:
    """Products of a law's weighted columns Z with a fit, summed over each of C cells of
    time.

    For the spans x (C,) of 0 and 1 the columns x Z have the Gram matrix G = sum_c x_c
    Z_c'Z_c. The fit leaves G - S'S of it, with S = sum_c x_c Q_c'Z_c. With b = sum_c
    x_c Z_c'r the squared error falls by b'(G - S'S)^-1 b.
    """

    #: (C, k, k) products Z'Z.
    grams: Array
    #: (C, r, k) products Q'Z with the fit's r orthonormal columns.
    along_fit: Array
    #: (C, k) products Z'r with the residual.
    with_residual: Array

    @classmethod
    def from_cells(cls, fit: WhiteFit, white: Array, cells: Cells) -> CellProducts:
        """Multiply white columns of a law (n joints, M rows, k) with a fit, cell by cell."""
        Z = white / fit.level[:, None, None]
        Q = fit.basis  # (n, M, r)
        residual = fit.residual  # (n, M)
        products = []
        for rows in cells.rows:
            # The rows of all joints in this cell, one joint below the other. A fixed
            # model has no columns: its Q_c is (size, 0).
            size = len(Z) * len(rows)
            Z_c, Q_c = (x[:, rows].reshape(size, x.shape[2]) for x in (Z, Q))
            r_c = residual[:, rows].ravel()
            products.append((Z_c.T @ Z_c, Q_c.T @ Z_c, Z_c.T @ r_c))
        grams, along_fit, with_residual = map(np.array, zip(*products, strict=True))
        return cls(grams, along_fit, with_residual)

    def over(self, x: Array) -> tuple[Array, Array]:
        """Return G - S'S (k, k) and b (k,) of the spans x (C,)."""
        S = np.tensordot(x, self.along_fit, 1)
        gram = np.tensordot(x, self.grams, 1) - S.T @ S
        return gram, x @ self.with_residual

    def parameters(self, x: Array) -> Array:
        """Return the parameters (k,) of least squares with the spans x (C,)."""
        gram, right = self.over(x)
        own = np.tensordot(x, self.grams, 1)
        return np.asarray(np.linalg.solve(regular(gram, own), right))

    def falls(self, x: Array, pairs: Indices) -> Array:
        """Return by how much the squared error falls (P,) with the spans x (C,)
        inverted between two cells.

        Parameters
        ----------
        pairs
            (P, 2) first cell of each inverted span, and the first one behind it.
        """
        change = 1.0 - 2.0 * x  # of x where it is inverted

        def sums(products: Array) -> tuple[Array, Array]:
            """Return the sum with x, and the running sums of the changes."""
            signed = change.reshape(-1, *[1] * (products.ndim - 1)) * products
            running = np.concatenate([np.zeros_like(signed[:1]), signed.cumsum(axis=0)])
            return np.tensordot(x, products, 1), running

        G, G_sums = sums(self.grams)
        S, S_sums = sums(self.along_fit)
        b, b_sums = sums(self.with_residual)
        out = []
        for start in range(0, len(pairs), _AT_A_TIME):
            first, last = pairs[start : start + _AT_A_TIME].T
            gram = G + G_sums[last] - G_sums[first]
            along = S + S_sums[last] - S_sums[first]
            right = b + b_sums[last] - b_sums[first]
            left = gram - along.transpose(0, 2, 1) @ along
            beta = np.linalg.solve(regular(left, gram), right[:, :, None])[:, :, 0]
            out.append(np.sum(beta * right, axis=1))
        return np.concatenate(out)


def regular(left: Array, gram: Array) -> Array:
    """Add a millionth of the columns' own squares to what a fit leaves of them.

    A column that the fit absorbs then has no coefficient. left, gram (..., k, k).
    """
    own = np.diagonal(gram, axis1=-2, axis2=-1) + 1e-12
    return left + 1e-6 * own[..., None] * np.eye(gram.shape[-1])


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of time, in order: which of the M rows belong to each, and to which run."""

    #: (M,) the cell of each row.
    label: Indices
    #: (C,) the run of each cell.
    run: Indices

    @classmethod
    def from_labels(cls, label: Indices, run_of_rows: Indices) -> Cells:
        """Make cells of labels from 0 without gaps."""
        _, first = np.unique(label, return_index=True)
        return cls(label, run_of_rows[first])

    @cached_property
    def rows(self) -> list[Indices]:
        """The numbers of each cell's rows."""
        order = np.argsort(self.label, kind="stable")
        ends = np.searchsorted(self.label[order], np.arange(len(self.run) + 1))
        return [order[a:b] for a, b in pairwise(ends)]

    def divided(self, parts: int) -> Cells:
        """Divide each cell into some parts with equally many rows."""
        fine = np.empty_like(self.label)
        count = 0
        for rows in self.rows:
            part = np.arange(len(rows)) * parts // len(rows)
            part = np.unique(part, return_inverse=True)[1]
            fine[rows] = count + part
            count += int(part[-1]) + 1
        run = np.zeros(count, np.intp)
        run[fine] = self.run[self.label]
        return Cells(fine, run)

    def count_edges(self, x: Array) -> int:
        """Count the instants at which x (C,) changes within a run."""
        return int(np.sum(self._steps(x)))

    def _steps(self, x: Array) -> Mask:
        """Flag the C - 1 borders of cells at which x (C,) changes within a run."""
        return (np.diff(x) != 0.0) & (np.diff(self.run) == 0)

    def with_moved_edges(self, x: Array) -> Iterator[tuple[Array, Array]]:
        """Yield for each edge of x (C,) the spans with it a cell earlier, and later."""
        for edge in np.flatnonzero(self._steps(x)):
            earlier = x.copy()
            earlier[edge] = x[edge + 1]
            later = x.copy()
            later[edge + 1] = x[edge]
            yield earlier, later

    def edges_added(self, x: Array, pairs: Indices) -> Indices:
        """Return how many edges (P,) an inversion of x (C,) between two borders adds.

        A border at the begin or end of a run costs nothing; one at an edge moves it.
        """
        added = np.zeros(len(x) + 1, np.intp)
        in_run = np.diff(self.run) == 0
        added[1:-1] = np.where(in_run, np.where(self._steps(x), -1, 1), 0)
        return added[pairs[:, 0]] + added[pairs[:, 1]]


def find_spans(
    products: CellProducts,
    cells: Cells,
    start: Array,
    price: float,
    longest: int | None = None,
) -> Array:
    """Find the spans in which a law explains most, less a price for each edge.

    Parameters
    ----------
    start
        (C,) the spans at first, of 0 and 1.
    price
        Fall of the squared error that an edge has to bring.
    longest
        The most cells that are inverted at once; default: all.

    Returns
    -------
    (C,) array
        1 in the spans, 0 elsewhere.
    """
    C = len(start)
    pairs = np.stack(np.triu_indices(C + 1, 1), axis=1)
    if longest is not None:
        pairs = pairs[pairs[:, 1] - pairs[:, 0] <= longest]
    x = start.copy()
    nothing = np.zeros((1, 2), np.intp)
    best = float(products.falls(x, nothing)[0]) - price * cells.count_edges(x)
    for _ in range(_MAX_INVERSIONS):
        n_edges = cells.count_edges(x) + cells.edges_added(x, pairs)
        value = products.falls(x, pairs) - price * n_edges
        k = int(np.argmax(value))
        if not value[k] > best:
            break
        best = float(value[k])
        first, last = pairs[k]
        x[first:last] = 1.0 - x[first:last]
    return x
