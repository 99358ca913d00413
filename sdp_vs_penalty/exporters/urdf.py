"""A URDF made from a model, or the user's own URDF with its inertials and friction
replaced.

lxml parses and answers questions; where each element's tags lie in the bytes is
scanned; new elements are spliced into these bytes, of which every other one stays:
quotes, spaces in tags, line ends.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from lxml import etree

from sdp_vs_penalty import formatting
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import (
    FIELDS,
    Content,
    Inertial,
    LinkPart,
    Options,
    element,
    link_parts,
    number,
    require_consistent,
    xml_name,
    xml_text,
)
from sdp_vs_penalty.exporters.held import left_out
from sdp_vs_penalty.exporters.interface import Written
from sdp_vs_penalty.files import read_bytes
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.robot.rotation import rpy_of
from sdp_vs_penalty.robot.urdf import load_urdf, placed_links

#: What may hold a < or > that is none of a tag's; then a whole tag, in which quotes may
#: hold a >.
_MARKUP = re.compile(
    rb"""<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>|(?P<tag><(?:[^"'>]|"[^"]*"|'[^']*')*>)""",
    re.DOTALL,
)
Attributes = Mapping[str, str]
Children = Mapping[str, Attributes]


@dataclass
class Document:
    """An XML file, its parsed tree, and where each of its elements sits in the bytes."""

    #: Bytes of the file.
    source: bytes
    #: Root of the parsed tree.
    root: Any
    #: Place of each element in the bytes: start of the start tag, its end, start of the
    #: end tag or None for <a/>.
    spans: dict[Any, tuple[int, int, int | None]]
    #: Changes of the bytes: start, end and the new text.
    _changes: list[tuple[int, int, bytes]] = field(default_factory=list)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a URDF file that :func:`load_urdf` has accepted.

        Returns
        -------
        Document
            Its bytes, and where each element lies in them.

        Raises
        ------
        InputError
            If it has a document type, or an encoding that does not contain ASCII.
        """
        source = read_bytes(Path(path))
        if b"<!DOCTYPE" in source:
            raise InputError(
                "files with a <!DOCTYPE> are not edited", "remove it", path
            )
        root = etree.fromstring(
            source, etree.XMLParser(resolve_entities=False, no_network=True)
        )
        encoding = (root.getroottree().docinfo.encoding or "UTF-8").upper()
        if encoding not in ("UTF-8", "ASCII", "US-ASCII", "ISO-8859-1", "LATIN-1"):
            raise InputError(
                f"the encoding {encoding} is not edited", "save the file as UTF-8", path
            )
        elements = [e for e in root.iter() if isinstance(e.tag, str)]
        return cls(source, root, dict(zip(elements, _spans(source), strict=True)))

    def put(
        self,
        parent: Any,
        tag: str,
        attributes: Attributes,
        children: Children = MappingProxyType({}),
    ) -> None:
        """Replace a child of an element, or append it; each new element gets its own
        line.

        A replaced child keeps its other attributes. The change is applied by
        :meth:`edited`.

        Parameters
        ----------
        parent : element
            The element whose child changes.
        attributes : mapping
            New attributes of the child.
        children : mapping
            Attributes of its children, by their names.
        """
        old_child = parent.find(tag)
        new_child = etree.Element(
            tag, {} if old_child is None else dict(old_child.attrib)
        )
        new_child.attrib.update(attributes)
        for name, child_attributes in children.items():
            etree.SubElement(new_child, name, dict(child_attributes))
        etree.indent(new_child)
        text = etree.tostring(new_child)
        if old_child is not None:
            start, end, closing = self.spans[old_child]
            stop = end if closing is None else self.source.index(b">", closing) + 1
            text = text.replace(b"\n", self._newline(start))
            self._changes.append((start, stop, text))
            return
        start, end, closing = self.spans[parent]
        newline = self._newline(start)
        line = newline + b"  " + text.replace(b"\n", newline + b"  ")
        if closing is None:  # <parent/> becomes <parent> ... </parent>
            end_tag = b"</" + parent.tag.encode() + b">"
            self._changes.append((end - 2, end, b">" + line + newline + end_tag))
            return
        # Behind the parent's last child, before the line of its end tag.
        place = max(len(self.source[:closing].rstrip(b" \t\r\n")), end)
        if place == closing:  # the end tag gets a line of its own
            line += newline
        self._changes.append((place, place, line))

    def _newline(self, start: int) -> bytes:
        """Return a line end of the file with the indentation of the line at ``start``."""
        line_start = self.source.rfind(b"\n", 0, start) + 1
        before = self.source[line_start:start]
        indentation = before[: len(before) - len(before.lstrip())]
        line_end = b"\r\n" if b"\r\n" in self.source else b"\n"
        return line_end + indentation

    def edited(self) -> bytes:
        """Return the file's bytes with all changes applied."""
        out: list[bytes] = []
        last = 0
        # Insertions at one place stay in the order in which they were asked for.
        for start, end, text in sorted(self._changes, key=lambda change: change[:2]):
            out += [self.source[last:start], text]
            last = end
        return b"".join([*out, self.source[last:]])


def _spans(source: bytes) -> list[tuple[int, int, int | None]]:
    """Return where the tags of every element lie in the bytes, in document order.

    For each: begin and end of the start tag, and begin of the end tag (None for <a/>).
    The file must be well-formed.
    """
    spans: list[tuple[int, int, int | None]] = []
    open_elements: list[int] = []  # their indices, the innermost last
    for match in _MARKUP.finditer(source):
        tag = match["tag"]
        if tag is None:  # a comment, text or instruction
            continue
        if tag.startswith(b"</"):
            k = open_elements.pop()
            begin, end, _ = spans[k]
            spans[k] = begin, end, match.start()
            continue
        if not tag.endswith(b"/>"):
            open_elements.append(len(spans))
        spans.append((*match.span(), None))
    return spans


_REMEDY = "give the URDF of the robot that was identified"
#: What rounded DH tables leave between two axes that coincide: distance [m], or
#: difference of unit vectors.
_NEAR = 1e-4
_DRAKE = "http://drake.mit.edu"

ENDING = ".urdf"
FILE = "robot.urdf"
ABOUT = "for ROS and simulators"
EDITS = True
HOLDS = FIELDS
RESTS = True


def write(estimate: Estimate, options: Options, drake: bool = False) -> Written:
    """Make a URDF of the model, or put the model's numbers into the user's own URDF;
    return the file's bytes and the effects left out.

    This module is an :class:`ExportFormat`. ``drake`` adds Drake's transmissions, which
    hold rotor inertias.
    """
    content = Content.plausible(estimate, options)
    robot = estimate.robot
    urdf_given = options.urdf
    file_content = (
        make_urdf(robot, content, drake)
        if urdf_given is None
        else edit_urdf(urdf_given, robot, content)
    )
    has_armature = drake and urdf_given is None
    fields = HOLDS | {"armature"} if has_armature else HOLDS
    return file_content, left_out(estimate, fields)


def make_urdf(robot: Robot, content: Content, drake: bool = False) -> bytes:
    """Make a URDF with a model's kinematics, inertials, damping and friction.

    Link frames lie on the joints.

    Parameters
    ----------
    robot : Robot
        The kinematics: joints and their frames.
    content : Content
        What a simulator's file can hold of the model.
    drake : bool
        Whether each joint gets a transmission with the rotor's inertia in Drake's own
        tags.
    """
    root = etree.Element(
        "robot", name=xml_name(robot.name), nsmap={"drake": _DRAKE} if drake else None
    )
    element(root, "link", name="base_link")
    for part in link_parts(robot, content.links):
        inertial_element = element(element(root, "link", name=part.name), "inertial")
        for tag, attributes in inertial_tags(part.inertial).items():
            element(inertial_element, tag, **attributes)
        _joint(root, robot, part, content)
    for name, armature in (
        zip(robot.joint_names, content.armature, strict=True) if drake else ()
    ):
        transmission = element(root, "transmission", name=f"{name}_transmission")
        element(transmission, "type", "transmission_interface/SimpleTransmission")
        element(transmission, "joint", name=name)
        actuator = element(transmission, "actuator", name=f"{name}_motor")
        # At the joint already: the gear's ratio squared is in it.
        element(actuator, f"{{{_DRAKE}}}rotor_inertia", value=armature)
        element(actuator, f"{{{_DRAKE}}}gear_ratio", value="1")
    return xml_text(root)


def inertial_tags(body: Inertial) -> dict[str, dict[str, str]]:
    """Return the tags of a URDF <inertial> with their attributes.

    Parameters
    ----------
    body : Inertial
        Mass, centre of mass and inertia of a link.
    """
    return {
        "origin": {"xyz": " ".join(map(number, body.com)), "rpy": "0 0 0"},
        "mass": {"value": number(body.mass)},
        "inertia": body.urdf_attributes,
    }


def _joint(root: Any, robot: Robot, part: LinkPart, content: Content) -> None:
    """Append a joint to a URDF: frame, parent and child, axis, limits, and either
    damping and friction (driven joints) or "mimic" (joints that follow another).

    A limit that is not known becomes +-1e6, because URDF demands a number.
    """
    joint = part.joint
    # A revolute joint without ends is "continuous" in URDF.
    bounded = np.isfinite(joint.lower) and np.isfinite(joint.upper)
    kind = joint.kind if bounded or joint.kind == "prismatic" else "continuous"
    joint_element = element(root, "joint", name=joint.name, type=kind)
    element(
        joint_element,
        "origin",
        xyz=joint.placement[:3, 3],
        rpy=rpy_of(joint.placement[:3, :3]),
    )
    element(joint_element, "parent", link=part.parent)
    element(joint_element, "child", link=part.name)
    element(joint_element, "axis", xyz=joint.axis)
    limits = {"effort": joint.effort, "velocity": joint.velocity}
    if kind != "continuous":
        limits = {"lower": joint.lower, "upper": joint.upper, **limits}
    # URDF demands a number where a limit is unknown; these do not limit.
    element(
        joint_element,
        "limit",
        **{k: v if np.isfinite(v) else np.copysign(1e6, v) for k, v in limits.items()},
    )
    # A driven joint, number k, has friction; another mimics its leader.
    if (k := part.place) is not None:
        element(
            joint_element,
            "dynamics",
            damping=content.damping[k],
            friction=content.friction[k],
        )
    else:
        leader, multiplier, offset = robot.leader(part.index)
        element(
            joint_element, "mimic", joint=leader, multiplier=multiplier, offset=offset
        )


def edit_urdf(path: str | Path, robot: Robot, content: Content) -> bytes:
    """Return the user's URDF with the model's inertials, damping and friction; every
    other byte stays.

    Links fixed to a moving one get a mass of zero, because theirs is part of the moving
    link's.

    Parameters
    ----------
    content : Content
        What a simulator's file can hold of the model.

    Raises
    ------
    InputError
        If the file's joints are not those of the model.
    """
    urdf_robot, _ = load_urdf(path)
    order = _order(path, urdf_robot, robot)
    links = _in_frames_of(path, urdf_robot, robot, content.links, order)
    document = Document.read(path)
    link_elements = {link.get("name"): link for link in document.root.findall("link")}
    zero = {
        "mass": {"value": "0"},
        "inertia": Inertial.from_parameters(np.zeros(10)).urdf_attributes,
    }
    for theta, (moving, *fixed) in zip(links, placed_links(path), strict=True):
        name = moving[0].get("name")
        require_consistent(theta, f"{path}: link {name!r}")
        tags = inertial_tags(Inertial.from_parameters(theta))
        document.put(link_elements[name], "inertial", {}, tags)
        for link, _ in fixed:
            fixed_link = link_elements[link.get("name")]
            if fixed_link.find("inertial") is not None:
                document.put(fixed_link, "inertial", {}, zero)
    joints = {joint.get("name"): joint for joint in document.root.findall("joint")}
    names = [joint.name for joint in urdf_robot.tree]
    for joint in urdf_robot.joints:
        joint_of_model = robot.tree[order[names.index(joint.name)]]
        index = robot.joint_names.index(joint_of_model.name)
        values = {
            "damping": content.damping[index],
            "friction": content.friction[index],
        }
        if joints[joint.name].find("dynamics") is not None or any(values.values()):
            written = {key: number(value) for key, value in values.items()}
            document.put(joints[joint.name], "dynamics", written)
    return document.edited()


def _order(path: str | Path, urdf_robot: Robot, model_robot: Robot) -> list[int]:
    """Return for each joint of the file's tree the index of the model's joint.

    Joints correspond by name if all names agree, else by order. Raises InputError for
    another number of joints.
    """
    if (urdf_robot.n, len(urdf_robot.tree), urdf_robot.links) != (
        model_robot.n,
        len(model_robot.tree),
        model_robot.links,
    ):
        what = (
            f"the file has {formatting.count(urdf_robot.n, 'moving joint')}, the model"
            f" {model_robot.n}"
        )
        raise InputError(what, _REMEDY, path)
    names = [joint.name for joint in model_robot.tree]
    if sorted(names) == sorted(joint.name for joint in urdf_robot.tree):
        return [names.index(joint.name) for joint in urdf_robot.tree]
    return list(range(len(model_robot.tree)))


def _in_frames_of(
    path: str | Path,
    urdf_robot: Robot,
    model_robot: Robot,
    links: Array,
    order: list[int],
) -> Array:
    """Return the links' standard parameters about the link frames of a URDF file.

    The model's frames may lie elsewhere on the same joint axes (a DH table against a
    URDF). With the poses T of corresponding joint frames at q = 0, parameters are
    transformed by T_file^-1 T_model.

    Parameters
    ----------
    path : path
        The file, for error messages.
    urdf_robot, model_robot : Robot
        Kinematics of the file and of the model.
    links : (links, 10) array
        Standard parameters about the model's joint frames.
    order : list of int
        For each joint of the file the model's joint.

    Raises
    ------
    InputError
        If two corresponding joint axes do not coincide.
    """
    poses_of_file = urdf_robot.poses(np.zeros((1, len(urdf_robot.tree))))[0]
    poses_of_model = model_robot.poses(np.zeros((1, len(model_robot.tree))))[0]
    link_of_joint = dict(zip(model_robot.link_joints, links, strict=True))
    transformed = []
    for index, (joint, k) in enumerate(zip(urdf_robot.tree, order, strict=True)):
        other = model_robot.tree[k]
        relation = np.linalg.inv(poses_of_file[index]) @ poses_of_model[k]
        parent = -1 if joint.parent < 0 else order[joint.parent]
        is_like = joint.kind == other.kind and parent == other.parent
        what = f"joint {joint.name!r} is not joint {other.name!r} of the model"
        axis_of_other = relation[:3, :3] @ other.axis
        if not is_like or np.linalg.norm(axis_of_other - joint.axis) > _NEAR:
            raise InputError(
                f"{what} (another kind, parent or direction of its axis)", _REMEDY, path
            )
        offset = relation[:3, 3]
        across = float(np.linalg.norm(offset - joint.axis * (joint.axis @ offset)))
        # A prismatic joint has a direction, but no place.
        if joint.kind == "revolute" and across > _NEAR:
            raise InputError(
                f"{what}: its axis lies {1e3 * across:.3g} mm away", _REMEDY, path
            )
        if index in urdf_robot.link_joints:
            link = link_of_joint[k]
            is_same_frame = np.array_equal(relation, np.eye(4))
            transformed.append(
                link if is_same_frame else inertia.transform(relation) @ link
            )
    return np.array(transformed)
