"""Read a robot from a URDF file: moving joints, fixed ones merged, inertials where they are given."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from sdp_vs_penalty import inertia
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot import STANDARD_GRAVITY, Joint, Robot

Array = NDArray[np.float64]

_MOVING = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}


@dataclass
class _Reader:
    path: Path
    inertials: dict[str, Array] = field(default_factory=dict)

    def fail(self, what: str) -> InputError:
        return InputError(f"{self.path}: {what}.")

    def numbers(self, element: Any, attribute: str, default: Sequence[float]) -> list[float]:
        text = None if element is None else element.get(attribute)
        if text is None:
            return list(default)
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            values = []
        if len(values) != len(default) or not np.all(np.isfinite(values)):
            raise self.fail(
                f"line {element.sourceline}, <{element.tag} {attribute}={text!r}> must hold "
                f"{len(default)} finite number(s)"
            )
        return values

    def pose(self, element: Any) -> Array:
        origin = element.find("origin")
        out = np.eye(4)
        out[:3, 3] = self.numbers(origin, "xyz", (0.0, 0.0, 0.0))
        out[:3, :3] = _rotation_rpy(*self.numbers(origin, "rpy", (0.0, 0.0, 0.0)))
        return out

    def end(self, joint: Any, which: str, links: Container[str]) -> str:
        """The link that a joint names as its parent or child."""
        element = joint.find(which)
        link = None if element is None else element.get("link")
        if link not in links:
            raise self.fail(
                f"joint {joint.get('name')!r} names link {link!r}, which the file does not have"
            )
        return str(link)

    def inertial(self, link: Any) -> Array:
        """Standard parameters (10,) about the link frame; zeros where the file gives none."""
        element = link.find("inertial")
        if element is None:
            return np.zeros(10)
        mass = self.numbers(element.find("mass"), "value", (0.0,))[0]
        tensor = element.find("inertia")
        names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        urdf = np.array([self.numbers(tensor, name, (0.0,))[0] for name in names])
        barycentric = np.concatenate([[mass, 0, 0, 0], urdf[list(inertia.URDF_ORDER)]])
        about_com = inertia.standard_from_barycentric(barycentric)
        return inertia.transform(self.pose(element)) @ about_com


def read_inertial(path: str | Path, link: Any) -> Array:
    """Standard parameters (10,), about the link frame, of a <link> element of a file."""
    return _Reader(Path(path)).inertial(link)


def load_urdf(path: str | Path, gravity: Sequence[float] = STANDARD_GRAVITY) -> tuple[Robot, Array]:
    """The robot of a URDF file and its nominal standard parameters, shape (n, 10).

    Joints come in the order of the file, depth first; continuous joints count as revolute without
    limits; a link behind a fixed joint is merged into the link that carries it, and one fixed to
    the base is dropped. A link without an inertial has zeros.

    Raises InputError for a file that is not a URDF, a floating, planar or mimic joint, a loop, or
    no moving joint at all.
    """
    path = Path(path)
    reader = _Reader(path)
    parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True)
    try:
        root = etree.fromstring(path.read_bytes(), parser)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except etree.XMLSyntaxError as error:
        raise reader.fail(f"not an XML file ({error.msg})") from error
    if root.tag != "robot":
        raise reader.fail(f"the outermost element is <{root.tag}>, a URDF's is <robot>")

    links = {link.get("name"): link for link in root.findall("link")}
    for tag in ("link", "joint"):
        names = [element.get("name") for element in root.findall(tag)]
        for name in names:
            if names.count(name) > 1:
                raise reader.fail(f"{tag} {name!r} is there {names.count(name)} times")
    children: dict[str, list[Any]] = {name: [] for name in links}
    parent_of: dict[str, str] = {}
    for element in root.findall("joint"):
        name = element.get("name")
        parent, child = reader.end(element, "parent", links), reader.end(element, "child", links)
        if child in parent_of:
            raise reader.fail(
                f"link {child!r} hangs on two joints (joint {name!r} closes a loop); "
                "only trees can be identified, cut the loop"
            )
        parent_of[child] = parent
        children[parent].append(element)
    roots = [name for name in links if name not in parent_of]
    if len(roots) != 1:
        found = ", ".join(roots) if roots else "none, the joints form a loop"
        raise reader.fail(f"one base link is needed, a link without a parent joint (found: {found})")

    joints: list[Joint] = []
    nominal: list[Array] = []
    reached: set[str] = set()

    def visit(link_name: str, body: int, pose: Array) -> None:
        """Add what hangs on a link; pose is that of the link in the frame of its moving body."""
        reached.add(link_name)
        if body >= 0:
            nominal[body] = nominal[body] + inertia.transform(pose) @ reader.inertial(links[link_name])
        for element in children[link_name]:
            kind, name = element.get("type"), element.get("name")
            placement = pose @ reader.pose(element)
            child = element.find("child").get("link")
            if kind == "fixed":
                visit(child, body, placement)
                continue
            if kind not in _MOVING:
                raise reader.fail(
                    f"joint {name!r} is of type {kind!r}; revolute, continuous, prismatic and fixed "
                    "joints can be identified (for a floating base, fix it)"
                )
            if element.find("mimic") is not None:
                raise reader.fail(
                    f"joint {name!r} mimics another; make it fixed to identify the robot without it"
                )
            axis = np.array(reader.numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0)))
            if not np.linalg.norm(axis) > 0:
                raise reader.fail(f"joint {name!r} has an axis of length zero")
            limit = element.find("limit")
            bounded = kind != "continuous" and limit is not None
            joints.append(
                Joint(
                    name=name,
                    kind=_MOVING[kind],
                    parent=body,
                    placement=placement,
                    axis=axis / np.linalg.norm(axis),
                    link_frame=np.eye(4),
                    lower=reader.numbers(limit if bounded else None, "lower", (-np.inf,))[0],
                    upper=reader.numbers(limit if bounded else None, "upper", (np.inf,))[0],
                    velocity=reader.numbers(limit, "velocity", (np.inf,))[0],
                    effort=reader.numbers(limit, "effort", (np.inf,))[0],
                )
            )
            nominal.append(np.zeros(10))
            visit(child, len(joints) - 1, np.eye(4))

    visit(roots[0], -1, np.eye(4))
    if len(reached) < len(links):
        name = next(name for name in links if name not in reached)
        raise reader.fail(f"link {name!r} is in a loop of joints apart from the base {roots[0]!r}")
    if not joints:
        raise reader.fail("no moving joint: there is nothing to identify")
    name = root.get("name") or path.stem
    x, y, z = (float(v) for v in gravity)
    return Robot(name, tuple(joints), (x, y, z)), np.array(nominal)


def _rotation_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """R = Rz(yaw) Ry(pitch) Rx(roll), URDF's fixed-axis convention."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
