"""Attack the command line with hostile files, names and formats, and count what happens.

    python benchmarks/attacks.py --number 400 --seed 1

Each attack is a command in a process of its own. It fails where the process ends by a
signal, takes more than 30 s, prints a traceback, an internal error, a warning of NumPy
or a raw control character, leaves a hidden or partial file, or runs what a name says.
Half of the kinds change bytes and structure of what logs, robots and models are written
in; the others proofs, findings, old formats, bags, problem files and locales.
"""

import argparse
import json
import os
import re
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "helpers")]

from hostile_names import hostile_names, raw_controls  # noqa: E402
from mutations import ODD, change_structure, sound_meshes  # noqa: E402
from small_runs import small_run, write_bag  # noqa: E402

import sdp_vs_penalty as sdp  # noqa: E402
from sdp_vs_penalty.cli.main import main  # noqa: E402
from sdp_vs_penalty.data import save  # noqa: E402

Rng = np.random.Generator
#: Seconds that an attack may take.
PATIENCE = 30.0
BAD = re.compile(rb"Traceback|internal error|RuntimeWarning|DeprecationWarning")
URDF = """<robot name="r"><link name="b"/><link name="l"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial><collision>
<geometry>{shape}</geometry></collision></link><joint name="j" type="continuous">
<parent link="b"/><child link="l"/><axis xyz="0 1 0"/></joint></robot>"""


def sound(folder: Path) -> None:
    """One good file of each kind."""
    problem = sdp.load_problem("two_link")
    run = small_run(problem)
    for suffix in (".csv", ".npz", ".mat", ".parquet"):
        save(run, folder / f"run{suffix}")
    for suffix in (".mcap", ".db3"):
        write_bag(folder / "bag", run, mcap=suffix == ".mcap")
        (file,) = (folder / "bag").glob(f"*{suffix}")
        file.rename(folder / f"run{suffix}")
        shutil.rmtree(folder / "bag")
    model = sdp.identify(problem, run, proof=folder / "proof.json")
    model.save(folder / "model.json")
    sdp.export(model, folder / "arm.urdf")
    found = json.dumps(sdp.diagnose(model, run).to_dict())
    (folder / "findings.json").write_text(found)
    home = ROOT / "problems" / "two_link"
    (folder / "problem.toml").write_bytes((home / "problem.toml").read_bytes())
    for suffix, content in sound_meshes().items():
        (folder / f"mesh{suffix}").write_bytes(content)


def changed(content: bytes, rng: Rng) -> bytes:
    """One to four bytes changed, a part cut, doubled or lost."""
    begin, end = sorted(rng.integers(len(content), size=2).tolist())
    way = int(rng.integers(4))
    if way == 0:
        out = bytearray(content)
        for k in rng.integers(len(out), size=int(rng.integers(1, 5))).tolist():
            out[k] = int(rng.integers(256))
        return bytes(out)
    parts = {1: content[:begin], 2: content[:end] + content[begin:]}
    return parts.get(way, content[:begin] + content[end:])


def changed_json(content: bytes, rng: Rng) -> bytes:
    """A field replaced, lost, doubled, or of another format."""
    document = json.loads(content)
    odd = [None, True, -1, 10**400, 1e300, "x", [], {}, [[1e308]], "\x1b[2J\n"]
    way = int(rng.integers(4))
    name = list(document)[int(rng.integers(len(document)))]
    if way == 0:
        document["format"] = int(rng.integers(-2, 99))
    elif way == 1:
        del document[name]
    elif way == 2:
        text = json.dumps(document)
        return ("{" + f'"{name}": 1, ' + text[1:]).encode()
    else:
        inner = document
        place = name
        while isinstance(inner[place], dict | list) and inner[place]:
            if rng.random() < 0.3:
                break
            inner = inner[place]
            places = [*inner] if isinstance(inner, dict) else [*range(len(inner))]
            place = places[int(rng.integers(len(places)))]
        inner[place] = odd[int(rng.integers(len(odd)))]
    return json.dumps(document).encode()


