"""Sums and products that hold whatever was rounded: numbers with a radius.

Formed in extended precision with the error bound of any order of summation, |fl(a.b) - a.b| <=
gamma_n |a|.|b| (Higham, Accuracy and Stability of Numerical Algorithms, 2002, sec. 3.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

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
    """(k,) inner products of exact arrays (k, ...) with one enclosed array (...)."""
    rows = np.asarray(exact, Long).reshape(len(exact), -1)
    made = product(rows, numbers.value.ravel())
    carried = product(np.abs(rows), numbers.radius.ravel()).upper
    return Enclosure(made.value, up(made.radius + carried))


def in_cone(cone: str, multiplier: Array) -> Enclosure:
    """A multiplier that lies in its (self-dual) cone exactly, near the one given."""
    if cone == "psd":
        eigenvalues, vectors = np.linalg.eigh(0.5 * (multiplier + multiplier.T))
        factor = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
        return product(factor, factor.T)
    if cone == "soc":
        norm = np.sqrt(product(multiplier[1:], multiplier[1:]).upper)
        axis = max(Long(multiplier[0]), norm * (1 + 4 * ROUNDOFF) + TINY)
        return Enclosure.exact(np.concatenate([[axis], np.asarray(multiplier[1:], Long)]))
    return Enclosure.exact(np.maximum(multiplier, 0.0))
