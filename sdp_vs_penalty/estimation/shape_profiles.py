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
from dataclasses import asdict, dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.normal_equations import Normal, times
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
        return {**asdict(self), "joint": self.joint + 1, "std": std}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> ShapeEstimate:
        before, after, gain = (float(data[key]) for key in ("before", "after", "gain"))
        std = np.inf if data["std"] is None else float(data["std"])
        effect, joint, shape = str(data["effect"]), int(data["joint"]) - 1, str(data["shape"])
        return cls(effect, joint, shape, before, after, std, gain, bool(data["at_end"]))


@lru_cache(maxsize=64)
def _interpolation(values: bytes, now: float) -> tuple[CubicSpline, Array, Array]:
    """From a constant's logarithm to weights (K,) of its grid's values; a finer grid (U,), and the
    weights (U + 1, K) there and at the constant that the model has."""
    grid = np.log(np.frombuffer(values))
    spline = CubicSpline(grid, np.eye(len(grid)))
    fine = np.linspace(grid[0], grid[-1], _FINE * (len(grid) - 1) + 1)
    return spline, fine, spline(np.append(fine, np.clip(np.log(now), grid[0], grid[-1])))


def best_shapes(
    data: Normal, base: NDArray[np.intp], banks: Sequence[ShapeBank], variance: float
) -> list[ShapeEstimate]:
    """The constants that together explain most, each beside the columns ``base`` and all other banks.

    data : of the columns of base and banks; variance : of one independent row, times how often rows
    repeat. A constant that the data do not tell stays what it is.
    """
    rest = beside(data, pooled(banks), np.eye(len(data.right))[:, base])
    return estimated(banks, settled(rest, banks, variance))


def estimated(banks: Sequence[ShapeBank], found: Array) -> list[ShapeEstimate]:
    """What :func:`settled` finds (4, B), in words."""
    return [
        ShapeEstimate(b.effect.name, b.joint, b.key, b.now, after, std, gain, bool(at_end))
        for b, (after, std, gain, at_end) in zip(banks, found.T.tolist(), strict=True)
    ]


def settled(rest: Normal, banks: Sequence[ShapeBank], variance: float) -> Array:
    """(4, ..., B) the constants that together explain most, their standard deviations, what they take,
    and whether they lie at an end; rest : of banks' columns alone, of which other columns explain
    nothing any more, of one set of rows or of several side by side."""
    places, shape = _places(banks), rest.right.shape[:-1]
    values = np.broadcast_to([float(bank.now) for bank in banks], (*shape, len(banks)))
    found = np.stack([values, *np.zeros((3, *values.shape))])
    now = columns_at(banks, values)
    half, moving = rest.gram @ now, np.ones(shape, bool)
    for _ in range(_TURNS):
        last = np.log(found[0])
        for k, (bank, (own, mine)) in enumerate(zip(banks, places, strict=True)):
            new = _best(bank, _beside(rest, now, half, own, mine), rest.gram[..., own, own], variance)
            found[..., k] = np.where(moving, new, found[..., k])
            now[..., own, mine] = columns_at([bank], found[0, ..., k : k + 1])
            half[..., mine] = rest.gram[..., own] @ now[..., own, mine]
        moved = np.abs(np.log(found[0]) - last) > 1e-3 + 1e-5 * np.abs(last)
        moving = moving & np.any(moved, axis=-1)
        if not moving.any():
            break
    return found


def fitted(
    data: Normal, base: NDArray[np.intp], banks: Sequence[ShapeBank], values: Sequence[float]
) -> Array:
    """Least-squares coefficients (p,) of all columns, with these constants."""
    left, explained = left_by(data, pooled(banks), np.eye(len(data.right))[:, base])
    rest = data.through(left, explained)
    return np.asarray(explained + left @ combined(rest, banks, np.array(values)))


def combined(rest: Normal, banks: Sequence[ShapeBank], values: Array) -> Array:
    """Least-squares coefficients (..., P) of the banks' columns, of which other columns explain nothing,
    with constants (..., B)."""
    columns = columns_at(banks, values)
    return times(columns, rest.through(columns).solved()[0])


def pooled(banks: Sequence[ShapeBank]) -> NDArray[np.intp]:
    """All places of the banks' columns, bank by bank."""
    return np.concatenate([bank.columns.ravel() for bank in banks])


def _places(banks: Sequence[ShapeBank]) -> list[tuple[slice, slice]]:
    """Where each bank stands among all banks' columns, and among columns at one constant each."""
    ends = np.cumsum([(0, 0), *((b.columns.size, b.columns.shape[1]) for b in banks)], axis=0).tolist()
    return [(slice(a, c), slice(b, d)) for (a, b), (c, d) in pairwise(ends)]


