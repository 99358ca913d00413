"""Read a robot from a URDF file: moving joints, fixed ones merged, inertials where they
are given.

<transmission> elements are simple, differential or four-bar. With motor (actuator)
reductions n_a, joint reductions n_j, as ros_control's transmission_interface: simple:
q_m = n q; differential: q_m1,2 = n_a1,2 (n_j1 q_1 +- n_j2 q_2); four-bar: q_m1 = n_a1
n_j1 q_1, q_m2 = n_a2 (n_j2 q_2 + q_1).
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from sdp_vs_penalty import formatting
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import read_bytes, refuse_stand_in
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import (
    Follower,
    HeldJoint,
    Joint,
    Transmission,
    hold_followers,
    resolve_mimic_joints,
)
from sdp_vs_penalty.robot.model_files import format_of, unexpanded
from sdp_vs_penalty.robot.robot import STANDARD_GRAVITY, Robot, check_held
from sdp_vs_penalty.robot.rotation import joint_motion, rotation_of_rpy

_MOVING = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
#: Lengths [m], masses [kg] and inertias [kg m^2] beyond this are no robot's and
#: overflow on the way.
LARGEST_NUMBER = 1e9
#: Angles in radians need no more than a turn; files that count on stay below two [rad].
_LARGEST_ANGLE = 4.0 * np.pi
#: Links of one file: humanoids with two hands have 200, and a chain of all must not
#: exhaust the stack.
_MOST_LINKS = 500
#: Formats of robots that are XML too, by their outermost elements.
_OTHER_FORMATS = {"sdf": "SDF", "mujoco": "MJCF"}
#: First bytes of a USD file: text or binary.
_USD_STARTS = (b"#usda", b"PXR-USDC")

#: A number as XML writes it: Python's float() also takes "1_000" and other scripts'
#: digits, which no reader of URDF does.
_NUMBER = re.compile(
    r"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?|inf|infinity|nan)",
    re.ASCII | re.IGNORECASE,
)
_BLANKS = " \t\r\n"
#: An XML declaration of a version that does not exist, such as 0.0 in Bullet's files; the
#: group ends before the number.
_ODD_VERSION = re.compile(rb"(\A\s*<\?xml\s+version\s*=\s*[\"'])0\.\d+")
#: Elements that couple links beside the tree of joints, by parts of their names.
_COUPLING = re.compile("constraint|loop|connect|weld|closure", re.IGNORECASE)

#: The <link> elements that make up one moving link, with their poses (4, 4) in its frame.
Parts = list[tuple[Any, Array]]


@contextmanager
def errors_located_in(path: str | Path) -> Iterator[None]:
    """Put a file's name before every error of the block."""
    try:
        yield
    except InputError as error:
        raise error.within(path) from error


def numbers_of(text: str, count: int) -> Array:
    """Parse numbers separated by spaces.

    Parameters
    ----------
    count : int
        How many numbers it must hold.

    Returns
    -------
    (count,) array
        The numbers; NaN where the text does not hold as many.
    """
    words = re.findall(f"[^{_BLANKS}]+", text)
    if len(words) != count or not all(map(_NUMBER.fullmatch, words)):
        return np.full(count, np.nan)
    return np.array([float(word) for word in words])


def _numbers(
    element: Any, attribute: str, *default: float, largest: float = LARGEST_NUMBER
) -> list[float]:
    """Return the numbers of an element's attribute, as many as there are defaults.

    The defaults stand in for a missing attribute or element. Raises InputError, naming
    the line, for other text or numbers beyond ``largest``.
    """
    text = None if element is None else element.get(attribute)
    if text is None:
        return list(default)
    values = numbers_of(text, len(default))
    if not np.all(np.abs(values) <= largest):
        where = f"line {element.sourceline}, <{element.tag} {attribute}={text[:40]!r}>"
        expected = formatting.count(len(default), "number")
        if np.isfinite(largest):
            expected = (
                f"{formatting.count(len(default), 'finite number')}, up to {largest:g}"
            )
        raise InputError(f"{where} must hold {expected}", "correct the file")
    return list(values.tolist())


