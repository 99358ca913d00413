"""Changes of a file that keep what its format is made of: elements, fields, records."""

import base64
import io
import json
import sqlite3
import struct
import xml.etree.ElementTree as ET
import zipfile
import zlib

import numpy as np
from hostile_names import hostile_names

#: What stands for a number, a name or a text.
ODD = ["1e300", "-1", "nan", "5e-324", "inf", "1,2", "0x10", "99999999999999999999"]
ODD_TOML = ["[]", "{}", "true", "1e400", "-0", "'x'", "[[1]]", "1979-05-27", "{a=1}"]
#: Values of a JSON field, of every type.
ODD_JSON = [
    None,
    True,
    -3,
    10**400,
    float("nan"),
    0.5,
    1e300,
    5e-324,
    "x",
    "\x1b[2J\n",
    [],
    [0.0],
    [[1e308]],
    {},
    {"a": 1},
]
#: Bytes that an archive may unpack to, to be changed by its arrays.
LARGEST_ARCHIVE = 10_000_000
#: The first and last bytes of an MCAP file.
_MCAP = b"\x89MCAP0\r\n"


def change_structure(suffix, content, rng):
    """A file with one part lost, doubled, moved or replaced; as it was where it has no
    such parts."""
    change = _CHANGES.get(suffix)
    if change is None:
        return content
    try:
        return change(content, rng)
    except _UNCHANGED:
        return content


