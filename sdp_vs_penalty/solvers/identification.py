"""Identification as a conic problem, and the way back from its solution to parameters and multipliers.

:func:`least_squares_sdp` writes it in the standard form: x = (scaled theta, residual z, ...)
with z = (R theta - rho) / lambda as variables of their own, and theta about a centre. In the bare
quadratic form the large constant rho^T rho sits between the solver and the loss it is to minimise,
and "solved" to 1e-8 of the constant can be percents of the loss.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from sdp_vs_penalty.constraints.constraint import Constraint
from sdp_vs_penalty.regression.regression import nearest_least_squares
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, Solution, svec, unsvec
from sdp_vs_penalty.solvers.objective import Entropy, Objective

#: A unit of a scaled parameter that the data do not see moves no matrix farther than this, in the
#: matrix's size: its bound alone (100 kg, metres) can make columns of a million beside those of one.
_FARTHEST = 100.0
#: A parameter whose largest torque is below this share of the measured one is seen by rounding alone.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Placed:
    """Where a constraint's rows start, and how its cone was scaled: T F T^T (T a matrix) or c * F."""

    constraint: Constraint
    start: int
    scale: Array


@dataclass(frozen=True)
class SdpProblem:
    """An identification problem in conic form with what is needed to read a solution back."""

    conic: ConicProblem
    centre: Array
    theta_scale: Array
    loss_scale: float
    placed: tuple[Placed, ...]
    offset: float = 0.0  # the objective is offset + loss_scale^2 times the conic one
    entropy: Entropy | None = None
    entropy_rows: tuple[int, ...] = ()  # where each link's 8x8 block starts

    def theta(self, solution: Solution) -> Array:
        return self.centre + self.theta_scale * solution.x[: len(self.theta_scale)]

    def entropy_slopes(self, solution: Solution) -> Array | None:
        """(links, 4, 4) the dual's own idea of P(theta)^-1, for a tight bound on -log det."""
        if self.entropy is None:
            return None
        out = []
        for start, p0 in zip(self.entropy_rows, self.entropy.nominal, strict=True):
            block = unsvec(solution.z[start : start + 36], 8)[:4, :4]
            scale = 1.0 / np.sqrt(np.diagonal(p0))
            out.append(block * np.outer(scale, scale) * self.loss_scale**2 / self.entropy.weight)
        return np.array(out)

    def multipliers(self, solution: Solution) -> list[Array]:
        """The dual matrix or vector of each constraint, in the units of loss per F."""
        out = []
        for item in self.placed:
            size = _rows(item.constraint)
            part = solution.z[item.start : item.start + size] * self.loss_scale**2
            if item.constraint.cone == "psd":
                matrix = unsvec(part, len(item.constraint.constant))
                out.append(item.scale.T @ matrix @ item.scale)
            else:
                out.append(item.scale * part)
        return out

    def shares(self, solution: Solution) -> Array:
        """(k,) <z, e> of each constraint's scaled multiplier z: its share of a proof, free of units.

        For :func:`largest_margin` they add up to one where no theta satisfies all constraints.
        """
        out = []
        for item in self.placed:
            z = solution.z[item.start : item.start + _rows(item.constraint)]
            e = item.constraint.identity
            out.append(float(z @ (svec(e) if item.constraint.cone == "psd" else e)))
        return np.array(out)


