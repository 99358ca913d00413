"""Random robots, links and motions for the tests."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import Measurements, Problem
from sdp_vs_penalty.effects import Model, Motion, parse_effects
from sdp_vs_penalty.estimators import Task, make_task
from sdp_vs_penalty.problem import open_box, plausible_links
from sdp_vs_penalty.regression import LeastSquares, compress
from sdp_vs_penalty.robot import Joint, Robot, inertia
from sdp_vs_penalty.signals import FilteredRuns

Array = NDArray[np.float64]


def rotation(rng: np.random.Generator) -> Array:
    """A uniformly random rotation (3, 3)."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diagonal(r))
    return q if np.linalg.det(q) > 0 else -q


def pose(rng: np.random.Generator, reach: float) -> Array:
    """A random pose (4, 4) whose translation is ``reach`` long."""
    out = np.eye(4)
    out[:3, :3] = rotation(rng)
    direction = rng.normal(size=3)
    out[:3, 3] = reach * direction / np.linalg.norm(direction)
    return out


def link_parameters(
    rng: np.random.Generator,
    reach: float,
    mass: float | None = None,
    thickness: float = 0.03,
) -> Array:
    """Standard parameters (10,) of a solid ellipsoid inside the ball of radius
    ``reach``.

    Its radius of gyration is at least ``thickness`` in every direction.
    """
    mass = float(rng.uniform(0.5, 5.0)) if mass is None else mass
    gyration = rng.uniform(thickness, max(thickness, 0.25 * reach), size=3)
    r = rotation(rng)
    direction = rng.normal(size=3)
    centre = direction / np.linalg.norm(direction) * reach * rng.uniform(0.05, 0.3)
    pseudo = np.empty((4, 4))
    pseudo[:3, :3] = mass * ((r * gyration**2) @ r.T + np.outer(centre, centre))
    pseudo[:3, 3] = pseudo[3, :3] = mass * centre
    pseudo[3, 3] = mass
    return inertia.from_pseudo_inertia(pseudo)


def tree(
    rng: np.random.Generator,
    n: int,
    *,
    branched: bool = True,
    link_frames: bool = False,
) -> Robot:
    """A random tree of n revolute and prismatic joints, depth first."""
    joints: list[Joint] = []
    branch: list[int] = []  # from the base to the last joint
    for i in range(n):
        if branched and i > 1 and rng.random() < 0.4:
            branch = branch[: rng.integers(0, len(branch))]
        parent = branch[-1] if branch else -1
        branch.append(i)
        axis = rng.normal(size=3)
        joints.append(
            Joint(
                f"joint{i + 1}",
                "prismatic" if rng.random() < 0.3 else "revolute",
                parent,
                pose(rng, rng.uniform(0.2, 0.5)),
                axis / np.linalg.norm(axis),
                pose(rng, 0.2) if link_frames else np.eye(4),
            )
        )
    return Robot("random", tuple(joints), tuple(rng.normal(size=3) * 6.0))


def states(robot: Robot, count: int, seed: int = 0) -> tuple[Array, Array, Array]:
    """Random configurations, velocities and accelerations, each (count, n)."""
    dq, ddq = np.random.default_rng(seed).normal(size=(2, count, robot.n)) * 2.0
    return robot.random_configurations(count, seed), dq, ddq


def sines(
    rng: np.random.Generator, n: int, t: Array, base_hz: float = 0.1, harmonics: int = 5
) -> Motion:
    """Sums of sines with exact derivatives: q, dq, ddq (N, n), speeds of about 1 rad/s
    or m/s."""
    w = 2.0 * np.pi * base_hz * np.arange(1, harmonics + 1)
    a, b = rng.normal(size=(2, n, harmonics)) * 1.0 / np.sqrt(harmonics)
    wt = t[:, None] * w
    s = np.sin(wt)
    c = np.cos(wt)
    q = s @ (a / w).T - c @ (b / w).T + rng.uniform(-1, 1, n)
    return Motion(t, q, c @ a.T + s @ b.T, -s @ (a * w).T + c @ (b * w).T)


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
        compress(FilteredRuns.of(run, problem.preprocessing.resolve(run)), model),
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
