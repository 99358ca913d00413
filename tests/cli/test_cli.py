"""The command line: verbs, files, exit codes, sentences instead of tracebacks."""

import io
import json
import os
import re
import signal
import subprocess
import sys

import pytest
from arms import THREE, write_urdf
from commands import HOME, PROGRAM, python, run_cli
from recorded import a_sentence
from small_runs import write_run

from sdp_vs_penalty import __version__
from sdp_vs_penalty.cli import console
from sdp_vs_penalty.cli.main import _for_any_reader
from sdp_vs_penalty.cli.verbs.list import Kind, listing
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.estimators import LmiSdp
from sdp_vs_penalty.simulation import hidden_runs


@pytest.fixture
def run(capsys):
    """Run the command line in this process: (exit code, stdout, stderr)."""

    def call(*arguments):
        return run_cli(*arguments), *capsys.readouterr()

    return call


@pytest.fixture(scope="module")
def runs(tmp_path_factory, two_link):
    folder = tmp_path_factory.mktemp("runs")
    return [write_run(folder / f"run{k}.csv", two_link, seed=k) for k in (1, 2)]


def assert_one_sentence(err, *words):
    assert err.startswith("sdp-vs-penalty: ")
    a_sentence(err.removesuffix("\n"), *words)


@pytest.mark.skipif(os.name == "nt", reason="no resource usage of children")
def test_help_answers_at_once():
    """The promise; 0.05 s of processor time on the machine where this was written."""
    import resource

    seconds = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        result = python(*PROGRAM, "--help", check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds.append(
            after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        )
    assert "identify" in result.stdout
    assert min(seconds) < 0.2


def test_simulate_never_overwrites_runs_of_the_users_own(run, tmp_path, monkeypatch):
    """The same simulation may be repeated."""
    monkeypatch.setattr(hidden_runs, "DURATION", 4.0)
    own = tmp_path / "own"
    folder = tmp_path / "made"
    own.mkdir()
    (own / "run2.csv").write_text("mine")
    hide = ("simulate", "two_link", "--hide", "joint_spring:1", "--out")
    code, _, err = run(*hide, own)
    assert code == 2
    assert_one_sentence(err, "run2.csv exists already", "another folder")
    assert [path.name for path in own.iterdir()] == ["run2.csv"]
    assert (own / "run2.csv").read_text() == "mine"
    for _ in range(2):
        assert run(*hide, folder)[0] == 0
    assert len(list(folder.iterdir())) == 5


def test_simulate_compares_all_before_the_runs_are_made(run, tmp_path, monkeypatch):
    """The robot, too: an edited file and held joints keep its name."""
    arm = write_urdf(tmp_path / "arm.urdf", "arm", THREE)
    monkeypatch.setattr(hidden_runs, "DURATION", 4.0)
    folder = tmp_path / "made"
    made = ("simulate", arm, "--out", folder)
    assert run(*made)[0] == 0
    before = {path: path.read_bytes() for path in folder.iterdir()}

    def measured(*_args):
        raise AssertionError("a run was simulated before the folder was compared")

    monkeypatch.setattr(hidden_runs, "_measure", measured)
    changes = {
        "seed": ("--seed", "1"),
        "level": ("--level", "weak"),
        "effects": ("--hide", "joint_spring:2"),
        "robot": ("--hold", "joint2=0"),
    }
    for name, change in changes.items():
        code, _, err = run(*made, *change)
        assert code == 2
        assert_one_sentence(
            err, "another simulation (problem arm, seed 0", f"differs by {name}"
        )
    arm.write_text(arm.read_text().replace('mass value="', 'mass value="1'))
    assert_one_sentence(run(*made)[2], "another simulation", "differs by robot")
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def test_the_programs_own_words(run):
    assert run("--version")[:2] == (0, f"sdp-vs-penalty {__version__}\n")
    code, out, _ = run()
    assert code == 0
    assert "Start here" in out


def test_the_list_of_effects_is_compact_and_one_of_them_is_told_in_full(
    run, monkeypatch
):
    """Every list names what is registered, a line each at its beginning."""
    monkeypatch.setattr(console.out(), "_width", 80)
    for kind in sorted((kind.value for kind in Kind), key="effects".__eq__):
        code, out, _ = run("list", kind)
        assert code == 0
        names = [row[0] for row in listing(kind)[1]]
        assert set(names) <= {
            line.split()[0] for line in out.splitlines() if line.split()
        }
    assert len(names) < len(out.splitlines()) <= 2 * len(names)
    assert all(len(line) <= 80 for line in out.splitlines())
    for name in names:
        code, out, _ = run("list", "effects", name)
        assert code == 0
        kind = effect_types()[name]
        shown = " ".join(out.split())
        for text in (
            name,
            kind.equation,
            kind.explanation,
            kind.reference,
            *kind.shapes,
        ):
            assert text.strip()
            assert " ".join(text.split()) in shown


@pytest.mark.long
def test_shootout_lists_what_there_is_and_writes_its_tables(run, tmp_path):
    code, said, _ = run("shootout", "--list")
    assert code == 0
    for name in ("panda gram g mm", "log-cholesky L-BFGS", "sdpa-program"):
        assert name in said
    assert re.search(r"clarabel +here", said)
    choice = (
        "--solvers",
        "clarabel,lmi-sdp",
        "--problems",
        "two_link simulated one-step plain",
    )
    code, said, _ = run(
        "shootout", *choice, "--accuracy", "1e-6", "--jobs", 1, "--out", tmp_path
    )
    assert code == 0
    assert "1 drawn problem cannot rank anybody" in said
    assert "Right to 1e-06: clarabel on 1 of 1 and lmi-sdp on 1 of 1." in said
    for name in ("runs.csv", "summary.md", "summary.csv"):
        assert str(tmp_path / name) in said
        assert (tmp_path / name).is_file()


def test_an_error_of_our_own_is_no_traceback_unless_asked_for(
    run, runs, tmp_path, monkeypatch
):
    def broken(*_, **__):
        raise ZeroDivisionError("inner")

    monkeypatch.setattr("sdp_vs_penalty.cli.runs.load_measurements", broken)
    words = ("identify", "two_link", "--data", runs[0], "--out", tmp_path / "m.json")
    code, _, err = run(*words)
    assert code == 1
    assert_one_sentence(err, "ZeroDivisionError", "--debug")
    assert "Traceback" in run(*words, "--debug")[2]


def test_without_docstrings_it_says_so():
    done = python("-OO", *PROGRAM, "check", "--help")
    assert done.returncode == 2
    assert_one_sentence(done.stderr, "-OO", "-O")


@pytest.mark.skipif(os.name == "nt", reason="signals differ")
def test_ctrl_c_leaves_the_old_file(run, runs, tmp_path, monkeypatch):
    """SIGINT in the middle of an identification: exit 130 and the file as it was."""
    kept = tmp_path / "model.json"
    kept.write_text("old")
    before = signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # a background job ignores it
    monkeypatch.setattr(LmiSdp, "fit", lambda *_: os.kill(os.getpid(), signal.SIGINT))
    code, _, err = run("identify", "two_link", "--data", runs[0], "--out", kept)
    signal.signal(signal.SIGINT, before)
    assert code == 130
    assert_one_sentence(err, "interrupted")
    assert kept.read_text() == "old"
    assert list(tmp_path.iterdir()) == [kept]


@pytest.mark.parametrize("is_buffered", [True, False])
def test_a_pipe_that_its_reader_closed_swallows_what_is_printed(is_buffered):
    reader, writer = os.pipe()
    os.close(reader)
    raw = io.FileIO(writer, "w")
    buffer = io.BufferedWriter(raw) if is_buffered else raw
    with io.TextIOWrapper(buffer, "utf-8") as stdout:
        printed = _for_any_reader(stdout)
        assert printed.write("a line\n") == 7
        printed.flush()
        assert printed.errors == "backslashreplace"


def test_a_closed_pipe_loses_no_file(tmp_path):
    kept = tmp_path / "effects.json"
    command = f"{sys.executable} -m sdp_vs_penalty list effects --json {kept}"
    shell = f"set -o pipefail; {command} | true"
    result = subprocess.run(["bash", "-c", shell], capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (0, "")
    assert json.loads(kept.read_text())


NOSE_PLUGIN = "def main():\n    pass\n"
OLD_ROS = "__version__ = '2.7.0'\ndef computeJointTorqueRegressor():\n    pass\n"
BROKEN = (
    "raise ImportError('libpinocchio_default.so: cannot open shared object file')\n"
)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (NOSE_PLUGIN, ["not Pinocchio 4", "pip uninstall pinocchio", "pin>=4"]),
        pytest.param(
            OLD_ROS, ["not Pinocchio 4", "PYTHONPATH", "ROS"], marks=pytest.mark.long
        ),
        pytest.param(
            BROKEN,
            ["cannot be imported", "libpinocchio_default.so", "pin>=4"],
            marks=pytest.mark.long,
        ),
    ],
)
def test_another_pinocchio_is_told_from_ours(content, words, tmp_path):
    """PyPI's `pinocchio`, a ROS copy in front of the wheel, a wheel without its
    libraries."""
    (tmp_path / "pinocchio.py").write_text(content)
    command = (*PROGRAM, "excite", "two_link", "--out", tmp_path / "t.csv")
    result = python(*command, path=f"{tmp_path}{os.pathsep}{HOME}")
    assert result.returncode == 2
    assert_one_sentence(result.stderr, *words)
