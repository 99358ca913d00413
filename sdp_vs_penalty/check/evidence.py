"""How well one arm explains all channels at once: the likelihood by which hypotheses are compared.

With the residual sum of squares S_j of joint j's channel under one theta for all joints, the Gaussian
log-likelihood with a noise variance of its own for each joint is, up to constants, -M/2 sum_j log S_j.
Its maximum over theta is found by reweighting each joint with its own residual (as identification does).
Compared are, per independent row and free of units and gains,

    score = sum_j log e_j,   e_j = S_j / |C_j|^2,

so that one joint whose residual falls to an e-th of its energy counts 1, whichever joint it is: a wrong
gain of a well-explained channel shows in its neighbours long before it shows in the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from sdp_vs_penalty.regression.regression import Regression
from sdp_vs_penalty.robot.arrays import Array

#: Relative ridge of the normal equations: directions that the motion does not excite stay quiet.
_RIDGE = 1e-9
#: Residuals below this share of the energy (0.3 % of the torque) are explained: less says nothing.
FLOOR = 1e-5
_ROUNDS = 3
#: Parts of the run that are left out in turn.
PARTS = 8


@dataclass(frozen=True)
class Evidence:
    """Normal equations joint by joint: gram (n, p, p), cross (n, p), energy (n,) of the channels."""

    gram: Array
    cross: Array
    energy: Array

    @classmethod
    def of(cls, gram: Array, columns: Sequence[Array], channels: Array) -> Evidence:
        cross = np.array([c.T @ y for c, y in zip(columns, channels.T, strict=True)])
        energy = np.sum(channels**2, axis=0)
        return cls(gram, cross, np.maximum(energy, 1e-12 * max(float(energy.max(initial=0.0)), 1e-280)))

    @classmethod
    def of_regression(cls, regression: Regression) -> Evidence:
        """From the rows that an identification is made of."""
        n, p = regression.joints, regression.p
        gram, cross, energy = np.zeros((n, p, p)), np.zeros((n, p)), np.full(n, 1e-280)
        for f in regression.factors:
            own = f.triangle.T @ f.triangle
            gram[f.joint][np.ix_(f.indices, f.indices)] += own[:-1, :-1]
            cross[f.joint, f.indices] += own[:-1, -1]
            energy[f.joint] += own[-1, -1]
        return cls(gram, cross, energy)

    @cached_property
    def theta(self) -> Array:
        """(p,) the parameters at the maximum."""
        weights = 1.0 / self.energy
        for _ in range(_ROUNDS):
            theta = self.weighted(weights)
            weights = 1.0 / (self._shares(theta) * self.energy)
        return theta

    def weighted(self, weights: Array) -> Array:
        """(p,) the parameters by least squares with these weights (n,) of the channels."""
        gram = np.tensordot(weights, self.gram, 1)
        return solve(gram, (weights @ self.cross)[:, None])[:, 0]

    def _left(self, theta: Array) -> Array:
        return np.maximum(self.energy - 2.0 * self.cross @ theta + self.gram @ theta @ theta, 0.0)

    def _shares(self, theta: Array) -> Array:
        return np.maximum(self._left(theta) / self.energy, FLOOR)

    @property
    def left(self) -> Array:
        """(n,) squared residual of each channel, one theta for all."""
        return self._left(self.theta)

    @cached_property
    def shares(self) -> Array:
        """(n,) share of each channel's energy that is left over, one theta for all."""
        return self._shares(self.theta)

    @cached_property
    def alone(self) -> Array:
        """(n,) the same with a theta of its own for each joint: no arm does better."""
        explained = [
            float(c @ solve(g, c[:, None])[:, 0]) for g, c in zip(self.gram, self.cross, strict=True)
        ]
        return np.maximum(1.0 - np.array(explained) / self.energy, FLOOR)

    @property
    def contradiction(self) -> float:
        """sum_j log of what one arm leaves over what each joint by itself leaves: no friction, however
        odd, adds to it, since friction is a joint's own."""
        return float(np.log(self.shares / self.alone).sum())

    @property
    def score(self) -> float:
        return float(np.log(self.shares).sum())

    @property
    def misfit(self) -> float:
        """The score without its floor, below which it would be flat: for the best value of a number."""
        return float(np.log(np.maximum(self.left / self.energy, 1e-12)).sum())


def in_parts(columns: Sequence[Array], channels: Array) -> list[Evidence]:
    """The evidence of each of the run's parts, one after the other."""
    cut = [slice(a, b) for a, b in pairwise(np.linspace(0, len(channels), PARTS + 1).astype(int))]
    parts = [([c[rows] for c in columns], channels[rows]) for rows in cut]
    return [Evidence.of(np.array([c.T @ c for c in own]), own, y) for own, y in parts]


def without_each(parts: list[Evidence]) -> list[Evidence]:
    """The evidence of the run without each of these parts."""
    gram, cross, energy = (sum(getattr(e, x) for e in parts) for x in ("gram", "cross", "energy"))
    return [Evidence(gram - e.gram, cross - e.cross, energy - e.energy) for e in parts]


def left_out(columns: Sequence[Array], channels: Array) -> Array:
    """(PARTS, n) share of each part's energy that the arm of all other parts leaves of it."""
    parts = in_parts(columns, channels)
    return np.array([p._shares(e.theta) for p, e in zip(parts, without_each(parts), strict=True)])


def alone_left_out(columns: Sequence[Array], channels: Array) -> Array:
    """(n,) share of each channel that its joint's own model leaves of parts that it did not see."""
    parts = in_parts(columns, channels)
    left = np.zeros((len(parts), channels.shape[1]))
    for k, (part, rest) in enumerate(zip(parts, without_each(parts), strict=True)):
        for j, (g, c) in enumerate(zip(rest.gram, rest.cross, strict=True)):
            theta = solve(g, c[:, None])[:, 0]
            left[k, j] = part.energy[j] - 2.0 * part.cross[j] @ theta + theta @ part.gram[j] @ theta
    return np.maximum(left.sum(axis=0) / sum(p.energy for p in parts), FLOOR)


def solve(gram: Array, right: Array) -> Array:
    """(G + ridge)^-1 b with columns scaled to one; zero for columns that are not there."""
    norms = np.sqrt(np.diagonal(gram))
    seen = norms > 1e-9 * norms.max(initial=0.0)
    out = np.zeros_like(right)
    if seen.any():
        scale = norms[seen]
        unit = gram[np.ix_(seen, seen)] / np.outer(scale, scale)
        unit[np.diag_indices_from(unit)] += _RIDGE
        out[seen] = np.linalg.solve(unit, right[seen] / scale[:, None]) / scale[:, None]
    return out
