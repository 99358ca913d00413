"""The recipes of CONTRIBUTING: one new file is found by everything that lists, runs and
compares."""

import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from dynamics_files import FULL, by_mujoco, estimate_of
from lxml import etree
from random_robots import states

import sdp_vs_penalty.effects
import sdp_vs_penalty.estimators
import sdp_vs_penalty.solvers
from sdp_vs_penalty import export, identify
from sdp_vs_penalty.api.registration import REGISTRIES
from sdp_vs_penalty.cli.verbs.list import details, listing
from sdp_vs_penalty.effects import FittedEffect, Motion, effect_types, on_the_arm
from sdp_vs_penalty.estimators import LmiSdp, estimator_types
from sdp_vs_penalty.shootout.contestants import contestants
from sdp_vs_penalty.simulation import experiment
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs
from sdp_vs_penalty.testing import contracts

#: The files of a package of plug-ins (tests/testing), as if they were written here.
THEIRS = Path(__file__).parent / "testing" / "theirs" / "theirs"
NAME = "rubber_spring"
IN_ONE_FILE = "preloaded_spring"


@pytest.fixture
def added(tmp_path, monkeypatch):
    """One file more in each of three folders, as if it had been written there."""
    homes = (
        (sdp_vs_penalty.estimators, "ridge"),
        (sdp_vs_penalty.solvers, "half_hearted"),
        (sdp_vs_penalty.effects, "rubber"),
        (sdp_vs_penalty.effects, "preload"),
    )
    for package, name in homes:
        folder = tmp_path / package.__name__.rpartition(".")[2]
        folder.mkdir(exist_ok=True)
        shutil.copy(THEIRS / f"{name}.py", folder)
        monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    forget()
    yield
    for package, name in homes:
        sys.modules.pop(f"{package.__name__}.{name}", None)
        vars(package).pop(name, None)
    monkeypatch.undo()
    forget()


def forget():
    """Look for plug-ins again."""
    for registry in REGISTRIES:
        registry.forget()


def test_an_estimator_is_one_file(two_link, added):
    assert "ridge" in estimator_types()
    assert ("ridge", "least squares pulled to the nominal parameters") in listing(
        "methods"
    )[1]
    run = experiment(two_link).training_run(seed=0)
    estimate = identify(two_link, run, "ridge")
    assert estimate.method == "ridge"
    assert estimate.settings["weight"] == 1e-3
    torque = run.tau - run.tau.mean(axis=0)
    assert estimate.certificate.loss < np.sum(torque**2)


def test_a_solver_is_one_file(two_link, added):
    assert "half-hearted" in [row[0] for row in listing("solvers")[1]]
    estimate = identify(
        two_link,
        experiment(two_link).training_run(seed=0),
        LmiSdp(solver="half-hearted"),
    )
    gap = estimate.certificate.gap
    assert gap < 1e-7
    contestant = contestants()["half-hearted"]
    contestant.warm_up()
    assert not contestant.absent


def test_an_effect_of_one_file_is_exported_and_hidden(two_link, added, tmp_path):
    """Its columns are its C code and its torque in a simulated world."""
    runs = hidden_runs(two_link, [(NAME, [1])], "strong", seed=1)
    assert runs.truth["effects"][0]["effect"] == NAME
    estimate = identify(
        two_link, runs.runs[0], effects=f"rigid_body,{NAME}:2", check=False
    )
    assert export(estimate, tmp_path / "model.h") == ()
    code = (tmp_path / "model.h").read_text("utf-8")
    assert "* 0.5 * sinh(q[1] / 0.5); /* rubber_spring */" in code


def test_one_file_keeps_the_contracts_and_is_listed(added):
    for contract in contracts(effect_types()[NAME]).values():
        contract()
    row = details("effects", NAME)
    assert row[1:3] == ("k_r q_0 sinh(q / q_0)", "q_0=0.5")


@pytest.mark.parametrize("ours", [False, True], ids=["new file", "edited"])
def test_an_effect_of_one_file_is_in_mjcf(two_link, added, tmp_path, ours):
    """MuJoCo makes its torque; attributes are where the effect declares them."""
    robot = two_link.robot
    out = tmp_path / "out.xml"
    options = {}
    if ours:
        options["mjcf"] = tmp_path / "robot.xml"
        export(estimate_of(robot, FULL, 1), options["mjcf"])
        text = options["mjcf"].read_text()
        flagged = re.sub("(<option [^>]*)/>", r"\1><flag/></option>", text)
        options["mjcf"].write_text(flagged)
    estimate = estimate_of(robot, f"{FULL},torque_offset,{IN_ONE_FILE}:2@q_0=0.2", 4)
    assert export(estimate, out, **options) == ()
    rows = states(robot, 20, 1)
    expected = estimate.torque(Motion(np.zeros(20), *rows))
    made = by_mujoco(out, robot, *rows)
    np.testing.assert_allclose(made, expected, rtol=0.0, atol=1e-9)
    root = etree.parse(str(out)).getroot()
    found = [x.get("margin") for x in root.iter("joint")]
    assert found == [None, "0.02"]
    assert [x.get("gear") for x in root.iter("motor")] == [None, "1.0"]
    assert root.find("option").get("impratio") == "2.0"
    assert (root.find("option/flag") is not None) == ours


def test_an_effect_of_one_file_has_words_and_contracts(two_link, added):
    kind = effect_types()[IN_ONE_FILE]
    for contract in contracts(kind).values():
        contract()
    found = FittedEffect(IN_ONE_FILE, (2,), 3.1, "N*m/rad", {"k_p2": 3.1}, {})
    assert "joint 2 is pulled back by 3.1 N m/rad" in on_the_arm(found)


def test_a_world_states_its_law_a_second_time(two_link, added, monkeypatch):
    """What is hidden is no torque of the columns, which may be wrong."""
    kind = effect_types()[IN_ONE_FILE]
    monkeypatch.setattr(kind, "column", lambda self, motion, joint: 1.0 / 0.0)
    runs = hidden_runs(two_link, [(IN_ONE_FILE, [1])], "strong", seed=1)
    assert runs.truth["effects"][0]["shape"] == {"q_0": 0.3}
