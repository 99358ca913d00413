"""Read a robot from a URDF file: moving joints, fixed ones merged, inertials where they are given.

<transmission> elements are simple, differential or four-bar. With motor (actuator) reductions n_a, joint
reductions n_j, as ros_control's transmission_interface: simple: q_m = n q; differential: q_m1,2 = n_a1,2
(n_j1 q_1 +- n_j2 q_2); four-bar: q_m1 = n_a1 n_j1 q_1, q_m2 = n_a2 (n_j2 q_2 + q_1).
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from sdp_vs_penalty import formatting
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import read_bytes
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import Follower, Joint, Transmission, following
from sdp_vs_penalty.robot.robot import STANDARD_GRAVITY, Robot


def numbers_of(text: str, count: int) -> Array:
    """(count,) numbers, NaN where the text does not hold as many."""
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    return values if len(values) == count else np.full(count, np.nan)


_MOVING = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
#: Lengths [m], masses [kg] and inertias [kg m^2] beyond this are no robot's and overflow on the way.
_LARGEST = 1e9
#: Links of one file: humanoids with two hands have 200, and a chain of all must not exhaust the stack.
_MOST_LINKS = 500


@dataclass
class _Reader:
    """What a walk through a file finds: joints, and of each moving link its elements and their poses."""

    path: Path
    joints: list[Joint] = field(default_factory=list)
    parts: list[list[tuple[Any, Array]]] = field(default_factory=list)
    reached: set[str] = field(default_factory=set)

    def fail(self, what: str, remedy: str = "correct the file") -> InputError:
        return InputError(what, remedy, self.path)

    def weighed(self) -> tuple[list[Array], tuple[int, ...]]:
        """(10,) of each moving link with what is fixed to it; which links say themselves that they have
        no mass, beside others that have one."""
        moved = [[inertia.transform(at) @ self.inertial(e) for e, at in parts] for parts in self.parts]
        nominal = [np.sum(own, axis=0) for own in moved]
        said = [any(e.find("inertial") is not None for e, _ in parts) for parts in self.parts]
        none = tuple(k for k, x in enumerate(nominal) if said[k] and not x.any())
        return nominal, none if any(x.any() for x in nominal) else ()

    def numbers(
        self, element: Any, attribute: str, default: Sequence[float], largest: float = _LARGEST
    ) -> list[float]:
        text = None if element is None else element.get(attribute)
        if text is None:
            return list(default)
        values = numbers_of(text, len(default))
        if not np.all(np.abs(values) <= largest):
            where = f"line {element.sourceline}, <{element.tag} {attribute}={text[:40]!r}>"
            wanted = formatting.count(len(default), "number")
            if np.isfinite(largest):
                wanted = f"{formatting.count(len(default), 'finite number')}, up to {largest:g}"
            raise self.fail(f"{where} must hold {wanted}")
        return list(values.tolist())

    def limit(self, element: Any, attribute: str, none: float) -> float:
        """A joint's limit, ``none`` where the file gives none or writes a huge number for it."""
        (value,) = self.numbers(element, attribute, (none,), np.inf)
        # How files write "no limit" where the format asks for a number [rad or m].
        return none if abs(value) > 1e6 else value

    def transmission(self, root: Any, names: Sequence[str]) -> Transmission | None:
        """How the motors turn with the joints ``names``; None where the file says nothing of it.

        A joint of which nothing is said has a motor that turns with it. Channels are those of joints, as
        every ROS log has them.
        """
        matrix, named = np.eye(len(names)), False
        for element in root.findall("transmission"):
            joints, actuators = element.findall("joint"), element.findall("actuator")
            places = [names.index(j.get("name")) for j in joints if j.get("name") in names]
            if not places or len(places) != len(joints) or len(joints) != len(actuators):
                continue  # of a fixed or following joint, or of no motor
            kind = (element.findtext("type") or element.get("type") or "").rpartition("/")[2]
            ratios = []
            for part in (*joints, *actuators):
                (value,) = numbers_of(part.findtext("mechanicalReduction", "1"), 1).tolist()
                if not np.isfinite(value) or value == 0.0:
                    where = f"line {part.sourceline}, <mechanicalReduction>"
                    raise self.fail(f"{where} must hold a number other than 0")
                ratios.append(value)
            n_j, n_a = np.split(np.array(ratios), 2)
            block = np.diag(n_j)
            if len(places) == 2 and kind == "DifferentialTransmission":
                block = np.array([[n_j[0], n_j[1]], [n_j[0], -n_j[1]]])
            elif len(places) == 2 and kind == "FourBarLinkageTransmission":
                block[1, 0] = 1.0
            matrix[np.ix_(places, places)] = n_a[:, None] * block
            named = True
        sides = ("joint",) * len(names)
        return Transmission(matrix, np.zeros(len(names)), sides, sides) if named else None

    def pose(self, element: Any) -> Array:
        origin = element.find("origin")
        out = np.eye(4)
        out[:3, 3] = self.numbers(origin, "xyz", (0.0, 0.0, 0.0))
        out[:3, :3] = _rotation_rpy(*self.numbers(origin, "rpy", (0.0, 0.0, 0.0)))
        return out

    def inertial(self, link: Any) -> Array:
        """Standard parameters (10,) about the link frame; zeros where the file gives none."""
        element = link.find("inertial")
        if element is None:
            return np.zeros(10)
        mass, tensor = self.numbers(element.find("mass"), "value", (0.0,)), element.find("inertia")
        names = [x.lower() for x in inertia.PARAMETERS[4:]]
        moments = [self.numbers(tensor, name, (0.0,))[0] for name in names]
        about_com = inertia.standard_from_barycentric([*mass, 0.0, 0.0, 0.0, *moments])
        return inertia.transform(self.pose(element)) @ about_com

    def visit(
        self, links: dict[str, Any], children: dict[str, list[Any]], name: str, body: int, pose: Array
    ) -> None:
        """Add a link and what hangs on it; pose is the link's in the frame of its moving body."""
        self.reached.add(name)
        if body >= 0:
            self.parts[body].append((links[name], pose))
        for element in children[name]:
            placement = pose @ self.pose(element)
            child = element.find("child").get("link")
            if element.get("type") == "fixed":
                self.visit(links, children, child, body, placement)
            else:
                self.joints.append(self.joint(element, body, placement))
                self.parts.append([])
                self.visit(links, children, child, len(self.joints) - 1, np.eye(4))

    def joint(self, element: Any, parent: int, placement: Array) -> Joint:
        """One moving joint."""
        kind, name = element.get("type"), element.get("name")
        if kind not in _MOVING:
            what = f"is of type {kind!r}, none of revolute, continuous, prismatic and fixed"
            raise self.fail(f"joint {name!r} {what}", "make it one of these (fix a floating base)")
        axis = np.array(self.numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0)))
        length = np.linalg.norm(axis)
        if not length > 1e-9:
            raise self.fail(f"joint {name!r} has an axis of length zero")
        limit = element.find("limit")
        span = None if kind == "continuous" else limit
        lower, upper = self.limit(span, "lower", -np.inf), self.limit(span, "upper", np.inf)
        if lower > upper:
            what = f"joint {name!r} has its lower limit {lower:g} above its upper {upper:g}"
            raise self.fail(f"line {limit.sourceline}, {what}")
        rates = (self.limit(limit, key, np.inf) for key in ("velocity", "effort"))
        place = placement, axis / length, np.eye(4)
        return Joint(name, _MOVING[kind], parent, *place, lower, upper, *rates)


