"""Refines the continuous shape constants of a candidate to where its evidence is
highest.

They stand on a lattice, so that a search meets the same values in every step.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.diagnosis.library import Candidate
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect

#: Steps of the lattice, in those of the grid that a search begins with.
STEPS = 0.5, 0.25, 0.125

#: Times that a constant that is as large as its effect follows it: what is left of an
#: error falls by the share of the effect that is not of first order, a quarter for the
#: softest gears.
_SIZED = 3


@dataclass(frozen=True)
class Judge:
    """Scores candidates as additions to one fit."""

    #: Returns a candidate with its evidence, coefficients and explained squares.
    scored: Callable[[Candidate], ScoredEffect]
    #: Returns only the drop of the deviance by a candidate, in a quarter of the time.
    drop: Callable[[Candidate], float]


def refine_constants(
    judge: Judge, start: ScoredEffect, fixed: Set[str] = frozenset()
) -> ScoredEffect:
    """Refine the continuous shape constants of a candidate, one after the other.

    Each one is set to the value with the highest evidence. A constant that is as large
    as the effect itself (a delay's) is set to the effect's size last.

    Parameters
    ----------
    judge
        Scores a candidate as an addition to a fit.
    start
        The scored candidate with its first constants.
    fixed
        Names of the constants that keep their values.

    Returns
    -------
    ScoredEffect
        The candidate with most evidence.
    """
    best = start
    for name in start.form.effect.searched:
        if name not in fixed:
            best = _refine_along(judge, best, name)
    sized = best.form.effect.sized_shape  # such as a delay's T; or ""
    if sized and sized not in fixed and len(best.beta):
        best = _follow_size(judge, best, sized)
    return best


def _follow_size(judge: Judge, best: ScoredEffect, sized: str) -> ScoredEffect:
    """Set the constant ``sized`` to the effect's estimated size, three times (_SIZED).

    The columns of a delay, for example, are linearised about the delay T that is the
    effect's constant; setting T to the estimated delay reduces the error of this
    linearisation in each step.

    Parameters
    ----------
    judge
        Scores a candidate as an addition to a fit.
    best
        The scored candidate; its first coefficient is its size.
    sized
        The name of the constant.
    """
    for _ in range(_SIZED):
        effect = best.form.effect
        # Six digits, as in the effect's text on the command line.
        value = float(f"{effect.as_sized(float(best.beta[0])):.6g}")
        if effect.shapes[sized].complaint(value):
            break  # outside of the constant's range
        if value == effect.shape[sized]:
            break  # the next step would be this one again
        best = judge.scored(best.form.with_shape(**{sized: value}))
    return best


def _refine_along(judge: Judge, start: ScoredEffect, name: str) -> ScoredEffect:
    """Refine one shape constant: climb in steps that halve twice, then fit a parabola.

    The steps are 1/2, 1/4 and 1/8 (STEPS) of the spacing of the grid of starting
    values. The top of the parabola is rounded to 1/16 of the last step, so that a
    search meets the same values again. A constant without bounds is not refined.

    Parameters
    ----------
    judge
        Scores a candidate as an addition to a fit.
    start
        The scored candidate from which the constant starts.
    """
    if start.form.bounds(name) is None:
        return start
    lattice = _Lattice(judge, start, name)
    x = 0.0  # position: spacings of the grid from the start
    for step in STEPS:
        x = lattice.climb(x, step)
    # The top of the parabola through the last point and its neighbours, by the drops of
    # the deviance there: the larger the better.
    step = STEPS[-1]
    below = lattice.drop(x - step)
    middle = lattice.drop(x)
    above = lattice.drop(x + step)
    curvature = below - 2.0 * middle + above
    if curvature < 0.0 and np.isfinite(below + above):
        steps_to_top = 0.5 * (below - above) / curvature
        top = x + step * round(16.0 * steps_to_top) / 16.0
        x = max((x, top), key=lattice.drop)
    return lattice.at(x)


class _Lattice:
    """Drops of the deviance by a candidate along one shape constant.

    A position x counts the spacings of the grid of starting values from where the
    constant starts: value = v0 + x h for a constant on a linear scale, v0 exp(x h) on a
    logarithmic one.
    """

    def __init__(self, judge: Judge, start: ScoredEffect, name: str) -> None:
        """Find the spacing h: the smallest one between the constant's starting values.

        With a single starting value h is that value's magnitude (linear scale), or log
        2, a factor of two (logarithmic scale).

        Parameters
        ----------
        judge
            Scores a candidate as an addition to a fit.
        start
            The scored candidate from which the constant starts, at x = 0.
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
        # Starting values of all constants, each a dict by the constant's name.
        starts = type(effect).starts(effect.robot, joint)
        grid = sorted({self._scale(s[name]) for s in starts if name in s})
        self.origin = self._scale(effect.shape[name])
        if len(grid) > 1:
            self.spacing = float(np.min(np.diff(grid)))
        elif self.is_linear:
            self.spacing = abs(self.origin) + 1e-3
        else:
            self.spacing = float(np.log(2.0))
        self._drops = {0.0: start.drop}  # by position x

    def _scale(self, value: float) -> float:
        """Return the constant on its scale: itself, or its logarithm."""
        return float(value if self.is_linear else np.log(value))

    def value(self, x: float) -> float:
        """Return the constant at position x, rounded to six digits.

        An effect's text on the command line has as many digits.
        """
        scaled = self.origin + x * self.spacing
        value = scaled if self.is_linear else np.exp(scaled)
        return float(f"{value:.6g}")

    def at(self, x: float) -> ScoredEffect:
        """Return the scored candidate at position x of the constant."""
        return self.start if x == 0.0 else self.judge.scored(self._candidate(x))

    def _candidate(self, x: float) -> Candidate:
        """Return the candidate at position x of the constant."""
        return self.start.form.with_shape(**{self.name: self.value(x)})

    def climb(self, x: float, step: float) -> float:
        """Climb from position x to the next local maximum of the drop; return it.

        Positions x - step and x + step are compared with x until neither is better.
        """
        while True:
            best = max((x, x - step, x + step), key=self.drop)
            if best == x:
                return x
            x = best

    def drop(self, x: float) -> float:
        """Return the drop of the deviance by the candidate at position x.

        Along a constant the evidence follows this drop: the number of correlated rows
        that count as one, and the price of parameters, hardly change. Errors of their
        estimates would hide the maximum. Each position is computed once. Beyond the
        constant's bounds the drop is minus infinity.
        """
        if x not in self._drops:
            low, high = self.bounds
            is_within = low <= self.value(x) <= high
            self._drops[x] = -np.inf
            if is_within:
                self._drops[x] = self.judge.drop(self._candidate(x))
        return self._drops[x]
