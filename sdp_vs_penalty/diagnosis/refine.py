"""Shape constants of a candidate, refined to where the score is highest.

They stand on a lattice, so that the same values come back in every step of a search.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.diagnosis.library import Candidate
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect

#: Steps of the lattice, in those of the grid that a search begins with.
STEPS = 0.5, 0.25, 0.125

#: Times that a constant that is as large as its effect follows it: what is left of an
#: error falls by the share of the effect that is not of first order, a quarter for the
#: softest gears.
_SIZED = 3

#: Judges a candidate beside a fit.
Judge = Callable[[Candidate], ScoredEffect]


def refine_constants(
    judge: Judge,
    start: ScoredEffect,
    fixed: Set[str] = frozenset(),
) -> ScoredEffect:
    """Each continuous shape constant but the fixed ones in turn.

    A constant that is as large as its effect, such as a delay's, is made so.
    """
    best = start
    for name in start.form.effect.searched:
        if name not in fixed:
            best = _refine_along(judge, best, name)
    sized = best.form.effect.sized_shape
    if sized and sized not in fixed and len(best.beta):
        best = _follow_size(judge, best, sized)
    return best


def _follow_size(judge: Judge, best: ScoredEffect, sized: str) -> ScoredEffect:
    """The constant ``sized`` made as large as the effect."""
    for _ in range(_SIZED):
        effect = best.form.effect
        value = float(f"{effect.as_sized(float(best.beta[0])):.6g}")
        if effect.shapes[sized].complaint(value):
            break
        best = judge(best.form.with_shape(**{sized: value}))
    return best


def _refine_along(judge: Judge, start: ScoredEffect, name: str) -> ScoredEffect:
    """One shape constant where the score is highest."""
    effect = start.form.effect
    shape = effect.shapes[name].on(effect.robot.joints[effect.joints[0]].kind)
    if shape.bounds is None:
        return start
    lattice = _Lattice(judge, start, name)
    x = step = 0.0
    for step in STEPS:
        while (best := max((x, x - step, x + step), key=lattice.score)) != x:
            x = best
    less = lattice.score(x - step)
    middle = lattice.score(x)
    more = lattice.score(x + step)
    curvature = less - 2.0 * middle + more
    if curvature < 0.0 and np.isfinite(less + more):  # the top of a parabola
        top = 0.5 * (less - more) / curvature
        x = max((x, x + step * round(16.0 * top) / 16.0), key=lattice.score)
    return lattice.at(x)


class _Lattice:
    """Scores of a candidate along one of its shape constants; x : steps of the grid from
    where it starts."""

    def __init__(
        self,
        judge: Judge,
        start: ScoredEffect,
        name: str,
    ) -> None:
        effect = start.form.effect
        joint = effect.joints[0]
        shape = effect.shapes[name].on(effect.robot.joints[joint].kind)
        assert shape.bounds is not None
        self.judge = judge
        self.start = start
        self.name = name
        self.bounds = start.form.bounds(name) or shape.bounds
        self.is_linear = shape.scale == "linear"
        starts = type(effect).starts(effect.robot, joint)
        grid = sorted({self._scale(s[name]) for s in starts if name in s})
        self.origin = self._scale(effect.shape[name])
        if len(grid) > 1:
            self.spacing = float(np.min(np.diff(grid)))
        elif self.is_linear:
            self.spacing = abs(self.origin) + 1e-3
        else:
            self.spacing = float(np.log(2.0))
        self._terms = {0.0: start}

    def _scale(self, value: float) -> float:
        """The scale on which the constant is refined."""
        return float(value if self.is_linear else np.log(value))

    def value(self, x: float) -> float:
        """The constant at x, to six digits."""
        scaled = self.origin + x * self.spacing
        return float(f"{scaled if self.is_linear else np.exp(scaled):.6g}")

    def at(self, x: float) -> ScoredEffect:
        """The candidate at x; without any evidence beyond the bounds."""
        if x not in self._terms:
            value = self.value(x)
            low, high = self.bounds
            if low <= value <= high:
                form = self.start.form.with_shape(**{self.name: value})
                self._terms[x] = self.judge(form)
            else:
                self._terms[x] = replace(self.start, drop=-np.inf)
        return self._terms[x]

    def score(self, x: float) -> float:
        """The evidence at x where rows are worth what they were at the start."""
        return self.at(x).evidence_with_worth_of(self.start)
