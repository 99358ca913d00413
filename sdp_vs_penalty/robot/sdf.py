"""The URDF of an SDFormat model, which the URDF reader then reads.

URDF's link frames lie on their joints, SDF's anywhere: with the poses X of a link and J
of the joint that carries it, in the model's frame at zero, the URDF has J as the link's
frame, and everything in the link moves by J^-1 X.
"""

import re
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
from lxml import etree

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.rotation import (
    rotation_of_quaternion,
    rotation_of_rpy,
    rpy_of,
)
from sdp_vs_penalty.robot.urdf import coupling_elements, numbers_of

#: The frame of the model, and what does not move.
_MODEL = "__model__"
_WORLD = "world"
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
#: Shapes and the numbers that URDF writes as attributes.
_SHAPES = {
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "mesh": ("scale",),
}


def urdf_of_sdf(root: Any) -> Any:
    """Return the <robot> element of a URDF with the links and joints of an SDF model.

    Parameters
    ----------
    root : XML element
        The <sdf> element: one <model>, alone or in a <world>.

    Returns
    -------
    XML element
        A URDF; what is wrong with its tree is left to the URDF reader.

    Raises
    ------
    InputError
        The file has another number of models, includes other files, or names a frame
        that it does not have.
    """
    models = [*root.findall("model"), *root.findall("world/model")]
    if len(models) != 1:
        what = f"{len(models)} <model>s, one is read"
        raise InputError(what, "name a file of one robot")
    (model,) = models
    for tag in ("include", "model"):
        if (inner := model.find(tag)) is not None:
            what = f"line {inner.sourceline}: a <{tag}> in the model is not read"
            raise InputError(what, "write one model with all its links (`gz sdf -p`)")
    return _Model.from_element(model).urdf()


def defaults_left_in(link: Any) -> list[str]:
    """List what the <inertial> of an SDF's <link> leaves to the format's default, a unit mass
    with unit moments; nothing of a link without one."""
    needed = ("mass", *(f"inertia/{x}" for x in _MOMENTS if x[1] == x[2]))
    inertials = link.findall("inertial")
    missing = [x for y in inertials for x in needed if not _text(y, x)]
    return [x.rpartition("/")[2] for x in missing]


