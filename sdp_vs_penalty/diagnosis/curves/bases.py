"""What a curve may run over, and the splines that it is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from scipy.interpolate import BSpline

from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.measured_curve import variable, variable_name
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.segments import SegmentedRuns

#: A variable of a curve: its word (of measured_curve.VARIABLES) and its joint, from 0.
Variable = tuple[str, int]

_DEGREE = 3
#: Splines along a position, along anything else, and along each variable of a pair.
_POSITION, _OTHER, _PAIR = 32, 20, 9
#: Values of the table that is written down, along one variable and along each of a pair.
_POINTS, _PAIR_POINTS = 81, 25


@dataclass(frozen=True)
class Axis:
    """Cubic B-splines of one variable between the ends of its range, held constant outside; of the sign
    of a velocity the constant and the sign itself."""

    variable: Variable
    low: float
    high: float
    count: int

    @property
    def is_sign(self) -> bool:
        return self.variable[0] == "sign(dq)"

    def columns(self, x: Array) -> Array:
        """(N, count) of the splines."""
        if self.is_sign:
            return np.column_stack([np.ones_like(x), x])
        step = (self.high - self.low) / (self.count - _DEGREE)
        knots = self.low + step * np.arange(-_DEGREE, self.count + 1)
        # The last knot belongs to what lies below it.
        inside = np.clip(x, self.low, self.high - 1e-9 * (self.high - self.low))
        return np.asarray(BSpline.design_matrix(inside, knots, _DEGREE).toarray())

    @property
    def penalty(self) -> Array:
        """(count, count) of second differences of the coefficients (Eilers, Marx 1996). Where splines
        are many, also of first ones, as large as they are for a wave as long as the range: where few
        measurements lie, such a curve levels off instead of going on straight."""
        if self.is_sign:
            return np.zeros((2, 2))
        first, second = (np.diff(np.eye(self.count), k, axis=0) for k in (1, 2))
        level = 0.0 if self.count == _PAIR else (2.0 * np.pi / self.count) ** 2
        return np.asarray(second.T @ second + level * first.T @ first)

    def points(self, count: int) -> Array:
        """Where the curve is written down."""
        return np.array([-1.0, 1.0]) if self.is_sign else np.linspace(self.low, self.high, count)


@dataclass(frozen=True)
class Basis:
    """Splines over one variable, or the products of those over two."""

    axes: tuple[Axis, ...]

    @property
    def of(self) -> tuple[str, ...]:
        """The variables as they are written."""
        return tuple(variable_name(*a.variable) for a in self.axes)

    @property
    def size(self) -> int:
        return int(np.prod([a.count for a in self.axes]))

    def at(self, *values: Array) -> Array:
        """(N, size) at given values of the variables."""
        return _products([axis.columns(x) for axis, x in zip(self.axes, values, strict=True)])

    def of_motion(self, motion: Motion, joint: int) -> Array:
        """(N, size) along a motion."""
        return self.at(*(variable(motion, *a.variable) for a in self.axes))

    @property
    def penalties(self) -> list[Array]:
        """(size, size) roughness along each variable."""
        return _penalties(tuple((a.count, a.is_sign) for a in self.axes))

    @property
    def grid(self) -> tuple[Array, ...]:
        """The values at which the curve is written down, per variable."""
        count = _POINTS if len([a for a in self.axes if not a.is_sign]) == 1 else _PAIR_POINTS
        return tuple(a.points(count) for a in self.axes)

    @property
    def points(self) -> Array:
        """(P, variables) all of the grid."""
        return np.array(list(product(*self.grid)))


@cache
def _penalties(axes: tuple[tuple[int, bool], ...]) -> list[Array]:
    """Those of the products of splines along axes, each of so many splines, or a sign."""
    out = []
    for k, (count, is_sign) in enumerate(axes):
        if not is_sign:
            before, after = (int(np.prod([c for c, _ in part])) for part in (axes[:k], axes[k + 1 :]))
            own = Axis(("", 0), 0.0, 1.0, count).penalty
            out.append(np.kron(np.kron(np.eye(before), own), np.eye(after)))
    return out


def _products(columns: Sequence[Array]) -> Array:
    """(N, size) every product of one column (N, k) of each."""
    out = columns[0]
    for own in columns[1:]:
        out = (out[:, :, None] * own[:, None, :]).reshape(len(out), -1)
    return out


def pairs_of(j: int, n: int, warm: bool = False) -> list[tuple[Variable, ...]]:
    """Everything that a curve of joint j may run over, one variable first; warm : with temperatures."""
    others = [i for i in range(n) if i != j]
    out: list[tuple[Variable, ...]] = [
        ((w, j),) for w in ("q", "dq", "ddq", "abs(ddq)", "tau", "sign(dq)")
    ]
    out += [(("temp", j),)] * warm
    out += [(("t", 0),), *(((w, i),) for i in others for w in ("q", "dq"))]
    own = [("q", "dq"), ("q", "sign(dq)"), ("dq", "tau"), ("q", "tau"), ("dq", "ddq"), ("q", "ddq")]
    own += [("tau", "sign(dq)"), ("abs(ddq)", "sign(dq)")]
    out += [((a, j), (b, j)) for a, b in own]
    mixed = [("q", "q"), ("q", "dq"), ("q", "sign(dq)"), ("dq", "dq")]
    return out + [((a, i), (b, j)) for i in others for a, b in mixed]


class Variables:
    """The values of all variables on the rows, filtered; and bases in their ranges."""

    def __init__(self, rows: SegmentedRuns) -> None:
        self.rows = rows
        self.keep = np.asarray(rows.keep.any(axis=1), bool)
        self.warm = all(s.motion.temperature is not None for s in rows.segments)
        self._rows: dict[Variable, Array] = {}
        self._axes: dict[Axis, Array] = {}

    def on_rows(self, v: Variable) -> Array:
        """(M,) low-passed."""
        if v not in self._rows:
            parts = [s.low_pass @ variable(s.motion, *v) for s in self.rows.segments]
            self._rows[v] = np.concatenate(parts)
        return self._rows[v]

    def basis(self, of: Sequence[Variable]) -> Basis | None:
        """None where a variable stands still."""
        axes = []
        pair = len([v for v in of if v[0] != "sign(dq)"]) > 1
        for v in of:
            x = self.on_rows(v)[self.keep]
            low, high = float(f"{x.min():.6g}"), float(f"{x.max():.6g}")
            if v[0] == "sign(dq)":
                low, high, count = -1.0, 1.0, 2
            else:
                count = _PAIR if pair else (_POSITION if v[0] == "q" else _OTHER)
            if not high - low > 1e-6:
                return None
            axes.append(Axis(v, low, high, count))
        return Basis(tuple(axes))

    def coarse(self, basis: Basis) -> Array:
        """(M, size) of the filtered variables: nearly the filtered splines."""
        return _products([self._splines(a) for a in basis.axes])

    def _splines(self, axis: Axis) -> Array:
        """(M, count) of one variable on the rows; kept."""
        if axis not in self._axes:
            self._axes[axis] = axis.columns(self.on_rows(axis.variable))
        return self._axes[axis]

    def exact(self, basis: Basis, joint: int) -> Array:
        """(M, size) filtered splines."""
        parts = [s.low_pass @ basis.of_motion(s.motion, joint) for s in self.rows.segments]
        return np.concatenate(parts)

    def supported(self, basis: Basis) -> Array:
        """(P, variables) the points of the basis's grid within a step of which the motion has been."""
        near = np.ones((len(self.keep), 1), bool)
        for axis, points in zip(basis.axes, basis.grid, strict=True):
            step = (points[-1] - points[0]) / (len(points) - 1)
            reach = 0.2 if axis.is_sign else 1.001 * step
            own = np.abs(self.on_rows(axis.variable)[:, None] - points) <= reach
            near = (near[:, :, None] & own[:, None, :]).reshape(len(near), -1)
        return np.asarray(basis.points[near[self.keep].any(axis=0)])
