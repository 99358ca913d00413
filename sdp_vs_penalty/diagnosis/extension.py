"""What columns more add to a fitted model: worked out once for all fits that they are part of.

A search asks again and again what the model explains with all picks but one. With P what the model
leaves of the picks' columns and P = N R, N orthonormal, the products of N with a library's columns Z are
R^-T P'Z, and what N leaves of the residual r has the products Z'r - (N'Z)'N'r: no pass over the rows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.library import Library
from sdp_vs_penalty.robot.arrays import Array

#: Something for a library's columns on each joint (..., C_j), and for those on several (n, ..., C).
Products = tuple[Array, ...]


@dataclass(frozen=True)
class PerLibrary:
    """Products with libraries, by the library; which is kept, so that its number stays its own."""

    kept: dict[int, tuple[Library, Products]] = field(default_factory=dict)

    def of(self, library: Library, made: Callable[[], Products]) -> Products:
        if id(library) not in self.kept:
            self.kept[id(library)] = library, made()
        return self.kept[id(library)][1]


@dataclass(frozen=True)
class Added:
    """White columns (n M, k) beside a fit, and what that leaves of them once weighted: rest (n M, k);
    least (k,) : norm from which a column of it is more than rounding."""

    white: Array
    rest: Array
    least: Array

    @cached_property
    def _overlaps(self) -> PerLibrary:
        return PerLibrary()

    def overlaps(self, library: Library) -> Products:
        """The rest's products with a weighted library's columns: (k, C_j), and (n, k, C)."""
        return self._overlaps.of(library, lambda: products(self.rest, library))


@dataclass(frozen=True)
class Extension:
    """Orthonormal columns that a fit has more than another one: of those ``added`` the ones ``kept``,
    times turn (m, m); taken (m,) : their products with what the other leaves."""

    added: tuple[Added, ...]
    kept: NDArray[np.intp]
    turn: Array
    taken: Array

    def overlaps(self, library: Library) -> Products:
        """The orthonormal columns' products with a library's: (m, C_j), and (n, m, C)."""
        parts = zip(*(a.overlaps(library) for a in self.added), strict=True)
        return tuple(self.turn.T @ np.concatenate(x, axis=-2)[..., self.kept, :] for x in parts)


def products(columns: Array, library: Library) -> Products:
    """x_j'z_j of columns x (n M, r) with a library's: (r, C_j) on each joint, (n, r, C) on several."""
    parts = np.split(columns, len(library.joints))
    own = [x.T @ z for x, z in zip(parts, library.joints, strict=True)]
    return *own, np.stack([x.T @ z for x, z in zip(parts, library.robot, strict=True)])
