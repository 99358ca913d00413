"""The set of models that data and constraints allow,

    {theta : every F_i(theta) in its cone,   |A theta - a|^2 <= loss* - loss_ls + c},

with |A theta - a|^2 = loss(theta) - loss_ls, loss_ls that of least squares and loss* the least
one under the constraints. A = U^T R_lead B: B theta are the base parameters, R_lead their columns
of the data's triangle R, U an orthonormal basis of these columns. Directions that no torque shows
are left out exactly.

c is a likelihood ratio. An end of a range rests on the data through one function w^T theta
alone, the slope of the loss there: every consistent theta beyond the end has a w^T theta
below the one at the end. c is therefore what the interval of w^T theta says, with the
noise's correlation, the effective rows and all else that intervals have:

    c(w) = (half-width of w^T theta's interval)^2 / |w|^2,      |w| in the metric of A.

Where the residual is more structure than noise, a model's error may hide in the columns as
well as beside them. The second, wider c adds the loss that noise does not explain: the
consistent model may differ from the best one by as much torque (root mean square) as the
best one, noise aside, differs from the measured torque.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import (
    EstimationProblem,
    with_errors_of_constants,
)
from sdp_vs_penalty.estimation.constants import LEVEL
from sdp_vs_penalty.estimation.uncertainty import linear_spread
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import interior_point
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.ranges.interior_point import Ball, InteriorPoint
from sdp_vs_penalty.regression.linalg import column_space
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.solvers.primal_dual import minimise
from sdp_vs_penalty.solvers.small_cones import SmallCones

#: Kinds of constraints: physics alone, where mass can be, stated bounds of links and
#: joints, and the robot's mass. A table shows ranges under each and those before it.
KINDS = ("consistency", "bodies", "bounds", "total")
_KIND_BY_FAMILY = {
    "pseudo-inertia": "consistency",
    "sign": "consistency",
    "moment": "consistency",
    "body": "bodies",
    "bounding ellipsoid": "bodies",
    "minimum thickness": "bodies",
    "total mass": "total",
}
#: Family of the limits that only keep the set finite: a mass and a distance that no link
#: is taken to exceed, and a largest value of each joint's parameters.
FAR = "far limit"
#: Far limit of a joint's parameter, in multiples of the task's bound on it.
_FAR_PARAMETER = 10.0


def kind_of(constraint: Constraint) -> str:
    """Return the kind of a constraint, one of KINDS, or FAR."""
    if constraint.family == FAR:
        return FAR
    return _KIND_BY_FAMILY.get(constraint.family, "bounds")


@dataclass(frozen=True)
class DataBall:
    """What the data say: |A theta - a|^2 = loss(theta) - loss_ls, and how far that may
    be from zero."""

    #: (r, p) visible directions of theta, in torque.
    A: Array
    #: (r,) their values at least squares.
    a: Array
    #: Loss of least squares [weighted (N m)^2].
    loss_ls: float
    #: Standard deviations of linear functions (k, p) of theta, as intervals have them.
    spread: Callable[[Array], Array]
    #: Loss that the noise does not explain; 0 where noise is not known or explains all.
    structure: float

    def rises(self, w: Array, z: float) -> Array:
        """Return c(w) = (z std(w^T theta) / |w|)^2 for functions w (k, p): the rise (k,)
        of the loss that takes w^T theta from least squares to the end of its interval.

        Models whose loss rises by at most c(w) count as fitting where the data limit
        them through w^T theta alone. |w| is in the metric of A, in whose span w lies;
        c(0) = 0.
        """
        length = np.linalg.norm(w @ self.directions, axis=1)
        is_seen = length > 0.0
        rises = np.zeros(len(w))
        if is_seen.any():
            std = self.spread(w[is_seen])
            rises[is_seen] = (z * std / length[is_seen]) ** 2
        return rises

    @cached_property
    def directions(self) -> Array:
        """(p, r) V with A V = 1."""
        return np.asarray(np.linalg.pinv(self.A, rcond=1e-13), float)


@dataclass(frozen=True)
class AllowedSet:
    """Data and constraints of one problem; ends, bands and samples read this."""

    #: The identification problem.
    task: Task
    #: What the data say.
    ball: DataBall
    #: Constraints that hold, the far limits among them.
    constraints: ConstraintSet
    #: (p,) with |theta_k| <= bound_k wherever the constraints hold.
    bound: Array
    #: (p,) the same of the far limits alone.
    far_bound: Array
    #: (p, p) column k: parameter k grows by one and others counter it, so that no torque
    #: shows it; zero where k leads a base parameter.
    unseen: Array
    #: (p,) strictly inside of all constraints.
    interior: Array
    #: (p,) a central model that fits best under the tightest constraints of the table.
    fit: Array
    #: Kinds of the constraints, of KINDS.
    kinds: tuple[str, ...]
    #: Probability with which an interval holds the truth.
    level: float = LEVEL
    #: (n,) noise floor of the filtered torque [N m, N]; None: not known.
    floor: Array | None = None

    @cached_property
    def cost(self) -> float:
        """loss* - loss_ls: what the tightest constraints of the table cost."""
        residual = self.ball.A @ self.fit - self.ball.a
        return float(residual @ residual)

    @cached_property
    def cones(self) -> SmallCones:
        """Cones for the interior-point method."""
        return SmallCones(None, self.constraints, len(self.bound))

    def limit(self, rise: float) -> float:
        """Return the largest |A theta - a|^2 where the loss may rise by so much above
        the least one under the constraints: loss* - loss_ls + rise."""
        return self.cost + rise

    @cached_property
    def first_rise(self) -> float:
        """Median c of the rows of A, with which the search for each end starts."""
        return float(np.median(self.ball.rises(self.ball.A, self.z)))

    @property
    def z(self) -> float:
        """Half the width of an interval of this level, in standard deviations."""
        return float(scipy.special.ndtri(0.5 + 0.5 * self.level))

    def optimiser(self, rise: float) -> InteriorPoint:
        """Return the interior-point method on this set, in units in which the ball
        |A theta - a|^2 <= :meth:`limit` of the rise has the radius 1.

        It starts at a central point whose loss is at most a quarter of the rise above
        the least one.
        """
        radius = np.sqrt(self.limit(rise))
        ball = Ball(self.ball.A / radius, self.ball.a / radius)
        loss = max(self.cost + self.ball.loss_ls, 1e-12 * self.task.data.tau_squared)
        start = self._towards_fit(self.best_fit(0.25 * rise / loss), 0.25 * rise)
        return InteriorPoint(self.cones, ball, start, self.fit, self.bound)

    def _towards_fit(self, theta: Array, rise: float) -> Array:
        """Return the point between the best fit and theta (p,) that is nearest to theta
        and has |A theta - a|^2 at most ``rise`` above that of the best fit."""
        at_fit = self.ball.A @ self.fit - self.ball.a
        step = self.ball.A @ (theta - self.fit)
        # |at_fit + t step|^2 = |at_fit|^2 + rise, solved for t without cancellation.
        slope, square = float(at_fit @ step), float(step @ step)
        t = rise / max(slope + float(np.sqrt(slope**2 + rise * square)), 1e-300)
        return self.fit + min(t, 1.0) * (theta - self.fit)

    def best_fit(self, accuracy: float) -> Array:
        """Return a central theta (p,) whose loss exceeds the least one by at most the
        share ``accuracy``."""
        optimum = minimise(self.cones, self._data, [self.interior], accuracy)
        if optimum is None:
            what = "no consistent model that fits these data was found"
            raise InputError(what, "check the units of data and bounds")
        return optimum.theta

    @cached_property
    def _data(self) -> LeastSquares:
        """The least-squares problem in A, with the loss of least squares as floor."""
        return replace(
            self.task.data,
            R=self.ball.A,
            rho=self.ball.a,
            residual_norm=float(np.sqrt(max(self.ball.loss_ls, 0.0))),
        )

    def with_kinds(self, kinds: Sequence[str]) -> AllowedSet:
        """Return the set under fewer kinds of constraints; loss* stays that of the
        tightest, so that the sets are nested."""
        keep = {*kinds, FAR}
        convex = tuple(c for c in self.constraints.convex if kind_of(c) in keep)
        bound = self.bound if set(kinds) >= set(self.kinds) else self.far_bound
        return replace(
            self,
            constraints=ConstraintSet(convex),
            bound=bound,
            kinds=tuple(k for k in KINDS if k in kinds),
        )


def far_limits(problem: Problem, task: Task) -> tuple[ConstraintSet, Array]:
    """Return the limits that only keep the set finite, and the bounds (p,) on |theta|
    that they imply [SI].

    They limit each link's mass and its distance from the link's frame, and the size of
    joints' parameters.
    """
    bound = _FAR_PARAMETER * task.bound
    limits = []
    for k, indices in enumerate(task.links):
        name = f"link {k + 1}"
        mass, radius = problem.link_defaults[k]
        sphere = np.diag([*np.full(3, -1.0 / radius**2), 1.0])
        limits.append(build.linear(FAR, name, indices[:1], [[-1.0]], [mass]))
        limits.append(build.density_in_ellipsoid(FAR, name, indices, sphere))
        # Of mass within the radius: m, three m c, six inertias.
        bound[indices] = mass * np.repeat([1.0, radius, radius**2], [1, 3, 6])
    for k in np.setdiff1d(np.arange(len(bound)), task.links).tolist():
        name = task.model.parameters[k].name
        limits.append(build.linear(FAR, name, [k], [[1.0, -1.0]], [bound[k]] * 2))
    for k, value in task.model.known_values.items():
        bound[k] = max(abs(value), task.bound[k])
    return ConstraintSet(tuple(limits)).with_known(task.model.known_values), bound


def stated_constraints(problem: Problem, task: Task) -> list[Constraint]:
    """Return the constraints of a task without limits of masses that nobody stated.

    Where neither the robot's file nor the user says any, the program assumes some. Here
    the far limits stand for an assumed upper limit, and m >= 0 for a lower one.
    """
    assumed_by_place = dict(
        zip(task.links[:, 0].tolist(), problem.assumed_masses, strict=True)
    )
    stated = []
    for constraint in (*task.constraints.convex, *task.bodies):
        if constraint.family != "mass":
            stated.append(constraint)
            continue
        lower_is_assumed, upper_is_assumed = assumed_by_place[
            int(constraint.indices[0])
        ]
        # A row of positive slope is a lower limit; one of a known mass has slope zero.
        slopes = constraint.coefficients[0]
        is_assumed = np.where(slopes > 0.0, lower_is_assumed, upper_is_assumed)
        is_stated = ~(is_assumed & (slopes != 0.0))
        if is_stated.any():
            stated.append(
                replace(
                    constraint,
                    constant=constraint.constant[is_stated],
                    coefficients=constraint.coefficients[:, is_stated],
                )
            )
    return stated


def allowed_set(
    posed: EstimationProblem,
    theta: Array,
    floor: Array | None = None,
    level: float = LEVEL,
) -> AllowedSet:
    """Return what data and all constraints of a posed problem allow.

    Parameters
    ----------
    theta : (p,) array
        An estimate, at which the intervals of shape constants are taken.
    floor : (n,) array, optional
        Noise floor of the filtered torque [N m, N]; None: not known, no structure.
    level : float
        Probability with which a range is to hold the truth.
    """
    task = posed.task
    limits, far_bound = far_limits(posed.problem, task)
    convex = tuple(stated_constraints(posed.problem, task))
    allowed = AllowedSet(
        task,
        data_ball(posed, theta, floor),
        ConstraintSet((*convex, *limits.convex)),
        bound=np.minimum(task.bound, far_bound),
        far_bound=far_bound,
        unseen=unseen_directions(task),
        interior=interior_point(task, ConstraintSet(convex)),
        fit=np.zeros(0),  # set below: its search needs the other fields
        kinds=KINDS,
        level=level,
        floor=floor,
    )
    return replace(allowed, fit=allowed.best_fit(1e-10))


def data_ball(posed: EstimationProblem, theta: Array, floor: Array | None) -> DataBall:
    """Return what the data say: A = U^T R_lead B and a = U^T rho, U an orthonormal basis
    of the columns R_lead of the leading parameters.

    Only the base parameters B theta make torque: R theta = R_lead B theta. ``theta`` and
    ``floor`` are those of :func:`allowed_set`.
    """
    data, base = posed.task.data, posed.task.base
    R_lead = data.R[:, base.leading]
    U, _ = column_space(R_lead)
    A = U.T @ R_lead @ base.rows
    a = U.T @ data.rho
    residual = data.rho - U @ a
    return DataBall(
        A,
        a,
        loss_ls=float(residual @ residual) + data.residual_norm**2,
        spread=spread_of(posed, theta),
        structure=_structure(posed, floor),
    )


def unseen_directions(task: Task) -> Array:
    """Return a direction of theta that no torque shows for each parameter, as columns
    (p, p): the parameter grows by one, and leading parameters counter it (B d = 0).
    Columns of leading parameters are zero."""
    base = task.base
    directions = np.eye(len(task.bound))
    directions[base.leading] = -base.rows
    directions[:, base.leading] = 0.0
    return directions


def spread_of(posed: EstimationProblem, theta: Array) -> Callable[[Array], Array]:
    """Return the function that computes the standard deviations (k,) of linear functions
    (k, p) of theta."""
    wide = with_errors_of_constants(posed, theta)
    return linear_spread(posed.task, posed.regression, theta, wide, posed.gain_errors)


def _structure(posed: EstimationProblem, floor: Array | None) -> float:
    """Return the weighted loss [(N m)^2] of least squares that noise of the floor (n,)
    [N m, N] does not explain; 0 without a floor."""
    if floor is None:
        return 0.0
    regression = posed.regression
    noise = regression.joint_rows() * np.asarray(floor, float) ** 2
    excess = np.maximum(regression.joint_losses(posed.task.ols) - noise, 0.0)
    return float(posed.task.weights**2 @ excess)
