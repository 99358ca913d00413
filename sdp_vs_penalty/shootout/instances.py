"""The problems of the shootout: what one is, in which form solvers get it, and what it
is made from, a simulated or measured robot or a random serial chain. All are
deterministic.
"""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Self

import numpy as np
import scipy

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import PoseOptions, build_problem
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdpThickness, interior_point
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import CentreOfMassCone, Problem, open_box
from sdp_vs_penalty.problem.published import measured_runs
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.constraint import ConeGroup, Constraint, ConstraintSet
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.simulation.experiments import experiment
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem, Entropy
from sdp_vs_penalty.solvers.identification import (
    SdpProblem,
    conic_problem,
    least_squares_sdp,
    plain_rows,
    scaled,
)

_CHAIN_SEED = 20191015


@dataclass(frozen=True)
class Instance:
    """The convex problem of a task, with a prior."""

    #: Data, constraints and bounds in the instance's own units; nothing nonconvex.
    task: Task
    #: The entropic prior; None without one.
    entropy: Entropy | None = None
    #: "residual": R and rho, for conic solvers centred and scaled. "rows" and "gram" are
    #: conic forms without either, as users write them (:func:`unscaled_sdp`).
    formulation: str = "residual"
    #: Name of the instance; "" where it has none.
    name: str = ""

    def having(self, convex: Iterable[Constraint]) -> Self:
        """Return the instance with other convex constraints."""
        constraints = ConstraintSet(tuple(convex))
        return replace(self, task=replace(self.task, constraints=constraints))

    def with_data(self, data: LeastSquares) -> Self:
        """Return the instance with other data of the objective."""
        return replace(self, task=replace(self.task, data=data))

    @cached_property
    def problem(self) -> ConvexProblem:
        """What is minimised, over which theta."""
        return replace(self.task.problem, entropy=self.entropy)

    @property
    def constraints(self) -> ConstraintSet:
        """The convex constraints on theta."""
        return self.task.constraints

    @property
    def data(self) -> LeastSquares:
        """The least-squares part of the objective, |R theta - rho|^2."""
        return self.task.data

    @cached_property
    def interior(self) -> Array | None:
        """A strictly feasible theta (p,); None if the constraints exclude each
        other.
        """
        try:
            return interior_point(self.task, self.constraints)
        except InputError:
            return None

    @property
    def sent(self) -> tuple[Constraint, ...]:
        """The constraints that solvers get: without redundant ones in the formulation
        "residual", all in the others, which imitate what users write."""
        is_ours = self.formulation == "residual"
        return self.problem.essential if is_ours else self.constraints.convex

    @cached_property
    def sdp(self) -> SdpProblem:
        """The semidefinite program as it is posed to conic solvers."""
        if self.formulation != "residual":
            return unscaled_sdp(self.data, self.sent, self.formulation)
        centre = self.inside
        return least_squares_sdp(
            self.problem, centre, centre, least_loss=self.least_loss
        )

    @property
    def inside(self) -> Array:
        """The interior point (p,), or the nominal theta where nothing is feasible."""
        return self.task.nominal if self.interior is None else self.interior

    @property
    def least_loss(self) -> float:
        """Loss below which the objective as it is handed out says little more: the
        least number that relative errors refer to.

        The bare quadratic form leaves out rho^T rho, and has its size. The other forms
        are posed in units of at least a millionth of |tau|^2.
        """
        rho = self.data.rho
        is_gram = self.formulation == "gram"
        size = float(rho @ rho) if is_gram else 1e-6 * self.data.tau_squared
        return max(size, self.least_size)

    @property
    def least_size(self) -> float:
        """Least size that errors refer to: 1 in a form that is handed out without scales,
        as in solvers' own tolerances.
        """
        return 0.0 if self.formulation == "residual" else 1.0

    @cached_property
    def hash(self) -> str:
        """A key of 16 hexadecimal digits that changes with the problem or its
        formulation.

        It hashes objective and constraints at three random points, to six digits, which
        all linear algebra libraries share.
        """
        bound = self.task.bound
        entropy = self.entropy
        numbers = [self.data.tau_squared, float(bound.sum())]
        numbers += [self.least_loss, self.least_size]
        if entropy is not None:
            numbers += [entropy.weight, float(entropy.nominal.sum())]
        points = np.random.default_rng(0).uniform(-1.0, 1.0, (3, len(bound))) * bound
        for theta in points:
            numbers.append(self.data.loss(theta))
            numbers += [float(c.value(theta).sum()) for c in self.constraints.convex]
        families = [f"{c.family} {c.name} {c.cone}" for c in self.constraints.convex]
        digits = [f"{x:.6g}" for x in numbers]
        words = [self.formulation, self.name, *families, *digits]
        return hashlib.sha256("\n".join(words).encode()).hexdigest()[:16]


