"""Ends of ranges: the least value of g^T theta over what data and constraints allow.

Weak duality, with any multipliers S_i in their cones and l >= 0:

    g^T theta >= min over the constraints of [g^T x + l |A x - a|^2] - l limit

for every allowed theta; :mod:`solvers.rigorous_bounds` bounds the minimum on the right
whatever was rounded. The solver's point is strictly inside: it is the witness, a consistent
model that fits and has nearly that value. The greatest value is minus the least one of -g.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sdp_vs_penalty.estimation.constants import CHANGES
from sdp_vs_penalty.ranges.allowed import FAR, AllowedSet, kind_of
from sdp_vs_penalty.ranges.interior_point import Points
from sdp_vs_penalty.ranges.rays import certified_ray
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import ConstraintSet
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem
from sdp_vs_penalty.solvers.fit import Fit, dual_evidence
from sdp_vs_penalty.solvers.proof import Proof, infeasibility_proof
from sdp_vs_penalty.solvers.rigorous_bounds import lower_bound

#: Largest error of a search as a share of the function's local size: of the first one,
#: which only shows on what the end rests, and of the others.
_ROUGH, _FINE = 0.2, 3e-9
#: The c of a search, over that which the search before it needed: a margin, so that the
#: search itself seldom needs more.
_MARGIN = 1.05
#: Further searches of an end at most, as long as it needs more than its c.
_ROUNDS = 4
#: Gap of an end as a share of its terms, up to which a quick certificate is enough.
_CERTAIN = 1e-7
#: Local length of a search's first step, and of those tried where an end is uncertain.
_FIRST, _OTHER_STARTS = 0.7, (0.2, 2.0, 0.05)
#: Share of an end's size by which a proof's claim lies beyond it: what is proved to be
#: empty must be so strictly.
_CLEARANCE = 1e-6


@dataclass(frozen=True)
class RangeEnd(JsonRecord):
    """One end of a range."""

    #: Certified: nothing allowed lies beyond it; infinite where the end is open.
    value: float
    #: "data", "consistency", "data and consistency", "bound" or "open".
    decided_by: str
    #: Names of the bounds that it follows, the strongest first; "far limit" for all far
    #: limits together.
    limited_by: tuple[str, ...] = ()
    #: Whether the true end may lie inside: a relaxation's bound.
    is_outer: bool = False
    #: Value of a consistent model that fits, on the inner side.
    attained: float = np.nan
    #: Of an open end: a change of parameters, by name, that no torque shows. Any multiple
    #: of it leaves models consistent; each one moves the function by 1.
    ray: Mapping[str, float] = field(default_factory=dict)

    @property
    def reason(self) -> str:
        """What decides the end; a bound by the name of the first one."""
        if self.decided_by != "bound":
            return self.decided_by
        first, *others = self.limited_by
        more = f" and {len(others)} more" if others else ""
        return first.replace(" of link", ", link") + more

    @classmethod
    def from_end(cls, end: End) -> RangeEnd:
        """Return what a file holds of a linear function's end."""
        out = cls(end.value, end.decided_by, end.limited_by, attained=end.attained)
        if end.ray is None:
            return out
        parameters = end.allowed.task.model.parameters
        change = zip(parameters, end.ray.tolist(), strict=True)
        ray = {parameter.name: x for parameter, x in change if x}
        return replace(out, value=-end.sign * np.inf, ray=ray)


