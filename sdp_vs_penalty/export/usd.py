"""A model as a USD text file (UsdPhysics), for Isaac Sim and Omniverse: links on their joints.

Source: OpenUSD, schema UsdPhysics; of the links what MassAPI holds: mass [kg], centerOfMass [m],
diagonalInertia [kg m^2] about it, and principalAxes, the quaternion of their directions.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.export.content import Content, Inertial, number
from sdp_vs_penalty.export.mjcf import quaternion
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import Joint
from sdp_vs_penalty.robot.robot import Robot

_HEAD = """#usda 1.0
(
    defaultPrim = "{name}"
    kilogramsPerUnit = 1
    metersPerUnit = 1
    upAxis = "Z"
)

def Xform "{name}" (
    prepend apiSchemas = ["PhysicsArticulationRootAPI"]
)
{{"""
_LINK = """
    def Xform "{name}" (
        prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
    )
    {{
        float physics:mass = {mass}
        point3f physics:centerOfMass = {com}
        float3 physics:diagonalInertia = {moments}
        quatf physics:principalAxes = {axes}
        double3 xformOp:translate = {place}
        quatd xformOp:orient = {turn}
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]
    }}"""
_JOINT = """
    def {kind} "{name}"
    {{
        uniform token physics:axis = "X"
        rel physics:body0 = </{robot}/{parent}>
        rel physics:body1 = </{robot}/{child}>
        point3f physics:localPos0 = {place}
        quatf physics:localRot0 = {turn}
        point3f physics:localPos1 = (0, 0, 0)
        quatf physics:localRot1 = {axis}{limits}
    }}"""
_BASE = """
    def Xform "base_link" (
        prepend apiSchemas = ["PhysicsRigidBodyAPI"]
    )
    {{
    }}

    def PhysicsFixedJoint "base"
    {{
        rel physics:body1 = </{robot}/base_link>
    }}"""


def make_usd(robot: Robot, content: Content) -> bytes:
    """USD of a model's kinematics at q = 0 and its inertials; the base stands in the world.

    A joint's axis is the x axis of its frames. Raises InputError for a link without mass or moments,
    which USD takes for "not given" and makes up, and for joints that follow others.
    """
    taken: set[str] = {"base_link", "base", *(f"link{i + 1}" for i in range(len(robot.tree)))}
    name = _identifier(robot.name, set())
    parts = [_HEAD.format(name=name), _BASE.format(robot=name)]
    link_of = {carrier: k for k, carrier in enumerate(robot.link_joints)}
    (poses,) = robot.poses(np.zeros((1, len(robot.tree))))
    for i, joint in enumerate(robot.tree):
        if i not in link_of or joint.name not in robot.joint_names:
            raise InputError(
                f"joint {joint.name!r} has no link of its own, or follows another: USD's physics has no "
                "place for that",
                "write .urdf or .json instead",
            )
        parts.append(_link(f"link{i + 1}", content.links[link_of[i]], poses[i]))
        # A rotation that takes x to the axis.
        turned, _ = Rotation.align_vectors(joint.axis[None, :], np.array([[1.0, 0.0, 0.0]]))
        about_axis = np.asarray(turned.as_matrix())
        joined = _JOINT.format(
            kind=f"Physics{joint.kind.capitalize()}Joint",
            name=_identifier(joint.name, taken),
            robot=name,
            parent="base_link" if joint.parent < 0 else f"link{joint.parent + 1}",
            child=f"link{i + 1}",
            place=_tuple(joint.placement[:3, 3]),
            turn=_tuple(quaternion(joint.placement[:3, :3] @ about_axis)),
            axis=_tuple(quaternion(about_axis)),
            limits="".join(_limits(joint)),
        )
        parts.append(joined)
    return ("\n".join([*parts, "}"]) + "\n").encode()


def _link(name: str, link: Array, pose: Array) -> str:
    body = Inertial.of(link)
    moments, axes = np.linalg.eigh(body.about_com)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    if body.mass <= 0.0 or not np.any(moments > 0.0):
        raise InputError(
            f"{name} has no mass or no moments of inertia, which USD would make up",
            "identify with the method lmi-sdp-thickness, or write .sdf instead",
        )
    return _LINK.format(
        name=name,
        mass=number(body.mass),
        com=_tuple(body.com),
        moments=_tuple(np.maximum(moments, 0.0)),
        axes=_tuple(quaternion(axes)),
        place=_tuple(pose[:3, 3]),
        turn=_tuple(quaternion(pose[:3, :3])),
    )


def _limits(joint: Joint) -> Iterator[str]:
    """Degrees for a revolute joint, as UsdPhysics has them."""
    scale = 180.0 / np.pi if joint.kind == "revolute" else 1.0
    for which, value in (("lower", joint.lower), ("upper", joint.upper)):
        if np.isfinite(value):
            yield f"\n        float physics:{which}Limit = {number(scale * value)}"


def _tuple(values: Array) -> str:
    return f"({', '.join(map(number, values))})"


def _identifier(text: str, taken: set[str]) -> str:
    """A name that USD allows and nobody has yet."""
    made = re.sub(r"\W", "_", text, flags=re.ASCII) or "_"
    made = f"_{made}" if made[0].isdigit() else made
    while made in taken:
        made += "_"
    taken.add(made)
    return made