def least_squares_sdp(
    objective: Objective,
    constraints: Sequence[Constraint],
    reference: Array,
    bound: Array,
    centre: Array | None = None,
    fine: bool = False,
    least_loss: float = 0.0,
) -> SdpProblem:
    """Minimise the objective subject to the constraints, centred and scaled for a solver.

    reference (p,) : a theta inside the constraints, from where each cone is scaled.
    bound (p,) : largest plausible |theta|.
    centre (p,) : theta = centre + scale x; near the optimum nothing cancels. Default: 0.
    fine : a unit of a parameter makes the torque of the residual instead of the whole torque.
    least_loss : what the loss at the optimum is at least about, where the constraints cost far more
        than the unconstrained residual: the objective is a number of size one in that unit.
    """
    data = objective.least_squares
    p = len(bound)
    centre = np.zeros(p) if centre is None else centre
    best = nearest_least_squares(data, centre, bound)
    loss_scale = float(np.sqrt(max(data.loss(best), 1e-12 * data.tau_squared, least_loss, 1e-300)))
    torque = float(np.sqrt(data.tau_squared)) or 1.0
    size = loss_scale if fine else torque
    norms = np.linalg.norm(data.R, axis=0)
    seen = norms * bound > _ROUNDING * torque
    unseen = moving_scale(constraints, reference, bound)
    scale = np.where(seen, np.minimum(bound, size / np.where(seen, norms, 1.0)), unseen)

    rows, rho, out_of_reach = _independent_rows(data.R * scale, data.rho - data.R @ centre)
    r, offset = len(rho), data.residual_norm**2 + out_of_reach
    pieces = _RowBuilder(p + r)
    # R (theta - centre) - lambda z = R (best - centre), up to what no theta reaches
    pieces.dense("zero", np.hstack([rows / loss_scale, -np.eye(r)]), rho / loss_scale)
    placed = []
    for constraint in constraints:
        start, cone_scale = pieces.constraint(constraint, centre, scale, reference)
        placed.append(Placed(constraint, start, cone_scale))
    quadratic = np.concatenate([np.zeros(p), 2.0 * np.ones(r)])
    linear = np.zeros(p + r)
    entropy_rows: tuple[int, ...] = ()
    if objective.entropy is not None:
        entropy_rows, logs = pieces.log_det(objective.entropy, centre, scale)
        offset += _entropy_offset(objective.entropy, centre)
        weight = objective.entropy.weight / loss_scale**2
        for link, p0 in zip(objective.entropy.links, objective.entropy.nominal, strict=True):
            linear[link.indices] += weight * link.adjoint(np.linalg.inv(p0)) * scale[link.indices]
        extra = np.zeros(pieces.width - p - r)
        quadratic = np.concatenate([quadratic, extra])
        linear = np.concatenate([linear, extra])
        linear[logs] = -weight
    conic = pieces.problem(sparse.diags(quadratic).tocsc(), linear)
    return SdpProblem(
        conic, centre, scale, loss_scale, tuple(placed), offset, objective.entropy, entropy_rows
    )


def _entropy_offset(entropy: Entropy, centre: Array) -> float:
    """What of the divergence the conic problem leaves out: its trace at the centre, log det, scaling."""
    total = 0.0
    for link, p0 in zip(entropy.links, entropy.nominal, strict=True):
        sizes = float(np.sum(np.log(np.diagonal(p0))))  # log det_block scales P to D P D, D^-2 = diag P0
        at_centre = float(np.sum(np.linalg.inv(p0) * link.value(centre)))
        total += at_centre + float(np.linalg.slogdet(p0)[1]) - 4.0 - sizes
    return entropy.weight * total


def largest_margin(constraints: Sequence[Constraint], reference: Array, scale: Array) -> SdpProblem:
    """Maximise t <= 1 with every (scaled) F(theta) - t e in its cone: an interior point if t > 0.

    x = (theta / scale, t); t < 0 at the optimum proves that no theta satisfies all constraints.
    """
    p = len(scale)
    pieces = _RowBuilder(p + 1)
    placed = []
    for constraint in constraints:
        start, cone_scale = pieces.constraint(constraint, np.zeros(p), scale, reference, slack=p)
        placed.append(Placed(constraint, start, cone_scale))
    top = np.zeros((1, p + 1))
    top[0, p] = 1.0
    pieces.dense("nonnegative", top, np.ones(1))
    linear = np.zeros(p + 1)
    linear[p] = -1.0
    conic = pieces.problem(sparse.csc_matrix((p + 1, p + 1)), linear)
    return SdpProblem(conic, np.zeros(p), scale, 1.0, tuple(placed))