@dataclass(frozen=True)
class End:
    """The least value of a linear function g^T theta, or the greatest one of -g."""

    #: The set over which it is an end.
    allowed: AllowedSet
    #: (p,) coefficients g of what is minimised.
    g: Array
    #: Certified: no allowed theta has a smaller g^T theta.
    lowest: float
    #: (p,) the witness: an allowed theta, strictly inside.
    witness: Array
    #: Rise c of the loss above the least one up to which models count as fitting here.
    rise: float
    #: Multiplier l of the data's ball.
    ball: float
    #: (e,) multipliers of the constraints' entries.
    multipliers: Array
    #: 1 where g^T theta is the function, -1 where it is minus the function.
    sign: float = 1.0

    @property
    def value(self) -> float:
        """Certified end of the function: no allowed theta has a value beyond it."""
        return self.sign * self.lowest

    @property
    def attained(self) -> float:
        """The function's value at the witness."""
        return self.sign * float(self.g @ self.witness)

    @property
    def gap(self) -> float:
        """Distance between the certified end and the witness [unit of the function]."""
        return abs(self.attained - self.value)

    @property
    def is_certain(self) -> bool:
        """Whether the witness is as near as a user can tell."""
        return self.gap <= _CERTAIN * self.size

    @cached_property
    def size(self) -> float:
        """Size of the function's terms at the best fit, with which shares are formed."""
        return max(float(np.abs(self.g) @ np.abs(self.allowed.fit)), abs(self.attained))

    @cached_property
    def rests_on(self) -> Array:
        """(p,) w: the data limit the end through w^T theta alone; zero if not at all."""
        ball = self.allowed.ball
        return 2.0 * self.ball * (ball.A @ self.witness - ball.a) @ ball.A

    @cached_property
    def bounds(self) -> dict[str, float]:
        """How far the end moves as a bound doubles, to first order and as a share of the
        end's size, by the bound's name, the largest first. The far limits count as one.

        It is the multiplier times the bound, which is half of the terms compared."""
        constraints = self.allowed.constraints
        entries = constraints.entries
        terms = entries.each(entries.at(self.witness)[1])
        out = dict[str, float]()
        for c, z, size in zip(
            constraints.convex, entries.each(self.multipliers), terms, strict=True
        ):
            if kind_of(c) == "consistency":
                continue
            name = FAR if c.family == FAR else f"{c.family} of {c.name}"
            moves = 0.5 * float(np.sum(np.abs(z) * size)) / (self.size or 1.0)
            out[name] = out.get(name, 0.0) + moves
        return dict(sorted(out.items(), key=lambda item: -item[1]))

    @property
    def limited_by(self) -> tuple[str, ...]:
        """Names of the bounds that the end follows, the far limits as one."""
        return tuple(name for name, moves in self.bounds.items() if moves > CHANGES)

    @property
    def decided_by(self) -> str:
        """What decides the end, in a word: "open" (it has a :attr:`ray`), "bound",
        "data", "consistency", or "data and consistency".

        At the end g is the sum of what the data and what the constraints hold against
        it: -``rests_on``, and the rest. A part below CHANGES (in size) decides nothing.
        """
        if self.ray is not None:
            return "open"
        if self.limited_by:
            return "bound"
        unit = np.abs(self.allowed.fit)
        negligible = CHANGES * np.linalg.norm(self.g * unit)
        if np.linalg.norm((self.g + self.rests_on) * unit) <= negligible:
            return "data"
        by_data = np.linalg.norm(self.rests_on * unit)
        return "data and consistency" if by_data > negligible else "consistency"

    @cached_property
    def ray(self) -> Array | None:
        """(p,) direction along which the function goes beyond the end by 1, and on
        without end; None where none was found, and for an end that does not follow the
        far limits."""
        if FAR not in self.limited_by:
            return None
        return certified_ray(self.allowed, self.g, self.rise)

    def proof(self, name: str) -> Proof:
        """Return a proof in exact arithmetic that nothing allowed lies beyond the end.

        It is one of infeasibility: three things contradict each other, with multipliers
        that show it. `verify` accepts its file. They are the constraints; the data, as a
        second-order cone; and the claim that the function, by this name, lies a
        millionth of its size beyond the end.
        """
        allowed = self.allowed
        ball = allowed.ball
        # 1. The data: |A theta - a| is at most the radius.
        radius = np.sqrt(allowed.limit(self.rise))
        all_places = np.arange(len(self.g))
        in_ball = build.linear(
            "data",
            f"weighted torque error within {radius:.6g} of least squares",
            all_places,
            np.column_stack([np.zeros(len(self.g)), ball.A.T]),
            np.concatenate([[radius], -ball.a]),
            cone="soc",
        )
        # 2. The claim: g^T theta is less than what is proved of it.
        beyond = self.lowest - _CLEARANCE * self.size
        relation = "<=" if self.sign > 0.0 else ">="
        claim = build.linear(
            "claim",
            f"{name} {relation} {self.sign * beyond:.9g}",
            all_places,
            -self.g[:, None],
            [beyond],
        )
        # 3. Multipliers: those of the end for the constraints, y for the data.
        entries = allowed.constraints.entries
        parts = entries.each(self.multipliers)
        multipliers = dict(zip(allowed.constraints.convex, parts, strict=True))
        # A^T y takes up all that the other multipliers leave of g in seen directions;
        # the second round takes up what rounding has left of the first.
        residual = ball.A @ self.witness - ball.a
        y = -2.0 * self.ball * residual
        pulled = entries.adjoint(self.multipliers, len(self.g)) - self.g
        for _ in range(2):
            y = y - ball.directions.T @ (pulled + y @ ball.A)
        multipliers[in_ball] = np.concatenate([[np.linalg.norm(y)], y])
        multipliers[claim] = np.ones(1)
        constraints = ConstraintSet((*allowed.constraints.convex, in_ball, claim))
        names = [q.name for q in allowed.task.model.parameters]
        flat = constraints.stack_multipliers(multipliers)
        nothing = ConvexProblem.without_data(constraints, allowed.bound)
        return infeasibility_proof(nothing, flat, names)


