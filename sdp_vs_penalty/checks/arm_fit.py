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

    basis (n, M, k) : of own columns; raw (n, M, s) : columns of the shared parameters;
    apart (n, M, s) : the same with own columns projected out; gram (n, s, s) : of these.
    """

    def __init__(self, basis: Array, raw: Array) -> None:
        self.basis = basis
        self.raw = raw
        left = self.rest(raw)
        # Rounding errors of columns that the own ones span are no columns.
        is_visible = np.linalg.norm(left, axis=1) > 1e-6 * np.linalg.norm(raw, axis=1)
        self.apart = left * is_visible[:, None]
        self.gram = np.swapaxes(self.apart, 1, 2) @ self.apart

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

    def gained(self, x: Array) -> Array:
        """By how much log S_j falls with one more own column of joint j: a score test,
        less what the arm's parameters take of it.

        x (n, M, K) : columns without what the own ones explain. Returns (n, K).
        """
        pull = np.einsum("jm,jmk->jk", self.residual, x) ** 2
        shared = np.swapaxes(self.rows.apart, 1, 2) @ x
        normal = np.tensordot(self.weights, self.rows.gram, 1)
        taken = self.weights[:, None] * np.sum(shared * solve(normal, shared), axis=1)
        energy = np.sum(x**2, axis=1)
        visible_energy = np.maximum(energy - taken, 1e-3 * energy) * self.left[:, None]
        return np.asarray(np.log1p(pull / np.maximum(visible_energy, 1e-280)))

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
