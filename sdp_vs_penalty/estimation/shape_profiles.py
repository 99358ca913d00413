"""Shape constants of a model's own effects, estimated beside its parameters.

A constant u (the velocity over which Coulomb friction turns round) is no coefficient, but for every u
the coefficients are known: with z(u) and y what all other columns leave of the effect's columns and of
the torque, it takes chi2(u) = y'z (z'z)^-1 z'y from the squared error, and the best u is where that is
largest (variable projection: Golub, Pereyra, SIAM J. Numerical Analysis 1973). The columns are computed
on a grid of u once; between its values z is a cubic spline of ln u, so that everything is small
algebra on compressed data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.normal_equations import Normal, pseudo_inverse
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.spline import CubicSpline

#: Values looked at between two of the grid.
_FINE = 12
#: Turns in which several constants are brought to agree.
_TURNS = 12
#: A constant stays whose best value takes less than this from the squared error, in its variances.
_WORTH = 2.0
#: Of a range's logarithm: nearer to an end than this, a constant is at it.
_AT_END = 0.02


@dataclass(frozen=True)
class ShapeBank:
    """One shape constant of one effect on one joint: the values (K,) whose columns are known, the one
    that the model has, and where the columns (K, k) stand among all others; ends : of the range in
    which the constant may lie."""

    effect: Effect
    joint: int
    key: str
    values: Array
    now: float
    columns: NDArray[np.intp]
    ends: tuple[float, float]


@dataclass(frozen=True)
class ShapeEstimate:
    """A shape constant as estimated: ``before`` is what the model had; std : its standard deviation,
    from the curvature of the squared error; gain : what the change takes from that error, in units of
    its variance; at_end : it lies at the end of the range in which it was looked for."""

    effect: str
    joint: int
    shape: str
    before: float
    after: float
    std: float
    gain: float
    at_end: bool

    def to_dict(self) -> dict[str, Any]:
        """joint counts from 1; std is null where the data do not bound the constant on both sides."""
        std = self.std if np.isfinite(self.std) else None
        return {**vars(self), "joint": self.joint + 1, "std": std}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> ShapeEstimate:
        before, after, gain = (float(data[key]) for key in ("before", "after", "gain"))
        std = np.inf if data["std"] is None else float(data["std"])
        effect, joint, shape = str(data["effect"]), int(data["joint"]) - 1, str(data["shape"])
        return cls(effect, joint, shape, before, after, std, gain, bool(data["at_end"]))


@lru_cache(maxsize=64)
def _interpolation(values: bytes) -> tuple[CubicSpline, Array, Array]:
    """From a constant's logarithm to weights (K,) of its grid's values; a finer grid, its weights."""
    grid = np.log(np.frombuffer(values))
    spline = CubicSpline(grid, np.eye(len(grid)))
    fine = np.linspace(grid[0], grid[-1], _FINE * (len(grid) - 1) + 1)
    return spline, fine, spline(fine)


@lru_cache(maxsize=4096)
def _weights(values: bytes, value: float) -> Array:
    """(K,) of the columns of each value of a grid, in those of one; outside the range of its end."""
    spline, fine, _ = _interpolation(values)
    return np.asarray(spline(np.clip(np.log(value), fine[0], fine[-1])))


def best_shapes(
    data: Normal, base: NDArray[np.intp], banks: Sequence[ShapeBank], variance: float
) -> list[ShapeEstimate]:
    """The constants that together explain most, each beside the columns ``base`` and all other banks.

    data : of the columns of base and banks; variance : of one independent row, times how often rows
    repeat. A constant that the data do not tell stays what it is.
    """
    rest = beside(data, pooled(banks), np.eye(len(data.right))[:, base])
    return settled(rest, curves_of(rest, banks), variance)


def settled(rest: Normal, curves: Sequence[Curve], variance: float) -> list[ShapeEstimate]:
    """The same of banks' columns alone, of which other columns explain nothing any more."""
    values = [curve.bank.now for curve in curves]
    found = dict[int, ShapeEstimate]()
    at = [curve.at(v) for curve, v in zip(curves, values, strict=True)]
    for _ in range(_TURNS):
        before = list(values)
        for k, curve in enumerate(curves):
            found[k] = curve.best(rest, np.hstack([at[k][:, :0], *at[:k], *at[k + 1 :]]), variance)
            values[k], at[k] = found[k].after, curve.at(found[k].after)
        last = np.log(before)
        if np.all(np.abs(np.log(values) - last) <= 1e-3 + 1e-5 * np.abs(last)):
            break
    return list(found.values())