class _RowBuilder:
    """Collects the rows of A and b cone by cone."""

    def __init__(self, width: int) -> None:
        self.width = width
        self.count = 0
        self.i: list[NDArray[np.intp]] = []
        self.j: list[NDArray[np.intp]] = []
        self.v: list[Array] = []
        self.b: list[Array] = []
        self.cones: list[Cone] = []

    def dense(self, kind: str, matrix: Array, b: Array) -> None:
        i, j = np.nonzero(matrix)
        self._add(i, j, matrix[i, j], b, Cone(kind, len(b)))

    def _add(self, i: ArrayLike, j: ArrayLike, v: ArrayLike, b: Array, cone: Cone) -> None:
        self.i.append(np.asarray(i, np.intp) + self.count)
        self.j.append(np.asarray(j, np.intp))
        self.v.append(np.asarray(v, float))
        self.b.append(b)
        self.cones.append(cone)
        self.count += len(b)

    def constraint(
        self,
        c: Constraint,
        centre: Array,
        theta_scale: Array,
        reference: Array,
        slack: int | None = None,
    ) -> tuple[int, Array]:
        """Append F(theta) [- t e] in its cone; returns the first row and the cone's scaling."""
        at, middle = c.value(reference), c.value(centre)
        local = theta_scale[c.indices]
        start = self.count
        if c.cone == "psd":
            d = len(c.constant)
            scale = _whitening(at) if slack is None else np.diag(_sizes(at))
            constant = svec(scale @ middle @ scale.T)
            columns = svec(scale @ c.coefficients @ scale.T) * local[:, None]
            direction = svec(np.eye(d))
            cone = Cone("psd", d)
        else:
            size = np.abs(c.coefficients * local[:, None]).max(axis=0) + np.abs(c.constant)
            size = np.where(size > 0.0, size, 1.0)
            if c.cone == "soc":
                size = np.full(len(size), size.max())
            scale = 1.0 / size
            constant = middle * scale
            columns = c.coefficients * scale * local[:, None]
            direction = c.identity
            cone = Cone(c.cone, len(constant))
        k, row = np.nonzero(columns)
        i, j, v = row, c.indices[k], -columns[k, row]
        if slack is not None:
            where = np.flatnonzero(direction)
            i = np.concatenate([i, where])
            j = np.concatenate([j, np.full(len(where), slack)])
            v = np.concatenate([v, direction[where]])
        self._add(i, j, v, constant, cone)
        return start, scale

    def log_det(
        self, entropy: Entropy, centre: Array, theta_scale: Array
    ) -> tuple[tuple[int, ...], NDArray[np.intp]]:
        """Append t_k with sum t <= log det P for each link; first rows of the blocks, columns of t.

        log det P >= sum_k log Z_kk where [[P, Z], [Z^T, diag(Z)]] >= 0 and Z is lower triangular.
        """
        lower = [(i, j) for j in range(4) for i in range(j, 4)]
        starts, logs = [], []
        for link, p0 in zip(entropy.links, entropy.nominal, strict=True):
            base, self.width = self.width, self.width + len(lower) + 4
            scale = 1.0 / np.sqrt(np.diagonal(p0))
            twice = np.outer(scale, scale)
            blocks = np.zeros((10 + len(lower), 8, 8))
            blocks[:10, :4, :4] = link.coefficients * twice
            blocks[:10] *= theta_scale[link.indices][:, None, None]
            for k, (i, j) in enumerate(lower):
                blocks[10 + k, i, 4 + j] = blocks[10 + k, 4 + j, i] = 1.0
                if i == j:
                    blocks[10 + k, 4 + i, 4 + i] = 1.0
            constant = np.zeros((8, 8))
            constant[:4, :4] = link.value(centre) * twice
            columns = svec(blocks)
            variables = np.concatenate([link.indices, base + np.arange(len(lower))])
            entry, row = np.nonzero(columns)
            starts.append(self.count)
            self._add(row, variables[entry], -columns[entry, row], svec(constant), Cone("psd", 8))
            for d in range(4):
                diagonal, log = base + lower.index((d, d)), base + len(lower) + d
                logs.append(log)
                # exp(t) <= Z_dd
                self._add(
                    np.array([0, 2]),
                    np.array([log, diagonal]),
                    np.array([-1.0, -1.0]),
                    np.array([0.0, 1.0, 0.0]),
                    Cone("exp", 3),
                )
        return tuple(starts), np.array(logs)

    def problem(self, quadratic: sparse.csc_matrix, linear: Array) -> ConicProblem:
        i, j, v = (np.concatenate(x) for x in (self.i, self.j, self.v))
        matrix = sparse.csc_matrix((v, (i, j)), shape=(self.count, self.width))
        return ConicProblem(
            sparse.csc_matrix(quadratic), linear, matrix, np.concatenate(self.b), tuple(self.cones)
        )