class EndSearch:
    """Ends of many functions over one set, each with its own rise c of the loss."""

    def __init__(self, allowed: AllowedSet, more: float = 0.0) -> None:
        """Prepare the search over a set.

        Parameters
        ----------
        more : float
            Added to each rise c of the loss: the model's error [(N m)^2].
        """
        self.allowed = allowed
        self.more = more
        self._method = allowed.optimiser(allowed.first_rise + more)
        self._unit = allowed.limit(allowed.first_rise + more)

    def least(
        self, functions: Sequence[Array], masses: Sequence[Array] | None = None
    ) -> list[End]:
        """Return the least value of each function g (p,), with its own c: the loss above
        the least one up to which models count as fitting.

        With ``masses`` m (p,) it is the least ratio v of g^T theta to m^T theta: the
        ends are those of g - v m, whose values are about zero.

        An end needs the c of the directions that it rests on, which the end itself
        shows. So it is found for a first c, and again for a c a little above the one
        that it needs, until that is enough.
        """
        if not functions:
            return []
        g = np.array(functions, float)
        m = np.zeros_like(g) if masses is None else np.reshape(masses, g.shape)
        c = np.full(len(g), self.allowed.first_rise)
        rough = self._points(g, m, c, _ROUGH)
        c = _MARGIN * self._rises_of(rough)
        points = self._points(g, m, c, _FINE, rough)
        for _ in range(_ROUNDS):
            needed = self._rises_of(points)
            wider = np.flatnonzero(needed > c)
            if not len(wider):
                break
            c[wider] = _MARGIN * needed[wider]
            again = self._points(g[wider], m[wider], c[wider], _FINE, rough[wider])
            points.put(wider, again)
        return [
            self._best_certified(g[k], m[k], points[k], rise)
            for k, rise in enumerate(c.tolist())
        ]

    def _points(
        self,
        g: Array,
        m: Array,
        rises: Array,
        accuracy: float,
        start: Points | None = None,
        first: float = _FIRST,
    ) -> Points:
        """Return the points at which functions g (k, p), over m, are least where the
        loss may rise by ``rises`` (k,); ``start`` are such points of other rises,
        ``first`` the length of a first step without one."""
        limits = np.array([self.allowed.limit(c + self.more) for c in rises])
        return self._method.minimise(
            g,
            accuracy,
            m=m,
            start=start,
            squared_radius=limits / self._unit,
            first=first,
        )

    def _best_certified(self, g: Array, m: Array, point: Points, rise: float) -> End:
        """Return the end at a point, or the best one of searches from other starts:
        where a set is thin, rounding ends some paths early."""
        best = self.certified(point, rise)
        for first in _OTHER_STARTS:
            if best.is_certain:
                break
            others = self._points(
                g[None], m[None], np.array([rise]), _FINE, first=first
            )
            other = self.certified(others[0], rise)
            best = max(best, other, key=lambda end: (-end.gap, end.lowest))
        return best

    def both(self, functions: Sequence[Array]) -> list[tuple[End, End]]:
        """Return the least and the greatest value of each function g (p,)."""
        ends = self.least([sign * g for g in functions for sign in (1.0, -1.0)])
        return [
            (low, replace(high, sign=-1.0))
            for low, high in zip(ends[::2], ends[1::2], strict=True)
        ]

    def _rises_of(self, points: Points) -> Array:
        """Return the c (k,) of the directions of the data that each point rests on; the
        first c where it rests on none."""
        allowed = self.allowed
        ball = allowed.ball
        w = points.ball[:, None] * ((points.theta @ ball.A.T - ball.a) @ ball.A)
        c = ball.rises(w, allowed.z)
        return np.where(c > 0.0, c, allowed.first_rise)

    def certified(self, point: Points, rise: float) -> End:
        """Return the end at a point that was found for a rise of the loss, with the
        lower bound of g^T theta that the point's multipliers prove."""
        allowed = self.allowed
        ball = allowed.ball
        limit = allowed.limit(rise + self.more)
        g = point.g
        weight = float(point.ball) / self._unit  # the method's ball is in this unit
        root = np.sqrt(weight)
        # The loss of these data is l |A x - a|^2.
        data = LeastSquares(root * ball.A, root * ball.a, 0.0, 0.0, 0)
        multipliers, _ = allowed.cones.multipliers(point.multipliers)
        problem = ConvexProblem(data, allowed.constraints, allowed.bound, linear=g)
        fit = Fit(point.theta, problem, multipliers)
        lowest = -np.inf
        for polished in (False, True):
            least = lower_bound(problem, dual_evidence(fit, polished=polished))
            # What l limit and the difference may have lost by rounding is subtracted.
            rounding = 4.0 * np.finfo(float).eps * (abs(least) + weight * limit)
            lowest = max(lowest, least - weight * limit - rounding)
            size = float(np.abs(g) @ np.abs(point.theta))
            if float(g @ point.theta) - lowest <= _CERTAIN * size:
                break
        return End(
            allowed,
            g=g,
            lowest=lowest,
            witness=point.theta,
            rise=rise + self.more,
            ball=weight,
            multipliers=multipliers,
        )
