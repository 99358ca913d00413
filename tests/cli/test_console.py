"""What every command can do with what it prints: as JSON, not at all, in a narrow
terminal, completed by the shell."""

import json
import shutil
import subprocess

import pytest
from commands import run_cli
from small_runs import write_run

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.cli.console import TimeLeft
from sdp_vs_penalty.cli.main import VERBS
from sdp_vs_penalty.results import Table

WIDE = Table(
    ["joint", *(f"figure {k}" for k in range(12))],
    [[f"joint{j}", *(f"{1000 * j + k}.25" for k in range(12))] for j in range(3)],
    title="All figures",
)


def test_quiet_prints_nothing(two_link, tmp_path, capsys):
    run = write_run(tmp_path / "run.csv", two_link)
    assert run_cli("check", "two_link", "--data", run, "--quiet") == 0
    assert run_cli("list", "problems", "-q") == 0
    assert capsys.readouterr().out == ""


def test_quiet_still_names_an_error(capsys):
    assert run_cli("list", "effects", "no_such_effect", "-q") == 2
    assert "no_such_effect" in capsys.readouterr().err


def test_quiet_ends_with_its_command(capsys):
    run_cli("list", "problems", "-q")
    run_cli("list", "problems")
    assert "two_link" in capsys.readouterr().out


def test_any_command_writes_what_it_says_as_json(two_link, tmp_path, capsys):
    run = write_run(tmp_path / "run.csv", two_link)
    model = tmp_path / "model.json"
    out = tmp_path / "said.json"
    words = ["identify", "two_link", "--data", run, "--out", model, "--json", out]
    assert run_cli(*words) == 0
    content = json.loads(out.read_text())
    assert content["command"] == ["sdp-vs-penalty", *map(str, words)]
    assert content["exit_code"] == 0
    assert content["written"] == [str(model)]
    assert content["next"][0].startswith("sdp-vs-penalty diagnose")
    assert content["tables"][0]["headings"]
    printed = capsys.readouterr().out
    assert all(
        sentence.split()[0].strip(":") in printed for sentence in content["sentences"]
    )


def test_simulate_writes_what_it_hides_as_json(tmp_path):
    out = tmp_path / "said.json"
    words = ["--hide", "joint_spring:2", "--out", tmp_path / "runs", "--json", out]
    assert run_cli("simulate", "two_link", *words) == 0
    truth = (tmp_path / "runs/truth.json").read_text()
    assert json.loads(out.read_text()) == json.loads(truth)


def test_quiet_leaves_hints_out(two_link, tmp_path, capsys):
    run = write_run(tmp_path / "run.csv", two_link)
    model, proof = tmp_path / "model.json", tmp_path / "proof.json"
    words = ["--data", run, "--out", model, "--proof", proof]
    run_cli("identify", "two_link", *words, "--quiet")
    capsys.readouterr()
    assert run_cli("verify", proof, "--quiet") == 0
    assert capsys.readouterr().err == ""


def test_a_refusal_leaves_the_old_json(tmp_path):
    out = tmp_path / "said.json"
    out.write_text("old")
    missing = tmp_path / "no.json"
    assert run_cli("export", missing, "--out", tmp_path / "a.urdf", "--json", out) == 2
    assert out.read_text() == "old"


def shown(monkeypatch, capsys, width, is_terminal):
    """The lines of the wide table."""
    monkeypatch.setattr(console.out(), "_width", width)
    monkeypatch.setattr(console.out(), "_force_terminal", is_terminal)
    monkeypatch.setattr(console.out(), "no_color", True)
    console.table(WIDE)
    return capsys.readouterr().out.splitlines()


@pytest.mark.parametrize("width", [30, 40, 60, 80, 100])
def test_a_narrow_terminal_shows_every_figure(width, monkeypatch, capsys):
    lines = shown(monkeypatch, capsys, width, is_terminal=True)
    words = {word for line in lines for word in line.split()}
    assert {f"{1000 * j + k}.25" for j in range(3) for k in range(12)} <= words


def test_a_pipe_gets_every_row_on_one_line(monkeypatch, capsys):
    lines = shown(monkeypatch, capsys, 80, is_terminal=False)
    assert sum(line.startswith("joint") for line in lines) == 4
    assert "2011.25" in lines[-1]


def test_a_table_that_fits_stays_one_block(monkeypatch, capsys):
    lines = shown(monkeypatch, capsys, 200, is_terminal=True)
    assert sum(line.startswith("joint") for line in lines) == 4


def test_the_time_left_follows_the_pace():
    now = [0.0]
    remaining = TimeLeft(clock=lambda: now[0])
    assert remaining.with_time_left("run 1 of 11") == "run 1 of 11"
    now[0] = 20.0
    left = remaining.with_time_left("run 3 of 11")
    assert left == "run 3 of 11, about 1 min 20 s left"
    now[0] = 30.0
    assert remaining.with_time_left("fold 4 of 9") == "fold 4 of 9"


@pytest.mark.parametrize("text", ["reading", "3 of 9 done, about 7 s left"])
def test_texts_without_a_count_or_with_a_time_stay(text):
    remaining = TimeLeft(clock=lambda: 0.0)
    remaining.with_time_left("1 of 9 done")
    assert remaining.with_time_left(text) == text


def test_bash_completes_every_verb_and_option(capsys):
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("no bash")
    assert run_cli("completion", "bash") == 0
    script = capsys.readouterr().out
    tries = "for w in '' 'compare --gra' 'list eff'; do COMP_WORDS=(sdp-vs-penalty $w);"
    tries += " [ -z \"$w\" ] && COMP_WORDS+=('');"
    tries += " COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); COMPREPLY=();"
    tries += ' _shtab_sdp_vs_penalty; echo "${COMPREPLY[@]}"; done'
    done = subprocess.run(
        [bash, "--norc", "-c", f"{script}\n{tries}"], capture_output=True, text=True
    )
    verbs, option, kind = done.stdout.splitlines()
    assert {verb for some in VERBS.values() for verb in some} <= set(verbs.split())
    assert (option, kind) == ("--gravity", "effects")
