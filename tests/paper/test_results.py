"""Every result lies beside the script that makes it, with a note of the machine."""

import ast
from pathlib import Path

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
def test_a_result_lies_beside_its_script(folder):
    names = {path.name for path in folder.iterdir()}
    assert {"make.py", "README.md"} <= names
    is_made = "Not made yet" not in (folder / "README.md").read_text("utf-8")
    assert (provenance.NOTE in names) == is_made


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda path: path.name)
def test_the_list_of_results_names_it(folder):
    assert f"({folder.name}/README.md)" in (RESULTS / "README.md").read_text()


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda path: path.name)
def test_a_script_says_its_own_command(folder):
    text = ast.get_docstring(ast.parse((folder / "make.py").read_text()))
    assert f"python results/{folder.name}/make.py" in (text or "")


def test_a_note_has_commands_machine_and_time(tmp_path: Path):
    folder = tmp_path / "results" / "one"
    folder.mkdir(parents=True)
    provenance.make_folder(folder, ["-c", "print(1)"])
    command, machine, time = (folder / provenance.NOTE).read_text().splitlines()
    assert command == "python -c print(1)"
    assert "cores" in machine
    assert "numpy" in machine
    assert "s of processor time" in time


def test_a_command_that_fails_ends_it_without_a_note(tmp_path: Path):
    folder = tmp_path / "results" / "one"
    folder.mkdir(parents=True)
    with pytest.raises(SystemExit, match="3"):
        provenance.make_folder(folder, ["-c", "raise SystemExit(3)"])
    assert not (folder / provenance.NOTE).exists()
