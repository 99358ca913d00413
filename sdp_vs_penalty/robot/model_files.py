"""Files of robots by what they are: URDF, xacro that is expanded first, MJCF; and the
names of the package robot_descriptions."""

import importlib
import re
import shlex
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import read_bytes


def is_mjcf(path: str | Path) -> bool:
    """Return whether a file is a MuJoCo model, by its outermost element.

    Parameters
    ----------
    path : path
        An XML file.

    Returns
    -------
    bool
        True for MJCF.
    """
    return re.search(rb"<mujoco[\s>/]", read_bytes(path)) is not None


def is_xacro(content: bytes) -> bool:
    """Return whether a file holds macros of xacro.

    Parameters
    ----------
    content : bytes
        Of an XML file.

    Returns
    -------
    bool
        True where it has to be expanded.
    """
    return re.search(rb"<xacro:[a-z]", content) is not None


def unexpanded(path: Path) -> InputError:
    """Return the error of a xacro file that is not expanded, with the command for it.

    Parameters
    ----------
    path : Path
        Of the xacro file.

    Returns
    -------
    InputError
        To be raised.
    """
    out = path.with_suffix("") if path.suffix == ".xacro" else path
    out = out.with_name(f"{out.stem}_expanded.urdf")
    command = f"xacro {shlex.quote(str(path))} > {shlex.quote(str(out))}"
    remedy = f"expand it with `{command}`, or pip install xacro"
    return InputError("a xacro file, which is no URDF yet", remedy, path)


@contextmanager
def expanded_robot(path: Path) -> Iterator[Path]:
    """Expand a xacro file into a URDF for the length of a block; a URDF stays as it is.

    Parameters
    ----------
    path : Path
        A URDF or xacro file.

    Yields
    ------
    Path
        The URDF.

    Raises
    ------
    InputError
        The package xacro is not installed, or refuses the file.
    """
    if not is_xacro(read_bytes(path)):
        yield path
        return
    try:
        import xacro
    except ImportError as error:
        raise unexpanded(path) from error
    try:
        text = xacro.process_file(str(path)).toxml()
    except Exception as error:
        what = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise InputError(
            f"xacro does not expand it ({what})", "correct it", path
        ) from error
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / f"{path.stem}.urdf"
        out.write_text(text, encoding="utf-8")
        yield out


def described_robot(name: str) -> Path:
    """Return the file of a robot of the package robot_descriptions, downloaded once.

    Parameters
    ----------
    name : str
        Such as "panda_description".

    Returns
    -------
    Path
        The URDF.

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
        found = importlib.import_module(f"robot_descriptions.{name}")
    except Exception as error:
        what = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise InputError(
            f"robot_descriptions has no robot {name!r} ({what})", "check its name"
        ) from error
    for kind in ("URDF_PATH", "MJCF_PATH", "XACRO_PATH"):
        if (path := getattr(found, kind, None)) is not None:
            return Path(path)
    raise InputError(f"robot_descriptions has no file of {name!r}", "name a URDF file")
