"""A URDF for Drake: its own tags carry the rotors' inertias."""

from __future__ import annotations

from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters import urdf
from sdp_vs_penalty.exporters.content import Content, Options

ENDING, FILE, ABOUT = ".drake.urdf", "robot.drake.urdf", "for Drake, with rotor inertias"
EDITS = True


def write(estimate: Estimate, options: Options) -> tuple[bytes, tuple[str, ...]]:
    """A URDF with a transmission a joint. A user's own file is edited as a plain one."""
    if options.urdf is not None:
        return urdf.write(estimate, options)
    content = Content.plausible(estimate, options)
    return urdf.make_urdf(estimate.robot, content, drake=True), content.left_out(armature=True)