def fitted(
    data: Normal, base: NDArray[np.intp], banks: Sequence[ShapeBank], values: Sequence[float]
) -> Array:
    """Least-squares coefficients (p,) of all columns, with these constants."""
    pool = pooled(banks)
    left, explained = left_by(data, pool, np.eye(len(data.right))[:, base])
    rest = data.through(left, explained)
    return np.asarray(explained + left @ combined(rest, curves_of(rest, banks), values))


def combined(rest: Normal, curves: Sequence[Curve], values: Sequence[float]) -> Array:
    """Least-squares coefficients of the banks' columns, of which other columns explain nothing."""
    columns = np.hstack([curve.at(v) for curve, v in zip(curves, values, strict=True)])
    part = Normal(columns.T @ rest.gram @ columns, columns.T @ rest.right, rest.square)
    return np.asarray(columns @ part.solved()[0])


def pooled(banks: Sequence[ShapeBank]) -> NDArray[np.intp]:
    """All places of the banks' columns, bank by bank."""
    return np.concatenate([bank.columns.ravel() for bank in banks])


def curves_of(rest: Normal, banks: Sequence[ShapeBank]) -> list[Curve]:
    """Of the banks' columns alone, bank by bank."""
    ends = np.cumsum([bank.columns.size for bank in banks])
    places = np.split(np.arange(ends[-1]), ends[:-1])
    return [Curve(bank, p, rest) for bank, p in zip(banks, places, strict=True)]


def beside(data: Normal, pool: NDArray[np.intp], others: Array) -> Normal:
    """Of the columns ``pool`` and the torque, what combinations ``others`` (p, q) of columns leave."""
    return data.through(*left_by(data, pool, others))


def left_by(data: Normal, pool: NDArray[np.intp], others: Array) -> tuple[Array, Array]:
    """Combinations of columns: (p, k) those of ``pool`` less what ``others`` (p, q) explain of them in
    these data, and (p,) what these explain of the torque."""
    norms = np.sqrt(np.maximum(np.einsum("pq,pq->q", others, data.gram @ others), 0.0))
    seen = norms > 1e-10 * norms.max(initial=0.0)
    others = others[:, seen] / norms[seen]
    half = data.gram @ others
    inverse, _ = pseudo_inverse(others.T @ half)
    explaining = others @ inverse
    return np.eye(len(data.right))[:, pool] - explaining @ half[pool].T, explaining @ (
        others.T @ data.right
    )


