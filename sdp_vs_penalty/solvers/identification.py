"""Identification as a conic problem, and the way back from its solution to parameters and multipliers.

:func:`least_squares_sdp` writes it in the standard form: x = (scaled theta, residual z, ...)
with z = (R theta - rho) / lambda as variables of their own, and theta about a centre. In the bare
quadratic form the large constant rho^T rho sits between the solver and the loss it is to minimise,
and "solved" to 1e-8 of the constant can be percents of the loss.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from sdp_vs_penalty.robot.arrays import Array, or_one
from sdp_vs_penalty.robot.constraint import Alike, Constraint, alike
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

    @property
    def rows(self) -> slice:
        cone = Cone(self.constraint.cone, len(self.constraint.constant))
        return slice(self.start, self.start + cone.rows)


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

    def multipliers(self, solution: Solution) -> dict[Constraint, Array]:
        """The dual matrix or vector of each constraint, in the units of loss per F."""
        out = {}
        for item in self.placed:
            c, part = item.constraint, solution.z[item.rows] * self.loss_scale**2
            psd = c.cone == "psd"
            out[c] = (
                item.scale.T @ unsvec(part, len(c.constant)) @ item.scale if psd else item.scale * part
            )
        return out

    def shares(self, solution: Solution) -> Array:
        """(k,) <z, e> of each constraint's scaled multiplier z: its share of a proof, free of units.

        For :func:`largest_margin` they add up to one where no theta satisfies all constraints.
        """
        out = []
        for item in self.placed:
            z, e = solution.z[item.rows], item.constraint.identity
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
    torque = float(np.sqrt(data.tau_squared)) or 1.0
    norms = np.linalg.norm(data.R, axis=0)
    seen = norms * bound > _ROUNDING * torque
    unit = np.where(
        seen, torque / np.where(seen, norms, 1.0), moving_scale(constraints, reference, bound)
    )
    rows, rho, out_of_reach = _independent_rows(data.R * unit, data.rho - data.R @ centre)
    r, offset = len(rho), data.residual_norm**2 + out_of_reach
    loss_scale = float(np.sqrt(max(offset, 1e-12 * data.tau_squared, least_loss))) or 1.0
    finer = loss_scale / torque if fine else 1.0
    scale = np.where(seen, np.minimum(bound, finer * unit), unit)
    rows *= scale / unit
    pieces = RowBuilder(p + r)
    # R (theta - centre) - lambda z = R (best - centre), up to what no theta reaches
    pieces.rows("zero", np.hstack([rows / loss_scale, -np.eye(r)]), rho / loss_scale)
    placed = pieces.constraints(constraints, centre, scale, reference)
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
    return SdpProblem(conic, centre, scale, loss_scale, placed, offset, objective.entropy, entropy_rows)


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
    pieces = RowBuilder(p + 1)
    placed = pieces.constraints(constraints, np.zeros(p), scale, reference, slack=p)
    top = np.zeros((1, p + 1))
    top[0, p] = 1.0
    pieces.rows("nonnegative", top, np.ones(1))
    linear = np.zeros(p + 1)
    linear[p] = -1.0
    conic = pieces.problem(sparse.csc_matrix((p + 1, p + 1)), linear)
    return SdpProblem(conic, np.zeros(p), scale, 1.0, placed)


class RowBuilder:
    """Collects the rows of A and b cone by cone."""

    def __init__(self, width: int) -> None:
        self.width = width
        self.count = 0
        self.i: list[NDArray[np.intp]] = []
        self.j: list[NDArray[np.intp]] = []
        self.v: list[Array] = []
        self.b: list[Array] = []
        self.cones: list[Cone] = []

    def rows(self, kind: str, matrix: Array | sparse.csr_matrix, b: Array) -> None:
        """Append rows of one of the cones that are no matrices."""
        entries = sparse.coo_matrix(matrix)
        self._add(entries.row, entries.col, entries.data, b, Cone(kind, len(b)))

    def place(
        self, c: Constraint, scale: Array, constant: Array, columns: Array, slack: int | None = None
    ) -> Placed:
        """Append F(theta) [- t e], constant + sum theta_k columns_k, in its cone."""
        k, row = np.nonzero(columns)
        i, j, v = row, c.indices[k], -columns[k, row]
        if slack is not None:
            direction = svec(c.identity) if c.cone == "psd" else c.identity
            where = np.flatnonzero(direction)
            i = np.concatenate([i, where])
            j = np.concatenate([j, np.full(len(where), slack)])
            v = np.concatenate([v, direction[where]])
        placed = Placed(c, self.count, scale)
        self._add(i, j, v, constant, Cone(c.cone, len(c.constant)))
        return placed

    def _add(self, i: ArrayLike, j: ArrayLike, v: ArrayLike, b: Array, cone: Cone) -> None:
        self.i.append(np.asarray(i, np.intp) + self.count)
        self.j.append(np.asarray(j, np.intp))
        self.v.append(np.asarray(v, float))
        self.b.append(b)
        self.cones.append(cone)
        self.count += len(b)

    def constraints(
        self,
        constraints: Sequence[Constraint],
        centre: Array,
        theta_scale: Array,
        reference: Array,
        slack: int | None = None,
    ) -> tuple[Placed, ...]:
        """Append each F(theta) [- t e] in its cone."""
        at = [c.value(reference) for c in constraints]
        middle = at if np.array_equal(centre, reference) else [c.value(centre) for c in constraints]
        scaled: list[tuple[Array, Array, Array]] = [()] * len(constraints)  # type: ignore[list-item]
        for group in alike(constraints):
            around, central = (np.array([x[k] for k in group.places]) for x in (at, middle))
            made = _scaled(group, theta_scale, around, central, whiten=slack is None)
            for place, *one in zip(group.places.tolist(), *made, strict=True):
                scaled[place] = (one[0], one[1], one[2])
        pairs = zip(constraints, scaled, strict=True)
        return tuple(self.place(c, *made, slack=slack) for c, made in pairs)

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


def _scaled(
    group: Alike, theta_scale: Array, at: Array, middle: Array, whiten: bool
) -> tuple[Array, Array, Array]:
    """Of each constraint the cone's scaling (:class:`Placed`), F(centre) and the columns, scaled.

    at, middle (g, ...) : F at the reference, from which matrices are seen, and at the centre.
    """
    local = theta_scale[group.indices]
    if group.cone == "psd":
        scale = _whitening(at) if whiten else _sizes(at)[:, :, None] * np.eye(at.shape[-1])
        turned = np.swapaxes(scale, 1, 2)
        columns = svec(scale[:, None] @ group.coefficients @ turned[:, None]) * local[:, :, None]
        return scale, svec(scale @ middle @ turned), columns
    size = np.abs(group.coefficients * local[:, :, None]).max(axis=1) + np.abs(group.constant)
    size = or_one(size)
    if group.cone == "soc":
        size = np.repeat(size.max(axis=1, keepdims=True), size.shape[1], axis=1)
    scale = 1.0 / size
    return scale, middle * scale, group.coefficients * scale[:, None] * local[:, :, None]


def moving_scale(constraints: Sequence[Constraint], reference: Array, bound: Array) -> Array:
    """(p,) units of theta, at most ``bound``, that move no matrix far in its size at the reference."""
    moves = np.zeros(len(bound))
    matrices = [c for c in constraints if c.cone == "psd"]
    for group in alike(matrices):
        t = _whitening(np.array([matrices[k].value(reference) for k in group.places]))[:, None]
        size = np.linalg.norm(t @ group.coefficients @ np.swapaxes(t, 2, 3), axis=(2, 3))
        np.maximum.at(moves, group.indices, size)
    return np.asarray(_FARTHEST / np.maximum(moves, _FARTHEST / bound))


def _whitening(values: Array) -> Array:
    """T (g, d, d) with T F T^T = 1 for positive definite F: the cones as seen from points inside them.

    A link's matrix has its mass in one corner and moments of a thousandth in the others, coupled by
    a centre of mass many times its thickness away; a solver that sees it as the identity gains one
    to two digits of the certified gap. Directions in which F is singular are stretched at most 1e3
    times.
    """
    size = _sizes(values)
    eigenvalues, vectors = np.linalg.eigh(values * (size[:, :, None] * size[:, None]))
    root = np.where(eigenvalues[:, -1:] > 0.0, np.sqrt(np.maximum(eigenvalues, 1e-6)), 1.0)
    return np.asarray((vectors / root[:, None]) @ np.swapaxes(vectors, 1, 2) * size[:, None])


def _sizes(values: Array) -> Array:
    """(g, d) the scaling that brings diagonals to one; for matrices that need not be definite."""
    diagonal = np.abs(np.diagonal(values, axis1=1, axis2=2))
    return np.asarray(1.0 / np.sqrt(or_one(diagonal)))


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
