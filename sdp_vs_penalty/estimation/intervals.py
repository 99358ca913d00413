"""One parameter's interval: what the data say, what physics allows, and a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.constants import IDENTIFIABLE_WIDTH, NORMAL_95, WEAK_WIDTH
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.arrays import Array

IDENTIFIABLE, WEAKLY, NOT_SEEN = "identifiable", "weakly", "not seen"


@dataclass(frozen=True)
class Interval:
    """One standard or base parameter: its estimate, what the data say of it, and a verdict.

    value : of the model; std : standard deviation, NaN where the data do not determine the parameter;
    low, high : bounds of the 95 % interval, infinite there. verdict : "identifiable" (half-width up to
    a quarter of the value), "weakly" (up to the value), or "not seen"; half-widths up to 0.25 % and 10 %
    of the largest value that the problem's bounds or the measured torque allow count as well.
    """

    name: str
    unit: str
    value: float
    std: float
    low: float
    high: float
    verdict: str

    def to_dict(self) -> dict[str, Any]:
        """As in model.json: null where the data say nothing."""
        std, low, high = (None if not np.isfinite(x) else x for x in (self.std, self.low, self.high))
        return {
            "name": self.name,
            "unit": self.unit,
            "value": self.value,
            "std": std,
            "lower": low,
            "upper": high,
            "verdict": self.verdict,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Interval:
        """What :meth:`to_dict` wrote."""
        ends = (("std", np.nan), ("lower", -np.inf), ("upper", np.inf))
        std, low, high = (none if data[k] is None else float(data[k]) for k, none in ends)
        return cls(
            data["name"], data["unit"], float(data["value"]), std, low, high, str(data["verdict"])
        )

    def widened(self, extra: float) -> Interval:
        """With an independent error of the standard deviation ``extra`` more; a lower end at zero is a
        bound and stays."""
        std = float(np.hypot(self.std, extra))
        more = NORMAL_95 * (std - self.std)
        low = self.low if self.low == 0.0 else self.low - more
        return replace(self, std=std, low=low, high=self.high + more)


def intervals_of(
    names: Sequence[str], units: Sequence[str], figures: Array, limits: Array, sizes: Array
) -> tuple[Interval, ...]:
    """figures (3, k) : values, least squares and standard deviations."""
    out = []
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        value, least, std = (float(x) for x in figures[:, k])
        if np.isnan(std):
            out.append(Interval(name, unit, value, np.nan, -np.inf, np.inf, NOT_SEEN))
            continue
        half = NORMAL_95 * std
        low, high = max(least - half, limits[k, 0]), min(least + half, limits[k, 1])
        low, high = min(low, value), max(high, value)
        verdict = _verdict(half, abs(least), float(sizes[k]))
        out.append(Interval(name, unit, value, std, float(low), float(high), verdict))
    return tuple(out)


def physical_limits(problem: Problem, model: Model) -> Array:
    """(p, 2) smallest and largest value that a parameter can have by the problem's bounds: masses and
    moments of inertia are not negative, nor is friction."""
    bound = problem.parameter_bound(model)
    limits = np.column_stack([-bound, bound])
    limits[:, 0] = np.maximum(limits[:, 0], [p.lower for p in model.parameters])
    for link, indices in enumerate(model.rigid_indices.reshape(-1, 10)):
        limits[indices[0], 0] = problem.box[link, 0, 0]
    for body in problem.constraints(model).convex:
        if body.family == "pseudo-inertia":
            own = body.indices[[0, 4, 6, 9]]
            limits[own, 0] = np.maximum(limits[own, 0], 0.0)
    return limits


def combined_limits(rows: Array, limits: Array) -> Array:
    """(b, 2) limits of linear combinations (b, p) of parameters with limits (p, 2)."""
    low = np.where(rows > 0.0, limits[:, 0], limits[:, 1])
    high = np.where(rows > 0.0, limits[:, 1], limits[:, 0])
    none = rows == 0.0
    return np.column_stack(
        [np.sum(np.where(none, 0.0, rows * np.where(none, 0.0, x)), axis=1) for x in (low, high)]
    )


def _verdict(half: float, value: float, largest: float) -> str:
    for (own, absolute), verdict in ((IDENTIFIABLE_WIDTH, IDENTIFIABLE), (WEAK_WIDTH, WEAKLY)):
        if half <= max(own * min(value, largest), absolute * largest if np.isfinite(largest) else 0.0):
            return verdict
    return NOT_SEEN


def counts(intervals: Sequence[Interval]) -> dict[str, int]:
    """How many of each verdict."""
    return {
        verdict: sum(i.verdict == verdict for i in intervals)
        for verdict in (IDENTIFIABLE, WEAKLY, NOT_SEEN)
    }


def coverage(truth: ArrayLike, intervals: Sequence[Interval]) -> float:
    """Share of the finite intervals that hold the true values: for judging intervals in simulation."""
    values = np.asarray(truth, float)
    held = [i.low <= x <= i.high for x, i in zip(values, intervals, strict=True) if np.isfinite(i.low)]
    return float(np.mean(held)) if held else 1.0