#: What a file raises that is no longer of its format.
_UNCHANGED = (
    ET.ParseError,
    EOFError,
    LookupError,
    MemoryError,
    NotImplementedError,
    OSError,
    OverflowError,
    RecursionError,
    TypeError,
    ValueError,
    sqlite3.Error,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


def pick(items, rng):
    """One of some items."""
    return items[int(rng.integers(len(items)))]


def odd_name(rng):
    """A hostile name that a column, a field or a link may have."""
    return next(hostile_names(1, of_files=False, seed=int(rng.integers(10**6))))


def _change_xml(content, rng):
    root = ET.fromstring(content)
    parents = [element for element in root.iter() if len(element)]
    parent = pick(parents, rng)
    child = pick(parent, rng)
    way = int(rng.integers(7))
    if way == 0:
        parent.remove(child)
    elif way == 1:
        parent.append(child)
    elif way == 2:  # a cycle would have no end: a copy
        target = pick(parents, rng)
        target.append(ET.fromstring(ET.tostring(child)))
    elif way == 3:
        child.tag = pick([element.tag for element in root.iter()], rng)
    elif child.attrib:
        name = pick(list(child.attrib), rng)
        if way == 4:
            del child.attrib[name]
        elif way == 5:
            child.attrib[name] = odd_name(rng)
        else:
            others = [value for e in root.iter() for value in e.attrib.values()]
            child.attrib[name] = pick([*ODD, *others], rng)
    return ET.tostring(root)


def _change_toml(content, rng):
    lines = content.decode().splitlines()
    k = int(rng.integers(len(lines)))
    way = int(rng.integers(5))
    if way == 0:
        del lines[k]
    elif way == 1:
        lines.insert(k, pick(lines, rng))
    elif "=" in lines[k]:
        name = lines[k].partition("=")[0]
        value = pick(ODD_TOML if way == 2 else ODD, rng)
        if way == 4:
            value = json.dumps(odd_name(rng))
        lines[k] = f"{name}= {value}"
    return "\n".join(lines).encode()


def _change_lines(content, rng):
    """A line of a text lost, doubled or moved, or one of its words replaced."""
    lines = content.decode("latin-1").splitlines()
    k = int(rng.integers(len(lines)))
    way = int(rng.integers(5))
    if way == 0:
        del lines[k]
    elif way == 1:
        lines.insert(k, lines[k])
    elif way == 2:
        lines.insert(k, lines.pop(int(rng.integers(len(lines)))))
    else:
        words = lines[k].split() or [""]
        words[int(rng.integers(len(words)))] = pick(ODD, rng)
        lines[k] = " ".join(words)
    return "\n".join(lines).encode("latin-1")


def _change_csv(content, rng):
    """A table with another header, other columns, another separator or encoding."""
    rows = [line.split(",") for line in content.decode().splitlines()]
    k = int(rng.integers(len(rows[0])))
    row = int(rng.integers(len(rows)))
    way = int(rng.integers(12))
    if way == 0:
        rows[0][k] = odd_name(rng)
    elif way == 1:
        rows[0][k] = pick(rows[0], rng)
    elif way == 2:
        rows = [cells[:k] + cells[k + 1 :] for cells in rows]
    elif way == 3:
        rows = [[*cells, cells[min(k, len(cells) - 1)]] for cells in rows]
    elif way == 4:
        rows.insert(row, rows[0])
    elif way == 5:
        rows[row] = rows[row][: k + 1]
    elif way == 6:
        rows[row][k] = pick([*ODD, "", '"', "\0", "1.5e", "9" * 5000], rng)
    elif way == 7:
        rows = [[cell.replace(".", ",") for cell in cells] for cells in rows]
    elif way == 8:
        rows.insert(1, [pick(("[rad]", "s", "N m", ""), rng) for _ in rows[0]])
    separator = pick((";", "\t", " ", "|"), rng) if way in (7, 9) else ","
    end = "\r\n" if way == 10 else "\n"
    text = end.join(separator.join(cells) for cells in rows)
    encoding = pick(("utf-16", "utf-8-sig", "latin-1"), rng) if way == 11 else "utf-8"
    return text.encode(encoding, "replace")


def _change_json(content, rng):
    """A field lost, doubled, renamed, exchanged with another one or replaced; another
    format."""
    document = json.loads(content)
    inner, place = _random_place(document, rng)
    way = int(rng.integers(8))
    if way == 0:
        del inner[place]
    elif way == 1 and isinstance(inner, dict):
        return _double_field(document, inner, place)
    elif way == 2:
        other = pick(list(inner) if isinstance(inner, dict) else range(len(inner)), rng)
        inner[place], inner[other] = inner[other], inner[place]
    elif way == 3 and isinstance(inner, dict):
        inner[odd_name(rng)] = inner.pop(place)
    elif way == 4 and isinstance(document, dict):
        versions = (-1, 0, 1, 3, 99, 2.0, "2", None, "sdp-vs-penalty proof 1")
        document["format"] = pick(versions, rng)
    elif way == 5 and isinstance(inner, list):
        inner.extend(inner[: int(rng.integers(len(inner) + 1))])
    elif way == 6:
        depth = int(rng.integers(1, 1500))
        return json.dumps(document).replace("[", "[" * depth, 1).encode()
    else:
        inner[place] = pick(ODD_JSON, rng)
    return json.dumps(document).encode()


def _random_place(document, rng):
    """A container of a document that is not empty, and a place in it."""
    inner = document
    while True:
        places = list(inner) if isinstance(inner, dict) else range(len(inner))
        place = pick(places, rng)
        is_leaf = not isinstance(inner[place], dict | list) or not inner[place]
        if is_leaf or rng.random() < 0.15:
            return inner, place
        inner = inner[place]


def _double_field(document, inner, place):
    """The text of a document in which a field comes twice, with two values."""
    mark = "doubled-field"
    inner[mark] = inner[place]
    return json.dumps(document).replace(mark, place).encode()


def _change_archive(content, rng):
    """An array of an .npz lost, renamed, of another type or shape, or with odd
    numbers."""
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
        if sum(member.file_size for member in packed.infolist()) > LARGEST_ARCHIVE:
            return content
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        arrays = dict(archive)
    name = pick(list(arrays), rng)
    array = arrays[name]
    way = int(rng.integers(8))
    if way == 0:
        del arrays[name]
    elif way == 1:
        arrays[odd_name(rng).replace("/", "")] = arrays.pop(name)
    elif way == 2:
        kinds = ("f2", "i1", "u8", "c16", "?", "g", "S8", "U4", "M8[s]", ">f8")
        with np.errstate(all="ignore"):
            arrays[name] = array.astype(pick(kinds, rng))
    elif way == 3:
        shapes = (array.T, array.ravel(), array[None], array[..., None], array[:0])
        arrays[name] = pick(shapes, rng)
    elif way == 4:
        arrays[name] = array[: int(rng.integers(len(array)))]
    elif way == 5:
        arrays[name] = np.full(array.shape, float(pick(("1e300", "nan", "-0"), rng)))
    elif way == 6:
        other = pick(list(arrays), rng)
        arrays[name], arrays[other] = arrays[other], arrays[name]
    else:
        arrays[name] = np.float64(3.0)
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def _change_database(content, rng):
    """A message, a topic or a table of a ROS 2 bag changed."""
    with sqlite3.connect(":memory:") as bag:
        bag.deserialize(content)
        rows = bag.execute("SELECT id, data FROM messages").fetchall()
        number, data = pick(rows, rng)
        place = int(rng.integers(len(data)))
        changed = data[:place] + bytes([int(rng.integers(256))]) + data[place + 1 :]
        statements = [
            ("UPDATE messages SET data = ? WHERE id = ?", (changed, number)),
            ("UPDATE messages SET data = ? WHERE id = ?", (data[:place], number)),
            ("UPDATE messages SET data = NULL WHERE id = ?", (number,)),
            ("UPDATE messages SET timestamp = ? WHERE id = ?", (-(2**63), number)),
            ("UPDATE messages SET topic_id = 99 WHERE id = ?", (number,)),
            ("DELETE FROM messages WHERE id >= ?", (number,)),
            ("DELETE FROM topics", ()),
            ("UPDATE topics SET name = ?", (odd_name(rng),)),
            ("UPDATE topics SET type = ?", (odd_name(rng),)),
            ("UPDATE topics SET serialization_format = 'x'", ()),
            ("DROP TABLE messages", ()),
        ]
        bag.execute(*pick(statements, rng))
        bag.commit()
        return bytes(bag.serialize())


def _change_records(content, rng):
    """One record (opcode, length, content) of an MCAP lost, doubled, cut or swapped."""
    records = []
    place = len(_MCAP)
    while place + 9 <= len(content) - len(_MCAP):
        (size,) = struct.unpack_from("<Q", content, place + 1)
        records.append(content[place : place + 9 + size])
        place += 9 + size
    if not records:
        return content
    k = int(rng.integers(len(records)))
    way = int(rng.integers(7))
    if way == 0:
        del records[k]
    elif way == 1:
        records.insert(k, records[k])
    elif way == 2:
        records[k] = records[k][: int(rng.integers(len(records[k]) + 1))]
    elif way == 3:
        other = int(rng.integers(len(records)))
        records[k], records[other] = records[other], records[k]
    elif way == 4:
        size = int(rng.integers(2**63))
        records[k] = records[k][:1] + struct.pack("<Q", size) + records[k][9:]
    elif way == 5:
        records[k] = bytes([int(rng.integers(256))]) + records[k][1:]
    else:  # as a recorder leaves it that is killed: no summary, no end
        return _MCAP + b"".join(records[:k])
    return _MCAP + b"".join(records) + _MCAP


_CHANGES = {
    ".csv": _change_csv,
    ".dae": _change_xml,
    ".db3": _change_database,
    ".gltf": _change_json,
    ".json": _change_json,
    ".mcap": _change_records,
    ".npz": _change_archive,
    ".obj": _change_lines,
    ".off": _change_lines,
    ".ply": _change_lines,
    ".solution": _change_lines,
    ".toml": _change_toml,
    ".txt": _change_lines,
    ".urdf": _change_xml,
}


def sound_meshes():
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
