"""Random robots, links and motions for the tests."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import Measurements, Problem
from sdp_vs_penalty.effects import Model, parse_effects
from sdp_vs_penalty.estimators import Task, make_task
from sdp_vs_penalty.problem import open_box, plausible_links
from sdp_vs_penalty.regression import LeastSquares, compress
from sdp_vs_penalty.robot import Robot
from sdp_vs_penalty.signals import FilteredRuns
from sdp_vs_penalty.testing.robots import link_parameters as link_parameters
from sdp_vs_penalty.testing.robots import pose as pose
from sdp_vs_penalty.testing.robots import rotation as rotation
from sdp_vs_penalty.testing.robots import sines as sines
from sdp_vs_penalty.testing.robots import tree as tree

Array = NDArray[np.float64]


def states(robot: Robot, count: int, seed: int = 0) -> tuple[Array, Array, Array]:
    """Random configurations, velocities and accelerations, each (count, n)."""
    dq, ddq = np.random.default_rng(seed).normal(size=(2, count, robot.n)) * 2.0
    return robot.random_configurations(count, seed), dq, ddq


def simulated(
    model: Model,
    theta: Array,
    seed: int | np.random.Generator = 0,
    noise: float = 0.0,
    seconds: float = 20.0,
    dt: float = 2e-3,
) -> Measurements:
    """A run of this model along sums of sines, with white noise."""
    rng = np.random.default_rng(seed)
    motion = sines(rng, model.robot.n, np.arange(0.0, seconds, dt))
    tau = model.torque(theta, motion)
    return Measurements(motion.t, motion.q, tau + noise * rng.normal(size=tau.shape))


def driven(
    seed: int = 0,
    seconds: float = 12.0,
    dt: float = 2e-3,
    effects: str = "rigid_body,viscous_friction",
    noise: float = 0.0,
) -> tuple[Model, Array, Measurements]:
    """The model of a random tree of three joints, its parameters, and a run of it with
    white noise."""
    rng = np.random.default_rng(seed)
    robot = tree(rng, 3)
    model = Model(robot, parse_effects(effects, robot))
    links = [link_parameters(rng, 0.4) for _ in robot.joints]
    theta = np.concatenate([*links, rng.uniform(0.1, 1.0, len(model.parameters) - 30)])
    return model, theta, simulated(model, theta, rng, noise, seconds, dt)


def open_problem(robot: Robot, nominal: Array) -> Problem:
    """A robot without bounds, and its nominal links (n, 10)."""
    return Problem(
        "random", "random", robot, open_box(robot.n, 0.01), nominal, torque_side="link"
    )


def with_box(
    problem: Problem, link: int, entry: int, low: float, high: float
) -> Problem:
    """A problem with other bounds on one parameter of a link."""
    box = problem.box.copy()
    box[link, entry] = low, high
    return replace(problem, box=box)


def bare(robot: Robot) -> Problem:
    """A robot of which nothing but the kinematics is known."""
    nominal, sources = plausible_links(robot, np.zeros((robot.n, 10)))
    return replace(
        open_problem(robot, nominal),
        name=robot.name,
        title="by hand",
        nominal_from=sources,
    )


def task_of(problem: Problem) -> Task:
    """A task whose data say nothing in particular: for what depends on the constraints
    alone."""
    model = problem.model()
    p = len(model.parameters)
    return Task(
        model,
        LeastSquares(np.eye(p), np.zeros(p), 1.0, 1.0, p),
        problem.constraints(model),
        problem.parameter_bound(model),
        problem.nominal(model),
        problem.box,
    )


def posed_task(
    problem: Problem, run: Measurements, effects: str | None = None, seed: int = 0
) -> Task:
    """What estimators are given of a run, under the problem's own filters."""
    model = problem.model(effects)
    return make_task(
        problem,
        model,
        compress(
            FilteredRuns.filtering(run, problem.preprocessing.resolve(run)), model
        ),
        seed=seed,
    )


def repeating_run(
    problem: Problem,
    seed: int,
    noise: float = 0.5,
    base: float = 0.1,
    motion_seed: int = 7,
    seconds: float = 24.0,
    effects: str | None = None,
) -> Measurements:
    """The model with friction of 0.4, a motion of period 1 / base and white noise."""
    rng = np.random.default_rng(seed)
    model = problem.model(effects)
    theta = problem.nominal(model)
    theta[len(model.rigid_indices) :] = 0.4
    t = np.arange(0.0, seconds, 4e-3)
    motion = sines(np.random.default_rng(motion_seed), problem.robot.n, t, base, 5)
    tau = model.torque(theta, motion)
    return Measurements(
        t, motion.q, tau + noise * rng.normal(size=tau.shape), None, None, (f"r{seed}",)
    )