@dataclass(frozen=True)
class _Model:
    """An SDF model and the poses of its frames at zero."""

    #: The <model> element.
    element: Any
    #: (4, 4) of each link, joint and frame in the model's frame, by name.
    poses: Mapping[str, Array]
    #: The link to which each frame is attached, by name; a link is its own.
    links: Mapping[str, str]

    @classmethod
    def from_element(cls, model: Any) -> "_Model":
        """Resolve the poses of all frames, each relative to another one."""
        # What each frame's pose is relative to where it does not say.
        default = {str(x.get("name")): _MODEL for x in model.findall("link")}
        attached = {name: name for name in default} | {_WORLD: _WORLD}
        elements = [*model.findall("link")]
        for x in model.findall("joint"):
            name = str(x.get("name"))
            default[name] = attached[name] = _text(x, "child")
            elements.append(x)
        for x in model.findall("frame"):
            name = str(x.get("name"))
            attached[name] = x.get("attached_to") or ""
            default[name] = attached[name] or _MODEL
            elements.append(x)
        poses = {_MODEL: np.eye(4), _WORLD: np.eye(4)}
        waiting = {str(x.get("name")): x for x in elements}
        while waiting:
            parents = {k: _relative_to(x, default[k]) for k, x in waiting.items()}
            ready = [name for name, parent in parents.items() if parent in poses]
            if not ready:
                raise _unresolved(parents)
            for name in ready:
                poses[name] = poses[parents[name]] @ _pose(waiting.pop(name))
        return cls(model, poses, attached)

    def urdf(self) -> Any:
        """Return the <robot> element."""
        robot = etree.Element("robot", name=self.element.get("name") or "robot")
        joints = self.element.findall("joint")
        ends = {str(x.get("name")): self._ends(x) for x in joints}
        # The frame of each URDF link: that of the joint which carries it.
        frames = {
            str(x.get("name")): self.poses[str(x.get("name"))] for x in self._links()
        }
        frames[_WORLD] = np.eye(4)
        for name, (_, child) in ends.items():
            frames[child] = self.poses[name]
        if any(_WORLD in pair for pair in ends.values()):
            etree.SubElement(robot, "link", name=_WORLD)
        for link in self._links():
            self._add_link(robot, link, frames[str(link.get("name"))])
        # What a simulator's plug-in couples stays, so that it is named as a URDF's is.
        # A copy holds what lies inside.
        couplings = coupling_elements(self.element)
        outer = [x for x in couplings if not {*x.iterancestors()} & {*couplings}]
        etree.SubElement(robot, "gazebo").extend(map(deepcopy, outer))
        for joint in joints:
            parent, child = ends[str(joint.get("name"))]
            self._add_joint(robot, joint, parent, child, frames.get(parent, np.eye(4)))
        return robot

    def _links(self) -> Any:
        """Return the <link> elements."""
        return self.element.findall("link")

    def _ends(self, joint: Any) -> tuple[str, str]:
        """Return the links at a joint's ends; a frame may stand for a link there."""
        ends = []
        for tag in ("parent", "child"):
            name = _text(joint, tag)
            for _ in self.links:
                name = self.links.get(name, name)
            ends.append(name)
        return ends[0], ends[1]

    def _add_link(self, robot: Any, link: Any, frame: Array) -> None:
        """Append a URDF link: inertial and shapes, in the frame (4, 4)."""
        placed = np.linalg.inv(frame) @ self.poses[str(link.get("name"))]
        out = etree.SubElement(robot, "link", name=str(link.get("name")))
        if (inertial := link.find("inertial")) is not None:
            element = etree.SubElement(out, "inertial")
            _add_origin(element, placed @ _pose(inertial))
            etree.SubElement(element, "mass", value=_text(inertial, "mass", "1"))
            # SDF's default is a unit mass with unit moments.
            moments = {
                key: _text(inertial, f"inertia/{key}", "1" if key[1] == key[2] else "0")
                for key in _MOMENTS
            }
            etree.SubElement(element, "inertia", moments)
        for tag in ("visual", "collision"):
            for shape in link.findall(tag):
                element = etree.SubElement(out, tag)
                _add_origin(element, placed @ _pose(shape))
                _add_geometry(element, shape.find("geometry"))

    def _add_joint(
        self, robot: Any, joint: Any, parent: str, child: str, frame: Array
    ) -> None:
        """Append a URDF joint between two links; frame (4, 4) is its parent's."""
        name = str(joint.get("name"))
        out = etree.SubElement(robot, "joint", name=name, type=str(joint.get("type")))
        _add_origin(out, np.linalg.inv(frame) @ self.poses[name])
        etree.SubElement(out, "parent", link=parent)
        etree.SubElement(out, "child", link=child)
        axis = joint.find("axis")
        if axis is None:
            return
        etree.SubElement(out, "axis", xyz=_words(self._axis(name, axis)))
        limits = {
            key: _text(axis, f"limit/{key}")
            for key in ("lower", "upper", "effort", "velocity")
            if axis.find(f"limit/{key}") is not None
        }
        # What an SDF has for no limit: -1, or a number beyond 1e15.
        for key in ("effort", "velocity"):
            if numbers_of(limits.get(key, "0"), 1)[0] < 0.0:
                del limits[key]
        if limits:
            etree.SubElement(out, "limit", limits)
        if (mimic := axis.find("mimic")) is not None:
            ratio, offset, reference = (
                numbers_of(_text(mimic, tag, default), 1)[0]
                for tag, default in (
                    ("multiplier", "1"),
                    ("offset", "0"),
                    ("reference", "0"),
                )
            )
            etree.SubElement(
                out,
                "mimic",
                joint=str(mimic.get("joint")),
                multiplier=repr(float(ratio)),
                offset=repr(float(offset - ratio * reference)),
            )

    def _axis(self, joint: str, axis: Any) -> Array:
        """Return a joint's axis (3,) in the joint's frame.

        It is written in that frame, in the one that "expressed_in" names, or in the
        model's (up to version 1.4, or "use_parent_model_frame").
        """
        xyz = axis.find("xyz")
        text = "0 0 1" if xyz is None else xyz.text or ""
        frame = joint if xyz is None else xyz.get("expressed_in") or joint
        version = numbers_of(self.element.getroottree().getroot().get("version", ""), 1)
        if version[0] < 1.5 or _text(axis, "use_parent_model_frame") in ("1", "true"):
            frame = _MODEL
        if frame not in self.poses:
            what = f"the axis of joint {joint!r} is expressed in {frame!r}"
            raise InputError(what, "name a frame of the model")
        direction = self.poses[frame][:3, :3] @ numbers_of(text, 3)
        return self.poses[joint][:3, :3].T @ direction


