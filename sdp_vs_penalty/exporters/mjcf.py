"""A MuJoCo model (MJCF) with full inertias, armature, damping and dry friction, or the
user's own with these numbers replaced.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from lxml import etree

from sdp_vs_penalty.effects.effect import JOINT_FIELDS, SimulatorField
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
from sdp_vs_penalty.exporters.own_file import Document, in_frames_of, order_of_joints
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import Joint
from sdp_vs_penalty.robot.mjcf import PlacedBody, load_bodies
from sdp_vs_penalty.robot.robot import Robot

ENDING = ".xml"
FILE = "robot.xml"
ABOUT = "MuJoCo's MJCF: links, armature, damping, dry friction, springs, offsets, gears"
EDITS = "MJCF"
HOLDS: frozenset[SimulatorField] = FIELDS | {*JOINT_FIELDS, "mjcf"}


def write(estimate: Estimate, options: Options) -> Written:
    """Return the bytes of a MuJoCo model, or of the user's own with the model's numbers
    in it, and the effects left out.

    This module is an :class:`ExportFormat`. The links must lie inside of their bodies.
    A new file has position actuators with the servo's gains; the user's own actuators
    stay as they are, so that these gains are left out there.
    """
    content = Content.plausible(estimate, options)
    lost = left_out(estimate, HOLDS)
    if options.own_file is None:
        return make_mjcf(estimate.robot, content), lost
    servos = () if content.servo is None else ("gains of the position actuators",)
    return edit_mjcf(options.own_file, estimate.robot, content), (*lost, *servos)


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
    element(
        root,
        "compiler",
        angle="radian",
        autolimits="true",
        inertiafromgeom="false",
        balanceinertia="false",
    )
    option = content.mjcf_attributes("option")
    element(root, "option", gravity=robot.gravity, **option)
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
            element(body, "joint", **attributes, **_joint_attributes(content, k))
            _actuator(actuators, joint, content, k)
        else:
            leader, multiplier, offset = robot.leader(i)
            polynomial = (offset, multiplier, 0.0, 0.0, 0.0)
            element(body, "joint", **attributes)
            element(
                equality, "joint", joint1=joint.name, joint2=leader, polycoef=polynomial
            )
        # A thin capsule from this body's origin to each joint that it carries shows the
        # link: it collides with nothing.
        for child in robot.tree:
            end = child.placement[:3, 3]
            if child.parent == i and end.any():
                element(
                    body,
                    "geom",
                    type="capsule",
                    fromto=np.concatenate([np.zeros(3), end]),
                    size=0.08 * float(np.linalg.norm(end)),
                    contype="0",
                    conaffinity="0",
                    rgba="0.6 0.65 0.7 0.5",
                )
    if len(equality):
        root.append(equality)
    root.append(actuators)
    return xml_text(root, declaration=False)


def _add_body(parent: Any, part: LinkPart) -> Any:
    """Add the body of a link to its parent's, with its pose and its inertial."""
    link_name = f"link {part.index + 1} (on joint {part.joint.name!r})"
    attributes = _inertial_attributes(part.inertial, link_name)
    placement = part.joint.placement
    rotation = scipy.spatial.transform.Rotation.from_matrix(placement[:3, :3])
    quat = rotation.as_quat(scalar_first=True)
    body = element(parent, "body", name=part.name, pos=placement[:3, 3], quat=quat)
    element(body, "inertial", **attributes)
    return body


