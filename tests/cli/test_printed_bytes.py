"""Hostile names through every verb: each printed byte is clean, each printed command can
be pasted."""

import json
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from itertools import cycle, islice
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from commands import HOME, run_cli
from hostile_names import hostile_names, raw_controls
from small_runs import small_run

import sdp_vs_penalty as sdp
from sdp_vs_penalty.data import save
from sdp_vs_penalty.errors import command_line

#: Verbs that are given a file of a hostile name for @, and write to the name ~.
FILES = {
    "check": "check two_link --data @.csv --json ~.json",
    "convert": "convert @.csv --out ~.npz",
    "foreign": "convert foreign@.csv --out ~.csv",
    "refused": "check two_link --data refused@.csv",
    "identify": "identify two_link --data @.csv --method ols --out ~.json",
    "compare": "compare @.json --data run.csv --json ~.json",
    "export": "export @.json --out ~.h",
    "export as XML": "export @.json --out ~.xml",
    "check-urdf": "check-urdf @.urdf --fix ~.urdf",
    "verify": "verify @.json",
    "not there": "identify @.urdf --data @.npz --out ~.json",
    "excite": "excite @.json --duration 1 --out ~.csv",
    "report": "report @.json --data @.csv --out ~.html",
    "export-sdp": "export-sdp two_link --data @.csv --out ~.dat-s",
    "diagnose": "diagnose @.json --data @.csv --json ~.json",
    "simulate": "simulate @.json --data @.csv --json ~.json",
    "add": "add @.json --effects ~ --data @.csv --out ~.json",
    "cross-validate": "cross-validate two_link --data @.csv --folds 0",
    "tables": "tables @ --out ~",
    "figures": "figures @ --out ~",
    "list": "list @",
    "fetch": "fetch @ --folder ~",
    "shootout": "shootout --problems @ --out ~",
    "page": "page @ --port x",
    "demo": "demo --out @.csv --x",
}


@pytest.fixture(scope="module")
def home(two_link, tmp_path_factory):
    """A folder with a run, a model and a URDF."""
    folder = tmp_path_factory.mktemp("home")
    run = small_run(two_link, seconds=1.0)
    save(run, folder / "run.csv")
    model = sdp.identify(two_link, run, "ols")
    model.save(folder / "model.json")
    (folder / "arm.urdf").write_text(urdf("arm"))
    return folder


def urdf(name):
    """An arm of one joint whose robot, links and joint have the name."""
    text = quoteattr("".join(c for c in name if c >= " " or c == "\n"))
    base = quoteattr("base" + text[1:-1])
    inertia = '<inertia ixx="1" iyy="1" izz="3" ixy="0" ixz="0" iyz="0"/>'
    return (
        f"<robot name={text}><link name={base}/><link name={text}><inertial>"
        f'<mass value="1"/>{inertia}</inertial></link><joint name={text}'
        f' type="continuous"><parent link={base}/><child link={text}/></joint></robot>'
    )


def place(home, folder, name):
    """Copies under the name of everything that verbs read, in this folder."""
    for source, suffix in (("run.csv", ".csv"), ("model.json", ".json")):
        (folder / f"{name}{suffix}").write_bytes((home / source).read_bytes())
    (folder / "run.csv").write_bytes((home / "run.csv").read_bytes())
    text = name.encode("utf-8", "replace").decode()
    (folder / f"{name}.urdf").write_text(urdf(text), "utf-8")
    header, rows = (home / "run.csv").read_text().split("\n", 1)
    odd = "".join(c for c in text if c not in ',\n\r"')
    foreign = header.replace("t,", f"time{odd},", 1).replace("q1", "position_1")
    foreign = foreign.replace("q2", "position_2").replace("tau", "effort_")
    (folder / f"foreign{name}.csv").write_text(f"{foreign}\n{rows}", "utf-8")
    (folder / f"refused{name}.csv").write_text(f"{odd},{odd}1\n1,2\n", "utf-8")


def numbered(count):
    """Seeds of names: the second for CI alone, the others slow."""
    marks = [(), pytest.mark.long, *(count - 2) * [pytest.mark.slow]]
    return [pytest.param(k, marks=mark) for k, mark in enumerate(marks)]


