"""Take a model elsewhere: simulators, controllers, tables; :func:`export` is the verb."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.sources import as_estimate
from sdp_vs_penalty.export.c_header import make_c_header
from sdp_vs_penalty.export.content import Content, require_plausible
from sdp_vs_penalty.export.friction_table import make_friction_table
from sdp_vs_penalty.export.header import with_verdict
from sdp_vs_penalty.export.load import FRANKA, make_franka, make_set_payload
from sdp_vs_penalty.export.mjcf import make_mjcf
from sdp_vs_penalty.export.numpy_function import make_function
from sdp_vs_penalty.export.sdf import make_sdf
from sdp_vs_penalty.export.sidecar import make_sidecar
from sdp_vs_penalty.export.urdf import edit_urdf, make_urdf
from sdp_vs_penalty.export.usd import make_usd
from sdp_vs_penalty.files import write_bytes
from sdp_vs_penalty.robot.robot import Robot

#: What each suffix writes, for the command line's help.
FORMATS = {
    ".urdf": "URDF",
    ".xml": "MuJoCo's MJCF",
    ".json": "plain JSON",
    ".py": "NumPy function",
    ".h": "C header",
    ".csv": "friction table",
    ".sdf": "SDFormat",
    ".usda": "USD",
    ".script": "UR's payload",
}

_SIMULATORS: dict[str, Callable[[Robot, Content], bytes]] = {
    ".xml": make_mjcf,
    ".sdf": make_sdf,
    ".usda": make_usd,
}
#: Of the others what is written, and the effects that are lost.
_OTHERS: dict[str, Callable[[Estimate], tuple[bytes, tuple[str, ...]]]] = {
    ".json": lambda e: (make_sidecar(e), ()),
    ".py": lambda e: (make_function(e), ()),
    ".h": make_c_header,
    ".csv": make_friction_table,
}


def export(
    estimate: Estimate | str | Path,
    out: str | Path,
    urdf: str | Path | None = None,
    *,
    force: bool = False,
    flange: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[str, ...]:
    """Write a model in the format of the suffix: .urdf, .xml (MJCF), .json, .py (NumPy function), .h (C
    header with links, viscous and Coulomb friction, offset and rotor inertia), .csv (friction by
    velocity), .sdf, .usda (links and joints for Isaac Sim); a name that ends in .drake.urdf (with rotor
    inertias, which Drake reads); of a payload, endeffector-config.json (Franka) or .script (UR's
    set_target_payload).

    estimate : the model, or its model.json; out : the file to write.
    urdf : the user's own URDF file, whose inertials, damping and friction are replaced and whose every
        other byte is kept; for ``out`` with the suffix .urdf only. Other files with comments begin with
        the model's verdict.
    flange : where the flange lies in the last joint's frame [m], for a payload.
    force : a link whose mass lies farther out than its body reaches is exported all the same.
    Returns the effects that the format has no place for (they are in the .json and the .py).
    Raises InputError for another suffix, an inconsistent or implausible inertial, or a URDF of another
    robot.
    """
    estimate = as_estimate(estimate, "export(estimate=...)")
    out = Path(out)
    suffix = out.suffix.lower()
    if suffix not in FORMATS:
        known = ", ".join(f"{key} ({what})" for key, what in FORMATS.items())
        raise InputError("unknown suffix", f"choose one of {known}", out)
    if urdf is not None and suffix != ".urdf":
        raise InputError("an edited URDF must end in .urdf", "rename it, or leave the URDF out", out)
    if out.name.endswith(FRANKA) or suffix == ".script":
        made = (make_set_payload if suffix == ".script" else make_franka)(estimate, flange)
        write_bytes(out, with_verdict(made, suffix, estimate))
        return ()
    if suffix in _OTHERS:
        made, left_out = _OTHERS[suffix](estimate)
        write_bytes(out, with_verdict(made, suffix, estimate))
        return left_out
    content = Content.of(estimate)
    if not force:
        require_plausible(estimate)
    if suffix in _SIMULATORS:
        made = _SIMULATORS[suffix](estimate.robot, content)
        write_bytes(out, with_verdict(made, suffix, estimate))
        return content.left_out(armature=suffix == ".xml", friction=suffix != ".usda")
    drake = urdf is None and out.name.lower().endswith(".drake.urdf")
    if urdf is None:
        made = make_urdf(estimate.robot, content, drake)
        write_bytes(out, with_verdict(made, suffix, estimate))
    else:
        write_bytes(out, edit_urdf(urdf, estimate.robot, content))
    return content.left_out(armature=drake)
