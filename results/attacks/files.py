"""Attacks by what files hold: bytes and structure of logs, robots and models."""

import json
import os
import re
from pathlib import Path

from hostile_names import hostile_names
from mutations import ODD, change_structure, odd_name, pick, sound_meshes

from attacks.attack import Attack, Kind, Rng

URDF = """<robot name="r"><link name="b"/><link name="l"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial><collision>
<geometry>{shape}</geometry></collision></link><joint name="j" type="continuous">
<parent link="b"/><child link="l"/><axis xyz="0 1 0"/></joint></robot>"""
#: Robots of other shapes.
URDFS = sorted((Path(__file__).parents[2] / "tests").rglob("*.urdf"))
#: What is done with a log, by its name.
VERBS_OF_LOGS = (
    "check two_link --data {}",
    "convert {} --out out.csv",
    "identify two_link --data {} --method ols --out out.json",
)


def command(words: str) -> Attack:
    """An attack by the words of a command alone."""
    return Attack(words.split())


def damaged(content: bytes, rng: Rng) -> bytes:
    """One to four bytes changed, a part cut, doubled or lost."""
    if not content:
        return b"\0"
    begin, end = sorted(rng.integers(len(content), size=2).tolist())
    way = int(rng.integers(4))
    if way == 0:
        changed = bytearray(content)
        for k in rng.integers(len(changed), size=int(rng.integers(1, 5))).tolist():
            changed[k] = int(rng.integers(256))
        return bytes(changed)
    parts = {1: content[:begin], 2: content[:end] + content[begin:]}
    return parts.get(way, content[:begin] + content[end:])


def change_file(path: Path, rng: Rng) -> None:
    """Change the parts of a file's format, or its bytes where that changes nothing."""
    content = path.read_bytes()
    structured = change_structure(path.suffix, content, rng)
    is_plain = structured == content or rng.random() < 0.4
    path.write_bytes(damaged(content, rng) if is_plain else structured)


def log(suffix: str) -> Kind:
    """A changed log of a format, in a verb that reads logs."""

    def attack(folder: Path, rng: Rng) -> Attack:
        change_file(folder / f"run{suffix}", rng)
        return command(pick(VERBS_OF_LOGS, rng).format(f"run{suffix}"))

    return attack


def document(name: str, *commands: str) -> Kind:
    """A changed document, in one of some commands."""

    def attack(folder: Path, rng: Rng) -> Attack:
        change_file(folder / name, rng)
        return command(pick(commands, rng))

    return attack


def mesh(folder: Path, rng: Rng) -> Attack:
    """A changed mesh, which a URDF names."""
    suffix = pick(list(sound_meshes()), rng)
    change_file(folder / f"mesh{suffix}", rng)
    return with_mesh(folder, f"mesh{suffix}")


def with_mesh(folder: Path, name: str) -> Attack:
    """A URDF that names a mesh, to be looked at."""
    shape = f'<mesh filename="{name}"/>'
    (folder / "arm.urdf").write_text(URDF.format(shape=shape))
    return command("check-urdf arm.urdf")


def deep_mesh(folder: Path, rng: Rng) -> Attack:
    """A mesh that nests without end, in one of the tags of its format."""
    tag = pick(("node", "Group", "scene", "a"), rng)
    depth = int(rng.integers(1000, 60_000))
    texts = {
        ".dae": f"<COLLADA><library_nodes>{f'<{tag}>' * depth}",
        ".x3d": f"<X3D><Scene>{f'<{tag}>' * depth}",
        ".gltf": '{"nodes":' + "[" * depth,
    }
    suffix = pick(list(texts), rng)
    (folder / f"mesh{suffix}").write_text(texts[suffix])
    return with_mesh(folder, f"mesh{suffix}")


