"""Torques of an arm as a USD text file says it: read by a few lines, computed by Pinocchio."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.robot.robot import Robot


def prims(text: str) -> dict[str, dict[str, Any]]:
    """Attributes of every prim by its name: numbers as arrays, targets as the end of their path."""
    out: dict[str, dict[str, Any]] = {}
    for kind, name, body in re.findall(r'def (\w+) "(\w+)"[^{]*\{([^{}]*)\}', text):
        out[name] = {"kind": kind}
        for key, value in re.findall(r"^\s+(?:uniform )?\w+ ([\w:]+) = (.+)$", body, re.MULTILINE):
            found = re.search(r"/(\w+)>$", value)
            if found is None and re.fullmatch(r"[-+.\deE, ()]+", value):
                out[name][key] = np.array([float(x) for x in value.strip("()").split(",")])
            else:
                out[name][key] = found[1] if found else value
    return out


def turn(wxyz: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(wxyz, scalar_first=True).as_matrix()


def place(at: np.ndarray, wxyz: np.ndarray) -> Any:
    return pin.SE3(turn(wxyz), at)


def torques(path: Path, robot: Robot, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    """By Pinocchio from what the file says, joints along their x axes."""
    said = prims(path.read_text())
    model, end = pin.Model(), {"base_link": (0, pin.SE3.Identity())}
    model.gravity = pin.Motion(np.array(robot.gravity), np.zeros(3))  # a matter of the scene
    order = []
    for name, joint in said.items():
        if joint["kind"] not in ("PhysicsRevoluteJoint", "PhysicsPrismaticJoint"):
            continue
        parent, behind = end[joint["physics:body0"]]
        outer = place(joint["physics:localPos0"], joint["physics:localRot0"])
        inner = place(joint["physics:localPos1"], joint["physics:localRot1"])
        kind = pin.JointModelRX() if "Revolute" in joint["kind"] else pin.JointModelPX()
        k = model.addJoint(parent, kind, behind * outer, name)
        end[joint["physics:body1"]] = k, inner.inverse()
        link = said[joint["physics:body1"]]
        axes = turn(link["physics:principalAxes"])
        about = axes @ np.diag(link["physics:diagonalInertia"]) @ axes.T
        body = pin.Inertia(float(link["physics:mass"][0]), link["physics:centerOfMass"], about)
        model.appendBodyToJoint(k, body, inner.inverse())
        order.append(name)
    data = model.createData()
    pick = [robot.joint_names.index(name) for name in order]
    out = np.empty_like(q)
    for k in range(len(q)):
        out[k, pick] = pin.rnea(model, data, q[k, pick], dq[k, pick], ddq[k, pick])
    # The links stand where the joints put them at q = 0, whoever reads the one or the other.
    pin.forwardKinematics(model, data, np.zeros(model.nq))
    for name, (k, behind) in end.items():
        if k:
            link = said[name]
            stands = place(link["xformOp:translate"], link["xformOp:orient"])
            assert (data.oMi[k] * behind).isApprox(stands, 1e-9)
    return out
