"""A file of the user's own brings plug-ins to every verb: --plugin."""

import json
import shutil
import sys
from pathlib import Path

import pytest
from commands import run_cli
from small_runs import write_run

from sdp_vs_penalty.api.registration import REGISTRIES

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
