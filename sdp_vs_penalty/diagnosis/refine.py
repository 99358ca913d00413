"""Refines the continuous shape constants of a candidate to where its evidence is
highest.

They stand on a lattice, so that a search meets the same values in every step.
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
    """Refine each continuous shape constant of a candidate in turn.

    Constants that are as large as the effect itself (a delay's) are set to its size
    last.

    Parameters
    ----------
    judge
        Scores a candidate beside a fit.
    start
        The candidate with its first constants.
    fixed
        Names of the constants that stay.

    Returns
    -------
    ScoredEffect
        The candidate with most evidence.
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
    """Set the constant ``sized`` to the effect's own size, _SIZED (3) times.

    A delay's column, for example, is linear about the delay that the constant states;
    each step reduces the error of this linearisation.
    """
    for _ in range(_SIZED):
        effect = best.form.effect
        value = float(f"{effect.as_sized(float(best.beta[0])):.6g}")
        if effect.shapes[sized].complaint(value):
            break
        best = judge(best.form.with_shape(**{sized: value}))
    return best


def _refine_along(judge: Judge, start: ScoredEffect, name: str) -> ScoredEffect:
    """Refine one shape constant: halve the step three times, then fit a parabola.

    The lattice has steps of 1/2, 1/4 and 1/8 of the grid's spacing, and 1/16 of the
    last step at the parabola's top. A constant without bounds is not refined.
    """
    effect = start.form.effect
    shape = effect.shapes[name].on(effect.robot.joints[effect.joints[0]].kind)
    if shape.bounds is None:
        return start
    lattice = _Lattice(judge, start, name)
    x = 0.0
    for step in STEPS:
        x = lattice.climb(x, step)
    # The top of the parabola through the last point and its neighbours.
    below = lattice.score(x - step)
    middle = lattice.score(x)
    above = lattice.score(x + step)
    curvature = below - 2.0 * middle + above
    if curvature < 0.0 and np.isfinite(below + above):
        steps_to_top = 0.5 * (below - above) / curvature
        top = x + step * round(16.0 * steps_to_top) / 16.0
        x = max((x, top), key=lattice.score)
    return lattice.at(x)


class _Lattice:
    """Scores of a candidate along one shape constant.

    Positions x count the spacings of the grid from where the constant starts; on a
    logarithmic scale unless the constant is linear.
    """

    def __init__(
        self,
        judge: Judge,
        start: ScoredEffect,
        name: str,
    ) -> None:
        """Find the spacing: the smallest one between the constant's starting values.

        With a single starting value it is that value's size (linear) or a factor of
        two.
        """
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
        grid = sorted({self._scale(start[name]) for start in starts if name in start})
        self.origin = self._scale(effect.shape[name])
        if len(grid) > 1:
            self.spacing = float(np.min(np.diff(grid)))
        elif self.is_linear:
            self.spacing = abs(self.origin) + 1e-3
        else:
            self.spacing = float(np.log(2.0))
        self._terms = {0.0: start}

    def _scale(self, value: float) -> float:
        """Return the constant on its scale: itself, or its logarithm."""
        return float(value if self.is_linear else np.log(value))

    def value(self, x: float) -> float:
        """Return the constant at x, rounded to six digits as a written effect has
        them.
        """
        scaled = self.origin + x * self.spacing
        value = scaled if self.is_linear else np.exp(scaled)
        return float(f"{value:.6g}")

    def at(self, x: float) -> ScoredEffect:
        """Return the scored candidate at x; beyond the bounds its evidence is minus
        infinity.
        """
        if x not in self._terms:
            value = self.value(x)
            low, high = self.bounds
            if low <= value <= high:
                form = self.start.form.with_shape(**{self.name: value})
                self._terms[x] = self.judge(form)
            else:
                self._terms[x] = replace(self.start, drop=-np.inf)
        return self._terms[x]

    def climb(self, x: float, step: float) -> float:
        """Return the first local maximum of the evidence from x on, in steps of ``step``."""
        while True:
            best = max((x, x - step, x + step), key=self.score)
            if best == x:
                return x
            x = best

    def score(self, x: float) -> float:
        """Return the evidence at x, with the number of rows counted as one of the
        start.
        """
        return self.at(x).evidence_with_worth_of(self.start)
