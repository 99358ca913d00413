"""A URDF made from a model, or the user's own URDF with its inertials and friction replaced."""

from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from sdp_vs_penalty import formatting
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import (
    Content,
    Inertial,
    Options,
    Part,
    element,
    number,
    parts,
    require_consistent,
    xml_text,
)
from sdp_vs_penalty.exporters.splice import Document
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.robot.urdf import load_urdf

#: How far the joint axes of a model and of a URDF may be apart: what rounded DH tables leave [m, -].
_SAME_AXIS = 1e-4
_REMEDY = "give the URDF of the robot that was identified"
_DRAKE = "http://drake.mit.edu"

ENDING, FILE, ABOUT = ".urdf", "robot.urdf", "for ROS and simulators"
EDITS = True


def write(estimate: Estimate, options: Options, drake: bool = False) -> tuple[bytes, tuple[str, ...]]:
    """A URDF made from the model, or the user's own with the model's numbers, edited plainly."""
    content = Content.plausible(estimate, options)
    robot, own = estimate.robot, options.urdf
    made = make_urdf(robot, content, drake) if own is None else edit_urdf(own, robot, content)
    return made, content.left_out(armature=drake and own is None)


def make_urdf(robot: Robot, content: Content, drake: bool = False) -> bytes:
    """A URDF of a model's kinematics, inertials, damping and friction; link frames on the joints.

    drake : with a transmission a joint that carries the rotor's inertia in Drake's own tags.
    """
    root = etree.Element("robot", name=robot.name, nsmap={"drake": _DRAKE} if drake else None)
    element(root, "link", name="base_link")
    for part in parts(robot, content.links):
        own = element(element(root, "link", name=part.name), "inertial")
        for tag, attributes in inertial_tags(part.inertial).items():
            element(own, tag, **attributes)
        _joint(root, robot, part, content)
    for name, armature in zip(robot.joint_names, content.armature, strict=True) if drake else ():
        transmission = element(root, "transmission", name=f"{name}_transmission")
        element(transmission, "type", "transmission_interface/SimpleTransmission")
        element(transmission, "joint", name=name)
        actuator = element(transmission, "actuator", name=f"{name}_motor")
        # At the joint already: the gear's ratio squared is in it.
        element(actuator, f"{{{_DRAKE}}}rotor_inertia", value=armature)
        element(actuator, f"{{{_DRAKE}}}gear_ratio", value="1")
    return xml_text(root)


def inertial_tags(body: Inertial) -> dict[str, dict[str, str]]:
    """What stands in an inertial: the tags and their attributes."""
    return {
        "origin": {"xyz": " ".join(map(number, body.com)), "rpy": "0 0 0"},
        "mass": {"value": number(body.mass)},
        "inertia": body.urdf_attributes,
    }


def _joint(root: Any, robot: Robot, part: Part, content: Content) -> None:
    joint = part.joint
    bounded = np.isfinite(joint.lower) and np.isfinite(joint.upper)
    open_kind = "continuous" if joint.kind == "revolute" else "prismatic"
    kind = joint.kind if bounded else open_kind
    own = element(root, "joint", name=joint.name, type=kind)
    element(own, "origin", xyz=joint.placement[:3, 3], rpy=rpy_of(joint.placement[:3, :3]))
    element(own, "parent", link=part.parent)
    element(own, "child", link=part.name)
    element(own, "axis", xyz=joint.axis)
    limits = {"effort": joint.effort, "velocity": joint.velocity}
    if kind != "continuous":
        limits = {"lower": joint.lower, "upper": joint.upper, **limits}
    # URDF demands a number where a limit is unknown; these do not limit.
    element(own, "limit", **{k: v if np.isfinite(v) else np.copysign(1e6, v) for k, v in limits.items()})
    if (k := part.place) is not None:
        element(own, "dynamics", damping=content.damping[k], friction=content.friction[k])
    else:
        leader, multiplier, offset = robot.leader(part.index)
        element(own, "mimic", joint=leader, multiplier=multiplier, offset=offset)


def rpy_of(rotation: Array) -> Array:
    """Angles of R = Rz(yaw) Ry(pitch) Rx(roll), exact to rounding also where the pitch is 90 degrees.

    There roll and yaw turn about one axis; the roll is read after the other two are undone, so that
    it makes up for whatever rounding did to the yaw.
    """
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    across = np.array([-np.sin(yaw), np.cos(yaw), 0.0])  # the y axis after the yaw
    roll = np.arctan2(-across @ rotation[:, 2], across @ rotation[:, 1])
    return np.array([roll, pitch, yaw])


