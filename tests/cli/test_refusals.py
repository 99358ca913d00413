"""Commands that cannot be: one sentence, which is kept; nothing is written, and old
files stay."""

import json
import shlex
from dataclasses import replace

import numpy as np
import pytest
from commands import run_cli
from recorded import refusals, same_refusal
from servo_log import log, write_slide
from small_runs import small_model, small_run, write_run

from sdp_vs_penalty import identify
from sdp_vs_penalty.cli import main
from sdp_vs_penalty.data import save
from sdp_vs_penalty.diagnosis.doubts import Doubt
from tests.cli.test_printed_commands import TWELVE, told


@pytest.fixture(scope="module")
def folder(two_link, panda, tmp_path_factory):
    """Runs and models of two robots, a run in degrees, findings that are sound, weak,
    old or none."""
    home = tmp_path_factory.mktemp("refused")
    for k in (1, 2):
        write_run(home / f"run{k}.csv", two_link, seed=k)
    degrees = small_run(two_link, seed=1)
    save(replace(degrees, q=np.degrees(degrees.q)), home / "degrees.csv")
    save(run := small_run(panda), home / "panda.csv")
    identify(panda, run, "ols", effects="rigid_body", check=False).save(
        home / "rigid.json"
    )
    small_model("ols").save(home / "model.json")
    found = told(panda, TWELVE)
    weak = replace(
        found,
        effects=tuple(replace(f, doubts=(Doubt("small"),)) for f in found.effects),
    )
    named = {"findings": found, "none": replace(found, effects=()), "weak": weak}
    for name, findings in named.items():
        (home / f"{name}.json").write_text(json.dumps(findings.to_dict()))
    (home / "old.json").write_text(
        json.dumps(found.to_dict()).replace('"text"', '"txet"')
    )
    (home / "kept.json").write_text("old")
    save(log().window(0.0, 3.0), home / "silent.csv")
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


#: Of each verb that works for long: a command whose output is the file {out}.
LONG_COMMANDS = (
    "identify two_link --data run1.csv --out {out}",
    "identify two_link --data run1.csv --out new.json --proof {out}",
    "diagnose model.json --data run1.csv --json {out}",
    "add model.json joint_spring:1 --data run1.csv --out {out}",
    "report model.json --data run1.csv --out {out}",
    "compare model.json --data run1.csv --json {out}",
    "check two_link --data run1.csv --json {out}",
    "simulate two_link --out {out}/runs",
    "convert run1.csv --out {out}",
)


@pytest.mark.parametrize(
    ("line", "out", "words"),
    [
        *((x, "kept.json/a.html", "written (Not a directory)") for x in LONG_COMMANDS),
        *((x, ".", "it is a folder") for x in LONG_COMMANDS if "runs" not in x),
    ],
)
def test_an_output_that_cannot_be_written_is_found_before_the_work(
    line, out, words, folder, monkeypatch, capsys
):
    """The place lies within a file, or is a folder. No verb is started, so nothing is in
    vain."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(main, "_transcribed", lambda *_: pytest.fail("work began"))
    assert run_cli(*shlex.split(line.format(out=out))) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert words in said


def test_a_folder_that_is_missing_is_made(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    out = tmp_path / "new" / "deep" / "run.csv"
    assert run_cli("convert", "run1.csv", "--out", str(out)) == 0
    assert out.exists()
