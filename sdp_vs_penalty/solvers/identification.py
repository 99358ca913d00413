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
from numpy.typing import NDArray

from sdp_vs_penalty.regression.linalg import UNSEEN
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.constraint import (
    ConeGroup,
    Constraint,
    StackedCones,
    group_cones,
)
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, Solution, svec, unsvec
from sdp_vs_penalty.solvers.objective import Entropy, Objective

#: A unit of a scaled parameter that the data do not see moves no matrix farther than
#: this, in the matrix's size: its bound alone (100 kg, metres) can make columns of a
#: million beside those of one.
_FARTHEST = 100.0


@dataclass(frozen=True)
class Placed:
    """Which rows are a constraint's, and how its cone was scaled: T F T^T (T a matrix)
    or c * F."""

    constraint: Constraint
    rows: slice
    scale: Array


@dataclass(frozen=True)
class SdpProblem:
    """An identification problem in conic form with what is needed to read a solution
    back."""

    conic: ConicProblem
    centre: Array
    theta_scale: Array
    loss_scale: float
    placed: tuple[Placed, ...]
    offset: float = 0.0  # the objective is offset + loss_scale^2 times the conic one
    entropy: Entropy | None = None
    entropy_row: int = 0  # where the links' 8x8 blocks start

    def theta(self, solution: Solution) -> Array:
        """The parameters of a solution.

        Parameters
        ----------
        solution : Solution
            What a solver has answered to this problem.

        Returns
        -------
        (p,)
            theta = centre + scale x.
        """
        return self.centre + self.theta_scale * solution.x[: len(self.theta_scale)]

    def entropy_slopes(self, solution: Solution) -> Array | None:
        """The dual's own idea of P(theta)^-1, for a tight bound on -log det.

        Parameters
        ----------
        solution : Solution
            What a solver has answered to this problem.

        Returns
        -------
        (links, 4, 4) or None
            None without an entropic prior.
        """
        if self.entropy is None:
            return None
        end = self.entropy_row + 36 * len(self.entropy.links)
        matrices = solution.z[self.entropy_row : end].reshape(-1, 36)
        blocks = unsvec(matrices, 8)[:, :4, :4]
        return (
            blocks
            * unit_diagonal_factors(self.entropy.nominal)
            * self.loss_scale**2
            / self.entropy.weight
        )

    def multipliers(self, solution: Solution) -> dict[Constraint, Array]:
        """The multipliers of a solution.

        Parameters
        ----------
        solution : Solution
            What a solver has answered to this problem.

        Returns
        -------
        dict
            The dual matrix or vector of each constraint, in the units of loss per
            F.
        """
        out = {}
        for item in self.placed:
            c = item.constraint
            T = item.scale
            part = solution.z[item.rows] * self.loss_scale**2
            out[c] = (
                T.T @ unsvec(part, len(c.constant)) @ T if c.cone == "psd" else T * part
            )
        return out

    def shares(self, solution: Solution) -> Array:
        """Each constraint's share of a proof, free of units.

        Parameters
        ----------
        solution : Solution
            What a solver has answered to this problem.

        Returns
        -------
        (k,)
            <z, e> of each constraint's scaled multiplier z. For
            :func:`largest_margin` they add up to one where no theta satisfies all
            constraints.
        """
        loss_parts = (
            (solution.z[item.rows], item.constraint.identity) for item in self.placed
        )
        return np.array(
            [float(z @ (svec(e) if e.ndim > 1 else e)) for z, e in loss_parts]
        )


