"""The geometry of a URDF's links: points that enclose their shapes, their volume, and
self-collisions.

Collision shapes are read where they can be, else visual ones. Meshes are found beside
the file or in the packages that ROS knows. A link with a mesh that is missing or cannot
be read has no geometry; its body is then taken from other sources.
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
from sdp_vs_penalty.robot.mesh import read_mesh
from sdp_vs_penalty.robot.urdf import LARGEST_NUMBER as LARGEST_LENGTH
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
    """Shapes of a link."""

    #: (k, 3) points in the link's frame [m], whose convex hull holds the shapes.
    points: Array
    #: Volume of the shapes [m^3].
    volume: float


def link_geometry(
    path: str | Path, held: Mapping[str, float] | None = None
) -> list[Geometry | None]:
    """Return the shapes of a URDF's moving links, each with what is fixed to it.

    Parameters
    ----------
    held : mapping or None
        Positions [rad, m] of joints that count as fixed.

    Returns
    -------
    list of Geometry or None
        One entry a link; None where a link's shape is not fully known.

    Raises
    ------
    InputError
        The file is no URDF of a tree of joints.
    """
    out: list[Geometry | None] = []
    for parts in placed_links(path, held):
        with errors_located_in(path):
            shapes_of_parts = [_shapes(Path(path), link, at) for link, at in parts]
        shapes = [shape for part in shapes_of_parts for shape in part or []]
        cloud = np.concatenate([np.zeros((0, 3)), *(shape.points for shape in shapes)])
        is_known = len(cloud) and None not in shapes_of_parts
        out.append(
            Geometry(cloud, sum(shape.volume for shape in shapes)) if is_known else None
        )
    return out


def link_surfaces(path: str | Path) -> list[Array | None]:
    """Return the triangles of the moving links' visual meshes, for pictures.

    Returns
    -------
    list of (m, 3, 3) array or None
        Corners of m triangles in the frame of each link [m]; None where a link has no
        mesh that can be read.

    Raises
    ------
    InputError
        The file is no URDF of a tree of joints.
    """
    surfaces: list[Array | None] = []
    for parts in placed_links(path):
        with errors_located_in(path):
            found = [
                surface
                for link, at in parts
                for surface in _visual_surfaces(Path(path), link, at)
            ]
        surfaces.append(np.concatenate(found) if found else None)
    return surfaces


def _visual_surfaces(path: Path, link: Any, placement: Array) -> Iterator[Array]:
    """Yield the triangles (m, 3, 3) [m] of each visual mesh of a <link> element that
    can be read: m triangles, three corners, x y z. ``placement`` (4, 4) is the pose of
    the link."""
    for visual in link.findall("visual"):
        element = visual.find("geometry/mesh")
        if element is None:
            continue
        file = mesh_file(path, element.get("filename") or "")
        scale = _lengths(element, "scale", 3, "1 1 1")
        mesh = None if file is None else read_mesh(file, scale, triangles=True)
        if mesh is None or not len(mesh.triangles):
            continue
        pose = placement @ pose_of(visual)
        corners = mesh.vertices[mesh.triangles.astype(int)]
        yield corners @ pose[:3, :3].T + pose[:3, 3]


def self_collision(urdf: str | Path, n: int) -> Callable[[Array], bool] | None:
    """Return a function that tells whether a URDF's arm is free of self-collision.

    Neighbours, and pairs that touch in all of forty poses (shapes drawn too large), are
    left out. Pinocchio and coal compute the collisions.

    Parameters
    ----------
    n : int
        Number of joints of the robot.

    Returns
    -------
    callable or None
        Of poses (N, n) [rad, m], True if no pair touches in any; None if the file has
        no readable collision shapes, or another number of joints.
    """
    load_urdf(urdf)  # says in a sentence what is wrong with the file
    shapes = _collision_model(Path(urdf))
    if shapes is None or shapes[1].ngeoms < 2 or shapes[0].nq != n:
        return None
    _, geometry = shapes
    collisions = _Collisions(*shapes)
    collisions.leave_out_neighbours()
    collisions.leave_out_what_always_touches()
    return collisions.is_free if len(geometry.collisionPairs) else None


def _collision_model(urdf: Path) -> tuple[Any, Any] | None:
    """Return Pinocchio's model of a URDF and its collision geometry; None if the file
    has no shapes, or some that cannot be read.

    Pinocchio reads a copy of the URDF with simplified meshes, first in a child process,
    which a broken file can end.
    """
    from sdp_vs_penalty.robot._pinocchio import pin

    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "robot.urdf"
        if not _write_collision_copy(urdf, copy):
            return None
        try:
            # First in a child process, which may crash in place of this one.
            list(parse_isolated(collision_shapes, copy, library="coal"))
            model = pin.buildModelFromUrdf(str(copy))
            geometry = pin.buildGeomFromUrdf(
                model, str(copy), pin.GeometryType.COLLISION, package_dirs=[folder]
            )
        except (ParserEndedError, ValueError, RuntimeError):
            return None
    return model, geometry


class _Collisions:
    """Pairs of an arm's shapes that must not touch."""

    def __init__(self, model: Any, geometry: Any) -> None:
        """Take Pinocchio's model and collision geometry; at first all pairs of shapes
        count.
        """
        self._model = model
        self._geometry = geometry
        self._data = model.createData()
        geometry.addAllCollisionPairs()
        self._placed = geometry.createData()

    def is_free(self, poses: Array) -> bool:
        """Tell whether no pair of shapes touches at any of the poses (N, n) [rad, m]."""
        return not any(self._touch(q, stop_at_first=True) for q in poses)

    def leave_out_neighbours(self) -> None:
        """Remove pairs of shapes of one link, and of links that a joint connects."""
        joints = [shape.parentJoint for shape in self._geometry.geometryObjects]
        parents = self._model.parents
        for pair in list(self._geometry.collisionPairs):
            a = joints[pair.first]
            b = joints[pair.second]
            if a == b or parents[a] == b or parents[b] == a:
                self._geometry.removeCollisionPair(pair)
        self._placed = self._geometry.createData()

    def leave_out_what_always_touches(self) -> None:
        """Remove pairs of shapes that touch in all of forty random poses between the
        joint limits (at most half a turn to each side): their shapes are drawn too
        large."""
        lowest = np.maximum(self._model.lowerPositionLimit, -np.pi)
        highest = np.minimum(self._model.upperPositionLimit, np.pi)
        shape = (40, self._model.nq)
        pairs = list(self._geometry.collisionPairs)
        touches = []
        for q in np.random.default_rng(0).uniform(lowest, highest, shape):
            self._touch(q, stop_at_first=False)
            touches.append([r.isCollision() for r in self._placed.collisionResults])
        for k in np.flatnonzero(np.all(touches, axis=0)):
            self._geometry.removeCollisionPair(pairs[k])
        self._placed = self._geometry.createData()

    def _touch(self, q: Array, *, stop_at_first: bool) -> bool:
        """Tell whether any pair of shapes touches at q (n,) [rad, m]; with
        ``stop_at_first`` the check ends at the first such pair."""
        from sdp_vs_penalty.robot._pinocchio import pin

        return bool(
            pin.computeCollisions(
                self._model, self._data, self._geometry, self._placed, q, stop_at_first
            )
        )


