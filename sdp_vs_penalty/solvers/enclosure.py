"""Sums and products that hold whatever was rounded: numbers with a radius.

Formed in extended precision with the error bound of any order of summation, |fl(a.b) - a.b| <=
gamma_n |a|.|b| (Higham, Accuracy and Stability of Numerical Algorithms, 2002, sec. 3.1).
"""

from __future__ import annotations

from collections.abc import Sequence
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


def inner(exact: Array, numbers: Enclosure) -> Enclosure:
    """(g, k) inner products of exact arrays (g, k, ...) with enclosed arrays (g, ...)."""
    rows = np.asarray(exact, Long).reshape(*exact.shape[:2], -1)
    value, radius = (x.reshape(len(x), -1, 1) for x in (numbers.value, numbers.radius))
    made, carried = product(rows, value), product(np.abs(rows), radius).upper
    return Enclosure(made.value[..., 0], up(made.radius + carried)[..., 0])


def scattered(size: int, parts: Sequence[tuple[NDArray[np.intp], Enclosure]]) -> Enclosure:
    """(size,) sums of enclosed numbers (...), each added at its index (...)."""
    value, absolute, radius = (np.zeros(size, Long) for _ in range(3))
    count = np.zeros(size, int)
    for indices, terms in parts:
        np.add.at(value, indices, terms.value)
        np.add.at(absolute, indices, np.abs(terms.value))
        np.add.at(radius, indices, terms.radius)
        np.add.at(count, indices, 1)
    gamma = 2 * (count + 2) * ROUNDOFF
    return Enclosure(value, up(gamma * absolute + (1 + gamma) * radius))


def in_cone(cone: str, multipliers: Array) -> Enclosure:
    """Multipliers (g, ...) that lie in their (self-dual) cone exactly, near those given."""
    if cone == "psd":
        eigenvalues, vectors = np.linalg.eigh(0.5 * (multipliers + np.swapaxes(multipliers, 1, 2)))
        factor = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))[:, None]
        return product(factor, np.swapaxes(factor, 1, 2))
    if cone == "soc":
        across = np.asarray(multipliers[:, 1:], Long)
        norm = np.sqrt(product(across[:, None], across[:, :, None]).upper[:, :, 0])
        axis = np.maximum(np.asarray(multipliers[:, :1], Long), norm * (1 + 4 * ROUNDOFF) + TINY)
        return Enclosure.exact(np.hstack([axis, across]))
    return Enclosure.exact(np.maximum(multipliers, 0.0))