def pose_of(element: Any) -> Array:
    """Return the pose of an element's <origin>, R = Rz(yaw) Ry(pitch) Rx(roll).

    Without an <origin> it is the identity.

    Parameters
    ----------
    element : XML element
        A <joint>, <inertial> or <collision>.

    Raises
    ------
    InputError
        Its attributes are no numbers, or its angles are beyond two turns: degrees.
    """
    origin = element.find("origin")
    out = np.eye(4)
    out[:3, 3] = _numbers(origin, "xyz", 0.0, 0.0, 0.0)
    angles = _numbers(origin, "rpy", 0.0, 0.0, 0.0)
    if max(map(abs, angles)) > _LARGEST_ANGLE:
        written = origin.get("rpy")
        what = f"line {origin.sourceline}, <origin rpy={written[:40]!r}> is in degrees"
        radians = " ".join(f"{x:.12g}" for x in np.radians(angles))
        raise InputError(what, f'write radians, as in rpy="{radians}"')
    out[:3, :3] = rotation_of_rpy(angles)
    return out


def read_inertial(link: Any) -> Array:
    """Read the standard parameters of a <link> element, about the link frame.

    Returns
    -------
    (10,) array
        m [kg], m c [kg m], inertia [kg m^2]; zeros without an <inertial>.

    Raises
    ------
    InputError
        Its attributes are no numbers.
    """
    element = link.find("inertial")
    if element is None:
        return np.zeros(10)
    mass = _numbers(element.find("mass"), "value", 0.0)
    tensor = element.find("inertia")
    # Smaller numbers are none of a robot's [kg, kg m^2], and are lost in squares.
    least_mass = 1e-15
    least_moment = 1e-30
    if 0.0 < abs(mass[0]) < least_mass:
        what = f"line {element.sourceline}: a mass of {mass[0]:g} kg is no link's"
        raise InputError(what, "write 0, or the mass in kg")
    moments = [
        _numbers(tensor, name.lower(), 0.0)[0] for name in inertia.PARAMETERS[4:]
    ]
    moments = [x if abs(x) >= least_moment else 0.0 for x in moments]
    about_com = inertia.standard_from_barycentric([*mass, 0.0, 0.0, 0.0, *moments])
    return inertia.transform(pose_of(element)) @ about_com


def load_urdf(
    path: str | Path,
    gravity: Sequence[float] = STANDARD_GRAVITY,
    held: Mapping[str, float] | None = None,
) -> tuple[Robot, Array]:
    """Read the robot of a URDF file and its nominal inertial parameters.

    Joints come in the order of the file, depth first. Continuous joints count as revolute
    joints without limits. A link behind a fixed joint is merged into the link that carries
    it; one fixed to the base is dropped. Mimic joints follow the joints that they name. A
    link whose inertials say mass 0 is massless and gets no parameters. <transmission>
    elements say how motors turn.

    Parameters
    ----------
    gravity : (3,) sequence
        Gravity in the base frame [m/s^2].
    held : mapping or None
        Positions [rad, m] of joints that count as fixed, with the joints that mimic them.

    Returns
    -------
    tuple
        The robot, and standard parameters (links, 10); zeros for a link without an
        <inertial>.

    Raises
    ------
    InputError
        The file is no URDF, has a floating or planar joint or a loop, or no joint
        moves.
    """
    held_joints = tuple[HeldJoint, ...]()
    if held:
        driven = load_urdf(path, gravity)[0].joint_names
        with errors_located_in(path):
            places = check_held(driven, held)
        held_joints = tuple(HeldJoint(driven[k], held[driven[k]], k) for k in places)
    root, tree, parts = _read(path, held)
    with errors_located_in(path):
        nominal, massless = _weighed(parts)
        moving = {joint.name for joint in tree}
        followers = {n: f for n, f in _followers(root).items() if n in moving}
        joints, mechanism = resolve_mimic_joints(tree, followers, massless)
        transmission = _transmission(root, [joint.name for joint in joints])
    name = root.get("name") or Path(path).stem
    gravity_vector = tuple(map(float, gravity))
    nominal_with_mass = [x for k, x in enumerate(nominal) if k not in massless]
    robot = Robot(
        name,
        joints,
        gravity=gravity_vector,
        transmission=transmission,
        mechanism=mechanism,
        held=held_joints,
    )
    return robot, np.array(nominal_with_mass)


def _followers(root: Any) -> dict[str, Follower]:
    """Return leader, multiplier and offset of each mimic joint, by name."""
    followers = dict[str, Follower]()
    for joint in root.findall("joint"):
        if (element := joint.find("mimic")) is not None:
            (ratio,) = _numbers(element, "multiplier", 1.0)
            (offset,) = _numbers(element, "offset", 0.0)
            followers[joint.get("name")] = (str(element.get("joint")), ratio, offset)
    return followers