def edit_mjcf(path: str | Path, robot: Robot, content: Content) -> bytes:
    """Return the user's MJCF with the model's inertials, armature, damping, dry friction,
    springs, and other attributes that its effects declare; actuators, meshes, names and
    every other byte stay.

    A body fixed to a moving one gets a mass of zero, because its mass is part of the
    moving one's. A body whose joint was held keeps its inertial, and the moving one gets
    the rest. Masses are those written: settings of the compiler that change them go.

    Parameters
    ----------
    path : path
        The file. Bodies that it includes from other files are not edited.
    content : Content
        What a simulator's file can hold of the model.

    Raises
    ------
    InputError
        If the file's joints are not those of the model, or its bodies lie in other
        files.
    """
    held = {joint.name: joint.value for joint in robot.held}
    file_robot, places = load_bodies(path, held)
    document = Document.read(path)
    bodies = _body_elements(path, document, [place.joints for place in places])
    order = order_of_joints(path, file_robot, robot)
    links = in_frames_of(path, file_robot, robot, content.links, order)
    link_of_joint = dict(zip(file_robot.link_joints, links, strict=True))
    _put_inertials(document, path, bodies, places, link_of_joint)
    _put_joints(document, bodies, file_robot, robot, content, order)
    for compiler in document.root.iter("compiler"):
        attributes = {k: v for k, v in compiler.attrib.items() if k != "settotalmass"}
        if attributes.get("inertiafromgeom") == "true":
            attributes["inertiafromgeom"] = "auto"
        if attributes != dict(compiler.attrib):
            document.change(compiler, attributes, keep=False)
    return document.edited()


def _put_inertials(
    document: Document,
    path: str | Path,
    bodies: Sequence[Any],
    places: Sequence[PlacedBody],
    links: dict[int, Array],
) -> None:
    """Write the model's links into the <inertial> elements of a file's bodies.

    A moving joint's first body gets the joint's link; other bodies fixed to it get zero
    mass. A held joint's body keeps its inertial, which is subtracted from the link.

    Parameters
    ----------
    bodies, places : sequence
        The <body> elements, and where each lies.
    links : dict
        Parameters (10,) of a link about its joint's frame, by the joint's index in the
        tree; changed here.
    """
    first_body = dict[int, int]()  # by the moving joint that carries it
    for k, place in enumerate(places):
        first_body.setdefault(place.carrier, k)
    for k, place in enumerate(places):
        joint = place.carrier
        if joint not in links or k == first_body[joint]:
            continue
        if place.joints:  # of a held joint
            carried = inertia.transform(place.pose) @ place.inertial
            links[joint] = links[joint] - carried
            _put_inertial(document, path, bodies[k], place.inertial)
        elif place.inertial.any():
            zero_inertial = {"pos": "0 0 0", "mass": "0", "diaginertia": "0 0 0"}
            _replace_inertial(document, bodies[k], zero_inertial)
    for joint, link in links.items():
        k = first_body[joint]
        to_body = inertia.transform(np.linalg.inv(places[k].pose))
        _put_inertial(document, path, bodies[k], to_body @ link)


def _body_elements(
    path: str | Path, document: Document, joints: list[tuple[str, ...]]
) -> list[Any]:
    """Return the <body> elements in MuJoCo's order, those of ``joints``.

    Raises InputError if they are not all in this file: included, replicated.
    """
    bodies = [
        body for world in document.root.iter("worldbody") for body in world.iter("body")
    ]
    counts = [len(body.findall("joint")) for body in bodies]
    names = [name for of_body in joints for name in of_body]
    if (
        counts != [len(of_body) for of_body in joints]
        or [*_joint_elements(bodies)] != names
    ):
        what = "its bodies are not all written in this file (included, or replicated)"
        remedy = "save it whole by MuJoCo (mj_saveLastXML), and name that file"
        raise InputError(what, remedy, path)
    return bodies


def _joint_elements(bodies: list[Any]) -> dict[str, Any]:
    """Return the <joint> elements of bodies by name, in MuJoCo's order; one without a name
    is called by its number, from 1."""
    elements = [joint for body in bodies for joint in body.findall("joint")]
    return {x.get("name") or f"joint{k}": x for k, x in enumerate(elements, 1)}


def _put_inertial(document: Document, path: str | Path, body: Any, link: Array) -> None:
    """Give a body the inertial of standard parameters (10,) about its frame."""
    body_name = f"{path}: body {body.get('name', 'without a name')!r}"
    require_consistent(link, body_name)
    attributes = _inertial_attributes(Inertial.from_parameters(link), body_name)
    written = {
        name: " ".join(map(number, np.atleast_1d(value)))
        for name, value in attributes.items()
    }
    _replace_inertial(document, body, written)


