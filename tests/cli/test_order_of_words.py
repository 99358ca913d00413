"""Every verb takes its problem or model first; the order before version 0.1 is taken
once more."""

import json

import pytest
from commands import run_cli
from small_runs import write_run

from sdp_vs_penalty import InputError
from sdp_vs_penalty.cli.main import VERBS, named
from sdp_vs_penalty.cli.options import Parser
from sdp_vs_penalty.errors import Remark

PARSERS = {
    verb: Parser(verb, named(verb)) for verbs in VERBS.values() for verb in verbs
}
WITH_DATA = [verb for verb, parser in PARSERS.items() if "data" in parser.options]


@pytest.mark.parametrize("verb", WITH_DATA)
def test_runs_stand_behind_data(verb):
    parser = PARSERS[verb]
    assert parser.options["data"].option_strings == ["--data"]
    first = next(iter(parser.options.values()))
    assert first.option_strings == []


@pytest.mark.parametrize("verb", PARSERS)
def test_every_verb_has_quiet_and_json(verb):
    flags = PARSERS[verb].format_help()
    assert "--quiet, -q" in flags
    assert "--json out.json" in flags


@pytest.mark.parametrize(
    "words",
    [
        "a.csv b.csv --problem p",
        "--problem p a.csv b.csv",
        "a.csv --problem=p b.csv",
        "a.csv b.csv --json=o.json --problem p",
        "--json o.json --problem p a.csv b.csv",
        "a.csv b.csv --problem p --fix f --apply sign:tau1 gain:tau2",
        "a.csv b.csv --apply sign:tau1 gain:tau2 --fix f --problem p",
        "a.csv b.csv --gravity -9.81,0,0 --problem p",
    ],
)
def test_the_order_before_0_1_is_taken_with_a_remark(words):
    with pytest.warns(Remark, match=r"write `check PROBLEM --data RUN.csv"):
        arguments = PARSERS["check"].given(words.split())
    assert arguments["problem"] == "p"
    assert [str(path) for path in arguments["data"]] == ["a.csv", "b.csv"]
    if "--apply" in words:
        assert arguments["apply"] == ["sign:tau1", "gain:tau2"]
        assert str(arguments["fix"]) == "f"


def test_the_order_before_0_1_without_a_run_is_refused():
    with pytest.warns(Remark), pytest.raises(InputError, match="--data"):
        PARSERS["check"].given(["--problem", "p"])


def test_a_model_is_judged_as_mounted_by_gravity(two_link, tmp_path, capsys):
    """The same arm on a wall: its model errs without --gravity, and is right with it."""
    floor = write_run(tmp_path / "floor.csv", two_link, seconds=10.0)
    turned = two_link.with_gravity([6.0, 7.76, 0.0])
    wall = write_run(tmp_path / "wall.csv", turned, seconds=10.0, seed=1)
    model = tmp_path / "model.json"
    out = tmp_path / "out.json"
    assert run_cli("identify", "two_link", "--data", floor, "--out", model) == 0
    errors = []
    for mounting in ([], ["--gravity", "6,7.76,0"]):
        words = ["compare", model, "--data", wall, "--json", out, *mounting]
        assert run_cli(*words) == 0
        errors.append(
            json.loads(out.read_text())["models"][0]["relative_error_percent"]
        )
    assert errors[1] < 0.2 * errors[0]
    said = capsys.readouterr().out.splitlines()[-1]
    assert "--gravity 6,7.76,0" in said