def least_squares_sdp(
    objective: Objective,
    constraints: Sequence[Constraint],
    reference: Array,
    bound: Array,
    centre: Array,
    fine: bool = False,
    least_loss: float = 0.0,
) -> SdpProblem:
    """Minimise the objective subject to the constraints, centred and scaled for a
    solver.

    Parameters
    ----------
    objective : Objective
        A sum of squares, with a linear and an entropic term.
    constraints : sequence of Constraint
        What theta has to satisfy.
    reference : (p,)
        A theta inside the constraints, from where each cone is scaled.
    bound : (p,)
        The largest plausible |theta_k|.
    centre : (p,)
        theta = centre + scale x; near the optimum nothing cancels.
    fine : bool
        A unit of a parameter makes the torque of the residual instead of the
        whole torque.
    least_loss : float
        What the loss at the optimum is at least about, where the constraints
        cost far more than the unconstrained residual: the objective is a number
        of size one in that unit.

    Returns
    -------
    SdpProblem
        The conic problem, and the way back to theta.
    """
    data = objective.least_squares
    entropy = objective.entropy
    p = len(bound)
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
    scale = np.where(
        is_seen,
        np.minimum(bound, finer * unit),
        unit,
    )
    # R (theta - centre) - lambda z = R (best - centre), up to what no theta reaches
    residual = np.hstack(
        [
            rows * (scale / unit) / loss_scale,
            -np.eye(r),
        ]
    )
    scaled_constraints, placed = scaled(
        constraints,
        centre,
        scale,
        reference,
        first=r,
    )
    groups = [plain_rows("zero", residual, -rho / loss_scale), *scaled_constraints]
    quadratic = np.repeat([0.0, 2.0], [p, r])
    linear = np.zeros(p + r)
    start = 0
    if entropy is not None:
        start = sum(group.constant.size for group in groups)
        more, logs, links = _log_det(
            entropy,
            centre,
            scale,
            p + r,
        )
        groups += more
        inverse, log_det = entropy.nominal_terms
        weight = entropy.weight / loss_scale**2
        linear[:p] = weight * scale * entropy.entries.adjoint(inverse.ravel(), p)
        n_more = logs.size + 10 * len(inverse)
        quadratic = np.pad(quadratic, (0, n_more))
        linear = np.pad(linear, (0, n_more))
        linear[logs] = -weight
        # Of the divergence the conic problem leaves out the trace at the centre, log
        # det and scaling.
        left = np.sum(inverse * links.values(centre)) + np.sum(log_det - 4.0)
        sizes = np.diagonal(
            entropy.nominal,
            axis1=1,
            axis2=2,
        )
        offset += entropy.weight * float(left - np.sum(np.log(sizes)))
    conic = conic_problem(
        groups,
        scipy.sparse.diags(quadratic).tocsc(),
        linear,
    )
    return SdpProblem(
        conic,
        centre,
        scale,
        loss_scale,
        placed,
        offset,
        entropy,
        start,
    )


def largest_margin(
    constraints: Sequence[Constraint],
    reference: Array,
    scale: Array,
) -> SdpProblem:
    """Maximise t <= 1 with every (scaled) F(theta) - t e in its cone.

    Parameters
    ----------
    constraints : sequence of Constraint
        What theta has to satisfy.
    reference : (p,)
        Where the search is centred.
    scale : (p,)
        The unit of each parameter.

    Returns
    -------
    SdpProblem
        In x = (theta / scale, t). t > 0 at the optimum shows an interior point;
        t < 0 proves that no theta satisfies all constraints.
    """
    p = len(scale)
    groups, placed = scaled(
        constraints,
        np.zeros(p),
        scale,
        reference,
        slack=True,
    )
    top = -np.eye(p + 1)[p:]
    conic = conic_problem(
        [*groups, plain_rows("nonnegative", top, np.ones(1))],
        None,
        top[0],
    )
    return SdpProblem(
        conic,
        np.zeros(p),
        scale,
        1.0,
        placed,
    )


def conic_problem(
    groups: Sequence[ConeGroup],
    quadratic: scipy.sparse.csc_matrix | None,
    linear: Array,
) -> ConicProblem:
    """Minimise 1/2 x^T quadratic x + linear^T x, every F(x) of the groups in its cone.

    Parameters
    ----------
    groups : sequence of ConeGroup
        Matrices by their svec: constant (g, rows), coefficients (g, k, rows).
    quadratic : (m, m) sparse, or None
        Upper triangle.
    linear : (m,)
        Slope.

    Returns
    -------
    ConicProblem
        As a solver takes it.
    """
    stacked = StackedCones.from_groups(groups)
    m = len(linear)
    A = scipy.sparse.csc_matrix(
        (-stacked.value, (stacked.row, stacked.column)), (len(stacked.constant), m)
    )
    cones = list[Cone]()
    for group in groups:
        count, size = group.constant.shape
        cones += [
            Cone(group.cone, math.isqrt(2 * size) if group.cone == "psd" else size)
        ] * count
    P = scipy.sparse.csc_matrix((m, m)) if quadratic is None else quadratic
    return ConicProblem(
        P,
        linear,
        A,
        stacked.constant,
        tuple(cones),
    )


