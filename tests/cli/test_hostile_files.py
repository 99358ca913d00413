"""Every verb's every file argument, given what is no such file: one sentence, exit 2,
bounded."""

import json
import os
import shlex
import signal
import subprocess
import sys
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import pytest
from commands import HOME, peak_memory
from small_runs import small_run

from sdp_vs_penalty import identify
from sdp_vs_penalty.cli import main as cli
from sdp_vs_penalty.data import save

#: Seconds and bytes that a refusal may take.
SECONDS = 10
MEMORY = 650e6

#: Commands by the kind of the file that stands for @; RUN, MODEL and PROOF are good
#: ones.
COMMANDS = json.loads(
    (Path(__file__).parents[1] / "data" / "commands_of_files.json").read_text()
)
SUFFIXES = {
    "run": (".csv", ".npz", ".mat", ".parquet", ".mcap"),
    "model": (".json",),
    "urdf": (".urdf",),
    "problem": ("",),
}


def chain(links):
    """A URDF of so many links, one on the other."""
    joint = (
        '<link name="{0}"/><joint name="j{0}" type="{2}"><parent link="{1}"/><child'
        ' link="{0}"/></joint>'
    )
    kinds = ("fixed", "continuous")
    body = "".join(joint.format(k, k - 1, kinds[k % 2]) for k in range(1, links))
    return f'<robot name="r"><link name="0"/>{body}</robot>'


