"""What a curve may run over, and the splines that it is made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.curve_variable import Variable
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.transmission_friction import combinations
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.segments import SegmentedRuns

_DEGREE = 3
#: Splines along one variable, and along each of a pair.
_ALONE, _PAIR = 32, 9


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
        return self.variable.word == "sign(dq)"

    def columns(self, x: Array) -> Array:
        """(N, count) of the splines."""
        if self.is_sign:
            return np.column_stack([np.ones_like(x), x])
        from scipy.interpolate import BSpline  # its import takes longer than a report

        # The last knot belongs to what lies below it.
        inside = np.clip(x, self.low, self.high - 1e-9 * (self.high - self.low))
        step = (self.high - self.low) / (self.count - _DEGREE)
        knots = self.low + step * np.arange(-_DEGREE, self.count + 1)
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

    @property
    def points(self) -> Array:
        """Where the curve is written down: at its knots, and at three values between each."""
        count = 4 * (self.count - _DEGREE) + 1
        return np.array([-1.0, 1.0]) if self.is_sign else np.linspace(self.low, self.high, count)


@dataclass(frozen=True)
class Basis:
    """Splines over one variable, or the products of those over two."""

    axes: tuple[Axis, ...]

    @property
    def of(self) -> tuple[str, ...]:
        """The variables as they are written."""
        return tuple(a.variable.name for a in self.axes)

    @property
    def size(self) -> int:
        return int(np.prod([a.count for a in self.axes]))

    def at(self, *values: Array) -> Array:
        """(N, size) at given values of the variables."""
        return _products([axis.columns(x) for axis, x in zip(self.axes, values, strict=True)])

    def of_motion(self, motion: Motion) -> Array:
        """(N, size) along a motion."""
        return self.at(*(a.variable.along(motion) for a in self.axes))

    @property
    def penalties(self) -> list[Array]:
        """(size, size) roughness along each variable, each of unit trace."""
        out, counts = [], [a.count for a in self.axes]
        for k, axis in enumerate(self.axes):
            if not axis.is_sign:
                before, after = (np.eye(int(np.prod(c))) for c in (counts[:k], counts[k + 1 :]))
                rough = np.kron(np.kron(before, axis.penalty), after)
                out.append(rough / np.trace(rough))
        return out

    @property
    def grid(self) -> tuple[Array, ...]:
        """The values at which the curve is written down, per variable."""
        return tuple(a.points for a in self.axes)

    @property
    def points(self) -> Array:
        """(P, variables) all of the grid."""
        return np.array(list(product(*self.grid)))


def _products(columns: Sequence[Array]) -> Array:
    """(N, size) every product of one column (N, k) of each."""
    out = columns[0]
    for own in columns[1:]:
        out = (out[:, :, None] * own[:, None, :]).reshape(len(out), -1)
    return out


def pairs_of(j: int, robot: Robot, warm: bool = False) -> list[tuple[Variable, ...]]:
    """Everything that a curve of joint j may run over, one variable first; warm : with
    temperatures."""
    others = [i for i in range(robot.n) if i != j]
    own = [Variable(w, j) for w in ("q", "dq", "ddq", "abs(ddq)", "tau", "sign(dq)")]
    own += [Variable("temp", j)] * warm
    own += [Variable("t"), *(Variable(w, i) for i in others for w in ("q", "dq"))]
    for ratios in (c for first in range(j + 1) for c in combinations(robot, first)):
        at = [int(key[1:]) - 1 for key in ratios]
        if len(at) == 2 and j in at:
            ratio = ratios[f"c{at[1] + 1}"] / ratios[f"c{at[0] + 1}"]
            own += [Variable(w, at[0], at[1], ratio) for w in ("q", "dq")]
    alone = [("q", "dq"), ("q", "sign(dq)"), ("dq", "tau"), ("q", "tau"), ("dq", "ddq"), ("q", "ddq")]
    alone += [("tau", "sign(dq)"), ("abs(ddq)", "sign(dq)")]
    mixed = [("q", "q"), ("q", "dq"), ("q", "sign(dq)"), ("dq", "dq")]
    pairs = [(Variable(a, j), Variable(b, j)) for a, b in alone]
    pairs += [(Variable(a, i), Variable(b, j)) for i in others for a, b in mixed]
    return [*((v,) for v in own), *pairs]


class Variables:
    """The values of all variables on the rows, filtered; and bases in their ranges."""

    def __init__(self, rows: SegmentedRuns, robot: Robot) -> None:
        self.rows, self.robot = rows, robot
        self.keep = np.asarray(rows.keep.any(axis=1), bool)
        self.warm = all(s.motion.temperature is not None for s in rows.segments)
        self.on_rows, self._splines = lru_cache(self._on_rows_of), lru_cache(self._splines_of)

    def _filtered(self, dense: Callable[[Motion], Array]) -> Array:
        """(M, ...) of what is worked out along the motion."""
        return np.concatenate([s.low_pass @ dense(s.motion) for s in self.rows.segments])

    def _on_rows_of(self, v: Variable) -> Array:
        """(M,) low-passed."""
        return self._filtered(v.along)

    def basis(self, of: tuple[Variable, ...]) -> Basis | None:
        """None where a variable stands still."""
        axes = []
        pair = len([v for v in of if v.word != "sign(dq)"]) > 1
        for v in of:
            x = self.on_rows(v)[self.keep]
            low, high = float(f"{x.min():.6g}"), float(f"{x.max():.6g}")
            if v.word == "sign(dq)":
                low, high, count = -1.0, 1.0, 2
            else:
                count = _PAIR if pair else _ALONE
            if not high - low > 1e-6:
                return None
            axes.append(Axis(v, low, high, count))
        return Basis(tuple(axes))

    def coarse(self, basis: Basis) -> Array:
        """(M, size) of the filtered variables: nearly the filtered splines."""
        return _products([self._splines(a) for a in basis.axes])

    def _splines_of(self, axis: Axis) -> Array:
        """(M, count) of one variable on the rows."""
        return axis.columns(self.on_rows(axis.variable))

    def exact(self, basis: Basis) -> Array:
        """(M, size) filtered splines."""
        return self._filtered(basis.of_motion)

    def of_law(self, basis: Basis, law: Callable[[Array], Array]) -> Array:
        """(M, m) filtered columns of a law, which says them at points (P, v)."""
        return self._filtered(lambda m: law(np.column_stack([a.variable.along(m) for a in basis.axes])))

    def supported(self, basis: Basis) -> Array:
        """(P, variables) the points of the basis's grid within a step of which the motion has been."""
        return basis.points[self.met(basis, self.keep)]

    def met(self, basis: Basis, which: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Of all points of a basis's grid, those near which some of the rows (M,) lie."""
        near = [np.ones((int(which.sum()), 1))]
        for axis, points in zip(basis.axes, basis.grid, strict=True):
            step = (points[-1] - points[0]) / (len(points) - 1)
            reach = 0.2 if axis.is_sign else 1.001 * step
            own = np.abs(self.on_rows(axis.variable)[which, None] - points) <= reach
            near.append(own.astype(float))
        return np.asarray(near[-2].T @ near[-1] > 0.0).ravel()  # of a pair both at once