def log(suffix: str) -> Callable[[Path, Rng], str]:
    def attack(folder: Path, rng: Rng) -> str:
        path = folder / f"run{suffix}"
        content = path.read_bytes()
        structured = change_structure(suffix, content, rng)
        is_plain = structured == content or rng.random() < 0.5
        path.write_bytes(changed(content, rng) if is_plain else structured)
        verbs = (
            f"check run{suffix} --problem two_link",
            f"convert run{suffix} --out out.csv",
            f"identify two_link --data run{suffix} --method ols --out out.json",
        )
        return verbs[int(rng.integers(len(verbs)))]

    return attack


def mesh(folder: Path, rng: Rng) -> str:
    suffixes = [*sound_meshes()]
    suffix = suffixes[int(rng.integers(len(suffixes)))]
    path = folder / f"mesh{suffix}"
    path.write_bytes(changed(path.read_bytes(), rng))
    shape = f'<mesh filename="mesh{suffix}"/>'
    (folder / "arm.urdf").write_text(URDF.format(shape=shape))
    return "check-urdf arm.urdf"


def deep_mesh(folder: Path, rng: Rng) -> str:
    """A mesh that nests without end, in one of the tags of its format."""
    tag = ("node", "Group", "scene", "a")[int(rng.integers(4))]
    depth = int(rng.integers(1000, 60_000))
    suffix = (".dae", ".x3d", ".gltf")[int(rng.integers(3))]
    text = {
        ".dae": f"<COLLADA><library_nodes>{f'<{tag}>' * depth}",
        ".x3d": f"<X3D><Scene>{f'<{tag}>' * depth}",
        ".gltf": '{"nodes":' + "[" * depth,
    }[suffix]
    (folder / f"mesh{suffix}").write_text(text)
    shape = f'<mesh filename="mesh{suffix}"/>'
    (folder / "arm.urdf").write_text(URDF.format(shape=shape))
    return "check-urdf arm.urdf"


def companion(folder: Path, rng: Rng) -> str:
    """A mesh that names a pipe or a device."""
    os.mkfifo(folder / "pipe")
    name = ("pipe", "/dev/zero", "/proc/self/mem")[int(rng.integers(3))]
    texts = {
        ".obj": f"mtllib {name}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        ".gltf": json.dumps({"asset": {"version": "2.0"}, "buffers": [{"uri": name}]}),
    }
    suffix = (".obj", ".gltf")[int(rng.integers(2))]
    (folder / f"mesh{suffix}").write_text(texts[suffix])
    shape = f'<mesh filename="mesh{suffix}"/>'
    (folder / "arm.urdf").write_text(URDF.format(shape=shape))
    return "check-urdf arm.urdf"


def urdf(folder: Path, rng: Rng) -> str:
    path = folder / "arm.urdf"
    content = path.read_bytes()
    for _ in range(int(rng.integers(1, 5))):
        content = change_structure(".urdf", content, rng)
    path.write_bytes(content)
    verbs = "check-urdf arm.urdf", "simulate arm.urdf --out runs --seconds 2"
    return verbs[int(rng.integers(2)) if rng.random() < 0.5 else 0]


def numbers(folder: Path, rng: Rng) -> str:
    odd = ODD[int(rng.integers(len(ODD)))]
    shapes = f'<sphere radius="{odd}"/>', f'<box size="1 {odd} 1"/>'
    text = URDF.format(shape=shapes[int(rng.integers(2))])
    if rng.random() < 0.7:
        names = "value", "ixx", "iyz", "xyz"
        name = names[int(rng.integers(len(names)))]
        text = re.sub(rf'{name}="[^"]*"', f'{name}="{odd}"', text, count=1)
    (folder / "arm.urdf").write_text(text)
    return "check-urdf arm.urdf"


def document(name: str, command: str) -> Callable[[Path, Rng], str]:
    def attack(folder: Path, rng: Rng) -> str:
        path = folder / name
        way = changed_json if rng.random() < 0.8 else changed
        path.write_bytes(way(path.read_bytes(), rng))
        return command

    return attack


def problem(folder: Path, rng: Rng) -> str:
    home = folder / "mine"
    home.mkdir()
    content = (folder / "problem.toml").read_bytes()
    content = change_structure(".toml", content, rng)
    (name,) = hostile_names(1, of_files=False, seed=int(rng.integers(10**6)))
    title = f"title = {json.dumps(name)}".encode()
    (home / "problem.toml").write_bytes(
        re.sub(rb"(?m)^title.*$", lambda _: title, content)
    )
    verbs = (
        "identify mine --data run.csv --method ols --out out.json",
        "check run.csv --problem mine",
        "export-sdp mine --data run.csv --out out.cbf",
    )
    return verbs[int(rng.integers(len(verbs)))]


