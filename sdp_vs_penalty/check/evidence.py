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

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import pairwise
from operator import add

import numpy as np
from numpy.typing import NDArray

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
class Grams:
    """each : (n, p, p) normal equations of every joint's columns.

    A parameter that only one joint's torque shows (friction, a rotor, zeros) follows from those that
    joints share, whatever weight the joint has: these are eliminated once, by a Schur complement.
    """

    each: Array

    @classmethod
    def of(cls, acting: Sequence[tuple[NDArray[np.intp], Array]], p: int) -> Grams:
        """Of each joint's columns (M, k) and the parameters (k,) that they belong to."""
        each = np.zeros((len(acting), p, p))
        for gram, (indices, columns) in zip(each, acting, strict=True):
            gram[indices[:, None], indices] = columns.T @ columns
        return cls(each)

    @cached_property
    def sizes(self) -> Array:
        """(n, p) squared norms of the columns."""
        return np.ascontiguousarray(np.diagonal(self.each, axis1=1, axis2=2))

    @cached_property
    def shared(self) -> NDArray[np.intp]:
        """(s,) parameters that show in several joints."""
        return np.flatnonzero(np.sum(self.sizes > 0.0, axis=0) > 1)

    @cached_property
    def own(self) -> NDArray[np.intp]:
        """(n, k) those that show in one joint alone, joint by joint; filled up where it has fewer."""
        alone = np.sum(self.sizes > 0.0, axis=0) == 1
        found = [np.flatnonzero(alone & (x > (1e-9) ** 2 * x.max(initial=0.0))) for x in self.sizes]
        out = np.full((len(found), max(len(k) for k in found)), -1)
        for row, k in zip(out, found, strict=True):
            row[: len(k)] = k
        return out

    @cached_property
    def blocks(self) -> tuple[Array, Array, Array]:
        """scale (n, k), blocks (n, k, k) of own columns scaled to one, with the ridge; and what is left

        of the shared ones (n, s, s) beside them.
        """
        joint, own = np.arange(len(self.own))[:, None], self.own
        scale = np.zeros(own.shape)
        real = own >= 0
        scale[real] = 1.0 / np.sqrt(np.take_along_axis(self.sizes, own, axis=1)[real])
        blocks = self.each[joint[:, :, None], own[:, :, None], own[:, None, :]]
        blocks = scale[:, :, None] * blocks * scale[:, None, :]
        blocks[:, np.arange(own.shape[1]), np.arange(own.shape[1])] = 1.0 + _RIDGE
        return scale, blocks, self.each[:, self.shared[:, None], self.shared]

    @cached_property
    def back(self) -> tuple[Array, Array]:
        """(n, k, s) own parameters for each shared one; (n, s, s) what is left of the shared columns."""
        scale, blocks, shared = self.blocks
        joint = np.arange(len(scale))[:, None, None]
        border = scale[:, :, None] * self.each[joint, self.own[:, :, None], self.shared]
        back = np.asarray(np.linalg.solve(blocks, border), float)
        return back, shared - np.swapaxes(border, 1, 2) @ back


