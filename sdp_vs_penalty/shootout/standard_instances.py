"""Instances as they come: simulated and measured robots, and random serial chains."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.pose import PoseOptions, pose
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdpThickness
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import CentreOfMassCone, Problem, open_box
from sdp_vs_penalty.problem.published import measured_runs
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.simulation.experiments import experiment
from sdp_vs_penalty.solvers.objective import Entropy, Objective

_CHAIN_SEED = 20191015


def recorded(
    name: str, robot: str, source: str, step: str, shape: str, stop: float = np.inf
) -> Instance:
    """From a robot's simulated experiment, or its real measurements up to ``stop`` [s].

    source : "simulated" or "measured". InputError where the measurements are absent."""
    return posed(name, _task(robot, source, stop), step, shape)


def posed(name: str, task: Task, step: str, shape: str) -> Instance:
    """One-step (torque) or two-step (base parameters) form of a task, with a demand on shape."""
    demands: list[Constraint] = []
    if shape == "gyration":
        demands = task.minimum_thickness(LmiSdpThickness.thickness)
    elif shape == "cones":
        demands = shape_cones(task)
    convex = ConstraintSet((*task.constraints.convex, *demands))
    task = replace(task, constraints=convex)
    data = task.data if step == "one-step" else task.base_distance
    entropy = None
    if shape == "regulariser":
        links = tuple(c for c in convex.convex if c.family == "pseudo-inertia")
        spread = max(data.loss(task.ols), 1e-6 * data.tau_squared) / max(data.rows, 1)
        nominal = inertia.pseudo_inertia(task.nominal[task.links])
        entropy = Entropy(spread, links, nominal)
    return Instance(name, replace(task, data=data), Objective(data, entropy))


def shape_cones(task: Task) -> list[Constraint]:
    """|c across z| <= r + |slope| c_z for each link: a centre of mass in a cone, as the 2R has.

    The cone opens along z from the nominal centre's plane, wide enough to hold it.
    """
    out = []
    for k, indices in enumerate(task.links):
        m, mx, my, mz = task.nominal[indices[:4]]
        centre, slope = np.array([mx, my, mz]) / m, 0.3
        radius = 1.2 * float(np.hypot(*centre[:2])) + 0.02 - slope * min(centre[2], 0.0)
        out.append(CentreOfMassCone(k, 2, radius, slope).constraint(indices))
    return out


@lru_cache(maxsize=8)
def _task(robot: str, source: str, stop: float) -> Task:
    problem, effects = load_problem(robot), None
    if source == "measured":
        run = measurements(problem, stop)
    else:
        described = experiment(problem)
        run, effects = _part(described.training_run(seed=0), problem, stop), described.effects
    task = pose(problem, run, PoseOptions(effects)).task
    return replace(task, constraints=ConstraintSet(task.constraints.convex))


def measurements(problem: Problem, stop: float = np.inf) -> Measurements:
    """The real identification run of a robot up to ``stop`` [s] of motion; InputError without it."""
    runs = measured_runs(problem.name)
    if not runs:
        raise InputError(
            f"The measurements of {problem.name} are absent", "name their folder in SDP_VS_PENALTY_DATA"
        )
    return _part(replace(next(iter(runs.values())), dq=None), problem, stop)


def _part(run: Measurements, problem: Problem, stop: float) -> Measurements:
    """The first ``stop`` seconds; of one or two, so many seconds of rows in which the robot moves."""
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
    """Twist +-90 degrees or 0, link lengths of 0.15-0.45 m, nominal links as balls."""
    rng = np.random.default_rng(_seeds(_CHAIN_SEED, n, draw))
    robot = Robot.from_dh(
        f"chain{n}",
        rng.uniform(0.0, 0.3, n).tolist(),
        (np.pi * rng.choice([-0.5, 0.0, 0.5], n)).tolist(),
        rng.uniform(0.05, 0.3, n).tolist(),
        "modified",
    )
    balls = np.zeros((n, 10))
    balls[:, 0] = 2.0
    balls[:, [4, 6, 9]] = 0.4 * 2.0 * (0.4 * np.array(robot.link_reach())[:, None]) ** 2
    links = inertia.standard_from_barycentric(balls)
    title = f"random serial chain of {n} links"
    return Problem(robot.name, title, robot, open_box(n), links, torque_side="link")


def _seeds(seed: int, n: int, draw: int) -> list[int]:
    return [seed, n] + ([draw] if draw else [])


def chain_task(n: int, draw: int = 0, noise: float = 0.01) -> Task:
    """Random states, torque of thin random links with friction and white noise.

    noise : over each joint's torque; draw : another arm of the same size, with another motion.
    """
    rng = np.random.default_rng(_seeds(_CHAIN_SEED + 1, n, draw))
    problem, samples = chain_problem(n, draw), 60
    model = problem.model()
    q = problem.robot.random_configurations(samples, _CHAIN_SEED)
    dq, ddq = rng.normal(size=(samples, n)), 3.0 * rng.normal(size=(samples, n))
    motion = Motion(np.linspace(0.0, 1.0, samples), q, dq, ddq)
    theta = np.concatenate([thin_links(rng, problem).ravel(), rng.uniform(0.1, 0.5, 3 * n)])
    columns = model.columns(motion)
    torque = np.column_stack([c.columns @ theta[c.indices] for c in columns])
    stack = [np.column_stack([c.wide(len(theta)), t]) for c, t in zip(columns, torque.T, strict=True)]
    for wide in stack:
        wide /= noise * float(np.sqrt(np.mean(wide[:, -1] ** 2)))
        wide[:, -1] += rng.normal(size=samples)
    return Task(
        model,
        LeastSquares.stacked(stack, n * samples),
        ConstraintSet(problem.constraints(model).convex),
        problem.parameter_bound(model),
        problem.nominal(model),
        problem.box,
    )


def thin_links(rng: np.random.Generator, problem: Problem) -> Array:
    """(n, 10) links of 1-4 kg whose mass lies near a rod: constraints that bind."""
    out = []
    for reach in problem.robot.link_reach():
        mass = rng.uniform(1.0, 4.0)
        centre = rng.uniform(-0.2, 0.2, 3) * reach
        frame, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        gyration = reach * np.array([0.3, 0.05, 0.02]) * rng.uniform(0.5, 1.0, 3)
        second = mass * (frame * gyration**2) @ frame.T + mass * np.outer(centre, centre)
        corner = (mass * centre)[:, None]
        out.append(inertia.from_pseudo_inertia(np.block([[second, corner], [corner.T, mass]])))
    return np.array(out)
