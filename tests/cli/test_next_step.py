"""The command to run next: of files that exist, with nothing of a stranger's options,
and it runs."""

import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from commands import run_cli
from small_runs import small_run

import sdp_vs_penalty as sdp
from sdp_vs_penalty.cli.main import import_verb
from sdp_vs_penalty.cli.next_step import free_name, say_what_follows
from sdp_vs_penalty.cli.options import Parser
from sdp_vs_penalty.cli.runs import NamedRuns
from sdp_vs_penalty.cli.verbs.check import _say_identify
from sdp_vs_penalty.data import save


def next_words(printed):
    """The words of the printed command behind the program's name; none without one."""
    lines = re.findall("^Next: sdp-vs-penalty (.*)$", printed, re.MULTILINE)
    assert len(lines) <= 1, printed
    return shlex.split(lines[0]) if lines else []


def followed(words, capsys):
    """Run a command, what it prints to run next, and so on; all of these commands."""
    commands = []
    while words and words[0] not in [command[0] for command in commands]:
        commands.append(words)
        code = run_cli(*words)
        printed = capsys.readouterr()
        assert code == 0, f"{words}\n{printed.out}{printed.err}"
        words = next_words(printed.out)
    return commands


@pytest.fixture(scope="module")
def folder(two_link, tmp_path_factory):
    """Two runs of training, one that is new, and a model of the first two."""
    home = tmp_path_factory.mktemp("next")
    seconds = {"run 1.csv": 10.0, "-run2.csv": 10.0, "new.csv": 2.5}
    for k, name in enumerate(seconds):
        save(small_run(two_link, seconds=seconds[name], seed=k), home / name)
    runs = sdp.load_measurements(home / "run 1.csv", home / "-run2.csv")
    sdp.identify(two_link, runs, "ols").save(home / "model.json")
    return home


@pytest.fixture
def inside(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return folder


RECORDED = ["run 1.csv", "./-run2.csv"]
TRAIN = "--data 'run 1.csv' ./-run2.csv"


@pytest.mark.parametrize(
    ("recorded", "options"),
    [
        # The run that judged stays unseen.
        (RECORDED, TRAIN),
        # Runs that are not there, and what is no run, are not named.
        (["gone.csv"], "--data new.csv"),
        ([], "--data new.csv"),
        (["run 1.csv", "--json", "victim.json"], "--data new.csv"),
        (["--json"], "--data new.csv"),
        (["run 1.csv", "--window", "--json"], "--data new.csv"),
        (["run 1.csv", "--window", "0:5"], "--data 'run 1.csv' --window 0:5"),
    ],
)
def test_a_diagnosis_is_of_runs_that_exist(recorded, options, inside, capsys):
    estimate = sdp.load_estimate("model.json")
    estimate.provenance["data"] = recorded
    say_what_follows("model.json", estimate, None, NamedRuns([Path("new.csv")]))
    printed = capsys.readouterr().out
    expected = f"diagnose model.json {options} --json findings.json"
    assert next_words(printed) == shlex.split(expected)
    assert ("unseen no longer" in printed) == ("new.csv" in options)


@pytest.mark.parametrize(
    ("given", "train", "kept"),
    [
        ("run1 run2 test new", "run1 run2", "test.csv and new.csv"),
        ("run1 run2 test", "run1 run2", "test.csv"),
        ("run1 run2", "run1", "run2.csv"),
        ("test run1", "run1", "test.csv"),
        ("run1", "run1", ""),
        ("test", "test", ""),
    ],
)
def test_the_last_of_several_runs_is_kept_to_judge(given, train, kept, capsys):
    given, train = ([Path(f"{x}.csv") for x in y.split()] for y in (given, train))
    _say_identify(given, "two_link", [])
    printed = capsys.readouterr().out
    assert next_words(printed)[3:-2] == [*map(str, train)]
    assert re.findall("judge the model: (.*)[.]", printed) == [kept] * bool(kept)


def test_nothing_is_diagnosed_where_nothing_is_missing(inside, capsys):
    estimate = sdp.load_estimate("model.json")
    verdict = estimate.verdict
    lines = tuple(replace(line, grade="good") for line in verdict.lines)
    nothing_missing = replace(verdict, lines=lines)
    say_what_follows(
        "model.json", estimate, nothing_missing, NamedRuns([Path("new.csv")])
    )
    assert next_words(capsys.readouterr().out)[0] == "report"


def test_the_findings_of_another_model_stay(inside, capsys):
    estimate = sdp.load_estimate("model.json")
    Path("findings.json").write_text("of another model")
    try:
        say_what_follows("model.json", estimate, None, NamedRuns([Path("new.csv")]))
    finally:
        Path("findings.json").unlink()
    assert next_words(capsys.readouterr().out)[-1] == "findings2.json"


def test_a_name_is_free(tmp_path):
    assert free_name(tmp_path / "model.json") == tmp_path / "model.json"
    for name in ("model.json", "model3.json", "model_x.json"):
        (tmp_path / name).touch()
    assert free_name(tmp_path / "model.json") == tmp_path / "model4.json"
    assert free_name(tmp_path / "model3.json") == tmp_path / "model4.json"


def test_recorded_runs_are_the_words_again(inside):
    for as_written in (False, True):
        named = NamedRuns([Path("run 1.csv")], "0:1,2:3", as_written)
        assert NamedRuns.recorded(named.words) == named


def test_commands_that_follow_each_other_run(inside, capsys):
    """From a file to the last command that is printed; what `simulate` and `compare`
    print is run in test_printed_commands.py."""
    words = ["convert", "run 1.csv", "--problem", "two_link", "--out=./-a.csv"]
    commands = followed(words, capsys)
    assert [command[0] for command in commands[:3]] == ["convert", "check", "identify"]


@pytest.mark.parametrize(
    "words",
    [
        "simulate model.json --follow new.csv",
        "cross-validate two_link --data ./-run2.csv --method ols",
    ],
)
def test_what_follows_parses(words, inside, capsys):
    assert run_cli(*words.split()) == 0
    verb, *rest = next_words(capsys.readouterr().out)
    Parser(verb, import_verb(verb)).parse_words(rest)
