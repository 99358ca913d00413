"""What columns more add to a fitted model: worked out once for all fits that they are part of.

A search asks again and again what the model explains with all picks but one. With P what the model
leaves of the picks' columns and P = N R, N orthonormal, the products of N with a library's columns Z are
R^-T P'Z, and what N leaves of the residual r has the products Z'r - (N'Z)'N'r: no pass over the rows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from sdp_vs_penalty.diagnosis.library import Library
from sdp_vs_penalty.robot.arrays import Array

#: Share of its norm that others leave of a column, from which Cholesky's triangle is exact to 1e-11.
_APART = 0.01


@dataclass(frozen=True)
class PerLibrary:
    """Products with a library's columns on one joint (None: on several), by library and joint; the
    library is kept as well, so that its number stays its own."""

    kept: dict[tuple[int, int | None], tuple[Library, Array]] = field(default_factory=dict)

    def of(self, library: Library, joint: int | None, made: Callable[[], Array]) -> Array:
        """Those that are kept, or else ``made``."""
        key = id(library), joint
        if key not in self.kept:
            self.kept[key] = library, made()
        return self.kept[key][1]


class Source(Protocol):
    """Products of weighted rows with a library's, without a pass over them."""

    def model(self, library: Library, joint: int | None) -> Array: ...
    def torque(self, library: Library, joint: int | None) -> Array: ...
    def columns(self, white: Array, library: Library, joint: int | None) -> Array: ...


class Base(Protocol):
    """The fit that columns are added to."""

    @property
    def source(self) -> Source | None: ...
    def overlaps(self, library: Library, joint: int | None) -> Array: ...


@dataclass(frozen=True)
class Added:
    """White columns (n M, k) beside a fit; along (r, k) : the fit's products with them, weighted, None
    where it leaves little; rest (n M, k) : what it leaves; least (k,) : norm from which a column of that
    is more than rounding; kept : the rest's products."""

    white: Array
    along: Array | None
    rest: Array
    least: Array
    kept: PerLibrary = field(default_factory=PerLibrary, init=False)

    def overlaps(self, base: Base, library: Library, joint: int | None) -> Array:
        """The rest's products with a library's columns."""

        def made() -> Array:
            if self.along is None or base.source is None:
                return products(self.rest, library, joint)
            whole = base.source.columns(self.white, library, joint)
            return np.asarray(whole - self.along.T @ base.overlaps(library, joint))

        return self.kept.of(library, joint, made)


@dataclass(frozen=True)
class Extension:
    """Orthonormal columns that a fit has more than another one: of those ``added`` the ones ``kept``,
    times turn (m, m); taken (m,) : their products with what the other leaves."""

    added: tuple[Added, ...]
    kept: NDArray[np.intp]
    turn: Array
    taken: Array

    def overlaps(self, base: Base, library: Library, joint: int | None) -> Array:
        """The orthonormal columns' products with a library's; base : the other fit."""
        parts = [a.overlaps(base, library, joint) for a in self.added]
        return np.asarray(self.turn.T @ np.concatenate(parts, axis=-2)[..., self.kept, :])


def products(columns: Array, library: Library, joint: int | None) -> Array:
    """x_j'z_j of columns x (n M, r) with those of a library on a joint, (r, C_j), or on several, joint
    by joint (n, r, C)."""
    n, level = len(library.parts), library.divisors
    parts = columns.reshape(n, len(columns) // n, columns.shape[1])
    if joint is not None:
        return np.asarray(parts[joint].T @ library.joints[joint]) / level[joint]
    each = zip(parts, library.robot, level, strict=True)
    return np.stack([x.T @ z / divisor for x, z, divisor in each])


def factored(columns: Array, least: Array) -> tuple[Array, Array, NDArray[np.intp]]:
    """Those of the columns (N, m) of which the ones before leave more than ``least`` (m,): as
    orthonormal ones times a triangle R, and their places; by Cholesky's triangle of their products where
    they are far enough from each other, else by Householder's."""
    gram = columns.T @ columns
    try:
        R = np.asarray(np.linalg.cholesky(gram).T)
        size = np.diagonal(R)
        if np.all(size >= _APART * np.sqrt(np.diagonal(gram))) and np.all(size > least):
            return columns @ np.linalg.inv(R), R, np.arange(len(least))
    except np.linalg.LinAlgError:
        pass
    whole = R = triangle(columns)
    kept = np.arange(len(least))
    while not (seen := np.abs(np.diagonal(R)) > least[kept]).all():
        kept = np.delete(kept, np.argmin(seen))
        R = triangle(whole[:, kept])
    q = solve_triangular(R, columns[:, kept].T, trans="T", check_finite=False).T
    again = np.linalg.cholesky(q.T @ q).T  # as orthonormal as the columns are far from each other
    return q @ np.linalg.inv(again), np.asarray(again @ R), kept


def triangle(columns: Array) -> Array:
    """Householder's R (m, m) of columns (N, m)."""
    return np.asarray(np.linalg.qr(columns, mode="r"))
