"""Arms as URDF files, made for the tests, and measurements of them whose truth is known."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from random_robots import link_parameters, sines

from sdp_vs_penalty import Measurements, Problem
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.robot import inertia

Array = NDArray[np.float64]

#: A SCARA: two revolute axes, a vertical stroke, a wrist; heavy arm, light quill.
_SCARA = (
    # kind, origin of the joint, (mass, centre, moments) of the link
    ("revolute", (0.0, 0.0, 0.2), (8.0, (0.16, 0.0, 0.0), (0.03, 0.10, 0.11))),
    ("revolute", (0.325, 0.0, 0.0), (5.0, (0.12, 0.0, 0.02), (0.02, 0.06, 0.06))),
    ("prismatic", (0.225, 0.0, 0.0), (1.2, (0.0, 0.0, -0.05), (8e-3, 8e-3, 4e-4))),
    ("revolute", (0.0, 0.0, -0.1), (0.3, (0.002, 0.0, -0.02), (3e-4, 3e-4, 1e-4))),
)
#: Viscous friction [N m s/rad, N s/m], Coulomb friction and offset [N m, N], noise of one sample.
SCARA_FRICTION = (
    np.array([3.0, 1.5, 14.0, 0.02]),
    np.array([1.2, 0.8, 5.0, 0.05]),
    np.array([0.3, -0.2, 1.0, 0.01]),
)
SCARA_NOISE = np.array([0.5, 0.3, 1.0, 0.01])


def _urdf(name: str, joints: list[str], links: list[str]) -> str:
    return (
        f'<robot name="{name}">\n<link name="base"/>\n' + "\n".join([*links, *joints]) + "\n</robot>\n"
    )


def _link(index: int, mass: float, centre: Array, about: Array) -> str:
    """``about`` (6,) : Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the centre of mass."""
    xx, xy, yy, xz, yz, zz = about
    return (
        f'<link name="link{index}"><inertial><origin xyz="{_words(centre)}"/><mass value="{mass:.17g}"/>'
        f'<inertia ixx="{xx:.17g}" ixy="{xy:.17g}" ixz="{xz:.17g}" iyy="{yy:.17g}" iyz="{yz:.17g}" '
        f'izz="{zz:.17g}"/></inertial></link>'
    )


def _joint(index: int, kind: str, origin: Array, turn: Array, axis: Array) -> str:
    parent = "base" if index == 1 else f"link{index - 1}"
    low, high = (-0.3, 0.3) if kind == "prismatic" else (-3.0, 3.0)
    return (
        f'<joint name="joint{index}" type="{kind}"><parent link="{parent}"/><child link="link{index}"/>'
        f'<origin xyz="{_words(origin)}" rpy="{_words(turn)}"/><axis xyz="{_words(axis)}"/>'
        f'<limit lower="{low}" upper="{high}" velocity="5" effort="500"/></joint>'
    )


def _words(numbers: Array) -> str:
    return " ".join(f"{x:.17g}" for x in numbers)


def scara(folder: Path) -> Path:
    """Write scara.urdf."""
    links = [
        _link(k, mass, np.array(centre), np.array([i[0], 0.0, i[1], 0.0, 0.0, i[2]]))
        for k, (_, _, (mass, centre, i)) in enumerate(_SCARA, 1)
    ]
    joints = [
        _joint(k, kind, np.array(origin), np.zeros(3), np.array([0.0, 0.0, 1.0]))
        for k, (kind, origin, _) in enumerate(_SCARA, 1)
    ]
    path = folder / "scara.urdf"
    path.write_text(_urdf("scara", joints, links))
    return path


def random_arm(folder: Path, seed: int) -> Path:
    """Write a random serial arm of two to six revolute and prismatic joints."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    links, joints = [], []
    for k in range(1, n + 1):
        reach = float(rng.uniform(0.05, 0.6))
        mass = float(10.0 ** rng.uniform(-1.5, 1.5))
        body = inertia.barycentric_from_standard(link_parameters(rng, reach, mass, thickness=0.02))
        links.append(_link(k, mass, body[1:4], body[4:]))
        kind = "prismatic" if rng.random() < 0.35 else "revolute"
        # Axes as machines have them, along or across, and now and then askew.
        axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.8 else rng.normal(size=3)
        turn = (
            rng.choice([0.0, np.pi / 2, -np.pi / 2], size=3)
            if rng.random() < 0.7
            else rng.normal(size=3)
        )
        joints.append(_joint(k, kind, reach * rng.normal(size=3), turn, axis / np.linalg.norm(axis)))
    path = folder / f"arm{seed}.urdf"
    path.write_text(_urdf(f"arm{seed}", joints, links))
    return path


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


def random_run(problem: Problem, seed: int) -> Measurements:
    """A run of a random arm with friction and noise drawn over several orders of magnitude."""
    rng = np.random.default_rng(seed)
    n = problem.robot.n
    viscous, coulomb = 10.0 ** rng.uniform(-2.0, 1.5, (2, n))
    noise = 10.0 ** rng.uniform(-3.0, 0.0, n)
    return run_of(problem, (viscous, coulomb, rng.normal(size=n)), noise, seed)