def plain_rows(kind: str, matrix: Array, constant: Array) -> ConeGroup:
    """Rows of one cone.

    Parameters
    ----------
    kind : str
        Of the cone.
    matrix : (r, w)
        Of the first w entries of x.
    constant : (r,)
        What is added.

    Returns
    -------
    ConeGroup
        matrix x[:w] + constant.
    """
    return ConeGroup(
        kind,
        np.arange(1),
        np.arange(matrix.shape[1])[None],
        constant[None],
        matrix.T[None],
    )


def scaled(
    constraints: Sequence[Constraint],
    centre: Array,
    theta_scale: Array,
    reference: Array | None,
    first: int = 0,
    slack: bool = False,
) -> tuple[list[ConeGroup], tuple[Placed, ...]]:
    """The constraints in x, theta = centre + theta_scale x, for :func:`conic_problem`.

    Parameters
    ----------
    constraints : sequence of Constraint
        What theta has to satisfy.
    centre : (p,)
        theta at x = 0.
    theta_scale : (p,)
        The unit of each parameter.
    reference : (p,) or None
        From where matrices are seen; None: cones as they are.
    first : int
        The row that the first one stands in.
    slack : bool
        Of F - t e, t the entry of x behind theta's; matrices are not turned
        then.

    Returns
    -------
    tuple
        The groups of cones, and where each constraint stands.
    """
    groups = list[ConeGroup]()
    placed = dict[int, Placed]()
    for group in group_cones(constraints):
        local = theta_scale[group.indices][:, :, None]
        psd = group.cone == "psd"
        d = group.constant.shape[1]
        indices = group.indices
        middle = group.values(centre)
        if psd:
            T = np.broadcast_to(np.eye(d), group.constant.shape)
            if reference is not None:
                at = group.values(reference)
                T = _sizes(at)[:, :, None] * T if slack else _whitening(at)
            turned = np.swapaxes(T, 1, 2)
            columns = svec(T[:, None] @ group.coefficients @ turned[:, None]) * local
            constant = svec(T @ middle @ turned)
            scale = T
        else:
            scale = np.ones_like(group.constant)
            if reference is not None:
                size = np.abs(group.coefficients * local).max(axis=1) + np.abs(
                    group.constant
                )
                soc = group.cone == "soc"
                scale = 1.0 / nonzero_or_one(
                    np.maximum(
                        size,
                        size.max(
                            axis=1,
                            keepdims=True,
                        ),
                    )
                    if soc
                    else size
                )
            constant = middle * scale
            columns = group.coefficients * scale[:, None] * local
        if slack:
            unit = constraints[group.places[0]].identity
            unit = np.broadcast_to(svec(unit) if psd else unit, constant.shape)
            columns = np.concatenate([columns, -unit[:, None]], axis=1)
            indices = np.column_stack(
                [indices, np.full(len(indices), len(theta_scale))]
            )
        groups.append(
            ConeGroup(
                group.cone,
                group.places,
                indices,
                constant,
                columns,
            )
        )
        for place, member_scale in zip(group.places.tolist(), scale, strict=True):
            placed[place] = Placed(
                constraints[place],
                slice(first, first + constant.shape[1]),
                member_scale,
            )
            first += constant.shape[1]
    return groups, tuple(placed[k] for k in range(len(constraints)))


def _log_det(
    entropy: Entropy,
    centre: Array,
    theta_scale: Array,
    width: int,
) -> tuple[list[ConeGroup], NDArray[np.intp], ConeGroup]:
    """Groups that say sum t <= log det P for each link, the places of all t in x, and
    the links.

    log det P >= sum_k log Z_kk where [[P, Z], [Z^T, diag(Z)]] >= 0 and Z is lower
    triangular; Z's ten entries and four t of each link stand in x from ``width`` on.
    """
    (links,) = group_cones(entropy.links)
    n, (i, j) = len(links.places), np.tril_indices(4)
    twice = unit_diagonal_factors(entropy.nominal)
    z = 10 + np.arange(10)
    blocks = np.zeros((n, 20, 8, 8))
    constant = np.zeros((n, 8, 8))
    local = theta_scale[links.indices][:, :, None, None]
    blocks[:, :10, :4, :4] = links.coefficients * twice[:, None] * local
    blocks[:, z, i, 4 + j] = 1.0
    blocks[:, z, 4 + j, i] = 1.0
    diagonal = np.flatnonzero(i == j)
    last = 4 + np.arange(4)
    blocks[:, z[diagonal], last, last] = 1.0
    constant[:, :4, :4] = links.values(centre) * twice
    new = width + np.arange(14 * n).reshape(n, 14)
    indices = np.column_stack(
        [
            links.indices,
            new[:, :10],
        ]
    )
    logs = new[:, 10:].ravel()
    matrices = ConeGroup(
        "psd",
        links.places,
        indices,
        svec(constant),
        svec(blocks),
    )
    # exp(t) <= Z_dd
    pairs = np.column_stack(
        [
            logs,
            new[:, diagonal].ravel(),
        ]
    )
    one = np.tile(np.eye(3)[1], (4 * n, 1))
    both = np.tile(np.eye(3)[::2], (4 * n, 1, 1))
    return (
        [
            matrices,
            ConeGroup(
                "exp",
                np.arange(4 * n),
                pairs,
                one,
                both,
            ),
        ],
        logs,
        links,
    )


