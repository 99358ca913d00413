"""The geometry of a URDF's links: points that enclose its shapes, their volume, and
what touches.

Collision shapes where they can be read, else visual ones. Meshes are found beside the
file or in the packages that ROS knows; a link of which one is missing or cannot be read
has no geometry, and its body is then taken from what else is known.
"""

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.isolated import ParserEndedError, parse_isolated
from sdp_vs_penalty.robot.mesh import load_coal, read_mesh
from sdp_vs_penalty.robot.urdf import (
    LARGEST_NUMBER as LARGEST_LENGTH,
)
from sdp_vs_penalty.robot.urdf import (
    errors_located_in,
    load_urdf,
    numbers_of,
    parse_urdf,
    placed_links,
    pose_of,
)


@dataclass(frozen=True)
class Geometry:
    """points (k, 3) whose convex hull holds a link's shapes, in its frame [m]; volume
    of them [m^3]."""

    points: Array
    volume: float


def link_geometry(
    path: str | Path, held: Mapping[str, float] | None = None
) -> list[Geometry | None]:
    """Of each moving link of a URDF, with what is fixed to it; None where it is not
    known whole; held : joints that count as fixed where they stand [rad, m].

    Raises InputError for a file that is not a URDF of a tree of joints.
    """
    out: list[Geometry | None] = []
    for parts in placed_links(path, held):
        with errors_located_in(path):
            shapes_of_parts = [_shapes(Path(path), link, at) for link, at in parts]
        shapes = [shape for part in shapes_of_parts for shape in part or []]
        cloud = np.concatenate([np.zeros((0, 3)), *(shape.points for shape in shapes)])
        known = len(cloud) and None not in shapes_of_parts
        out.append(
            Geometry(cloud, sum(shape.volume for shape in shapes)) if known else None
        )
    return out


def self_collision(urdf: str | Path, n: int) -> Callable[[Array], bool] | None:
    """Whether a URDF's arm is free of itself at all of the poses (N, n), by Pinocchio
    and coal.

    Neighbours, and pairs that touch in every one of a few poses (shapes drawn too
    large), are left out. None where the file has no collision shapes that can be read,
    or other joints than n.
    """
    from sdp_vs_penalty.robot._pinocchio import pin

    load_urdf(urdf)  # says in a sentence what is wrong with the file
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "robot.urdf"
        if not _write_collision_copy(Path(urdf), copy):
            return None
        try:
            # Pinocchio has read it once where it may end the process.
            list(parse_isolated(collision_shapes, copy, prepare=load_coal))
            model = pin.buildModelFromUrdf(str(copy))
            geometry = pin.buildGeomFromUrdf(
                model, str(copy), pin.GeometryType.COLLISION, package_dirs=[folder]
            )
        except (ParserEndedError, ValueError, RuntimeError):
            return None
    if geometry.ngeoms < 2 or model.nq != n:
        return None
    geometry.addAllCollisionPairs()
    joints = [o.parentJoint for o in geometry.geometryObjects]
    for pair in list(geometry.collisionPairs):
        a = joints[pair.first]
        b = joints[pair.second]
        if a == b or model.parents[a] == b or model.parents[b] == a:
            geometry.removeCollisionPair(pair)
    data = model.createData()

    def touching(q: Array, placed: Any, first: bool) -> bool:
        return bool(pin.computeCollisions(model, data, geometry, placed, q, first))

    low = np.maximum(model.lowerPositionLimit, -np.pi)
    high = np.minimum(model.upperPositionLimit, np.pi)
    poses = np.random.default_rng(0).uniform(low, high, (40, n))
    pairs = list(geometry.collisionPairs)
    touch = []
    placed = geometry.createData()
    for q in poses:
        touching(q, placed, False)
        touch.append([r.isCollision() for r in placed.collisionResults])
    for k in np.flatnonzero(np.all(touch, axis=0)):
        geometry.removeCollisionPair(pairs[k])
    placed = geometry.createData()
    left = len(geometry.collisionPairs)
    return (
        (lambda q: not any(touching(row, placed, True) for row in q)) if left else None
    )


def collision_shapes(path: str) -> Iterator[dict[str, Array]]:
    """How many collision shapes Pinocchio finds in a URDF; a broken one can end this
    process."""
    from sdp_vs_penalty.robot._pinocchio import pin

    kind = pin.GeometryType.COLLISION
    folder = str(Path(path).parent)
    model = pin.buildModelFromUrdf(path)
    geometry = pin.buildGeomFromUrdf(model, path, kind, package_dirs=[folder])
    yield {"count": np.array([float(geometry.ngeoms)])}


