"""Changes of a file that keep what its format is made of: elements, fields, records."""

import base64
import json
import struct
import xml.etree.ElementTree as ET

import numpy as np

#: What stands for a number, a name or a text.
ODD = ["1e300", "-1", "nan", "5e-324", "inf", "1,2", "0x10", "99999999999999999999"]
ODD_TOML = ["[]", "{}", "true", "1e400", "-0", "'x'", "[[1]]", "1979-05-27", "{a=1}"]
#: The first and last bytes of an MCAP file.
_MCAP = b"\x89MCAP0\r\n"


def change_structure(suffix: str, content: bytes, rng: np.random.Generator) -> bytes:
    """A file with one part lost, doubled, moved or replaced; as it was where it has no
    such parts."""
    try:
        if suffix in (".urdf", ".dae"):
            return _change_xml(content, rng)
        if suffix == ".toml":
            return _change_lines(content, rng)
        if suffix == ".mcap":
            return _change_records(content, rng)
    except (ET.ParseError, UnicodeDecodeError, ValueError, struct.error):
        pass
    return content


def _change_xml(content: bytes, rng: np.random.Generator) -> bytes:
    root = ET.fromstring(content)
    parents = [element for element in root.iter() if len(element)]
    parent = parents[int(rng.integers(len(parents)))]
    child = parent[int(rng.integers(len(parent)))]
    way = int(rng.integers(6))
    if way == 0:
        parent.remove(child)
    elif way == 1:
        parent.append(child)
    elif way == 2:  # a cycle would have no end: a copy
        target = parents[int(rng.integers(len(parents)))]
        target.append(ET.fromstring(ET.tostring(child)))
    elif way == 3:
        others = [element.tag for element in root.iter()]
        child.tag = others[int(rng.integers(len(others)))]
    elif child.attrib:
        names = list(child.attrib)
        name = names[int(rng.integers(len(names)))]
        if way == 4:
            del child.attrib[name]
        else:
            values = [*ODD, *(x for e in root.iter() for x in e.attrib.values())]
            child.attrib[name] = values[int(rng.integers(len(values)))]
    return ET.tostring(root)


def _change_lines(content: bytes, rng: np.random.Generator) -> bytes:
    lines = content.decode().splitlines()
    k = int(rng.integers(len(lines)))
    way = int(rng.integers(4))
    if way == 0:
        del lines[k]
    elif way == 1:
        lines.insert(k, lines[int(rng.integers(len(lines)))])
    elif "=" in lines[k]:
        values = ODD_TOML if way == 2 else ODD
        name = lines[k].partition("=")[0]
        lines[k] = f"{name}= {values[int(rng.integers(len(values)))]}"
    return "\n".join(lines).encode()


def _change_records(content: bytes, rng: np.random.Generator) -> bytes:
    """One record (opcode, length, content) of an MCAP lost, doubled, cut or swapped."""
    records = list[bytes]()
    place = len(_MCAP)
    while place + 9 <= len(content) - len(_MCAP):
        (size,) = struct.unpack_from("<Q", content, place + 1)
        records.append(content[place : place + 9 + size])
        place += 9 + size
    if not records:
        return content
    k = int(rng.integers(len(records)))
    way = int(rng.integers(5))
    if way == 0:
        del records[k]
    elif way == 1:
        records.insert(k, records[k])
    elif way == 2:
        records[k] = records[k][: int(rng.integers(len(records[k]) + 1))]
    elif way == 3:
        other = int(rng.integers(len(records)))
        records[k], records[other] = records[other], records[k]
    else:
        size = int(rng.integers(2**63))
        records[k] = records[k][:1] + struct.pack("<Q", size) + records[k][9:]
    return _MCAP + b"".join(records) + _MCAP


def sound_meshes() -> dict[str, bytes]:
    """One triangle in every format of meshes, by the suffix."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
    text = base64.b64encode(corners.tobytes()).decode()
    buffer = {"byteLength": 36, "uri": f"data:application/octet-stream;base64,{text}"}
    accessor = {"componentType": 5126, "count": 3, "type": "VEC3", "bufferView": 0}
    gltf = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [accessor],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [buffer],
    }
    stl = b"\0" * 80 + struct.pack("<I", 1) + np.zeros(3, "<f4").tobytes()
    ply = (
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\n"
        "end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    return {
        ".obj": b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        ".stl": stl + corners.tobytes() + b"\0\0",
        ".ply": ply.encode(),
        ".off": b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
        ".gltf": json.dumps(gltf).encode(),
    }
