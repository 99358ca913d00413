"""A URDF made from a model, or the user's own URDF with its inertials and friction
replaced.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

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
from sdp_vs_penalty.exporters.own_file import Document, in_frames_of, order_of_joints
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.robot.rotation import rpy_of
from sdp_vs_penalty.robot.urdf import load_urdf, placed_links, read_inertial

_DRAKE = "http://drake.mit.edu"

ENDING = ".urdf"
FILE = "robot.urdf"
ABOUT = "for ROS and simulators"
EDITS = "URDF"
HOLDS = FIELDS


def write(estimate: Estimate, options: Options, drake: bool = False) -> Written:
    """Make a URDF of the model, or put the model's numbers into the user's own URDF;
    return the file's bytes and the effects left out.

    This module is an :class:`ExportFormat`. ``drake`` adds Drake's transmissions, which
    hold rotor inertias.
    """
    content = Content.plausible(estimate, options)
    if options.own_file is not None:
        edited = edit_urdf(options.own_file, estimate.robot, content)
        return edited, left_out(estimate, HOLDS)
    text = make_urdf(estimate.robot, content, drake)
    return text, left_out(estimate, {*HOLDS, "armature"} if drake else HOLDS)


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
    link's. A link whose joint was held keeps its inertial, and the moving link gets the
    rest.

    Parameters
    ----------
    content : Content
        What a simulator's file can hold of the model.

    Raises
    ------
    InputError
        If the file's joints are not those of the model.
    """
    held = {joint.name: joint.value for joint in robot.held}
    urdf_robot, _ = load_urdf(path, held=held)
    order = order_of_joints(path, urdf_robot, robot)
    links = in_frames_of(path, urdf_robot, robot, content.links, order)
    document = Document.read(path)
    _put_inertials(document, path, links, held)
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


def _put_inertials(
    document: Document, path: str | Path, links: Array, held: Mapping[str, float]
) -> None:
    """Write links (links, 10) about their own frames as the inertials of a URDF, whose
    joints of the names ``held`` stand at these positions [rad, m]."""
    elements = {link.get("name"): link for link in document.root.findall("link")}
    zero = {
        "mass": {"value": "0"},
        "inertia": Inertial.from_parameters(np.zeros(10)).urdf_attributes,
    }
    moving_links = placed_links(path, held)
    moving_names = {moving.get("name") for ((moving, _), *_) in moving_links}
    # Links that keep their inertials: those that only a held joint fixes to another one.
    kept_links = set[str]()
    for fixed_together in placed_links(path):
        names = [link.get("name") for link, _ in fixed_together]
        if names[0] not in moving_names:
            kept_links.update(names)
    for theta, ((moving, _), *others) in zip(links, moving_links, strict=True):
        for link, pose in others:
            element_of_link = elements[link.get("name")]
            if link.get("name") in kept_links:
                theta = theta - inertia.transform(pose) @ read_inertial(link)
            elif element_of_link.find("inertial") is not None:
                document.put(element_of_link, "inertial", {}, zero)
        name = moving.get("name")
        require_consistent(theta, f"{path}: link {name!r}")
        tags = inertial_tags(Inertial.from_parameters(theta))
        document.put(elements[name], "inertial", {}, tags)
