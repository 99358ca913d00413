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
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem
from sdp_vs_penalty.solvers.fit import Fit, dual_evidence
from sdp_vs_penalty.solvers.proof import Proof, infeasibility_proof
from sdp_vs_penalty.solvers.rigorous_bounds import lower_bound

#: Largest error of a search as a share of the function's local size: of the first one,
#: which only shows on what the end rests, and of the others.
_ROUGH, _FINE = 0.2, 3e-9
#: The rise of the loss that a search allows, over the rise that the search before it
#: needed: a margin, so that the search itself seldom needs more.
_MARGIN = 1.05
#: Further searches of an end at most, as long as it needs a larger rise than it had.
_ROUNDS = 4
#: Gap of an end as a share of its terms, up to which a quick certificate is enough.
_CERTAIN = 1e-7
#: Local length of a search's first step, and of those tried where an end is uncertain.
_FIRST_STEP, _OTHER_FIRST_STEPS = 0.7, (0.2, 2.0, 0.05)
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
        """Return what a file holds of a linear function's end; an end with a ray has the
        value -inf (least) or inf (greatest)."""
        closed = cls(end.value, end.decided_by, end.limited_by, attained=end.attained)
        if end.ray is None:
            return closed
        parameters = end.allowed.task.model.parameters
        changes = zip(parameters, end.ray.tolist(), strict=True)
        ray = {parameter.name: change for parameter, change in changes if change}
        return replace(closed, value=-end.sign * np.inf, ray=ray)


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
    ball_multiplier: float
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
    def data_gradient(self) -> Array:
        """(p,) gradient w = 2 l A^T (A theta - a) of the data's term l |A theta - a|^2 at
        the witness: the data limit the end through w^T theta alone; zero: not at all."""
        ball = self.allowed.ball
        residual = ball.A @ self.witness - ball.a
        return 2.0 * self.ball_multiplier * residual @ ball.A

    @cached_property
    def shift_by_bound(self) -> dict[str, float]:
        """How far the end moves as a bound doubles, to first order and as a share of the
        end's size, by the bound's name, the largest first. The far limits count as one.

        A bound moves the end by multiplier times bound. At an active bound
        a^T theta <= b both terms are equal, so that b is half of the sum of their sizes.
        """
        constraints = self.allowed.constraints
        entries = constraints.entries
        sizes = entries.each(entries.at(self.witness)[1])
        multipliers = entries.each(self.multipliers)
        shifts = dict[str, float]()
        for constraint, multiplier, size in zip(
            constraints.convex, multipliers, sizes, strict=True
        ):
            family = constraint.family
            if kind_of(constraint) == "consistency":
                continue
            name = FAR if family == FAR else f"{family} of {constraint.name}"
            change = 0.5 * float(np.sum(np.abs(multiplier) * size))
            shifts[name] = shifts.get(name, 0.0) + change / (self.size or 1.0)
        return dict(sorted(shifts.items(), key=lambda item: -item[1]))

    @property
    def limited_by(self) -> tuple[str, ...]:
        """Names of the bounds that the end follows, the far limits as one."""
        shifts = self.shift_by_bound.items()
        return tuple(name for name, shift in shifts if shift > CHANGES)

    @property
    def decided_by(self) -> str:
        """What decides the end, in a word: "open" (it has a :attr:`ray`), "bound",
        "data", "consistency", or "data and consistency".

        At the optimum g = -``data_gradient`` + the constraints' part. A part decides
        nothing if it is smaller than the share CHANGES of g.
        """
        if self.ray is not None:
            return "open"
        if self.limited_by:
            return "bound"
        # Parameters have different units: each counts in units of its fitted value.
        unit = np.abs(self.allowed.fit)
        negligible = CHANGES * np.linalg.norm(self.g * unit)
        by_constraints = np.linalg.norm((self.g + self.data_gradient) * unit)
        if by_constraints <= negligible:
            return "data"
        by_data = np.linalg.norm(self.data_gradient * unit)
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

        It proves infeasibility, by multipliers: the constraints and the data contradict
        the claim that the function, by this name, lies a millionth of its size beyond
        the end. `verify` accepts its file.
        """
        allowed = self.allowed
        in_ball, claim = self._data_constraint(), self._claim_beyond(name)
        parts = allowed.constraints.entries.each(self.multipliers)
        multipliers = dict(zip(allowed.constraints.convex, parts, strict=True))
        y = self._data_multiplier()
        multipliers[in_ball] = np.concatenate([[np.linalg.norm(y)], y])
        multipliers[claim] = np.ones(1)
        constraints = ConstraintSet((*allowed.constraints.convex, in_ball, claim))
        parameter_names = [q.name for q in allowed.task.model.parameters]
        flat = constraints.stack_multipliers(multipliers)
        problem = ConvexProblem.without_data(constraints, allowed.bound)
        return infeasibility_proof(problem, flat, parameter_names)

    def _data_constraint(self) -> Constraint:
        """Return the data's ball as a second-order cone: |A theta - a| <= radius."""
        ball = self.allowed.ball
        radius = np.sqrt(self.allowed.limit(self.rise))
        return build.linear(
            "data",
            f"weighted torque error within {radius:.6g} of least squares",
            np.arange(len(self.g)),
            np.column_stack([np.zeros(len(self.g)), ball.A.T]),
            np.concatenate([[radius], -ball.a]),
            cone="soc",
        )

    def _claim_beyond(self, name: str) -> Constraint:
        """Return the claim g^T theta <= lowest - clearance, which the proof refutes; its
        text is in terms of the function ``name``."""
        beyond = self.lowest - _CLEARANCE * self.size
        relation = "<=" if self.sign > 0.0 else ">="
        return build.linear(
            "claim",
            f"{name} {relation} {self.sign * beyond:.9g}",
            np.arange(len(self.g)),
            -self.g[:, None],
            [beyond],
        )

    def _data_multiplier(self) -> Array:
        """Return the multiplier y (r,) of the data's cone: A^T y is what the constraints'
        multipliers leave of g."""
        ball = self.allowed.ball
        entries = self.allowed.constraints.entries
        y = -2.0 * self.ball_multiplier * (ball.A @ self.witness - ball.a)
        leftover = entries.adjoint(self.multipliers, len(self.g)) - self.g
        # The second round removes what rounding has left of the first.
        for _ in range(2):
            y = y - ball.directions.T @ (leftover + y @ ball.A)
        return y