def _unresolved(frames: Mapping[str, str]) -> InputError:
    """Return the error of frames, each relative to another, that have no pose."""
    missing = [(x, of) for x, of in frames.items() if of not in frames]
    name, frame = (missing or list(frames.items()))[0]
    what = f"the pose of {name!r} is relative to {frame!r}"
    remedy = "name a frame of the model, in no circle"
    return InputError(what, remedy)


def _text(element: Any, path: str, default: str = "") -> str:
    """Return the text of an element below another one, without blanks around it."""
    return (element.findtext(path) or "").strip() or default


def _relative_to(element: Any, default: str) -> str:
    """Return the frame in which an element's pose is written."""
    pose = element.find("pose")
    return default if pose is None else pose.get("relative_to") or default


def _pose(element: Any) -> Array:
    """Return the pose (4, 4) that an element has: x y z roll pitch yaw, or x y z and a
    quaternion x y z w.

    Raises InputError for other numbers.
    """
    out = np.eye(4)
    pose = element.find("pose")
    if pose is None or not (pose.text or "").strip():
        return out
    is_quaternion = pose.get("rotation_format") == "quat_xyzw"
    values = numbers_of(pose.text, 7 if is_quaternion else 6)
    if not np.all(np.isfinite(values)):
        count = 7 if is_quaternion else 6
        what = f"line {pose.sourceline}, <pose> must hold {count} numbers"
        raise InputError(what, "correct the file")
    out[:3, 3] = values[:3]
    if is_quaternion:
        out[:3, :3] = rotation_of_quaternion(values[3:6], values[6])
    else:
        in_degrees = pose.get("degrees") in ("1", "true")
        out[:3, :3] = rotation_of_rpy(
            np.radians(values[3:]) if in_degrees else values[3:]
        )
    return out


def _add_origin(element: Any, pose: Array) -> None:
    """Append the <origin> of a pose (4, 4)."""
    etree.SubElement(
        element, "origin", xyz=_words(pose[:3, 3]), rpy=_words(rpy_of(pose[:3, :3]))
    )


def _add_geometry(element: Any, geometry: Any) -> None:
    """Append a <geometry> with the shape of SDF's; none for a shape that URDF lacks."""
    out = etree.SubElement(element, "geometry")
    for shape in () if geometry is None else geometry:
        if not isinstance(shape.tag, str) or shape.tag not in _SHAPES:
            continue
        texts = {
            key: re.sub(r"\s+", " ", _text(shape, key))
            for key in _SHAPES[shape.tag]
            if _text(shape, key)
        }
        if shape.tag == "mesh":
            texts["filename"] = _text(shape, "uri")
        etree.SubElement(out, shape.tag, texts)


def _words(numbers: Array) -> str:
    """Return numbers as text of full precision, separated by blanks."""
    return " ".join(repr(float(x) + 0.0) for x in numbers)
