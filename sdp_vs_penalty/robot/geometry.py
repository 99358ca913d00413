"""The geometry of a URDF's links: points that enclose its shapes, their volume, and
what touches.

Collision shapes where they can be read, else visual ones. Meshes are found beside the
file or in the packages that ROS knows; a link of which one is missing or cannot be read
has no geometry, and its body is then taken from what else is known.
"""

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.files import LARGEST_TEXT, reading
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.urdf import (
    load_urdf,
    named,
    numbers_of,
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
        with named(path):
            found = [_shapes(Path(path), link, at) for link, at in parts]
        every = [shape for part in found for shape in part or []]
        cloud = np.concatenate([np.zeros((0, 3)), *(shape.points for shape in every)])
        known = len(cloud) and None not in found
        out.append(
            Geometry(cloud, sum(shape.volume for shape in every)) if known else None
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
    with reading(urdf, LARGEST_TEXT):
        model = pin.buildModelFromUrdf(str(urdf))
    try:
        shapes, folders = pin.GeometryType.COLLISION, [str(Path(urdf).parent)]
        geometry = pin.buildGeomFromUrdf(model, str(urdf), shapes, package_dirs=folders)
    except (ValueError, RuntimeError):
        return None
    if geometry.ngeoms < 2 or model.nq != n:
        return None
    geometry.addAllCollisionPairs()
    joints = [o.parentJoint for o in geometry.geometryObjects]
    for pair in list(geometry.collisionPairs):
        a, b = joints[pair.first], joints[pair.second]
        if a == b or model.parents[a] == b or model.parents[b] == a:
            geometry.removeCollisionPair(pair)
    data = model.createData()

    def touching(q: Array, placed: Any, first: bool) -> bool:
        return bool(pin.computeCollisions(model, data, geometry, placed, q, first))

    limits = (
        np.maximum(model.lowerPositionLimit, -np.pi),
        np.minimum(model.upperPositionLimit, np.pi),
    )
    pairs, touch, placed = list(geometry.collisionPairs), [], geometry.createData()
    for q in np.random.default_rng(0).uniform(*limits, (40, n)):
        touching(q, placed, False)
        touch.append([r.isCollision() for r in placed.collisionResults])
    for k in np.flatnonzero(np.all(touch, axis=0)):
        geometry.removeCollisionPair(pairs[k])
    placed, left = geometry.createData(), len(geometry.collisionPairs)
    return (
        (lambda q: not any(touching(row, placed, True) for row in q)) if left else None
    )


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
    made: Geometry | None = None
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    if shape is None:
        return None
    if shape.tag == "box":
        half = 0.5 * numbers_of(shape.get("size", ""), 3)
        made = Geometry(corners * half, float(8.0 * half.prod()))
    elif shape.tag == "sphere":
        (radius,) = numbers_of(shape.get("radius", ""), 1)
        made = Geometry(corners * radius, 4.0 / 3.0 * np.pi * radius**3)
    elif shape.tag in ("cylinder", "capsule"):
        radius, length = (
            x
            for name in ("radius", "length")
            for x in numbers_of(shape.get(name, ""), 1)
        )
        ends = 0.5 * length + (radius if shape.tag == "capsule" else 0.0)
        turn, outer = (
            np.pi / 8.0 * np.arange(16),
            radius / np.cos(np.pi / 16.0),
        )  # a prism around it
        circle = outer * np.cos(turn), outer * np.sin(turn)
        prism = [np.column_stack([*circle, np.full(16, z)]) for z in (ends, -ends)]
        made = Geometry(np.concatenate(prism), np.pi * radius**2 * length)
    elif shape.tag == "mesh":
        scale = numbers_of(shape.get("scale", "1 1 1"), 3)
        made = _mesh(path, shape.get("filename") or "", scale)
    known = made is not None and len(made.points) and np.all(np.isfinite(made.points))
    return made if known else None


def _mesh(path: Path, filename: str, scale: Array) -> Geometry | None:
    file = next((p for p in _places(path, filename) if p.is_file()), None)
    if file is None:
        return None
    try:
        import coal

        with reading(file, LARGEST_TEXT):
            model = coal.MeshLoader().load(str(file), scale)
            points = np.array(model.vertices(), float).reshape(-1, 3)
            volume = abs(float(model.computeVolume()))
    except (
        Exception
    ):  # a mesh is a help, not an input: whatever its reader says, the rest is enough
        return None
    extent = np.ptp(points, axis=0) if len(points) else np.zeros(3)
    # The volume of an open surface means nothing; a solid's is at most that of its box.
    return Geometry(points, volume if volume <= 1.001 * float(np.prod(extent)) else 0.0)


def _places(path: Path, filename: str) -> Iterator[Path]:
    """Where a mesh may be: beside the URDF, or in a package above it or on ROS's own
    paths."""
    folder = path.resolve().parent
    if not filename.startswith(("package://", "model://")):
        yield folder / filename.removeprefix("file://")
        return
    package, _, rest = filename.partition("://")[2].partition("/")
    for above in (folder, *folder.parents):
        if above.name == package:
            yield above / rest
        yield above / package / rest
    for variable, inside in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        for root in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            yield Path(root) / inside / package / rest