class EndSearch:
    """Ends of many functions over one set, each with its own rise c of the loss."""

    def __init__(self, allowed: AllowedSet, extra_rise: float = 0.0) -> None:
        """Prepare the search over a set.

        Parameters
        ----------
        extra_rise : float
            Added to each rise of the loss, for the model's own error [(N m)^2].
        """
        self.allowed = allowed
        self.extra_rise = extra_rise
        self._method = allowed.optimiser(allowed.first_rise + extra_rise)
        #: |A theta - a|^2 on the ball that has the radius 1 in the method's units.
        self._unit_limit = allowed.limit(allowed.first_rise + extra_rise)

    def least_ends(
        self, functions: Sequence[Array], denominators: Sequence[Array] | None = None
    ) -> list[End]:
        """Return the least value of each function g^T theta, or of each ratio v of
        g^T theta to m^T theta.

        The rise c of the loss up to which models count as fitting depends on the
        direction through which the data limit the end (:meth:`DataBall.rises`), which
        only the end itself shows. So each end is sought with a first c, and again with
        a c a little above what it needs, until that is enough.

        Parameters
        ----------
        functions : sequence of (p,) arrays
            Coefficients g.
        denominators : sequence of (p,) arrays, optional
            Coefficients m. An end is then that of g - v m, whose value is about zero.
        """
        if not functions:
            return []
        g = np.array(functions, float)
        m = np.zeros_like(g)
        if denominators is not None:
            m = np.reshape(denominators, g.shape)
        rises = np.full(len(g), self.allowed.first_rise)
        rough = self._minimise(g, m, rises, _ROUGH)
        rises = _MARGIN * self._needed_rises(rough)
        points = self._minimise(g, m, rises, _FINE, rough)
        for _ in range(_ROUNDS):
            needed = self._needed_rises(points)
            short = np.flatnonzero(needed > rises)
            if not len(short):
                break
            rises[short] = _MARGIN * needed[short]
            improved = self._minimise(
                g[short], m[short], rises[short], _FINE, rough[short]
            )
            points.put(short, improved)
        return [
            self._best_certified(g[k], m[k], points[k], rise)
            for k, rise in enumerate(rises.tolist())
        ]

    def least_and_greatest(self, functions: Sequence[Array]) -> list[tuple[End, End]]:
        """Return the least and the greatest value of each function g (p,); the greatest
        is minus the least one of -g."""
        ends = self.least_ends([sign * g for g in functions for sign in (1.0, -1.0)])
        return [
            (least, replace(least_of_negative, sign=-1.0))
            for least, least_of_negative in zip(ends[::2], ends[1::2], strict=True)
        ]

    def _minimise(
        self,
        g: Array,
        m: Array,
        rises: Array,
        accuracy: float,
        start: Points | None = None,
        first_step: float = _FIRST_STEP,
    ) -> Points:
        """Return the points with the least ratio g^T theta / m^T theta (m = 0: the least
        g^T theta) among models whose loss is at most ``rises`` above the least one.

        Parameters
        ----------
        g, m : (k, p) arrays
            Coefficients of k functions, and of their denominators.
        rises : (k,) array
            Rise of the loss that each function may use [weighted (N m)^2].
        start : Points, optional
            Solutions for the same functions with other rises.
        first_step : float
            Local length of the first step from the centre, where there is no ``start``.
        """
        limits = np.array([self.allowed.limit(c + self.extra_rise) for c in rises])
        return self._method.minimise(
            g,
            accuracy,
            m=m,
            start=start,
            squared_radius=limits / self._unit_limit,
            first_step=first_step,
        )

    def _best_certified(self, g: Array, m: Array, point: Points, rise: float) -> End:
        """Return the certified end at a point. If it is not certain, other first steps
        are tried, and the end with the smallest gap is returned: where a set is thin,
        rounding ends some paths early."""
        best = self._certified_end(point, rise)
        for first_step in _OTHER_FIRST_STEPS:
            if best.is_certain:
                break
            others = self._minimise(
                g[None], m[None], np.array([rise]), _FINE, first_step=first_step
            )
            other = self._certified_end(others[0], rise)
            best = max(best, other, key=lambda end: (-end.gap, end.lowest))
        return best

    def _needed_rises(self, points: Points) -> Array:
        """Return the rise c(w) (k,) for the gradient w of the data's term at each point;
        the first rise where the data do not limit the point (w = 0)."""
        allowed = self.allowed
        ball = allowed.ball
        residual = points.theta @ ball.A.T - ball.a
        gradients = points.ball_multiplier[:, None] * (residual @ ball.A)
        rises = ball.rises(gradients, allowed.z)
        return np.where(rises > 0.0, rises, allowed.first_rise)

    def _certified_end(self, point: Points, rise: float) -> End:
        """Return the end at a point that was found for a rise of the loss, with the
        lower bound of g^T theta that the point's multipliers prove:
        min [g^T x + l |A x - a|^2] - l limit (weak duality)."""
        allowed = self.allowed
        ball = allowed.ball
        g = point.g
        limit = allowed.limit(rise + self.extra_rise)
        # l, out of the method's units, in which the ball's radius is 1.
        ball_multiplier = float(point.ball_multiplier) / self._unit_limit
        root = np.sqrt(ball_multiplier)
        # The loss of these data is l |A x - a|^2.
        data = LeastSquares(root * ball.A, root * ball.a, 0.0, 0.0, 0)
        multipliers, _ = allowed.cones.multipliers(point.multipliers)
        problem = ConvexProblem(data, allowed.constraints, allowed.bound, linear=g)
        fit = Fit(point.theta, problem, multipliers)
        size = float(np.abs(g) @ np.abs(point.theta))
        lowest = -np.inf
        # Polished multipliers take longer: only where the quick bound is not tight.
        for polished in (False, True):
            least = lower_bound(problem, dual_evidence(fit, polished=polished))
            at_limit = ball_multiplier * limit
            # What l limit and the difference may have lost by rounding is subtracted.
            rounding = 4.0 * np.finfo(float).eps * (abs(least) + at_limit)
            lowest = max(lowest, least - at_limit - rounding)
            if float(g @ point.theta) - lowest <= _CERTAIN * size:
                break
        return End(
            allowed,
            g=g,
            lowest=lowest,
            witness=point.theta,
            rise=rise + self.extra_rise,
            ball_multiplier=ball_multiplier,
            multipliers=multipliers,
        )
