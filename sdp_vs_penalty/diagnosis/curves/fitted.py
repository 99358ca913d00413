"""A curve fitted to what a state leaves of a joint, before anything is decided about it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy import sparse

from sdp_vs_penalty.diagnosis.curves import smooth as splines
from sdp_vs_penalty.diagnosis.curves.bases import Basis, Variables
from sdp_vs_penalty.diagnosis.curves.curve import table_effect
from sdp_vs_penalty.diagnosis.curves.smooth import Factors, Smooth
from sdp_vs_penalty.diagnosis.state import SearchState
from sdp_vs_penalty.effects.measured_curve import MeasuredCurve
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.autoregression import ORDER

#: Draws of the bootstrap, and the level of the band.
_DRAWS, _LEVEL = 300, 0.95
#: Numbers of the columns that are screened at once.
_AT_ONCE = 400_000


@dataclass(frozen=True)
class Fitted:
    """A curve of one joint: its basis, its columns (M, k), not white, and its fit."""

    basis: Basis
    columns: Array
    smooth: Smooth

    @property
    def factors(self) -> Factors:
        return self.smooth.factors

    @property
    def joint(self) -> int:
        return self.factors.joint

    @cached_property
    def gain(self) -> float:
        """On data left out."""
        return splines.held_out_gain(self.factors, self.smooth.P)

    @cached_property
    def projector(self) -> Array:
        """(k, k) onto what the model's own columns cannot make."""
        return splines.identifiable(self.factors, self.smooth.P)

    @property
    def coefficients(self) -> Array:
        """(k,) of what the model's own columns cannot make."""
        return np.asarray(self.projector @ self.smooth.c)


class Screened(NamedTuple):
    """A rough curve: its evidence, the weight of its roughness, and how its blocks agree (B, B)."""

    basis: Basis
    evidence: float
    weight: float
    agreeing: Array


class Look:
    """What a state leaves, ready to be compared with curves; settled : with the joints' levels such that
    what is left beside the curve in question is noise."""

    def __init__(self, state: SearchState, variables: Variables, settled: bool = False) -> None:
        self.settled = settled
        self.state, self.variables, self.fit = state, variables, state.fit
        self.noise, self.rows = state.stage.noise, state.stage.rows
        self._filter = cache(self._filter_of)

    @cached_property
    def overlap(self) -> Array:
        """(B, r) block sums of Q r."""
        return self.fit.rows.block_sums(self.fit.Q * self.fit.residual[:, None])

    def white(self, columns: Array, joint: int) -> Array:
        """Columns (M, k) of one joint, white and weighted like the rows."""
        return np.asarray(self._filter(joint) @ columns)

    def _filter_of(self, joint: int) -> sparse.csr_array:
        """(M, M) what makes columns white: two autoregressions, one behind the other, read off combs."""
        M, teeth = len(self.rows.t), 2 * ORDER + 1
        row, column = np.arange(M)[:, None], np.arange(M)[:, None] - np.arange(teeth)
        comb = self.noise.whiten(1.0 * (row % teeth == np.arange(teeth)), joint, self.rows.pieces(joint))
        comb = self.fit.weighting.apply(comb, joint)[row, column % teeth]
        at = np.nonzero((column >= 0) & (comb != 0.0))
        return sparse.csr_array((comb[at], (at[0], column[at])), shape=(M, M))

    def _gain(self, joint: int) -> splines.Gain:
        return None if self.settled else partial(self.fit.joint_gains, joint)

    def _torque(self, columns: Array, joint: int) -> Array:
        return columns if self.rows.gains is None else self.rows.gains[joint] * columns

    def screened(self, bases: Sequence[Basis], joint: int) -> Iterator[Screened]:
        """Rough curves over bases of one kind for which there is evidence; few at once."""
        step = max(1, _AT_ONCE // (len(self.rows.t) * bases[0].size))
        for some in (bases[k : k + step] for k in range(0, len(bases), step)):
            every = [self.variables.coarse(b) for b in some]
            columns = np.hstack(every) if len(every) > 1 else every[0]
            white = self.white(self._torque(columns, joint), joint)
            factors = Factors.several(self.fit, white, joint, len(some))
            fits = splines.smooth_all(factors, some[0].penalties, self._gain(joint))
            for basis, f in zip(some, fits, strict=True):
                if f.evidence > 0.0:
                    yield Screened(basis, f.evidence, f.weight, splines.agreement(f, self.overlap))

    def fitted(self, basis: Basis, joint: int, near: float) -> Fitted:
        """A curve on exact columns; near : the weight of the roughness of one like it."""
        columns = self._torque(self.variables.exact(basis), joint)
        factors = Factors.of(self.fit, self.white(columns, joint), joint)
        found = splines.smooth(factors, basis.penalties, self._gain(joint), near)
        return Fitted(basis, columns, found)

    def law(self, columns: Callable[[Array, Array], Array], constants: Array, f: Fitted) -> Array:
        """(M, ...) of a law of a curve's variables on the rows: columns(points (N, v), constants)."""
        parts = []
        for s in self.rows.segments:
            points = np.column_stack([a.variable.along(s.motion) for a in f.basis.axes])
            dense = columns(points, constants)
            parts.append((s.low_pass @ dense.reshape(len(dense), -1)).reshape(-1, *dense.shape[1:]))
        return self._torque(np.concatenate(parts), f.joint)


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
    errors = splines.draws(found.smooth, seed, _DRAWS)
    grid = found.basis.at(*look.variables.supported(found.basis).T)
    errors = errors @ found.projector.T @ grid.T
    deviation = np.maximum(errors.std(axis=0), 1e-300)
    largest = np.max(np.abs(errors) / deviation, axis=1)
    return np.asarray(np.quantile(largest, _LEVEL) * deviation)