def placed_links(
    path: str | Path, held: Mapping[str, float] | None = None
) -> list[Parts]:
    """Return the elements that make up each moving link with a mass.

    A link that is fixed to a moving one belongs to it.

    Parameters
    ----------
    held : mapping or None
        Positions [rad, m] of joints that count as fixed.

    Returns
    -------
    list of Parts
        For each moving link its <link> elements, each with its pose (4, 4) in the
        moving link's joint frame; the moving link itself comes first.

    Raises
    ------
    InputError
        The file is no URDF of a tree of joints (see :func:`load_urdf`).
    """
    parts = _read(path, held)[2]
    with errors_located_in(path):
        massless = _weighed(parts)[1]
    return [elements for k, elements in enumerate(parts) if k not in massless]


def couplings_left_out(root: Any, *, has_lines: bool) -> str:
    """Return a sentence about the elements of a URDF that couple links or motors and that
    we do not read: loops and constraints of its extensions, and motor reductions that are
    no numbers.

    Parameters
    ----------
    has_lines : bool
        Whether to name the elements' lines: those of a converted file mean nothing to the
        user.

    Returns
    -------
    str
        Such as "<connect body1='a' body2='b'> (line 7): not read: ..."; "" without any.
    """
    out = []
    for element in coupling_elements(root):
        tag = etree.QName(element).localname
        words = [tag, *(f"{k}={v!r}" for k, v in element.attrib.items())]
        line = f" (line {element.sourceline})" if has_lines else ""
        out.append(f"<{' '.join(words)[:100]}>{line}")
    unread = _unread_reductions(root)
    if unread:
        line = f" (line {unread[0].sourceline})" if has_lines else ""
        text = " ".join((unread[0].text or "").split())[:100]
        what = f"<mechanicalReduction> holds {text!r}{line}, no number other than 0"
        reductions = (
            f"{what}: every motor turns as its joint, without the file's reductions"
        )
        return "; ".join(filter(None, (not_read(out), reductions)))
    return not_read(out)


def coupling_elements(root: Any) -> list[Any]:
    """List the XML elements that couple links of a robot beside its tree of joints."""
    elements = []
    for element in root.iter(etree.Element):
        tag, parent = etree.QName(element).localname, element.getparent()
        in_extension = parent is not None and parent.tag in ("gazebo", "equality")
        if _COUPLING.search(tag) or (in_extension and tag == "joint"):
            elements.append(element)
    return elements


def axes_left_out(root: Any) -> list[str]:
    """List the moving joints without an <axis>, whose axis is then 1 0 0 by URDF's rule.

    Empty if half of the joints or more have none: the file then relies on the rule.
    """
    moving = [x for x in root.findall("joint") if x.get("type") in _MOVING]
    without = [str(x.get("name")) for x in moving if x.find("axis") is None]
    return without if 2 * len(without) < len(moving) else []


def not_read(couplings: Sequence[str]) -> str:
    """Say that couplings of links are not read; "" without any."""
    reason = "the arm is the tree of joints alone, without such couplings"
    return f"{', '.join(couplings)}: not read: {reason}" if couplings else ""


def _weighed(parts: Sequence[Parts]) -> tuple[list[Array], tuple[int, ...]]:
    """Return the standard parameters (10,) of each moving link, with those of the links
    fixed to it, and the indices of massless links.

    A link counts as massless if its <inertial> says so while other links have mass.
    parts : for each moving link its <link> elements, each with its pose (4, 4) in it.
    """
    parameters = [
        [inertia.transform(at) @ read_inertial(e) for e, at in elements]
        for elements in parts
    ]
    nominal = [np.sum(elements, axis=0) for elements in parameters]
    has_inertial = [
        any(e.find("inertial") is not None for e, _ in elements) for elements in parts
    ]
    massless = tuple(
        k for k, x in enumerate(nominal) if has_inertial[k] and not x.any()
    )
    return nominal, massless if any(x.any() for x in nominal) else ()


