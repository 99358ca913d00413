"""Every verb, its help and its example are of one piece; the documentation runs the
verbs."""

import inspect
import re
import shlex
from pathlib import Path

import pytest

import sdp_vs_penalty
from sdp_vs_penalty import InputError
from sdp_vs_penalty.cli.main import VERBS, import_verb, main
from sdp_vs_penalty.cli.options import Parser

ROOT = Path(sdp_vs_penalty.__file__).parent
PARSERS = {
    verb: Parser(verb, import_verb(verb)) for verbs in VERBS.values() for verb in verbs
}
EXAMPLES = {
    verb: re.findall(r"Example:\n  (.*)", parser.epilog)
    for verb, parser in PARSERS.items()
}


def test_every_file_of_verbs_is_in_the_programs_help(capsys):
    files = {
        path.stem.replace("_", "-")
        for path in (ROOT / "cli" / "verbs").glob("[!_]*.py")
    }
    assert set(EXAMPLES) == files, (
        "VERBS of cli/main.py names each file of cli/verbs, and no other"
    )
    with pytest.raises(SystemExit):
        main(["--help"])
    lines = capsys.readouterr().out.splitlines()
    left = files - {line.split()[0] for line in lines if line.startswith("  ")}
    assert not left, f"{left} begin with no line for the help"
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize("verb", sorted(EXAMPLES))
def test_a_verb_has_the_summary_of_its_docstring_and_one_example_that_parses(verb):
    summaries = {name: line for verbs in VERBS.values() for name, line in verbs.items()}
    first, _, _ = str(import_verb(verb).__doc__).partition("\n\n")
    assert summaries[verb] == " ".join(first.split())
    assert len(EXAMPLES[verb]) == 1, (
        f"{verb}: one line 'Example: sdp-vs-penalty ...' in the docstring"
    )
    (example,) = EXAMPLES[verb]
    program, called, *words = shlex.split(example)
    assert (program, called) == ("sdp-vs-penalty", verb)
    PARSERS[verb].parse_words(words)


def test_values_that_a_verb_begins_with_are_those_of_its_function():
    told = 0
    for verb in EXAMPLES:
        function = getattr(sdp_vs_penalty, verb.replace("-", "_"), None)
        theirs = (
            inspect.signature(function).parameters
            if inspect.isroutine(function)
            else {}
        )
        for name, own in inspect.signature(import_verb(verb)).parameters.items():
            if name in theirs and own.default not in (None, own.empty):
                told += 1
                assert own.default == pytest.approx(theirs[name].default), (verb, name)
    assert told > 10


def test_a_flag_is_given_by_its_name_and_taken_back_where_it_holds_by_itself():
    page = PARSERS["page"]
    export = PARSERS["export"]
    assert [page.parse_words(words)["browser"] for words in ([], ["--no-browser"])] == [
        True,
        False,
    ]
    words = ["m.json", "--out", "a.urdf"]
    assert [
        export.parse_words([*words, *more])["force"] for more in ([], ["--force"])
    ] == [False, True]
    with pytest.raises(InputError, match="did you mean --force"):
        export.parse_words([*words, "--no-force"])