def load_urdf(path: str | Path, gravity: Sequence[float] = STANDARD_GRAVITY) -> tuple[Robot, Array]:
    """The robot of a URDF file and its nominal standard parameters, shape (links, 10).

    Joints come in the order of the file, depth first; continuous joints count as revolute without
    limits; a link behind a fixed joint is merged into the link that carries it, and one fixed to
    the base is dropped. A link without an inertial has zeros. Mimic joints follow the joints that they
    name; a link whose inertials say mass 0 is massless and gets no parameters; <transmission> elements
    say how motors turn.

    Raises InputError for a file that is not a URDF, a floating or planar joint, a loop, or no moving
    joint at all.
    """
    reader, root = _read(path)
    (nominal, massless), followers = reader.weighed(), dict[str, Follower]()
    for joint in root.findall("joint"):
        if (element := joint.find("mimic")) is not None:
            (ratio,) = reader.numbers(element, "multiplier", (1.0,))
            (offset,) = reader.numbers(element, "offset", (0.0,))
            followers[joint.get("name")] = (str(element.get("joint")), ratio, offset)
    try:
        joints, mechanism = following(reader.joints, followers, massless)
        transmission = reader.transmission(root, [joint.name for joint in joints])
    except InputError as error:
        raise error if error.where == reader.path else error.within(reader.path) from error
    name, given = root.get("name") or reader.path.stem, tuple(map(float, gravity))
    kept = [x for k, x in enumerate(nominal) if k not in massless]
    return Robot(name, joints, given, transmission, mechanism), np.array(kept)


