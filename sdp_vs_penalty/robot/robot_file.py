"""The one door from a robot's file to the robot: URDF, xacro, SDF and MJCF.

xacro and SDF become a URDF in a temporary file, with the paths of meshes from the root,
so that everything behind reads URDF or MJCF.
"""

import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType

import numpy as np
from lxml import etree

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import read_bytes
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.geometry import (
    Geometry,
    link_geometry,
    mesh_file,
    package_folders,
)
from sdp_vs_penalty.robot.isolated import Arrays, ParserEndedError, parse_isolated
from sdp_vs_penalty.robot.model_files import format_of, unexpanded
from sdp_vs_penalty.robot.robot import STANDARD_GRAVITY, Robot
from sdp_vs_penalty.robot.sdf import urdf_of_sdf
from sdp_vs_penalty.robot.urdf import couplings_left_out, load_urdf, parse_urdf

#: Size of a file for which a macro language may take 1 GB of memory.
_N_BYTES = 2**24


@dataclass(frozen=True)
class RobotFile:
    """What a robot's file states."""

    #: The robot's joints and gravity.
    robot: Robot
    #: (links, 10) standard parameters about the link frames; zeros where it has none.
    links: Array
    #: Shapes of the links; None for a format whose shapes are not read.
    geometry: Sequence[Geometry | None] | None = None
    #: Parameters of the joints by name, such as f_v1 [N m s/rad].
    values: Mapping[str, float] = field(default_factory=dict)
    #: Which couplings of links beside the tree of joints are left out; "" for none.
    couplings: str = ""


def load_robot(
    path: str | Path,
    gravity: Sequence[float] | None = None,
    held: Mapping[str, float] | None = None,
) -> RobotFile:
    """Read the robot of a URDF, xacro, SDF or MJCF file.

    Parameters
    ----------
    gravity : (3,) sequence of float, optional
        Gravity in the base frame [m/s^2]; default: an MJCF file's, else 9.81 downwards.
    held : mapping of str to float, optional
        Joints that stand still, and their positions [rad, m].

    Returns
    -------
    RobotFile
        Robot, links, and what else the file states.

    Raises
    ------
    InputError
        The file is none of these, or its joints are no tree.
    """
    if format_of(read_bytes(path)) == "mjcf":
        from sdp_vs_penalty.robot.mjcf import load_mjcf

        robot, links, values, couplings = load_mjcf(path, gravity, held)
        return RobotFile(robot, links, values=values, couplings=couplings)
    down = STANDARD_GRAVITY if gravity is None else gravity
    with as_urdf(Path(path)) as file:
        robot, links = load_urdf(file, down, held)
        geometry = link_geometry(file, held)
        has_lines = file == Path(path)
        couplings = couplings_left_out(parse_urdf(file), has_lines=has_lines)
        return RobotFile(robot, links, geometry, couplings=couplings)


@contextmanager
def as_urdf(path: Path) -> Iterator[Path]:
    """Turn a xacro or SDF file into a URDF for the length of a block; other files stay
    as they are.

    Yields
    ------
    Path
        The URDF. Errors of the block name the file that the user has.

    Raises
    ------
    InputError
        The package xacro is not installed, or refuses the file; the SDF holds no single
        model.
    """
    kind = format_of(read_bytes(path))
    if kind not in ("xacro", "sdf"):
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / f"{path.stem}.urdf"
        try:
            if kind == "xacro":
                out.write_bytes(_expanded(path))
                root = parse_urdf(out)
            else:
                root = urdf_of_sdf(parse_urdf(path))
            for mesh in root.iter("mesh"):
                file = mesh_file(path, mesh.get("filename") or "")
                if file is not None:
                    mesh.set("filename", str(file.absolute()))
            etree.indent(root)
            out.write_bytes(etree.tostring(root))
            yield out
        except InputError as error:
            where = str(path if error.where is None else error.where)
            raise type(error)(
                error.what, error.remedy, where.replace(str(out), str(path))
            ) from error


def _expanded(path: Path) -> bytes:
    """Return the URDF of a xacro file, expanded in a child process.

    Raises InputError if the package xacro is not installed, or refuses the file.
    """
    try:
        import xacro  # noqa: F401
    except ImportError as error:
        raise unexpanded(path) from error
    try:
        parts = parse_isolated(
            expanded_text,
            path.absolute(),
            [str(folder) for folder in package_folders(path)],
            library="xacro",
            n_bytes=_N_BYTES,
        )
        return b"".join(part["text"].astype(np.uint8).tobytes() for part in parts)
    except (ParserEndedError, MemoryError) as error:
        what = str(error) or "too much memory"
        raise InputError(
            f"xacro does not expand it ({what})", "correct it", path
        ) from error


def expanded_text(path: str, folders: list[str]) -> Iterator[Arrays]:
    """Yield the bytes of an expanded xacro file as numbers.

    It runs in a child process, since macros can loop and grow.

    Parameters
    ----------
    folders : list of str
        Where packages of ROS may lie that "$(find NAME)" names.
    """
    import xacro

    try:
        import ament_index_python.packages  # type: ignore[import-not-found]  # noqa: F401
    except ImportError:  # without ROS
        packages = ModuleType("ament_index_python.packages")
        packages.get_package_share_directory = (  # type: ignore[attr-defined]
            lambda name: _package(name, folders)
        )
        sys.modules["ament_index_python"] = ModuleType("ament_index_python")
        sys.modules["ament_index_python.packages"] = packages
    text = xacro.process_file(path).toxml().encode()
    yield {"text": np.frombuffer(text, np.uint8).astype(float)}


def _package(name: str, folders: Sequence[str]) -> str:
    """Return the folder of a package of ROS: one of its name in ``folders``, or one of
    these itself.

    Raises LookupError if there is none.
    """
    for folder in map(Path, folders):
        for place in (folder, folder / name):
            if place.name == name and place.is_dir():
                return str(place)
    raise LookupError(f"the package {name!r} is in no folder above it")
