"""What makes parameters admissible, as data: arrays that every method and the
certificate read.

A convex constraint is an affine family F(theta) = F_0 + sum_i theta_i F_i in a cone: positive
semidefinite matrices, the second-order cone {(s, u): |u| <= s}, or non-negative numbers. The SDP
imposes these arrays, the penalty methods read violation and gradient from them, the certificate
checks them. Bounds that are not convex in the standard parameters are kept beside them as
:class:`BarycentricBound`: which method receives which is said in each table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one


def cone_margin(cone: str, values: Array) -> Array:
    """Smallest eigenvalue (psd), s - |u| (soc) or smallest entry (nonnegative), of one
    or a batch.

    >>> float(cone_margin("soc", np.array([6.0, 3.0, 4.0])))
    1.0
    """
    if cone == "psd":
        return smallest_eigenvalue(values)
    if cone == "soc":
        return np.asarray(values[..., 0] - np.linalg.norm(values[..., 1:], axis=-1))
    return np.asarray(values.min(axis=-1))


def cone_depths(cone: str, values: Array, terms: Array) -> Array:
    """(g,) margins of equal cones (g, ...) relative to the terms that were summed: free
    of units.

    terms (g, ...) : |F_0| + sum |theta_i F_i|, entry by entry. A matrix F is seen as D
    F D with D = diag(terms)^-1/2, so that rounding in F is of size eps whatever
    cancelled on the way: a depth above :func:`safe_depth` is a positive margin in any
    order of summation.
    """
    if cone == "psd":
        size = np.sqrt(nonzero_or_one(np.diagonal(terms, axis1=1, axis2=2)))
        return np.asarray(
            np.linalg.eigvalsh(values / (size[:, :, None] * size[:, None, :]))[:, 0]
        )
    if cone == "soc":
        return cone_margin(cone, values) / nonzero_or_one(terms.sum(axis=1))
    return cone_margin(cone, values / nonzero_or_one(terms))


def safe_depth(size: int) -> float:
    """The depth that rounding cannot turn into a violation, for cones of this order."""
    return 32.0 * size * float(np.finfo(float).eps)


def smallest_eigenvalue(values: Array) -> Array:
    """The smallest eigenvalue of symmetric matrices (..., d, d), its sign right in any
    system of units.

    A matrix of a link holds its mass in one corner and, in kilometres, moments of 1e-9
    in the others: rounding relative to the corner would decide on them. The sign is
    therefore taken from T F T with diagonals of size one (Sylvester), T of powers of
    two, which round nothing.
    """
    raw = np.linalg.eigvalsh(values)[..., 0]
    diagonal = np.abs(np.diagonal(values, axis1=-2, axis2=-1))
    t = 2.0 ** -np.round(0.5 * np.log2(nonzero_or_one(diagonal)))
    sign = np.linalg.eigvalsh(values * t[..., :, None] * t[..., None, :])[..., 0]
    # Ostrowski: the eigenvalue is that of T F T times a factor between the extremes of
    # T^-2.
    smallest = sign * np.min(t**-2, axis=-1)
    return np.asarray(
        np.where(sign >= 0.0, np.maximum(raw, 0.0), np.minimum(raw, smallest))
    )


def project(cone: str, value: Array) -> Array:
    """The nearest point of the cone (all three are their own duals); one value or a
    batch (g, ...)."""
    if cone == "psd":
        symmetric = 0.5 * (value + np.swapaxes(value, -1, -2))
        eigenvalues, vectors = np.linalg.eigh(symmetric)
        positive = np.maximum(eigenvalues, 0.0)
        return (vectors * positive[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    if cone == "soc":
        s = value[..., :1]
        norm = np.linalg.norm(value[..., 1:], axis=-1, keepdims=True)
        with np.errstate(divide="ignore", invalid="ignore"):
            ray = np.concatenate([np.ones_like(s), value[..., 1:] / norm], axis=-1)
        boundary = 0.5 * (s + norm) * ray
        return np.where(norm <= s, value, np.where(norm <= -s, 0.0, boundary))
    return np.maximum(value, 0.0)


def projected_rows(cone: str, values: Array, directions: Array) -> tuple[Array, Array]:
    """The projections Pi(M) as rows, and their derivative.

    For M + A x they are the gradient and an element of the generalised Hessian of
    1/2 sum |Pi(M + A x)|^2: Gauss-Newton steps on the rows are semismooth Newton steps.

    Parameters
    ----------
    cone : "psd", "soc" or "nonnegative"
    values : M (g, ...)
    directions : A (g, entries, p)

    Returns
    -------
    rows : r (m,) with |r|^2 = sum |Pi(M)|^2
    derivative : J (m, p) with J^T r = sum A^T Pi(M) and J^T J = sum A^T dPi(M) A, dPi an
        element of the generalised derivative

    References
    ----------
    Malick, Sendov: Clarke generalized Jacobian of the projection onto the cone of
    positive semidefinite matrices. Set-Valued Analysis, 2006.
    """
    if cone == "nonnegative":
        positive = np.maximum(values.ravel(), 0.0)
        flat = directions.reshape(-1, directions.shape[2])
        return positive, flat * (positive > 0.0)[:, None]
    if cone == "psd":
        return _projected_matrices(values, directions)
    return _projected_vectors(values, directions)


def _projected_matrices(values: Array, directions: Array) -> tuple[Array, Array]:
    """The same of symmetric matrices (g, d, d): dPi(M)[H] = U (Omega o U^T H U) U^T with
    the divided differences Omega of max(., 0)."""
    group, _, width = directions.shape
    d = values.shape[-1]
    eigenvalues, u = np.linalg.eigh(values)
    positive = np.maximum(eigenvalues, 0.0)
    omega = _divided_differences(eigenvalues, positive)
    h = directions.reshape(group, d, d, width).transpose(0, 3, 1, 2)
    rotated = np.swapaxes(u, 1, 2)[:, None] @ h @ u[:, None]
    weighted = np.sqrt(omega)[:, None] * rotated
    derivative = weighted.transpose(0, 2, 3, 1).reshape(-1, width)
    rows = (positive[:, :, None] * np.eye(d)).ravel()
    return rows, derivative


def _divided_differences(eigenvalues: Array, positive: Array) -> Array:
    """(g, d, d) of max(., 0) between eigenvalues (g, d), whose positive parts are given;
    its step where two are equal."""
    gap = eigenvalues[:, :, None] - eigenvalues[:, None, :]
    largest = np.abs(eigenvalues).max(axis=1)[:, None, None]
    is_close = np.abs(gap) <= 1e-14 * largest
    rise = positive[:, :, None] - positive[:, None, :]
    step = (eigenvalues > 0.0)[:, :, None] * np.ones(eigenvalues.shape[1])
    return np.where(is_close, step, rise / np.where(is_close, 1.0, gap))


def _projected_vectors(values: Array, directions: Array) -> tuple[Array, Array]:
    """The same of vectors (g, d) and the second-order cone.

    In the frame (axis, ray, across the ray) the derivative has eigenvalues 1 and 0 along
    (1, +-ray) / sqrt(2), and (1 + s / |u|) / 2, at most 1 and at least 0, across.
    """
    width = directions.shape[2]
    s = values[:, 0]
    norm = np.linalg.norm(values[:, 1:], axis=1)
    on_axis = norm <= 1e-14 * np.abs(s)
    ray = values[:, 1:] / np.where(on_axis, 1.0, norm)[:, None]
    along = np.array([np.where(on_axis, s, s + norm), s - norm])
    ends = np.maximum(along, 0.0) / np.sqrt(2.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip(0.5 * (1.0 + s / norm), 0.0, 1.0)
    across = np.where(on_axis, s > 0.0, share)
    on_ray = np.einsum("gi,gip->gp", ray, directions[:, 1:])
    sum_and_difference = np.array(
        [directions[:, 0] + on_ray, directions[:, 0] - on_ray]
    )
    both = sum_and_difference / np.sqrt(2.0)
    beside_ray = directions[:, 1:] - ray[:, :, None] * on_ray[:, None]
    tail = np.sqrt(across)[:, None, None] * beside_ray
    rows = np.concatenate([ends.ravel(), np.zeros(tail.shape[0] * tail.shape[1])])
    derivative = np.concatenate(
        [
            (both * (ends > 0.0)[:, :, None]).reshape(-1, width),
            tail.reshape(-1, width),
        ]
    )
    return rows, derivative


@dataclass(frozen=True, eq=False)
class Constraint:
    """F_0 + sum_i theta[indices[i]] F_i in a cone; a key of what belongs to it, equal
    to itself only.

    family : what kind of demand it is ("pseudo-inertia", "mass", ...); name : of whom ("link 3").
    cone : "psd" (constant (d, d), coefficients (k, d, d)), "soc" or "nonnegative" (constant (d,),
        coefficients (k, d)); a second-order cone's first entry is its axis.
    """

    family: str
    name: str
    cone: str
    indices: NDArray[np.intp]
    constant: Array
    coefficients: Array

    def value(self, theta: ArrayLike) -> Array:
        """F(theta)."""
        part = np.asarray(theta, float)[self.indices]
        return self.constant + np.tensordot(part, self.coefficients, axes=(0, 0))

    def margin(self, theta: ArrayLike) -> float:
        """Distance to the cone's boundary, in the cone's units: negative exactly if
        violated."""
        return float(cone_margin(self.cone, self.value(theta)))

    @property
    def identity(self) -> Array:
        """The element e of the cone for which margin(F + t e) = margin(F) + t."""
        unit = np.eye(len(self.constant))
        return (
            unit
            if self.cone == "psd"
            else unit[0]
            if self.cone == "soc"
            else unit.sum(axis=0)
        )


@dataclass(frozen=True)
class BarycentricBound:
    """lower <= x <= upper for an entry x of a link's inertia about its centre of mass
    [kg m^2].

    Not convex in the standard parameters for products of inertia and for upper bounds
    on moments: I = J - m (c.c 1 - c c^T). The penalty methods take it as it is; where
    it has a convex consequence the problem gives that to the SDP as a Constraint of
    family "trace".
    """

    name: str
    indices: NDArray[np.intp]  # (10,) of the link in theta
    entry: int  # 0..5 in our order
    lower: float
    upper: float
    family: str = "barycentric inertia"

    def margin(self, theta: ArrayLike) -> float:
        """How far it lies inside its bounds [kg m^2]; negative outside, 0 without a
        mass."""
        part = np.asarray(theta, float)[self.indices]
        x = float(inertia.barycentric_from_standard(part)[4 + self.entry])
        if not np.isfinite(x):  # a massless link: no inertia about a centre of mass
            return 0.0
        return min(x - self.lower, self.upper - x)


@dataclass(frozen=True)
class ConstraintSet:
    """All demands on theta: convex ones, and those only some methods can take."""

    convex: tuple[Constraint, ...]
    nonconvex: tuple[BarycentricBound, ...] = ()

    def worst(self, theta: ArrayLike) -> dict[str, float]:
        """Worst violation of each family, max(0, -margin), in the family's own units."""
        out: dict[str, float] = {}
        families = [c.family for c in self.convex] + [b.family for b in self.nonconvex]
        worst_by_family = [
            *self.entries.margins(theta)[0],
            *(b.margin(theta) for b in self.nonconvex),
        ]
        for family, margin in zip(families, worst_by_family, strict=True):
            out[family] = max(out.get(family, 0.0), -float(margin))
        return out

    def margin(self, theta: ArrayLike) -> float:
        """Smallest margin of the convex constraints: >= 0 exactly if theta is feasible
        for the SDP."""
        return float(self.entries.margins(theta)[0].min(initial=np.inf))

    def depths(self, theta: ArrayLike) -> list[float]:
        """How far inside each group of constraints theta lies, free of units: at most
        about one."""
        x = np.asarray(theta, float)
        both = zip(
            self.groups, *map(self.entries.split, self.entries.at(x)), strict=True
        )
        return [
            float(cone_depths(s.cone, values, terms).min()) for s, values, terms in both
        ]

    def depth(self, theta: ArrayLike) -> float:
        """The least of the depths."""
        return min(self.depths(theta), default=np.inf)

    def with_families(self, keep: Callable[[str], bool]) -> ConstraintSet:
        """Only the families for which ``keep`` is true."""
        return ConstraintSet(
            tuple(c for c in self.convex if keep(c.family)),
            tuple(c for c in self.nonconvex if keep(c.family)),
        )

    @property
    def essential(self) -> tuple[Constraint, ...]:
        """The convex ones without the pseudo-inertias that a minimum thickness of the
        link contains."""
        thick = {c.name for c in self.convex if c.family == "minimum thickness"}
        return tuple(
            c
            for c in self.convex
            if c.family != "pseudo-inertia" or c.name not in thick
        )

    def stack_multipliers(self, multipliers: Mapping[Constraint, Array]) -> Array:
        """(e,) multipliers of the convex ones as ``entries`` has them; zero for those
        left out."""
        constraints = (
            self.convex[k] for group in self.groups for k in group.places.tolist()
        )
        values = [
            multipliers[c] if c in multipliers else np.zeros_like(c.constant)
            for c in constraints
        ]
        return np.concatenate([np.zeros(0), *(x.ravel() for x in values)])

    def plus(self, more: Sequence[Constraint]) -> ConstraintSet:
        """These and further ones."""
        return ConstraintSet(self.convex + tuple(more), self.nonconvex)

    @cached_property
    def entries(self) -> StackedCones:
        """All numbers of the convex constraints end to end."""
        return StackedCones.from_groups(self.groups)

    @cached_property
    def groups(self) -> tuple[ConeGroup, ...]:
        """The convex constraints side by side, for methods that evaluate them often."""
        return tuple(group_cones(self.convex))