def locale(folder: Path, rng: Rng) -> str:
    """A name of any kind under the locale C."""
    (name,) = hostile_names(1, of_files=True, seed=int(rng.integers(10**6)))
    suffix = (".csv", ".npz", ".mat", ".parquet")[int(rng.integers(4))]
    (folder / f"run{suffix}").rename(folder / f"{name}{suffix}")
    (folder / "NAME").write_bytes(os.fsencode(f"{name}{suffix}"))
    return "check NAME --problem two_link --json out.json"


def outputs(folder: Path, rng: Rng) -> str:
    """Two outputs that are one file, or an output that is an input."""
    (folder / "link.json").symlink_to("out.json")
    names = "out.json", "./out.json", "link.json", "run.csv"
    first, second = (names[int(rng.integers(len(names)))] for _ in range(2))
    return f"identify two_link --data run.csv --out {first} --proof {second}"


KINDS: dict[str, Callable[[Path, Rng], str]] = {
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
    # Not reached by the earlier trial:
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


def run(command: str, folder: Path) -> tuple[str, bytes]:
    """What becomes of a command in this folder: "ok" or what is wrong, and its output."""
    words = command.split()
    if "NAME" in words:
        name = os.fsdecode((folder / "NAME").read_bytes())
        words = [name if word == "NAME" else word for word in words]
    before = {path.name for path in folder.iterdir()}
    child = os.fork()
    if child == 0:
        os.chdir(folder)
        handle = os.open(folder / "PRINTED", os.O_CREAT | os.O_WRONLY)
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        code = 1
        try:
            for stream in (1, 2):
                encoding = "ascii" if "NAME" in command else "utf-8"
                file = open(stream, "w", encoding=encoding, closefd=False)  # noqa: SIM115
                setattr(sys, "stdout" if stream == 1 else "stderr", file)
            main(words)
        except SystemExit as end:
            code = int(end.code or 0)
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    end = time.monotonic() + PATIENCE
    status = None
    while status is None and time.monotonic() < end:
        number, found = os.waitpid(child, os.WNOHANG)
        status = found if number else None
        time.sleep(0.005)
    if status is None:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return "hang", b""
    printed = (folder / "PRINTED").read_bytes()
    if os.WIFSIGNALED(status):
        return f"signal {os.WTERMSIG(status)}", printed
    if os.WEXITSTATUS(status) not in (0, 1, 2):
        return f"exit code {os.WEXITSTATUS(status)}", printed
    if found := BAD.search(printed):
        return found[0].decode(), printed
    if controls := raw_controls(printed):
        return f"raw {controls[0]!r}", printed
    new = [p.name for p in folder.iterdir() if p.name not in before]
    left = [name for name in new if name.endswith(".part") or name == "PWNED"]
    return (f"left {left}" if left else "ok"), printed


def attack_all(number: int, seed: int) -> int:
    """So many attacks; a line for each kind, and each failure. How many failed."""
    kinds = list(KINDS)
    failed = Counter[str]()
    tried = Counter[str]()
    with tempfile.TemporaryDirectory() as home:
        base = Path(home) / "sound"
        base.mkdir()
        sound(base)
        for k in range(number):
            kind = kinds[k % len(kinds)]
            folder = Path(home) / "attack"
            shutil.copytree(base, folder)
            rng = np.random.default_rng([seed, k])
            outcome, printed = run(KINDS[kind](folder, rng), folder)
            tried[kind] += 1
            if outcome != "ok":
                failed[kind] += 1
                text = printed.decode("utf-8", "backslashreplace")[-300:]
                print(f"{k} {kind}: {outcome}: {text!r}", flush=True)
            shutil.rmtree(folder)
    for kind in kinds:
        print(f"{kind:22} {tried[kind]:4} tried, {failed[kind]} failed")
    print(f"{tried.total()} attacks, {failed.total()} failed")
    return failed.total()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--number", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    sys.exit(min(attack_all(chosen.number, chosen.seed), 1))
