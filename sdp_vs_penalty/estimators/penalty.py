"""The exact penalty, from several seeded starts (the published one is in
``penalty_paper.py``).

It receives the SDP's convex constraints as the same arrays, and the barycentric bounds
that are not convex as they are. For constraints F_i(x) in cones K_i (self-dual), weight
w and shifts S_i,

    L(x; S, w) = f(x) + 1 / (2 w) sum_i (|Pi_K(S_i - w F_i(x))|^2 - |S_i|^2)

is smooth; S <- Pi_K(S - w F(x)) after each minimisation makes the minimiser feasible at a finite w, and
S tends to the multipliers, from which the certificate bounds the optimum (Powell 1969, Hestenes 1969,
Rockafellar 1974: the augmented Lagrangian). The weight grows tenfold while the violation does not fall
to a quarter. Each minimisation is one of nonlinear least squares, by Gauss-Newton steps, which are
semismooth Newton steps (Zhao, Sun, Toh, SIAM J. Optim. 2010; :func:`projected_rows`). Where they do not
settle, MINPACK's Levenberg-Marquardt method goes on. A weak pull to the last x keeps the rows of full
rank where the data leave directions open (Rockafellar 1976: the proximal method of multipliers).

Where the data leave much open, stages do not settle. Then the convex relaxation (the same SDP without
the limits that are not convex) bounds the optimum, and its own optimum is the next start.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any, ClassVar

import numpy as np
import scipy

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task, with_joint_prior
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdpThickness, PosedSdp, interior_point
from sdp_vs_penalty.regression.linalg import InTurn
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, Indices, nonzero_or_one
from sdp_vs_penalty.robot.constraint import (
    BarycentricBound,
    ConeGroup,
    Constraint,
    ConstraintSet,
    project,
    projected_rows,
)
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem
from sdp_vs_penalty.solvers.fit import repair, with_best_dual
from sdp_vs_penalty.solvers.rigorous_bounds import TIGHT

#: Columns that LAPACK's QR takes at once.
_QR_BLOCK = 16
#: Stages, and evaluations of each, at most. One that is cut short lets the weight grow
#: too early: with 60, runs on columns that torque hardly tells apart (rotors, links)
#: ended .8 % too high.
_STEPS = 300
#: A stage has settled if a step promises no more than this share of the value.
_SETTLED = 1e-14
#: Steps go on as long as each promises less than this share of the last one.
_LAST_GAIN = 0.01
#: Evaluations of a stage by Gauss-Newton steps, at most.
_EVALUATIONS = 30
#: Share of what its slope promises that a step has to gain; smallest share to which a step
#: is cut at once.
_ARMIJO, _SMALLEST_CUT = 1e-4, 1e-3


@dataclass(frozen=True)
class PenaltyPart:
    """Constraints of one kind: F(x) (g, ...) in a cone."""

    #: Kind of the cone, such as "psd".
    cone: str
    #: F(x) (g, ...) of scaled parameters x (p,).
    values: Callable[[Array], Array]
    #: dF/dx (rows, p), rows in the order of F.ravel().
    jacobian: Callable[[Array], Array]
    #: (g, ...) factor of F over the affine group's own entries, entry by entry.
    scale: Array | float = 1.0


@dataclass(frozen=True)
class QuadraticForms:
    """F_k = u^T A_k u + b_k u_0 of u = x[indices_k], k = 1..K; indices (K, 10), forms
    (K, 10, 10), slopes (K,)."""

    indices: Indices
    forms: Array
    slopes: Array

    def values(self, x: Array) -> Array:
        """Return (K,) F_k = u^T A_k u + b_k u_0, u the scaled parameters of the form's
        link."""
        u = x[self.indices]
        quadratic = np.einsum("ki,kij,kj->k", u, self.forms, u)
        return quadratic + self.slopes * u[:, 0]

    def jacobian(self, x: Array) -> Array:
        """Return (K, p) the derivatives of the forms by all scaled parameters x
        (p,)."""
        by_form = 2.0 * np.einsum("kij,kj->ki", self.forms, x[self.indices])
        by_form[:, 0] += self.slopes
        jacobian = np.zeros((len(self.indices), len(x)))
        jacobian[np.arange(len(jacobian))[:, None], self.indices] = by_form
        return jacobian


def barycentric_part(
    bounds: Sequence[BarycentricBound], theta_scale: Array, reference: Array
) -> PenaltyPart:
    """Return the penalty on bounds of moments and products of inertia about the centre of
    mass.

    With m I_e = m J_e - h^T Q_e h, h = m c, a bound on the entry e of that inertia
    becomes m sign (I_e - limit) >= 0, which is quadratic in x = theta / theta_scale and
    has no pole at m = 0. Each bound is tightened by TIGHT, which is more than the final
    repair moves theta. I_xx >= 0 is left out, as P(theta) >= 0 contains it.

    Parameters
    ----------
    bounds : sequence of BarycentricBound
        The bounds; open ends are left out.
    reference : (p,) array
        Parameters at which each form has a size of about one.

    Returns
    -------
    PenaltyPart
        Quadratic forms, each demanded to be nonnegative.
    """
    indices = list[Indices]()
    forms = list[Array]()
    slopes = list[float]()
    for bound in bounds:
        link = reference[bound.indices]
        scale = theta_scale[bound.indices]
        moments = link[[4, 6, 9]]  # Ixx, Iyy, Izz
        size = float(moments.sum())
        form = _moment_form(bound.entry) * np.outer(scale, scale)
        # sign (m I_e - m limit) >= 0, over its size at the reference (link[0]: mass).
        for sign, end in _ends(bound):
            limit = end + sign * TIGHT * (size + abs(end))
            factor = sign / (link[0] * (size + abs(limit)))
            indices.append(bound.indices)
            forms.append(factor * form)
            slopes.append(-factor * limit * scale[0])
    quadratic = QuadraticForms(
        np.array(indices, np.intp).reshape(-1, 10),
        np.array(forms).reshape(-1, 10, 10),
        np.array(slopes),
    )
    return PenaltyPart("nonnegative", quadratic.values, quadratic.jacobian)


def _moment_form(entry: int) -> Array:
    """Return (10, 10) A with u^T A u = m I_e for a link's standard parameters u (10,).

    I_e is the entry e (0..5) of the inertia about the centre of mass.
    """
    form = np.zeros((10, 10))
    form[0, 4 + entry] = 0.5
    form[4 + entry, 0] = 0.5
    form[1:4, 1:4] = -inertia.STEINER_FORMS[entry]
    return form


def _ends(bound: BarycentricBound) -> list[tuple[float, float]]:
    """Return the finite ends of a bound on an inertia, as (sign, value).

    The sign is 1 for a lower end and -1 for an upper one: sign (I_e - value) >= 0.
    Lower ends of moments at or below zero are left out, since moments are never
    negative.
    """
    is_moment = np.trace(inertia.STEINER_FORMS[bound.entry]) > 0.0
    ends = list[tuple[float, float]]()
    if np.isfinite(bound.lower) and not (is_moment and bound.lower <= 0.0):
        ends.append((1.0, bound.lower))
    if np.isfinite(bound.upper):
        ends.append((-1.0, bound.upper))
    return ends


def affine_part(group: ConeGroup, theta_scale: Array, reference: Array) -> PenaltyPart:
    """Return the penalty on a group of equal cones, scaled to a size of about one.

    Parameters
    ----------
    theta_scale : (p,) array
        Scale of each parameter, x = theta / theta_scale.
    reference : (p,) array
        Parameters at which each cone's value has a size of about one. Scaling leaves
        the cone as it is.

    Returns
    -------
    PenaltyPart
        Affine maps and their cone.
    """
    values = group.values(reference)
    matrix = np.zeros((len(group.matrix), len(theta_scale)))
    matrix[:, : group.matrix.shape[1]] = group.matrix
    matrix *= theta_scale
    if group.cone == "psd":
        diagonals = np.abs(np.diagonal(values, axis1=1, axis2=2))
        root = 1.0 / np.sqrt(nonzero_or_one(diagonals))
        scale = root[:, :, None] * root[:, None, :]
    else:
        largest = np.abs(matrix).max(axis=1)
        size = largest + np.abs(group.constant.ravel())
        scale = 1.0 / nonzero_or_one(size).reshape(values.shape)
        if group.cone == "soc":  # one factor for all entries of a cone
            scale = np.broadcast_to(scale.min(axis=1, keepdims=True), scale.shape)
    constant = group.constant * scale
    matrix = matrix * scale.reshape(-1, 1)
    return PenaltyPart(
        group.cone,
        values=lambda x: constant + (matrix @ x).reshape(values.shape),
        jacobian=lambda x: matrix,
        scale=scale,
    )


class ShiftedPenalty:
    """L(x; S, w) with f(x) = |R x - rho|^2, x = theta / theta_scale; losses and cones
    are of size one.

    ``shifts`` has one array a part; received : convex, without what others imply.
    """

    def __init__(self, task: Task, problem: ConvexProblem, interior: Array) -> None:
        """Scale parameters by what the torque allows, cones at the interior point, and
        the loss.

        Parameters
        ----------
        task : Task
            Its least squares, whose loss is the unit of the loss.
        interior : (p,) array
            A point inside the convex constraints.
        """
        data, constraints = problem.least_squares, problem.constraints
        norms = data.column_norms
        size = np.sqrt(data.tau_squared)
        scales = np.where(
            (norms > 0.0) & (size > 0.0), size / nonzero_or_one(norms), np.inf
        )
        self.theta_scale = np.minimum(scales, problem.bound)
        # The loss in units of its unconstrained minimum, so that weights mean the same
        # everywhere.
        self.loss_scale = max(data.loss(task.ols), 1e-6 * data.tau_squared) or 1.0
        self.received = ConstraintSet(constraints.essential)
        self.parts = [
            affine_part(s, self.theta_scale, interior) for s in self.received.groups
        ]
        if constraints.nonconvex:
            self.parts.append(
                barycentric_part(constraints.nonconvex, self.theta_scale, interior)
            )
        root = np.sqrt(self.loss_scale)
        self.R = data.R * self.theta_scale / root
        self.rho = data.rho / root

    def multipliers(self, constraints: ConstraintSet, shifts: Sequence[Array]) -> Array:
        """Return the shifts of the penalty as dual variables of the constraints.

        Returns
        -------
        (e,) array
            Multipliers, in units of loss per F; zero for constraints that others imply.
        """
        by_constraint: dict[Constraint, Array] = {}
        # The groups are the first of the parts, in this order.
        for group, part, shift in zip(
            self.received.groups, self.parts, shifts, strict=False
        ):
            values = self.loss_scale * part.scale * shift
            for place, multiplier in zip(group.places.tolist(), values, strict=True):
                by_constraint[self.received.convex[place]] = multiplier
        return constraints.stack_multipliers(by_constraint)

    def shifts(
        self, constraints: ConstraintSet, multipliers: Array | None, x: Array
    ) -> list[Array]:
        """Return dual variables (e,) of the constraints as shifts, an array a part.

        It is the inverse of :meth:`multipliers`. Shifts of limits that are not convex,
        and all without multipliers, are zero. ``x`` (p,) are scaled parameters.
        """
        shifts = [np.zeros_like(part.values(x)) for part in self.parts]
        if multipliers is None:
            return shifts
        by_constraint = dict(
            zip(constraints.convex, constraints.entries.each(multipliers), strict=True)
        )
        # The groups are the first of the parts, in this order.
        for k, group in enumerate(self.received.groups):
            places = group.places.tolist()
            values = [by_constraint[self.received.convex[place]] for place in places]
            shifts[k] = np.array(values) / (self.loss_scale * self.parts[k].scale)
        return shifts

    def shifted(self, x: Array, shifts: Sequence[Array], weight: float) -> list[Array]:
        """Return the next shifts of the augmented Lagrangian, Pi_K(S - w F(x)), an
        array a part, from shifts S, scaled parameters x (p,) and the weight w."""
        new_shifts = []
        for part, shift in zip(self.parts, shifts, strict=True):
            new_shifts.append(project(part.cone, shift - weight * part.values(x)))
        return new_shifts

    def rows(
        self, x: Array, shifts: Sequence[Array], weight: float
    ) -> tuple[Array, Array]:
        """Return residuals r and Jacobian J of the augmented Lagrangian L = |r|^2 +
        constant.

        2 J^T r is the gradient of L; 2 J^T J is an element of its generalised Hessian
        for affine F.

        Returns
        -------
        tuple
            r (m,) and J (m, p): rows of the data, then of the cones.
        """
        residuals, slopes = self.cone_rows(x, shifts, weight)
        all_residuals = np.concatenate([self.R @ x - self.rho, residuals])
        return all_residuals, np.concatenate([self.R, slopes])

    def cone_rows(
        self, x: Array, shifts: Sequence[Array], weight: float
    ) -> tuple[Array, Array]:
        """Return residuals and Jacobian of the penalty alone, without the data.

        Returns
        -------
        tuple
            r (m,) and J (m, p), with |r|^2 = |Pi_K(S - w F)|^2 / (2 w).
        """
        residuals = [np.zeros(0)]
        slopes = [np.zeros((0, len(x)))]
        for part, shift in zip(self.parts, shifts, strict=True):
            # (cones of the part, entries of a cone, p)
            jacobian = part.jacobian(x).reshape(len(shift), -1, len(x))
            r, J = projected_rows(part.cone, shift - weight * part.values(x), jacobian)
            residuals.append(r / np.sqrt(2.0 * weight))
            slopes.append(-np.sqrt(0.5 * weight) * J)
        return np.concatenate(residuals), np.concatenate(slopes)


@dataclass(frozen=True)
class _Stage:
    """One minimisation over z (p,), of the sum L(z; S, w) + |near (z - centre)|^2."""

    #: Data and constraints, scaled.
    penalty: ShiftedPenalty
    #: Shifts S, an array a part.
    shifts: list[Array]
    #: Weight w of the penalty.
    weight: float
    #: (p,) point to which z is pulled.
    centre: Array
    #: (p, p) rows of the pull, times z - centre.
    near: Array

    @cached_property
    def linear_rows(self) -> Array:
        """(k, p + 1) triangle [T, t]: the data's |R z - rho|^2 and the pull's
        |near (z - centre)|^2 together are |T z - t|^2.

        T is the same at every z, so that it is worked out once a stage; only the cones'
        rows change with z.
        """
        loss = np.column_stack([self.penalty.R, self.penalty.rho])
        pull = np.column_stack([self.near, self.near @ self.centre])
        stacked = np.vstack([loss, pull])
        return np.asarray(np.linalg.qr(stacked, mode="r"))

    def at(self, z: Array) -> "_Point":
        """Evaluate what is minimised at z (p,)."""
        residuals, slopes = self.penalty.cone_rows(z, self.shifts, self.weight)
        linear = self.linear_rows[:, :-1] @ z - self.linear_rows[:, -1]
        value = float(linear @ linear + residuals @ residuals)
        return _Point(z, value, linear, np.column_stack([slopes, residuals]))

    def triangle(self, point: "_Point") -> Array:
        """Return the triangle (p + 1, p + 1) of all rows [J, r] at a point: of the
        data, the pull to the centre, and the cones.

        The first two have the triangle T already. LAPACK's dtpqrt takes it with the
        cones' rows below, which costs less than a QR of all rows.
        """
        triangle = self.linear_rows.copy()
        triangle[:, -1] = point.linear
        if not len(point.cones):
            return triangle
        block = min(_QR_BLOCK, triangle.shape[1])
        with_cones, *_ = scipy.linalg.lapack.dtpqrt(0, block, triangle, point.cones)
        return np.asarray(with_cones)

    def rows(self, z: Array) -> tuple[Array, Array]:
        """Return residuals (p + 1,) and Jacobian (p + 1, p) at z (p,), as a triangle.

        It keeps |r|^2 and its derivatives, so that MINPACK's result is the same, and
        its own QR, which is not blocked, has less to do.
        """
        triangle = self.triangle(self.at(z))
        return triangle[:, -1], triangle[:, :-1]

    def solve(self) -> Array:
        """Return the minimiser (p,): by Gauss-Newton steps, and where these do not
        settle by MINPACK's Levenberg-Marquardt method.
        """
        point, settled = self.gauss_newton()
        if settled:
            return point.z
        rows = InTurn(self.rows)
        solution = scipy.optimize.least_squares(
            rows.residual,
            point.z,
            rows.jacobian,
            method="lm",
            ftol=_SETTLED,
            xtol=_SETTLED,
            gtol=_SETTLED,
            max_nfev=_STEPS,
        )
        return np.asarray(solution.x)

    def gauss_newton(self) -> tuple["_Point", bool]:
        """Take Gauss-Newton steps from the centre until they settle.

        A step minimises |T step + r|^2, with the triangle T of all rows. It has settled
        if it promises a share _SETTLED of the value at most, and steps no longer improve
        fast. Returns the last point, and whether steps have settled within _EVALUATIONS.
        """
        point = self.at(self.centre)
        last_gain = np.inf
        n_evaluations = 1
        while n_evaluations < _EVALUATIONS:
            triangle = self.triangle(point)
            r = triangle[:-1, -1]
            step, _ = scipy.linalg.lapack.dtrtrs(triangle[:-1, :-1], -r)
            # A whole step gains |r|^2 where the rows are linear; the slope is twice that.
            gain = float(r @ r)
            settled = gain <= _SETTLED * point.value
            if settled and gain > _LAST_GAIN * last_gain:
                return point, True
            last_gain = gain
            if settled:
                # The value of a settled stage is known to rounding only: no step is cut.
                trial: _Point | None = self.at(point.z + step)
                n_evaluations += 1
            else:
                trial, n_evaluations = self._cut_step(point, step, gain, n_evaluations)
            if trial is None:
                return point, False
            point = trial
        return point, False

    def _cut_step(
        self, point: "_Point", step: Array, gain: float, n_evaluations: int
    ) -> tuple["_Point | None", int]:
        """Return the point after a step (p,), or after the share of it that gains enough,
        and the number of evaluations so far; no point after _EVALUATIONS of them.

        A step that does not gain a share of what its slope, -2 ``gain``, promises
        (Armijo's rule) is cut to where a parabola through both its ends is lowest. Steps
        become short where cones begin to act within them.
        """
        share = 1.0
        trial = self.at(point.z + step)
        n_evaluations += 1
        while True:
            rise = trial.value - point.value
            if not rise > -2.0 * _ARMIJO * share * gain:
                return trial, n_evaluations
            if n_evaluations == _EVALUATIONS:
                return None, n_evaluations
            lowest = gain * share**2 / (rise + 2.0 * gain * share)
            share = min(0.5 * share, max(lowest, _SMALLEST_CUT * share))
            trial = self.at(point.z + share * step)
            n_evaluations += 1


@dataclass(frozen=True)
class _Point:
    """A point of a stage: its value, residuals and rows at z, of p parameters."""

    #: (p,) scaled parameters.
    z: Array
    #: Value of what the stage minimises.
    value: float
    #: (p + 1,) residuals of the data and of the pull.
    linear: Array
    #: (k, p + 1) rows [J, r] of the cones.
    cones: Array


def minimise(
    penalty: ShiftedPenalty, x: Array, tolerance: float, shifts: list[Array]
) -> tuple[Array, list[Array], dict[str, Any]]:
    """Minimise from scaled parameters x (p,) by a sequence of shifted penalties until
    constraints and shifts settle.

    Each stage minimises the augmented Lagrangian with a proximal pull to the last x.
    The weight grows tenfold unless the change of the shifts has fallen to a quarter. A
    weight that can grow no more and a change that does not fall end the sequence.

    Parameters
    ----------
    shifts : list of arrays
        First shifts, an array a part.
    tolerance : float
        Largest violation and complementarity, in the scaled units of the parts.

    Returns
    -------
    x : (p,) array
        The minimiser, in scaled units.
    shifts : list of arrays
        Multipliers, one array a part.
    details : dict
        Last residual, and number of stages.
    """
    # First weight of the penalty, in units of (scaled loss) / (scaled distance)^2.
    weight = 0.1
    # Weight of the pull to the last stage's x, in the same units; as x settles the pull
    # vanishes.
    pull = 1e-6
    pull_rows = np.sqrt(pull) * np.eye(len(x))
    residual = np.inf
    n_stages = 0
    for _ in range(_STEPS):
        n_stages += 1
        last = x
        x = _Stage(penalty, shifts, weight, centre=last, near=pull_rows).solve()
        new_shifts = penalty.shifted(x, shifts, weight)
        previous = residual
        residual = largest_change(new_shifts, shifts) / weight
        shifts = new_shifts
        if max(residual, pull * largest_change([x], [last])) <= tolerance:
            break
        if residual > 0.25 * previous:
            if weight * tolerance >= 1.0:
                break
            weight *= 10.0
    return x, shifts, {"residual": residual, "stages": n_stages}


def largest_change(new: Sequence[Array], old: Sequence[Array]) -> float:
    """Return the largest absolute difference between two lists of arrays of equal
    shapes."""
    largest = 0.0
    for a, b in zip(new, old, strict=True):
        largest = max(largest, float(np.abs(a - b).max(initial=0.0)))
    return largest


@dataclass(frozen=True)
class Penalty(Estimator):
    """minimise loss(theta) + shifted penalty of F(theta), weights continued until it is
    exact."""

    name = "penalty"
    proves_optimum: ClassVar[bool] = True
    table_place: ClassVar[int | None] = 2
    description = "least squares with a penalty on impossible links, from many starts"

    #: Whether each link's mass must lie inside of its body, as for ``lmi-sdp``.
    body: bool = True
    #: Smallest radius of gyration of a link [m]; 0 for none.
    thickness: float = LmiSdpThickness.thickness
    #: Largest number of runs: the first from the problem's nominal robot, the second
    #: from the optimum of the convex relaxation. Limits that are not convex get others,
    #: from seeded random points of the barycentric box, moved towards the first until
    #: the convex constraints hold. A run whose optimum is proved is the last one; the
    #: certified gap of others says how far above the relaxation they end.
    starts: int = 5
    #: Tolerance of violation and complementarity, relative to the size of each
    #: constraint's values.
    tolerance: float = 1e-9
    #: Weight of the pull of joint parameters to zero, as of ``lmi-sdp``; 0: none.
    joint_prior: float = 0.0

    def demands(self, task: Task) -> ConstraintSet:
        """Return the constraints that are penalised, which are the same arrays as the
        SDP's."""
        demands = task.constraints.plus(task.minimum_thickness(self.thickness))
        return demands.plus(task.bodies) if self.body else demands

    def fit(self, task: Task) -> Fit:
        """Minimise the loss with exact penalties from several starts."""
        task = with_joint_prior(task, self.joint_prior)
        problem = ConvexProblem(self.data(task), self.demands(task), task.bound)

        def relaxation() -> Fit:
            """Solve the SDP without the limits that are not convex."""
            return PosedSdp(task, problem).fit()

        return fit_penalty(task, problem, self.starts, self.tolerance, relaxation)

    def data(self, task: Task) -> LeastSquares:
        """Return the loss that is minimised: that of the torque."""
        return task.data


@dataclass(frozen=True)
class PenaltyTwoStep(Penalty):
    """minimise |pi(theta) - pi_hat|^2, the retrieval of Gaz et al. (RA-L 2019, eq. 29).

    Friction and other joint parameters are coefficients of their own: they stay as
    estimated where their sign bounds allow it.
    """

    name = "penalty-two-step"
    table_place: ClassVar[int | None] = None
    description = (
        "exact penalty on the distance to the OLS base parameters, multi-start"
    )

    #: The distance may be a thousandth of what a violation of 1e-9 is worth: on the TX40
    #: a run that is made feasible from there ends 1.2 % above its proved optimum.
    tolerance: float = 1e-12

    def data(self, task: Task) -> LeastSquares:
        """Return the loss that is minimised: the distance to the OLS base
        parameters."""
        return task.base_distance


#: A run whose own multipliers prove this gap, relative to the loss, is the last one: no
#: other start can end lower by more.
PROVEN_GAP = 1e-6
#: Up to this violation, in a constraint's own units, a run is feasible.
FEASIBLE = 1e-9


@dataclass(frozen=True)
class PenaltyRun:
    """Where one start ends."""

    #: (p,) parameters, made feasible.
    theta: Array
    #: (e,) multipliers of the convex constraints.
    multipliers: Array
    #: Loss, objective, violation, residual and number of stages.
    figures: dict[str, Any]

    @property
    def is_feasible(self) -> bool:
        """Whether all constraints hold up to FEASIBLE, nonconvex ones included."""
        return bool(self.figures["violation"] <= FEASIBLE)

    @property
    def rank(self) -> float:
        """Objective of a feasible run; infinity otherwise. The smallest is the best."""
        return float(self.figures["objective"]) if self.is_feasible else np.inf


def fit_penalty(
    task: Task,
    problem: ConvexProblem,
    starts: int,
    tolerance: float,
    relaxation: Callable[[], Fit] | None = None,
) -> Fit:
    """Return the best of several runs from different starts, each made feasible.

    Parameters
    ----------
    task : Task
        Seed and the loss that is reported.
    problem : ConvexProblem
        Its loss is the task's torque loss, or a distance of base parameters.
    starts : int
        Largest number of runs; one that a certificate proves to a gap of PROVEN_GAP is
        the last.
    tolerance : float
        Largest violation and complementarity, in units of each constraint's size.
    relaxation : callable, optional
        Solves the problem without its limits that are not convex. It is called if the
        first run is not proved: its multipliers bound all runs, its optimum is the
        second start. None: the penalty alone.

    Returns
    -------
    Fit
        With multipliers, and the figures of every run in its details.

    Raises
    ------
    InputError
        If the convex constraints have no interior point.
    """
    interior = interior_point(task, problem.constraints)
    penalty = ShiftedPenalty(task, problem, interior)
    figures = list[dict[str, Any]]()
    bounds = list[Fit]()  # whose multipliers bound every run
    best: PenaltyRun | None = None
    n_starts = max(starts, 1)
    all_starts = _starts(task, problem.constraints, interior, relaxation)
    for number, start in enumerate(islice(all_starts, n_starts)):
        run = start.run(task, problem, penalty, interior, tolerance)
        figures.append(run.figures)
        if start.relaxed is not None:
            bounds.append(start.relaxed)
        lowest = min(f["objective"] for f in figures)
        task.progress(
            f"run {number + 1} of {n_starts}: best {lowest:.6g}, violation"
            f" {run.figures['violation']:.1e}"
        )
        # A run that is lower by so little is no better: it may be lower because it
        # violates a constraint within the tolerance, and its multipliers may be worse.
        if best is None or run.rank < best.rank * (1.0 - 1e-7):
            best = run
        fit = Fit(
            theta=best.theta,
            problem=problem,
            multipliers=best.multipliers,
            interior=interior,
            details={"runs": figures},
        )
        fit = with_best_dual(fit, bounds)
        if best.is_feasible and fit.gap <= PROVEN_GAP:
            break
    return fit


@dataclass(frozen=True)
class _Start:
    """Where a run begins."""

    #: (p,) parameters.
    theta: Array
    #: The relaxation's fit, if theta is its optimum.
    relaxed: Fit | None = None

    def run(
        self,
        task: Task,
        problem: ConvexProblem,
        penalty: ShiftedPenalty,
        interior: Array,
        tolerance: float,
    ) -> PenaltyRun:
        """Minimise the penalty from here; an optimum of the relaxation that satisfies
        all limits stays as it is."""
        constraints = problem.constraints
        theta = self.theta
        multipliers = None if self.relaxed is None else self.relaxed.multipliers
        effort = {"residual": 0.0, "stages": 0}
        if multipliers is None or not _obeys_nonconvex(constraints, theta):
            x = theta / penalty.theta_scale
            shifts = penalty.shifts(constraints, multipliers, x)
            x, shifts, effort = minimise(penalty, x, tolerance, shifts)
            theta = made_feasible(constraints, penalty.theta_scale * x, interior)
            multipliers = penalty.multipliers(constraints, shifts)
        figures = {
            "loss": task.data.loss(theta),
            "objective": problem.least_squares.loss(theta),
            "violation": max(constraints.worst(theta).values(), default=0.0),
        }
        return PenaltyRun(theta, multipliers, figures | effort)


def _starts(
    task: Task,
    constraints: ConstraintSet,
    interior: Array,
    relaxation: Callable[[], Fit] | None,
) -> Iterator[_Start]:
    """Yield the starts: the interior point, the relaxation's optimum, then, unless that
    settles it, random points of the box without end.

    Random points are moved towards the interior point until the convex constraints
    hold.
    """
    yield _Start(interior)
    if relaxation is not None:
        # If its solvers give up, the random starts below are tried.
        with suppress(InputError):
            relaxed = relaxation()
            yield _Start(relaxed.theta, relaxed)
            if not constraints.nonconvex:
                return  # a convex problem: no other start ends lower
    box = BarycentricBox(task)
    rng = np.random.default_rng(task.seed)
    while True:
        random = box.theta(rng.uniform(box.lower, box.upper))
        yield _Start(repair(constraints, random, interior))


def made_feasible(constraints: ConstraintSet, theta: Array, interior: Array) -> Array:
    """Move an almost feasible theta (p,) towards a point strictly inside the convex
    constraints, until all constraints hold.

    Shares of the way are tried in turn: 0, then from 1e-14, a rounding error, to 1, four
    a decade. Where the nonconvex constraints hold at none of these points, the nearest
    one at which the convex ones do is returned; the certificate says what it violates.
    """
    repaired = repair(constraints, theta, interior)
    four_a_decade = np.logspace(-14.0, 0.0, 1 + 4 * 14)
    for share in (0.0, *four_a_decade):
        point = repaired + share * (interior - repaired)
        if _obeys_nonconvex(constraints, point):
            return point
    return repaired


def _obeys_nonconvex(constraints: ConstraintSet, theta: Array) -> bool:
    """Return whether theta (p,) satisfies the constraints that are not convex."""
    return all(bound.margin(theta) >= 0.0 for bound in constraints.nonconvex)


#: The authors' box for friction and offset parameters [N m, N m s / rad] (bounds of
#: their one-step identification). Widened where a parameter must be larger to make the
#: measured torque.
JOINT_PARAMETER_RANGE = 100.0


class BarycentricBox:
    """Bounds of p (p,): each link's ten barycentric parameters in place of theta's, the
    rest as is.

    The problem's box; where it is open, what the problem implies (Task.bound). Centres
    of mass: |c| <= largest |m c| / largest m; moments and products of inertia: the
    largest moment about the frame. Joint parameters: their sign, and max(100, |tau| /
    |Y_k|) in SI units, where |tau| / |Y_k| is the size at which parameter k alone makes
    all the measured torque.
    """

    def __init__(self, task: Task) -> None:
        """Set lower and upper bounds (p,) of barycentric parameters (inertia about the
        centre of mass).

        A bound is that of the problem's box; where the box is open, the largest value
        that the problem implies. Parameters of joints get their sign and a wide range.
        """
        self.links = task.links
        self.upper = self._joint_range(task)
        lowest = [parameter.lower for parameter in task.model.parameters]
        self.lower = np.maximum(-self.upper, lowest)
        # A link's ten parameters: m, c (3), Ixx, Ixy, Iyy, Ixz, Iyz, Izz.
        # Implied: |m c| / m bounds |c|; mass and moments are not negative.
        implied_upper = task.bound[self.links]
        implied_upper[:, 1:4] /= nonzero_or_one(implied_upper[:, :1])
        implied_lower = -implied_upper
        implied_lower[:, [0, 4, 6, 9]] = 0.0
        # The problem's box comes first, where it has an end.
        box = task.box[: len(self.links)]
        lower = box[:, :, 0]
        upper = box[:, :, 1]
        self.lower[self.links] = np.where(np.isfinite(lower), lower, implied_lower)
        self.upper[self.links] = np.where(np.isfinite(upper), upper, implied_upper)

    @staticmethod
    def _joint_range(task: Task) -> Array:
        """Return (p,) the largest size of each parameter of a joint, such as friction.

        It is max(JOINT_PARAMETER_RANGE, |tau| / |Y_k|), at most the implied bound.
        |tau| / |Y_k| is the value with which parameter k alone makes all the torque. The
        entries of links have no meaning; the caller overwrites them.
        """
        norms = task.data.column_norms
        torque = np.where(norms > 0.0, np.sqrt(task.data.tau_squared), 0.0)
        largest_alone = torque / nonzero_or_one(norms)
        return np.minimum(np.maximum(JOINT_PARAMETER_RANGE, largest_alone), task.bound)

    def theta(self, p: Array) -> Array:
        """Return standard parameters (p,) of barycentric p (p,): h = m c, J = I + m
        (c.c 1 - c c^T)."""
        theta = p.copy()
        theta[self.links] = inertia.standard_from_barycentric(p[self.links])
        return theta

    def pull_back(self, p: Array, gradient: Array) -> Array:
        """Return the gradient (p,) by barycentric parameters, (d theta / d p)^T
        gradient, of a gradient by standard parameters."""
        masses = self.links[:, :1]
        centres = self.links[:, 1:4]
        c = p[centres]
        by_links = gradient[self.links]
        by_first_moments = by_links[:, 1:4]
        by_inertias = by_links[:, 4:]
        # Half of the slope of J = I + m (c.c 1 - c c^T) over m c, (n, 3).
        half_slopes = np.einsum("ne,eij,nj->ni", by_inertias, inertia.STEINER_FORMS, c)
        by_p = gradient.copy()
        by_p[masses[:, 0]] += np.sum(c * (by_first_moments + half_slopes), axis=1)
        by_p[centres] = p[masses] * (by_first_moments + 2.0 * half_slopes)
        return by_p

    def p(self, theta: Array) -> Array:
        """Return barycentric parameters (p,) of theta (p,), clipped to the box; the
        middle of the box for a massless link."""
        p = theta.copy()
        p[self.links] = inertia.barycentric_from_standard(theta[self.links])
        middle = 0.5 * (self.lower + self.upper)
        finite = np.where(np.isfinite(p), p, middle)
        return np.clip(finite, self.lower, self.upper)
