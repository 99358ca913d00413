"""Random robots, links and motions for the tests."""

from dataclasses import replace

import numpy as np

from sdp_vs_penalty import Measurements, Problem
from sdp_vs_penalty.effects import Model, parse_effects
from sdp_vs_penalty.estimators import Task, make_task
from sdp_vs_penalty.problem import open_box, plausible_links
from sdp_vs_penalty.regression import LeastSquares, compress
from sdp_vs_penalty.signals import FilteredRuns
from sdp_vs_penalty.testing.robots import link_parameters as link_parameters
from sdp_vs_penalty.testing.robots import pose as pose
from sdp_vs_penalty.testing.robots import rotation as rotation
from sdp_vs_penalty.testing.robots import sines as sines
from sdp_vs_penalty.testing.robots import tree as tree


def states(robot, count, seed=0):
    """Random configurations, velocities and accelerations, each (count, n)."""
    dq, ddq = np.random.default_rng(seed).normal(size=(2, count, robot.n)) * 2.0
    return robot.random_configurations(count, seed), dq, ddq


def simulated(model, theta, seed=0, noise=0.0, seconds=20.0, dt=2e-3):
    """A run of this model along sums of sines, with white noise."""
    rng = np.random.default_rng(seed)
    motion = sines(rng, model.robot.n, np.arange(0.0, seconds, dt))
    tau = model.torque(theta, motion)
    return Measurements(motion.t, motion.q, tau + noise * rng.normal(size=tau.shape))


def driven(
    seed=0, seconds=12.0, dt=2e-3, effects="rigid_body,viscous_friction", noise=0.0
):
    """The model of a random tree of three joints, its parameters, and a run of it with
    white noise."""
    rng = np.random.default_rng(seed)
    robot = tree(rng, 3)
    model = Model(robot, parse_effects(effects, robot))
    links = [link_parameters(rng, 0.4) for _ in robot.joints]
    theta = np.concatenate([*links, rng.uniform(0.1, 1.0, len(model.parameters) - 30)])
    return model, theta, simulated(model, theta, rng, noise, seconds, dt)


def open_problem(robot, nominal):
    """A robot without bounds, and its nominal links (n, 10)."""
    return Problem(
        "random", "random", robot, open_box(robot.n, 0.01), nominal, torque_side="link"
    )


def with_box(problem, link, entry, low, high):
    """A problem with other bounds on one parameter of a link."""
    box = problem.box.copy()
    box[link, entry] = low, high
    return replace(problem, box=box)


def bare(robot):
    """A robot of which nothing but the kinematics is known."""
    nominal, sources = plausible_links(robot, np.zeros((robot.n, 10)))
    return replace(
        open_problem(robot, nominal),
        name=robot.name,
        title="by hand",
        nominal_from=sources,
    )


def task_of(problem):
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


def posed_task(problem, run, effects=None, seed=0):
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
    problem, seed, noise=0.5, base=0.1, motion_seed=7, seconds=24.0, effects=None
):
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
