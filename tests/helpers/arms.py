"""Small arms as URDF files, for tests of what belongs to a robot that is nobody's built-in one."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Axis:
    """One moving joint and its link: ``com`` from the link's frame [m]; moments (6,) about it, Ixx, Ixy,
    Iyy, Ixz, Iyz, Izz, of a solid ball of 8 cm radius where none are given."""

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
SCARA = (
    Axis("revolute", "0 0 1", "0 0 0.4", 6.0, "0.2 0.01 0"),
    Axis("revolute", "0 0 1", "0.35 0 0", 4.0, "0.15 0.01 0"),
    Axis("prismatic", "0 0 1", "0.3 0 0", 1.2, "0.01 0 -0.1"),
    Axis("revolute", "0 0 1", "0 0 -0.1", 0.4, "0.02 0.01 0"),
)
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


def _words(numbers: str | Sequence[float]) -> str:
    return numbers if isinstance(numbers, str) else " ".join(f"{x:.17g}" for x in numbers)


def write_urdf(
    path: Path, name: str, axes: Sequence[Axis], limits: tuple[float, float, float] = (0.2, 2.5, 2.0)
) -> Path:
    """A chain of these axes as a robot of that name; limits : of a slide, of a turn, of velocity."""
    links, joints = ['<link name="link0"/>'], []
    for k, a in enumerate(axes, start=1):
        ball = 0.4 * a.mass * 0.08**2
        six = zip(
            ["xx", "xy", "yy", "xz", "yz", "zz"], a.moments or (ball, 0, ball, 0, 0, ball), strict=True
        )
        tensor = " ".join(f'i{entry}="{value:.17g}"' for entry, value in six)
        links.append(
            f'<link name="link{k}"><inertial><origin xyz="{_words(a.com)}"/>'
            f'<mass value="{a.mass:.17g}"/><inertia {tensor}/></inertial></link>'
        )
        limit = limits[a.kind != "prismatic"]
        joints.append(
            f'<joint name="joint{k}" type="{a.kind}"><parent link="link{k - 1}"/><child link="link{k}"/>'
            f'<origin xyz="{_words(a.origin)}" rpy="{_words(a.turn)}"/><axis xyz="{_words(a.axis)}"/>'
            f'<limit lower="{-limit}" upper="{limit}" velocity="{limits[2]}" effort="500"/></joint>'
        )
    path.write_text(f'<robot name="{name}">{"".join(links + joints)}</robot>')
    return path


def write_folder(folder: Path) -> Path:
    """A folder with a problem.toml, a table of bounds and a cone, of the last two of THREE joints."""
    folder.mkdir()
    write_urdf(folder / "arm.urdf", "arm", THREE[1:])
    (folder / "problem.toml").write_text(FOLDER)
    (folder / "bounds.csv").write_text("parameter,lower,upper\nm1,0.5,3.5\nc1x,-0.1,0.3\nI1xx,0,0.2\n")
    return folder