def _replace_inertial(
    document: Document, body: Any, attributes: Mapping[str, str]
) -> None:
    """Give a body these attributes of its inertial, and no others."""
    if (old := body.find("inertial")) is not None:
        document.change(old, attributes, keep=False)
    else:
        document.put(body, "inertial", attributes)


def _put_joints(
    document: Document,
    bodies: list[Any],
    file_robot: Robot,
    robot: Robot,
    content: Content,
    order: list[int],
) -> None:
    """Give the driven joints of a file the model's damping, dry friction, armature and
    springs, and joints, actuators and option what else its effects declare.

    Where the file counts in degrees, a hinge's springref does, too.
    """
    tree_names = [joint.name for joint in file_robot.tree]
    angles = [x.get("angle") for x in document.root.iter("compiler") if x.get("angle")]
    is_in_degrees = not angles or angles[-1] == "degree"
    elements = _joint_elements(bodies)
    for joint in file_robot.joints:
        name_in_model = robot.tree[order[tree_names.index(joint.name)]].name
        k = robot.joint_names.index(name_in_model)
        values = _joint_attributes(content, k)
        if "springref" in values and is_in_degrees and joint.kind == "revolute":
            values["springref"] = np.degrees(values["springref"])
        document.change(elements[joint.name], _written(values))
        if of_actuator := content.mjcf_attributes("actuator", k):
            for x in document.root.iterfind(f"actuator/*[@joint='{joint.name}']"):
                document.change(x, _written(of_actuator))
    if of_option := content.mjcf_attributes("option"):
        option = document.root.find("option")
        if option is None:
            document.put(document.root, "option", _written(of_option))
        else:
            document.change(option, _written(of_option))


def _written(values: Mapping[str, float]) -> dict[str, str]:
    """Return numbers as text of full precision."""
    return {key: number(value) for key, value in values.items()}


def _joint_attributes(content: Content, k: int) -> dict[str, float]:
    """Return the attributes of MuJoCo's <joint> that hold the effects of driven joint
    k."""
    return {
        "damping": content.damping[k],
        "frictionloss": content.friction[k],
        **_spring(content.stiffness[k], content.offset[k]),
        "armature": content.armature[k],
        **content.mjcf_attributes("joint", k),
    }


def _inertial_attributes(solid: Inertial, name: str) -> dict[str, Any]:
    """Return the attributes of MuJoCo's <inertial>: pos [m], mass [kg], fullinertia
    [kg m^2] (Ixx, Iyy, Izz, Ixy, Ixz, Iyz).

    Raises InputError for a link without mass or thickness, which MuJoCo refuses; its own
    limit is 1e-15 (mjMINVAL), and numbers below 1e-12 are rounding. ``name`` is the
    link's there.
    """
    smallest_moment = np.linalg.eigvalsh(solid.about_com)[0]
    needed = {"mass": solid.mass, "moment of inertia about some axis": smallest_moment}
    missing = [what for what, size in needed.items() if size <= 1e-12]
    if missing:
        raise InputError(
            f"{name}: it has no {missing[0]}, which MuJoCo refuses",
            "identify with the method lmi-sdp-thickness, whose links have a minimum"
            " thickness, or write .json where a link is declared massless",
        )
    full = solid.about_com[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return {"pos": solid.com, "mass": solid.mass, "fullinertia": full}


#: The torque of a spring that stands for an offset alone changes by this share of the
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
    names: dict[str, Any] = {
        "name": joint.name,
        "joint": joint.name,
        **content.mjcf_attributes("actuator", k),
    }
    if content.servo is not None:
        kp, kd = content.servo[:, k]
        element(actuators, "position", kp=kp, kv=kd, **names)
        return
    if content.gains:  # a command is in the units that the channel measures
        names["gear"] = 1.0 / content.gains[k]
    if np.isfinite(joint.effort) and joint.effort > 0.0:
        names["ctrlrange"] = (-joint.effort, joint.effort)
    element(actuators, "motor", **names)
