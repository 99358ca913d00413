"""The model behind a colour's filter: fitted with any levels of the joints, filtered once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy.linalg

from sdp_vs_penalty.diagnosis.extension import triangle
from sdp_vs_penalty.diagnosis.fit import RowLabels, Weighting, WhiteFit
from sdp_vs_penalty.diagnosis.library import Library
from sdp_vs_penalty.robot.arrays import Array

#: Rows are compressed to triangles where that makes them fewer by this.
_FEWER = 3


@dataclass(frozen=True)
class JointRows:
    """One joint's rows behind its filter: the model's columns (M, r) = Q R, Q orthonormal, the torque
    (M,), and what is asked of them again and again."""

    columns: Array
    target: Array
    Q: Array
    R: Array
    filter: Callable[[Array], Array]
    _beside: dict[int, tuple[Array, tuple[Array, Array] | None]] = field(
        default_factory=dict, init=False
    )
    _times: dict[int, tuple[Array, dict[int, tuple[Array, Array]]]] = field(
        default_factory=dict, init=False
    )

    @classmethod
    def of(cls, basis: Array, target: Array, filter: Callable[[Array], Array]) -> JointRows:
        """From white columns (M, r) and torque (M,)."""
        columns = filter(basis)
        Q, R = np.linalg.qr(columns)
        return cls(columns, filter(target), np.asarray(Q), np.asarray(R), filter)

    def beside(self, white: Array, own: Array) -> tuple[Array, Array] | None:
        """Of white columns, here ``own`` (M, k), behind the filter: Q's products with them and what Q
        leaves; None where they do not act."""
        if id(white) not in self._beside:
            found = None
            if own.any():
                z = self.filter(own)
                overlap = self.Q.T @ z
                found = overlap, z - self.Q @ overlap
            self._beside[id(white)] = white, found
        return self._beside[id(white)][1]

    def times(self, Z: Array) -> tuple[Array, Array]:
        """Products Q'Z (r, C) and torque'Z (C,) with a library's columns behind the filter; those of the
        last library are kept."""
        known = self._products(Z)
        if 0 not in known:
            known[0] = self.Q.T @ Z, self.target @ Z
        return known[0]

    def white_times(self, white: Array, own: Array, Z: Array) -> Array | None:
        """Products (k, C) of white columns with a library's, both behind the filter."""
        known, parts = self._products(Z), self.beside(white, own)
        if parts is None:
            return None
        if id(white) not in known:
            known[id(white)] = parts[0].T @ self.times(Z)[0] + parts[1].T @ Z, white
        return known[id(white)][0]

    def _products(self, Z: Array) -> dict[int, tuple[Array, Array]]:
        if id(Z) not in self._times:
            self._times.clear()
            self._times[id(Z)] = Z, {}
        return self._times[id(Z)][1]


@dataclass(frozen=True)
class Levelled:
    """Products of joints' rows divided by their ``level`` (n,) with a library's on a joint, (..., C_j),
    or on several, joint by joint (n, ..., C); turn (r, r) : makes the model's columns orthonormal."""

    joints: tuple[JointRows, ...]
    level: Array
    turn: Array

    def model(self, library: Library, joint: int | None) -> Array:
        """With the model's orthonormal columns, (r, C_j)."""
        return self._each(library, joint, lambda j, Z: self._turns[j] @ self.joints[j].times(Z)[0])

    @cached_property
    def _turns(self) -> list[Array]:
        """From each joint's orthonormal columns to those of all joints."""
        return [(own.R @ self.turn).T for own in self.joints]

    def torque(self, library: Library, joint: int | None) -> Array:
        """With the torque, (C_j,)."""
        return self._each(library, joint, lambda j, Z: self.joints[j].times(Z)[1])

    def columns(self, white: Array, library: Library, joint: int | None) -> Array:
        """With white columns (n M, k), (k, C_j)."""
        parts = white.reshape(len(self.joints), -1, white.shape[1])

        def times(j: int, Z: Array) -> Array:
            found = self.joints[j].white_times(white, parts[j], Z)
            return np.zeros((white.shape[1], Z.shape[1])) if found is None else found

        return self._each(library, joint, times)

    def _each(self, library: Library, joint: int | None, times: Callable[[int, Array], Array]) -> Array:
        def of(j: int) -> Array:
            mine = slice(library.own[j]) if j == joint else slice(library.own[j], None)
            return times(j, library.parts[j])[..., mine] / (self.level[j] * library.divisors[j])

        return of(joint) if joint is not None else np.stack([of(j) for j in range(len(self.joints))])


