"""Which format a robot's file has: URDF, xacro, MJCF or SDF; and the names of the
package robot_descriptions."""

import importlib
import re
import shlex
from importlib.util import find_spec
from pathlib import Path

from sdp_vs_penalty.errors import InputError, install_command

#: Comments, instructions and the document type: what may stand before the outermost
#: element, or hold tags that are none.
_NOT_ELEMENTS = re.compile(
    rb"<!--.*?-->|<\?.*?\?>|<!DOCTYPE[^>\[]*(\[.*?\])?\s*>", re.DOTALL
)
#: Endings of robots' files; the content of a file tells its format.
ROBOT_FILE_ENDINGS = (".urdf", ".xacro", ".sdf", ".xml", ".mjcf")
_FORMATS = {b"mujoco": "mjcf", b"sdf": "sdf", b"robot": "urdf"}


def format_of(content: bytes) -> str:
    """Return the format of a robot's file by its elements; comments do not count.

    Returns
    -------
    str
        "xacro" (macros that have to be expanded), "mjcf", "sdf", "urdf" or "".
    """
    elements = _NOT_ELEMENTS.sub(b"", content)
    if re.search(rb"<xacro:[a-z]", elements):
        return "xacro"
    outermost = re.match(rb"[^<]*<([\w:.-]+)", elements)
    return _FORMATS.get(outermost[1], "") if outermost else ""


def unexpanded(path: Path) -> InputError:
    """Return the error of a xacro file that is not expanded, with the command that
    expands it."""
    out = path.with_suffix("") if path.suffix == ".xacro" else path
    out = out.with_name(f"{out.stem}_expanded.urdf")
    remedy = (
        f"expand it with `xacro {shlex.quote(str(path))} > {shlex.quote(str(out))}`"
    )
    if find_spec("xacro") is None:
        remedy += f", or {install_command('formats')}"
    return InputError("a xacro file, which is no URDF yet", remedy, path)


def described_robot(name: str) -> Path:
    """Return the file of a robot of the package robot_descriptions, downloaded once.

    Raises
    ------
    InputError
        The package is not installed, or has no such robot.
    """
    try:
        importlib.import_module("robot_descriptions")
    except ImportError as error:
        remedy = "pip install robot_descriptions, or name a URDF file"
        what = f"problem {name!r} is a name of the package robot_descriptions"
        raise InputError(what, remedy) from error
    try:
        description = importlib.import_module(f"robot_descriptions.{name}")
    except Exception as error:
        what = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise InputError(
            f"robot_descriptions has no robot {name!r} ({what})", "check its name"
        ) from error
    for kind in ("URDF_PATH", "MJCF_PATH", "XACRO_PATH"):
        if (path := getattr(description, kind, None)) is not None:
            return Path(path)
    raise InputError(f"robot_descriptions has no file of {name!r}", "name a URDF file")
