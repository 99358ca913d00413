"""A model in SDFormat, for Gazebo and Drake: links on their joints, damping and dry
friction."""

from typing import Any

import numpy as np
from lxml import etree

from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import (
    FIELDS,
    Content,
    Options,
    element,
    link_parts,
    number,
    xml_text,
)
from sdp_vs_penalty.exporters.held import left_out
from sdp_vs_penalty.exporters.interface import Written
from sdp_vs_penalty.robot.rotation import rpy_of

ENDING = ".sdf"
FILE = "robot.sdf"
ABOUT = "SDFormat, for Gazebo"
HOLDS = FIELDS


def write(estimate: Estimate, options: Options) -> Written:
    """Make an SDF 1.9 document: kinematics, inertials, damping and friction; of version
    1.11, which has <mimic>, where joints follow others.

    Each link's frame is placed relative to its parent's; the joints lie at the origins
    of their child links. The base is fixed to the world. This module is an
    :class:`ExportFormat`. Returns the file's bytes and the effects left out.
    """
    content = Content.plausible(estimate, options)
    robot = estimate.robot
    version = "1.9" if robot.mechanism is None else "1.11"
    root = etree.Element("sdf", version=version)
    model = element(root, "model", name=robot.name)
    # The base, fixed to the world.
    element(model, "link", name="base_link")
    _texts(
        element(model, "joint", name="base", type="fixed"),
        parent="world",
        child="base_link",
    )
    # A link and its joint at a time, from the base on.
    for part in link_parts(robot, content.links):
        joint = part.joint
        body = part.inertial
        link = element(model, "link", name=part.name)
        # The link's frame in its parent's: position [m], then roll, pitch and yaw
        # [rad].
        pose = np.concatenate([joint.placement[:3, 3], rpy_of(joint.placement[:3, :3])])
        element(link, "pose", pose, relative_to=part.parent)
        # Mass, centre of mass, and inertia about it in axes of the link's frame.
        inertial = element(link, "inertial")
        _texts(
            inertial, pose=f"{' '.join(map(number, body.com))} 0 0 0", mass=body.mass
        )
        _texts(element(inertial, "inertia"), **body.urdf_attributes)
        joint_element = element(model, "joint", name=joint.name, type=joint.kind)
        _texts(joint_element, parent=part.parent, child=part.name)
        axis = element(joint_element, "axis")
        _texts(axis, xyz=joint.axis)
        # Limits that are known.
        ends = {"lower": joint.lower, "upper": joint.upper, "effort": joint.effort}
        if limits := {k: x for k, x in ends.items() if np.isfinite(x)}:
            _texts(element(axis, "limit"), **limits)
        # A driven joint, number k, has friction; one that follows another has none.
        if (k := part.place) is not None:
            friction = {"damping": content.damping[k], "friction": content.friction[k]}
            _texts(element(axis, "dynamics"), **friction)
        else:  # q = multiplier (q_leader - reference) + offset
            leader, multiplier, offset = robot.leader(part.index)
            mimic = element(axis, "mimic", joint=leader)
            _texts(mimic, multiplier=multiplier, offset=offset, reference=0.0)
    return xml_text(root), left_out(estimate, HOLDS)


def _texts(parent: Any, /, **texts: Any) -> None:
    """Append child elements that hold text only, by their names."""
    for name, text in texts.items():
        element(parent, name, text)
