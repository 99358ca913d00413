"""Least squares from normal equations, which add up and take combinations of columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class Normal:
    """Normal equations of rows [Y tau]: gram (p, p) = Y'Y, right (p,) = Y'tau, square = |tau|^2."""

    gram: Array
    right: Array
    square: float

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

    def __add__(self, other: Normal) -> Normal:
        return Normal(self.gram + other.gram, self.right + other.right, self.square + other.square)

    def part(self, columns: NDArray[np.intp]) -> Normal:
        """Of some of the columns."""
        return Normal(self.gram[np.ix_(columns, columns)], self.right[columns], self.square)

    def through(self, columns: Array, torque: Array) -> Normal:
        """Of rows [Y columns, tau - Y torque], with columns (p, q) and torque (p,)."""
        half = self.gram @ columns
        return Normal(columns.T @ half, columns.T @ self.right - half.T @ torque, self.left(torque))

    def least(self) -> float:
        """The squared error of least squares."""
        return self.left(self.solved()[0])

    def solved(self) -> tuple[Array, int]:
        """Least-squares coefficients (p,), and how many of their directions the data show."""
        norms = np.sqrt(np.maximum(np.diagonal(self.gram), 0.0))
        unit = np.where(norms > 1e-10 * norms.max(initial=0.0), norms, np.inf)
        inverse, rank = pseudo_inverse(self.gram / np.outer(unit, unit))
        return (inverse @ (self.right / unit)) / unit, rank

    def taken(self, columns: NDArray[np.intp]) -> Array:
        """(N,) what least squares takes from |tau|^2 with each of N sets of columns (N, c) alone."""
        gram = self.gram[columns[:, :, None], columns[:, None, :]]
        norms = np.sqrt(np.maximum(np.diagonal(gram, axis1=1, axis2=2), 0.0))
        unit = np.where(norms > 1e-10 * norms.max(axis=1, keepdims=True), norms, np.inf)
        values, vectors = np.linalg.eigh(gram / unit[:, :, None] / unit[:, None, :])
        good = values > 1e-12 * values[:, -1:]
        part = np.einsum("nij,ni->nj", vectors, self.right[columns] / unit)
        return np.asarray(np.sum(np.where(good, part**2, 0.0) / np.where(good, values, 1.0), axis=1))

    def left(self, theta: Array) -> float:
        """|Y theta - tau|^2."""
        return float(theta @ self.gram @ theta - 2.0 * self.right @ theta + self.square)


def total(parts: Sequence[Normal]) -> Normal:
    """Of all rows together."""
    return sum(parts[1:], parts[0])


def pseudo_inverse(gram: Array) -> tuple[Array, int]:
    if not gram.size:
        return gram, 0
    values, vectors = np.linalg.eigh(gram)
    good = values > 1e-12 * values.max(initial=0.0)
    half = vectors[:, good] / np.sqrt(values[good])
    return half @ half.T, int(good.sum())
