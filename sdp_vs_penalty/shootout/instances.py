"""The problems of the shootout: what one is, in which form solvers get it, and what it
is made from, a simulated or measured robot or a random serial chain. All are
deterministic.
"""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np
import scipy

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import PoseOptions, build_problem
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdpThickness, essential, interior_point
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import CentreOfMassCone, Problem, open_box
from sdp_vs_penalty.problem.published import measured_runs
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import ConeGroup, Constraint, ConstraintSet
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.simulation.experiments import experiment
from sdp_vs_penalty.solvers.identification import (
    SdpProblem,
    conic_problem,
    least_squares_sdp,
    plain_rows,
    scaled,
)
from sdp_vs_penalty.solvers.objective import Entropy, Objective

_CHAIN_SEED = 20191015


@dataclass(frozen=True)
class Instance:
    """minimise objective(theta) over task.constraints.convex, |theta_k| <= task.bound.

    task : data, constraints and bounds in the instance's own units; what it calls nonconvex is empty.
    formulation : "residual" is ours, centred and scaled; "gram", "gram in float32" and "rows" are what
        users write (:func:`unscaled_sdp`).
    """

    task: Task
    objective: Objective
    formulation: str = "residual"
    name: str = ""

    def having(self, convex: Iterable[Constraint] | None = None, **data: Any) -> Self:
        """The instance with other constraints, or other entries of the data.

        Parameters
        ----------
        convex : iterable of Constraint, optional
            Default: as they are.
        **data : Any
            Fields of the least-squares data.

        Returns
        -------
        Instance
            A copy.
        """
        rows = replace(self.data, **data)
        constraints_kept = (
            self.constraints if convex is None else ConstraintSet(tuple(convex))
        )
        objective = replace(self.objective, least_squares=rows)
        return replace(
            self,
            task=replace(self.task, data=rows, constraints=constraints_kept),
            objective=objective,
        )

    @property
    def constraints(self) -> ConstraintSet:
        """The convex constraints."""
        return self.task.constraints

    @property
    def data(self) -> LeastSquares:
        """The least-squares part of the objective."""
        return self.objective.least_squares

    @cached_property
    def interior(self) -> Array | None:
        """A strictly feasible theta, or None where the constraints exclude each other."""
        try:
            return interior_point(self.task, self.constraints)
        except InputError:
            return None

    @cached_property
    def sent(self) -> list[Constraint]:
        """The constraints that solvers get: ours without redundant ones, users' all of
        them."""
        if self.formulation == "residual":
            return essential(self.constraints, self.objective)
        return list(self.constraints.convex)

    @cached_property
    def sdp(self) -> SdpProblem:
        """The problem as it is posed to conic solvers."""
        if self.formulation != "residual":
            return unscaled_sdp(self.data, self.sent, self.formulation)
        centre = self.task.nominal if self.interior is None else self.interior
        smallest_scale = 1e-6 * self.data.tau_squared
        return least_squares_sdp(
            self.objective,
            self.sent,
            centre,
            self.task.bound,
            centre,
            least_loss=smallest_scale,
        )

    @cached_property
    def hash(self) -> str:
        """Sixteen hexadecimal digits of the problem and the form it is posed in: of
        objective and constraints at three points, to the six digits that all libraries
        of linear algebra share."""
        bound = self.task.bound
        entropy = self.objective.entropy
        numbers = [self.data.tau_squared, float(bound.sum())]
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
    data: LeastSquares,
    constraints: Sequence[Constraint],
    formulation: str,
) -> SdpProblem:
    """The problem as users write it, without a centre, without scales of parameters or
    cones.

    gram   minimise theta^T (R^T R) theta - 2 rho^T R theta, whose constant rho^T rho is left out;
           "gram in float32" sums R^T R and R^T rho in single precision
    rows   minimise |z|^2 subject to R theta - z = rho

    Parameters
    ----------
    data : LeastSquares
        R (r, p), rho (r,).
    constraints : sequence of Constraint
        In theta.
    formulation : str
        "gram", "gram in float32" or "rows".

    Returns
    -------
    SdpProblem
        Without scales.
    """
    r, p = data.R.shape
    groups = list[ConeGroup]()
    offset = data.residual_norm**2
    if formulation == "rows":
        equations = np.hstack(
            [
                data.R,
                -np.eye(r),
            ]
        )
        groups.append(plain_rows("zero", equations, -data.rho))
        P = scipy.sparse.diags(np.repeat([0.0, 2.0], [p, r])).tocsc()
        q = np.zeros(p + r)
    else:
        precision = np.float32 if formulation.endswith("float32") else np.float64
        R: Array = data.R.astype(precision)
        rho: Array = data.rho.astype(precision)
        gram = (R.T @ R).astype(float)
        P = scipy.sparse.csc_matrix(np.triu(2.0 * gram))
        q = -2.0 * (R.T @ rho).astype(float)
        offset += float(data.rho @ data.rho)
    first = r if groups else 0
    more, placed = scaled(
        constraints,
        np.zeros(p),
        np.ones(p),
        None,
        first=first,
    )
    conic = conic_problem([*groups, *more], P, q)
    return SdpProblem(
        conic,
        np.zeros(p),
        np.ones(p),
        1.0,
        placed,
        offset,
    )