class Curve:
    """The columns of one bank as a function of its constant: weights of the columns on the grid."""

    def __init__(self, bank: ShapeBank, places: NDArray[np.intp], rest: Normal) -> None:
        self.bank, self.places, self.size = bank, places, len(rest.right)
        self.grid = np.log(bank.values)
        self.known = dict[float, Array]()
        self.signed = len(bank.effect.parameters) == 1 and bank.effect.parameters[0].lower == 0.0
        self.seen = 1e-9 * float(np.max(np.diagonal(rest.gram)[places]))
        values = bank.values.tobytes()
        _, self.fine, between = _interpolation(values)
        #: (U + 1, K) weights at the constants that are looked at, and at the one that the model has.
        self.looked_at = np.vstack([between, _weights(values, float(bank.now))])

    def at(self, value: float) -> Array:
        """(p, k) weights of all columns; outside the range those of its end."""
        if value in self.known:
            return self.known[value]
        w = _weights(self.bank.values.tobytes(), float(value))
        k = self.bank.columns.shape[1]
        out = np.zeros((self.size, k))
        out[self.places] = (w[:, None, None] * np.eye(k)).reshape(-1, k)
        self.known[value] = out
        return out

    def best(self, rest: Normal, others: Array, variance: float) -> ShapeEstimate:
        """The constant that takes most beside combinations ``others`` (p, q) of all columns."""
        taken = self._taken(self._beside(rest, others), self.looked_at) / variance
        u, gain, bend = _vertex(self.fine, taken[:-1], int(np.argmax(taken[:-1])))
        std = float(np.sqrt(2.0 / bend)) if bend > 0.0 else np.inf
        gain -= float(taken[-1])
        known = gain > _WORTH
        # As many digits as a written effect has.
        after = float(f"{np.exp(u):.6g}") if known else self.bank.now
        first, last = np.log(self.bank.ends)
        near = _AT_END * (last - first)
        at_end = known and bool(u < first + near or u > last - near)
        who = self.bank.effect.name, self.bank.joint, self.bank.key, self.bank.now
        return ShapeEstimate(*who, after, after * std, gain if known else 0.0, at_end)

    def _beside(self, rest: Normal, others: Array) -> Normal:
        """The bank's own columns, less what others explain of them."""
        gram, right = rest.gram[np.ix_(self.places, self.places)], rest.right[self.places]
        if others.shape[1]:
            half = rest.gram @ others
            inner = others.T @ half
            norms = np.sqrt(np.maximum(np.diagonal(inner), 0.0))
            unit = np.where(norms > 1e-10 * norms.max(initial=0.0), norms, np.inf)
            shared = half[self.places] / unit
            explained = shared @ pseudo_inverse(inner / np.outer(unit, unit))[0]
            gram = gram - explained @ shared.T
            right = right - explained @ ((others.T @ rest.right) / unit)
        return Normal(gram, right, rest.square)

    def _taken(self, own: Normal, w: Array) -> Array:
        """(U,) what the columns with weights (U, K) take from the squared error."""
        K, k = self.bank.columns.shape
        pull = w @ own.right.reshape(K, k)
        if k > 1:
            half = (w @ own.gram.reshape(K, -1)).reshape(len(w), k, K, k)
            gram = (w[:, None, None, :] @ half)[:, :, 0]
            solved = np.linalg.pinv(gram, rcond=1e-9, hermitian=True) @ pull[:, :, None]
            return np.asarray(np.sum(pull * solved[:, :, 0], axis=1))
        energy, p = np.einsum("uk,uk->u", w @ own.gram, w), pull[:, 0]
        # What the other columns absorb but for rounding shows no constant.
        used = (energy > self.seen) & ~(self.signed & (p < 0.0))
        return np.where(used, p * p / np.where(used, energy, 1.0), 0.0)


def _vertex(x: Array, values: Array, top: int) -> tuple[float, float, float]:
    """Where a curve on a uniform grid is highest, how high, and -d2/dx2 there; at an end the end."""
    inner = min(max(top, 1), len(x) - 2)
    left, middle, right = values[inner - 1 : inner + 2]
    step = x[1] - x[0]
    bend = (2.0 * middle - left - right) / step**2
    if top != inner or bend <= 0.0:
        return float(x[top]), float(values[top]), float(bend)
    shift = float(np.clip(0.5 * (right - left) / (bend * step**2), -0.5, 0.5))
    return float(x[inner] + shift * step), float(middle + 0.25 * (right - left) * shift), float(bend)


def alone(effect: Effect, joint: int, **shape: float) -> Effect:
    """The effect on one of its joints, with some shape constants changed."""
    return type(effect)(effect.robot, [joint], **{**effect.shape, **shape})


def with_shapes(effects: Sequence[Effect], found: Sequence[ShapeEstimate]) -> tuple[Effect, ...]:
    """The effects with estimated constants: those that were estimated stand alone, a joint each, in
    the same order, so that the parameters keep their places."""
    values = {(s.effect, s.joint, s.shape): s.after for s in found}
    out: list[Effect] = []
    for effect in effects:
        keys = [(j, k) for j in effect.joints for k in effect.shapes if (effect.name, j, k) in values]
        if not keys:
            out.append(effect)
            continue
        for joint in effect.joints:
            own = {k: values[effect.name, j, k] for j, k in keys if j == joint}
            out.append(alone(effect, joint, **own))
    return tuple(out)


def asked_effects(effects: Sequence[Effect], shapes: Sequence[Mapping[str, Any]]) -> list[str]:
    """How effects are written so that `identify` estimates again what it has estimated: ``shapes`` as
    an estimate's details hold them."""
    estimated = {(s["effect"], s["joint"] - 1) for s in shapes}
    joints: dict[str, list[int]] = {}
    out: list[str] = []
    for effect in effects:
        if not all((effect.name, j) in estimated for j in effect.joints):
            out.append(effect.text)
        elif effect.name in joints:
            joints[effect.name] += effect.joints
        else:
            joints[effect.name] = list(effect.joints)
            out.append(effect.name)
    every = effects[0].robot.n if effects else 0
    return [
        f"{name}:{'+'.join(str(j + 1) for j in joints[name])}"
        if name in joints and len(joints[name]) < every
        else name
        for name in out
    ]
