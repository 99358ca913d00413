"""Arms as URDF files, made for the tests, and measurements of them whose truth is known."""

from pathlib import Path

import numpy as np
from arms import Axis, write_urdf
from numpy.typing import NDArray
from random_robots import link_parameters, sines

from sdp_vs_penalty import Measurements, Problem
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.robot import inertia

Array = NDArray[np.float64]

#: A SCARA: two revolute axes, a vertical stroke, a wrist; heavy arm, light quill.
_UP = "0 0 1"
_SCARA = (
    Axis("revolute", _UP, "0 0 0.2", 8.0, "0.16 0 0", (0.03, 0, 0.10, 0, 0, 0.11)),
    Axis("revolute", _UP, "0.325 0 0", 5.0, "0.12 0 0.02", (0.02, 0, 0.06, 0, 0, 0.06)),
    Axis("prismatic", _UP, "0.225 0 0", 1.2, "0 0 -0.05", (8e-3, 0, 8e-3, 0, 0, 4e-4)),
    Axis("revolute", _UP, "0 0 -0.1", 0.3, "0.002 0 -0.02", (3e-4, 0, 3e-4, 0, 0, 1e-4)),
)
#: Viscous friction [N m s/rad, N s/m], Coulomb friction and offset [N m, N], noise of one sample.
SCARA_FRICTION = (
    np.array([3.0, 1.5, 14.0, 0.02]),
    np.array([1.2, 0.8, 5.0, 0.05]),
    np.array([0.3, -0.2, 1.0, 0.01]),
)
SCARA_NOISE = np.array([0.5, 0.3, 1.0, 0.01])
LIMITS = (0.3, 3.0, 5.0)


def scara(folder: Path) -> Path:
    """Write scara.urdf."""
    return write_urdf(folder / "scara.urdf", "scara", _SCARA, LIMITS)


def random_arm(folder: Path, seed: int) -> Path:
    """Write a random serial arm of two to six revolute and prismatic joints."""
    rng = np.random.default_rng(seed)
    axes = []
    for _ in range(int(rng.integers(2, 7))):
        reach = float(rng.uniform(0.05, 0.6))
        mass = float(10.0 ** rng.uniform(-1.5, 1.5))
        body = inertia.barycentric_from_standard(link_parameters(rng, reach, mass, thickness=0.02))
        kind = "prismatic" if rng.random() < 0.35 else "revolute"
        # Axes as machines have them, along or across, and now and then askew.
        axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.8 else rng.normal(size=3)
        square = rng.choice([0.0, np.pi / 2, -np.pi / 2], size=3) if rng.random() < 0.7 else None
        turn, origin = rng.normal(size=3) if square is None else square, reach * rng.normal(size=3)
        axis = axis / np.linalg.norm(axis)
        axes.append(Axis(kind, axis, origin, mass, body[1:4], tuple(body[4:]), turn))
    return write_urdf(folder / f"arm{seed}.urdf", f"arm{seed}", axes, LIMITS)


def run_of(
    problem: Problem,
    friction: tuple[Array, Array, Array],
    noise: Array,
    seed: int = 0,
    seconds: float = 8.0,
    rate: float = 100.0,
) -> Measurements:
    """Sums of sines, driven by the URDF's own links, viscous and Coulomb friction and an offset."""
    rng = np.random.default_rng(seed)
    n = problem.robot.n
    t = np.arange(0.0, seconds, 1.0 / rate)
    sum_of_sines = sines(rng, n, t, base_hz=2.0 / seconds)
    stroke = np.array([0.1 if j.kind == "prismatic" else 0.5 for j in problem.robot.joints])
    q, dq, ddq = (stroke * x for x in (sum_of_sines.q, sum_of_sines.dq, sum_of_sines.ddq))
    names = "rigid_body,viscous_friction,coulomb_friction,torque_offset"
    model = problem.model(names)
    theta = np.concatenate([problem.nominal_links.ravel(), *friction])
    tau = model.torque(theta, Motion(t, q, dq, ddq))
    return Measurements(t, q, tau + noise * rng.normal(size=tau.shape), dq)


def run_of_widths(arm: Problem, widths: tuple[float, ...], seconds: float) -> Measurements:
    """The SCARA; Coulomb friction written out, over another velocity on each joint."""
    viscous, coulomb, offset = SCARA_FRICTION
    bare = run_of(arm, (np.zeros(4),) * 3, np.zeros(4), seconds=seconds, rate=500.0)
    friction = viscous * bare.dq + coulomb * np.tanh(bare.dq / np.array(widths)) + offset
    noise = np.random.default_rng(0).normal(size=friction.shape) * 0.02 * coulomb
    return Measurements(bare.t, bare.q, bare.tau + friction + noise, bare.dq)


def random_run(problem: Problem, seed: int) -> Measurements:
    """A run of a random arm with friction and noise drawn over several orders of magnitude."""
    rng = np.random.default_rng(seed)
    n = problem.robot.n
    viscous, coulomb = 10.0 ** rng.uniform(-2.0, 1.5, (2, n))
    noise = 10.0 ** rng.uniform(-3.0, 0.0, n)
    return run_of(problem, (viscous, coulomb, rng.normal(size=n)), noise, seed)
