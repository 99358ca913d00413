"""A file of the user's own brings plug-ins to every verb: --plugin."""

import json
import re
import shlex
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from commands import run_cli
from small_runs import write_run

from sdp_vs_penalty.api.registration import REGISTRIES, register_file
from sdp_vs_penalty.cli.verbs import diagnose
from sdp_vs_penalty.effects.written import WrittenEffect

THEIRS = Path(__file__).parents[1] / "testing" / "theirs" / "theirs"


@pytest.fixture
def file(tmp_path, monkeypatch):
    """An effect's file, of a name that no other test has; all is forgotten after it."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    for registry in REGISTRIES:
        monkeypatch.setattr(registry, "_registered", [])
    yield shutil.copy(THEIRS / "rubber.py", tmp_path / "my_rubber.py")
    sys.modules.pop("my_rubber", None)
    for registry in REGISTRIES:
        registry.forget()


def forget():
    """Be another process, which was not given the file."""
    for registry in REGISTRIES:
        registry._registered = []
        registry.forget()


def test_a_model_with_an_effect_of_a_file_names_the_file(
    two_link, file, tmp_path, capsys
):
    run = write_run(tmp_path / "run.csv", two_link)
    model = tmp_path / "model.json"
    words = ["identify", "two_link", "--data", run, "--out", model, "--no-check"]
    effects = ["--effects", "rigid_body,rubber_spring:2"]
    assert run_cli(*words, *effects, "--plugin", file) == 0
    (line,) = re.findall("^Next: (.*)$", capsys.readouterr().out, re.M)
    assert shlex.split(line)[-2:] == ["--plugin", str(file)]
    plugins = json.loads(model.read_text())["provenance"]["plugins"]
    assert plugins == {"rubber_spring": "my_rubber"}
    forget()
    assert run_cli("compare", model, "--data", run) == 2
    assert "name its file with --plugin" in capsys.readouterr().err
    assert run_cli("compare", model, "--data", run, "--plugin", file) == 0


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("json.py", "", "Python has another module json"),
        ("my-law.py", "", "not the name of a module of Python"),
        ("my_slip.py", "1 / 0", "ZeroDivisionError"),
        ("my_nothing.py", "x = 1", "no plug-in in it"),
        ("my_absent.py", None, "no such file"),
    ],
)
def test_a_file_that_brings_nothing_is_refused(
    name, text, words, file, tmp_path, capsys
):
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    assert run_cli("list", "effects", "--plugin", path) == 2
    assert words in capsys.readouterr().err
    if name != "json.py":
        sys.modules.pop(path.stem, None)


def test_several_files_follow_one_option(file, tmp_path, capsys):
    other = tmp_path / "my_drag.py"
    other.write_text(DRAG)
    assert run_cli("list", "effects", "--plugin", file, other) == 0
    printed = capsys.readouterr().out
    assert "rubber_spring" in printed
    assert "drag" in printed
    sys.modules.pop("my_drag")


#: An effect as a user writes it, whole.
DRAG = """
import numpy as np
from sdp_vs_penalty.effects.effect import JointEffect

class Drag(JointEffect):
    equation = "g |tau_l| dq"
    explanation = "Drag that grows with the load."
    reference = "a thesis"
    symbol = "f_drag"
    units = ("s/rad", "s/m")
    needs_links = True

    def column(self, motion, joint):
        return np.abs(motion.link_torque[:, joint]) * motion.dq[:, joint]
"""


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("need", "    needs_links = True\n", "", "write needs_links = True"),
        ("word", "    reference", "    # ", "Drag has no reference"),
        (
            "words",
            '    explanation = "Drag that grows with the load."\n    reference',
            "    # ",
            'has no explanation and reference: write explanation = "..."; reference',
        ),
        ("symbol", '"f_drag"', '"f_v"', "symbol 'f_v' is that of viscous_friction"),
        ("without", "    symbol", "    # ", "no attribute 'symbol'"),
        ("short", "[:, joint]\n", "[:, joint][1:]\n", "its columns cannot be computed"),
        ("length", "return ", "return np.ones(3) # ", "shape (3, 1) for 50 instants"),
        (
            "width",
            "return ",
            "return motion.q[:, :2] # ",
            "14 columns, but 7 parameters",
        ),
    ],
)
def test_a_broken_effect_is_one_sentence_before_anything_runs(
    name, old, new, words, file, tmp_path, capsys
):
    path = tmp_path / f"my_broken_{name}.py"
    path.write_text(DRAG.replace(old, new, 1 if name != "short" else -1))
    assert run_cli("diagnose", "no.json", "--data", "no.csv", "--plugin", path) == 2
    error = capsys.readouterr().err
    assert f"{path}: effect Drag" in error
    assert words in error
    assert "internal error" not in error
    sys.modules.pop(path.stem)


@pytest.mark.parametrize(
    ("named", "in_model", "words"),
    [
        ((), (), "Your effect rubber spring was tried"),
        (("rubber_spring",), (), ""),
        ((), ("rubber_spring",), ""),
    ],
)
def test_a_diagnosis_says_what_became_of_ones_own_effect(
    named, in_model, words, file, capsys
):
    register_file(Path(file))
    finding = SimpleNamespace(
        effect="viscous_friction", rivals=[*map(WrittenEffect, named)]
    )
    result = SimpleNamespace(effects=(finding,), invisible=())
    diagnose._say_what_became_of_plugins(result, set(in_model))
    printed = " ".join(capsys.readouterr().out.split())
    assert words in printed
    assert bool(words) == bool(printed)