def unscaled_sdp(
    data: LeastSquares, constraints: Sequence[Constraint], formulation: str
) -> SdpProblem:
    """Pose a problem as users write it, without a centre and without any scaling.

    "gram": minimise theta^T (R^T R) theta - 2 rho^T R theta; the constant rho^T rho is
    left out. "rows": minimise |z|^2 subject to R theta - z = rho.

    Parameters
    ----------
    data : LeastSquares
        R (r, p) and rho (r,) of theta (p,).

    Returns
    -------
    SdpProblem
        minimise 1/2 x^T P x + q^T x over cones, and how theta and the loss follow from
        x.
    """
    r, p = data.R.shape
    groups = list[ConeGroup]()
    offset = data.residual_norm**2
    if formulation == "rows":
        # Variables are theta (p) and z (r); P holds twice the quadratic form.
        equations = np.hstack([data.R, -np.eye(r)])
        groups.append(plain_rows("zero", equations, -data.rho))
        P = scipy.sparse.diags(np.repeat([0.0, 2.0], [p, r])).tocsc()
        q = np.zeros(p + r)
    else:
        P = scipy.sparse.csc_matrix(np.triu(2.0 * (data.R.T @ data.R)))
        q = -2.0 * (data.R.T @ data.rho)
        offset += float(data.rho @ data.rho)
    # The r equations, if any, are the first rows of the conic problem. Centre 0 and
    # scales 1 leave the constraints as they are.
    first = r if groups else 0
    more, placed = scaled(constraints, np.zeros(p), np.ones(p), None, first=first)
    conic = conic_problem([*groups, *more], P, q)
    return SdpProblem(
        conic,
        centre=np.zeros(p),
        theta_scale=np.ones(p),
        loss_scale=1.0,
        placed=placed,
        offset=offset,
    )


def principal_rows(data: LeastSquares) -> LeastSquares:
    """Return the same loss by the rows s_k v_k of R = U S V^T, and u_k^T rho.

    Up to signs they follow from the loss. A triangular factor does not: below a column
    that depends on earlier ones, its rows are any rotation of each other, which
    rounding chooses. What rounds or selects rows starts from these.
    """
    left_vectors, sizes, right = np.linalg.svd(data.R, full_matrices=False)
    determined = sizes > 1e-10 * sizes[0]
    rho = left_vectors.T[determined] @ data.rho
    lost = max(float(data.rho @ data.rho - rho @ rho), 0.0)
    residual_norm = float(np.hypot(data.residual_norm, np.sqrt(lost)))
    R = sizes[determined, None] * right[determined]
    return replace(data, R=R, rho=rho, residual_norm=residual_norm)


def exactly_squarable(data: LeastSquares) -> LeastSquares:
    """Return the data with R and rho in whole multiples of a unit of their column.

    They have 20 bits, so that doubles hold R^T R and R^T rho without rounding: the Gram
    matrix has no negative eigenvalue, and a proof for R and rho is one for it.
    """

    def rounded(columns: Array) -> Array:
        largest = np.abs(columns).max(axis=0)
        unit = 2.0 ** (np.ceil(np.log2(nonzero_or_one(largest))) - 20)
        return np.rint(columns / unit) * unit

    exact = principal_rows(data)
    return replace(exact, R=rounded(exact.R), rho=rounded(exact.rho[:, None])[:, 0])


