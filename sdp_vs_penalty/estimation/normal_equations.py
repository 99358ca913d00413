"""Least squares from normal equations, which add up and take combinations of columns."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class Normal:
    """Normal equations of rows [Y tau]: gram (p, p) = Y'Y, right (p,) = Y'tau, square = |tau|^2; or of
    several sets of rows, (..., p, p), (..., p) and (...)."""

    gram: Array
    right: Array
    square: Any

    @classmethod
    def of(cls, rows: Array, torque: Array) -> Normal:
        """From rows (n, M, p) and torque (n, M) of n joints: columns that are zero on one cost nothing
        there."""
        gram, right = np.zeros((rows.shape[2], rows.shape[2])), np.zeros(rows.shape[2])
        for Y, tau in zip(rows, torque, strict=True):
            seen = np.flatnonzero(Y.any(axis=0))
            part = Y[:, seen]
            gram[np.ix_(seen, seen)] += part.T @ part
            right[seen] += part.T @ tau
        return cls(gram, right, float(np.sum(torque**2)))

    @classmethod
    def extended(cls, gram: Array) -> Normal:
        """From [Y tau]'[Y tau] (..., p + 1, p + 1)."""
        return cls(gram[..., :-1, :-1], gram[..., :-1, -1], gram[..., -1, -1])

    def total(self) -> Normal:
        """Of all sets (F, ...) together."""
        return Normal(self.gram.sum(axis=0), self.right.sum(axis=0), self.square.sum(axis=0))

    def without(self, other: Normal) -> Normal:
        """Of these rows less those of the other, which are among them."""
        return Normal(self.gram - other.gram, self.right - other.right, self.square - other.square)

    def part(self, columns: NDArray[np.intp]) -> Normal:
        """Of some of the columns."""
        return Normal(self.gram[np.ix_(columns, columns)], self.right[columns], self.square)

    def through(self, columns: Array, torque: Array | None = None) -> Normal:
        """Of rows [Y columns, tau - Y torque], with columns (..., p, q) and torque (..., p)."""
        across = np.swapaxes(columns, -1, -2)
        half = self.gram @ columns
        right = times(across, self.right)
        if torque is None:
            return Normal(across @ half, right, self.square)
        moved = times(np.swapaxes(half, -1, -2), torque)
        return Normal(across @ half, right - moved, self.left(torque))

    def least(self) -> float:
        """The squared error of least squares."""
        return float(self.left(self.solved()[0]))

    def solved(self) -> tuple[Array, Any]:
        """Least-squares coefficients (..., p), and how many of their directions the data show."""
        inverse, rank = self.inverse
        return times(inverse, self.right), rank

    @property
    def inverse(self) -> tuple[Array, Any]:
        """Of gram, where more than rounding is left of columns and directions, and its rank."""
        norms = np.sqrt(np.maximum(np.diagonal(self.gram, axis1=-2, axis2=-1), 0.0))
        seen = norms > 1e-10 * norms.max(axis=-1, keepdims=True, initial=0.0)
        scale = np.where(seen, 1.0 / np.where(seen, norms, 1.0), 0.0)
        both = scale[..., None] * scale[..., None, :]
        inverse, rank = pseudo_inverse(both * self.gram)
        return both * inverse, rank

    def taken(self, columns: NDArray[np.intp]) -> Array:
        """(N,) what least squares takes from |tau|^2 with each of N sets of columns (N, c) alone."""
        own = Normal(
            self.gram[columns[:, :, None], columns[:, None, :]], self.right[columns], self.square
        )
        return np.asarray(np.sum(own.solved()[0] * own.right, axis=1))

    def left(self, theta: Array) -> Any:
        """|Y theta - tau|^2."""
        return np.sum(theta * (times(self.gram, theta) - 2.0 * self.right), axis=-1) + self.square


def times(matrices: Array, vectors: Array) -> Array:
    """(..., p, q) times (..., q)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def pseudo_inverse(gram: Array) -> tuple[Array, Any]:
    """Of positive semidefinite matrices (..., p, p), without the directions below 1e-12 of the largest,
    and how many are left."""
    if not gram.size:
        return gram, 0
    with suppress(np.linalg.LinAlgError):  # twenty times faster, where the condition has a bound
        back = np.linalg.inv(root := np.linalg.cholesky(gram))
        if np.all(np.sum(root**2, axis=(-2, -1)) * np.sum(back**2, axis=(-2, -1)) < 1e12):
            return np.swapaxes(back, -1, -2) @ back, gram.shape[-1]
    values, vectors = np.linalg.eigh(gram)
    good = values > 1e-12 * np.maximum(values[..., -1:], 0.0)
    half = vectors * np.where(good, 1.0 / np.sqrt(np.where(good, values, 1.0)), 0.0)[..., None, :]
    return half @ np.swapaxes(half, -1, -2), good.sum(axis=-1)
