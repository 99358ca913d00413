"""The default solver of identification SDPs: a primal-dual interior-point method in
NumPy.

    minimise |R theta - rho|^2 + l^T theta - sum_b w_b log det F_b(theta)
    subject to F_b(theta) >= 0 (matrices of order at most four), A theta + c >= 0

It follows the central path S Z = max(w, mu) 1 of slacks S = F(theta) and multipliers Z
in the HKM direction (Helmberg, Rendl, Vanderbei, Wolkowicz, SIAM J. Optim. 1996) with
Mehrotra's predictor and corrector (SIAM J. Optim. 1992). A matrix with a log det is a
cone whose complementarity goes to w instead of 0. theta stays inside of all cones; only
the slope R^T(...) - F*(Z) starts above zero. A step is one Cholesky factor of 2 R^T R +
sum F_i^* (S^-1 . Z) F_j (p, p); all small cones are worked on at once, as arrays
(blocks, 4, 4). What it returns is certified by others (:mod:`fit`).
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import scipy

from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.solvers.small_cones import ORDER, SmallCones

#: Complementarity of a cold start as a share of its objective. 1 to 1e-4 differ by two
#: steps of ten.
_COLD = 1e-3
#: A start for similar data: the last iterate whose relative gap was above this.
_CENTRAL = 1e-2
#: A step goes this share of the way to the boundary, more where the predictor came near
#: the optimum.
_SHARE = 0.9
#: Relative change of H's diagonal: what rounding in H may cost its positive
#: definiteness.
_RIDGE = 1e-14
#: A shorter step cannot be told from rounding.
_SHORTEST = float(np.sqrt(np.finfo(float).eps))


@dataclass(frozen=True)
class Iterate:
    """A point of the primal-dual method, strictly inside."""

    #: (p,) parameters, strictly inside the constraints.
    theta: Array
    #: (rows + 16 blocks,) multipliers, strictly inside of their cones.
    multipliers: Array


@dataclass(frozen=True)
class Optimum(Iterate):
    """Where the method ends."""

    #: Number of iterations.
    iterations: int
    #: Gap and leftover slope as the method itself sees them, relative to the loss.
    error: float
    #: An iterate from which to start for similar data.
    central: Iterate


def minimise(
    cones: SmallCones,
    data: LeastSquares,
    starts: Sequence[Array | Iterate],
    accuracy: float,
) -> Optimum | None:
    """Minimise a sum of squares over small cones by an interior-point method.

    Starts at the first of ``starts`` that lies strictly inside the cones and whose
    system of equations can be factorised.

    Parameters
    ----------
    starts : sequence
        Points theta (p,), or iterates of an earlier run.
    accuracy : float
        Largest cost of gap and dual residual, as a share of the loss.

    Returns
    -------
    Optimum or None
        Best iterate, even if its accuracy is worse; None without such a start.
    """
    for start in starts:
        with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
            if solved := _InteriorPoint(cones, data, start).solve(accuracy):
                return solved
    return None


class _InteriorPoint:
    """The iterate on its way, and what one step needs of it.

    Slacks S and multipliers Z are flat arrays (rows + 16 blocks,), ``slacks`` and
    ``multipliers``, the two rows of one array ``pair``. ``rows`` (2, rows) and ``blocks``
    (2, blocks, 4, 4) are views of it. ``change`` is the change of ``pair`` in a step, and
    ``target`` where Z is to move.
    """

    def __init__(
        self, cones: SmallCones, data: LeastSquares, start: Array | Iterate
    ) -> None:
        """Start the interior-point method at slacks S and multipliers Z inside the
        cones.

        S = constant + slack_map theta. A start without multipliers gets those on the
        central path (:meth:`central_multipliers`). Raises LinAlgError unless the start
        is strictly inside.
        """
        self.cones = cones
        self.data = data
        self.pair = np.empty((2, len(cones.constant)))
        self.slacks, self.multipliers = self.pair
        self.rows, self.blocks = self._views(self.pair)
        #: (blocks, 1, 1) weight w of each block's -log det in the objective.
        self.weight = cones.weight[:, None, None]
        self.degree = max(cones.rows + ORDER * len(cones.weight), 1)
        self.weighted_logs = float(cones.weight @ np.log(nonzero_or_one(cones.weight)))
        self.theta = start.theta if isinstance(start, Iterate) else start
        self.slacks[:] = cones.constant + cones.slack_map @ self.theta
        np.linalg.cholesky(self.blocks[0])  # raises unless positive definite
        if isinstance(start, Iterate):
            self.multipliers[:] = start.multipliers
        else:
            self.evaluate_objective()
            # Complementarity of each cone: a small share of the objective.
            mu = _COLD * abs(self.value) / self.degree or 1.0
            self.inverse = np.linalg.inv(self.blocks[0])
            self.multipliers[:] = self.central_multipliers(mu)
        is_inside = bool(np.all(self.rows[0] > 0.0))
        if not is_inside or not np.all(np.isfinite(self.pair)):
            raise np.linalg.LinAlgError

    def _views(self, flat: Array) -> tuple[Array, Array]:
        """Return views of flat slacks or multipliers (k, rows + 16 blocks).

        The first has the rows (k, rows), the second the blocks (k, blocks, 4, 4).
        """
        split = self.cones.rows
        blocks = flat[:, split:].reshape(len(flat), -1, ORDER, ORDER)
        return flat[:, :split], blocks

    def evaluate_objective(self) -> None:
        """Set loss, value and gradient (p,) of the objective without its logarithms,
        |R theta - rho|^2 + l^T theta."""
        data = self.data
        linear = self.cones.linear
        residual = data.R @ self.theta - data.rho
        self.loss = float(residual @ residual) + data.residual_norm**2
        self.value = self.loss + float(linear @ self.theta)
        self.gradient = 2.0 * (residual @ data.R) + linear

    def solve(self, accuracy: float) -> Optimum | None:
        """Iterate until the error is at most ``accuracy`` or no step helps.

        Returns the best iterate, with the last central one as a start for similar data;
        None if nothing could be factorised.
        """
        best: Optimum | None = None
        central = self.iterate()
        n_steps = 60  # twice what the slowest of the shootout's instances needs
        for k in range(n_steps):
            try:
                error = self.factorize()
            except np.linalg.LinAlgError:
                break
            iterate = self.iterate()
            if error > _CENTRAL:
                central = iterate
            if best is None or error < best.error:
                final = iterate if error > accuracy else self.polished()
                best = Optimum(
                    final.theta,
                    final.multipliers,
                    iterations=k,
                    error=error,
                    central=central,
                )
            if error <= accuracy or not self.advance():
                break
        return best

    def iterate(self) -> Iterate:
        """Return a copy of the present iterate."""
        return Iterate(self.theta, self.multipliers.copy())

    def factorize(self) -> float:
        """Factorise the Newton system, and solve it for predictor and correction.

        Sets ``step`` (p,), the predictor (a Newton step towards complementarity zero),
        and ``correction`` (p,), the Newton step that removes the dual residual (gradient
        - adjoint of Z). Returns the error: duality gap plus the cost of the dual
        residual, over the loss.
        """
        cones = self.cones
        # S = L L^T and Z likewise, (2, blocks, 4, 4): L, L^-1, L^-T, and S^-1.
        self.factors = np.linalg.cholesky(self.blocks)
        self.roots = np.linalg.inv(self.factors)
        self.roots_transposed = np.swapaxes(self.roots, -1, -2)
        self.inverse = self.roots_transposed[0] @ self.roots[0]
        self.evaluate_objective()
        self._factorize_hessian()
        # Both by one pair of triangular solves.
        dual_residual = self.gradient - cones.adjoint @ self.multipliers
        self.target = self.central_multipliers(0.0)
        towards_target = cones.adjoint @ self.target - self.gradient
        right_sides = np.array([towards_target, dual_residual])
        solutions, _ = scipy.linalg.lapack.dpotrs(self.cholesky, right_sides.T, lower=1)
        self.step, self.correction = solutions.T
        # Half the square of Newton's decrement: the cost of the dual residual.
        cost = 0.5 * float(dual_residual @ self.correction)
        # The loss, or rounding of it where a model explains all; 1 without torque.
        scale = max(self.loss, 1e-12 * self.data.tau_squared) or 1.0
        error = float((max(self._duality_gap(), 0.0) + max(cost, 0.0)) / scale)
        return error if math.isfinite(error) else math.inf

    def _factorize_hessian(self) -> None:
        """Set ``cholesky``, the lower factor (p, p) of H = 2 R^T R + curvature of the
        cones: z / s of the rows, Kronecker products of S^-1 and Z of the blocks. Raises
        LinAlgError unless H is positive definite."""
        cones = self.cones
        kronecker = self.inverse[:, :, :, None, None] * self.blocks[1][:, None, None]
        products = np.concatenate([self.rows[1] / self.rows[0], kronecker.ravel()])
        H = self.data.curvature.copy()
        flat = H.ravel()
        flat[cones.places] += cones.curvature @ products
        flat[:: len(H) + 1] *= 1.0 + _RIDGE  # the diagonal
        self.cholesky, failed = scipy.linalg.lapack.dpotrf(
            H.T, lower=1, overwrite_a=1, clean=0
        )
        if failed:
            raise np.linalg.LinAlgError

    def _duality_gap(self) -> float:
        """Return <S, Z> - sum w (4 + log det S Z - 4 log w) over the blocks."""
        weight = self.cones.weight
        products = float(self.slacks @ self.multipliers)
        diagonals = np.diagonal(self.factors, axis1=-2, axis2=-1)
        log_roots = np.log(diagonals).sum(axis=(0, 2))  # half the log det of S Z
        gap = products - ORDER * float(weight.sum())
        return gap - (2.0 * float(weight @ log_roots) - ORDER * self.weighted_logs)

    def central_multipliers(self, mu: float) -> Array:
        """Return the multipliers Z, flat, that the central path has at S for a
        complementarity mu.

        Rows: z = mu / s. Blocks: Z = max(w, mu) S^-1, with w the weight of -log det S
        in the objective, for which Z = w S^-1 is optimal.
        """
        blocks = np.maximum(self.weight, mu) * self.inverse
        return np.concatenate([mu / self.rows[0], blocks.ravel()])

    def multiplier_response(self, dS: Array, Z: Array) -> Array:
        """Return by how much multipliers fall, at fixed complementarity, as slacks rise by
        dS: ds z / s of rows, the symmetric part of S^-1 dS Z of blocks.

        With the change of Z in place of Z it is the second-order term. dS, Z and the
        result are flat.
        """
        rows, blocks = self._views(np.array([dS, Z]))
        product = self.inverse @ blocks[0] @ blocks[1]
        symmetric = 0.5 * (product + np.swapaxes(product, -1, -2))
        return np.concatenate([rows[0] * rows[1] / self.rows[0], symmetric.ravel()])

    def set_direction(self, step: Array, second_order: Array | float) -> float:
        """Set ``change``, those of S and Z for a step (p,) of theta, and return the
        longest multiple of it that stays inside the cones.

        Z moves to ``target``, less the ``second_order`` term (rows + 16 blocks,) of the
        predictor.
        """
        dS = self.cones.slack_map @ step
        Z = self.multipliers
        dZ = self.target - Z - second_order - self.multiplier_response(dS, Z)
        self.change = np.array([dS, dZ])
        rows, blocks = self._views(self.change)
        # The most negative relative change; -1 / smallest is the way to the boundary.
        smallest = (rows / self.rows).min(initial=-1e-12)
        relative = self.roots @ blocks @ self.roots_transposed
        # A norm, which bounds eigenvalues, of less than _SHARE allows the whole step.
        could_matter = np.einsum("kbij,kbij->kb", relative, relative) > _SHARE**2
        eigenvalues = np.linalg.eigvalsh(relative[could_matter])
        return -1.0 / float(eigenvalues.min(initial=smallest))

    def complementarity(self, pair: Array) -> float:
        """Return <S, Z> over all cones, less what the weights of log det ask for; ``pair``
        (2, rows + 16 blocks) holds S and Z."""
        rows, blocks = self._views(pair)
        # <S, Z> of each block b; on the central path of w log det it is 4 w.
        products = np.einsum("bij,bij->b", blocks[0], blocks[1])
        by_block = products - ORDER * self.cones.weight
        return float(rows[0] @ rows[1] + np.abs(by_block).sum())

    def advance(self) -> bool:
        """Make one predictor-corrector step (Mehrotra) of theta, slacks S and
        multipliers Z.

        1. The predictor shows how far one can go and how much complementarity <S, Z>
        that leaves. 2. The corrector aims at that share of it, with the predictor's
        second-order term. Returns False if hardly any step is possible.
        """
        cones = self.cones
        reach = min(1.0, 0.999 * self.set_direction(self.step, 0.0))
        before = self.complementarity(self.pair)
        after = self.complementarity(self.pair + reach * self.change)
        remaining = after / (before or 1.0)
        # Mehrotra's heuristic: the better the predictor, the less centring.
        centring = min(max(remaining ** max(1.0, 3.0 * reach**2), 1e-7), 1.0)
        second_order = self.multiplier_response(*self.change)
        self.target = self.central_multipliers(centring * before / self.degree)
        right_side = cones.adjoint @ (self.target - second_order) - self.gradient
        step = scipy.linalg.lapack.dpotrs(self.cholesky, right_side, lower=1)[0]
        longest = self.set_direction(step, second_order)
        share = min(1.0, (_SHARE + (0.999 - _SHARE) * reach**2) * longest)
        if not share > _SHORTEST:  # NaN, too, ends the iteration
            return False
        self.theta = self.theta + share * step
        self.multipliers += share * self.change[1]
        self.slacks[:] = cones.constant + cones.slack_map @ self.theta
        return bool(np.all(self.rows[0] > 0.0))

    def polished(self) -> Iterate:
        """Return the iterate after the Newton step ``correction``, which leaves no dual
        residual.

        If that leaves the cones (rows > 0, blocks positive definite), the present
        iterate is returned.
        """
        dS = self.cones.slack_map @ -self.correction
        multipliers = self.multipliers - self.multiplier_response(dS, self.multipliers)
        moved = np.array([self.slacks + dS, multipliers])
        rows, blocks = self._views(moved)
        with suppress(np.linalg.LinAlgError):
            np.linalg.cholesky(blocks)  # raises unless positive definite
            if np.all(rows > 0.0):
                return Iterate(self.theta - self.correction, multipliers)
        return self.iterate()
