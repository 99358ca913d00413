"""Every result lies beside the script that makes it, with a note of the machine."""

import ast
import re

import pytest
from committed import RESULTS

from sdp_vs_penalty.paper import provenance

pytestmark = pytest.mark.skipif(
    not RESULTS.is_dir(), reason="not a checkout: no results/"
)
FOLDERS = (
    sorted(
        path
        for path in RESULTS.iterdir()
        if path.name != "simulated" and path.is_dir() and any(path.iterdir())
    )
    if RESULTS.is_dir()
    else []
)


def test_nothing_lies_loose():
    assert [path.name for path in RESULTS.iterdir() if path.is_file()] == ["README.md"]


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda path: path.name)
def test_a_result_is_listed_and_lies_beside_its_script_which_says_its_command(folder):
    names = {path.name for path in folder.iterdir()}
    assert {"make.py", "README.md"} <= names
    is_made = "Not made yet" not in (folder / "README.md").read_text("utf-8")
    assert (provenance.NOTE in names) == is_made
    assert f"({folder.name}/README.md)" in (RESULTS / "README.md").read_text()
    text = ast.get_docstring(ast.parse((folder / "make.py").read_text()))
    assert f"python results/{folder.name}/make.py" in (text or "")


def test_a_note_has_commands_machine_commit_and_time(tmp_path):
    """Of what is made again alone, the others' lines stay."""
    folder = tmp_path / "results" / "one"
    folder.mkdir(parents=True)
    commands = [["-c", "print(1)"], ["-c", "print(2)"]]
    provenance.make_folder(folder, *commands)
    first, second = (folder / provenance.NOTE).read_text().split("\n\n")
    command, machine, time = first.splitlines()
    assert command == "python -c print(1)"
    assert "cores" in machine
    assert "numpy" in machine
    assert re.search("UTC, commit .*s of processor time", time)
    provenance.make_folder(folder, *commands, only=["print(1)"])
    assert (folder / provenance.NOTE).read_text().startswith(second.strip())
    provenance.make_folder(
        folder, commands[0]
    )  # the second is no command of it any more
    assert "print(2)" not in (folder / provenance.NOTE).read_text()


def test_a_command_that_fails_ends_it_without_a_note(tmp_path):
    folder = tmp_path / "results" / "one"
    folder.mkdir(parents=True)
    with pytest.raises(SystemExit, match="3"):
        provenance.make_folder(folder, ["-c", "raise SystemExit(3)"])
    assert not (folder / provenance.NOTE).exists()


def test_a_command_that_adds_nothing_leaves_the_note_of_what_is_there(tmp_path):
    """A resume that runs nothing was no timed run: its load and time say nothing."""
    folder = tmp_path / "results" / "some"
    folder.mkdir(parents=True)
    runs, note = folder / "runs.csv", folder / provenance.NOTE
    more = ["-c", "open('results/some/runs.csv', 'a').write('a run')"]
    for command, is_noted in ((more, True), (["-c", "pass"], False), (more, True)):
        note.write_text("of the runs\n")
        provenance.make_folder(folder, command, result="runs.csv")
        assert (note.read_text() != "of the runs\n") is is_noted
    assert runs.read_text() == 2 * "a run"
    note.write_text("of the runs\n")
    provenance.make_folder(folder, ["-c", "pass"])  # makes all of the folder
    assert "processor time" in note.read_text()
