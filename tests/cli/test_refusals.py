"""Commands that cannot be: one sentence, which is kept; nothing is written, and old
files stay."""

import json
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import run_cli
from recorded import refusals, same_refusal
from servo_log import log, write_slide
from small_runs import small_run, write_run

from sdp_vs_penalty import Problem, identify
from sdp_vs_penalty.data import save
from tests.cli.test_printed_commands import TWELVE, told


@pytest.fixture(scope="module")
def folder(
    two_link: Problem,
    panda: Problem,
    tmp_path_factory: pytest.TempPathFactory,
) -> Path:
    """Runs and models of two robots, a run in degrees, findings that are sound, weak,
    old or none."""
    home = tmp_path_factory.mktemp("refused")
    for k in (1, 2):
        write_run(home / f"run{k}.csv", two_link, seed=k)
    degrees = small_run(two_link, seed=1)
    save(replace(degrees, q=np.degrees(degrees.q)), home / "degrees.csv")
    save(run := small_run(panda), home / "panda.csv")
    identify(panda, run, "ols", effects="rigid_body").save(home / "rigid.json")
    identify(two_link, small_run(two_link), "ols").save(home / "model.json")
    found = told(panda, TWELVE)
    weak = replace(
        found, effects=tuple(replace(f, confidence="weak") for f in found.effects)
    )
    named = {
        "findings": found,
        "none": replace(found, effects=()),
        "weak": weak,
    }
    for name, findings in named.items():
        (home / f"{name}.json").write_text(json.dumps(findings.to_dict()))
    (home / "old.json").write_text(
        json.dumps(found.to_dict()).replace('"text"', '"txet"')
    )
    (home / "kept.json").write_text("old")
    save(log(), home / "silent.csv")
    write_slide(home)
    return home


@pytest.mark.parametrize("line", refusals("commands"))
def test_a_command_is_refused(line, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    before = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert run_cli(*shlex.split(line)) == 2
    said = capsys.readouterr().err
    assert said.startswith("sdp-vs-penalty: ")
    assert same_refusal("commands", line, said.rstrip("\n"))
    assert {path: path.stat().st_mtime_ns for path in folder.iterdir()} == before