def parse_urdf(path: str | Path) -> Any:
    """Parse an XML file safely: no entities are expanded, no other file is read.

    Raises
    ------
    InputError
        The file is no XML, or a xacro file that is not expanded.
    """
    safe: dict[str, Any] = {"resolve_entities": False, "no_network": True}
    parser = etree.XMLParser(**safe, remove_comments=True, remove_pis=True)
    content = read_bytes(path)
    refuse_stand_in(path, content)
    if content.startswith(_USD_STARTS):
        remedy = "name the URDF from which this USD was made, or convert it to URDF"
        raise InputError("USD, not a URDF", remedy, path)
    if format_of(content) == "xacro":
        raise unexpanded(Path(path))
    try:
        return etree.fromstring(_ODD_VERSION.sub(rb"\g<1>1.0", content), parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        what = f"not an XML file ({str(error).splitlines()[0]})"
        raise InputError(what, "correct the file", path) from error


def _read(
    path: str | Path, held: Mapping[str, float] | None = None
) -> tuple[Any, list[Joint], list[Parts]]:
    """Return the <robot> element, the moving joints depth first, and the elements of
    each moving joint's link.

    The latter are lists of (<link> element, pose (4, 4) in the moving link's frame):
    the moving link and what is fixed to it. ``held`` are joints that count as fixed, by
    name, and their positions [rad, m].
    """
    root = parse_urdf(path)
    joints: list[Joint] = []
    parts: list[Parts] = []

    # ``body`` is the number of the moving link that carries a link; -1 is the base.
    def visit(name: str, body: int, pose: Array) -> None:
        """Add a link and what hangs on it; pose is the link's in the frame of its
        moving body."""
        link = links.pop(name)
        if body >= 0:
            parts[body].append((link, pose))
        for element in children[name]:
            placement = pose @ pose_of(element)
            child = element.find("child").get("link")
            name_of_joint = element.get("name")
            if element.get("type") == "fixed":
                visit(child, body, placement)
            elif name_of_joint in held_positions:
                at = joint_motion(
                    _joint(element, body, placement), held_positions[name_of_joint]
                )
                visit(child, body, placement @ at)
            else:
                joints.append(_joint(element, body, placement))
                parts.append([])
                visit(child, len(joints) - 1, np.eye(4))

    with errors_located_in(path):
        links, children, base = _tree(root)
        held_positions = hold_followers(held or {}, _followers(root))
        visit(base, -1, np.eye(4))
        for name in links:
            what = f"link {name!r} is in a loop of joints apart from the base {base!r}"
            raise InputError(what, "correct the file")
        if not joints:
            raise InputError(
                "no moving joint, so nothing to identify", "name another file"
            )
    return root, joints, parts


def _require_unique_names(root: Any) -> None:
    """Raise InputError for a link or joint without a name, or with another one's."""
    for tag in ("link", "joint"):
        names = Counter(element.get("name") for element in root.findall(tag))
        for name, count in names.items():
            if not name:
                raise InputError(f"a <{tag}> has no name", "correct the file")
            if count > 1:
                what = f"{tag} {name!r} appears {count} times"
                raise InputError(what, "correct the file")


def _tree(root: Any) -> tuple[dict[str, Any], dict[str, list[Any]], str]:
    """Return the links by name, the <joint> elements that hang on each link, and the
    name of the base.

    Raises InputError unless the links form a tree: one base, and one parent joint for
    every other link.
    """
    if root.tag != "robot":
        what = f"the outermost element is <{root.tag}>, a URDF's is <robot>"
        remedy = "correct the file"
        if root.tag in _OTHER_FORMATS:
            other_format = _OTHER_FORMATS[root.tag]
            what = f"{other_format}, not a URDF: {what}"
            remedy = f"name the URDF from which this {other_format} was made, or convert it to URDF"
        raise InputError(what, remedy)
    if len(root.findall("link")) > _MOST_LINKS:
        raise InputError(f"more than {_MOST_LINKS} links", "name the file of one robot")
    _require_unique_names(root)
    links = {link.get("name"): link for link in root.findall("link")}
    if not links:
        raise InputError(
            "no <link>", "name a URDF; a xacro file has to be expanded first"
        )
    children: dict[str, list[Any]] = {name: [] for name in links}
    # Links that some joint carries; exactly one link, the base, is not carried.
    carried: set[str] = set()
    for element in root.findall("joint"):
        name = element.get("name")
        parent = _end_of_joint(element, "parent", links)
        child = _end_of_joint(element, "child", links)
        if child in carried:
            what = (
                f"link {child!r} has two parent joints (joint {name!r} closes a loop)"
            )
            raise InputError(what, "cut the loop, for only trees can be identified")
        carried.add(child)
        children[parent].append(element)
    roots = [name for name in links if name not in carried]
    if len(roots) != 1:
        root_names = ", ".join(roots[:5]) if roots else "none, the joints form a loop"
        raise InputError(
            f"one link without a parent joint is needed (found: {root_names})",
            "give one base",
        )
    return links, children, roots[0]


def _end_of_joint(element: Any, which: str, links: Mapping[str, Any]) -> str:
    """Return the name of the link at a joint's "parent" or "child" end.

    Raises InputError for a link that the file does not have.
    """
    end = element.find(which)
    link = "" if end is None else str(end.get("link", ""))
    if link not in links:
        name = element.get("name")
        what = f"joint {name!r} names link {link!r}, which is not in the file"
        raise InputError(what, "correct the file")
    return link


def _joint(element: Any, parent: int, placement: Array) -> Joint:
    """Return the moving joint of a <joint> element.

    ``parent`` is the index of the joint that carries its parent link, -1 for the base;
    ``placement`` (4, 4) is its pose in that joint's frame. Raises InputError for
    another type than revolute, continuous and prismatic, or an axis of length zero.
    """
    kind = element.get("type")
    name = element.get("name")
    if kind not in _MOVING:
        what = f"is of type {kind!r}, none of revolute, continuous, prismatic and fixed"
        raise InputError(
            f"joint {name!r} {what}", "make it one of these (fix a floating base)"
        )
    # URDF's default axis is x.
    axis = np.array(_numbers(element.find("axis"), "xyz", 1.0, 0.0, 0.0))
    length = np.linalg.norm(axis)
    if not length > 1e-9:
        raise InputError(
            f"joint {name!r} has an axis of length zero", "correct the file"
        )
    # Lower and upper position, velocity and effort; infinite where there is no limit. A
    # continuous joint has no ends, even if the file writes some.
    limit = element.find("limit")
    limits = []
    for key, no_limit in (
        ("lower", -np.inf),
        ("upper", np.inf),
        ("velocity", np.inf),
        ("effort", np.inf),
    ):
        element_of_limit = (
            None if kind == "continuous" and key in ("lower", "upper") else limit
        )
        (value,) = _numbers(element_of_limit, key, no_limit, largest=np.inf)
        # How files write "no limit" where the format asks for a number [rad or m].
        limits.append(no_limit if abs(value) > 1e6 else value)
    return Joint(
        name, _MOVING[kind], parent, placement, axis / length, np.eye(4), *limits
    )


def _transmission(root: Any, names: Sequence[str]) -> Transmission | None:
    """Return how the motors turn with the joints ``names``, None if the file does not
    say, or not in numbers.

    A joint without <transmission> has a motor that turns with it. Channels are on the
    joint side, as in every ROS log.
    """
    if _unread_reductions(root):
        return None
    matrix = np.eye(len(names))
    has_transmission = False
    for element in root.findall("transmission"):
        joints = element.findall("joint")
        actuators = element.findall("actuator")
        places = [names.index(j.get("name")) for j in joints if j.get("name") in names]
        if not places or len(places) != len(joints) or len(joints) != len(actuators):
            continue  # of a fixed or following joint, or of no motor
        of_joints = np.array([_reduction(part) for part in joints])
        of_actuators = np.array([_reduction(part) for part in actuators])
        kind = str(element.findtext("type") or element.get("type") or "")
        block = _motors_by_joints(kind.rpartition("/")[2], of_joints)
        matrix[np.ix_(places, places)] = of_actuators[:, None] * block
        has_transmission = True
    if not has_transmission:
        return None
    sides = ("joint",) * len(names)
    return Transmission(
        matrix, offset=np.zeros(len(names)), positions=sides, torques=sides
    )


def _unread_reductions(root: Any) -> list[Any]:
    """List the elements whose mechanical reduction is no number other than 0."""
    return [
        element
        for element in root.iterfind("transmission/*/mechanicalReduction")
        if not 0.0 < abs(numbers_of(element.text or "", 1)[0]) < np.inf
    ]


def _reduction(part: Any) -> float:
    """Return the mechanical reduction of a joint or an actuator; 1 without one."""
    return float(part.findtext("mechanicalReduction", "1"))


def _motors_by_joints(kind: str, reductions: Array) -> Array:
    """Return (k, k) motor turns per joint turn in a transmission, by ros_control's
    rules.
    """
    block = np.diag(reductions)
    if len(reductions) == 2 and kind == "DifferentialTransmission":
        first, second = reductions
        block = np.array([[first, second], [first, -second]])
    elif len(reductions) == 2 and kind == "FourBarLinkageTransmission":
        block[1, 0] = 1.0
    return block