def collision_shapes(path: str) -> Iterator[dict[str, Array]]:
    """Yield the number of collision shapes that Pinocchio finds in a URDF.

    It runs in a process of its own, which a broken file can end.
    """
    from sdp_vs_penalty.robot._pinocchio import pin

    kind = pin.GeometryType.COLLISION
    folder = str(Path(path).parent)
    model = pin.buildModelFromUrdf(path)
    geometry = pin.buildGeomFromUrdf(model, path, kind, package_dirs=[folder])
    yield {"count": np.array([float(geometry.ngeoms)])}


def _write_collision_copy(urdf: Path, copy: Path) -> bool:
    """Write a copy of a URDF with its collision meshes as .obj files beside it.

    Pinocchio then reads the triangles that we read. Returns False if a mesh cannot be
    read.
    """
    robot = parse_urdf(urdf)
    names = dict[str, str]()
    for element in robot.iterfind("link/collision/geometry/mesh"):
        name = element.get("filename") or ""
        if name not in names:
            file = mesh_file(urdf, name)
            mesh = None if file is None else read_mesh(file, np.ones(3), triangles=True)
            if mesh is None:
                return False
            names[name] = f"mesh{len(names)}.obj"
            lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
            faces = (mesh.triangles.astype(int) + 1).tolist()
            lines += [f"f {a} {b} {c}" for a, b, c in faces]
            (copy.parent / names[name]).write_text("\n".join(lines))
        element.set("filename", names[name])
    # Visual meshes are not needed.
    for link in robot.findall("link"):
        for element in link.findall("visual"):
            link.remove(element)
    copy.write_bytes(etree.tostring(robot))
    return True


