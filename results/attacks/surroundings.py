"""Attacks by what a command meets while it runs: kills, a full disk, other writers, other
locales, closed terminals, odd options; and files of kinds that it does not expect."""

import atexit
import csv
import io
import json
import os
import resource
import shutil
import signal
import socket
import tempfile
import threading
from functools import cache, partial
from pathlib import Path

from disks import mount_small_disk, unmount
from hostile_names import hostile_names
from mutations import ODD, change_structure, odd_name, pick, sound_meshes
from other_locales import LOCALES, make_locales, set_locale

from attacks.attack import Attack, Kind, Rng
from attacks.files import VERBS_OF_LOGS, change_file, command, damaged, with_mesh

#: Commands that write files, each of another kind.
WRITERS = (
    "identify two_link --data run.csv --out out/model.json --proof out/proof.json",
    "identify two_link --data run.csv second.csv --jobs 2 --out out/model.json",
    "diagnose model.json --data run.csv --json out/findings.json",
    "convert run.mat --out out/run.npz",
    "convert run.csv --out out/run.parquet",
    "export model.json --out out/arm.urdf",
    "export model.json --out out/arm.h",
    "report model.json --data run.csv --out out/report.html",
    "export-sdp two_link --data run.csv --out out/problem.cbf",
    "simulate two_link --out out",
    "cross-validate two_link --data run.csv --folds 2 --json out/folds.json",
    "excite model.json --duration 1 --out out/path.csv",
    "tables VIII --problem two_link --jobs 2 --out out",
)


def killed(folder: Path, rng: Rng) -> Attack:
    """A command that gets a signal at some time, and is run again."""
    number = pick((signal.SIGKILL, signal.SIGTERM, signal.SIGINT), rng)
    kill = float(rng.uniform(0.0, 1.5)), number
    return Attack(pick(WRITERS, rng).split(), kill=kill, again=True)


def two_processes_killed(folder: Path, rng: Rng) -> Attack:
    """The same with --jobs 2."""
    verbs = [words for words in WRITERS if "--jobs" in words]
    number = pick((signal.SIGKILL, signal.SIGTERM, signal.SIGINT), rng)
    kill = float(rng.uniform(0.0, 1.5)), number
    return Attack(pick(verbs, rng).split(), kill=kill, again=True)


def two_writers(folder: Path, rng: Rng) -> Attack:
    """Two commands that write the same files at once."""
    words = pick(WRITERS, rng).split()
    return Attack(words, rival=words)


def full_disk(folder: Path, rng: Rng) -> Attack:
    """A limit of what a file may hold."""
    room = int(rng.choice([0, 100, 3000, 20_000, 100_000]))
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (room, room))
    return Attack(pick(WRITERS, rng).split(), surround=limit)


def small_disk(folder: Path, rng: Rng) -> Attack:
    """A file system with little room, where one can be mounted; else as full_disk."""
    room = int(rng.choice([4, 8, 16, 64, 128]))
    place = folder / "out"
    place.mkdir()
    if not mount_small_disk(place, room):
        return full_disk(folder, rng)
    return Attack(pick(WRITERS, rng).split(), clean_up=partial(unmount, place))


def odd_output(folder: Path, rng: Rng) -> Attack:
    """An output that is a device, a pipe, a folder, a loop or no name."""
    (folder / "loop").symlink_to("loop")
    (folder / "dangling").symlink_to("nowhere/file")
    os.mkfifo(folder / "pipe")
    names = [
        "/dev/full",
        "/dev/null",
        "loop",
        "dangling",
        ".",
        "run.csv/x",
        "",
        "x" * 300,
        "a\0b",
        "/proc/self/x",
        "-",
        "~",
        "../attack/out",
    ]
    place = pick(names, rng)
    words = [word.replace("out", place, 1) for word in pick(WRITERS, rng).split()]
    return Attack([word if "--" not in word else word[:20] for word in words])


