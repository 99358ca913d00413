"""An effect says everything of itself: no other folder knows one by its name."""

import ast
import re
from pathlib import Path

import pytest

import sdp_vs_penalty
from sdp_vs_penalty.effects import effect_types

ROOT = Path(sdp_vs_penalty.__file__).parent
#: Who chooses effects as a user does: the paper's models, the demo's hidden effect, and
#: the worlds that state torques a second time, against which columns are tested.
USERS = ("effects", "paper", "simulation/worlds", "reports/demo.py")
#: Names that a sentence may hold as plain words count where a value is compared alone.
NAMES = {name for name in effect_types() if "_" in name}
WORDS = {name for name in effect_types() if "_" not in name}
CLASSES = {kind.__name__ for kind in effect_types().values()}
IN_TEXT = re.compile(rf"(?<![\w}}])({'|'.join(sorted(NAMES))})(?!\w)")
FILES = [
    path
    for path in sorted(ROOT.rglob("*.py"))
    if not path.relative_to(ROOT).as_posix().startswith(USERS)
]
#: What no file without it can know an effect by.
ANY = re.compile("|".join([*NAMES, *WORDS, *CLASSES]))


def names_of_effects(tree):
    """Names and classes of effects in code; docstrings and comments may name them."""
    docstrings = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and isinstance(node.body[0], ast.Expr)
    }
    found = set[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) not in docstrings:
                found |= set(IN_TEXT.findall(node.value))
        elif isinstance(node, ast.Compare):
            found |= _compared_with_names(node)
        elif isinstance(node, ast.Name | ast.Attribute | ast.alias):
            word = (
                getattr(node, "id", "")
                or getattr(node, "attr", "")
                or getattr(node, "name", "")
            )
            found |= {word} & CLASSES
    return found


def _compared_with_names(node):
    """Names without an underscore, as in ``effect.name == "payload"``."""
    sides = [node.left, *node.comparators]
    attributes = {side.attr for side in sides if isinstance(side, ast.Attribute)}
    texts = {side.value for side in sides if isinstance(side, ast.Constant)}
    return texts & WORDS if attributes & {"name", "effect", "text"} else set()


def test_no_other_folder_knows_an_effect_by_its_name():
    texts = {path: path.read_text("utf-8") for path in FILES}
    named = {path: text for path, text in texts.items() if ANY.search(text)}
    found = {path: names_of_effects(ast.parse(text)) for path, text in named.items()}
    assert not {str(path): names for path, names in found.items() if names}


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("if effect.name == 'stiction': pass", {"stiction"}),
        ("parse('rigid_body,joint_spring:2@k=1')", {"rigid_body", "joint_spring"}),
        ("from x import Payload", {"Payload"}),
        ("links.BaseTilt(robot)", {"BaseTilt"}),
        ("'the torque there is stiction'", set()),
        ("def f():\n    '''Like coulomb_friction.'''", set()),
    ],
)
def test_the_test_sees_names(code, found):
    assert names_of_effects(ast.parse(code)) == found
