"""Renderers lay out facts and compute none: read from their syntax trees.

A number that a person reads is computed by one method of one record. What prints it,
a verb's printing, a stage of the page, a template, has no arithmetic and no NumPy.
"""

import ast
from pathlib import Path

import jinja2
import pytest
from jinja2 import nodes

import sdp_vs_penalty

ROOT = Path(sdp_vs_penalty.__file__).parent
PRINTING = [ROOT / "cli" / "printing.py", ROOT / "cli" / "console.py"]
STAGES = sorted((ROOT / "page" / "stages").glob("*.py"))
TEMPLATES = sorted(ROOT.rglob("*.html"))
#: Operators of numbers; + joins texts and lists, so it counts beside a number only.
OPERATORS = (ast.Sub, ast.Mult, ast.Div, ast.FloorDiv, ast.Mod, ast.Pow)
#: Functions that make a number of numbers. `len` counts, and `round` is a computation.
FUNCTIONS = {"sum", "min", "max", "abs", "round", "divmod", "pow"}


def arithmetic(path):
    """Expressions of a Python file that compute with numbers."""
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.BinOp) and is_arithmetic(node):
            found.append(ast.unparse(node))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") in FUNCTIONS:
            found.append(ast.unparse(node))
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names]
            module = getattr(node, "module", None) or ""
            if "numpy" in (*names, module.split(".")[0]):
                found.append(ast.unparse(node))
    return found


def is_arithmetic(node):
    """Whether an operator works on numbers, as far as its syntax shows."""
    sides = (node.left, node.right)
    texts = [
        isinstance(side, ast.JoinedStr | ast.List | ast.ListComp)
        or (isinstance(side, ast.Constant) and isinstance(side.value, str))
        for side in sides
    ]
    if any(texts):
        return False
    numbers = [
        isinstance(side, ast.Constant) and isinstance(side.value, int | float)
        for side in sides
    ]
    return isinstance(node.op, OPERATORS) or (
        isinstance(node.op, ast.Add) and any(numbers)
    )


@pytest.mark.parametrize("path", [*PRINTING, *STAGES], ids=lambda path: path.name)
def test_a_renderer_computes_nothing(path):
    assert arithmetic(path) == []


@pytest.mark.parametrize("path", TEMPLATES, ids=lambda path: path.stem)
def test_a_template_computes_nothing(path):
    tree = jinja2.Environment().parse(path.read_text())
    computed = (
        nodes.Add,
        nodes.Sub,
        nodes.Mul,
        nodes.Div,
        nodes.FloorDiv,
        nodes.Mod,
        nodes.Pow,
    )
    assert not list(tree.find_all(computed))
    filters = {node.name for node in tree.find_all(nodes.Filter)}
    assert filters <= {"code", "join", "sentence"}


@pytest.mark.parametrize(
    "code", ["x = a * b", "x = a / 2", "x = k + 1", "x = sum(y)", "import numpy as np"]
)
def test_arithmetic_is_seen(code, tmp_path):
    """The rule itself: what it must not let pass."""
    path = tmp_path / "renderer.py"
    path.write_text(code)
    assert arithmetic(path)


@pytest.mark.parametrize("code", ["x = ['a'] + b", "x = f'{a}' + b", "x = len(y)"])
def test_texts_and_lists_may_be_joined(code, tmp_path):
    path = tmp_path / "renderer.py"
    path.write_text(code)
    assert not arithmetic(path)
