"""The model behind a colour's filter: fitted with any levels of the joints, filtered once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import scipy.linalg

from sdp_vs_penalty.diagnosis.extension import triangle
from sdp_vs_penalty.diagnosis.fit import RowLabels, Weighting, WhiteFit
from sdp_vs_penalty.robot.arrays import Array

#: Rows are compressed to triangles where that makes them fewer by this.
_FEWER = 3


@dataclass(frozen=True)
class Coloured:
    """The model's white columns (n, M, r) and the torque (n, M) behind the colour's filter, not yet
    divided by the joints' levels; factors : each joint's columns, orthonormal ones times a triangle."""

    columns: Array
    target: Array
    factors: tuple[tuple[Array, Array], ...]
    weighting: Weighting
    _added: dict[int, tuple[Array, dict[int, tuple[Array, Array]]]] = field(
        default_factory=dict, init=False
    )

    @classmethod
    def of(cls, basis: Array, target: Array, weighting: Weighting) -> Coloured:
        """From white columns (n M, r) of full rank and white torque (n M,)."""
        n, (N, r) = len(weighting.level), basis.shape
        only = replace(weighting, level=np.ones(n))
        columns = only.apply_all(basis).reshape(n, N // n, r)
        factors = tuple((np.asarray(q), np.asarray(R)) for q, R in map(np.linalg.qr, columns))
        return cls(columns, only.apply_all(target).reshape(n, -1), factors, only)

    def compressed(
        self, rows: RowLabels, white: Sequence[Array], weighting: Weighting
    ) -> WhiteFit | None:
        """The fit with white columns (n M, k) more, on the rows of a triangle of each joint's columns
        and torque, where these are fewer: joints' errors and degrees are the same."""
        n, M, r = self.columns.shape
        ends = r + np.cumsum([0, *(w.shape[1] for w in white)])
        size = int(ends[-1]) + 1
        if _FEWER * size > M:
            return None
        out = np.zeros((n, size, size))
        for j, (q, R) in enumerate(self.factors):
            known = [
                (slice(a, a + w.shape[1]), self._beside(w)) for a, w in zip(ends, white, strict=False)
            ]
            own = [(at, parts[j]) for at, parts in known if j in parts]
            along = q.T @ self.target[j]
            own.append((slice(size - 1, size), (along[:, None], (self.target[j] - q @ along)[:, None])))
            out[j, :r, :r] = R
            for at, (overlap, _) in own:
                out[j, :r, at] = overlap
            places = np.concatenate([np.r_[at] for at, _ in own])
            rest = triangle(np.hstack([left for _, (_, left) in own]))
            out[j, r : r + len(rest), places] = rest.T
        few = replace(weighting, colour=np.zeros_like(weighting.colour))
        labels = replace(rows, block=np.zeros(size, np.intp), fold=np.zeros(size, np.intp))
        less = Coloured(out[:, :, :r], out[:, :, -1], self.factors, few)
        parts = [out[:, :, a:b].reshape(n * size, -1) for a, b in pairwise(ends.tolist())]
        return less.fit(labels, few).extended(*parts)

    def _beside(self, white: Array) -> dict[int, tuple[Array, Array]]:
        """Of white columns behind the colour's filter, by joint: their products with the joint's
        orthonormal ones and what these leave; kept."""
        if id(white) not in self._added:
            parts = {}
            for j, z in enumerate(white.reshape(*self.target.shape, -1)):
                if z.any():
                    z, q = self.weighting.apply(z, j), self.factors[j][0]
                    overlap = q.T @ z
                    parts[j] = overlap, z - q @ overlap
            self._added[id(white)] = white, parts
        return self._added[id(white)][1]

    def fit(self, rows: RowLabels, weighting: Weighting) -> WhiteFit:
        """Least squares with these levels; the orthonormal basis by the joints' triangular factors."""
        level = weighting.level[:, None]
        Y, target = self.columns / level[:, :, None], (self.target / level).ravel()
        q = Y.reshape(len(target), Y.shape[2])
        if q.shape[1]:
            parts = [R / v for (_, R), v in zip(self.factors, weighting.level, strict=True)]
            R = np.linalg.qr(np.concatenate(parts), mode="r")
            size = np.abs(np.diagonal(R))
            if size.min() > 1e-8 * size.max():
                q = scipy.linalg.solve_triangular(R, q.T, trans="T", check_finite=False).T
            else:
                q = np.linalg.qr(q)[0]
        return WhiteFit(rows, q, target - q @ (q.T @ target), target, weighting)
