"""What the README says works: its commands, its Python, its table; and it is short."""

import re
import runpy
import shlex
from pathlib import Path

import pytest
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
ARM = """<robot name="my_arm">
  <link name="base"/><link name="column"/><link name="slider"/><link name="tool"/>
  <joint name="turn" type="continuous"><parent link="base"/><child link="column"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 1 0"/></joint>
  <joint name="slide" type="prismatic"><parent link="column"/><child link="slider"/>
    <origin xyz="0.2 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" velocity="1" effort="100"/></joint>
  <joint name="mount" type="fixed"><parent link="slider"/><child link="tool"/></joint>
</robot>"""


def test_the_two_commands_are_those_promised():
    first, *_, last = (text.splitlines()[0] for language, text in BLOCKS if language == "console")
    assert first == (
        "python3 -m venv .venv && .venv/bin/pip install -c constraints.txt '.[report]' "
        "&& .venv/bin/sdp-vs-penalty demo"
    )
    assert last == ".venv/bin/pip install -c constraints.txt '.[test]' && .venv/bin/pytest"


def test_ci_runs_the_readmes_test_command():
    script = (ROOT / ".ci" / "run").read_text()
    wanted = re.search(r'grep -m 1 -F "([^"]*)" README.md', script)
    assert wanted is not None
    found = [line for line in README.splitlines() if wanted[1] in line]
    assert found[0] == ".venv/bin/pip install -c constraints.txt '.[test]' && .venv/bin/pytest"
    assert 'eval "$command"' in script


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
    (out / "my_arm.urdf").write_text(ARM)
    problem = load_problem(out / "my_arm.urdf")
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