def moving_scale(constraints: Sequence[Constraint], reference: Array, bound: Array) -> Array:
    """(p,) units of theta, at most ``bound``, that move no matrix far in its size at the reference."""
    moves = np.zeros(len(bound))
    for c in constraints:
        if c.cone == "psd":
            t = _whitening(c.value(reference))
            size = np.linalg.norm(t @ c.coefficients @ t.T, axis=(1, 2))
            moves[c.indices] = np.maximum(moves[c.indices], size)
    return np.asarray(_FARTHEST / np.maximum(moves, _FARTHEST / bound))


def _whitening(value: Array) -> Array:
    """T (d, d) with T F T^T = 1 for a positive definite F: the cone as seen from a point inside it.

    A link's matrix has its mass in one corner and moments of a thousandth in the others, coupled by
    a centre of mass many times its thickness away; a solver that sees it as the identity gains one
    to two digits of the certified gap. Directions in which F is singular are stretched at most 1e3
    times.
    """
    size = _sizes(value)
    eigenvalues, vectors = np.linalg.eigh(value * np.outer(size, size))
    root = np.sqrt(np.maximum(eigenvalues, 1e-6)) if eigenvalues[-1] > 0.0 else np.ones(len(value))
    return np.asarray((vectors / root) @ vectors.T * size)


def _sizes(value: Array) -> Array:
    """(d,) the scaling that brings the diagonal to one; for a matrix that need not be definite."""
    diagonal = np.abs(np.diagonal(value))
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)))


def _rows(constraint: Constraint) -> int:
    size = len(constraint.constant)
    return size * (size + 1) // 2 if constraint.cone == "psd" else size


def _independent_rows(matrix: Array, rho: Array) -> tuple[Array, Array, float]:
    """An orthogonal change of rows that drops those without content and leaves an upper trapezoid.

    Beside rows and right-hand side what no theta reaches, |rho|^2 less that of the new right-hand side.
    By QR with pivoted columns: half the entries of any other choice, hence two thirds of the time.
    """
    if matrix.size == 0:
        return np.zeros((0, matrix.shape[1])), np.zeros(0), float(rho @ rho)
    q, r, pivots = scipy.linalg.qr(matrix, mode="economic", pivoting=True, check_finite=False)
    diagonal = np.abs(np.diagonal(r))
    rank = int(np.sum(diagonal > 1e-13 * diagonal[0])) if diagonal[0] > 0.0 else 0
    rows = np.zeros((rank, matrix.shape[1]))
    rows[:, pivots] = r[:rank]
    kept = q[:, :rank].T @ rho
    missed = rho - q[:, :rank] @ kept
    return rows, kept, float(missed @ missed)
