"""Errors are data: whoever raises one says what to do about it."""

import ast
from pathlib import Path

import sdp_vs_penalty

ROOT = Path(sdp_vs_penalty.__file__).parent
#: A worker of the page hands its error on as the one sentence that it is.
HANDED_ON = {"page/worker.py"}


def test_every_error_has_a_remedy():
    without, calls = [], 0
    for path in sorted(ROOT.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in (
                "InputError",
                "Infeasible",
            ):
                calls += 1
                remedy = [k.value for k in node.keywords if k.arg == "remedy"] + node.args[1:2]
                if not remedy or (isinstance(remedy[0], ast.Constant) and not remedy[0].value):
                    without.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert calls > 200
    assert [place for place in without if place.partition(":")[0] not in HANDED_ON] == []
