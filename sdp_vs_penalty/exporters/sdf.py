"""A model in SDFormat, for Gazebo and Drake: links on their joints, damping and dry friction."""

from __future__ import annotations

from typing import Any

import numpy as np
from lxml import etree

from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import Content, Inertial, Options, number, numbers
from sdp_vs_penalty.exporters.urdf import rpy_of
from sdp_vs_penalty.robot.robot import Robot

ENDING, FILE, ABOUT = ".sdf", "robot.sdf", "SDFormat, for Gazebo"


def write(estimate: Estimate, options: Options) -> tuple[bytes, tuple[str, ...]]:
    """Links, damping and dry friction."""
    content = Content.plausible(estimate, options)
    return make_sdf(estimate.robot, content), content.left_out(armature=False)


def make_sdf(robot: Robot, content: Content) -> bytes:
    """SDF 1.9 of a model's kinematics, inertials, damping and friction; the base stands in the world."""
    root = etree.Element("sdf", version="1.9")
    model = etree.SubElement(root, "model", name=robot.name)
    etree.SubElement(model, "link", name="base_link")
    fixed = etree.SubElement(model, "joint", name="base", type="fixed")
    _texts(fixed, parent="world", child="base_link")
    link_of = {carrier: k for k, carrier in enumerate(robot.link_joints)}
    for i, joint in enumerate(robot.tree):
        parent = "base_link" if joint.parent < 0 else f"link{joint.parent + 1}"
        link = etree.SubElement(model, "link", name=f"link{i + 1}")
        pose = np.concatenate([joint.placement[:3, 3], rpy_of(joint.placement[:3, :3])])
        etree.SubElement(link, "pose", relative_to=parent).text = numbers(pose)
        body = Inertial.of(content.links[link_of[i]] if i in link_of else np.zeros(10))
        inertial = etree.SubElement(link, "inertial")
        _texts(inertial, pose=f"{numbers(body.com)} 0 0 0", mass=number(body.mass))
        _texts(etree.SubElement(inertial, "inertia"), **body.urdf_attributes)
        element = etree.SubElement(model, "joint", name=joint.name, type=joint.kind)
        _texts(element, parent=parent, child=f"link{i + 1}")
        axis = etree.SubElement(element, "axis")
        _texts(axis, xyz=numbers(joint.axis))
        ends = {"lower": joint.lower, "upper": joint.upper, "effort": joint.effort}
        limits = {k: number(x) for k, x in ends.items() if np.isfinite(x)}
        if limits:
            _texts(etree.SubElement(axis, "limit"), **limits)
        if joint.name in robot.joint_names:
            k = robot.joint_names.index(joint.name)
            friction = {"damping": content.damping[k], "friction": content.friction[k]}
            dynamics = etree.SubElement(axis, "dynamics")
            _texts(dynamics, **{name: number(x) for name, x in friction.items()})
    etree.indent(root)
    return bytes(etree.tostring(root, xml_declaration=True, encoding="utf-8")) + b"\n"


def _texts(element: Any, **texts: str) -> None:
    for name, text in texts.items():
        etree.SubElement(element, name).text = text