@dataclass(frozen=True)
class Units:
    """Units of mass and length; seconds stay."""

    #: Unit of mass [kg].
    mass: float
    #: Unit of length [m].
    length: float

    @property
    def torque(self) -> float:
        """Factor from a torque or an inertia in SI units to these units."""
        return 1.0 / (self.mass * self.length**2)

    @property
    def corner(self) -> Array:
        """(4,) factors d with P' = diag(d) P diag(d), for a pseudo-inertia matrix P in
        SI units and P' in these units.

        P = [[second moments (3x3), first moments], [first moments^T, mass]]; its
        entries are divided by mass length^2, mass length, and mass.
        """
        lengths = np.array([1.0, 1.0, 1.0, self.length])
        return lengths / (self.length * np.sqrt(self.mass))

    def parameters(self, task: Task) -> Array:
        """Return the factor from each parameter in SI units to these units.

        Parameters
        ----------
        task : Task
            The problem in SI units; it says which parameters are those of links.

        Returns
        -------
        (p,) array
            Factors; parameters of effects (friction ...) scale like torques.
        """
        first_moment = 1.0 / (self.mass * self.length)
        factors = np.full(len(task.bound), self.torque)
        # A link's mass, three first moments and six inertias.
        factors[task.links] = [1.0 / self.mass, *[first_moment] * 3, *[self.torque] * 6]
        return factors

    def rows(self, family: str) -> float:
        """Return the factor from a constraint's values in SI units to these units.

        Parameters
        ----------
        family : str
            Family of constraints: one on masses, on first moments, or on inertias.
        """
        if family in ("mass", "total mass", "bounding ellipsoid", "body"):
            return 1.0 / self.mass
        if family in ("centre of mass", "centre of mass cone"):
            return 1.0 / (self.mass * self.length)
        return self.torque

    def constraint(self, c: Constraint, parameters: Array) -> Constraint:
        """Return a constraint F(theta) = constant + coefficients theta in a cone in
        these units.

        Parameters
        ----------
        parameters : (p,) array
            Factor of each parameter, the result of :meth:`parameters`.

        Returns
        -------
        Constraint
            It has the same feasible set: values and parameters are scaled by positive
            factors.
        """
        scale: Array | float = self.rows(c.family)
        if c.cone == "psd":
            scale = np.outer(self.corner, self.corner)
        # Coefficients (k, ...) have one leading entry for each of the k parameters.
        shape = (len(c.indices), *[1] * c.constant.ndim)
        factors = parameters[c.indices].reshape(shape)
        coefficients = c.coefficients * scale / factors
        return replace(c, constant=c.constant * scale, coefficients=coefficients)


def in_units(instance: Instance, mass: float, length: float) -> Instance:
    """Return the same problem in other units of mass and length; seconds stay.

    Torques become tau / (mass length^2); parameters, bounds and constraint rows follow
    their units: ``mass`` [kg] and ``length`` [m].
    """
    task = instance.task
    data = instance.data
    units = Units(mass, length)
    torque = units.torque
    factor = units.parameters(task)
    changed = replace(
        data,
        R=torque * data.R / factor,
        rho=torque * data.rho,
        residual_norm=torque * data.residual_norm,
        tau_squared=torque**2 * data.tau_squared,
    )
    convex = [units.constraint(c, factor) for c in task.constraints.convex]
    moved = replace(
        task,
        data=changed,
        constraints=ConstraintSet(tuple(convex)),
        bound=task.bound * factor,
        nominal=task.nominal * factor,
    )
    entropy = instance.entropy
    if entropy is not None:
        nominal = entropy.nominal * np.outer(units.corner, units.corner)
        weight = entropy.weight * torque**2
        entropy = Entropy(weight, moved.pseudo_inertias, nominal)
    return replace(instance, task=moved, entropy=entropy)


def recorded(
    robot: str, source: str, step: str, shape: str, stop: float = np.inf
) -> Instance:
    """Build an instance from a robot's simulated experiment or its real measurements.

    Parameters
    ----------
    robot : str
        Name of a problem, such as "panda".
    step : str
        "one-step" fits the torques, "two-step" the base parameters of a first fit.
    shape : str
        Demand on the links' shapes, as in :func:`instance_of_task`.
    stop : float
        Length of the run that is used [s].

    Raises
    ------
    InputError
        If the measurements are absent.
    """
    return instance_of_task(_task(robot, source, stop), step, shape)


