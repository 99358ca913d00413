"""The exact penalty, from several seeded starts (the published one is in
``penalty_paper.py``).

It receives the SDP's convex constraints as the same arrays, and the barycentric bounds
that are not convex as they are. For constraints F_i(x) in cones K_i (self-dual), weight
w and shifts S_i,

    L(x; S, w) = f(x) + 1 / (2 w) sum_i (|Pi_K(S_i - w F_i(x))|^2 - |S_i|^2)

is smooth; S <- Pi_K(S - w F(x)) after each minimisation makes the minimiser feasible at a finite w, and
S tends to the multipliers, from which the certificate bounds the optimum (Powell 1969, Hestenes 1969,
Rockafellar 1974: the augmented Lagrangian). The weight grows tenfold while the violation does not fall
to a quarter. Each minimisation is one of nonlinear least squares, by MINPACK's Levenberg-Marquardt
method; its Gauss-Newton steps are semismooth Newton steps (Zhao, Sun, Toh, SIAM J. Optim. 2010;
:func:`projected_rows`). A weak pull to the last x keeps its rows of full rank where the data leave
directions open (Rockafellar 1976: the proximal method of multipliers).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task, with_joint_prior
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdpThickness, interior_point
from sdp_vs_penalty.regression.linalg import in_turn
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.constraint import (
    BarycentricBound,
    ConeGroup,
    Constraint,
    ConstraintSet,
    project,
    projected_rows,
)
from sdp_vs_penalty.solvers.fit import repair
from sdp_vs_penalty.solvers.objective import Objective
from sdp_vs_penalty.solvers.rigorous_bounds import TIGHT

#: Stages, and evaluations of each, at most. One that is cut short lets the weight grow
#: too early: with 60, runs on columns that torque hardly tells apart (rotors, links)
#: ended .8 % too high.
_STEPS = 300


@dataclass(frozen=True)
class PenaltyPart:
    """Constraints of one kind: F(x) (g, ...) in a cone, and dF/dx (rows, p) in the
    order of F.ravel(); scale (g, ...) : of an affine F over the group's, entry by
    entry."""

    cone: str
    values: Callable[[Array], Array]
    jacobian: Callable[[Array], Array]
    scale: Array | float = 1.0


def barycentric_part(
    bounds: Sequence[BarycentricBound], theta_scale: Array, reference: Array
) -> PenaltyPart:
    """m sign (I_e - limit) >= 0 for entries e of inertia about links' centres of mass,
    with m I_e = m J_e - h^T Q_e h: quadratic in x = theta / theta_scale, without a pole
    at m = 0.

    Of each finite end, inside by as much as a gap is promised, more than the final
    repair moves, and of about unit size at the reference (p,); without I_xx >= 0, which
    P(theta) >= 0 contains.
    """
    entries = list[
        tuple[NDArray[np.intp], Array, float]
    ]()  # F = u^T form u + slope u_0, u = x[indices]
    for b in bounds:
        link = reference[b.indices]
        scale = theta_scale[b.indices]
        moment = link[[4, 6, 9]].sum()
        itself = np.trace(inertia.STEINER_FORMS[b.entry]) > 0.0
        form = np.zeros((10, 10))
        form[0, 4 + b.entry] = form[4 + b.entry, 0] = 0.5
        form[1:4, 1:4] = -inertia.STEINER_FORMS[b.entry]
        for sign, end in ((1.0, b.lower), (-1.0, b.upper)):
            if np.isfinite(end) and not (itself and sign > 0.0 and end <= 0.0):
                limit = end + sign * TIGHT * (moment + abs(end))
                factor = sign / (link[0] * (moment + abs(limit)))
                entries.append(
                    (
                        b.indices,
                        form * factor * np.outer(scale, scale),
                        -factor * limit * scale[0],
                    )
                )
    indices = np.array([x[0] for x in entries], np.intp).reshape(-1, 10)
    forms = np.array([x[1] for x in entries]).reshape(-1, 10, 10)
    slopes = np.array([x[2] for x in entries])

    def values(x: Array) -> Array:
        u = x[indices]
        return np.asarray(np.einsum("ki,kij,kj->k", u, forms, u) + slopes * u[:, 0])

    def jacobian(x: Array) -> Array:
        out = np.zeros((len(indices), len(x)))
        local = 2.0 * np.einsum("kij,kj->ki", forms, x[indices])
        local[:, 0] += slopes
        out[np.arange(len(out))[:, None], indices] = local
        return out

    return PenaltyPart("nonnegative", values, jacobian)


def affine_part(group: ConeGroup, theta_scale: Array, reference: Array) -> PenaltyPart:
    """A group of equal cones, each of about unit size at the reference: the set stays
    the same."""
    at = group.values(reference)
    matrix = np.zeros((len(group.matrix), len(theta_scale)))
    matrix[:, : group.matrix.shape[1]] = group.matrix
    matrix *= theta_scale
    if group.cone == "psd":
        root = 1.0 / np.sqrt(nonzero_or_one(np.abs(np.diagonal(at, axis1=1, axis2=2))))
        scale = root[:, :, None] * root[:, None, :]
    else:
        size = np.abs(matrix).max(axis=1) + np.abs(group.constant.ravel())
        scale = 1.0 / nonzero_or_one(size).reshape(at.shape)
        if group.cone == "soc":
            scale = np.broadcast_to(scale.min(axis=1, keepdims=True), scale.shape)
    constant = group.constant * scale
    matrix = matrix * scale.reshape(-1, 1)
    return PenaltyPart(
        group.cone,
        lambda x: constant + (matrix @ x).reshape(at.shape),
        lambda x: matrix,
        scale,
    )


class ShiftedPenalty:
    """L(x; S, w) with f(x) = |R x - rho|^2, x = theta / theta_scale; losses and cones
    are of size one.

    ``shifts`` has one array a part; received : convex, without what others imply."""

    def __init__(
        self,
        task: Task,
        data: LeastSquares,
        constraints: ConstraintSet,
        interior: Array,
    ) -> None:
        """In units of what each parameter can be, of the cones at the interior point
        and of the loss."""
        norms = data.column_norms
        size = np.sqrt(data.tau_squared)
        scales = np.where(
            (norms > 0.0) & (size > 0.0), size / nonzero_or_one(norms), np.inf
        )
        self.theta_scale = np.minimum(scales, task.bound)
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
        """(e,) the shifts as dual variables of the constraints' entries, in units of
        loss per F."""
        by_constraint: dict[Constraint, Array] = {}
        # The groups are the first of the parts, in this order.
        for group, part, shift in zip(
            self.received.groups, self.parts, shifts, strict=False
        ):
            groups_with_values = zip(
                group.places.tolist(), self.loss_scale * part.scale * shift, strict=True
            )
            by_constraint |= {
                self.received.convex[k]: multiplier
                for k, multiplier in groups_with_values
            }
        return constraints.stack_multipliers(by_constraint)

    def shifted(self, x: Array, shifts: Sequence[Array], weight: float) -> list[Array]:
        """Pi_K(S - w F(x)): the next shifts."""
        both = zip(self.parts, shifts, strict=True)
        return [project(p.cone, shift - weight * p.values(x)) for p, shift in both]

    def rows(
        self, x: Array, shifts: Sequence[Array], weight: float
    ) -> tuple[Array, Array]:
        """r (m,) with L = |r|^2 up to a constant, and J (m, p): 2 J^T r is L's
        gradient, and 2 J^T J an element of its generalised Hessian where F is affine.
        """
        residuals = [self.R @ x - self.rho]
        slopes = [self.R]
        for part, shift in zip(self.parts, shifts, strict=True):
            jacobian = part.jacobian(x).reshape(len(shift), -1, len(x))
            r, J = projected_rows(part.cone, shift - weight * part.values(x), jacobian)
            residuals.append(r / np.sqrt(2.0 * weight))
            slopes.append(-np.sqrt(0.5 * weight) * J)
        return np.concatenate(residuals), np.concatenate(slopes)


def minimise(
    penalty: ShiftedPenalty, x: Array, tolerance: float
) -> tuple[Array, list[Array], dict[str, Any]]:
    """Continue weight and shifts from x until violation and complementarity are below
    tolerance, in the scaled units of the parts: x (p,), the shifts (multipliers) there,
    and what was spent."""
    # The first weight is in units of (scaled loss) / (scaled distance)^2.
    shifts = [np.zeros_like(part.values(x)) for part in penalty.parts]
    weight = 0.1
    # to the last stage's x, in scaled units; each stage takes back what it cost
    pull = 1e-6
    residual = np.inf
    stages = 0
    near = np.sqrt(pull) * np.eye(len(x))
    options = {
        "method": "lm",
        **dict.fromkeys(("ftol", "xtol", "gtol"), 1e-14),
        "max_nfev": _STEPS,
    }

    def rows(z: Array) -> tuple[Array, Array]:
        r, J = penalty.rows(z, shifts, weight)
        both = np.vstack(
            [np.column_stack([J, r]), np.column_stack([near, near @ (z - x)])]
        )
        # Turned into as few rows: nothing that MINPACK looks at changes, and its own QR
        # is not blocked.
        turned = np.asarray(np.linalg.qr(both, mode="r"))
        return turned[:, -1], turned[:, :-1]

    while stages < _STEPS:
        stages += 1
        residuals, slopes = in_turn(rows)  # of this stage's shifts and weight
        solution = optimize.least_squares(residuals, x, slopes, **options)
        last = x
        x = solution.x
        moved = penalty.shifted(x, shifts, weight)
        changes = (
            np.abs(a - b).max(initial=0.0) for a, b in zip(moved, shifts, strict=True)
        )
        previous = residual
        residual = float(max(changes, default=0.0)) / weight
        shifts = moved
        if max(residual, pull * np.abs(x - last).max(initial=0.0)) <= tolerance:
            break
        if residual > 0.25 * previous and weight * tolerance < 1.0:
            weight *= 10.0
    return x, shifts, {"residual": residual, "stages": stages}


@dataclass(frozen=True)
class Penalty(Estimator):
    """minimise loss(theta) + shifted penalty of F(theta), weights continued until it is
    exact.

    body : whether each link's mass must lie inside of its body, as for ``lmi-sdp``.
    thickness : smallest radius of gyration of a link [m]; 0 for none.
    starts : runs; the first from the problem's nominal robot, the others from seeded random points
        of the barycentric box, moved towards it until the convex constraints hold. Where the data
        leave directions open a run may stop above the optimum, and its certified gap says so.
    tolerance : of violation and complementarity, relative to the size of each constraint's values.
    joint_prior : as ``lmi-sdp`` has it.
    """

    name = "penalty"
    table_place: ClassVar[int | None] = 2
    description = (
        "one-step torque loss with an exact penalty, multi-start (the strongest)"
    )

    body: bool = True
    thickness: float = LmiSdpThickness.thickness
    starts: int = 5
    tolerance: float = 1e-9
    joint_prior: float = 0.0

    def demands(self, task: Task) -> ConstraintSet:
        """The same arrays as the SDP's."""
        demands = task.constraints.plus(task.minimum_thickness(self.thickness))
        return demands.plus(task.bodies) if self.body else demands

    def fit(self, task: Task) -> Fit:
        task = with_joint_prior(task, self.joint_prior)
        return fit_penalty(
            task, task.data, self.demands(task), self.starts, self.tolerance
        )


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

    def fit(self, task: Task) -> Fit:
        return fit_penalty(
            task, task.base_distance, self.demands(task), self.starts, self.tolerance
        )