@dataclass(frozen=True)
class Units:
    """Masses in ``mass`` kg and lengths in ``length`` m; seconds stay."""

    mass: float
    length: float

    @property
    def torque(self) -> float:
        """What a torque or an inertia in SI units is multiplied by."""
        return 1.0 / (self.mass * self.length**2)

    @property
    def corner(self) -> Array:
        """(4,) of rows and columns of a pseudo-inertia."""
        lengths = np.array([1.0, 1.0, 1.0, self.length])
        return lengths / (self.length * np.sqrt(self.mass))

    def parameters(self, task: Task) -> Array:
        """What parameters in SI units are multiplied by.

        Parameters
        ----------
        task : Task
            In SI units.

        Returns
        -------
        (p,) array
            Factors.
        """
        first_moment = 1.0 / (self.mass * self.length)
        out = np.full(len(task.bound), self.torque)
        out[task.links] = [
            1.0 / self.mass,
            *[first_moment] * 3,
            *[self.torque] * 6,
        ]
        return out

    def rows(self, family: str) -> float:
        """What a family's constraint rows in SI units are multiplied by.

        Parameters
        ----------
        family : str
            Of constraints.

        Returns
        -------
        float
            Factor.
        """
        if family in ("mass", "total mass", "bounding ellipsoid", "body"):
            return 1.0 / self.mass
        if family in ("centre of mass", "centre of mass cone"):
            return 1.0 / (self.mass * self.length)
        return self.torque

    def constraint(self, c: Constraint, parameters: Array) -> Constraint:
        """A constraint in these units.

        Parameters
        ----------
        c : Constraint
            In SI units.
        parameters : (p,) array
            What parameters are multiplied by.

        Returns
        -------
        Constraint
            In these units.
        """
        scale: Array | float = self.rows(c.family)
        if c.cone == "psd":
            scale = np.outer(self.corner, self.corner)
        size = (len(c.indices), *[1] * c.constant.ndim)
        local = parameters[c.indices].reshape(size)
        coefficients = c.coefficients * scale / local
        return replace(c, constant=c.constant * scale, coefficients=coefficients)


