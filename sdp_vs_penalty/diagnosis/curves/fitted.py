"""A curve fitted to what a state leaves of a joint, before anything is decided about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from sdp_vs_penalty.diagnosis.curves import smooth as splines
from sdp_vs_penalty.diagnosis.curves.bases import Basis, Variables
from sdp_vs_penalty.diagnosis.curves.curve import table_effect
from sdp_vs_penalty.diagnosis.curves.smooth import Factors, Smooth
from sdp_vs_penalty.diagnosis.state import SearchState
from sdp_vs_penalty.effects.measured_curve import MeasuredCurve
from sdp_vs_penalty.robot.arrays import Array

#: Draws of the bootstrap, and the level of the band.
_DRAWS, _LEVEL = 300, 0.95


@dataclass(frozen=True)
class Fitted:
    """A curve of one joint: its basis, white columns Z (M, k) with C = Q'Z, factors, fit, and where fine
    its gain on data left out."""

    joint: int
    basis: Basis
    Z: Array
    C: Array
    factors: Factors
    smooth: Smooth
    gain: float

    @property
    def coefficients(self) -> Array:
        """(k,) of what the model's own columns cannot make."""
        return np.asarray(splines.identifiable(self.factors, self.smooth.P) @ self.smooth.c)


class Look:
    """What a state leaves, ready to be compared with curves; settled : with the joints' levels such that
    what is left beside the curve in question is noise."""

    def __init__(self, state: SearchState, variables: Variables, settled: bool = False) -> None:
        self.settled = settled
        self.state, self.variables, self.fit = state, variables, state.fit
        self.noise, self.rows = state.stage.noise, state.stage.rows

    @cached_property
    def overlap(self) -> Array:
        """(B, r) block sums of Q r."""
        return self.fit.rows.block_sums(self.fit.Q * self.fit.residual[:, None])

    def white(self, columns: Array, joint: int) -> Array:
        """(M, k) columns of one joint, white and weighted like the rows."""
        gain = 1.0 if self.rows.gains is None else self.rows.gains[joint]
        pieces = self.rows.pieces(joint)
        return self.fit.weighting.apply(self.noise.whiten(gain * columns, joint, pieces), joint)

    def fitted(self, basis: Basis, joint: int, fine: bool) -> Fitted:
        """A curve on exact columns where ``fine``, with its gain."""
        columns = self.variables.exact(basis, joint) if fine else self.variables.coarse(basis)
        Z = self.white(columns, joint)
        factors, C = Factors.of(self.fit, Z, joint)
        gain = {} if self.settled else {"gain": partial(self.fit.joint_gains, joint)}
        found = splines.smooth(factors, basis.penalties, fine, **gain)
        left_out = splines.held_out_gain(self.fit, Z, C, factors, found.P, joint) if fine else 0.0
        return Fitted(joint, basis, Z, C, factors, found, left_out)

    def law(self, columns: Callable[[Array, Array], Array], constants: Array, f: Fitted) -> Array:
        """(M, m) white columns of a law of a curve's variables: columns(points (N, v), constants)."""
        parts = []
        for s in self.rows.segments:
            points = np.column_stack([a.variable.along(s.motion) for a in f.basis.axes])
            parts.append(s.low_pass @ columns(points, constants))
        return self.white(np.concatenate(parts), f.joint)


def effect_of(look: Look, found: Fitted, law: Callable[[Array], Array] | None = None) -> MeasuredCurve:
    """The curve as an effect: a table of its values, or of those that its law has at points (P, v),
    which also fills what was not measured between the ends."""
    robot = look.state.stage.candidacy.model.robot
    points = look.variables.supported(found.basis)
    if law is None:
        values, measured = found.basis.at(*points.T) @ found.coefficients, len(points)
    else:
        measured, points = len(points), np.vstack([points, unmeasured(found.basis, points)])
        values = law(points)
    return table_effect(robot, found.joint, found.basis.of, points, values, measured)


def unmeasured(basis: Basis, points: Array) -> Array:
    """(P', v) the points of a basis's grid that are not among ``points`` (P, v)."""
    have = {tuple(p) for p in points.tolist()}
    left = [p for p in basis.points.tolist() if tuple(p) not in have]
    return np.reshape(left, (-1, points.shape[1]))


def band(look: Look, found: Fitted, seed: int) -> Array:
    """(P,) half width, where measurements lie, of the band that holds _LEVEL of whole curves."""
    projector = splines.identifiable(found.factors, found.smooth.P)
    errors = splines.draws(look.fit, found.Z, found.C, found.smooth, found.joint, seed, _DRAWS)
    grid = found.basis.at(*look.variables.supported(found.basis).T)
    errors = errors @ projector.T @ grid.T
    deviation = np.maximum(errors.std(axis=0), 1e-300)
    largest = np.max(np.abs(errors) / deviation, axis=1)
    return np.asarray(np.quantile(largest, _LEVEL) * deviation)