def instance_of_task(task: Task, step: str, shape: str) -> Instance:
    """Build an instance from a task, with a demand on the links' shapes.

    Parameters
    ----------
    step : str
        "one-step" minimises the torque error, "two-step" the distance of the base
        parameters from their least-squares estimate.
    shape : str
        "plain" adds nothing, "gyration" demands a minimal thickness, "regulariser" adds
        an entropic distance from the nominal links, "cones" limits the centres of mass.
    """
    data = task.data if step == "one-step" else task.base_distance
    demands = list[Constraint]()
    entropy = None
    if shape == "gyration":
        demands = task.minimum_thickness(LmiSdpThickness.thickness)
    elif shape == "cones":
        demands = shape_cones(task)
    elif shape == "regulariser":
        # A row's variance for a weight; without noise rounding must not decide it.
        loss = max(data.loss(task.ols), 1e-6 * data.tau_squared)
        weight = loss / max(data.rows, 1)
        nominal = inertia.pseudo_inertia(task.nominal[task.links])
        entropy = Entropy(weight, task.pseudo_inertias, nominal)
    constraints = ConstraintSet((*task.constraints.convex, *demands))
    return Instance(replace(task, data=data, constraints=constraints), entropy)


def shape_cones(task: Task) -> list[Constraint]:
    """Return a cone for each link's centre of mass, |c across z| <= radius + slope c_z.

    The 2R of the paper has such cones. Each opens along z, and is wide enough to hold
    the link's nominal centre of mass.
    """
    cones = []
    for k, indices in enumerate(task.links):
        m, mx, my, mz = task.nominal[indices[:4]]
        centre = np.array([mx, my, mz]) / m
        slope = 0.3
        # 20 % and 20 mm wider than the nominal centre needs.
        across = float(np.hypot(centre[0], centre[1]))
        radius = 1.2 * across + 0.02 - slope * min(centre[2], 0.0)
        cones.append(CentreOfMassCone(k + 1, "z", radius, slope).constraint(indices))
    return cones


@lru_cache(maxsize=8)
def _task(robot: str, source: str, stop: float) -> Task:
    """Build the identification task of a robot from the first ``stop`` seconds of its
    run.

    Nonconvex constraints are left out.
    """
    problem = load_problem(robot)
    effects = None
    if source == "measured":
        if not (runs := list(measured_runs(robot).values())):
            what = f"The measurements of {robot} are absent"
            raise InputError(what, "name their folder in SDP_VS_PENALTY_DATA")
        run = replace(runs[0], dq=None)
    else:
        described = experiment(problem)
        run = described.training_run(seed=0)
        effects = described.effects
    task = build_problem(
        problem, _first_seconds(run, problem, stop), PoseOptions(effects)
    ).task
    return replace(task, constraints=ConstraintSet(task.constraints.convex))


def _first_seconds(run: Measurements, problem: Problem, stop: float) -> Measurements:
    """Return the first ``stop`` [s] of a run.

    Below 5 s they count from where the robot has started to move, and the time that the
    filters lose at both ends is added: little else would be left.
    """
    if stop >= 5.0:
        return run.window(0.0, stop)
    # The robot moves once a joint is a fifth of the largest range from its start.
    distance = np.abs(run.q - run.q[0]).max(axis=1)
    is_away = distance > 0.2 * np.ptp(run.q, axis=0).max()
    begin = float(run.t[np.argmax(is_away)] - run.t[0])
    settings = problem.preprocessing.resolve(run)
    assert settings.state_cutoff is not None
    assert settings.torque_cutoff is not None
    # The filters' kernels reach two periods of their cut-off beyond each row.
    margin = 2.0 / settings.state_cutoff + 2.0 / settings.torque_cutoff
    return run.window(begin, begin + stop + 2.0 * margin)


def _seed_of_chain(base: int, n: int, draw: int) -> list[int]:
    """Return the seed of the draw-th random arm of n links.

    The first draw (0) is left out of the seed, so that it stays the arm of earlier
    versions, which had one arm for each n.
    """
    return [base, n] if draw == 0 else [base, n, draw]


