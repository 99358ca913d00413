"""Which findings a command adds, and what it says of the weak ones among them."""

import json
import re
import shutil
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from commands import run_cli
from small_runs import small_model, write_run

from sdp_vs_penalty import InputError
from sdp_vs_penalty.diagnosis import Curve
from sdp_vs_penalty.diagnosis.doubts import REASONS, Doubt
from sdp_vs_penalty.diagnosis.finding import Retune
from sdp_vs_penalty.estimation.verdict import ErrorsBesideNoise
from tests.cli.test_printed_commands import told

UNCERTAIN, SMALL = "uncertain", "small"


@pytest.fixture(scope="module")
def home(two_link, tmp_path_factory):
    """A folder with run.csv and the model of it."""
    folder = tmp_path_factory.mktemp("home")
    write_run(folder / "run.csv", two_link)
    small_model("ols").save(folder / "model.json")
    return folder


@pytest.fixture
def run(home, tmp_path, monkeypatch, capsys):
    """Run a command beside run.csv and model.json; what it printed, on one line."""
    shutil.copytree(home, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)

    def call(*words):
        assert run_cli(*words) == 0
        return " ".join(capsys.readouterr().out.split())

    return call


def springs(problem, *doubts):
    """A joint spring found on each joint in turn: confident for "", else weak for this
    reason."""
    names = [f"joint_spring:{j}" for j, _ in enumerate(doubts, start=1)]
    found = told(problem, names)
    effects = tuple(
        replace(f, doubts=(Doubt(doubt),)) if doubt else f
        for f, doubt in zip(found.effects, doubts, strict=True)
    )
    return replace(found, effects=effects)


def curve(joint):
    """A curve of missing torque over the joint's position."""
    x = np.linspace(-0.5, 0.5, 9)
    y = x**2
    return Curve(joint, (f"q{joint}",), x, y, y - 0.1, y + 0.1, 0.9, None, 0.2, 0.1)


def with_curve(found, joint):
    """With a curve on a joint (from 1), which replaces the finding there."""
    effects = tuple(
        replace(f, doubts=(*f.doubts, Doubt("curve"))) if f.joints == (joint,) else f
        for f in found.effects
    )
    return replace(found, effects=effects, curves=(curve(joint),))


def add(run, found, *options):
    """Add the findings of a file to the model, and return what is printed."""
    Path("findings.json").write_text(json.dumps(found.to_dict()))
    words = (
        "--from",
        "findings.json",
        *options,
        "--data",
        "run.csv",
        "--out",
        "m.json",
    )
    return run("add", "model.json", *words)


@pytest.mark.parametrize("doubts", [("", UNCERTAIN), (SMALL, UNCERTAIN)])
def test_confident_says_which_weak_findings_it_takes_and_why(doubts, run, two_link):
    """Beside a sure finding, and where there is none."""
    said = add(run, springs(two_link, *doubts), "--helpful")
    assert (
        "added, since the error on data left out falls with it: joint spring on joint 2"
        " is weak"
        f" ({REASONS[UNCERTAIN].sentence})"
    ) in said
    assert "--only" in said
    assert REASONS[SMALL].sentence not in said


def test_only_takes_no_constant_along_and_says_how_to_add_it(run, two_link):
    sure = Retune(
        "coulomb_friction",
        1,
        "v_s",
        before=0.01,
        after=0.016,
        rmse_before=1.0,
        rmse_after=0.5,
        explanation="it is wider",
    )
    found = replace(springs(two_link, "", SMALL), retuned=(sure,))
    for options, is_added in {"--helpful": True, "--only=1": False}.items():
        said = add(run, found, options)
        assert ("re-estimated constant: joint 1" in said) == is_added
        assert (f"not added: {sure.text} (it has no number" in said) != is_added


def test_confident_says_nothing_of_weak_findings_where_all_are_sure(run, two_link):
    assert "weak" not in add(run, springs(two_link, "", ""), "--helpful")


