"""Random robots, links and motions, on which contracts are asked."""

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.motion import Motion
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import Joint
from sdp_vs_penalty.robot.robot import Robot


def rotation(rng: np.random.Generator) -> Array:
    """Return a uniformly random rotation (3, 3)."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diagonal(r))
    return q if np.linalg.det(q) > 0 else -q


def pose(rng: np.random.Generator, reach: float) -> Array:
    """Return a random pose (4, 4) whose translation is ``reach`` long."""
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
    """Return a random tree of n revolute and prismatic joints, depth first."""
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


def measured(problem: Problem, noise: float) -> Measurements:
    """Ten seconds of a problem's nominal robot with friction, logged with velocities and
    with noise [N m, N] on its torques."""
    model = problem.model()
    truth = problem.nominal(model)
    truth[len(model.rigid_indices) :] = 0.4
    t = np.arange(0.0, 10.0, 4e-3)
    motion = sines(np.random.default_rng(5), problem.robot.n, t)
    error = noise * np.random.default_rng(0).normal(size=motion.q.shape)
    return Measurements(t, motion.q, model.torque(truth, motion) + error, motion.dq)
