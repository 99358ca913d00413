"""A MuJoCo model (MJCF) with full inertias, armature, damping and dry friction."""

from __future__ import annotations

from typing import Any

import numpy as np
from lxml import etree
from scipy.spatial.transform import Rotation

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import Content, Inertial, Options, number, numbers
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import Joint
from sdp_vs_penalty.robot.robot import Robot

#: MuJoCo's mjMINVAL: moving bodies need a mass and moments of inertia above it.
_SMALLEST = 1e-15

ENDING, FILE, ABOUT = ".xml", "robot.xml", "MuJoCo's MJCF: links, armature, damping, dry friction, gears"


def write(estimate: Estimate, options: Options) -> tuple[bytes, tuple[str, ...]]:
    """Links, damping, dry friction and armature."""
    content = Content.plausible(estimate, options)
    return make_mjcf(estimate.robot, content), content.left_out(armature=True)


def make_mjcf(robot: Robot, content: Content) -> bytes:
    """MJCF with one body a link; gravity, ranges and motors included; capsules only to be seen.

    Raises InputError for a link that MuJoCo cannot load: one without mass or without thickness.
    """
    root = etree.Element("mujoco", model=robot.name)
    # Nothing is to be guessed or mended: the numbers are those that were identified.
    etree.SubElement(
        root,
        "compiler",
        angle="radian",
        autolimits="true",
        inertiafromgeom="false",
        balanceinertia="false",
    )
    etree.SubElement(root, "option", gravity=numbers(np.array(robot.gravity)))
    bodies: list[Any] = [etree.SubElement(root, "worldbody")]
    actuators, equality = etree.Element("actuator"), etree.Element("equality")
    link_of = {carrier: k for k, carrier in enumerate(robot.link_joints)}
    for i, joint in enumerate(robot.tree):
        body = etree.SubElement(
            bodies[joint.parent + 1],
            "body",
            name=f"link{i + 1}",
            pos=numbers(joint.placement[:3, 3]),
            quat=numbers(quaternion(joint.placement[:3, :3])),
        )
        bodies.append(body)
        if i not in link_of:
            raise InputError(
                f"link {i + 1} (on joint {joint.name!r}) is declared massless, which MuJoCo refuses",
                "write .json instead",
            )
        inertial = Inertial.of(content.links[link_of[i]])
        _require_solid(inertial, i, joint.name)
        full = inertial.about_com[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        etree.SubElement(
            body,
            "inertial",
            pos=numbers(inertial.com),
            mass=number(inertial.mass),
            fullinertia=numbers(full),
        )
        element = _joint(body, joint)
        if joint.name in robot.joint_names:
            k = robot.joint_names.index(joint.name)
            element.set("damping", number(content.damping[k]))
            element.set("frictionloss", number(content.friction[k]))
            element.set("armature", number(content.armature[k]))
            actuators.append(_actuator(joint, content, k))
        else:
            leader, multiplier, offset = robot.leader(i)
            course = numbers(np.array([offset, multiplier, 0.0, 0.0, 0.0]))
            etree.SubElement(equality, "joint", joint1=joint.name, joint2=leader, polycoef=course)
        _capsules(body, robot, i)
    if len(equality):
        root.append(equality)
    root.append(actuators)
    etree.indent(root)
    return bytes(etree.tostring(root, encoding="utf-8")) + b"\n"


def _actuator(joint: Joint, content: Content, k: int) -> Any:
    """A position servo where its gains were identified, else a motor."""
    names = {"name": joint.name, "joint": joint.name}
    if content.servo is not None:
        kp, kd = map(number, content.servo[:, k])
        return etree.Element("position", kp=kp, kv=kd, **names)
    motor = etree.Element("motor", **names)
    if content.gains:  # a command is in the units that the channel measures
        motor.set("gear", number(1.0 / content.gains[k]))
    if np.isfinite(joint.effort) and joint.effort > 0.0:
        motor.set("ctrlrange", numbers(np.array([-joint.effort, joint.effort])))
    return motor


def _joint(body: Any, joint: Joint) -> Any:
    kind = "hinge" if joint.kind == "revolute" else "slide"
    element = etree.SubElement(body, "joint", name=joint.name, type=kind, axis=numbers(joint.axis))
    if np.isfinite(joint.lower) and np.isfinite(joint.upper):
        element.set("range", numbers(np.array([joint.lower, joint.upper])))
    return element


def _require_solid(body: Inertial, i: int, joint: str) -> None:
    smallest = float(np.linalg.eigvalsh(body.about_com)[0])
    if body.mass <= _SMALLEST or smallest <= _SMALLEST:
        what = "mass" if body.mass <= _SMALLEST else "moment of inertia about some axis"
        raise InputError(
            f"link {i + 1} (on joint {joint!r}): it has no {what}, which MuJoCo refuses",
            "identify with the method lmi-sdp-thickness, whose links have a minimum thickness",
        )


def _capsules(body: Any, robot: Robot, i: int) -> None:
    """A thin capsule to every joint that the link carries: no mass, no collisions."""
    for child in robot.tree:
        end = child.placement[:3, 3]
        length = float(np.linalg.norm(end))
        if child.parent == i and length > 0.0:
            etree.SubElement(
                body,
                "geom",
                type="capsule",
                fromto=numbers(np.concatenate([np.zeros(3), end])),
                size=number(0.08 * length),
                contype="0",
                conaffinity="0",
                rgba="0.6 0.65 0.7 0.5",
            )


def quaternion(rotation: Array) -> Array:
    """(w, x, y, z) of a rotation."""
    return Rotation.from_matrix(rotation).as_quat(scalar_first=True)
