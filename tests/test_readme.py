"""What the README says works: its commands, its Python, its tables."""

from __future__ import annotations

import re
import runpy
import shlex
from pathlib import Path

import pytest
import typer.main
from small_runs import small_run, write_run

from sdp_vs_penalty.cli.main import app, expand_many, main
from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import Problem

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
TESTED_ELSEWHERE = {
    "tables",
    "figures",
    "excite",
    "shootout",
    "fetch",
    "convert",
    "page",
    "verify",
}
ARM = """<robot name="my_arm">
  <link name="base"/><link name="column"/><link name="slider"/><link name="tool"/>
  <joint name="turn" type="continuous"><parent link="base"/><child link="column"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 1 0"/></joint>
  <joint name="slide" type="prismatic"><parent link="column"/><child link="slider"/>
    <origin xyz="0.2 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" velocity="1" effort="100"/></joint>
  <joint name="mount" type="fixed"><parent link="slider"/><child link="tool"/></joint>
</robot>"""


def test_the_two_commands_are_those_promised() -> None:
    assert BLOCKS[0][1].splitlines() == [
        "python3 -m venv .venv && .venv/bin/pip install -c constraints.txt . "
        "&& .venv/bin/sdp-vs-penalty tables",
        ".venv/bin/pip install -c constraints.txt '.[test]' && .venv/bin/pytest",
    ]


def test_ci_runs_the_readmes_test_command() -> None:
    script = (ROOT / ".ci" / "run").read_text()
    wanted = re.search(r'grep -m 1 -F "([^"]*)" README.md', script)
    assert wanted is not None
    found = [line for line in README.splitlines() if wanted[1] in line]
    assert found[0] == ".venv/bin/pip install -c constraints.txt '.[test]' && .venv/bin/pytest"
    assert 'eval "$command"' in script


def test_constraints_pin_exact_versions_and_name_no_host() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert pins
    for line in pins:
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.+!]+", line), line
    assert not re.search(r"://|--", "\n".join(lines))


def test_every_verb_is_shown() -> None:
    verbs = set(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
    left = verbs - {shlex.split(line)[1] for line in COMMANDS}
    assert not left, f"no command of the README shows {left}"


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_parse(line: str) -> None:
    """The command's own parser accepts every word, without running it."""
    _, verb, *words = expand_many(shlex.split(line))
    command = typer.main.get_command(app).commands[verb]  # type: ignore[attr-defined]
    command.make_context(verb, list(words))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, panda: Problem) -> Path:
    """The files that the README's examples name."""
    out = tmp_path_factory.mktemp("readme")
    for seed, name in enumerate(("run1.csv", "run2.csv", "test.csv")):
        write_run(out / name, panda, seed=seed)
    (out / "my_arm.urdf").write_text(ARM)
    save(small_run(load_problem(out / "my_arm.urdf")), out / "my_run.csv")
    return out


def test_commands_run_in_order(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """All but those that take long or need the network or another program's file."""
    monkeypatch.chdir(folder)
    for line in COMMANDS:
        words = shlex.split(line)[1:]
        if words[0] in TESTED_ELSEWHERE:
            continue
        with pytest.raises(SystemExit) as stop:
            main(words)
        assert stop.value.code == 0, f"{line}\n{capsys.readouterr().err}"
    assert (folder / "comparison.json").exists()


def test_the_python_runs(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (code,) = [text for language, text in BLOCKS if language == "python"]
    assert sum(1 for line in code.splitlines() if line.strip()) <= 11
    (folder / "example.py").write_text(code)
    monkeypatch.chdir(folder)
    runpy.run_path("example.py")
    assert "certified lower bound" in capsys.readouterr().out
    assert (folder / "model.json").exists()


def test_tables_equal_the_generated_ones() -> None:
    tool = runpy.run_path(str(ROOT / "tools" / "update_readme.py"))
    assert tool["with_results"](README, tool["headline"]()) == README
    assert tool["with_results"](README, tool["headline"]() + "\nchanged") != README
    for picture in re.findall(r"\]\((results/[^)]*)\)", README):
        assert (ROOT / picture).is_file()
