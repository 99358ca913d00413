"""No sentence of advice names a command: commands are written from a remedy's change."""

import ast
import re
from pathlib import Path

import pytest

import sdp_vs_penalty

ROOT = Path(sdp_vs_penalty.__file__).parent
FILES = sorted((ROOT / "checks").rglob("*.py"))
#: What a terminal takes, and no button does.
COMMAND = re.compile(r"`[^`]*`| --[a-z]")


def advice(path):
    """The texts that a file gives as ``remedy``: keyword arguments and variables."""
    found = []
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.keyword) and node.arg == "remedy":
            found.append(node.value)
        elif isinstance(node, ast.Assign):
            names = map(ast.unparse, node.targets)
            found += [node.value] * ("remedy" in names)
    parts = [part for value in found for part in ast.walk(value)]
    constants = [part.value for part in parts if isinstance(part, ast.Constant)]
    return [text for text in constants if isinstance(text, str)]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_no_advice_of_the_check_is_a_command(path):
    assert not [text for text in advice(path) if COMMAND.search(text)]


def test_there_is_advice_to_read():
    assert sum(len(advice(path)) for path in FILES) > 20
