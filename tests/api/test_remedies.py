"""Each verb of a remedy, done to runs, problem and model, and written as a command."""

from dataclasses import replace

import numpy as np
import pytest
from commands import run_cli
from numpy.testing import assert_allclose, assert_array_equal
from small_runs import small_run

from sdp_vs_penalty import InputError, check, load_measurements
from sdp_vs_penalty.api.remedies import (
    Files,
    State,
    apply_change,
    command_of,
    effect_on_error,
    next_command,
    next_remedy,
)
from sdp_vs_penalty.checks.report import list_remedies
from sdp_vs_penalty.data import save
from sdp_vs_penalty.problem.check_command import CheckCommand
from sdp_vs_penalty.results import Change, Remedy

FILES = Files(
    CheckCommand(problem="arm.urdf", runs=["run 1.csv"]),
    model="model.json",
    findings="found.json",
    data=["--data", "run 1.csv"],
    new={"model": "model2.json", "trajectory": "motion.csv"},
)
EFFECT = "coulomb_friction:1"
WORDS = [
    (Change("transform", "", {"apply": ["sign:tau2"]}), "--apply sign:tau2"),
    (Change("cut", "", {"run": "run 1.csv", "spans": [[2, 3]]}), "convert *--cut 2:3"),
    (Change("read", "", {"scale": {"q": "deg"}}), "convert *--scale q=deg"),
    (Change("read", "", {"run": "run 1.csv", "scale": {"q": "deg"}}), "--scale q=deg"),
    (Change("read", "", {"rate": 100.0}), "--rate 100.0"),
    (Change("hold", "", {"positions": {"finger": 0.0}}), "--hold finger=0"),
    (Change("mount", "", {"gravity": [0, -9.81, 0]}), "--gravity 0,-9.81,0"),
    (Change("add", "", {"effects": [EFFECT]}), f"add model.json {EFFECT}"),
    (Change("add", "", {"effects": [], "findings": [2]}), "--only 2"),
    (Change("add", "", {"effects": [], "findings": "helpful"}), "--helpful"),
    (Change("reset", "", {"effects": [f"{EFFECT}@v_s=1"]}), "@v_s=1"),
    (Change("record", ""), "excite arm.urdf --out motion.csv"),
    (Change("record", "", {"separate": [EFFECT]}), f"model.json --separate {EFFECT}"),
]


@pytest.mark.parametrize(("change", "words"), WORDS)
def test_a_change_is_one_command(change, words):
    printed = " ".join(command_of(change, FILES) or [])
    assert all(part in printed for part in words.split(" *"))


@pytest.mark.parametrize(
    ("change", "files"),
    [
        (Change("read", "", {"scale": {"tau": None}}), FILES),
        (Change("cut", "", {"run": "other", "spans": [[2, 3]]}), FILES),
        (Change("cut", "", {"run": "run 1.csv"}), FILES),  # nothing would be left
        (Change("read", "", {"run": "other", "scale": {"q": "deg"}}), FILES),
        (Change("add", "", {"effects": [EFFECT]}), replace(FILES, model=None)),
    ],
)
def test_what_the_user_has_to_say_first_is_no_command(change, files):
    assert command_of(change, files) is None


@pytest.fixture(scope="module")
def spoiled(two_link):
    """Two runs in which the torque of joint 2 has the wrong sign."""
    runs = (small_run(two_link, 8.0, seed) for seed in (1, 2))
    names = ("run1.csv", "run2.csv")
    return State(
        two_link,
        tuple(
            replace(run, tau=run.tau * [1.0, -1.0], names=(name,))
            for run, name in zip(runs, names, strict=True)
        ),
    )


