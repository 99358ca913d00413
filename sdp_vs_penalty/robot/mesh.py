"""Triangles of a mesh file, read by assimp in a process of its own.

assimp opens what a mesh names (materials, textures, buffers) wherever it lies. It is
therefore handed a copy that names nothing: of an OBJ the lines of its geometry; of a
glTF its geometry with the buffers inside. Only formats whose suffix alone decides the
reader are read.
"""

import base64
import binascii
import json
import struct
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.files import LARGEST_TEXT, read_bytes
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.isolated import ParserEndedError, parse_isolated

#: What a glTF's geometry is made of.
_GLTF_PARTS = "asset", "scene", "scenes", "nodes", "meshes", "accessors", "bufferViews"


@dataclass(frozen=True)
class Mesh:
    """A surface of triangles."""

    #: (k, 3) vertices [m].
    vertices: Array
    #: (m, 3) rows of three vertices each; none where they were not asked for.
    triangles: Array
    #: Volume that they enclose [m^3]; meaningless where the surface is open.
    volume: float


def read_mesh(path: Path, scale: Array, *, triangles: bool = False) -> Mesh | None:
    """Read a mesh file: vertices, volume and, on demand, triangles.

    The file is copied without what is not geometry (materials, textures), and parsed in
    a child process, which a broken file can end.

    Parameters
    ----------
    path : Path
        An .stl, .obj, .dae, .gltf or .glb file, by its suffix.
    scale : (3,) array
        Factors of the coordinates x, y and z.
    triangles : bool
        Whether the mesh holds its triangles too.

    Returns
    -------
    Mesh or None
        Lengths [m] and volume [m^3]; None, with a warning, if the file cannot be read.
    """
    suffix = path.suffix.lower()
    try:
        if suffix not in _COPIES:
            raise ValueError(f"{suffix or 'no suffix'} is not read")
        text = _COPIES[suffix](path, read_bytes(path, LARGEST_TEXT))
        with tempfile.TemporaryDirectory() as folder:
            # The copy of a binary glTF is a text one.
            copy = Path(folder) / f"mesh{'.gltf' if suffix == '.glb' else suffix}"
            copy.write_bytes(text)
            factors = [float(x) for x in scale]
            (mesh,) = parse_isolated(mesh_of, copy, factors, triangles, library="coal")
    except (
        ArithmeticError,
        AttributeError,  # a part of a glTF that is of another type
        InputError,
        LookupError,
        MemoryError,
        OSError,
        ParserEndedError,
        RecursionError,
        TypeError,
        ValueError,
    ) as error:
        reason = error.what if isinstance(error, InputError) else error
        reason = "too much memory" if isinstance(error, MemoryError) else reason
        what = f"{path}: this mesh is left out ({str(reason)[:200]})"
        warnings.warn(what, Remark, stacklevel=2)
        return None
    return Mesh(mesh["vertices"], mesh["triangles"], abs(float(mesh["volume"][0])))


def mesh_of(
    path: str, scale: list[float], has_triangles: bool
) -> Iterator[dict[str, Array]]:
    """Yield vertices (k, 3), triangles (m, 3) and volume (1,) of a mesh file.

    It runs in a process of its own, which a broken file can end.
    """
    import coal

    try:
        model = coal.MeshLoader().load(path, np.array(scale))
    except (RuntimeError, ValueError) as error:
        remedy = "export it as STL"
        raise InputError("assimp cannot read it", remedy, path) from error
    n_triangles = model.num_tris if has_triangles else 0
    triangles = (model.tri_indices(k) for k in range(n_triangles))
    corners = [[triangle[k] for k in range(3)] for triangle in triangles]
    yield {
        "vertices": np.array(model.vertices(), float).reshape(-1, 3),
        "triangles": np.array(corners, float).reshape(-1, 3),
        "volume": np.array([float(model.computeVolume())]),
    }


def _as_it_is(_: Path, content: bytes) -> bytes:
    """Return a file's content unchanged."""
    return content


def _obj_geometry(_: Path, content: bytes) -> bytes:
    """Return the lines of an .obj file with vertices and faces, and their continuation
    lines.
    """
    lines = content.replace(b"\0", b"\n").replace(b"\f", b"\n").splitlines()
    geometry = tuple(b"v f 0 1 2 3 4 5 6 7 8 9 + - . \\".split())
    return b"\n".join(x for x in lines if x.lstrip().startswith(geometry))


def _gltf_geometry(path: Path, content: bytes) -> bytes:
    """Return a glTF without materials and textures, with its buffers inside.

    Raises LookupError, TypeError or ValueError for another content, and InputError for
    a buffer that cannot be read or lies outside of the mesh's folder.
    """
    embedded = b""
    # Binary glTF: a header of 12 bytes; the length and kind (8 bytes) of the JSON and
    # its text; then length and kind (8 bytes) of the buffer and its bytes.
    if content[:4] == b"glTF":
        n_json = struct.unpack_from("<I", content, 12)[0]
        embedded = content[20 + n_json + 8 :]
        content = content[20 : 20 + n_json]
    document = json.loads(content)
    if not isinstance(document, dict):
        raise TypeError("no JSON object")
    geometry = {name: document[name] for name in _GLTF_PARTS if name in document}
    for mesh in geometry.get("meshes", []):
        mesh["primitives"] = [
            {k: x for k, x in part.items() if k in ("attributes", "indices", "mode")}
            for part in mesh["primitives"]
        ]
    buffers = [
        _buffer(path, buffer.get("uri"), embedded) for buffer in document["buffers"]
    ]
    head = "data:application/octet-stream;base64,"
    geometry["buffers"] = [
        {"byteLength": len(x), "uri": head + base64.b64encode(x).decode()}
        for x in buffers
    ]
    return json.dumps(geometry).encode()


def _buffer(path: Path, uri: Any, inside: bytes) -> bytes:
    """Return the bytes of a glTF buffer: inside the file, in its URI, or in a file
    beside it.

    Raises InputError for a file outside of the mesh's folder.
    """
    if uri is None:
        return inside
    if uri.startswith("data:"):
        try:
            return base64.b64decode(uri.partition(",")[2], validate=True)
        except binascii.Error as error:
            raise ValueError(f"a buffer: {error}") from error
    folder = path.resolve().parent
    place = (folder / uri).resolve()
    if not place.is_relative_to(folder):
        raise InputError(
            f"the buffer {uri!r} lies elsewhere", "keep it in the mesh's folder", path
        )
    return read_bytes(place, LARGEST_TEXT)


#: How the copy of a mesh file for assimp is made, by its suffix.
_COPIES: dict[str, Callable[[Path, bytes], bytes]] = {
    ".3ds": _as_it_is,
    ".dae": _as_it_is,
    ".fbx": _as_it_is,
    ".glb": _gltf_geometry,
    ".gltf": _gltf_geometry,
    ".obj": _obj_geometry,
    ".off": _as_it_is,
    ".ply": _as_it_is,
    ".stl": _as_it_is,
}
