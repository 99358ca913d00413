"""The model as plain JSON: also the effects that a URDF or MJCF has no place for."""

import json
from typing import Any

from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import Options, verdict_line
from sdp_vs_penalty.exporters.interface import Written
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot

ENDING = ".json"
FILE = "effects.json"
ABOUT = "every effect as plain JSON, with its equation"


def write(estimate: Estimate, options: Options) -> Written:
    """Make a JSON file with links in readable form, and every effect.

    It holds the robot, each link's mass, centre of mass and inertia about it, and each
    effect's equation, reference, constants, and parameters with values and units; then
    method, verdict and provenance. Where an effect refers to the torque of links
    (friction by load), ``reference_links`` are those at which it was identified. This
    module is an :class:`ExportFormat`. Returns the file's bytes; nothing is left out.
    """
    model = estimate.model
    robot = estimate.robot
    effects = []
    # Each effect with what explains it, and the values of its parameters.
    for effect, indices in model.parts:
        about = {
            name: getattr(effect, name)
            for name in ("equation", "explanation", "reference")
        }
        about["parameters"] = [
            {"name": p.name, "joint": p.joint, "value": float(value), "unit": p.unit}
            for p, value in zip(effect.parameters, estimate.theta[indices], strict=True)
        ]
        effects.append({**effect.entry.to_dict(), **about})
    content = {
        "robot": robot.to_dict(),
        "links": _plain_links(robot, estimate.theta[model.rigid_indices]),
        "effects": effects,
        "method": estimate.method,
        "verdict": verdict_line(estimate),
        "provenance": dict(estimate.provenance),
    }
    if model.reference is not None:
        reference = model.reference[model.rigid_indices]
        content["reference_links"] = _plain_links(robot, reference)
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode(), ()


def _plain_links(robot: Robot, theta: Array) -> list[dict[str, Any]]:
    """Return mass, centre of mass and inertia about it of links with standard
    parameters theta (10 links,); the centre of a massless link is None."""
    links = []
    parts = inertia.barycentric_from_standard(theta.reshape(-1, 10))
    for k, (carrier, row) in enumerate(zip(robot.link_joints, parts, strict=False)):
        names = "ixx", "ixy", "iyy", "ixz", "iyz", "izz"
        moments = dict(zip(names, row[4:].tolist(), strict=True))
        plain: dict[str, Any] = {
            "link": k + 1,
            "joint": robot.tree[carrier].name,
            "mass_kg": float(row[0]),
        }
        plain["centre_of_mass_m"] = row[1:4].tolist() if row[0] else None
        plain["inertia_about_centre_of_mass_kg_m2"] = moments if row[0] else None
        links.append(plain)
    return links