def in_units(instance: Instance, mass: float, length: float) -> Instance:
    """The problem in other units of mass and length; seconds stay.

    Torques become tau / (mass length^2); parameters, bounds and constraint rows follow
    their units.

    Parameters
    ----------
    instance : Instance
        In SI units.
    mass : float
        Unit of mass [kg].
    length : float
        Unit of length [m].

    Returns
    -------
    Instance
        The same problem.
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
    entropy = instance.objective.entropy
    if entropy is not None:
        nominal = entropy.nominal * np.outer(units.corner, units.corner)
        weight = entropy.weight * torque**2
        entropy = Entropy(weight, moved.pseudo_inertias, nominal)
    return replace(instance, task=moved, objective=Objective(changed, entropy))


def recorded(
    robot: str,
    source: str,
    step: str,
    shape: str,
    stop: float = np.inf,
) -> Instance:
    """Instance from a robot's simulated experiment or its real measurements.

    Parameters
    ----------
    robot : str
        Name of a problem.
    source : str
        "simulated" or "measured".
    step : str
        "one-step" or "two-step".
    shape : str
        The demand on links' shapes.
    stop : float
        Seconds of the run that count.

    Returns
    -------
    Instance
        Without a name.

    Raises
    ------
    InputError
        Where the measurements are absent.
    """
    return posed(_task(robot, source, stop), step, shape)


def posed(task: Task, step: str, shape: str) -> Instance:
    """Instance from a task, with a demand on the links' shapes.

    Parameters
    ----------
    task : Task
        Data and constraints.
    step : str
        "one-step" (torque) or "two-step" (base parameters).
    shape : str
        "plain", "gyration", "regulariser" or "cones".

    Returns
    -------
    Instance
        Without a name.
    """
    demands = list[Constraint]()
    if shape == "gyration":
        demands = task.minimum_thickness(LmiSdpThickness.thickness)
    elif shape == "cones":
        demands = shape_cones(task)
    convex = (*task.constraints.convex, *demands)
    task = replace(task, constraints=ConstraintSet(convex))
    data = task.data if step == "one-step" else task.base_distance
    entropy = None
    if shape == "regulariser":
        loss = max(data.loss(task.ols), 1e-6 * data.tau_squared)
        weight = loss / max(data.rows, 1)
        nominal = inertia.pseudo_inertia(task.nominal[task.links])
        entropy = Entropy(weight, task.pseudo_inertias, nominal)
    return Instance(replace(task, data=data), Objective(data, entropy))


def shape_cones(task: Task) -> list[Constraint]:
    """Cones for the centres of mass, as the 2R has: |c across z| <= r + |slope| c_z.

    A cone opens along z from the nominal centre's plane, wide enough to hold it.

    Parameters
    ----------
    task : Task
        With nominal links.

    Returns
    -------
    list of Constraint
        One a link.
    """
    out = []
    for k, indices in enumerate(task.links):
        m, mx, my, mz = task.nominal[indices[:4]]
        centre = np.array([mx, my, mz]) / m
        slope = 0.3
        radius = 1.2 * float(np.hypot(*centre[:2])) + 0.02 - slope * min(centre[2], 0.0)
        out.append(CentreOfMassCone(k + 1, "z", radius, slope).constraint(indices))
    return out


@lru_cache(maxsize=8)
def _task(robot: str, source: str, stop: float) -> Task:
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
    task = build_problem(problem, _part(run, problem, stop), PoseOptions(effects)).task
    return replace(task, constraints=ConstraintSet(task.constraints.convex))


def _part(run: Measurements, problem: Problem, stop: float) -> Measurements:
    """The first ``stop`` seconds; of one or two, so many seconds of rows in which the
    robot moves."""
    if stop >= 5.0:
        return run.window(0.0, stop)
    moved = np.abs(run.q - run.q[0]).max(axis=1) > 0.2 * np.ptp(run.q, axis=0).max()
    begin = float(run.t[np.argmax(moved)] - run.t[0])
    settings = problem.preprocessing.resolve(run)
    assert settings.state_cutoff is not None
    assert settings.torque_cutoff is not None
    # The filters' kernels reach two periods of their cut-off beyond each row.
    reach = 2.0 / settings.state_cutoff + 2.0 / settings.torque_cutoff
    return run.window(begin, begin + stop + 2.0 * reach)


def chain_problem(n: int, draw: int = 0) -> Problem:
    """Random serial chain: twists of +-90 degrees or 0, link lengths of 0.15-0.45 m, nominal
    links as balls.

    Parameters
    ----------
    n : int
        Links.
    draw : int
        Number of the arm among those of this size.

    Returns
    -------
    Problem
        Without bounds.
    """
    rng = np.random.default_rng(
        [
            _CHAIN_SEED,
            n,
            *[draw] * (draw > 0),
        ]
    )
    a = rng.uniform(0.0, 0.3, n)
    twist = rng.choice([-0.5, 0.0, 0.5], n)
    d = rng.uniform(0.05, 0.3, n)
    robot = Robot.from_dh(
        f"chain{n}",
        a.tolist(),
        (np.pi * twist).tolist(),
        d.tolist(),
        "modified",
    )
    balls = np.zeros((n, 10))
    balls[:, 0] = 2.0
    balls[:, [4, 6, 9]] = 0.4 * 2.0 * (0.4 * np.array(robot.link_reach())[:, None]) ** 2
    links = inertia.standard_from_barycentric(balls)
    title = f"random serial chain of {n} links"
    return Problem(
        robot.name,
        title,
        robot,
        open_box(n),
        links,
        torque_side="link",
    )


def chain_task(n: int, draw: int = 0) -> Task:
    """Data of a random serial chain: random states, thin random links, friction.

    Parameters
    ----------
    n : int
        Links.
    draw : int
        Number of the arm among those of this size.

    Returns
    -------
    Task
        Torques have white noise of 1 % of each joint's.
    """
    rng = np.random.default_rng(
        [
            _CHAIN_SEED + 1,
            n,
            *[draw] * (draw > 0),
        ]
    )
    problem = chain_problem(n, draw)
    samples = 60
    model = problem.model()
    q = problem.robot.random_configurations(samples, _CHAIN_SEED)
    dq, ddq = rng.normal(size=(samples, n)), 3.0 * rng.normal(size=(samples, n))
    motion = Motion(
        np.linspace(0.0, 1.0, samples),
        q,
        dq,
        ddq,
    )
    theta = np.concatenate(
        [
            thin_links(rng, problem).ravel(),
            rng.uniform(0.1, 0.5, 3 * n),
        ]
    )
    columns = model.columns(motion)
    torque = np.column_stack([c.columns @ theta[c.indices] for c in columns])
    stack = [
        np.column_stack([c.dense_columns(len(theta)), t])
        for c, t in zip(columns, torque.T, strict=True)
    ]
    for wide in stack:
        wide /= 0.01 * float(np.sqrt(np.mean(wide[:, -1] ** 2)))
        wide[:, -1] += rng.normal(size=samples)
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
    """Links of 1-4 kg whose mass lies near a rod: constraints that bind.

    Parameters
    ----------
    rng : Generator
        Random numbers.
    problem : Problem
        Gives the links' reach.

    Returns
    -------
    (n, 10) array
        Standard parameters [kg, kg m, kg m^2].
    """
    out = []
    for reach in problem.robot.link_reach():
        mass = rng.uniform(1.0, 4.0)
        centre = rng.uniform(-0.2, 0.2, 3) * reach
        frame, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        gyration = reach * np.array([0.3, 0.05, 0.02]) * rng.uniform(0.5, 1.0, 3)
        second = mass * (frame * gyration**2) @ frame.T + mass * np.outer(
            centre, centre
        )
        corner = (mass * centre)[:, None]
        out.append(
            inertia.from_pseudo_inertia(np.block([[second, corner], [corner.T, mass]]))
        )
    return np.array(out)