@dataclass(frozen=True)
class Evidence:
    """Normal equations joint by joint: grams, cross (n, p), energy (n,) of the channels."""

    grams: Grams
    cross: Array
    energy: Array

    @classmethod
    def of(cls, columns: Sequence[Array], channels: Array) -> Evidence:
        """Of each joint's columns (M, p)."""
        seen = [np.flatnonzero(c.any(axis=0)) for c in columns]
        acting = [(k, c[:, k]) for k, c in zip(seen, columns, strict=True)]
        cross = np.array([c.T @ y for c, y in zip(columns, channels.T, strict=True)])
        return cls(Grams.of(acting, cross.shape[1]), cross, energy_of(channels))

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
        return cls(Grams(gram), cross, energy)

    def __add__(self, other: Evidence) -> Evidence:
        grams = Grams(self.gram + other.gram)
        return Evidence(grams, self.cross + other.cross, self.energy + other.energy)

    def __sub__(self, other: Evidence) -> Evidence:
        grams = Grams(self.gram - other.gram)
        return Evidence(grams, self.cross - other.cross, self.energy - other.energy)

    @property
    def gram(self) -> Array:
        """(n, p, p) normal equations of each joint's columns."""
        return self.grams.each

    @cached_property
    def theta(self) -> Array:
        """(p,) the parameters at the maximum."""
        return self._full(self._best[0])

    @cached_property
    def _reduced(self) -> _Reduced:
        return _Reduced.of([self])

    @cached_property
    def _best(self) -> tuple[Array, Array]:
        """Of them those that joints share, and what they leave of each channel (n,)."""
        settle([self])
        return self.__dict__["_best"]  # type: ignore[no-any-return]

    def weighted(self, weights: Array) -> Array:
        """(p,) the parameters by least squares with these weights (n,) of the channels."""
        return self._full(self._reduced.weighted(weights[None])[0])

    def _full(self, theta: Array) -> Array:
        out, grams = np.zeros(self.cross.shape[1]), self.grams
        real = grams.own >= 0
        out[grams.own[real]] = (grams.blocks[0] * self._reduced.own(theta[None])[0])[real]
        out[grams.shared] = theta
        return out

    def left_by(self, theta: Array) -> Array:
        """(n,) squared residual of each channel by these parameters (p,), however they were found."""
        return np.maximum(self.energy - 2.0 * self.cross @ theta + self.gram @ theta @ theta, 0.0)

    @cached_property
    def left(self) -> Array:
        """(n,) squared residual of each channel, one theta for all."""
        return self._best[1]

    @cached_property
    def shares(self) -> Array:
        """(n,) share of each channel's energy that is left over, one theta for all."""
        return np.maximum(self.left / self.energy, FLOOR)

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


@dataclass(frozen=True)
class _Reduced:
    """K Evidences of the same parameters, each joint's own ones eliminated: (K or 1, ...) arrays.

    shared (n, s, s), sizes (n, s) of the columns that joints share; back (n, k, s) own parameters for
    each of them, alone (n, k) without them, scaled; cross (n, s) and energy (n,) that these leave; whole
    (n,) energy.
    """

    shared: Array
    sizes: Array
    back: Array
    alone: Array
    cross: Array
    energy: Array
    whole: Array

    @classmethod
    def of(cls, many: Sequence[Evidence]) -> _Reduced:
        """Of Evidences whose normal equations are of the same parameters."""
        kinds = list({id(e.grams): e.grams for e in many}.values())
        if 1 < len(kinds) < len(many):
            kinds = [e.grams for e in many]
        first, joint = kinds[0], np.arange(len(many[0].energy))[:, None]
        cross, whole = np.stack([e.cross for e in many]), np.stack([e.energy for e in many])
        scale, blocks = (np.stack([g.blocks[k] for g in kinds]) for k in (0, 1))
        back, shared = (np.stack([g.back[k] for g in kinds]) for k in (0, 1))
        own = scale * cross[:, joint, first.own]
        if len(kinds) == 1:  # one factorisation for all
            alone = np.moveaxis(np.linalg.solve(blocks[0], np.moveaxis(own, 0, 2)), 2, 0)
        else:
            alone = np.linalg.solve(blocks, own[..., None])[..., 0]
        left = cross[:, :, first.shared] - (own[:, :, None, :] @ back)[:, :, 0]
        sizes = np.stack([g.sizes[:, first.shared] for g in kinds])
        return cls(shared, sizes, back, alone, left, whole - np.sum(own * alone, axis=2), whole)

    def weighted(self, weights: Array) -> Array:
        """(K, s) the shared parameters by least squares with these weights (K, n) of the channels."""
        k, n, s = self.cross.shape
        if not s:
            return np.zeros((k, 0))
        gram = (weights[:, None] @ self.shared.reshape(-1, n, s * s)).reshape(k, s, s)
        right = (weights[:, None] @ self.cross)[:, 0]
        norms = np.sqrt((weights[:, None] @ self.sizes)[:, 0])
        seen = norms > 1e-9 * norms.max(axis=1, initial=0.0, keepdims=True)
        scale = np.where(seen, 1.0 / np.where(seen, norms, 1.0), 0.0)
        gram *= scale[:, :, None]
        gram *= scale[:, None, :]
        gram.reshape(k, -1)[:, :: s + 1] += np.where(seen, _RIDGE, 1.0)
        return np.asarray(scale * np.linalg.solve(gram, (scale * right)[..., None])[..., 0])

    def own(self, theta: Array) -> Array:
        """(K, n, k) each joint's own parameters beside these shared ones (K, s), scaled."""
        return np.asarray(self.alone - (self.back @ theta[:, None, :, None])[..., 0])

    def least(self, theta: Array) -> Array:
        """(K, n) squared residuals with these shared parameters (K, s) and the best own ones."""
        ridge = _RIDGE * np.sum(self.own(theta) ** 2, axis=2)  # it is no residual
        bent = (self.shared @ theta[:, None, :, None])[..., 0] - 2.0 * self.cross
        return np.maximum(self.energy + (bent @ theta[:, :, None])[..., 0] - ridge, 0.0)


