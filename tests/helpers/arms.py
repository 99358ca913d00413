"""Small arms as URDF files, and measurements of them whose truth is known, for tests of
what belongs to a robot that is nobody's built-in one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from random_robots import link_parameters, sines

from sdp_vs_penalty import Measurements
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot._pinocchio import pin


@dataclass(frozen=True)
class Axis:
    """One moving joint and its link: ``com`` from the link's frame [m]; moments (6,)
    about it, Ixx, Ixy, Iyy, Ixz, Iyz, Izz, of a solid ball of 8 cm radius where none
    are given."""

    kind: str
    axis: str | Sequence[float]
    origin: str | Sequence[float]
    mass: float
    com: str | Sequence[float]
    moments: Sequence[float] = ()
    turn: str | Sequence[float] = "0 0 0"


TURN = Axis("revolute", "0 0 1", "0 0 0.3", 4.0, "0.02 0.01 0.1")
SHOULDER = Axis("revolute", "0 1 0", "0 0 0.2", 3.0, "0.2 0.01 0.02")
ELBOW = Axis("revolute", "0 1 0", "0.4 0 0", 1.5, "0.15 0.01 0.01")
#: Heavier than anything that the built-in two_link may weigh.
HEAVY = (
    Axis("revolute", "0 1 0", "0 0 0.3", 30.0, "0.3 0.02 0"),
    Axis("revolute", "0 1 0", "0.6 0 0", 20.0, "0.2 0 0.02"),
)
THREE = (TURN, SHOULDER, ELBOW)
#: Two revolute axes, a vertical stroke, a wrist; heavy arm, light quill.
_UP = "0 0 1"
SCARA = (
    Axis("revolute", _UP, "0 0 0.2", 8.0, "0.16 0 0", (0.03, 0, 0.10, 0, 0, 0.11)),
    Axis("revolute", _UP, "0.325 0 0", 5.0, "0.12 0 0.02", (0.02, 0, 0.06, 0, 0, 0.06)),
    Axis("prismatic", _UP, "0.225 0 0", 1.2, "0 0 -0.05", (8e-3, 0, 8e-3, 0, 0, 4e-4)),
    Axis(
        "revolute", _UP, "0 0 -0.1", 0.3, "0.002 0 -0.02", (3e-4, 0, 3e-4, 0, 0, 1e-4)
    ),
)
#: Viscous friction [N m s/rad, N s/m], Coulomb friction and offset [N m, N], noise of
#: one sample.
SCARA_FRICTION = (
    np.array([3.0, 1.5, 14.0, 0.02]),
    np.array([1.2, 0.8, 5.0, 0.05]),
    np.array([0.3, -0.2, 1.0, 0.01]),
)
SCARA_NOISE = np.array([0.5, 0.3, 1.0, 0.01])
LIMITS = (0.3, 3.0, 5.0)
FOLDER = """title = "two joints with a light first link"
[kinematics]
urdf = "arm.urdf"
[bounds]
tables = ["bounds.csv"]
total_mass = [1.0, 9.0]
[[centre_of_mass_cone]]
link = 2
axis = "x"
radius = 0.05
slope = 0.1
[preprocessing]
state_cutoff = 6.0
"""


def _words(numbers):
    return (
        numbers if isinstance(numbers, str) else " ".join(f"{x:.17g}" for x in numbers)
    )


def write_urdf(path, name, axes, limits=(0.2, 2.5, 2.0)):
    """A chain of these axes as a robot of that name; limits : of a slide, of a turn, of
    velocity."""
    links = ['<link name="link0"/>']
    joints = []
    for k, a in enumerate(axes, start=1):
        ball = 0.4 * a.mass * 0.08**2
        six = zip(
            ["xx", "xy", "yy", "xz", "yz", "zz"],
            a.moments or (ball, 0, ball, 0, 0, ball),
            strict=True,
        )
        tensor = " ".join(f'i{entry}="{value:.17g}"' for entry, value in six)
        links.append(
            f'<link name="link{k}"><inertial><origin xyz="{_words(a.com)}"/>'
            f'<mass value="{a.mass:.17g}"/><inertia {tensor}/></inertial></link>'
        )
        limit = limits[a.kind != "prismatic"]
        joints.append(
            f'<joint name="joint{k}" type="{a.kind}"><parent link="link{k - 1}"/><child'
            f' link="link{k}"/><origin xyz="{_words(a.origin)}"'
            f' rpy="{_words(a.turn)}"/><axis xyz="{_words(a.axis)}"/><limit'
            f' lower="{-limit}" upper="{limit}" velocity="{limits[2]}"'
            ' effort="500"/></joint>'
        )
    path.write_text(f'<robot name="{name}">{"".join(links + joints)}</robot>')
    return path


def write_folder(folder):
    """A folder with a problem.toml, a table of bounds and a cone, of the last two of
    THREE joints."""
    folder.mkdir()
    write_urdf(folder / "arm.urdf", "arm", THREE[1:])
    (folder / "problem.toml").write_text(FOLDER)
    (folder / "bounds.csv").write_text(
        "parameter,lower,upper\nm1,0.5,3.5\nc1x,-0.1,0.3\nI1xx,0,0.2\n"
    )
    return folder


def scara(folder):
    """Write scara.urdf."""
    return write_urdf(folder / "scara.urdf", "scara", SCARA, LIMITS)


def random_arm(folder, seed):
    """Write a random serial arm of two to six revolute and prismatic joints."""
    rng = np.random.default_rng(seed)
    axes = []
    for _ in range(int(rng.integers(2, 7))):
        reach = float(rng.uniform(0.05, 0.6))
        mass = float(10.0 ** rng.uniform(-1.5, 1.5))
        body = inertia.barycentric_from_standard(
            link_parameters(rng, reach, mass, thickness=0.02)
        )
        kind = "prismatic" if rng.random() < 0.35 else "revolute"
        # Axes as machines have them, along or across, and now and then askew.
        axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.8 else rng.normal(size=3)
        square = (
            rng.choice([0.0, np.pi / 2, -np.pi / 2], size=3)
            if rng.random() < 0.7
            else None
        )
        turn = rng.normal(size=3) if square is None else square
        origin = reach * rng.normal(size=3)
        axis = axis / np.linalg.norm(axis)
        axes.append(Axis(kind, axis, origin, mass, body[1:4], tuple(body[4:]), turn))
    return write_urdf(folder / f"arm{seed}.urdf", f"arm{seed}", axes, LIMITS)


def run_of(problem, friction, noise, seed=0, seconds=8.0, rate=100.0):
    """Sums of sines, driven by the URDF's own links, viscous and Coulomb friction and
    an offset."""
    rng = np.random.default_rng(seed)
    n = problem.robot.n
    t = np.arange(0.0, seconds, 1.0 / rate)
    sum_of_sines = sines(rng, n, t, base_hz=2.0 / seconds)
    stroke = np.array(
        [0.1 if j.kind == "prismatic" else 0.5 for j in problem.robot.joints]
    )
    q, dq, ddq = (
        stroke * x for x in (sum_of_sines.q, sum_of_sines.dq, sum_of_sines.ddq)
    )
    names = "rigid_body,viscous_friction,coulomb_friction,torque_offset"
    model = problem.model(names)
    theta = np.concatenate([problem.nominal_links.ravel(), *friction])
    tau = model.torque(theta, Motion(t, q, dq, ddq))
    return Measurements(t, q, tau + noise * rng.normal(size=tau.shape), dq)


def run_of_widths(arm, widths, seconds):
    """The SCARA; Coulomb friction written out, over another velocity on each joint."""
    viscous, coulomb, offset = SCARA_FRICTION
    bare = run_of(arm, (np.zeros(4),) * 3, np.zeros(4), seconds=seconds, rate=500.0)
    friction = (
        viscous * bare.dq + coulomb * np.tanh(bare.dq / np.array(widths)) + offset
    )
    noise = np.random.default_rng(0).normal(size=friction.shape) * 0.02 * coulomb
    return Measurements(bare.t, bare.q, bare.tau + friction + noise, bare.dq)


def random_run(problem, seed):
    """A run of a random arm with friction and noise drawn over several orders of
    magnitude."""
    rng = np.random.default_rng(seed)
    n = problem.robot.n
    viscous, coulomb = 10.0 ** rng.uniform(-2.0, 1.5, (2, n))
    noise = 10.0 ** rng.uniform(-3.0, 0.0, n)
    return run_of(problem, (viscous, coulomb, rng.normal(size=n)), noise, seed)


def urdfdom_torque(path, robot, q, dq, ddq):
    """Inverse dynamics (N, n) of a file as Pinocchio's own reader (urdfdom) builds it,
    not ours."""
    model = pin.buildModelFromUrdf(str(path))
    model.gravity = pin.Motion(np.array(robot.gravity), np.zeros(3))
    data = model.createData()
    out = np.empty_like(q)
    for k in range(len(q)):
        configuration = np.zeros(model.nq)
        v = np.zeros(model.nv)
        a = np.zeros(model.nv)
        for i, joint in enumerate(robot.joints):
            theirs = model.joints[model.getJointId(joint.name)]
            angle = [q[k, i]] if theirs.nq == 1 else [np.cos(q[k, i]), np.sin(q[k, i])]
            configuration[theirs.idx_q : theirs.idx_q + theirs.nq] = angle
            v[theirs.idx_v], a[theirs.idx_v] = dq[k, i], ddq[k, i]
        tau = pin.rnea(model, data, configuration, v, a)
        out[k] = [
            tau[model.joints[model.getJointId(j.name)].idx_v] for j in robot.joints
        ]
    return out