def unit_diagonal_factors(values: Array) -> Array:
    """Scaling factors that, entry by entry, give matrices a diagonal of ones.

    Parameters
    ----------
    values : (g, d, d)
        Matrices with positive diagonals.

    Returns
    -------
    (g, d, d)
        d_i d_j with d_i = 1 / sqrt(values_ii).
    """
    size = _sizes(values)
    return np.asarray(size[:, :, None] * size[:, None])


def moving_scale(
    constraints: Sequence[Constraint],
    reference: Array,
    bound: Array,
) -> Array:
    """Units of theta that move no matrix far in its size at the reference.

    Parameters
    ----------
    constraints : sequence of Constraint
        What theta has to satisfy.
    reference : (p,)
        Where the matrices are looked at.
    bound : (p,)
        The largest unit.

    Returns
    -------
    (p,)
        A unit for each parameter.
    """
    moves = np.zeros(len(bound))
    for group in group_cones([c for c in constraints if c.cone == "psd"]):
        t = _whitening(group.values(reference))[:, None]
        size = np.linalg.norm(
            t @ group.coefficients @ np.swapaxes(t, 2, 3), axis=(2, 3)
        )
        np.maximum.at(moves, group.indices, size)
    return np.asarray(_FARTHEST / np.maximum(moves, _FARTHEST / bound))


def _whitening(values: Array) -> Array:
    """T (g, d, d) with T F T^T = 1 for positive definite F: the cones as seen from
    points inside them.

    A link's matrix has its mass in one corner and moments of a thousandth in the
    others, coupled by a centre of mass many times its thickness away; a solver that
    sees it as the identity gains one to two digits of the certified gap. Directions in
    which F is singular are stretched at most 1e3 times.
    """
    size = _sizes(values)
    eigenvalues, vectors = np.linalg.eigh(values * unit_diagonal_factors(values))
    root = np.where(
        eigenvalues[:, -1:] > 0.0,
        np.sqrt(np.maximum(eigenvalues, 1e-6)),
        1.0,
    )
    return np.asarray(
        (vectors / root[:, None]) @ np.swapaxes(vectors, 1, 2) * size[:, None]
    )


def _sizes(values: Array) -> Array:
    """(g, d) the scaling that brings diagonals to one; for matrices that need not be
    definite."""
    diagonal = np.abs(
        np.diagonal(
            values,
            axis1=1,
            axis2=2,
        )
    )
    return np.asarray(1.0 / np.sqrt(nonzero_or_one(diagonal)))


def _independent_rows(matrix: Array, rho: Array) -> tuple[Array, Array, float]:
    """An orthogonal change of rows that drops those without content and leaves an upper
    trapezoid.

    Beside rows and right-hand side what no theta reaches, |rho|^2 less that of the new
    right-hand side. By QR with pivoted columns: half the entries of any other choice,
    hence two thirds of the time.
    """
    q, r, pivots = scipy.linalg.qr(
        matrix,
        mode="economic",
        pivoting=True,
        check_finite=False,
    )
    diagonal = np.abs(np.diagonal(r))
    rank = 0
    if diagonal[0] > 0.0:
        rank = int(np.sum(diagonal > 1e-13 * diagonal[0]))
    rows = np.zeros((rank, matrix.shape[1]))
    rows[:, pivots] = r[:rank]
    reduced = q[:, :rank].T @ rho
    missed = rho - q[:, :rank] @ reduced
    return rows, reduced, float(missed @ missed)