def _write_collision_copy(urdf: Path, copy: Path) -> bool:
    """A URDF as we read it, whose meshes are files beside it with the triangles that we
    read; False where a collision mesh cannot be read."""
    robot = parse_urdf(urdf)
    names = dict[str, str]()
    for element in robot.iterfind("link/collision/geometry/mesh"):
        name = element.get("filename") or ""
        if name not in names:
            file = _mesh_file(urdf, name)
            mesh = None if file is None else read_mesh(file, np.ones(3), triangles=True)
            if mesh is None:
                return False
            names[name] = f"mesh{len(names)}.obj"
            lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
            faces = (mesh.triangles.astype(int) + 1).tolist()
            lines += [f"f {a} {b} {c}" for a, b, c in faces]
            (copy.parent / names[name]).write_text("\n".join(lines))
        element.set("filename", names[name])
    for link in robot.findall("link"):
        for element in link.findall("visual"):
            link.remove(element)
    copy.write_bytes(etree.tostring(robot))
    return True


def _shapes(path: Path, link: Any, placement: Array) -> list[Geometry] | None:
    """Of one <link> element: all its collision shapes, else all visual ones; None: some
    are missing."""
    elements = [link.findall(tag) for tag in ("collision", "visual")]
    for members in elements:
        shapes = [_shape(path, element.find("geometry")) for element in members]
        if shapes and None not in shapes:
            poses = [placement @ pose_of(element) for element in members]
            return [
                Geometry(shape.points @ pose[:3, :3].T + pose[:3, 3], shape.volume)
                for shape, pose in zip(shapes, poses, strict=True)
                if shape is not None
            ]
    return None if any(elements) else []


def _shape(path: Path, geometry: Any) -> Geometry | None:
    """One shape about its own origin; None for numbers that describe none, or a mesh
    that is missing."""
    shape = next(iter(geometry), None) if geometry is not None else None
    body_geometry: Geometry | None = None
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    if shape is None:
        return None
    if shape.tag == "box":
        half = 0.5 * _lengths(shape, "size", 3)
        body_geometry = Geometry(corners * half, float(8.0 * half.prod()))
    elif shape.tag == "sphere":
        (radius,) = _lengths(shape, "radius", 1)
        body_geometry = Geometry(corners * radius, 4.0 / 3.0 * np.pi * radius**3)
    elif shape.tag in ("cylinder", "capsule"):
        (radius,) = _lengths(shape, "radius", 1)
        (length,) = _lengths(shape, "length", 1)
        ends = 0.5 * length + (radius if shape.tag == "capsule" else 0.0)
        turn, outer = (
            np.pi / 8.0 * np.arange(16),
            radius / np.cos(np.pi / 16.0),
        )  # a prism around it
        circle = outer * np.cos(turn), outer * np.sin(turn)
        prism = [np.column_stack([*circle, np.full(16, z)]) for z in (ends, -ends)]
        body_geometry = Geometry(np.concatenate(prism), np.pi * radius**2 * length)
    elif shape.tag == "mesh":
        scale = _lengths(shape, "scale", 3, "1 1 1")
        body_geometry = _mesh(path, shape.get("filename") or "", scale)
    known = (
        body_geometry is not None
        and len(body_geometry.points)
        and np.all(np.isfinite(body_geometry.points))
    )
    return body_geometry if known else None


def _lengths(shape: Any, attribute: str, count: int, default: str = "") -> Array:
    """(count,) numbers of an attribute, NaN where it does not hold as many; InputError
    for one that is no robot's."""
    values = numbers_of(shape.get(attribute, default), count)
    if np.any(np.abs(values) > LARGEST_LENGTH):
        text = shape.get(attribute)[:40]
        where = f"line {shape.sourceline}, <{shape.tag} {attribute}={text!r}>"
        problem = f"a length beyond {LARGEST_LENGTH:g} m"
        raise InputError(f"{where} has {problem}", "correct the file")
    return values


def _mesh(path: Path, filename: str, scale: Array) -> Geometry | None:
    file = _mesh_file(path, filename)
    if file is None:
        return None
    mesh = read_mesh(file, scale)
    if mesh is None:
        return None
    points = mesh.vertices
    extent = np.ptp(points, axis=0) if len(points) else np.zeros(3)
    # The volume of an open surface means nothing; a solid's is at most that of its box.
    is_solid = mesh.volume <= 1.001 * float(np.prod(extent))
    return Geometry(points, mesh.volume if is_solid else 0.0)


def _mesh_file(path: Path, filename: str) -> Path | None:
    """Where a mesh lies; None where there is no such file, or its name is none."""
    # A name that is too long, or holds a zero byte, is no file's.
    return next((p for p in _places(path, filename) if os.path.isfile(p)), None)


def _places(path: Path, filename: str) -> Iterator[Path]:
    """Where a mesh may be: beside the URDF, or in a package above it or on ROS's own
    paths."""
    folder = path.resolve().parent
    if not filename.startswith(("package://", "model://")):
        yield folder / filename.removeprefix("file://")
        return
    package, _, path_in_package = filename.partition("://")[2].partition("/")
    for above in (folder, *folder.parents):
        if above.name == package:
            yield above / path_in_package
        yield above / package / path_in_package
    for variable, inside in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        for root in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            yield Path(root) / inside / package / path_in_package
