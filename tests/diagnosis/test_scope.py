"""Errors leave out the rows at which no joint moves, and say so wherever they stand."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import run_cli
from small_runs import small_run

import sdp_vs_penalty as sdp
from sdp_vs_penalty.cli import printing
from sdp_vs_penalty.data import save
from sdp_vs_penalty.diagnosis.conclude import NOTES_ON_NOISE
from sdp_vs_penalty.diagnosis.findings import load_diagnosis
from sdp_vs_penalty.render.diagnosis_words import errors_left
from sdp_vs_penalty.render.words import finding_table
from sdp_vs_penalty.signals.noise import SPECTRUM, SPECTRUM_KNOWN

#: How long the arm is held at the end of the run [s].
HELD = 3.0


@pytest.fixture(scope="module")
def model(two_link):
    return sdp.identify(two_link, small_run(two_link), "ols", check=False)


@pytest.fixture(scope="module")
def held(two_link):
    """A run behind which the arm stands still, its torque far from the model's."""
    run = small_run(two_link)
    step = float(np.median(np.diff(run.t)))
    n_still = round(HELD / step)
    t = np.concatenate([run.t, run.t[-1] + step * np.arange(1, n_still + 1)])
    q = np.concatenate([run.q, np.repeat(run.q[-1:], n_still, axis=0)])
    tau = np.concatenate([run.tau, np.repeat(run.tau[-1:] + 5.0, n_still, axis=0)])
    return replace(run, t=t, q=q, tau=tau, dq=None)


def test_nothing_is_said_where_nothing_is_left_out(model, two_link):
    (compared,) = sdp.compare(model, small_run(two_link))
    assert compared.standstill_left_out == 0.0
    assert compared.scope == f"below {compared.band_hz:.3g} Hz"


def test_a_comparison_says_how_long_the_arm_stood_still(model, held):
    (compared,) = sdp.compare(model, held)
    # Half a second behind the motion still counts as motion.
    assert compared.standstill_left_out == pytest.approx(HELD - 0.25, abs=0.3)
    words = compared.scope
    assert re.fullmatch(r"below [\d.]+ Hz, 2\.\d s of standstill left out", words)
    assert words in str(compared)


def test_commands_report_and_files_say_the_same(
    model, held, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    model.save("model.json")
    save(held, Path("run.csv"))
    (compared,) = sdp.compare(model, "run.csv")
    words = compared.scope
    data = ("--data", "run.csv")
    for verb in (
        ("compare", "model.json", *data, "--json", "errors.json"),
        ("cross-validate", "two_link", *data, "--method", "ols"),
    ):
        assert run_cli(*verb) == 0
        assert "s of standstill left out" in " ".join(capsys.readouterr().out.split())
    assert json.dumps(words) in Path("errors.json").read_text()
    assert run_cli("diagnose", "model.json", *data, "--json", "findings.json") == 0
    diagnosis = load_diagnosis("findings.json")
    assert diagnosis.standstill_left_out == compared.standstill_left_out
    title = finding_table(diagnosis, (), model.robot.torque_units).title
    assert title.endswith(f"not used for fitting, {diagnosis.scope}")
    assert "; 2.8 s of standstill left out): j1" in errors_left(diagnosis)
    sdp.report(model, "run.csv", "report.html")
    assert f"errors are those {words}" in Path("report.html").read_text()


def test_how_rough_the_noise_is_is_said_once(model, held, capsys):
    """Of several models, and by a diagnosis, whose headline says it."""
    (one,) = sdp.compare(model, held)
    rough = replace(one, noise_floor=np.full(2, 0.5), noise_source=SPECTRUM)
    printing.verdicts([rough, replace(rough, name="another")])
    printed = " ".join(capsys.readouterr().out.split())
    assert printed.count("the noise is from the torque's spectrum, rough") == 2
    assert printed.count("four times too large on a real arm") == 1
    assert SPECTRUM_KNOWN not in NOTES_ON_NOISE[SPECTRUM]


def test_a_training_run_is_no_test_run(two_link, model):
    """It leaves nothing out: parts of the training runs judge, as without a test run."""
    run = small_run(two_link)
    with pytest.warns(UserWarning, match="the test run is a training run"):
        found = sdp.diagnose(model, run, run, check=False)
    alone = sdp.diagnose(model, run, check=False)
    assert found.held_out_source == alone.held_out_source != "test"
    np.testing.assert_array_equal(
        found.held_out_rmse_before, alone.held_out_rmse_before
    )