def bombs(kind, folder):
    """Files of about a megabyte that nest or count without end; data/test_bad_input.py
    unpacks some."""
    size = 10**6
    entities = "".join(f'<!ENTITY a{k} "{10 * f"&a{k - 1};"}">' for k in range(2, 10))
    texts = {
        "run": {
            "bomb.csv": "t,q1,tau1\n" + "1," * (size // 2),
            "digits.csv": "9" * size,
        },
        "model": {
            "bomb.json": '{"format":2,"robot":' * (size // 20),
            "list.json": "[" * size,
        },
        "urdf": {
            "bomb.urdf": (
                "<!DOCTYPE robot [<!ENTITY a1"
                f' "aaaaaaaaaa">{entities}]><robot>&a9;</robot>'
            ),
            "deep.urdf": "<robot>" + "<a>" * (size // 3),
            "chain.urdf": chain(8000),
        },
        "problem": {
            "bomb/problem.toml": "a = " + "[" * size,
            "keys/problem.toml": "x=" + "9" * size,
        },
    }
    for name, text in texts[kind].items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        yield path.parent if kind == "problem" else path


def hostile(kind, folder, every):
    """What an argument must survive: devices, pipes, folders, unreadable files, and
    bombs.

    every : with every suffix and every bomb of this kind, instead of one.
    """
    for suffix in SUFFIXES[kind] if every else SUFFIXES[kind][:1]:
        for name, target in (
            ("zero", "/dev/zero"),
            ("mem", "/proc/self/mem"),
            ("gone", folder / "nothing"),
        ):
            link = folder / f"{name}{suffix}"
            link.symlink_to(target)
            yield link
        os.mkfifo(folder / f"pipe{suffix}")
        yield folder / f"pipe{suffix}"
        (folder / f"folder{suffix}").mkdir()
        yield folder / f"folder{suffix}"
    if kind == "problem":
        for name, target in (("device", "/dev/zero"), ("unreadable", "/proc/self/mem")):
            (folder / name).mkdir()
            (folder / name / "problem.toml").symlink_to(target)
            yield folder / name
        (folder / "waits").mkdir()
        os.mkfifo(folder / "waits" / "problem.toml")
        yield folder / "waits"
    yield from islice(bombs(kind, folder), None if every else 1)


@contextmanager
def at_most(seconds):
    """An error where the block takes longer."""

    def late(*_):
        raise AssertionError(f"still at it after {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="module")
def good(two_link, tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    run = small_run(two_link)
    save(run, folder / "run.csv")
    identify(two_link, run, proof=folder / "proof.json").save(folder / "model.json")
    return {
        k: str(folder / v)
        for k, v in (
            ("RUN", "run.csv"),
            ("MODEL", "model.json"),
            ("PROOF", "proof.json"),
        )
    }


CASES = [(kind, command) for kind, commands in COMMANDS.items() for command in commands]


@pytest.mark.skipif(
    not Path("/proc/self/mem").exists(), reason="devices and limits of Linux"
)
@pytest.mark.parametrize(
    ("kind", "command"),
    [
        pytest.param(
            kind,
            command,
            id=command,
            marks=() if command == COMMANDS[kind][0] else pytest.mark.long,
        )
        for kind, command in CASES
    ],
)
def test_no_file_crashes_hangs_or_bursts(
    kind, command, good, tmp_path, monkeypatch, capsys
):
    given = tmp_path / "given"
    work = tmp_path / "work"
    given.mkdir()
    work.mkdir()
    monkeypatch.chdir(work)
    first = command == COMMANDS[kind][0]
    for path in hostile(kind, given, first):
        words = [{"@": str(path), **good}.get(word, word) for word in command.split()]
        with peak_memory() as peak, at_most(SECONDS), pytest.raises(SystemExit) as end:
            cli.main(words)
        said = capsys.readouterr().err.strip()
        told = (
            f"{command} with {path.name}: exit {end.value.code}, {peak[0] / 1e6:.0f}"
            f" MB: {said}"
        )
        assert end.value.code == 2 or (
            command.startswith("verify @") and end.value.code == 1
        ), told
        assert "internal error" not in said, told
        assert len(said.splitlines()) <= 1, told
        assert len(said) < 1000, told
        assert peak[0] < MEMORY, told
        assert not [*work.iterdir()], told


def refused(verb, before, good, folder):
    """What a verb says that ends with exit code 2, after the words of a shell, and
    leaves nothing."""
    words = [good.get(word, word) for word in shlex.split(verb)]
    command = f"{before} {shlex.join([sys.executable, '-m', 'sdp_vs_penalty', *words])}"
    bare = {name: value for name, value in os.environ.items() if name != "HOME"}
    done = subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, cwd=folder, env=bare
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    assert not [path for path in folder.rglob("*") if path.is_file()]
    return done.stderr


@pytest.mark.parametrize(
    "verb", ["identify two_link --data RUN --out out.json", "check RUN", "list"]
)
def test_a_limit_of_memory_is_one_sentence(verb, good, tmp_path):
    """OpenBLAS would end the process in words of its own."""
    said = refused(verb, "ulimit -v 250000; exec", good, tmp_path)
    assert "this process may take 244 MiB of memory" in said


@pytest.mark.parametrize(
    "verb",
    [
        "export MODEL --out out/arm.urdf",
        *(
            pytest.param(verb, marks=pytest.mark.slow)
            for verb in (
                (
                    "identify two_link --data RUN --jobs 2 --out out/model.json --proof"
                    " out/proof.json"
                ),
                "report MODEL --data RUN --out out/report.html",
                "simulate two_link --out out",
                "tables VIII --problem two_link --out out",
                (
                    "shootout --problems 'chain of 2 links gyration 0' --solvers"
                    " clarabel,scs --out out"
                ),
                "excite two_link --duration 2 --out out/path.csv",
            )
        ),
    ],
)
def test_where_nothing_can_be_written(verb, good, tmp_path):
    """A full disk, and a folder of another account; neither has a home."""
    assert "too large" in refused(verb, "ulimit -f 0; exec", good, tmp_path).lower()
    folder = tmp_path / "theirs"
    folder.mkdir(mode=0o555)
    someone = (
        "exec setpriv --bounding-set=-all --inh-caps=-all"
        if os.getuid() == 0
        else "exec"
    )
    assert "Permission denied" in refused(verb, someone, good, folder)


def test_a_folder_that_was_removed_is_a_sentence(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    code = f"""if True:
        import os
        from sdp_vs_penalty.cli.main import main

        os.rmdir({str(gone)!r})
        main(["list"])"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=gone,
        env={**os.environ, "PYTHONPATH": HOME},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert "the current folder cannot be used" in done.stderr