@dataclass(frozen=True)
class Coloured:
    """All joints' rows behind the filters of a weighting, not yet divided by the joints' levels."""

    joints: tuple[JointRows, ...]

    @classmethod
    def of(cls, basis: Array, target: Array, weighting: Weighting) -> Coloured:
        """From white columns (n M, r) of full rank and white torque (n M,)."""
        n = len(weighting.level)
        parts = zip(basis.reshape(n, -1, basis.shape[1]), target.reshape(n, -1), strict=True)
        return cls(tuple(JointRows.of(Y, t, weighting.filter_of(j)) for j, (Y, t) in enumerate(parts)))

    def fit(self, rows: RowLabels, weighting: Weighting) -> WhiteFit:
        """Least squares with these levels; the orthonormal basis by the joints' triangular factors."""
        level = weighting.level
        parts = [(own.columns / v, own.R / v) for own, v in zip(self.joints, level, strict=True)]
        target = np.concatenate([own.target / v for own, v in zip(self.joints, level, strict=True)])
        q, turn = _orthonormal(*(np.concatenate(x) for x in zip(*parts, strict=True)))
        source = None if turn is None else Levelled(self.joints, level, turn)
        return WhiteFit(rows, q, target - q @ (q.T @ target), target, weighting, source)

    def compressed(
        self, rows: RowLabels, white: Sequence[Array], weighting: Weighting
    ) -> WhiteFit | None:
        """The fit with white columns (n M, k) more, on the rows of a triangle of each joint's columns
        and torque, where these are fewer: joints' errors and degrees are the same."""
        n, (M, r) = len(self.joints), self.joints[0].columns.shape
        ends = r + np.cumsum([0, *(w.shape[1] for w in white)])
        size = int(ends[-1]) + 1
        if _FEWER * size > M:
            return None
        out = np.zeros((n, size, size))
        for j, own in enumerate(self.joints):
            along = own.Q.T @ own.target
            beside = [(size - 1, along[:, None], (own.target - own.Q @ along)[:, None])]
            for first, w in zip(ends.tolist(), white, strict=False):
                parts = own.beside(w, w.reshape(n, M, -1)[j])
                beside += [] if parts is None else [(first, *parts)]
            places = np.concatenate([at + np.arange(x.shape[1]) for at, x, _ in beside])
            out[j, :r, :r] = own.R
            out[j, :r, places] = np.hstack([x for _, x, _ in beside]).T
            rest = triangle(np.hstack([x for *_, x in beside]))
            out[j, r : r + len(rest), places] = rest.T
        few = replace(weighting, colour=np.zeros_like(weighting.colour))
        labels = replace(rows, block=np.zeros(size, np.intp), fold=np.zeros(size, np.intp))
        scaled = out / weighting.level[:, None, None]
        q, target = _orthonormal(scaled[:, :, :r].reshape(n * size, r))[0], scaled[:, :, -1].ravel()
        fit = WhiteFit(labels, q, target - q @ (q.T @ target), target, few)
        return fit.extended(*(out[:, :, a:b].reshape(n * size, -1) for a, b in pairwise(ends.tolist())))


def _orthonormal(columns: Array, factors: Array | None = None) -> tuple[Array, Array | None]:
    """The columns (N, r) made orthonormal, and the triangle's inverse that does it, None where that is
    not exact; factors : triangles one below the other with the columns' products."""
    if not columns.shape[1]:
        return columns, np.zeros((0, 0))
    R = triangle(columns if factors is None else factors)
    size = np.abs(np.diagonal(R))
    if size.min() > 1e-8 * size.max():
        q = scipy.linalg.solve_triangular(R, columns.T, trans="T", check_finite=False).T
        return q, np.asarray(np.linalg.inv(R))
    return np.asarray(np.linalg.qr(columns)[0]), None