def odd_option(folder: Path, rng: Rng) -> Attack:
    """An option with a value that nobody means."""
    verbs = {
        "identify two_link --data run.csv --out out.json": (
            "--window --gravity --filters --hold --known --seed --jobs --bounds"
            " --known-load --instruments --gain-uncertainty --effects --solver"
        ),
        "convert run.csv --out out.csv": "--rate --rename --units --joints --topic",
        "cross-validate two_link --data run.csv": "--folds --seed --effects",
        "diagnose model.json --data run.csv": "--seed --window",
        "excite model.json --out out.csv": "--duration --seed",
        "simulate two_link --out out": "--level --hide --seed",
        "export model.json --out out.urdf": "--flange --urdf",
        "check two_link --data run.csv": "--rate --window",
        "compare model.json --data run.csv": "--window --json",
    }
    verb = pick(list(verbs), rng)
    option = pick(verbs[verb].split(), rng)
    values = [*ODD, "", ",", ":", "=", "a=b", "1:0", "0:1e9", "-1,-1,-1", "0,0,0", "\0"]
    value = odd_name(rng) if rng.random() < 0.3 else pick(values, rng)
    if option == "--jobs" and value.isdigit():
        value = "0"  # a thousand processes are what was asked for
    return Attack([*verb.split(), option, value])


def odd_stream(folder: Path, rng: Rng) -> Attack:
    """A terminal that is closed, full, or goes away."""

    def closed() -> None:
        os.close(1)

    def full() -> None:
        os.dup2(os.open("/dev/full", os.O_WRONLY), 1)

    def broken_pipe() -> None:
        ours, theirs = os.pipe()
        os.close(ours)
        os.dup2(theirs, 1)

    def no_input() -> None:
        os.close(0)

    def odd_terminal() -> None:
        os.environ.update(TERM=odd_name(rng).replace("\0", ""), COLUMNS="0", LINES="-1")

    verbs = [
        "check two_link --data run.csv",
        "list methods",
        "--help",
        "check-urdf arm.urdf",
        *WRITERS[:3],
    ]
    ways = (closed, full, broken_pipe, no_input, odd_terminal)
    return Attack(pick(verbs, rng).split(), surround=pick(ways, rng))