def companion(folder: Path, rng: Rng) -> Attack:
    """A mesh that names a pipe or a device."""
    os.mkfifo(folder / "pipe")
    name = pick(("pipe", "/dev/zero", "/proc/self/mem"), rng)
    texts = {
        ".obj": f"mtllib {name}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        ".gltf": json.dumps({"asset": {"version": "2.0"}, "buffers": [{"uri": name}]}),
    }
    suffix = pick(list(texts), rng)
    (folder / f"mesh{suffix}").write_text(texts[suffix])
    return with_mesh(folder, f"mesh{suffix}")


def urdf(folder: Path, rng: Rng) -> Attack:
    """A URDF whose elements are changed in one to four places: an exported arm, or one
    of those with trees, sliders, fixed joints and meshes that the tests have."""
    path = folder / "arm.urdf"
    content = pick([path, *URDFS], rng).read_bytes()
    for _ in range(int(rng.integers(1, 5))):
        content = change_structure(".urdf", content, rng)
    path.write_bytes(content)
    is_simulated = rng.random() < 0.25
    return command(
        "simulate arm.urdf --out runs" if is_simulated else "check-urdf arm.urdf"
    )


def numbers(folder: Path, rng: Rng) -> Attack:
    """A URDF with a number that no arm has."""
    odd = pick(ODD, rng)
    shapes = f'<sphere radius="{odd}"/>', f'<box size="1 {odd} 1"/>'
    text = URDF.format(shape=pick(shapes, rng))
    if rng.random() < 0.7:
        name = pick(("value", "ixx", "iyz", "xyz"), rng)
        text = re.sub(rf'{name}="[^"]*"', f'{name}="{odd}"', text, count=1)
    (folder / "arm.urdf").write_text(text)
    return command("check-urdf arm.urdf")


def problem(folder: Path, rng: Rng) -> Attack:
    """A changed problem under a hostile title."""
    home = folder / "mine"
    home.mkdir()
    content = (folder / "problem.toml").read_bytes()
    content = change_structure(".toml", content, rng)
    title = f"title = {json.dumps(odd_name(rng))}".encode()
    titled = re.sub(rb"(?m)^title.*$", lambda _: title, content)
    (home / "problem.toml").write_bytes(titled)
    verbs = (
        "identify mine --data run.csv --method ols --out out.json",
        "check mine --data run.csv",
        "export-sdp mine --data run.csv --out out.cbf",
    )
    return command(pick(verbs, rng))


def locale(folder: Path, rng: Rng) -> Attack:
    """A name of any kind in a terminal of ASCII."""
    (name,) = hostile_names(1, of_files=True, seed=int(rng.integers(10**6)))
    suffix = pick((".csv", ".npz", ".mat", ".parquet"), rng)
    (folder / f"run{suffix}").rename(folder / f"{name}{suffix}")
    words = ["check", "two_link", "--data", f"{name}{suffix}", "--json", "out.json"]
    return Attack(words, encoding="ascii")


def outputs(folder: Path, rng: Rng) -> Attack:
    """Two outputs that are one file, or an output that is an input."""
    (folder / "link.json").symlink_to("out.json")
    names = "out.json", "./out.json", "link.json", "run.csv"
    first = pick(names, rng)
    second = pick(names, rng)
    return command(f"identify two_link --data run.csv --out {first} --proof {second}")


KINDS: dict[str, Kind] = {
    "MATLAB": log(".mat"),
    "archive": log(".npz"),
    "CSV": log(".csv"),
    "Parquet": log(".parquet"),
    "mesh": mesh,
    "deep mesh": deep_mesh,
    "companion of a mesh": companion,
    "URDF": urdf,
    "numbers": numbers,
    "two outputs": outputs,
    "proof.json": document("proof.json", "verify proof.json"),
    "findings.json": document(
        "findings.json",
        "add model.json --from findings.json --data run.csv --out o.json",
    ),
    "model.json, C": document("model.json", "export model.json --out out.h"),
    "model.json, XML": document("model.json", "export model.json --out out.xml"),
    "model.json, torque": document("model.json", "compare model.json --data run.csv"),
    "MCAP": log(".mcap"),
    "bag": log(".db3"),
    "problem.toml": problem,
    "locale": locale,
}
