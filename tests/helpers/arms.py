"""Small arms as URDF files, for tests of what belongs to a robot that is nobody's built-in one."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Axis:
    """One moving joint and its link: a solid ball of 8 cm radius, ``com`` from the link's frame [m]."""

    kind: str
    axis: str
    origin: str
    mass: float
    com: str


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


def write_urdf(path: Path, name: str, axes: tuple[Axis, ...]) -> Path:
    """A chain of these axes as a robot of that name."""
    links, joints = ['<link name="link0"/>'], []
    for k, a in enumerate(axes, start=1):
        moment = 0.4 * a.mass * 0.08**2
        links.append(
            f'<link name="link{k}"><inertial><origin xyz="{a.com}"/><mass value="{a.mass}"/>'
            f'<inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/>'
            "</inertial></link>"
        )
        limit = 0.2 if a.kind == "prismatic" else 2.5
        joints.append(
            f'<joint name="joint{k}" type="{a.kind}"><parent link="link{k - 1}"/><child link="link{k}"/>'
            f'<origin xyz="{a.origin}"/><axis xyz="{a.axis}"/>'
            f'<limit lower="{-limit}" upper="{limit}" velocity="2" effort="500"/></joint>'
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
