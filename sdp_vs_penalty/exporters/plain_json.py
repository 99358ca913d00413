"""The model as plain JSON: also the effects that a URDF or MJCF has no place for."""

import json

from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import Options, verdict_line
from sdp_vs_penalty.exporters.interface import Written
from sdp_vs_penalty.robot import inertia

ENDING = ".json"
FILE = "effects.json"
ABOUT = "every effect as plain JSON, with its equation"


def write(estimate: Estimate, options: Options) -> Written:
    """Make a JSON file with links in readable form, and every effect.

    It holds the robot, each link's mass, centre of mass and inertia about it, and each
    effect's equation, reference, constants, and parameters with values and units; then
    method, verdict and provenance. This module is an :class:`ExportFormat`. Returns the
    file's bytes; nothing is left out.
    """
    model = estimate.model
    robot = estimate.robot
    links = []
    if len(model.rigid_indices):
        parts = inertia.barycentric_from_standard(estimate.links)
        # A row is mass, centre of mass (3), inertia about it (6); a massless link
        # (row[0] = 0) has no centre.
        for k, (carrier, row) in enumerate(zip(robot.link_joints, parts, strict=True)):
            names = "ixx", "ixy", "iyy", "ixz", "iyz", "izz"
            moments = dict(zip(names, row[4:].tolist(), strict=True))
            plain = {
                "link": k + 1,
                "joint": robot.tree[carrier].name,
                "mass_kg": float(row[0]),
            }
            plain["centre_of_mass_m"] = row[1:4].tolist() if row[0] else None
            plain["inertia_about_centre_of_mass_kg_m2"] = moments if row[0] else None
            links.append(plain)
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
        "links": links,
        "effects": effects,
        "method": estimate.method,
        "verdict": verdict_line(estimate),
        "provenance": dict(estimate.provenance),
    }
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode(), ()