@cache
def folder_of_locales() -> Path:
    """Locales that the system does not have."""
    folder = Path(tempfile.mkdtemp(prefix="attack-locales-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    make_locales(folder)
    return folder


def other_locale(folder: Path, rng: Rng) -> Attack:
    """Decimal commas, a dotless i, no UTF-8; also set for the libraries in C."""
    names = [f"{name}.{charset}" for name, charset in LOCALES.items()]
    name = pick([*names, "C", "POSIX", "xx"], rng)
    surround = partial(set_locale, name, folder_of_locales())
    verbs = [*WRITERS, "verify proof.json", "check two_link --data run.mat"]
    words = pick(verbs, rng).split()
    if rng.random() < 0.3:
        suffix = pick(list(sound_meshes()), rng)
        words = list(with_mesh(folder, f"mesh{suffix}").words)
    return Attack(words, surround=surround)


def wrong_place(folder: Path, rng: Rng) -> Attack:
    """A file where one of another kind belongs: SDPA and CBF among them."""
    texts = {
        "problem.cbf": "VER\n3\n\nOBJSENSE\nMIN\n\nVAR\n2 1\nF 2\n\n",
        "problem.dat-s": '"x"\n2 = mDIM\n1 = nBLOCK\n2\n1 1\n0 1 1 1 1\n',
    }
    for name, text in texts.items():
        content = text.encode()
        if rng.random() < 0.5:
            content = damaged(content, rng)
        (folder / name).write_bytes(content)
    names = [path.name for path in folder.iterdir() if path.is_file()]
    name = pick([*texts, *names], rng)
    verbs = (
        *VERBS_OF_LOGS,
        "verify {}",
        "check-urdf {}",
        "identify {} --data run.csv --out out.json",
        "compare {} --data run.csv",
        "export {} --out out.h",
        "identify two_link --data run.csv --bounds {} --out out.json",
        "add model.json --from {} --data run.csv --out out.json",
        "export model.json --urdf {} --out out.urdf",
    )
    return command(pick(verbs, rng).format(name))


def solver_that_lies(folder: Path, rng: Rng) -> Attack:
    """A program in the place of csdp whose answer, in SDPA's format, is broken."""
    answer = "0.1 " * int(rng.integers(0, 60)) + "\n2 1 1 1 0.5\n1 1 1 2 1e300\n"
    content = change_structure(".solution", answer.encode(), rng)
    (folder / "answer").write_bytes(
        damaged(content, rng) if rng.random() < 0.3 else content
    )
    end = pick(
        ("exit 0", "exit 1", "exit 3", "exit 77", "kill -9 $$", "kill -11 $$"), rng
    )
    noise = pick(("echo Success", "head -c 300 /dev/urandom", "true"), rng)
    program = folder / "programs" / "csdp"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\ncp '{folder}/answer' solution\n{noise}\n{end}\n")
    program.chmod(0o755)

    def put_first() -> None:
        os.environ["PATH"] = f"{program.parent}:{os.environ['PATH']}"

    words = "identify two_link --data run.csv --method lmi-sdp-thickness --solver csdp"
    return Attack([*words.split(), "--out", "out.json"], surround=put_first)


def cut_bag(folder: Path, rng: Rng) -> Attack:
    """A bag or MCAP file as a recorder leaves it that is killed."""
    suffix = pick((".mcap", ".db3"), rng)
    path = folder / f"run{suffix}"
    content = path.read_bytes()
    path.write_bytes(content[: int(rng.integers(len(content)))])
    return command(pick(VERBS_OF_LOGS, rng).format(path.name))


def other_format(folder: Path, rng: Rng) -> Attack:
    """A document of an older or newer format, or in which a field comes twice."""
    verbs = {
        "model.json": (
            "compare model.json --data run.csv",
            "export model.json --out a.h",
        ),
        "findings.json": (
            "add model.json --from findings.json --data run.csv --out out.json",
        ),
        "proof.json": ("verify proof.json",),
    }
    name = pick(list(verbs), rng)
    text = (folder / name).read_text()
    document = json.loads(text)
    if rng.random() < 0.4:
        field = pick(list(document), rng)
        value = json.dumps(pick([document[field], None, 1], rng))
        text = "{" + f"{json.dumps(field)}: {value}, " + text[text.index("{") + 1 :]
    else:
        document["format"] = pick((0, 1, 3, -1, 1.5, "1", None, True, [2], 10**30), rng)
        if name == "proof.json" and rng.random() < 0.5:
            document["format"] = f"sdp-vs-penalty proof {int(rng.integers(9))}"
        text = json.dumps(document)
    (folder / name).write_text(text)
    return command(pick(verbs[name], rng))


SHOOTOUT = (
    "shootout",
    "--problems",
    "two_link simulated one-step gyration",
    "--solvers",
    "clarabel",
    "--accuracy",
    "1e-4",
    "--out",
    "out",
)


@cache
def shootout_results() -> dict[str, bytes]:
    """The files of a small shootout."""
    from sdp_vs_penalty.cli.main import main

    with tempfile.TemporaryDirectory() as home:
        child = os.fork()
        if child == 0:
            os.chdir(home)
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, 1)
            try:
                main(list(SHOOTOUT))
            finally:
                os._exit(0)
        os.waitpid(child, 0)
        return {path.name: path.read_bytes() for path in Path(home, "out").iterdir()}


def folder_of_results(folder: Path, rng: Rng) -> Attack:
    """A shootout that goes on from results that were changed."""
    (folder / "out").mkdir()
    for name, content in shootout_results().items():
        (folder / "out" / name).write_bytes(content)
    name = pick(("runs.csv", "references.json", "references.json"), rng)
    change_file(folder / "out" / name, rng)
    return Attack(SHOOTOUT)


def column_names(folder: Path, rng: Rng) -> Attack:
    """Columns of any name, in any of the formats of tables."""
    lines = list(csv.reader((folder / "run.csv").read_text().splitlines()))
    for k in rng.integers(len(lines[0]), size=int(rng.integers(1, 4))).tolist():
        lines[0][k] = odd_name(rng)
    if rng.random() < 0.3:
        lines = [[*row, "0.5"] for row in lines]
        lines[0][-1] = odd_name(rng)
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    (folder / "run.csv").write_text(text.getvalue(), "utf-8")
    return command(pick(VERBS_OF_LOGS, rng).format("run.csv"))


def names_in_a_model(folder: Path, rng: Rng) -> Attack:
    """A model whose robot, joints, method, data and problem have hostile names, written
    in each format."""
    model = json.loads((folder / "model.json").read_text())
    model["robot"]["name"] = odd_name(rng)
    model["problem"]["name"] = odd_name(rng)
    model["problem"]["title"] = odd_name(rng)
    model["method"] = odd_name(rng)
    model["provenance"]["data"] = [odd_name(rng)]
    for joint in model["robot"]["joints"]:
        joint["name"] = odd_name(rng)
    (folder / "model.json").write_text(json.dumps(model))
    verbs = (
        "report model.json --data run.csv --out out.html",
        "export model.json --out out.h",
        "export model.json --out out.xml",
        "export model.json --out out.sdf",
        "export model.json --out out.urdf",
        "export model.json --out out.csv",
        "export model.json --out out.json",
        "compare model.json --data run.csv --json out.json",
        "diagnose model.json --data run.csv --json out.json",
        "excite model.json --duration 1 --out out.csv --ros out.yaml",
    )
    return command(pick(verbs, rng))


def tables_of_a_name(folder: Path, rng: Rng) -> Attack:
    """LaTeX and Markdown of a problem with a hostile title in a folder of such a name."""
    (name,) = hostile_names(1, of_files=True, seed=int(rng.integers(10**6)))
    home = folder / name
    home.mkdir()
    content = (folder / "problem.toml").read_text()
    lines = [
        f"title = {json.dumps(odd_name(rng))}" if line.startswith("title") else line
        for line in content.splitlines()
    ]
    (home / "problem.toml").write_text("\n".join(lines), "utf-8")
    return Attack(["tables", "III", "--problem", name, "--out", "out"])


def bounds(folder: Path, rng: Rng) -> Attack:
    """A table of bounds that is changed."""
    rows = ["parameter,lower,upper", "m1,0.1,20", "c1x,-0.5,0.5", "I2xx,0,1"]
    (folder / "bounds.csv").write_text("\n".join(rows) + "\n")
    for _ in range(int(rng.integers(1, 4))):
        change_file(folder / "bounds.csv", rng)
    return command(
        "identify two_link --data run.csv --bounds bounds.csv --out out.json"
    )


def scheduler(folder: Path, rng: Rng) -> Attack:
    """The address of a scheduler where nobody, or somebody else, answers."""
    server = socket.socket()
    server.bind(("127.0.0.1", 0))
    server.listen()
    answer = bytes(rng.integers(256, size=200).tolist())

    def talk_nonsense() -> None:
        while True:
            try:
                client, _ = server.accept()
            except OSError:
                return
            client.sendall(answer)
            client.close()

    address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
    odd = pick(("tcp://", "x", "", "tcp://127.0.0.1:1", odd_name(rng), address), rng)

    def serve_in_the_command() -> None:
        threading.Thread(target=talk_nonsense, daemon=True).start()

    words = [
        "identify",
        "two_link",
        "--data",
        "run.csv",
        "--jobs",
        "2",
        "--out",
        "out.json",
    ]
    return Attack([*words, "--scheduler", odd], surround=serve_in_the_command)


def no_room(folder: Path, rng: Rng) -> Attack:
    """Little memory, few open files, no folder for temporary files, no home."""

    def few_files() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (int(rng.integers(4, 40)),) * 2)

    def no_temporary_folder() -> None:
        os.environ["TMPDIR"] = "/nonexistent"
        tempfile.tempdir = None

    def no_home() -> None:
        os.environ.pop("HOME", None)

    def gone_folder() -> None:
        os.mkdir("gone")
        os.chdir("gone")
        os.rmdir("../gone")

    ways = (few_files, no_temporary_folder, no_home, gone_folder)
    verbs = [*WRITERS, "check two_link --data run.mat", "check-urdf arm.urdf"]
    return Attack(pick(verbs, rng).split(), surround=pick(ways, rng))


KINDS: dict[str, Kind] = {
    "killed": killed,
    "--jobs 2 killed": two_processes_killed,
    "two writers": two_writers,
    "full disk": full_disk,
    "small disk": small_disk,
    "other format": other_format,
    "cut bag": cut_bag,
    "solver that lies (SDPA)": solver_that_lies,
    "wrong place (SDPA, CBF)": wrong_place,
    "other locale": other_locale,
    "names in a model": names_in_a_model,
    "tables of a name (LaTeX)": tables_of_a_name,
    "Dask": scheduler,
    # Not named by the earlier trial:
    "odd output": odd_output,
    "odd option": odd_option,
    "odd stream": odd_stream,
    "folder of results": folder_of_results,
    "column names": column_names,
    "bounds": bounds,
    "no room": no_room,
}
