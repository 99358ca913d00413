"""A URDF made from a model, or the user's own URDF with its inertials and friction replaced."""

from __future__ import annotations

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
    number,
    numbers,
    require_consistent,
)
from sdp_vs_penalty.exporters.splice import Document
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.robot.urdf import load_urdf

#: How far the joint axes of a model and of a URDF may be apart: what rounded DH tables leave [m, -].
_SAME_AXIS = 1e-4


_DRAKE = "http://drake.mit.edu"

ENDING, FILE, ABOUT = ".urdf", "robot.urdf", "for ROS and simulators"
EDITS = True


def write(estimate: Estimate, options: Options) -> tuple[bytes, tuple[str, ...]]:
    """A URDF made from the model, or the user's own with the model's numbers."""
    content = Content.plausible(estimate, options)
    robot, own = estimate.robot, options.urdf
    made = make_urdf(robot, content) if own is None else edit_urdf(own, robot, content)
    return made, content.left_out(armature=False)


def make_urdf(robot: Robot, content: Content, drake: bool = False) -> bytes:
    """A URDF of a model's kinematics, inertials, damping and friction; link frames on the joints.

    drake : with a transmission a joint that carries the rotor's inertia in Drake's own tags.
    """
    root = etree.Element("robot", name=robot.name, nsmap={"drake": _DRAKE} if drake else None)
    etree.SubElement(root, "link", name="base_link")
    link_of = {carrier: k for k, carrier in enumerate(robot.link_joints)}
    for i in range(len(robot.tree)):
        link = etree.SubElement(root, "link", name=f"link{i + 1}")
        body = Inertial.of(content.links[link_of[i]] if i in link_of else np.zeros(10))
        element = etree.SubElement(link, "inertial")
        etree.SubElement(element, "origin", xyz=numbers(body.com), rpy="0 0 0")
        etree.SubElement(element, "mass", value=number(body.mass))
        etree.SubElement(element, "inertia", **body.urdf_attributes)
        _joint(root, robot, i, content)
    for name, armature in zip(robot.joint_names, content.armature, strict=True) if drake else ():
        transmission = etree.SubElement(root, "transmission", name=f"{name}_transmission")
        etree.SubElement(transmission, "type").text = "transmission_interface/SimpleTransmission"
        etree.SubElement(transmission, "joint", name=name)
        actuator = etree.SubElement(transmission, "actuator", name=f"{name}_motor")
        # At the joint already: the gear's ratio squared is in it.
        etree.SubElement(actuator, f"{{{_DRAKE}}}rotor_inertia", value=number(armature))
        etree.SubElement(actuator, f"{{{_DRAKE}}}gear_ratio", value="1")
    etree.indent(root)
    return bytes(etree.tostring(root, xml_declaration=True, encoding="utf-8")) + b"\n"


