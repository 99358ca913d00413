"""Inverse dynamics as one C header without dependencies, for a controller's real-time
loop."""

import json
import re
from pathlib import Path
from string import Template

import numpy as np

from sdp_vs_penalty.effects import effect_in_words
from sdp_vs_penalty.effects.effect import SimulatorField
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.c_formulas import formulas, has_closed_form
from sdp_vs_penalty.exporters.content import Content, Options, moved_to_joints
from sdp_vs_penalty.exporters.held import left_out
from sdp_vs_penalty.exporters.interface import Written
from sdp_vs_penalty.robot.arrays import Array

ENDING = ".h"
FILE = "model.h"
ABOUT = "a C header without dependencies"

#: The header holds links and payload as arrays, all else as formulas.
HOLDS: frozenset[SimulatorField] = frozenset({"links", "payload", "formulas"})

#: @ stands for the robot's name, $word for an entry of :func:`write`.
_TEMPLATE = Path(__file__).parent / "c_header.h"


def write(estimate: Estimate, options: Options) -> Written:
    """Make a C header without dependencies that computes the inverse dynamics.

    This module is an :class:`ExportFormat`. Returns the file's bytes and the effects
    left out. Raises InputError for an inconsistent link, or joints that follow others.
    """
    robot = estimate.robot
    model = estimate.model
    if robot.mechanism is not None or model.gains is not None:
        raise InputError(
            "the header has no place for joints that follow others, or gains",
            "write .json",
        )
    # Refuses what no simulator or controller should be given.
    content = Content.from_estimate(estimate)
    omitted = left_out(estimate, HOLDS)
    lacking = dict.fromkeys((*options.identified_without, *omitted))
    # The robot's name as an identifier of C, where it can be one.
    name = re.sub(r"\W", "_", robot.name)
    if not (name and name.isascii() and not name[0].isdigit()):
        name = "robot"
    lines = [*_load_of_reference(estimate, name), *formulas(estimate)]
    # "@" in the template is the robot's name as a C identifier.
    template = Template(_TEMPLATE.read_text("utf-8").replace("@", name))
    # The parent of a joint on the base is n, an index beyond all joints.
    joints = robot.joints
    parents = [j.parent if j.parent >= 0 else robot.n for j in joints]
    text = template.substitute(
        robot=_comment(robot.name),
        method=_comment(estimate.method),
        joints=_comment(", ".join(robot.joint_names)),
        left=_comment(", ".join(map(effect_in_words, lacking)) or "nothing"),
        n=robot.n,
        parent=_braces(np.array(parents)),
        slides=_braces(np.array([int(j.kind == "prismatic") for j in joints])),
        origin=_braces(np.array([j.placement[:3, 3] for j in joints])),
        turned=_braces(np.array([j.placement[:3, :3] for j in joints])),
        axis=_braces(np.array([j.axis for j in joints])),
        **_link_arrays(content.links),
        # Gravity as an upward acceleration of the base.
        up=_braces(-np.array(robot.gravity, float)),
        formulas="\n".join(f"  {line}" for line in lines),
    )
    return text.encode(), omitted


def _link_arrays(links: Array) -> dict[str, str]:
    """Write mass, first moments and inertias of links (n, 10) as C arrays, by name."""
    # Entries xx, xy, yy, xz, yz, zz as a symmetric matrix.
    full_inertias = links[:, 4:][:, [[0, 1, 3], [1, 2, 4], [3, 4, 5]]]
    return {
        "mass": _braces(links[:, 0]),
        "first": _braces(links[:, 1:4]),
        "inertia": _braces(full_inertias),
    }


def _load_of_reference(estimate: Estimate, name: str) -> list[str]:
    """Return lines of C that set ``load`` (n,) to the torque of the links at which
    friction that depends on load was identified; none if no effect of the file reads it.

    These links are those of ``Model.reference`` (p,), the parameters of the model of that
    time, without the payload:
    :meth:`~sdp_vs_penalty.estimation.estimate.Estimate.predict` takes the same.

    name : prefix of the file's functions and constants.
    """
    model = estimate.model
    reads_load = any(
        effect.needs_links and has_closed_form(effect, estimate)
        for effect in model.effects
    )
    if not reads_load or model.reference is None:
        return []
    reference_links = model.reference[model.rigid_indices].reshape(-1, 10)
    arrays = _link_arrays(moved_to_joints(estimate.robot, reference_links))
    return [
        "/* what friction by load refers to: the links at which it was identified */",
        f"static const double load_mass[{name}_N] = {arrays['mass']};",
        f"static const double load_first[{name}_N][3] = {arrays['first']};",
        f"static const double load_inertia[{name}_N][3][3] = {arrays['inertia']};",
        f"{name}_links(q, dq, ddq, load_mass, load_first, load_inertia, load);",
    ]


def _braces(values: Array) -> str:
    """Write an array as C initialises it: {{1.0, 2.0}, {3.0, 4.0}}; zeros have no minus
    sign."""
    return (
        json.dumps((np.asarray(values) + 0).tolist())
        .replace("[", "{")
        .replace("]", "}")
    )


def _comment(text: str) -> str:
    """Replace characters of a text that could end the C comment it stands in."""
    return re.sub(r"[^\x20-\x7e]|\*/|/\*", "?", text)