def edit_urdf(path: str | Path, robot: Robot, content: Content) -> bytes:
    """The user's URDF with this model's inertials, damping and friction, else byte for byte the same.

    Links fixed to a moving one carry a mass of zero afterwards: theirs is part of the moving link's.
    Raises InputError where the file's joints are not those of the model.
    """
    theirs, _ = load_urdf(path)
    links = _in_frames_of(path, theirs, robot, content.links)
    document = Document.read(path)
    owner = _moving_links(document.root, theirs)
    order = _order(path, theirs, robot)
    for link in document.root.findall("link"):
        name = link.get("name")
        body = owner.get(name)
        if body is None:  # the base and what is fixed to it
            continue
        index, carries = body
        if carries:
            require_consistent(links[index], f"{path}: link {name!r}")
            write_inertial(document, link, Inertial.of(links[index]))
        elif link.find("inertial") is not None:
            zero = Inertial.of(np.zeros(10))
            _write(document, link, {"mass": {"value": "0"}, "inertia": zero.urdf_attributes})
    joints = {joint.get("name"): joint for joint in document.root.findall("joint")}
    tree = [joint.name for joint in theirs.tree]
    for joint in theirs.joints:
        mine = robot.joint_names.index(robot.tree[order[tree.index(joint.name)]].name)
        values = {"damping": content.damping[mine], "friction": content.friction[mine]}
        dynamics = joints[joint.name].find("dynamics")
        attributes = {key: number(value) for key, value in values.items()}
        if dynamics is not None:
            document.set(dynamics, attributes)
        elif any(values.values()):
            text = "".join(f' {key}="{value}"' for key, value in attributes.items())
            document.append(joints[joint.name], f"<dynamics{text}/>")
    return document.edited()


def write_inertial(document: Document, link: Any, body: Inertial) -> None:
    """Replace the numbers of a link's inertial; add whatever of it is missing."""
    _write(document, link, inertial_tags(body))


def _write(document: Document, link: Any, wanted: dict[str, dict[str, str]]) -> None:
    own = link.find("inertial")
    texts = {
        tag: f"<{tag}" + "".join(f' {k}="{v}"' for k, v in attributes.items()) + "/>"
        for tag, attributes in wanted.items()
        if own is None or own.find(tag) is None
    }
    if own is None:
        document.append(link, "<inertial>" + "".join(texts.values()) + "</inertial>")
        return
    for tag, attributes in wanted.items():
        if tag in texts:
            document.append(own, texts[tag])
        else:
            document.set(own.find(tag), attributes)


def _moving_links(root: Any, robot: Robot) -> dict[str, tuple[int, bool]]:
    """Of every link that moves: the joint that moves it, and whether it hangs on that joint itself."""
    link_of = {carrier: k for k, carrier in enumerate(robot.link_joints)}
    index = {joint.name: link_of.get(k) for k, joint in enumerate(robot.tree)}
    above: dict[str, tuple[str, str]] = {}
    for joint in root.findall("joint"):
        child = joint.find("child").get("link")
        above[child] = joint.get("name"), joint.find("parent").get("link")
    out: dict[str, tuple[int, bool]] = {}
    for name in above:
        link, own = name, True
        while link in above:
            joint_name, parent = above[link]
            if joint_name in index:
                place = index[joint_name]
                if place is not None:  # else it is declared massless, and stays so
                    out[name] = place, own
                break
            link, own = parent, False
    return out


def _order(path: str | Path, theirs: Robot, mine: Robot) -> list[int]:
    """For each joint of the file's tree the model's: by name where all names agree, else in order."""
    if (theirs.n, len(theirs.tree), theirs.links) != (mine.n, len(mine.tree), mine.links):
        what = f"the file has {formatting.count(theirs.n, 'moving joint')}, the model {mine.n}"
        raise InputError(what, _REMEDY, path)
    names = [joint.name for joint in mine.tree]
    if sorted(names) == sorted(joint.name for joint in theirs.tree):
        return [names.index(joint.name) for joint in theirs.tree]
    return list(range(len(mine.tree)))


def _in_frames_of(path: str | Path, theirs: Robot, mine: Robot, links: Array) -> Array:
    """Standard parameters about the file's link frames; the joint axes must coincide at q = 0.

    A model's frames may sit elsewhere on the same axes (a DH table beside a URDF): with T the poses
    of corresponding joint frames in the base, parameters move by T_file^-1 T_model.
    """
    order = _order(path, theirs, mine)
    from_file, from_model = (r.poses(np.zeros((1, len(r.tree))))[0] for r in (theirs, mine))
    out = np.empty_like(links)
    place, mine_place = ({joint: k for k, joint in enumerate(r.link_joints)} for r in (theirs, mine))
    for index, joint in enumerate(theirs.tree):
        other = mine.tree[order[index]]
        relation = np.linalg.inv(from_file[index]) @ from_model[order[index]]
        turned, offset = relation[:3, :3] @ other.axis, relation[:3, 3]
        across = float(np.linalg.norm(offset - joint.axis * (joint.axis @ offset)))
        apart = across if joint.kind == "revolute" else 0.0
        wrong_parent = (-1 if joint.parent < 0 else order[joint.parent]) != other.parent
        if joint.kind != other.kind or wrong_parent or np.linalg.norm(turned - joint.axis) > _SAME_AXIS:
            what = (
                f"joint {joint.name!r} is not joint {other.name!r} of the model (another kind, parent "
            )
            raise InputError(what + "or direction of its axis)", _REMEDY, path)
        if apart > _SAME_AXIS:
            what = (
                f"the axis of joint {joint.name!r} lies {1000.0 * apart:.3g} mm away from that of joint "
            )
            raise InputError(f"{what}{other.name!r} of the model", _REMEDY, path)
        if index in place:
            own = links[mine_place[order[index]]]
            same = np.array_equal(relation, np.eye(4))
            out[place[index]] = own if same else inertia.transform(relation) @ own
    return out