@pytest.mark.parametrize("number", numbered(4))
def test_every_printed_byte_is_clean(number, home, tmp_path, monkeypatch, capsysbinary):
    """Fourteen names of files, each through two verbs; each number asks every verb."""
    monkeypatch.chdir(tmp_path)
    commands = islice(cycle(FILES.values()), 2 * number, None)
    for name in hostile_names(14, of_files=True, seed=number):
        place(home, tmp_path, name)
        for command in islice(commands, 2):
            words = [
                word.replace("@", name).replace("~", f"out{name}")
                for word in command.split()
            ]
            code = run_cli(*words)
            printed = capsysbinary.readouterr()
            both = printed.out + printed.err
            assert not raw_controls(both), (words, both)
            assert b"internal error" not in both, (words, both)
            assert code in (0, 1, 2), (words, both)
            assert not re.search(rb"(?m)^sdp-vs-penalty: all is well", both), words
        for path in tmp_path.iterdir():
            if path.is_file():
                path.unlink()
    assert not (tmp_path / "PWNED").exists()


@pytest.mark.parametrize("number", numbered(3))
def test_names_inside_of_files_are_clean(
    number, home, tmp_path, monkeypatch, capsysbinary
):
    """Names of columns, arrays, links and joints."""
    monkeypatch.chdir(tmp_path)
    with np.load(archive(home, tmp_path)) as arrays:
        columns = dict(arrays)
    for name in hostile_names(10, of_files=False, seed=number):
        (tmp_path / "arm.urdf").write_text(urdf(name), "utf-8")
        extra = {**columns, name.replace("/", ""): columns["t"]}
        np.savez(tmp_path / "named.npz", **extra)
        model = json.loads((home / "model.json").read_text())
        model["robot"]["name"] = name
        (tmp_path / "model.json").write_text(json.dumps(model))
        for command in (
            "check two_link --data named.npz",
            "check-urdf arm.urdf",
            "export model.json --out a.h",
            "export model.json --out a.xml",
        ):
            assert run_cli(*command.split()) in (0, 1, 2)
            printed = capsysbinary.readouterr()
            both = printed.out + printed.err
            assert not raw_controls(both), (command, both)
            assert b"internal error" not in both, (command, both)
        if (tmp_path / "a.xml").exists():
            ET.parse(tmp_path / "a.xml")


def archive(home, folder):
    save(sdp.load_measurements(home / "run.csv"), folder / "named.npz")
    return folder / "named.npz"


def test_a_shell_reads_the_words_that_were_meant(tmp_path):
    names = [*hostile_names(200, of_files=True)]
    lines = [command_line(["printf", "%s|", name, "end"]) for name in names]
    assert all(line.isprintable() for line in lines)
    script = "".join(f"{line}\nprintf '\\0'\n" for line in lines)
    done = subprocess.run(["bash", "-c", script], capture_output=True, cwd=tmp_path)
    read = done.stdout.split(b"\0")[:-1]
    assert read == [os.fsencode(name) + b"|end|" for name in names]
    assert not [*tmp_path.iterdir()]


#: Where Python takes file names for ASCII.
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


NAMES = ("bad\udcff\udcfe", "naïve 機械")
SUFFIXES = (".csv", ".npz", ".parquet", ".mat")


def save_as(name, folder, problem):
    """Runs of all kinds under a name; their files."""
    for seed, suffix in enumerate(SUFFIXES):
        run = small_run(problem, seconds=2.0, seed=seed)
        save(run, folder / f"plain{suffix}")
        (folder / f"plain{suffix}").rename(folder / f"{name}{suffix}")
    return [f"{name}{suffix}" for suffix in SUFFIXES]


def checked(path):
    """Kinds of the files that a check's JSON is about."""
    written = json.loads(path.read_text("utf-8"))
    return [Path(x["run"]).suffix for x in written["runs"]]


@pytest.mark.parametrize("name", NAMES)
def test_runs_of_any_name_are_checked(name, two_link, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    files = save_as(name, tmp_path, two_link)
    code = run_cli("check", "two_link", "--data", *files, "--json", f"{name}.json")
    assert code == 0
    assert checked(tmp_path / f"{name}.json") == [*SUFFIXES]


@pytest.mark.long
def test_runs_of_any_name_are_checked_in_a_locale_of_ascii(two_link, tmp_path):
    """Names that are no UTF-8, and names that are not of the locale."""
    files = [file for name in NAMES for file in save_as(name, tmp_path, two_link)]
    words = ["check", "two_link", "--data", *files, "--json", f"{NAMES[1]}.json"]
    done = subprocess.run(
        [sys.executable, "-m", "sdp_vs_penalty", *words],
        env={**os.environ, **ASCII, "PYTHONPATH": HOME},
        capture_output=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert checked(tmp_path / f"{NAMES[1]}.json") == [*SUFFIXES, *SUFFIXES]
