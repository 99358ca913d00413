"""A MuJoCo model (MJCF) with full inertias, armature, damping and dry friction."""

from typing import Any

import numpy as np
import scipy
from lxml import etree

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import (
    FIELDS,
    Content,
    LinkPart,
    Options,
    element,
    link_parts,
    xml_name,
    xml_text,
)
from sdp_vs_penalty.exporters.held import left_out
from sdp_vs_penalty.exporters.interface import Written
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import Joint
from sdp_vs_penalty.robot.robot import Robot

ENDING = ".xml"
FILE = "robot.xml"
ABOUT = "MuJoCo's MJCF: links, armature, damping, dry friction, springs, offsets, gears"
HOLDS = FIELDS | {"armature", "stiffness", "offset"}
RESTS = True


def write(estimate: Estimate, options: Options) -> Written:
    """Make a MuJoCo model: links, damping, dry friction, armature, springs and offsets.

    This module is an :class:`ExportFormat`. Returns the file's bytes and the effects
    left out.
    """
    content = Content.plausible(estimate, options)
    return make_mjcf(estimate.robot, content), left_out(estimate, HOLDS)


def make_mjcf(robot: Robot, content: Content) -> bytes:
    """Make an MJCF document with one body for each link, gravity, joint ranges and
    motors.

    Capsules show the links; they neither collide nor weigh anything.

    Parameters
    ----------
    robot : Robot
        The kinematics: joints and their frames.
    content : Content
        What a simulator's file can hold of the model.

    Raises
    ------
    InputError
        For a link without mass or without thickness, which MuJoCo cannot load.
    """
    root = etree.Element("mujoco", model=xml_name(robot.name))
    # Nothing is to be guessed or mended: the numbers are those that were identified.
    no = dict.fromkeys(("inertiafromgeom", "balanceinertia"), "false")
    element(root, "compiler", angle="radian", autolimits="true", **no)
    element(root, "option", gravity=robot.gravity)
    bodies: list[Any] = [element(root, "worldbody")]
    actuators = etree.Element("actuator")
    equality = etree.Element("equality")
    # bodies[k + 1] is the body that joint k carries; bodies[0] is the world.
    for i, part in enumerate(link_parts(robot, content.links)):
        joint = part.joint
        body = _add_body(bodies[joint.parent + 1], part)
        bodies.append(body)
        kind = "hinge" if joint.kind == "revolute" else "slide"
        attributes: dict[str, Any] = {
            "name": joint.name,
            "type": kind,
            "axis": joint.axis,
        }
        if np.isfinite(joint.lower) and np.isfinite(joint.upper):
            attributes["range"] = (joint.lower, joint.upper)
        # A driven joint, number k, has friction and a motor; another follows its leader
        # by an equality q = offset + multiplier q_leader.
        if (k := part.place) is not None:
            attributes |= {
                "damping": content.damping[k],
                "frictionloss": content.friction[k],
            }
            attributes |= _spring(content.stiffness[k], content.offset[k])
            element(body, "joint", **attributes, armature=content.armature[k])
            _actuator(actuators, joint, content, k)
        else:
            leader, multiplier, offset = robot.leader(i)
            course = (offset, multiplier, 0.0, 0.0, 0.0)
            element(body, "joint", **attributes)
            element(
                equality, "joint", joint1=joint.name, joint2=leader, polycoef=course
            )
        # A capsule from this body's origin to each joint that it carries shows its
        # shape.
        for child in robot.tree:
            if child.parent == i:
                _draw_capsule(body, child.placement[:3, 3])
    if len(equality):
        root.append(equality)
    root.append(actuators)
    return xml_text(root, declaration=False)


def _add_body(parent: Any, part: LinkPart) -> Any:
    """Add the body of a link to its parent's, with its pose and its inertial."""
    _require_loadable(part)
    placement = part.joint.placement
    rotation = scipy.spatial.transform.Rotation.from_matrix(placement[:3, :3])
    quat = rotation.as_quat(scalar_first=True)
    body = element(parent, "body", name=part.name, pos=placement[:3, 3], quat=quat)
    solid = part.inertial
    # Ixx, Iyy, Izz, Ixy, Ixz, Iyz.
    full = solid.about_com[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    element(body, "inertial", pos=solid.com, mass=solid.mass, fullinertia=full)
    return body


def _require_loadable(part: LinkPart) -> None:
    """Raise InputError for a link without mass or thickness, which MuJoCo refuses.

    MuJoCo's own limit is 1e-15 (mjMINVAL); numbers below 1e-12 are rounding.
    """
    smallest_moment = np.linalg.eigvalsh(part.inertial.about_com)[0]
    needed = {
        "mass": part.inertial.mass,
        "moment of inertia about some axis": smallest_moment,
    }
    missing = [name for name, size in needed.items() if size <= 1e-12]
    if missing:
        raise InputError(
            f"link {part.index + 1} (on joint {part.joint.name!r}): it has no"
            f" {missing[0]}, which MuJoCo refuses",
            "identify with the method lmi-sdp-thickness, whose links have a minimum"
            " thickness, or write .json where a link is declared massless",
        )


def _draw_capsule(body: Any, end: Array) -> None:
    """Append a thin capsule from a body's origin to ``end`` (3,) [m].

    It only shows the link: it collides with nothing. A length of zero shows nothing.
    """
    length = float(np.linalg.norm(end))
    if length == 0.0:
        return
    element(
        body,
        "geom",
        type="capsule",
        fromto=np.concatenate([np.zeros(3), end]),
        size=0.08 * length,
        contype="0",
        conaffinity="0",
        rgba="0.6 0.65 0.7 0.5",
    )


#: Of a spring that stands for an offset alone: its torque changes by this share of the
#: offset in a radian or metre.
_SOFT = 1e-10


def _spring(stiffness: float, offset: float) -> dict[str, float]:
    """Return MuJoCo's joint attributes for a drive torque k q + c.

    MuJoCo's spring pulls with -stiffness (q - springref). An offset without a spring
    becomes a spring so soft and so far away that its torque hardly changes.
    """
    if not offset and not stiffness:
        return {}
    if not offset:
        return {"stiffness": stiffness, "springref": 0.0}
    stiffness = stiffness or _SOFT * abs(offset)
    return {"stiffness": stiffness, "springref": -offset / stiffness}


def _actuator(actuators: Any, joint: Joint, content: Content, k: int) -> None:
    """Append the actuator of joint k: a position servo if its gains are known, else
    a motor.
    """
    names: dict[str, Any] = {"name": joint.name, "joint": joint.name}
    if content.servo is not None:
        kp, kd = content.servo[:, k]
        element(actuators, "position", kp=kp, kv=kd, **names)
        return
    if content.gains:  # a command is in the units that the channel measures
        names["gear"] = 1.0 / content.gains[k]
    if np.isfinite(joint.effort) and joint.effort > 0.0:
        names["ctrlrange"] = (-joint.effort, joint.effort)
    element(actuators, "motor", **names)