def _shapes(path: Path, link: Any, placement: Array) -> list[Geometry] | None:
    """Return a <link>'s collision shapes, or else its visual ones, in its moving body's
    frame.

    ``placement`` (4, 4) is the link's pose in that frame. [] without shapes; None if
    some cannot be read.
    """
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
    """Return the shape of a <geometry> element about its origin.

    None for numbers that describe no shape, or a missing mesh.
    """
    shape = next(iter(geometry), None) if geometry is not None else None
    if shape is None:
        return None
    solid = _solid(path, shape)
    if solid is None or not len(solid.points) or not np.all(np.isfinite(solid.points)):
        return None
    return solid


def _solid(path: Path, shape: Any) -> Geometry | None:
    """Return points around a solid (box, sphere, cylinder, capsule or mesh) about its
    origin, and its volume [m^3].

    ``shape`` is the child of a <geometry> element. Corner points enclose the solid.
    None for another shape.
    """
    # (8, 3) corners of the cube from -1 to 1.
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    if shape.tag == "box":
        half = 0.5 * _lengths(shape, "size", 3)
        return Geometry(corners * half, float(8.0 * half.prod()))
    if shape.tag == "sphere":
        (radius,) = _lengths(shape, "radius", 1)
        return Geometry(corners * radius, 4.0 / 3.0 * np.pi * radius**3)
    if shape.tag in ("cylinder", "capsule"):
        return _cylinder(shape)
    if shape.tag == "mesh":
        scale = _lengths(shape, "scale", 3, "1 1 1")
        file = mesh_file(path, shape.get("filename") or "")
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
    return None


def _cylinder(shape: Any) -> Geometry:
    """Return a 16-sided prism around a cylinder or capsule, and the cylinder's volume
    [m^3].
    """
    (radius,) = _lengths(shape, "radius", 1)
    (length,) = _lengths(shape, "length", 1)
    end = 0.5 * length + (radius if shape.tag == "capsule" else 0.0)
    n_sides = 16
    angles = 2.0 * np.pi / n_sides * np.arange(n_sides)
    outer_radius = radius / np.cos(np.pi / n_sides)  # so that sides touch the cylinder
    x = outer_radius * np.cos(angles)
    y = outer_radius * np.sin(angles)
    rings = [np.column_stack([x, y, np.full(n_sides, z)]) for z in (end, -end)]
    return Geometry(np.concatenate(rings), np.pi * radius**2 * length)


def _lengths(shape: Any, attribute: str, count: int, default: str = "") -> Array:
    """Return (count,) numbers of an attribute, NaN if it does not hold as many.

    Raises InputError for a length beyond LARGEST_LENGTH.
    """
    values = numbers_of(shape.get(attribute, default), count)
    if np.any(np.abs(values) > LARGEST_LENGTH):
        text = shape.get(attribute)[:40]
        where = f"line {shape.sourceline}, <{shape.tag} {attribute}={text!r}>"
        problem = f"a length beyond {LARGEST_LENGTH:g} m"
        raise InputError(f"{where} has {problem}", "correct the file")
    return values


def mesh_file(path: Path, filename: str) -> Path | None:
    """Return the path of a mesh file, None if there is none.

    Parameters
    ----------
    filename : str
        The mesh, as that file names it.
    """
    for place in _places(path, filename):
        # os.path.isfile: False also for a name that is too long or holds a zero byte.
        if os.path.isfile(place):
            return place
    return None


def _places(path: Path, filename: str) -> Iterator[Path]:
    """Yield where a mesh file may be: beside the URDF, or, for package://NAME/PATH, in
    a folder NAME above it or on ROS's search paths."""
    folder = path.resolve().parent
    if not filename.startswith(("package://", "model://")):
        yield folder / filename.removeprefix("file://")
        return
    package, _, path_in_package = filename.partition("://")[2].partition("/")
    for above in package_folders(path):
        if above.name == package:
            yield above / path_in_package
        yield above / package / path_in_package


def package_folders(path: Path) -> Iterator[Path]:
    """Yield the folders in which packages of ROS may lie that a robot's file names.

    Yields
    ------
    Path
        The folders above it, then those on ROS's search paths.
    """
    yield from path.resolve().parents
    for variable, inside in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        for root in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            yield Path(root) / inside
