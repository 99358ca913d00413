"""Normal equations of the joints' rows, in which each joint has columns of its own.

The columns that only one joint has (its friction, its rotor, its offset) are projected
out of that joint's rows. What remains adds: over the parts of a log, over several logs,
and over joints, each weighted by its own residual. A part is left out by subtraction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.robot.arrays import Array

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
    """Of n joints' rows, of one log or of several (..., n).

    gram (..., n, s, s), cross (..., n, s) : of the columns that joints share, with own
    columns projected out; energy, total (..., n) : squared torque after and before;
    own_solution (..., n, k, s + 1) : what the k own columns take of the shared ones and
    of the torque.
    """

    gram: Array
    cross: Array
    energy: Array
    total: Array
    own_solution: Array = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, full: Array, n_own: int) -> NormalEquations:
        """From Gram matrices (..., n, w, w) of own columns, shared ones, and the torque
        as the last."""
        own = full[..., :n_own, :n_own]
        size = np.trace(own, axis1=-2, axis2=-1)[..., None, None] / max(n_own, 1)
        # A joint that rests in these rows has nothing of its own there.
        own = own + np.maximum(1e-6 * size, 1e-280) * np.eye(n_own)
        own_solution = np.linalg.solve(own, full[..., :n_own, n_own:])
        left = full[..., n_own:, n_own:] - full[..., n_own:, :n_own] @ own_solution
        return cls(
            gram=left[..., :-1, :-1],
            cross=left[..., :-1, -1],
            energy=np.maximum(left[..., -1, -1], 0.0),
            total=positive(full[..., -1, -1]),
            own_solution=own_solution,
        )

    @classmethod
    def together(cls, logs: Sequence[NormalEquations]) -> NormalEquations:
        """The joints of several logs (1, n, ...) next to each other, to fit one arm to
        them."""

        def join(name: str) -> Array:
            return np.concatenate([getattr(log, name) for log in logs], axis=1)

        return cls(join("gram"), join("cross"), join("energy"), join("total"))

    def left_of(self, full: Array, theta: Array) -> Array:
        """(..., n) squared residuals in rows with such Gram matrices (..., n, w, w),
        under each joint's parameters (..., n, s) and the own ones that go with them."""
        torque = -np.ones((*theta.shape[:-1], 1))
        shared = np.append(theta, torque, axis=-1)[..., None]
        own = -self.own_solution @ shared
        shared = np.broadcast_to(shared, (*full.shape[:-2], *shared.shape[-2:]))
        vector = np.concatenate([own, shared], axis=-2)
        return np.asarray(np.sum(vector * (full @ vector), axis=(-2, -1)))

    def normal(self, weights: Array) -> Normal:
        """(..., s, s) and (..., s) : sums over joints of such weights (..., n)."""
        s = self.gram.shape[-1]
        flat = self.gram.reshape(*self.gram.shape[:-2], s * s)
        gram = weights[..., None, :] @ flat
        cross = np.einsum("...j,...js->...s", weights, self.cross)
        return gram.reshape(*gram.shape[:-2], s, s), cross

    def fitted(self, chosen: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Fit one arm, each joint weighted by its own residual.

        Parameters
        ----------
        chosen : (n,) array
            Which joints move.

        Returns
        -------
        theta : (..., s) array
            The shared parameters of largest likelihood.
        left : (..., n) array
            Squared residuals there, at least FLOOR of the whole.
        """
        left = self.total
        for _ in range(ROUNDS):
            gram, cross = self.normal(chosen / left)
            theta = solve(gram, cross[..., None])[..., 0]
            image = (self.gram @ theta[..., None, :, None])[..., 0]
            fall = np.einsum("...js,...s->...j", image - 2.0 * self.cross, theta)
            left = np.maximum(self.energy + fall, FLOOR * self.total)
        return theta, left


def solve(gram: Array, right: Array) -> Array:
    """(G + ridge)^-1 B with columns of G scaled to one; zero for those that are not
    there.

    Parameters
    ----------
    gram : (..., s, s) array
        G.
    right : (..., s, r) array
        B.

    Returns
    -------
    (..., s, r) array
        The solutions.
    """
    norms = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 0.0))
    is_there = norms > 1e-9 * norms.max(axis=-1, keepdims=True, initial=0.0)
    scale = np.where(is_there, 1.0 / np.where(is_there, norms, 1.0), 0.0)[..., None]
    unit = scale * gram * np.swapaxes(scale, -1, -2)
    np.einsum("...ii->...i", unit)[...] += np.where(is_there, RIDGE, 1.0)
    return np.asarray(scale * np.linalg.solve(unit, scale * right))


def jackknifed(estimates: Array) -> tuple[Array, Array]:
    """Numbers and their standard deviations, from their values without one part each.

    Parameters
    ----------
    estimates : (parts, ...) array
        The values.

    Returns
    -------
    array
        Means.
    array
        Standard deviations.
    """
    n_parts = len(estimates)
    # Numbers that the rows do not determine may be as large as floats can be.
    with np.errstate(over="ignore", invalid="ignore"):
        spread = np.sqrt((n_parts - 1) * np.var(estimates, axis=0))
        return np.mean(estimates, axis=0), spread


def standard_errors_above_zero(values: Array) -> float:
    """Mean of values over its standard error.

    Parameters
    ----------
    values : (parts,) or (logs, parts) array
        Of the parts of a log, or of several logs, whose means may differ: the scatter
        is that of the parts of each log about the log's mean.

    Returns
    -------
    float
        By how many standard errors the mean lies above zero; negative below zero.
    """
    variance = np.mean(np.var(values, axis=-1))
    error = float(np.sqrt(variance / values.size))
    return float(np.mean(values)) / max(error, 1e-300)


def positive(energy: Array) -> Array:
    """Energies of torques, none of them 0.

    Parameters
    ----------
    energy : (..., n) array
        At least 0.

    Returns
    -------
    (..., n) array
        Above 0.
    """
    largest = energy.max(axis=-1, keepdims=True, initial=0.0)
    return np.maximum(energy, 1e-12 * largest + 1e-280)