def placed_links(path: str | Path) -> list[list[tuple[Any, Array]]]:
    """Of each moving link the <link> elements that it is made of, with their poses (4, 4) in its frame.

    Raises InputError as :func:`load_urdf` does.
    """
    reader = _read(path)[0]
    massless = reader.weighed()[1]
    return [parts for k, parts in enumerate(reader.parts) if k not in massless]


def pose_of(path: str | Path, element: Any) -> Array:
    """The pose (4, 4) of an element's <origin>, the identity without one."""
    return _Reader(Path(path)).pose(element)


def read_inertial(path: str | Path, link: Any) -> Array:
    """Standard parameters (10,), about the link frame, of a <link> element of a file."""
    return _Reader(Path(path)).inertial(link)


def _read(path: str | Path) -> tuple[_Reader, Any]:
    """The reader after its walk through the file, and the <robot> element; entities are never expanded,
    nothing is loaded from elsewhere."""
    reader, safe = _Reader(Path(path)), {"resolve_entities": False, "no_network": True}
    parser = etree.XMLParser(**safe, remove_comments=True, remove_pis=True)
    try:
        root = etree.fromstring(read_bytes(reader.path), parser)
    except InputError:
        raise
    except (etree.XMLSyntaxError, ValueError) as error:
        raise reader.fail(f"not an XML file ({str(error).splitlines()[0]})") from error
    if root.tag != "robot":
        raise reader.fail(f"the outermost element is <{root.tag}>, a URDF's is <robot>")
    links, children, base = _tree(reader, root)
    try:
        reader.visit(links, children, base, -1, np.eye(4))
    except RecursionError:
        raise reader.fail("the chain of links is too long") from None
    for name in links:
        if name not in reader.reached:
            raise reader.fail(f"link {name!r} is in a loop of joints apart from the base {base!r}")
    if not reader.joints:
        raise reader.fail("no moving joint, so nothing to identify", "name another file")
    return reader, root


def _tree(reader: _Reader, root: Any) -> tuple[dict[str, Any], dict[str, list[Any]], str]:
    """The links by name, for each link the joints that hang on it, and the one that no joint carries."""
    if len(root.findall("link")) > _MOST_LINKS:
        raise reader.fail(f"more than {_MOST_LINKS} links", "name the file of one robot")
    for tag in ("link", "joint"):
        names = Counter(element.get("name") for element in root.findall(tag))
        for name, count in names.items():
            if not name:
                raise reader.fail(f"a <{tag}> has no name")
            if count > 1:
                raise reader.fail(f"{tag} {name!r} appears {count} times")
    links = {link.get("name"): link for link in root.findall("link")}
    if not links:
        raise reader.fail("no <link>", "name a URDF; a xacro file has to be expanded first")
    children: dict[str, list[Any]] = {name: [] for name in links}
    carried: set[str] = set()
    for element in root.findall("joint"):
        name, ends = element.get("name"), [element.find(which) for which in ("parent", "child")]
        parent, child = ("" if end is None else str(end.get("link", "")) for end in ends)
        for link in (parent, child):
            if link not in links:
                raise reader.fail(f"joint {name!r} names link {link!r}, which is not in the file")
        if child in carried:
            what = f"link {child!r} has two parent joints (joint {name!r} closes a loop)"
            raise reader.fail(what, "cut the loop, for only trees can be identified")
        carried.add(child)
        children[parent].append(element)
    roots = [name for name in links if name not in carried]
    if len(roots) != 1:
        found = ", ".join(roots[:5]) if roots else "none, the joints form a loop"
        raise reader.fail(f"one link without a parent joint is needed (found: {found})", "give one base")
    return links, children, roots[0]


def _rotation_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """R = Rz(yaw) Ry(pitch) Rx(roll), URDF's fixed-axis convention."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    x = [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr]
    y = [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr]
    return np.array([x, y, [-sp, cp * sr, cp * cr]])
