"""Identification as a conic problem, and the way back from its solution to parameters
and multipliers.

:func:`least_squares_sdp` writes it in the standard form: x = (scaled theta, residual z, ...)
with z = (R theta - rho) / lambda as variables of their own, and theta about a centre. In the bare
quadratic form the large constant rho^T rho sits between the solver and the loss it is to minimise,
and "solved" to 1e-8 of the constant can be percents of the loss.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from sdp_vs_penalty.regression.linalg import UNSEEN
from sdp_vs_penalty.robot.arrays import Array, Indices, nonzero_or_one
from sdp_vs_penalty.robot.constraint import (
    ConeGroup,
    Constraint,
    StackedCones,
    group_cones,
)
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, Solution, svec, unsvec
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem, Entropy

#: A unit of a scaled parameter that the data do not see moves no matrix farther than
#: this, in the matrix's size: its bound alone (100 kg, metres) can make columns of a
#: million beside those of one.
_FARTHEST = 100.0


@dataclass(frozen=True)
class Placed:
    """Where a constraint stands in a conic problem, and how its cone was scaled."""

    #: The constraint on theta.
    constraint: Constraint
    #: Rows of the constraint in the conic problem.
    rows: slice
    #: T of T F T^T for a matrix F, else the factor c of c * F.
    scale: Array


@dataclass(frozen=True)
class SdpProblem:
    """An identification problem in conic form with what is needed to read a solution
    back."""

    #: The problem in conic form.
    conic: ConicProblem
    #: (p,) theta at x = 0.
    centre: Array
    #: (p,) unit of each parameter: theta = centre + theta_scale x.
    theta_scale: Array
    #: Expected size of the residual, the unit of the conic problem's.
    loss_scale: float
    #: Rows and scale of each constraint, in their order.
    placed: tuple[Placed, ...]
    #: The objective is offset + loss_scale^2 times the conic one.
    offset: float = 0.0
    #: The entropic prior; None without one.
    entropy: Entropy | None = None
    #: Row in which the links' 8x8 blocks begin.
    entropy_row: int = 0

    def theta(self, solution: Solution) -> Array:
        """Return the parameters of a solver's solution.

        Returns
        -------
        (p,)
            theta = centre + scale x.
        """
        return self.centre + self.theta_scale * solution.x[: len(self.theta_scale)]

    def entropy_slopes(self, solution: Solution) -> Array | None:
        """Return the dual's estimate of P(theta)^-1, for a tight bound of -log det P.

        It is the upper left 4x4 block of the multiplier of each link's 8x8 matrix,
        unscaled.

        Returns
        -------
        (links, 4, 4) or None
            None without an entropic prior.
        """
        if self.entropy is None:
            return None
        svec_length = 36  # of a matrix of order 8
        end = self.entropy_row + svec_length * len(self.entropy.links)
        vectors = solution.z[self.entropy_row : end].reshape(-1, svec_length)
        blocks = unsvec(vectors, 8)[:, :4, :4]
        return (
            blocks
            * unit_diagonal_factors(self.entropy.nominal)
            * self.loss_scale**2
            / self.entropy.weight
        )

    def multipliers(self, solution: Solution) -> dict[Constraint, Array]:
        """Return the multipliers of a solution, unscaled.

        Returns
        -------
        dict
            Dual matrix or vector of each constraint, in loss per unit of F.
        """
        multipliers = {}
        for item in self.placed:
            constraint = item.constraint
            T = item.scale
            multiplier = solution.z[item.rows] * self.loss_scale**2
            if constraint.cone == "psd":
                multipliers[constraint] = (
                    T.T @ unsvec(multiplier, len(constraint.constant)) @ T
                )
            else:
                multipliers[constraint] = T * multiplier
        return multipliers

    def shares(self, solution: Solution) -> Array:
        """Return each constraint's share in a proof of infeasibility, free of units.

        Returns
        -------
        (k,)
            <z, e> with the scaled multiplier z and the unit e of its cone. For
            :func:`largest_margin` they add up to one if no theta satisfies all
            constraints.
        """
        shares = []
        for item in self.placed:
            unit = item.constraint.identity
            if unit.ndim > 1:
                unit = svec(unit)
            shares.append(float(solution.z[item.rows] @ unit))
        return np.array(shares)


def least_squares_sdp(
    problem: ConvexProblem,
    reference: Array,
    centre: Array,
    fine: bool = False,
    least_loss: float = 0.0,
) -> SdpProblem:
    """Pose an identification as a conic problem, centred and scaled for a solver.

    Its constraints are the essential ones. New variables z are the residual in units of
    the expected loss; theta = centre + scale x.

    Parameters
    ----------
    reference : (p,)
        A theta inside the constraints, at which each cone is scaled to its unit.
    centre : (p,)
        theta at x = 0; near the optimum no digits cancel.
    fine : bool
        A unit of x makes the torque of the residual instead of the whole torque.
    least_loss : float
        Lower estimate of the loss at the optimum, where constraints cost far more than
        the unconstrained residual: the unit of the objective.

    Returns
    -------
    SdpProblem
        Conic problem, and the way back to theta.
    """
    data = problem.least_squares
    entropy = problem.entropy
    constraints = problem.essential
    bound = problem.bound
    p = len(bound)
    # 1. Unit of each parameter: what makes all the torque, or moves no matrix far.
    torque = float(np.sqrt(data.tau_squared)) or 1.0
    norms = np.linalg.norm(data.R, axis=0)
    is_seen = norms * bound > UNSEEN * torque
    unit = np.where(
        is_seen,
        torque / np.where(is_seen, norms, 1.0),
        moving_scale(constraints, reference, bound),
    )
    rows, rho, out_of_reach = _independent_rows(
        data.R * unit, data.rho - data.R @ centre
    )
    r = len(rho)
    offset = data.residual_norm**2 + out_of_reach
    loss_scale = (
        float(np.sqrt(max(offset, 1e-12 * data.tau_squared, least_loss))) or 1.0
    )
    finer = loss_scale / torque if fine else 1.0
    scale = np.where(is_seen, np.minimum(bound, finer * unit), unit)
    # 2. Equality rows: R (theta - centre) / loss_scale - z = (rho - R centre) /
    # loss_scale; the objective is |z|^2, and the constraints follow.
    residual = np.hstack([rows * (scale / unit) / loss_scale, -np.eye(r)])
    scaled_constraints, placed = scaled(constraints, centre, scale, reference, first=r)
    groups = [plain_rows("zero", residual, -rho / loss_scale), *scaled_constraints]
    quadratic = np.repeat([0.0, 2.0], [p, r])  # of x (p,) and z (r,)
    linear = np.zeros(p + r)
    # 3. The prior w (tr(P0^-1 P) - log det P + ...), with further variables t.
    start = 0
    if entropy is not None:
        start = sum(group.constant.size for group in groups)
        log_det_cones, logs, links = _log_det(entropy, centre, scale, p + r)
        groups += log_det_cones
        inverse, log_det = entropy.nominal_terms
        weight = entropy.weight / loss_scale**2
        linear[:p] = weight * scale * entropy.entries.adjoint(inverse.ravel(), p)
        # Each link adds ten entries of a triangular matrix, and its logarithms t.
        n_new = logs.size + 10 * len(inverse)
        quadratic = np.pad(quadratic, (0, n_new))
        linear = np.pad(linear, (0, n_new))
        linear[logs] = -weight
        # Constants of the divergence: the trace at the centre, log det P0 - 4, and the
        # scaling of P to a diagonal of ones.
        left_out = np.sum(inverse * links.values(centre)) + np.sum(log_det - 4.0)
        sizes = np.diagonal(entropy.nominal, axis1=1, axis2=2)
        offset += entropy.weight * float(left_out - np.sum(np.log(sizes)))
    conic = conic_problem(groups, scipy.sparse.diags(quadratic).tocsc(), linear)
    return SdpProblem(
        conic,
        centre,
        theta_scale=scale,
        loss_scale=loss_scale,
        placed=placed,
        offset=offset,
        entropy=entropy,
        entropy_row=start,
    )


def largest_margin(
    constraints: Sequence[Constraint], reference: Array, scale: Array
) -> SdpProblem:
    """Pose the problem: maximise t <= 1 with every scaled F(theta) - t e in its cone.

    ``scale`` (p,) is the unit of each parameter.

    Parameters
    ----------
    reference : (p,)
        Point at which the cones are scaled.

    Returns
    -------
    SdpProblem
        In x = (theta / scale, t). t > 0 at the optimum shows an interior point; t < 0
        proves that no theta satisfies all constraints.
    """
    p = len(scale)
    groups, placed = scaled(constraints, np.zeros(p), scale, reference, slack=True)
    # Variables (x, t): the row 1 - t >= 0, and the objective -t to minimise.
    minus_t = -np.eye(p + 1)[p:]
    conic = conic_problem(
        [*groups, plain_rows("nonnegative", minus_t, np.ones(1))], None, minus_t[0]
    )
    return SdpProblem(
        conic, centre=np.zeros(p), theta_scale=scale, loss_scale=1.0, placed=placed
    )


def conic_problem(
    groups: Sequence[ConeGroup],
    quadratic: scipy.sparse.csc_matrix | None,
    linear: Array,
) -> ConicProblem:
    """Pose: minimise 1/2 x^T quadratic x + linear^T x with every F(x) of the groups in
    its cone.

    ``quadratic`` (m, m) is an upper triangle (None: zero); ``linear`` is (m,).

    Parameters
    ----------
    groups : sequence of ConeGroup
        constant (g, rows) and coefficients (g, k, rows); matrices by their svec.

    Returns
    -------
    ConicProblem
        In the standard form of the solvers.
    """
    stacked = StackedCones.from_groups(groups)
    m = len(linear)
    A = scipy.sparse.csc_matrix(
        (-stacked.value, (stacked.row, stacked.column)), (len(stacked.constant), m)
    )
    cones = list[Cone]()
    for group in groups:
        count, size = group.constant.shape
        if (
            group.cone == "psd"
        ):  # the svec of a matrix of order d has d (d + 1) / 2 rows
            size = math.isqrt(2 * size)
        cones += [Cone(group.cone, size)] * count
    P = scipy.sparse.csc_matrix((m, m)) if quadratic is None else quadratic
    return ConicProblem(P, q=linear, A=A, b=stacked.constant, cones=tuple(cones))


def plain_rows(kind: str, matrix: Array, constant: Array) -> ConeGroup:
    """Return one cone of rows matrix x[:w] + constant (r,).

    Parameters
    ----------
    kind : str
        Kind of the cone, such as "zero".
    matrix : (r, w)
        Coefficients of the first w entries of x.

    Returns
    -------
    ConeGroup
        A group with one cone.
    """
    return ConeGroup(
        kind,
        places=np.arange(1),
        indices=np.arange(matrix.shape[1])[None],
        constant=constant[None],
        coefficients=matrix.T[None],
    )


def scaled(
    constraints: Sequence[Constraint],
    centre: Array,
    theta_scale: Array,
    reference: Array | None,
    first: int = 0,
    slack: bool = False,
) -> tuple[list[ConeGroup], tuple[Placed, ...]]:
    """Return the constraints in x, with theta = centre + theta_scale x, and scaled
    cones.

    Scaling: a matrix F becomes T F T^T, with T such that it is the identity at
    ``reference`` (with ``slack``: has a diagonal of ones). Rows are divided by their
    largest coefficient.

    Parameters
    ----------
    centre : (p,)
        theta at x = 0.
    reference : (p,) or None
        Point at which the cones are scaled; None: no scaling.
    first : int
        Row in which the first constraint begins.
    slack : bool
        Return F - t e, with t the entry of x behind theta's and e the unit of the cone.

    Returns
    -------
    list of ConeGroup
        The scaled cones, for :func:`conic_problem`.
    tuple of Placed
        Rows and scale of each constraint, in their order.
    """
    groups = list[ConeGroup]()
    placed = dict[int, Placed]()
    for group in group_cones(constraints):
        # A group has g constraints of one size: constant (g, ...), coefficients
        # (g, k, ...) of the parameters ``indices`` (g, k).
        local = theta_scale[group.indices][:, :, None]
        is_psd = group.cone == "psd"
        indices = group.indices
        centre_value = group.values(centre)
        if is_psd:
            scale = _matrix_scale(group, reference, only_diagonal=slack)
            transposed = np.swapaxes(scale, 1, 2)
            coefficients = scale[:, None] @ group.coefficients @ transposed[:, None]
            columns = svec(coefficients) * local
            constant = svec(scale @ centre_value @ transposed)
        else:
            scale = np.ones_like(group.constant)
            if reference is not None:
                scale = _row_scale(group, local)
            constant = centre_value * scale
            columns = group.coefficients * scale[:, None] * local
        if slack:
            unit = constraints[group.places[0]].identity
            unit = np.broadcast_to(svec(unit) if is_psd else unit, constant.shape)
            columns = np.concatenate([columns, -unit[:, None]], axis=1)
            place_of_t = np.full(len(indices), len(theta_scale))
            indices = np.column_stack([indices, place_of_t])
        groups.append(
            ConeGroup(group.cone, group.places, indices, constant, coefficients=columns)
        )
        for place, member_scale in zip(group.places.tolist(), scale, strict=True):
            placed[place] = Placed(
                constraints[place],
                slice(first, first + constant.shape[1]),
                member_scale,
            )
            first += constant.shape[1]
    return groups, tuple(placed[k] for k in range(len(constraints)))


def _matrix_scale(
    group: ConeGroup, reference: Array | None, *, only_diagonal: bool
) -> Array:
    """Return T (g, d, d), with which matrices F of a group become T F T^T.

    At ``reference`` (p,) that is the identity, or a matrix with a diagonal of ones
    (``only_diagonal``). Without a reference T is the identity.
    """
    identity = np.broadcast_to(np.eye(group.constant.shape[1]), group.constant.shape)
    if reference is None:
        return identity
    values = group.values(reference)
    if only_diagonal:
        return _sizes(values)[:, :, None] * identity
    return _whitening(values)


def _row_scale(group: ConeGroup, theta_scale: Array) -> Array:
    """Return (g, rows) factors that bring the terms of rows to size one.

    ``theta_scale`` (g, k, 1) are the units of the group's k parameters. The rows of a
    second-order cone share one factor, which leaves the cone as it is.
    """
    in_units = group.coefficients * theta_scale  # (g, k, rows)
    size = np.abs(in_units).max(axis=1) + np.abs(group.constant)
    if group.cone == "soc":
        size = np.maximum(size, size.max(axis=1, keepdims=True))
    return 1.0 / nonzero_or_one(size)


def _log_det(
    entropy: Entropy, centre: Array, theta_scale: Array, width: int
) -> tuple[list[ConeGroup], Indices, ConeGroup]:
    """Return cones that bound sum t <= log det P for each link's pseudo-inertia P
    (4x4).

    log det P >= sum_k log Z_kk where [[P, Z], [Z^T, diag(Z)]] >= 0 and Z is lower
    triangular (4x4), and exp(t_k) <= Z_kk. P is scaled to a diagonal of ones at the
    nominal link. The variables of the conic problem are x = (theta's, others); from
    index ``width`` on each link has 14 new ones: ten entries of Z and four t. theta =
    centre + theta_scale x.

    Returns the groups of cones, the indices of all t in x, and the links'
    pseudo-inertias.
    """
    (links,) = group_cones(entropy.links)
    n = len(links.places)
    # Entries (i, j) of Z. Each link's 8x8 matrix depends on 20 variables: its ten
    # parameters, then the ten entries of Z (numbers ``z``).
    i, j = np.tril_indices(4)
    z = 10 + np.arange(10)
    factors = unit_diagonal_factors(entropy.nominal)
    blocks = np.zeros((n, 20, 8, 8))  # coefficient of each variable
    constant = np.zeros((n, 8, 8))
    local = theta_scale[links.indices][:, :, None, None]
    # Upper left 4x4: P. Upper right: Z, lower left: Z^T. Lower right: diag(Z).
    blocks[:, :10, :4, :4] = links.coefficients * factors[:, None] * local
    blocks[:, z, i, 4 + j] = 1.0
    blocks[:, z, 4 + j, i] = 1.0
    diagonal = np.flatnonzero(i == j)
    lower_diagonal = 4 + np.arange(4)
    blocks[:, z[diagonal], lower_diagonal, lower_diagonal] = 1.0
    constant[:, :4, :4] = links.values(centre) * factors
    # Places in x: ten entries of Z and four t of each link.
    places = width + np.arange(14 * n).reshape(n, 14)
    indices = np.column_stack([links.indices, places[:, :10]])
    logs = places[:, 10:].ravel()
    matrices = ConeGroup(
        "psd", links.places, indices, constant=svec(constant), coefficients=svec(blocks)
    )
    # exp(t) <= Z_kk: the exponential cone holds (t, 1, Z_kk).
    pairs = np.column_stack([logs, places[:, diagonal].ravel()])
    first, second, third = np.eye(3)
    exponentials = ConeGroup(
        "exp",
        places=np.arange(4 * n),
        indices=pairs,
        constant=np.tile(second, (4 * n, 1)),
        coefficients=np.tile([first, third], (4 * n, 1, 1)),
    )
    return [matrices, exponentials], logs, links


def unit_diagonal_factors(values: Array) -> Array:
    """Return factors d_i d_j (g, d, d), d_i = 1 / sqrt(values_ii), that give matrices
    with positive diagonals a diagonal of ones, entry by entry."""
    size = _sizes(values)
    return size[:, :, None] * size[:, None]


def moving_scale(
    constraints: Sequence[Constraint], reference: Array, bound: Array
) -> Array:
    """Return units (p,) of theta, at most ``bound``, that move no matrix by more than
    _FARTHEST times its size.

    Parameters
    ----------
    reference : (p,)
        Point at which the size of the matrices is taken.
    """
    moves = np.zeros(len(bound))  # relative change of the matrices by a unit of theta
    for group in group_cones([c for c in constraints if c.cone == "psd"]):
        # |T F_k T^T| (g, k), with T F(reference) T^T = 1.
        t = _whitening(group.values(reference))[:, None]
        size = np.linalg.norm(
            t @ group.coefficients @ np.swapaxes(t, 2, 3), axis=(2, 3)
        )
        np.maximum.at(moves, group.indices, size)
    return _FARTHEST / np.maximum(moves, _FARTHEST / bound)


def _whitening(values: Array) -> Array:
    """Return T (g, d, d) with T F T^T = 1 for positive definite matrices F (g, d, d).

    A link's pseudo-inertia has its mass in one corner and moments of a thousandth in
    the others, coupled by a centre of mass many times its thickness away. A solver that
    sees it as the identity gains one to two digits of the certified gap. Directions in
    which F is singular are stretched at most 1e3 times.
    """
    size = _sizes(values)
    eigenvalues, vectors = np.linalg.eigh(values * unit_diagonal_factors(values))
    root = np.where(
        eigenvalues[:, -1:] > 0.0, np.sqrt(np.maximum(eigenvalues, 1e-6)), 1.0
    )
    return (vectors / root[:, None]) @ np.swapaxes(vectors, 1, 2) * size[:, None]


def _sizes(values: Array) -> Array:
    """Return (g, d) factors 1 / sqrt|F_ii| of matrices (g, d, d), which may be
    indefinite.
    """
    diagonal = np.abs(np.diagonal(values, axis1=1, axis2=2))
    return 1.0 / np.sqrt(nonzero_or_one(diagonal))


def _independent_rows(matrix: Array, rho: Array) -> tuple[Array, Array, float]:
    """Reduce the rows of |matrix x - rho| to independent ones by a pivoted QR.

    Returns an upper trapezoid (rank, p), the new right side (rank,), and the squared
    residual that no x can reach. Pivoted columns leave half the entries of any other
    choice, hence a solver takes two thirds of the time.
    """
    q, r, pivots = scipy.linalg.qr(
        matrix, mode="economic", pivoting=True, check_finite=False
    )
    diagonal = np.abs(np.diagonal(r))
    rank = 0
    if diagonal[0] > 0.0:
        # Less than 1e-13 of the largest is rounding.
        rank = int(np.sum(diagonal > 1e-13 * diagonal[0]))
    rows = np.zeros((rank, matrix.shape[1]))
    rows[:, pivots] = r[:rank]
    reduced = q[:, :rank].T @ rho
    missed = rho - q[:, :rank] @ reduced
    return rows, reduced, float(missed @ missed)