def chain_problem(n: int, draw: int = 0) -> Problem:
    """Make a random serial arm: its kinematics, with nominal links shaped as balls.

    Twists are 0 or +-90 degrees, link lengths 0.15 to 0.45 m, and each ball weighs 2
    kg.

    Parameters
    ----------
    draw : int
        Which of the arms of this size.

    Returns
    -------
    Problem
        Without bounds on the parameters.
    """
    rng = np.random.default_rng(_seed_of_chain(_CHAIN_SEED, n, draw))
    a = rng.uniform(0.0, 0.3, n)
    twist = rng.choice([-0.5, 0.0, 0.5], n)
    d = rng.uniform(0.05, 0.3, n)
    robot = Robot.from_dh(
        f"chain{n}", a.tolist(), (np.pi * twist).tolist(), d.tolist(), "modified"
    )
    # Balls: I = 2/5 m r^2 on the diagonal (columns Ixx, Iyy, Izz), r = 0.4 reach.
    mass = 2.0
    radii = 0.4 * np.array(robot.link_reach())
    balls = np.zeros((n, 10))
    balls[:, 0] = mass
    balls[:, [4, 6, 9]] = 0.4 * mass * radii[:, None] ** 2
    links = inertia.standard_from_barycentric(balls)
    title = f"random serial chain of {n} links"
    return Problem(robot.name, title, robot, open_box(n), links, torque_side="link")


def chain_task(n: int, draw: int = 0) -> Task:
    """Simulate torques of a random serial arm in 60 random states, and pose its
    identification.

    Its true links are nearly rods, so that the constraints of consistency bind.
    Friction acts in every joint. Each joint's torque has white noise with a standard
    deviation of 1 % of its root mean square.

    Parameters
    ----------
    draw : int
        Number of the random arm of this size, from 0.

    Returns
    -------
    Task
        Rows of each joint are divided by the standard deviation of its noise.
    """
    rng = np.random.default_rng(_seed_of_chain(_CHAIN_SEED + 1, n, draw))
    problem = chain_problem(n, draw)
    samples = 60
    model = problem.model()
    q = problem.robot.random_configurations(samples, _CHAIN_SEED)
    dq = rng.normal(size=(samples, n))
    ddq = 3.0 * rng.normal(size=(samples, n))
    t = np.linspace(0.0, 1.0, samples)
    motion = Motion(t, q, dq, ddq)
    # Ten parameters of each link, then three of each joint's friction.
    links = thin_links(rng, problem).ravel()
    friction = rng.uniform(0.1, 0.5, 3 * n)
    theta = np.concatenate([links, friction])
    columns = model.columns(motion)
    torque = np.column_stack([c.columns @ theta[c.indices] for c in columns])
    # Of each joint [regressor, torque], (samples, p + 1).
    stack = [
        np.column_stack([c.dense_columns(len(theta)), torque_of_joint])
        for c, torque_of_joint in zip(columns, torque.T, strict=True)
    ]
    # In units of the noise, 1 % of the joint's RMS torque (the last column).
    for rows in stack:
        rows /= 0.01 * float(np.sqrt(np.mean(rows[:, -1] ** 2)))
        rows[:, -1] += rng.normal(size=samples)
    data = LeastSquares.stacked(stack, n * samples)
    convex = problem.constraints(model).convex
    return Task(
        model=model,
        data=data,
        constraints=ConstraintSet(convex),
        bound=problem.parameter_bound(model),
        nominal=problem.nominal(model),
        box=problem.box,
    )


def thin_links(rng: np.random.Generator, problem: Problem) -> Array:
    """Draw links of 1 to 4 kg whose mass lies near a rod, so that constraints bind.

    Parameters
    ----------
    problem : Problem
        Its links' reach [m] scales the centres of mass and the radii of gyration.

    Returns
    -------
    (n, 10) array
        Standard parameters [kg, kg m, kg m^2].
    """
    links = []
    for reach in problem.robot.link_reach():
        mass = rng.uniform(1.0, 4.0)
        centre = rng.uniform(-0.2, 0.2, 3) * reach
        frame, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        # Radii of gyration along the axes: a rod is long in one direction only.
        gyration = reach * np.array([0.3, 0.05, 0.02]) * rng.uniform(0.5, 1.0, 3)
        about_centre = mass * (frame * gyration**2) @ frame.T
        second = about_centre + mass * np.outer(centre, centre)
        first = (mass * centre)[:, None]
        pseudo_inertia = np.block([[second, first], [first.T, mass]])
        links.append(inertia.from_pseudo_inertia(pseudo_inertia))
    return np.array(links)
