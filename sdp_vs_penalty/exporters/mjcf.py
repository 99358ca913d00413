"""A MuJoCo model (MJCF) with full inertias, armature, damping and dry friction."""

from typing import Any

import numpy as np
import scipy
from lxml import etree

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import (
    HELD,
    Content,
    Options,
    element,
    parts,
    xml_name,
    xml_text,
)
from sdp_vs_penalty.exporters.interface import Written
from sdp_vs_penalty.robot.joint import Joint
from sdp_vs_penalty.robot.robot import Robot

ENDING = ".xml"
FILE = "robot.xml"
ABOUT = "MuJoCo's MJCF: links, armature, damping, dry friction, springs, offsets, gears"
HOLDS = HELD | {"rotor_inertia", "joint_spring", "torque_offset"}


def write(estimate: Estimate, options: Options) -> Written:
    """Make a MuJoCo model: links, damping, dry friction, armature, springs and offsets.

    This module is an :class:`ExportFormat`. Returns the file's bytes and the effects
    left out.
    """
    content = Content.plausible(estimate, options)
    return make_mjcf(estimate.robot, content), content.left_out(
        armature=True, springs=True
    )


def make_mjcf(robot: Robot, content: Content) -> bytes:
    """Make an MJCF document with one body for each link, gravity, joint ranges and
    motors.

    Capsules show the links; they neither collide nor weigh anything.

    Parameters
    ----------
    robot : Robot
        Its kinematics.
    content : Content
        What a simulator's file can hold of the model.

    Returns
    -------
    bytes
        The document.

    Raises
    ------
    InputError
        For a link without mass or without thickness, which MuJoCo cannot load.
    """
    root = etree.Element("mujoco", model=xml_name(robot.name))
    # Nothing is to be guessed or mended: the numbers are those that were identified.
    no = dict.fromkeys(("inertiafromgeom", "balanceinertia"), "false")
    element(
        root,
        "compiler",
        angle="radian",
        autolimits="true",
        **no,
    )
    element(root, "option", gravity=robot.gravity)
    bodies: list[Any] = [element(root, "worldbody")]
    actuators = etree.Element("actuator")
    equality = etree.Element("equality")
    for i, part in enumerate(parts(robot, content.links)):
        joint = part.joint
        place = part.joint.placement
        quat = scipy.spatial.transform.Rotation.from_matrix(place[:3, :3]).as_quat(
            scalar_first=True
        )
        body = element(
            bodies[joint.parent + 1],
            "body",
            name=part.name,
            pos=place[:3, 3],
            quat=quat,
        )
        bodies.append(body)
        solid = part.inertial
        needed = {"mass": solid.mass}
        needed["moment of inertia about some axis"] = np.linalg.eigvalsh(
            solid.about_com
        )[0]
        # MuJoCo wants its mjMINVAL, 1e-15; less than this is rounding.
        if missing := [name for name, size in needed.items() if size <= 1e-12]:
            raise InputError(
                f"link {i + 1} (on joint {joint.name!r}): it has no {missing[0]}, which"
                " MuJoCo refuses",
                "identify with the method lmi-sdp-thickness, whose links have a minimum"
                " thickness, or write .json where a link is declared massless",
            )
        full = solid.about_com[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        element(
            body,
            "inertial",
            pos=solid.com,
            mass=solid.mass,
            fullinertia=full,
        )
        kind = "hinge" if joint.kind == "revolute" else "slide"
        attributes: dict[str, Any] = {
            "name": joint.name,
            "type": kind,
            "axis": joint.axis,
        }
        if np.isfinite(joint.lower) and np.isfinite(joint.upper):
            attributes["range"] = (joint.lower, joint.upper)
        if (k := part.place) is not None:
            attributes |= {
                "damping": content.damping[k],
                "frictionloss": content.friction[k],
            }
            attributes |= _spring(content.stiffness[k], content.offset[k])
            element(
                body,
                "joint",
                **attributes,
                armature=content.armature[k],
            )
            _actuator(actuators, joint, content, k)
        else:
            leader, multiplier, offset = robot.leader(i)
            course = (offset, multiplier, 0.0, 0.0, 0.0)
            element(body, "joint", **attributes)
            element(
                equality,
                "joint",
                joint1=joint.name,
                joint2=leader,
                polycoef=course,
            )
        for child in (
            robot.tree
        ):  # a thin capsule to every joint that the link carries: only to be seen
            end = child.placement[:3, 3]
            if child.parent == i and (length := float(np.linalg.norm(end))) > 0.0:
                visual_attributes = {
                    "contype": "0",
                    "conaffinity": "0",
                    "rgba": "0.6 0.65 0.7 0.5",
                }
                ends = np.concatenate([np.zeros(3), end])
                element(
                    body,
                    "geom",
                    type="capsule",
                    fromto=ends,
                    size=0.08 * length,
                    **visual_attributes,
                )
    if len(equality):
        root.append(equality)
    root.append(actuators)
    return xml_text(root, declaration=False)


#: Of a spring that stands for an offset alone: its torque changes by this share of the
#: offset in a radian or metre.
_SOFT = 1e-10


def _spring(stiffness: float, offset: float) -> dict[str, float]:
    """Return MuJoCo's joint attributes for a drive torque k q + c.

    MuJoCo's spring pulls with -stiffness (q - springref). An offset without a spring
    becomes a spring so soft and so far away that its torque hardly changes.
    """
    if not offset:
        return (
            {
                "stiffness": stiffness,
                "springref": 0.0,
            }
            if stiffness
            else {}
        )
    stiffness = stiffness or _SOFT * abs(offset)
    return {
        "stiffness": stiffness,
        "springref": -offset / stiffness,
    }


def _actuator(
    actuators: Any,
    joint: Joint,
    content: Content,
    k: int,
) -> None:
    """Append the actuator of joint k: a position servo if its gains are known, else
    a motor.
    """
    names: dict[str, Any] = {
        "name": joint.name,
        "joint": joint.name,
    }
    if content.servo is not None:
        kp, kd = content.servo[:, k]
        element(
            actuators,
            "position",
            kp=kp,
            kv=kd,
            **names,
        )
        return
    if content.gains:  # a command is in the units that the channel measures
        names["gear"] = 1.0 / content.gains[k]
    if np.isfinite(joint.effort) and joint.effort > 0.0:
        names["ctrlrange"] = (-joint.effort, joint.effort)
    element(actuators, "motor", **names)
