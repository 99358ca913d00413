"""The recipes of CONTRIBUTING: one new file is found by everything that lists, runs and
compares."""

import shutil
import sys
from pathlib import Path

import effect_contract
import numpy as np
import pytest

import sdp_vs_penalty.effects
import sdp_vs_penalty.estimators
import sdp_vs_penalty.solvers
from sdp_vs_penalty import export, identify
from sdp_vs_penalty.api.registration import REGISTRIES
from sdp_vs_penalty.cli.verbs.list import details, listing
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.estimators import LmiSdp, estimator_types
from sdp_vs_penalty.shootout.contestants import contestants
from sdp_vs_penalty.simulation import MAKERS, at_joint, experiment, log_uniform
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs
from sdp_vs_penalty.testing import contracts

#: The files of a package of plug-ins (tests/testing), as if they were written here.
THEIRS = Path(__file__).parent / "testing" / "theirs" / "theirs"
NAME = "rubber_spring"


@pytest.fixture
def added(tmp_path, monkeypatch):
    """One file more in each of three folders, as if it had been written there."""
    homes = (
        (sdp_vs_penalty.estimators, "ridge"),
        (sdp_vs_penalty.solvers, "half_hearted"),
        (sdp_vs_penalty.effects, "rubber"),
    )
    for package, name in homes:
        folder = tmp_path / package.__name__.rpartition(".")[2]
        folder.mkdir()
        shutil.copy(THEIRS / f"{name}.py", folder)
        monkeypatch.setattr(package, "__path__", [*package.__path__, str(folder)])
    monkeypatch.setitem(MAKERS, NAME, hardening)
    forget()
    yield
    for package, name in homes:
        sys.modules.pop(f"{package.__name__}.{name}", None)
        vars(package).pop(name, None)
    monkeypatch.undo()
    forget()


def forget():
    """Look for plug-ins again, and draw hidden worlds again."""
    for registry in REGISTRIES:
        registry.forget()
    effect_contract.hidden_cases.cache_clear()


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


def hardening(w, j, rng):
    q_0 = log_uniform(rng, 0.4, 0.6)
    side = float(rng.choice([-1.0, 1.0]))

    def law(w, m):
        stretched = np.exp(m.q[:, j] / q_0)
        return np.asarray(side * q_0 * (stretched - 1.0 / stretched) / 2.0)

    return at_joint(j, law, side, q_0=q_0)


def test_an_effect_of_one_file_is_exported_and_hidden(two_link, added, tmp_path):
    """Its columns are its C code and its torque in a simulated world."""
    MAKERS.pop(NAME)  # which states it a second time
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
    effect_contract.check_columns_are_the_hidden_torque(NAME)
    row = details("effects", NAME)
    assert row[1:3] == ("k_r q_0 sinh(q / q_0)", "q_0=0.5")
