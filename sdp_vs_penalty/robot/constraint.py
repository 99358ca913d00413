"""What makes parameters admissible, as data: arrays that every method and the
certificate read.

A convex constraint is an affine family F(theta) = F_0 + sum_i theta_i F_i in a cone: positive
semidefinite matrices, the second-order cone {(s, u): |u| <= s}, or non-negative numbers. The SDP
imposes these arrays, the penalty methods read violation and gradient from them, the certificate
checks them. Bounds that are not convex in the standard parameters are kept beside them as
:class:`BarycentricBound`: which method receives which is said in each table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, Indices, nonzero_or_one


def cone_margin(cone: str, values: Array) -> Array:
    """Return the margin of a point in a cone: positive inside, zero on the boundary.

    The margin is the smallest eigenvalue (psd), s - |u| for the point (s, u) (soc), or the
    smallest entry (nonnegative).

    Parameters
    ----------
    values : array
        One point, or a batch (g, ...) of them.

    Examples
    --------
    >>> float(cone_margin("soc", np.array([6.0, 3.0, 4.0])))
    1.0
    """
    if cone == "psd":
        return smallest_eigenvalue(values)
    if cone == "soc":
        return np.asarray(values[..., 0] - np.linalg.norm(values[..., 1:], axis=-1))
    return np.asarray(values.min(axis=-1))


def cone_depths(cone: str, values: Array, terms: Array) -> Array:
    """Return margins (g,) of points in cones relative to the summed terms, free of
    units.

    A matrix F is judged as D F D with D = diag(terms)^-1/2. Rounding errors in F are then of
    the size of eps, whatever cancelled in the sum. A depth above :func:`safe_depth` is a
    positive margin in any order of summation.

    Parameters
    ----------
    values : (g, ...) array
        The points F(theta) of g equal cones.
    terms : (g, ...) array
        |F_0| + sum |theta_i F_i|, entry by entry.
    """
    if cone == "psd":
        size = np.sqrt(nonzero_or_one(np.diagonal(terms, axis1=1, axis2=2)))
        scaled = values / (size[:, :, None] * size[:, None, :])  # D F D
        return np.linalg.eigvalsh(scaled)[:, 0]
    if cone == "soc":
        return cone_margin(cone, values) / nonzero_or_one(terms.sum(axis=1))
    return cone_margin(cone, values / nonzero_or_one(terms))


def safe_depth(size: int) -> float:
    """Return the largest depth [-] that rounding errors can give to a violated cone with
    ``size`` rows: one of :func:`cone_depths` above it is certain.

    It is 32 rounding errors for each row, a generous bound of an eigenvalue's error.
    """
    return 32.0 * size * float(np.finfo(float).eps)


def smallest_eigenvalue(values: Array) -> Array:
    """Return the smallest eigenvalue of symmetric matrices (..., d, d), its sign right
    in any units.

    A link's matrix holds its mass in one corner and, in kilometres, moments of 1e-9 in the
    others: rounding errors of the size of the corner would decide on the sign. The sign is
    therefore that of T F T with unit diagonal (Sylvester's law of inertia). T holds powers
    of two, which do not round.
    """
    raw = np.linalg.eigvalsh(values)[..., 0]
    diagonal = np.abs(np.diagonal(values, axis1=-2, axis2=-1))
    t = 2.0 ** -np.round(0.5 * np.log2(nonzero_or_one(diagonal)))
    sign = np.linalg.eigvalsh(values * t[..., :, None] * t[..., None, :])[..., 0]
    # Ostrowski: the eigenvalue is that of T F T times a factor between the extremes of
    # T^-2.
    smallest = sign * np.min(t**-2, axis=-1)
    return np.where(sign >= 0.0, np.maximum(raw, 0.0), np.minimum(raw, smallest))


def project(cone: str, value: Array) -> Array:
    """Return the nearest points in a cone. All three cones are their own duals.

    Parameters
    ----------
    value : array
        One point, or a batch (g, ...) of them.

    Returns
    -------
    array
        The nearest points, of the same shape.
    """
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
    """Return the projections Pi(M) onto a cone as rows, and their derivative.

    For M + A x they are the gradient and an element of the generalised Hessian of
    1/2 sum |Pi(M + A x)|^2: Gauss-Newton steps on the rows are semismooth Newton steps.

    Parameters
    ----------
    values : (g, ...) array
        M, the points of g equal cones.

    Returns
    -------
    rows : (m,) array
        r with |r|^2 = sum |Pi(M)|^2; rows that are zero may be left out.
    derivative : (m, p) array
        J with J^T r = sum A^T Pi(M) and J^T J = sum A^T dPi(M) A, dPi an element of the
        generalised derivative.

    References
    ----------
    Malick, Sendov: Clarke generalized Jacobian of the projection onto the cone of
    positive semidefinite matrices. Set-Valued Analysis, 2006.
    """
    if cone == "nonnegative":
        flat = values.ravel()
        is_positive = flat > 0.0
        derivative = directions.reshape(-1, directions.shape[2])
        return flat[is_positive], derivative[is_positive]
    if cone == "psd":
        return _projected_matrices(values, directions)
    return _projected_vectors(values, directions)


def _projected_matrices(values: Array, directions: Array) -> tuple[Array, Array]:
    """Return rows and derivative of :func:`projected_rows` for symmetric matrices (g,
    d, d).

    dPi(M)[H] = U (Omega o U^T H U) U^T, with eigenvectors U and the divided differences
    Omega of max(., 0).
    """
    d = values.shape[-1]
    eigenvalues, u = np.linalg.eigh(values)
    # A matrix without positive eigenvalues is projected to zero.
    has_projection = eigenvalues[:, -1] > 0.0
    eigenvalues = eigenvalues[has_projection]
    u = u[has_projection]
    positive = np.maximum(eigenvalues, 0.0)
    # One row stands for the two equal entries on both sides of the diagonal.
    i, j = np.triu_indices(d)
    # Divided differences of max(x, 0) between eigenvalues; its slope where two are equal.
    gap = eigenvalues[:, :, None] - eigenvalues[:, None, :]
    largest = np.abs(eigenvalues).max(axis=1)[:, None, None]
    is_close = np.abs(gap) <= 1e-14 * largest
    rise = positive[:, :, None] - positive[:, None, :]
    step = (eigenvalues > 0.0)[:, :, None] * np.ones(eigenvalues.shape[1])
    omega = np.where(is_close, step, rise / np.where(is_close, 1.0, gap))[:, i, j]
    scale = np.sqrt(np.where(i == j, omega, 2.0 * omega))
    # Entry (i, j) of U^T H U is the row u_i (x) u_j times the entries of H.
    pairs = u[:, :, None, i] * u[:, None, :, j]
    rotation = (scale[:, None, None] * pairs).reshape(len(u), d * d, len(i))
    turned = np.swapaxes(rotation, 1, 2) @ directions[has_projection]
    rows = np.zeros((len(u), len(i)))
    rows[:, i == j] = positive
    return rows.ravel(), turned.reshape(-1, directions.shape[2])


def _projected_vectors(values: Array, directions: Array) -> tuple[Array, Array]:
    """Return rows and derivative of :func:`projected_rows` for the second-order cone
    |u| <= s; ``values`` (g, d) are g points (s, u), ``directions`` (g, d, p) their
    derivatives by p parameters.

    In the frame (axis, ray, across the ray) the derivative of the projection has the
    eigenvalues 1 or 0 along (1, +-ray) / sqrt(2), and (1 + s / |u|) / 2, clipped to [0,
    1], across. Rows and derivatives are scaled by their square roots.
    """
    width = directions.shape[2]
    # Points (s, u): s (g,), |u| (g,) and the unit vector u / |u| (g, d - 1).
    s = values[:, 0]
    norm = np.linalg.norm(values[:, 1:], axis=1)
    on_axis = norm <= 1e-14 * np.abs(s)
    ray = values[:, 1:] / np.where(on_axis, 1.0, norm)[:, None]
    # Eigenvalues s + |u| and s - |u| of the point (2, g), of which the projection keeps
    # the positive parts.
    on_diagonals = np.array([np.where(on_axis, s, s + norm), s - norm])
    ends = np.maximum(on_diagonals, 0.0) / np.sqrt(2.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        clipped = np.clip(0.5 * (1.0 + s / norm), 0.0, 1.0)
    slope_across = np.where(on_axis, s > 0.0, clipped)
    # Derivatives of the point by the parameters, along the ray (g, p) and across it.
    on_ray = np.einsum("gi,gip->gp", ray, directions[:, 1:])
    sum_and_difference = np.array(
        [directions[:, 0] + on_ray, directions[:, 0] - on_ray]
    )
    unit_combinations = sum_and_difference / np.sqrt(2.0)
    across_ray = directions[:, 1:] - ray[:, :, None] * on_ray[:, None]
    tail = np.sqrt(slope_across)[:, None, None] * across_ray
    rows = np.concatenate([ends.ravel(), np.zeros(tail.shape[0] * tail.shape[1])])
    derivative = np.concatenate(
        [
            (unit_combinations * (ends > 0.0)[:, :, None]).reshape(-1, width),
            tail.reshape(-1, width),
        ]
    )
    return rows, derivative


@dataclass(frozen=True, eq=False)
class Constraint:
    """F_0 + sum_i theta[indices[i]] F_i in a cone. It equals only itself, so that it
    can be the key of its multipliers."""

    #: Kind of the demand ("pseudo-inertia", "mass", ...).
    family: str
    #: What the demand is on ("link 3").
    name: str
    #: "psd", "soc" or "nonnegative"; a second-order cone's first entry is its axis.
    cone: str
    #: (k,) places of its parameters in theta.
    indices: Indices
    #: F_0, (d, d) for "psd", else (d,).
    constant: Array
    #: F_i of each parameter, (k, d, d) for "psd", else (k, d).
    coefficients: Array

    def value(self, theta: ArrayLike) -> Array:
        """Return the constrained quantity F(theta) = F_0 + sum theta_i F_i.

        Parameters
        ----------
        theta : (p,) array
            All parameters of the model.

        Returns
        -------
        array
            F(theta), which has to lie in the cone.
        """
        part = np.asarray(theta, float)[self.indices]
        return self.constant + np.tensordot(part, self.coefficients, axes=(0, 0))

    def margin(self, theta: ArrayLike) -> float:
        """Return the margin of F(theta) in the cone, in the unit of F, at parameters
        theta (p,); negative if the constraint is violated."""
        return float(cone_margin(self.cone, self.value(theta)))

    def is_reached(self, theta: ArrayLike) -> bool:
        """Return whether an entry of F(theta) is at zero, to a millionth of its terms.

        Of a linear constraint that is its boundary.
        """
        part = np.abs(np.asarray(theta, float)[self.indices])
        terms = np.tensordot(part, np.abs(self.coefficients), axes=(0, 0))
        size = np.abs(self.constant) + terms
        return bool(np.any(self.value(theta) <= 1e-6 * size))

    def with_known(self, values: Mapping[int, float]) -> Constraint:
        """Return the constraint on the other parameters, with known values in their
        places.

        Their coefficients are zero then. Entries of a non-negative constraint that are
        left without a parameter, and hold, are left out.

        Parameters
        ----------
        values : mapping of int to float
            Known parameters [SI] by their index in theta.

        Returns
        -------
        Constraint
            F_0 + sum over known k of value_k F_k, and the coefficients of the others.
        """
        is_known = np.array([k in values for k in self.indices.tolist()], bool)
        if not is_known.any():
            return self
        known_values = [values[k] for k in self.indices[is_known].tolist()]
        known_part = np.tensordot(
            known_values, self.coefficients[is_known], axes=(0, 0)
        )
        constant = self.constant + known_part
        coefficients = self.coefficients.copy()
        coefficients[is_known] = 0.0
        if self.cone == "nonnegative":
            is_open = np.any(coefficients != 0.0, axis=0) | (constant < 0.0)
            constant = constant[is_open]
            coefficients = coefficients[:, is_open]
        return replace(self, constant=constant, coefficients=coefficients)

    @property
    def holds_anyway(self) -> bool:
        """Whether the constraint holds whatever the parameters are: it has none, and
        its constant lies in the cone."""
        if np.any(self.coefficients):
            return False
        if not self.constant.size:
            return True
        return float(cone_margin(self.cone, self.constant)) >= 0.0

    @property
    def identity(self) -> Array:
        """Element e of the cone with margin(F + t e) = margin(F) + t."""
        d = len(self.constant)
        if self.cone == "psd":
            return np.eye(d)
        if self.cone == "soc":
            return np.eye(d)[0]  # the axis
        return np.ones(d)


@dataclass(frozen=True)
class BarycentricBound:
    """lower <= x <= upper for an entry x of a link's inertia about its centre of mass
    [kg m^2].

    Not convex in the standard parameters for products of inertia and for upper bounds
    on moments: I = J - m (c.c 1 - c c^T). The penalty methods take it as it is; where
    it has a convex consequence the problem gives that to the SDP as a Constraint of
    family "trace".
    """

    #: Name of the link.
    name: str
    #: (10,) places of the link's parameters in theta.
    indices: Indices
    #: Entry of the inertia, 0..5 for Ixx, Ixy, Iyy, Ixz, Iyz, Izz.
    entry: int
    #: Lower bound of the entry [kg m^2].
    lower: float
    #: Upper bound of the entry [kg m^2].
    upper: float
    #: Kind of the demand.
    family: str = "barycentric inertia"

    def margin(self, theta: ArrayLike) -> float:
        """Return the margin of a link's barycentric inertia to its bounds.

        Parameters
        ----------
        theta : (p,) array
            All parameters of the model.

        Returns
        -------
        float
            Margin [kg m^2]: negative outside; 0 for a link without mass.
        """
        part = np.asarray(theta, float)[self.indices]
        x = float(inertia.barycentric_from_standard(part)[4 + self.entry])
        if not np.isfinite(x):  # a massless link: no inertia about a centre of mass
            return 0.0
        return min(x - self.lower, self.upper - x)


@dataclass(frozen=True)
class ConstraintSet:
    """All demands on theta: convex ones, and others, which only some methods can take."""

    #: Convex demands, which every method takes.
    convex: tuple[Constraint, ...]
    #: Demands that are not convex, which only some methods can take.
    nonconvex: tuple[BarycentricBound, ...] = ()

    def worst(self, theta: ArrayLike) -> dict[str, float]:
        """Return the largest violation of each family of constraints.

        Parameters
        ----------
        theta : (p,) array
            All parameters of the model.

        Returns
        -------
        dict of str to float
            max(0, -margin) by family, each in its own unit.
        """
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
        """Return the smallest margin of the convex constraints, in the unit of its
        constraint, at parameters theta (p,); nonnegative if all hold."""
        return float(self.entries.margins(theta)[0].min(initial=np.inf))

    def depths(self, theta: ArrayLike) -> Iterator[float]:
        """Yield the smallest depth of :func:`cone_depths` in each group of constraints
        at parameters theta (p,), free of units, computed when it is taken; at most
        about one."""
        for group, values, terms in self.entries.parts(theta):
            yield float(cone_depths(group.cone, values, terms).min())

    def is_safely_inside(self, theta: ArrayLike) -> bool:
        """Return whether theta is feasible in any order of summation.

        Parameters
        ----------
        theta : (p,) array
            All parameters of the model.

        Returns
        -------
        bool
            Every group is at least as deep as its :func:`safe_depth`. The first group
            that is not ends the computation.
        """
        return all(
            depth >= safe_depth(group.constant.shape[1])
            for depth, group in zip(self.depths(theta), self.groups, strict=True)
        )

    def depth(self, theta: ArrayLike) -> float:
        """Return the depth of theta in the feasible set, the smallest of
        :meth:`depths`.

        Parameters
        ----------
        theta : (p,) array
            All parameters of the model.
        """
        return min(self.depths(theta), default=np.inf)

    def with_families(self, keep: Callable[[str], bool]) -> ConstraintSet:
        """Return the constraints of some families.

        Parameters
        ----------
        keep : callable
            Whether to keep a family, by its name.
        """
        return ConstraintSet(
            tuple(c for c in self.convex if keep(c.family)),
            tuple(c for c in self.nonconvex if keep(c.family)),
        )

    def with_known(self, values: Mapping[int, float]) -> ConstraintSet:
        """Return the constraints on the other parameters, with known values in their
        places; a convex one that holds whatever these are is left out.

        Parameters
        ----------
        values : mapping of int to float
            Known parameters [SI] by their index in theta.
        """
        if not values:
            return self
        convex = [c.with_known(values) for c in self.convex]
        return ConstraintSet(
            tuple(c for c in convex if not c.holds_anyway), self.nonconvex
        )

    @property
    def essential(self) -> tuple[Constraint, ...]:
        """Convex constraints without pseudo-inertias that a minimum thickness of the
        link implies.
        """
        thick = {c.name for c in self.convex if c.family == "minimum thickness"}
        return tuple(
            c
            for c in self.convex
            if c.family != "pseudo-inertia" or c.name not in thick
        )

    def stack_multipliers(self, multipliers: Mapping[Constraint, Array]) -> Array:
        """Stack the multipliers of the convex constraints into one vector.

        Parameters
        ----------
        multipliers : mapping of Constraint to array
            Multipliers of some constraints; all others are zero.

        Returns
        -------
        (e,) array
            Entries in the order of ``entries``.
        """
        constraints = (
            self.convex[k] for group in self.groups for k in group.places.tolist()
        )
        values = [
            multipliers[c] if c in multipliers else np.zeros_like(c.constant)
            for c in constraints
        ]
        return np.concatenate([np.zeros(0), *(x.ravel() for x in values)])

    def plus(self, more: Sequence[Constraint]) -> ConstraintSet:
        """Return these constraints with further convex ones."""
        return ConstraintSet(self.convex + tuple(more), self.nonconvex)

    @cached_property
    def entries(self) -> StackedCones:
        """All convex constraints stacked as one sparse affine map F(theta) = F_0 + A
        theta, group by group; theta is feasible if each part of F lies in its cone."""
        return StackedCones.from_groups(self.groups)

    @cached_property
    def groups(self) -> tuple[ConeGroup, ...]:
        """Convex constraints in groups of equal cones, which are evaluated together."""
        return tuple(group_cones(self.convex))


@dataclass(frozen=True)
class ConeGroup:
    """Coefficients of g :class:`Constraint` of one cone, size and number of
    parameters."""

    #: "psd", "soc" or "nonnegative".
    cone: str
    #: (g,) places of these constraints among all.
    places: Indices
    #: (g, k) places of each constraint's parameters in theta.
    indices: Indices
    #: (g, ...) F_0 of each constraint.
    constant: Array
    #: (g, k, ...) F_i of each constraint.
    coefficients: Array

    @cached_property
    def matrix(self) -> Array:
        """(g d, p') matrix with F.ravel() = constant.ravel() + matrix theta[:p']."""
        g, k = self.indices.shape
        flat = self.coefficients.reshape(g, k, -1)
        out = np.zeros((g, flat.shape[2], 1 + int(self.indices.max(initial=-1))))
        out[np.arange(g)[:, None], :, self.indices] = flat
        return out.reshape(-1, out.shape[2])

    def values(self, theta: Array) -> Array:
        """Return the points F(theta) (g, ...) of all constraints of the group.

        Parameters
        ----------
        theta : (p,) array
            All parameters of the model.
        """
        flat = self.matrix @ theta[: self.matrix.shape[1]]
        return self.constant + flat.reshape(self.constant.shape)


def group_cones(constraints: Sequence[Constraint]) -> list[ConeGroup]:
    """Group constraints of equal cone and size, so that they are evaluated together.

    Returns
    -------
    list of ConeGroup
        Groups, in the order in which each kind comes first.
    """
    # Places of the constraints in the sequence, by cone and shape.
    groups: dict[tuple[str, tuple[int, ...]], list[int]] = {}
    for place, c in enumerate(constraints):
        groups.setdefault((c.cone, c.coefficients.shape), []).append(place)
    out = []
    for (cone, _), places in groups.items():
        members = [constraints[k] for k in places]
        out.append(
            ConeGroup(
                cone,
                places=np.array(places),
                indices=np.array([c.indices for c in members]),
                constant=np.array([c.constant for c in members]),
                coefficients=np.array([c.coefficients for c in members]),
            )
        )
    return out


@dataclass(frozen=True)
class StackedCones:
    """The numbers of constraints end to end, group by group: F (e,) = constant + sum
    over z of value[z] theta[column[z]] at row[z]."""

    #: Groups of equal cones, in the order of the rows.
    groups: tuple[ConeGroup, ...]
    #: (e,) constant part of F.
    constant: Array
    #: (z,) row of F of each nonzero coefficient.
    row: Indices
    #: (z,) place in theta of each nonzero coefficient.
    column: Indices
    #: (z,) nonzero coefficients.
    value: Array

    @classmethod
    def from_groups(cls, groups: Sequence[ConeGroup]) -> StackedCones:
        """Stack the coefficients of all groups into one sparse map."""
        start = 0  # number of the group's first entry
        no_places = np.zeros(0, np.intp)
        rows = [no_places]
        columns = [no_places]
        values = [np.zeros(0)]
        for group in groups:
            # (cones, parameters of a cone, entries of a cone)
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
        """Evaluate all constraints at a point.

        Parameters
        ----------
        theta : (p,) array
            All parameters of the model.

        Returns
        -------
        (e,) array
            F(theta), the entries of all constraints.
        (e,) array
            |F_0| + sum |theta_i F_i|: the size of the terms that were summed.
        """
        terms = self.value * theta[self.column]
        count = len(self.constant)
        values = self.constant + np.bincount(self.row, terms, count)
        size = np.abs(self.constant) + np.bincount(self.row, np.abs(terms), count)
        return np.asarray(values), np.asarray(size)

    def parts(self, theta: ArrayLike) -> Iterator[tuple[ConeGroup, Array, Array]]:
        """Return each group with its points F(theta) (g, ...) and the size of their
        terms."""
        values, terms = map(self.split, self.at(np.asarray(theta, float)))
        return zip(self.groups, values, terms, strict=True)

    def margins(self, theta: ArrayLike) -> tuple[Array, Array]:
        """Return the margins of all constraints at a point.

        Parameters
        ----------
        theta : (p,) array
            All parameters of the model.

        Returns
        -------
        (m,) array
            Margin of each constraint, negative if it is violated.
        (m,) array
            Size of its largest summed term, with which rounding is compared.
        """
        margin, size = np.zeros((2, sum(len(group.places) for group in self.groups)))
        for group, values, terms in self.parts(theta):
            margin[group.places] = cone_margin(group.cone, values)
            size[group.places] = terms.reshape(len(values), -1).max(axis=1)
        return margin, size

    def adjoint(self, flat: Array, p: int) -> Array:
        """Return the adjoint of F's linear part: with F(theta) = F_0 + A theta and
        multipliers y (e,) this is A^T y (p,), for each parameter k the product <dF /
        dtheta_k, y>."""
        return np.asarray(np.bincount(self.column, self.value * flat[self.row], p))

    def split(self, flat: Any) -> list[Any]:
        """Split a stacked vector into one array a group; the arrays are views.

        Returns
        -------
        list of arrays
            One array (g, ...) a group.
        """
        out = []
        start = 0
        for group in self.groups:
            stop = start + group.constant.size
            out.append(flat[start:stop].reshape(group.constant.shape))
            start = stop
        return out

    def each(self, flat: Array) -> list[Array]:
        """Split a stacked vector into one array a constraint, in the order of the
        constraints.

        Returns
        -------
        list of arrays
            One array a constraint, with its shape.
        """
        by_place: dict[int, Array] = {}
        for group, part in zip(self.groups, self.split(flat), strict=True):
            by_place |= zip(group.places.tolist(), part, strict=True)
        return [by_place[k] for k in range(len(by_place))]


def pseudo_inertia(name: str, indices: ArrayLike, radius: float = 0.0) -> Constraint:
    """Return the constraint that a link's pseudo-inertia P(theta) is positive
    semidefinite.

    P >= 0 contains m >= 0, positive definiteness of the inertia and the triangle
    inequalities. With a radius r, Sigma_c >= m r^2 1 is demanded as well, as
    [[Sigma - m r^2 1, m c], [(m c)^T, m]] >= 0 (Schur complement). It keeps the optimum from
    being a rod of zero thickness.

    Parameters
    ----------
    indices : (10,) array of int
        Places of the link's parameters in theta.
    radius : float
        Smallest radius of gyration [m].

    Returns
    -------
    Constraint
        A psd constraint of order four.

    References
    ----------
    Wensing, Kim, Slotine, "Linear matrix inequalities for physically consistent inertial
    parameter identification", RA-L 2018.
    """
    coefficients = inertia.PSEUDO_INERTIA_BASIS.copy()
    coefficients[0, :3, :3] -= radius**2 * np.eye(3)
    family = "minimum thickness" if radius else "pseudo-inertia"
    return linear(
        family, name, indices, coefficients, constant=np.zeros((4, 4)), cone="psd"
    )


def density_in_ellipsoid(
    family: str, name: str, indices: ArrayLike, quadric: ArrayLike
) -> Constraint:
    """Return the constraint tr(P Q) >= 0: the link's mass lies inside an ellipsoid.

    (x, 1)^T Q (x, 1) is 1 at the centre of the ellipsoid and 0 on its surface. Its mean over
    the density is not negative, and it is linear in theta. With P >= 0 the constraint holds
    exactly where some density inside the ellipsoid has these parameters, and it bounds all
    of P by the mass.

    Parameters
    ----------
    family, name : str
        Family of the constraint and name of the link.
    indices : (10,) array of int
        Places of the link's parameters in theta.
    quadric : (4, 4) array
        Q, as :attr:`Body.quadric` has it.

    References
    ----------
    Wensing, Kim, Slotine, RA-L 2018, equation 20.
    """
    row = np.einsum(
        "kab,ab->k", inertia.PSEUDO_INERTIA_BASIS, np.asarray(quadric, float)
    )
    return linear(family, name, indices, coefficients=row[:, None], constant=[0.0])


def linear(
    family: str,
    name: str,
    indices: ArrayLike,
    coefficients: ArrayLike,
    constant: ArrayLike,
    cone: str = "nonnegative",
) -> Constraint:
    """Return the constraint that constant (d,) + coefficients (k, d)^T theta lies in a
    cone.

    Parameters
    ----------
    family, name : str
        Family of the constraint and name of what it is about.
    indices : (k,) array of int
        Places of the parameters in theta.
    cone : str
        "nonnegative" (entry by entry), "soc" with the entries (s, u) of |u| <= s, or "psd"
        with a matrix's entries.
    """
    places = np.asarray(indices, np.intp)
    return Constraint(
        family,
        name,
        cone,
        indices=places,
        constant=np.asarray(constant, float),
        coefficients=np.asarray(coefficients, float),
    )