@dataclass(frozen=True)
class ConeGroup:
    """Equal cones of as many parameters: ``places`` (g,) among the constraints that
    they are of.

    indices (g, k), constant (g, ...), coefficients (g, k, ...) : of each what
    :class:`Constraint` has.
    """

    cone: str
    places: NDArray[np.intp]
    indices: NDArray[np.intp]
    constant: Array
    coefficients: Array

    @cached_property
    def matrix(self) -> Array:
        """(g d, p') with F.ravel() = constant.ravel() + matrix theta[:p'], entry by
        entry."""
        g, k = self.indices.shape
        flat = self.coefficients.reshape(g, k, -1)
        out = np.zeros((g, flat.shape[2], 1 + int(self.indices.max(initial=-1))))
        out[np.arange(g)[:, None], :, self.indices] = flat
        return out.reshape(-1, out.shape[2])

    def values(self, theta: Array) -> Array:
        """(g, ...) all F(theta)."""
        flat = self.matrix @ theta[: self.matrix.shape[1]]
        return self.constant + flat.reshape(self.constant.shape)


def group_cones(constraints: Sequence[Constraint]) -> list[ConeGroup]:
    """Constraints side by side, to be worked on at once, in the order in which each
    kind comes first."""
    groups: dict[tuple[str, tuple[int, ...]], list[int]] = {}
    for place, c in enumerate(constraints):
        groups.setdefault((c.cone, c.coefficients.shape), []).append(place)
    out = []
    for (cone, _), places in groups.items():
        arrays = [
            (c.indices, c.constant, c.coefficients)
            for c in (constraints[k] for k in places)
        ]
        out.append(
            ConeGroup(cone, np.array(places), *map(np.array, zip(*arrays, strict=True)))
        )
    return out