def test_the_first_remedy_of_a_check_repairs_its_runs(spoiled):
    reports = [check(spoiled.problem, list(spoiled.runs), thorough=False)]
    remedy = next_remedy(list_remedies(reports[0]))
    assert remedy is not None
    assert remedy.change.arguments == {"apply": ["sign:tau2"]}
    repaired = apply_change(remedy.change, spoiled)
    for before, after in zip(spoiled.runs, repaired.runs, strict=True):
        assert_allclose(after.tau[:, 1], -before.tau[:, 1])
    assert repaired.effect.falls
    command = next_command(list_remedies(reports[0]), FILES)
    assert command is not None
    assert command[-2:] == ["--apply", "sign:tau2"]


def test_a_repair_that_an_effect_of_the_arm_makes_needless_is_no_next_step():
    change = Change("transform", "", {"apply": ["clock:t"]})
    remedy = Remedy("", "likely", "its size", change, may_be_the_arm=True)
    alone = replace(remedy, may_be_the_arm=False)
    assert next_remedy([remedy, replace(alone, certainty="possible")]) is None
    assert next_remedy([remedy, alone]) is alone
    older = {k: v for k, v in remedy.to_dict().items() if k != "may_be_the_arm"}
    assert not Remedy.from_dict(older).may_be_the_arm


def test_spans_are_cut_units_read_and_gravity_set(spoiled):
    cut = Change("cut", "", {"run": "run1.csv", "spans": [[1.0, 2.0]]})
    first, second = apply_change(cut, spoiled).runs
    assert not np.any((first.t >= 0.75) & (first.t <= 2.25))
    assert len(second.t) == len(spoiled.runs[1].t)
    read = apply_change(Change("read", "", {"scale": {"tau": "mNm"}}), spoiled)
    assert_allclose(read.runs[0].tau, 1e-3 * spoiled.runs[0].tau)
    one = Change("read", "", {"run": "run2.csv", "scale": {"tau": "mNm"}})
    first, second = apply_change(one, spoiled).runs
    assert_array_equal(first.tau, spoiled.runs[0].tau)
    assert_allclose(second.tau, 1e-3 * spoiled.runs[1].tau)
    out = Change("cut", "", {"run": "run1.csv"})
    assert [run.names for run in apply_change(out, spoiled).runs] == [("run2.csv",)]
    both = CheckCommand(problem="arm.urdf", runs=["run1.csv", "run2.csv"])
    words = command_of(out, replace(FILES, check=both))
    assert words == ["check", "arm.urdf", "--data", "run2.csv"]
    mount = Change("mount", "", {"gravity": [0.0, -9.81, 0.0]})
    assert apply_change(mount, spoiled).problem.robot.gravity == (0.0, -9.81, 0.0)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (Change("read", "", {"scale": {"tau": None}}), "no unit is named"),
        (Change("read", "", {"rate": 100.0}), "read anew"),
        (Change("add", "", {"effects": [EFFECT]}), "no model"),
        (Change("record", ""), "asks for a new run"),
    ],
)
def test_a_change_that_lacks_something_says_what(spoiled, change, what):
    with pytest.raises(InputError, match=what):
        apply_change(change, spoiled)


def test_a_command_cuts_as_the_button_does(spoiled, tmp_path, monkeypatch):
    """And the check finds the gap alone in what is left; the error is stated."""
    monkeypatch.chdir(tmp_path)
    save(spoiled.runs[0], "run1.csv")
    cut = Change("cut", "", {"run": "run1.csv", "spans": [[3.5, 4.5]]})
    files = replace(FILES, check=CheckCommand(problem="two_link", runs=["run1.csv"]))
    assert run_cli(*command_of(cut, files)) == 0
    before = replace(spoiled, runs=(load_measurements("run1.csv"),))
    after = apply_change(cut, before)
    (written,) = load_measurements("run1_cut.csv").runs()
    assert_array_equal(written.t, after.runs[0].t)
    (faults,), (left,) = (
        check(spoiled.problem, list(x.runs), thorough=False) for x in (before, after)
    )
    new = {f.kind for f in left.issues} - {f.kind for f in faults.issues}
    assert new == {"gap in time"}
    assert "as logged" in effect_on_error(before, after).sentence