def fit_penalty(
    task: Task,
    data: LeastSquares,
    constraints: ConstraintSet,
    starts: int,
    tolerance: float,
) -> Fit:
    """The best of several runs, each made feasible; raises InputError where nothing is
    feasible."""
    interior = interior_point(task, constraints)
    penalty = ShiftedPenalty(task, data, constraints, interior)
    box = BarycentricBox(task)
    rng = np.random.default_rng(task.seed)
    runs: list[dict[str, Any]] = []
    best: tuple[float, Array, list[Array]] | None = None
    for run in range(max(starts, 1)):
        random = box.theta(rng.uniform(box.lower, box.upper)) if run else interior
        start = repair(constraints, random, interior) if run else interior
        x, shifts, spent = minimise(penalty, start / penalty.theta_scale, tolerance)
        repaired = repair(constraints, penalty.theta_scale * x, interior)
        # The nearest point towards the interior where bounds that are not convex hold
        # too; if they hold nowhere on the way, the convex repair alone.
        way = (
            repaired + s * (interior - repaired)
            for s in (0.0, *np.logspace(-14, 0, 57))
        )
        holds = (
            p
            for p in way
            if all(bound.margin(p) >= 0.0 for bound in constraints.nonconvex)
        )
        theta = next(holds, repaired)
        objective = data.loss(theta)
        violation = max(constraints.worst(theta).values(), default=0.0)
        result_details = {
            "loss": task.data.loss(theta),
            "objective": objective,
            "violation": violation,
        }
        runs.append({**result_details, **spent})
        # A run that could not be made feasible counts behind every one that could.
        rank = objective if violation <= 1e-9 else np.inf
        # One that is lower by less than it violates is no better: its multipliers may
        # be worse.
        if best is None or rank < best[0] * (1.0 - 1e-7):
            best = (rank, theta, shifts)
        best_objective = min(r["objective"] for r in runs)
        task.progress(
            f"run {run + 1} of {starts}: best {best_objective:.6g}, violation {violation:.1e}"
        )
    assert best is not None
    _, theta, shifts = best
    multipliers = penalty.multipliers(constraints, shifts)
    details = {"runs": runs}
    return Fit(
        theta,
        Objective(data),
        constraints,
        multipliers,
        interior=interior,
        details=details,
    )


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
        norms = task.data.column_norms
        self.links = task.links
        separate = np.where(
            norms > 0.0, np.sqrt(task.data.tau_squared), 0.0
        ) / nonzero_or_one(norms)
        self.upper = np.minimum(np.maximum(JOINT_PARAMETER_RANGE, separate), task.bound)
        lowest = [parameter.lower for parameter in task.model.parameters]
        self.lower = np.maximum(-self.upper, lowest)
        implied = task.bound[self.links]
        implied[:, 1:4] /= nonzero_or_one(implied[:, :1])
        low, (lower, upper) = -implied, np.moveaxis(task.box[: len(self.links)], 2, 0)
        low[:, [0, 4, 6, 9]] = 0.0
        self.lower[self.links] = np.where(np.isfinite(lower), lower, low)
        self.upper[self.links] = np.where(np.isfinite(upper), upper, implied)

    def theta(self, p: Array) -> Array:
        """Standard parameters of p: h = m c, J = I + m (c.c 1 - c c^T)."""
        out = p.copy()
        out[self.links] = inertia.standard_from_barycentric(p[self.links])
        return out

    def pull_back(self, p: Array, gradient: Array) -> Array:
        """(d theta / d p)^T gradient."""
        out = gradient.copy()
        c = p[self.links[:, 1:4]]
        g = gradient[self.links]
        across = np.einsum(
            "ne,eij,nj->ni", g[:, 4:], inertia.STEINER_FORMS, c
        )  # half of d J / d(m c)
        out[self.links[:, 0]] += np.sum(c * (g[:, 1:4] + across), axis=1)
        out[self.links[:, 1:4]] = p[self.links[:, :1]] * (g[:, 1:4] + 2.0 * across)
        return out

    def p(self, theta: Array) -> Array:
        """p of standard parameters, put inside the box (a massless link: its middle)."""
        out = theta.copy()
        out[self.links] = inertia.barycentric_from_standard(theta[self.links])
        middle = 0.5 * (self.lower + self.upper)
        return np.clip(np.where(np.isfinite(out), out, middle), self.lower, self.upper)