@dataclass(frozen=True)
class StackedCones:
    """The numbers of constraints end to end, group by group: F (e,) = constant + sum
    over z of value[z] theta[column[z]] at row[z]."""

    groups: tuple[ConeGroup, ...]
    constant: Array
    row: NDArray[np.intp]
    column: NDArray[np.intp]
    value: Array

    @classmethod
    def from_groups(cls, groups: Sequence[ConeGroup]) -> StackedCones:
        start = 0
        none = np.zeros(0, np.intp)
        rows = [none]
        columns = [none]
        values = [np.zeros(0)]
        for group in groups:
            flat = group.coefficients.reshape(*group.indices.shape, -1)
            member, position, entry = np.nonzero(flat)
            rows.append(start + member * flat.shape[2] + entry)
            columns.append(group.indices[member, position])
            values.append(flat[member, position, entry])
            start += group.constant.size
        constant = np.concatenate(
            [np.zeros(0), *(group.constant.ravel() for group in groups)]
        )
        row = np.concatenate(rows)
        column = np.concatenate(columns)
        return cls(tuple(groups), constant, row, column, np.concatenate(values))

    def at(self, theta: Array) -> tuple[Array, Array]:
        """(e,) F(theta) of all, and |F_0| + sum |theta_i F_i|: the size of what was
        summed."""
        terms = self.value * theta[self.column]
        count = len(self.constant)
        size = np.abs(self.constant) + np.bincount(self.row, np.abs(terms), count)
        return np.asarray(
            self.constant + np.bincount(self.row, terms, count)
        ), np.asarray(size)

    def margins(self, theta: ArrayLike) -> tuple[Array, Array]:
        """Of each constraint (m,) its margin, and the size of the largest terms that
        were summed."""
        margin, size = np.zeros((2, sum(len(group.places) for group in self.groups)))
        both = map(self.split, self.at(np.asarray(theta, float)))
        for group, values, terms in zip(self.groups, *both, strict=True):
            margin[group.places] = cone_margin(group.cone, values)
            size[group.places] = terms.reshape(len(values), -1).max(axis=1)
        return margin, size

    def adjoint(self, flat: Array, p: int) -> Array:
        """(p,) inner products of every dF / dtheta_k with multipliers (e,)."""
        return np.asarray(np.bincount(self.column, self.value * flat[self.row], p))

    def split(self, flat: Any) -> list[Any]:
        """Of each group (g, ...) its part of (e,)."""
        out = []
        start = 0
        for group in self.groups:
            stop = start + group.constant.size
            out.append(flat[start:stop].reshape(group.constant.shape))
            start = stop
        return out

    def each(self, flat: Array) -> list[Array]:
        """Of each constraint its part of (e,)."""
        parts = zip(self.groups, self.split(flat), strict=True)
        by_place = {
            k: x
            for group, part in parts
            for k, x in zip(group.places.tolist(), part, strict=True)
        }
        return [by_place[k] for k in range(len(by_place))]


