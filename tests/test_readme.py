"""What the README says works: its commands, its Python, its table; and it is short."""

import re
import runpy
import shlex
from pathlib import Path

import pytest
from arms import SCARA, write_urdf
from commands import run_cli
from small_runs import write_run

from sdp_vs_penalty import load_problem

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
COMMANDS = [
    line
    for language, text in BLOCKS
    if language == "console"
    for line in text.splitlines()
    if line.startswith("sdp-vs-penalty ")
]


def test_constraints_pin_exact_versions_and_name_no_host():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert pins
    for line in pins:
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.+!]+", line), line
    assert not re.search(r"://|--", "\n".join(lines))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that the README's examples name."""
    out = tmp_path_factory.mktemp("readme")
    problem = load_problem(write_urdf(out / "my_arm.urdf", "my_arm", SCARA[1:3]))
    for seed, name in enumerate(("run1.csv", "run2.csv", "test.csv")):
        write_run(out / name, problem, seed=seed)
    return out


def test_your_robot_in_four_commands(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert len(COMMANDS) == 4
    for line in COMMANDS:
        assert run_cli(*shlex.split(line)[1:]) == 0, f"{line}\n{capsys.readouterr().err}"
    assert (folder / "report.html").exists()


def test_the_python_runs(folder, monkeypatch, capsys):
    (code,) = [text for language, text in BLOCKS if language == "python"]
    assert sum(1 for line in code.splitlines() if line.strip()) <= 11
    (folder / "example.py").write_text(code)
    monkeypatch.chdir(folder)
    runpy.run_path("example.py")
    assert "certified lower bound" in capsys.readouterr().out
    assert (folder / "model.json").exists()


def test_the_table_equals_the_generated_one():
    tool = runpy.run_path(str(ROOT / "tools" / "update_readme.py"))
    assert tool["with_results"](README, tool["headline"]()) == README
    assert tool["with_results"](README, tool["headline"]() + "\nchanged") != README
    for picture in re.findall(r"\]\(([^):]*)\)", README):
        assert (ROOT / picture).exists(), picture


def test_it_is_short_and_says_what_the_tests_leave_out():
    assert len(README.split()) <= 900
    left_out = re.findall(r"not (\w+)", (ROOT / "pyproject.toml").read_text().partition("-m '")[2][:60])
    assert left_out
    assert all(f"`{marker}`" in README for marker in left_out)
