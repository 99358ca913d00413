"""Every verb takes its problem or model first."""

import json

import pytest
from commands import run_cli
from small_runs import write_run

from sdp_vs_penalty.cli.main import VERBS, import_verb
from sdp_vs_penalty.cli.options import Parser
from sdp_vs_penalty.errors import InputError

PARSERS = {
    verb: Parser(verb, import_verb(verb)) for verbs in VERBS.values() for verb in verbs
}


@pytest.mark.parametrize("verb", PARSERS)
def test_every_verb_has_quiet_and_json_and_its_runs_behind_data(verb):
    flags = PARSERS[verb].format_help()
    assert "--quiet, -q" in flags
    assert "--json out.json" in flags
    if data := PARSERS[verb].options.get("data"):
        assert data.option_strings == ["--data"]
        first = next(iter(PARSERS[verb].options.values()))
        assert first.option_strings == []


def test_runs_may_stand_behind_one_problem_or_model():
    """Words behind it, and those of --data, are runs; one is needed."""
    words = ["panda", "a.csv", "--out", "m.json", "--data", "b.csv"]
    runs = PARSERS["identify"].parse_words(words)["data"]
    assert [str(run) for run in runs] == ["b.csv", "a.csv"]
    with pytest.raises(
        InputError, match=r"no measured run is named .* --data run1\.csv"
    ):
        PARSERS["diagnose"].parse_words(["model.json"])
    assert PARSERS["ranges"].parse_words(["model.json"])["data"] is None


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