def columns_at(banks: Sequence[ShapeBank], values: Array) -> Array:
    """(..., P, M) the columns at constants (..., B) as combinations of the banks' columns; beyond a
    range those of its end."""
    places = _places(banks)
    out = np.zeros((*values.shape[:-1], places[-1][0].stop, places[-1][1].stop))
    for bank, (own, mine), value in zip(banks, places, np.moveaxis(values, -1, 0), strict=True):
        spline, fine, _ = _interpolation(bank.values.tobytes(), float(bank.now))
        weights, k = spline(np.clip(np.log(value), fine[0], fine[-1])), bank.columns.shape[1]
        for c in range(k):
            out[..., own.start + c : own.stop : k, mine.start + c] = weights
    return out


def beside(data: Normal, pool: NDArray[np.intp], others: Array) -> Normal:
    """Of the columns ``pool`` and the torque, what combinations ``others`` (p, q) of columns leave."""
    return data.through(*left_by(data, pool, others))


def left_by(data: Normal, pool: NDArray[np.intp], others: Array) -> tuple[Array, Array]:
    """Combinations of columns: (..., p, k) those of ``pool`` less what ``others`` (p, q) explain of them
    in these data, and (..., p) what these explain of the torque."""
    own = data.through(others)
    explaining = others @ own.inverse[0]
    left = np.eye(len(others))[:, pool] - explaining @ (others.T @ data.gram[..., pool])
    return left, times(explaining, own.right)


def _beside(rest: Normal, now: Array, half: Array, own: slice, mine: slice) -> Normal:
    """A bank's ``own`` columns, less what the other banks' columns ``now`` explain of them."""
    gram, right = rest.gram[..., own, own], rest.right[..., own]
    other = np.delete(np.arange(now.shape[-1]), mine)
    if not other.size:
        return Normal(gram, right, rest.square)
    across, half = np.swapaxes(now[..., other], -1, -2), half[..., other]
    others = Normal(across @ half, times(across, rest.right), rest.square)
    shared = half[..., own, :]
    explained = shared @ others.inverse[0]
    gram = gram - explained @ np.swapaxes(shared, -1, -2)
    return Normal(gram, right - times(explained, others.right), rest.square)


def _best(bank: ShapeBank, own: Normal, alone: Array, variance: float) -> Array:
    """(4, ...) the constant that takes most, its standard deviation, what it takes, whether it lies at
    an end; own : of the bank's columns beside all else; alone (..., K k, K k) : their products."""
    _, x, looked_at = _interpolation(bank.values.tobytes(), float(bank.now))
    seen = 1e-9 * np.max(np.diagonal(alone, axis1=-2, axis2=-1), axis=-1)
    taken = _taken(bank, own, looked_at, seen[..., None]) / variance
    u, gain, bend = _vertex(x, taken[..., :-1])
    gain = gain - taken[..., -1]
    known = gain > _WORTH
    # As many digits as a written effect has.
    written = np.reshape([float(f"{v:.6g}") for v in np.ravel(np.exp(u))], np.shape(u))
    after = np.where(known, written, bank.now)
    std = np.where(bend > 0.0, after * np.sqrt(2.0 / np.where(bend > 0.0, bend, 1.0)), np.inf)
    first, last = np.log(bank.ends)
    near = _AT_END * (last - first)
    at_end = known & ((u < first + near) | (u > last - near))
    return np.stack([after, std, np.where(known, gain, 0.0), at_end])


def _taken(bank: ShapeBank, own: Normal, w: Array, seen: Array) -> Array:
    """(..., U) what the columns with weights (U, K) take from the squared error."""
    (K, k), some = bank.columns.shape, own.right.shape[:-1]
    if k > 1:
        half = (w @ own.gram.reshape(*some, K, -1)).reshape(*some, len(w), k, K, k)
        gram = np.einsum("...uaLb,uL->...uab", half, w)
        pull = w @ own.right.reshape(*some, K, k)
        solved = np.linalg.pinv(gram, rcond=1e-9, hermitian=True)
        return np.asarray(np.sum(pull * times(solved, pull), axis=-1))
    energy, pull = np.sum((w @ own.gram) * w, axis=-1), own.right @ w.T
    # What the other columns absorb but for rounding shows no constant.
    used = energy > seen
    if bank.effect.parameters[0].lower == 0.0:
        used &= pull >= 0.0
    return np.where(used, pull * pull / np.where(used, energy, 1.0), 0.0)


def _vertex(x: Array, values: Array) -> tuple[Array, Array, Array]:
    """Where curves (..., U) on a uniform grid are highest, how high, and -d2/dx2 there; at an end the
    end."""
    top = np.argmax(values, axis=-1)
    inner = np.clip(top, 1, len(x) - 2)
    around = np.take_along_axis(values, inner[..., None] + np.array([-1, 0, 1]), -1)
    left, middle, right = np.moveaxis(around, -1, 0)
    step = x[1] - x[0]
    bend = (2.0 * middle - left - right) / step**2
    end = (top != inner) | (bend <= 0.0)
    shift = np.clip(0.5 * (right - left) / np.where(end, np.inf, bend * step**2), -0.5, 0.5)
    return (
        np.where(end, x[top], x[inner] + shift * step),
        np.where(end, values.max(axis=-1), middle + 0.25 * (right - left) * shift),
        bend,
    )


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