def settle(many: Iterable[Evidence]) -> None:
    """Find the maxima of several at once, their normal equations solved side by side."""
    groups: dict[tuple[object, ...], list[Evidence]] = {}
    for e in many:
        if "_best" not in e.__dict__:
            key = e.cross.shape, e.grams.shared.tobytes(), e.grams.own.tobytes()
            groups.setdefault(key, []).append(e)
    for alike in groups.values():
        reduced = _Reduced.of(alike)
        weights = 1.0 / reduced.whole
        for _ in range(_ROUNDS):
            theta = reduced.weighted(weights)
            left = reduced.least(theta)
            weights = 1.0 / np.maximum(left, FLOOR * reduced.whole)
        for e, found in zip(alike, zip(theta, left, strict=True), strict=True):
            e.__dict__["_best"] = found


def energy_of(channels: Array) -> Array:
    """(n,) of each channel (M, n), at least a trace of the largest."""
    energy = np.sum(channels**2, axis=0)
    return np.maximum(energy, 1e-12 * max(float(energy.max(initial=0.0)), 1e-280))


def in_parts(columns: Sequence[Array], channels: Array, edges: Sequence[int] = ()) -> list[Evidence]:
    """The evidence of each of the run's parts, one after the other: eight alike, or as cut."""
    cuts = edges or np.linspace(0, len(channels), PARTS + 1).astype(int).tolist()
    return [Evidence.of([c[a:b] for c in columns], channels[a:b]) for a, b in pairwise(cuts)]


def without_each(parts: list[Evidence]) -> list[Evidence]:
    """The evidence of the run without each of these parts."""
    whole = reduce(add, parts)
    return [whole - e for e in parts]


def left_out(columns: Sequence[Array], channels: Array) -> Array:
    """(PARTS, n) share of each part's energy that the arm of all other parts leaves of it."""
    parts = in_parts(columns, channels)
    rest = without_each(parts)
    settle(rest)
    each = zip(parts, rest, strict=True)
    return np.array([np.maximum(p.left_by(e.theta) / p.energy, FLOOR) for p, e in each])


def alone_left_out(columns: Sequence[Array], channels: Array) -> Array:
    """(n,) share of each channel that its joint's own model leaves of parts that it did not see."""
    parts = in_parts(columns, channels)
    left = np.zeros((len(parts), channels.shape[1]))
    for k, (part, rest) in enumerate(zip(parts, without_each(parts), strict=True)):
        for j, (g, c) in enumerate(zip(rest.gram, rest.cross, strict=True)):
            theta = solve(g, c[:, None])[:, 0]
            left[k, j] = part.energy[j] - 2.0 * part.cross[j] @ theta + theta @ part.gram[j] @ theta
    return np.maximum(left.sum(axis=0) / sum(p.energy for p in parts), FLOOR)


def solve(gram: Array, right: Array, sizes: Array | None = None) -> Array:
    """(G + ridge)^-1 b with columns scaled to one; zero for columns that are not there.

    sizes : (p,) squared norms of the columns, where the diagonal is no longer these.
    """
    norms = np.sqrt(np.diagonal(gram) if sizes is None else sizes)
    seen = np.flatnonzero(norms > 1e-9 * norms.max(initial=0.0))
    out = np.zeros_like(right)
    if len(seen):
        scale = 1.0 / norms[seen]
        unit = gram if len(seen) == len(gram) else gram[seen[:, None], seen]
        unit = scale[:, None] * unit * scale
        unit.flat[:: len(unit) + 1] += _RIDGE
        out[seen] = scale[:, None] * np.linalg.solve(unit, scale[:, None] * right[seen])
    return out
