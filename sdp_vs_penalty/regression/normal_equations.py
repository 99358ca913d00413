"""Normal equations of the joints' rows, in which each joint has columns of its own.

The columns that only one joint has (its friction, its rotor, its offset) are projected
out of that joint's rows. What remains adds: over the parts of a log, over several logs,
and over joints, each weighted by its own residual. A part is left out by subtraction.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from sdp_vs_penalty.robot.arrays import Array, Mask

#: Weighted normal equations (..., s, s), (..., s).
Normal: TypeAlias = tuple[Array, Array]

#: Relative ridge: directions that the motion does not excite stay quiet.
RIDGE = 1e-9
#: A residual below 0.3 % of the torque is explained: friction laws and filters are no
#: better.
FLOOR = 1e-5
#: Rounds of reweighting each joint by its own residual.
ROUNDS = 3


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations of n joints' rows, of one log or of several (..., n), with own
    columns projected out."""

    #: (..., n, s, s) products of the s columns that joints share.
    gram: Array
    #: (..., n, s) products of these columns with the torque.
    cross: Array
    #: (..., n) squared torque after own columns are projected out.
    energy: Array
    #: (..., n) squared torque before.
    total: Array
    #: (..., n, k, s + 1) what the k own columns take of the shared ones and of the
    #: torque.
    own_solution: Array = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def eliminating(cls, full: Array, n_own: int) -> NormalEquations:
        """Eliminate each joint's own columns (those that no other joint has).

        The Gram matrix [[A, B], [B^T, C]] of own and other columns becomes that of the
        residuals after least squares in the own columns, C - B^T A^-1 B.

        Parameters
        ----------
        full : (..., n, w, w) array
            Gram matrices of n joints: own columns, shared columns, and the torque last.
        """
        # Blocks of the Gram matrix: A of own columns, B own by others, B^T.
        own = full[..., :n_own, :n_own]
        own_by_others = full[..., :n_own, n_own:]
        others_by_own = full[..., n_own:, :n_own]
        # A ridge, for joints that rest in these rows: their own columns are zero.
        mean_square = np.trace(own, axis1=-2, axis2=-1) / max(n_own, 1)
        ridge = np.maximum(1e-6 * mean_square, 1e-280)
        own = own + ridge[..., None, None] * np.eye(n_own)
        own_solution = np.linalg.solve(own, own_by_others)
        # Schur complement C - B^T A^-1 B: the Gram matrix of the residuals.
        remaining = full[..., n_own:, n_own:] - others_by_own @ own_solution
        energy = remaining[..., -1, -1]  # squared torque; the torque is the last column
        return cls(
            gram=remaining[..., :-1, :-1],
            cross=remaining[..., :-1, -1],
            energy=np.maximum(energy, 0.0),
            total=positive(full[..., -1, -1]),
            own_solution=own_solution,
        )

    def left_of(self, full: Array, theta: Array) -> Array:
        """Return the squared residuals of given parameters in other rows.

        The joints' own parameters are those that fit best in the rows of this object.

        Parameters
        ----------
        full : (..., n, w, w) array
            Gram matrices of these rows.
        theta : (..., n, s) array
            Shared parameters, joint by joint.

        Returns
        -------
        (..., n) array
            Squared residual of each joint.
        """
        # v = (own, theta, -1): v^T G v is the squared residual.
        torque = -np.ones((*theta.shape[:-1], 1))
        shared = np.append(theta, torque, axis=-1)[..., None]
        own = -self.own_solution @ shared
        shape = (*full.shape[:-2], *shared.shape[-2:])
        v = np.concatenate([own, np.broadcast_to(shared, shape)], axis=-2)
        return np.sum(v * (full @ v), axis=(-2, -1))

    def normal(self, weights: Array) -> Normal:
        """Return the sum of the joints' normal equations with weights (..., n): Gram
        matrix (..., s, s) and right side (..., s)."""
        s = self.gram.shape[-1]
        leading_shape = self.gram.shape[:-2]
        flat = self.gram.reshape(*leading_shape, s * s)
        gram = weights[..., None, :] @ flat
        cross = np.einsum("...j,...js->...s", weights, self.cross)
        return gram.reshape(*gram.shape[:-2], s, s), cross

    def fitted(self, chosen: Mask) -> tuple[Array, Array]:
        """Fit the shared parameters of the joints that ``chosen`` (n,) flags, each
        joint weighted by its inverse squared residual.

        The weights depend on the fit: ROUNDS rounds settle them.

        Returns
        -------
        theta : (..., s) array
            Shared parameters of largest likelihood.
        left : (..., n) array
            Squared residuals, at least FLOOR of the squared torque.
        """
        residuals = self.total
        for _ in range(ROUNDS):
            gram, cross = self.normal(chosen / residuals)
            theta = solve(gram, cross[..., None])[..., 0]
            # Of each joint j: |tau|^2 - 2 theta^T cross + theta^T gram theta.
            column = theta[..., None, :, None]
            image = (self.gram @ column)[..., 0]
            change = np.einsum("...js,...s->...j", image - 2.0 * self.cross, theta)
            residuals = np.maximum(self.energy + change, FLOOR * self.total)
        return theta, residuals


def solve(gram: Array, right: Array) -> Array:
    """Solve (G + ridge) X = B for X (..., s, r), with G (..., s, s) positive
    semidefinite and its columns scaled to one; X is zero for columns that are zero."""
    squares = np.diagonal(gram, axis1=-2, axis2=-1)
    norms = np.sqrt(np.maximum(squares, 0.0))
    largest = norms.max(axis=-1, keepdims=True, initial=0.0)
    is_nonzero = norms > 1e-9 * largest
    safe_norms = np.where(is_nonzero, norms, 1.0)
    scale = np.where(is_nonzero, 1.0 / safe_norms, 0.0)[..., None]
    unit = scale * gram * np.swapaxes(scale, -1, -2)
    diagonal = np.einsum("...ii->...i", unit)  # a writable view
    # Zero columns get a one, so that their solution is zero.
    diagonal += np.where(is_nonzero, RIDGE, 1.0)
    solution = np.linalg.solve(unit, scale * right)
    return scale * solution


def positive(energy: Array) -> Array:
    """Raise energies (..., n) (squared torques) that are zero to a tiny positive
    number, 1e-12 of the largest joint's."""
    largest = energy.max(axis=-1, keepdims=True, initial=0.0)
    return np.maximum(energy, 1e-12 * largest + 1e-280)