def _joint(root: Any, robot: Robot, i: int, content: Content) -> None:
    joint = robot.tree[i]
    bounded = np.isfinite(joint.lower) and np.isfinite(joint.upper)
    open_kind = "continuous" if joint.kind == "revolute" else "prismatic"
    kind = joint.kind if bounded else open_kind
    element = etree.SubElement(root, "joint", name=joint.name, type=kind)
    xyz, rpy = joint.placement[:3, 3], rpy_of(joint.placement[:3, :3])
    etree.SubElement(element, "origin", xyz=numbers(xyz), rpy=numbers(rpy))
    parent = "base_link" if joint.parent < 0 else f"link{joint.parent + 1}"
    etree.SubElement(element, "parent", link=parent)
    etree.SubElement(element, "child", link=f"link{i + 1}")
    etree.SubElement(element, "axis", xyz=numbers(joint.axis))
    limits = {"effort": joint.effort, "velocity": joint.velocity}
    if kind != "continuous":
        limits = {"lower": joint.lower, "upper": joint.upper, **limits}
    # URDF demands a number where a limit is unknown; these do not limit.
    bound = {k: number(v if np.isfinite(v) else np.copysign(1e6, v)) for k, v in limits.items()}
    etree.SubElement(element, "limit", **bound)
    if joint.name in robot.joint_names:
        k = robot.joint_names.index(joint.name)
        dynamics = {"damping": number(content.damping[k]), "friction": number(content.friction[k])}
        etree.SubElement(element, "dynamics", **dynamics)
    else:
        leader, multiplier, offset = robot.leader(i)
        follows = {"multiplier": number(multiplier), "offset": number(offset)}
        etree.SubElement(element, "mimic", joint=leader, **follows)


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
    for element in document.root.findall("link"):
        name = element.get("name")
        body = owner.get(name)
        if body is None:  # the base and what is fixed to it
            continue
        index, carries = body
        if carries:
            require_consistent(links[index], f"{path}: link {name!r}")
            write_inertial(document, element, Inertial.of(links[index]))
        elif element.find("inertial") is not None:
            zero = Inertial.of(np.zeros(10))
            _write(document, element, {"mass": {"value": "0"}, "inertia": zero.urdf_attributes})
    joints = {joint.get("name"): joint for joint in document.root.findall("joint")}
    tree = [joint.name for joint in theirs.tree]
    for joint in theirs.joints:
        element = joints[joint.name]
        mine = robot.joint_names.index(robot.tree[order[tree.index(joint.name)]].name)
        values = {"damping": content.damping[mine], "friction": content.friction[mine]}
        dynamics = element.find("dynamics")
        attributes = {key: number(value) for key, value in values.items()}
        if dynamics is not None:
            document.set(dynamics, attributes)
        elif any(values.values()):
            text = "".join(f' {key}="{value}"' for key, value in attributes.items())
            document.append(element, f"<dynamics{text}/>")
    return document.edited()


def write_inertial(document: Document, link: Any, body: Inertial) -> None:
    """Replace the numbers of a link's inertial; add whatever of it is missing."""
    wanted = {
        "origin": {"xyz": numbers(body.com), "rpy": "0 0 0"},
        "mass": {"value": number(body.mass)},
        "inertia": body.urdf_attributes,
    }
    _write(document, link, wanted)


def _write(document: Document, link: Any, wanted: dict[str, dict[str, str]]) -> None:
    texts = {
        tag: f"<{tag}" + "".join(f' {k}="{v}"' for k, v in attributes.items()) + "/>"
        for tag, attributes in wanted.items()
    }
    element = link.find("inertial")
    if element is None:
        document.append(link, "<inertial>" + "".join(texts.values()) + "</inertial>")
        return
    for tag, attributes in wanted.items():
        child = element.find(tag)
        if child is None:
            document.append(element, texts[tag])
        else:
            document.set(child, attributes)


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
        raise InputError(
            f"the file has {formatting.count(theirs.n, 'moving joint')}, the model {mine.n}",
            "give the URDF of the robot that was identified",
            path,
        )
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
    place = {carrier: k for k, carrier in enumerate(theirs.link_joints)}
    mine_place = {carrier: k for k, carrier in enumerate(mine.link_joints)}
    for index, joint in enumerate(theirs.tree):
        other = mine.tree[order[index]]
        relation = np.linalg.inv(from_file[index]) @ from_model[order[index]]
        turned = relation[:3, :3] @ other.axis
        offset = relation[:3, 3]
        if joint.kind == "revolute":
            offset = offset - joint.axis * (joint.axis @ offset)
            apart = float(np.linalg.norm(offset))
        else:
            apart = 0.0
        wrong_parent = (-1 if joint.parent < 0 else order[joint.parent]) != other.parent
        if joint.kind != other.kind or wrong_parent or np.linalg.norm(turned - joint.axis) > _SAME_AXIS:
            raise InputError(
                f"joint {joint.name!r} is not joint {other.name!r} of the model (another kind, "
                "parent or direction of its axis)",
                "give the URDF of the robot that was identified",
                path,
            )
        if apart > _SAME_AXIS:
            raise InputError(
                f"the axis of joint {joint.name!r} lies {1000.0 * apart:.3g} mm away from that "
                f"of joint {other.name!r} of the model",
                "give the URDF of the robot that was identified",
                path,
            )
        if index in place:
            own = links[mine_place[order[index]]]
            same = np.array_equal(relation, np.eye(4))
            out[place[index]] = own if same else inertia.transform(relation) @ own
    return out
