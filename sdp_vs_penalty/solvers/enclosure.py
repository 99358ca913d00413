"""Sums and products that hold whatever was rounded: numbers with a radius.

Formed in extended precision with the error bound of any order of summation, |fl(a.b) - a.b| <=
gamma_n |a|.|b| (Higham, Accuracy and Stability of Numerical Algorithms, 2002, sec. 3.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sdp_vs_penalty.robot.arrays import Array

#: Extended precision where the machine has it, plain doubles elsewhere; the error bounds follow.
Long = np.longdouble
Extended = Any  # an array or a number of Long

#: An upper bound of the unit roundoff of Long.
ROUNDOFF = Long(max(float(np.finfo(Long).eps), 2.0**-64))
#: Added once an operation for what underflow can lose.
TINY = Long(1e-300)


@dataclass(frozen=True)
class Enclosure:
    """Numbers known up to a radius: |true - value| <= radius, entry by entry."""

    value: Extended
    radius: Extended

    @classmethod
    def exact(cls, numbers: ArrayLike) -> Enclosure:
        value = np.asarray(numbers, Long)
        return cls(value, np.zeros_like(value))

    def __add__(self, other: Enclosure) -> Enclosure:
        value = self.value + other.value
        return Enclosure(value, up(self.radius + other.radius + 2 * ROUNDOFF * np.abs(value)))

    def __sub__(self, other: Enclosure) -> Enclosure:
        return self + Enclosure(-other.value, other.radius)

    def times(self, factor: float) -> Enclosure:
        value = self.value * Long(factor)
        return Enclosure(value, up(self.radius * abs(Long(factor)) + 2 * ROUNDOFF * np.abs(value)))

    @property
    def lower(self) -> Extended:
        return self.value - up(self.radius + 2 * ROUNDOFF * np.abs(self.value))

    @property
    def upper(self) -> Extended:
        return self.value + up(self.radius + 2 * ROUNDOFF * np.abs(self.value))

    def magnitude(self) -> Extended:
        """An upper bound of |true|."""
        return up(np.abs(self.value) + self.radius)


def up(x: Any) -> Any:
    """At least the exact value of what a handful of additions and products of non-negatives gave."""
    return x * (1 + 16 * ROUNDOFF) + TINY


def product(a: ArrayLike, b: ArrayLike) -> Enclosure:
    """a @ b of exact numbers; gamma_n doubled, which covers the rounding of the bound itself."""
    a, b = np.asarray(a, Long), np.asarray(b, Long)
    gamma = 2 * (a.shape[-1] + 2) * ROUNDOFF
    return Enclosure(a @ b, gamma * (np.abs(a) @ np.abs(b)) + TINY * (a.shape[-1] + 1))


def total(numbers: Enclosure) -> Enclosure:
    """The sum of all entries."""
    gamma = 2 * (numbers.value.size + 2) * ROUNDOFF
    radius = gamma * np.abs(numbers.value).sum() + (1 + gamma) * numbers.radius.sum()
    return Enclosure(numbers.value.sum(), up(radius))


def scaled(exact: Extended, numbers: Enclosure) -> Enclosure:
    """Exact numbers times enclosed ones, entry by entry."""
    value = exact * numbers.value
    return Enclosure(value, up(np.abs(exact) * numbers.radius + 2 * ROUNDOFF * np.abs(value)))


def scattered(size: int, indices: NDArray[np.intp], terms: Enclosure) -> Enclosure:
    """(size,) sums of enclosed numbers, each added at its index."""
    value, absolute, radius = (np.zeros(size, Long) for _ in range(3))
    np.add.at(value, indices, terms.value)
    np.add.at(absolute, indices, np.abs(terms.value))
    np.add.at(radius, indices, terms.radius)
    gamma = 2 * (np.bincount(indices, minlength=size) + 2) * ROUNDOFF
    return Enclosure(value, up(gamma * absolute + (1 + gamma) * radius))


def in_cone(cone: str, multipliers: Array) -> Enclosure:
    """Multipliers (g, ...) that lie in their (self-dual) cone exactly, near those given."""
    if cone == "psd":
        v = factor(0.5 * (multipliers + np.swapaxes(multipliers, 1, 2)))
        return product(v, np.swapaxes(v, 1, 2))
    if cone == "soc":
        across = np.asarray(multipliers[:, 1:], Long)
        norm = np.sqrt(product(across[:, None], across[:, :, None]).upper[:, :, 0])
        axis = np.maximum(np.asarray(multipliers[:, :1], Long), norm * (1 + 4 * ROUNDOFF) + TINY)
        return Enclosure.exact(np.hstack([axis, across]))
    return Enclosure.exact(np.maximum(multipliers, 0.0))


def factor(matrices: Array) -> Array:
    """V (g, d, d) with V V^T near symmetric matrices; near their projections where one is indefinite,
    seen with a diagonal of size one: what is near does not depend on units."""
    out, used = np.zeros_like(matrices), matrices.any(axis=(1, 2))
    try:
        out[used] = np.linalg.cholesky(matrices[used])  # near entry by entry, in any system of units
    except np.linalg.LinAlgError:
        size = np.sqrt(np.abs(np.diagonal(matrices, axis1=1, axis2=2)))
        size = np.where(size > 0.0, size, 1.0)[:, :, None]
        eigenvalues, vectors = np.linalg.eigh(matrices / size / np.swapaxes(size, 1, 2))
        out = size * vectors * np.sqrt(np.maximum(eigenvalues, 0.0))[:, None]
    return out