def test_sizes_are_printed_of_what_was_added(run, two_link):
    """A finding that a measured curve replaces is not in the model: it has no size."""
    found = with_curve(springs(two_link, "", SMALL), 2)
    said = add(run, found)
    assert "Joint spring, joint 1: " in said
    assert "Joint spring, joint 2: " not in said


@pytest.mark.parametrize(
    ("doubts", "joint_of_curve", "is_confident"),
    [
        (("", SMALL), None, True),
        (("", SMALL), 1, True),  # the weak one would come with the curve
        (("", SMALL), 2, False),  # the curve replaces the weak one
        (("", ""), 1, False),
    ],
)
def test_the_next_command_adds_what_is_sure(
    doubts, joint_of_curve, is_confident, run, two_link, monkeypatch
):
    found = springs(two_link, *doubts)
    if joint_of_curve is not None:
        found = with_curve(found, joint_of_curve)
    monkeypatch.setattr("sdp_vs_penalty.api.diagnose", lambda *_, **__: found)
    said = run("diagnose", "model.json", "--data", "run.csv", "--json", "found.json")
    assert ("--from found.json --helpful" in said) == is_confident
    leaves_curves_out = is_confident and joint_of_curve is not None
    assert ("measured beside the weak findings" in said) == leaves_curves_out


def test_a_curve_beside_weak_findings_alone_is_not_offered(run, two_link, monkeypatch):
    """It was measured beside them, and nothing of them is sure: there is no `add`."""
    found = with_curve(springs(two_link, SMALL, SMALL), 1)
    monkeypatch.setattr("sdp_vs_penalty.api.diagnose", lambda *_, **__: found)
    said = run("diagnose", "model.json", "--data", "run.csv", "--json", "found.json")
    assert "add model.json" not in said


def test_printed_errors_are_explained(run):
    """A table and the check's sentence say that they mean RMS torques."""
    data = ("--data", "run.csv")
    identified = run(
        "identify", "two_link", "--method", "ols", *data, "--out", "m.json"
    )
    assert (
        "Error (RMS) of the modelled torque on these measurements below" in identified
    )
    assert "Error (RMS) of the modelled torque below" in run("compare", "m.json", *data)
    assert "of the torque unexplained (RMS)" in run("check", "two_link", *data)


def test_all_tables_show_one_error_a_joint(run, monkeypatch):
    """That of the comparison; the analysis of causes leaves rows out."""
    home = import_module("sdp_vs_penalty.diagnosis.where_it_fails")
    search = home.where_it_fails

    def doubled(*given, **options):
        found = search(*given, **options)
        return home.Failures(
            [replace(f, rmse=2.0 * f.rmse) for f in found], found.units
        )

    monkeypatch.setattr(home, "where_it_fails", doubled)
    said = run("compare", "model.json", "--data", "run.csv", "--verbose")
    first, second = re.findall(r"error \[N m or N\] (\S+) (\S+)", said)[0]
    assert f" 1 [N m] {first} " in said
    assert f" 2 [N m] {second} " in said


@pytest.mark.parametrize(
    ("floor", "first", "refused"),
    [
        (None, 0.7, True),
        (0.3, 0.7, True),
        (0.7, 0.7, False),  # 1.13 times its noise: still noise
        (None, 0.4, False),  # joint 1 gains more than joint 2 loses
    ],
)
def test_findings_that_raise_a_joints_error_beyond_noise_are_not_added(
    floor, first, refused
):
    """Joint 2 errs by 58 % more while it slides, joint 1 by less."""

    def compared(*rmse):
        noise = None if floor is None else np.full(2, floor)
        errors = ErrorsBesideNoise(np.array(rmse), noise, np.ones(2), ("N*m", "N*m"))
        return SimpleNamespace(errors_sliding=errors)

    before, after = compared(1.0, 0.5), compared(first, 0.79)
    refuse = import_module("sdp_vs_penalty.cli.verbs.add")._refuse_harm
    refuse(before, before, "test.csv")
    if not refused:
        refuse(before, after, "test.csv")
        return
    with pytest.raises(InputError, match=r"joint 2 errs by 58 % more on test\.csv"):
        refuse(before, after, "test.csv")
