"""One arm fitted to one repaired log, and the rows that it was fitted to."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.regression.normal_equations import FLOOR, solve
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one


class RepairedRows:
    """The rows of n joints under one repair of the motion.

    basis (n, M, k) : orthonormal columns of each joint alone; raw (n, M, s) : columns of
    the shared parameters; apart (n, M, s) : the same with the basis projected out; gram
    (n, s, s) : of these.
    """

    def __init__(self, basis: Array, raw: Array) -> None:
        self.basis = basis
        self.raw = raw
        in_basis = np.swapaxes(basis, 1, 2) @ raw
        left = raw - basis @ in_basis
        gram = np.swapaxes(left, 1, 2) @ left
        # Rounding errors of columns that the basis spans are no columns.
        of_left = np.diagonal(gram, axis1=1, axis2=2)
        of_raw = of_left + np.einsum("jks,jks->js", in_basis, in_basis)
        is_visible = of_left > 1e-12 * of_raw
        self.apart = left * is_visible[:, None]
        self.gram = gram * is_visible[:, None] * is_visible[:, :, None]

    def rest(self, y: Array) -> Array:
        """(n, M, K) torques or columns with own columns projected out."""
        return np.asarray(y - self.basis @ (np.swapaxes(self.basis, 1, 2) @ y))


@dataclass
class ArmFit:
    """One arm fitted to one repaired log.

    moving (n,) : joints that move; channels (n, M) : the torque as repaired; theta
    (s,) : the arm; left, total (n,) : squared torque that it leaves, and all [(N m)^2].
    """

    moving: NDArray[np.bool_]
    rows: RepairedRows
    channels: Array
    theta: Array
    left: Array
    total: Array

    @cached_property
    def shares(self) -> Array:
        """(n,) share of each channel's energy that is left over."""
        return self.left / self.total

    @property
    def unexplained(self) -> float:
        """The same of all joints that move together."""
        return float(self.left[self.moving].sum() / self.total[self.moving].sum())

    @property
    def mean_share(self) -> float:
        """The mean of the shares of joints that move."""
        return float(np.mean(self.shares[self.moving]))

    @cached_property
    def score(self) -> float:
        """sum_j log of what is left, of joints that move."""
        return float(np.log(self.shares)[self.moving].sum())

    @property
    def poor(self) -> NDArray[np.bool_]:
        """(n,) joints of whose torque more is unexplained than what friction laws and
        filters are worth: their motion may be another one."""
        return np.asarray(self.moving & (self.shares > 2.0 * FLOOR))

    @cached_property
    def residual(self) -> Array:
        """(n, M) what the arm leaves of the channels."""
        left = self.rows.rest(self.channels[:, :, None])[:, :, 0]
        return np.asarray(left - self.rows.apart @ self.theta)

    def gained(self, columns: Array) -> Array:
        """Fall of log S_j with one more own column of joint j, by a score test.

        Parameters
        ----------
        columns : (n, M, K) array
            K candidates for each joint.

        Returns
        -------
        (n, K) array
            The falls, less what the arm's parameters take of them.
        """
        transposed = np.swapaxes(columns, 1, 2)
        return self._gained(
            pull=(transposed @ self.residual[:, :, None])[:, :, 0],
            in_arm=transposed @ self.rows.apart,
            in_basis=transposed @ self.rows.basis,
            energy=np.einsum("jmk,jmk->jk", columns, columns),
        )

    def gained_by_steps(
        self,
        heard: Array,
        first_rows: NDArray[np.intp],
    ) -> Array:
        """:meth:`gained` of steps: columns that are 0 before a row.

        Products with a step are sums over the rows from its first one on.

        Parameters
        ----------
        heard : (n, M) array
            Value of the column from there on: 1 where a joint's torque is asked for.
        first_rows : (K,) array
            Row at which each step begins.

        Returns
        -------
        (n, K) array
            The falls.
        """

        def from_rows(y: Array) -> Array:
            """(n, K, ...) sums of (n, M, ...) over the rows of each step."""
            sums = np.cumsum(y[:, ::-1], axis=1)[:, ::-1]
            return np.asarray(sums[:, first_rows])

        return self._gained(
            pull=from_rows(heard * self.residual),
            in_arm=from_rows(heard[:, :, None] * self.rows.apart),
            in_basis=from_rows(heard[:, :, None] * self.rows.basis),
            energy=from_rows(heard**2),
        )

    def _gained(
        self,
        pull: Array,
        in_arm: Array,
        in_basis: Array,
        energy: Array,
    ) -> Array:
        """(n, K) fall of log S_j from products of K columns with the residual (n, K), the
        arm's columns (n, K, s), the basis (n, K, k), and themselves (n, K)."""
        normal = np.tensordot(self.weights, self.rows.gram, 1)
        transposed = np.swapaxes(in_arm, 1, 2)
        of_arm = np.sum(transposed * solve(normal, transposed), axis=1)
        taken = self.weights[:, None] * of_arm
        left = energy - np.sum(in_basis**2, axis=2)
        # What the basis spans is nothing new.
        is_new = left > 1e-10 * energy
        visible = np.maximum(left - taken, 1e-3 * left) * self.left[:, None]
        return np.asarray(is_new * np.log1p(pull**2 / np.maximum(visible, 1e-280)))

    @cached_property
    def independent_rows(self) -> float:
        """How many independent samples M rows hold whose neighbours are alike:
        M / (1 + 2 sum_k rho_k) of the median joint, over lags before what the arm leaves
        is correlated no more (Geyer 1992)."""
        left = self.residual[self.moving]
        count = self.channels.shape[1]
        centred = left - left.mean(axis=1, keepdims=True)
        power = np.abs(np.fft.rfft(centred, 2 * count)) ** 2
        rho = np.fft.irfft(power)[:, :count]
        rho = rho / nonzero_or_one(rho[:, :1])
        lasts = 2.0 * np.sum(rho * np.cumprod(rho > 0.0, axis=1), axis=1) - 1.0
        return count / max(float(np.median(lasts)), 1.0)

    @cached_property
    def weights(self) -> Array:
        """(n,) of each joint's rows, 0 where it does not move."""
        return np.where(self.moving, 1.0 / self.left, 0.0)