def pseudo_inertia(name: str, indices: ArrayLike, radius: float = 0.0) -> Constraint:
    """P(theta) >= 0: contains m >= 0, positive definiteness and the triangle
    inequalities.

    radius [m] : with one, Sigma_c >= m r^2 1, as [[Sigma - m r^2 1, m c], [(m c)^T, m]]
    >= 0 (Schur complement): keeps the SDP from answering with rods of zero thickness.
    """
    coefficients = inertia.PSEUDO_INERTIA_BASIS.copy()
    coefficients[0, :3, :3] -= radius**2 * np.eye(3)
    family = "minimum thickness" if radius else "pseudo-inertia"
    return linear(family, name, indices, coefficients, np.zeros((4, 4)), "psd")


def density_in_ellipsoid(
    family: str, name: str, indices: ArrayLike, quadric: ArrayLike
) -> Constraint:
    """The mass lies inside an ellipsoid: tr(P Q) >= 0 (Wensing, Kim, Slotine 2018, eq.
    20).

    quadric Q (4, 4) : (x, 1)^T Q (x, 1) is 1 at the ellipsoid's centre, 0 on its
    surface (:attr:`Body.quadric`). Its mean over the density is non-negative: linear in
    theta. With P >= 0 it holds exactly if some density inside has these parameters, and
    it bounds all of P by the mass.
    """
    row = np.einsum(
        "kab,ab->k", inertia.PSEUDO_INERTIA_BASIS, np.asarray(quadric, float)
    )
    return linear(family, name, indices, row[:, None], [0.0])


def linear(
    family: str,
    name: str,
    indices: ArrayLike,
    coefficients: ArrayLike,
    constant: ArrayLike,
    cone: str = "nonnegative",
) -> Constraint:
    """constant + coefficients^T theta >= 0, entry by entry, or in another cone;
    coefficients (k, d).

    Of a second-order cone, |u| <= s, these are (s, u); of a matrix its entries."""
    places = np.asarray(indices, np.intp)
    return Constraint(
        family,
        name,
        cone,
        places,
        np.asarray(constant, float),
        np.asarray(coefficients, float),
    )
