"""The saved estimate: the same torques to the last bit, valid JSON, and who decides
each parameter."""

import json
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
from arms import SCARA_FRICTION, SCARA_NOISE, run_of
from drawn import given, seeds, settings
from numpy.testing import assert_allclose, assert_array_equal
from random_robots import (
    link_parameters,
    open_problem,
    posed_task,
    repeating_run,
    sines,
    tree,
)
from recorded import refusal
from small_runs import small_model, small_run
from unchecked import identify

from sdp_vs_penalty import InputError, add, compare, export, load_estimate
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.estimation import is_data_determined
from sdp_vs_penalty.estimation.estimate import estimate_of_file
from sdp_vs_penalty.estimators import LmiSdp
from sdp_vs_penalty.regression import LeastSquares

noisy_run = partial(repeating_run, noise=0.2, base=0.15, motion_seed=3, seconds=8.0)


def strict(text):
    return json.loads(
        text, parse_constant=lambda word: pytest.fail(f"{word} is not JSON")
    )


def assert_same_estimate(a, b, motion):
    assert_array_equal(a.theta, b.theta)
    assert_array_equal(a.torque(motion), b.torque(motion))
    assert_array_equal(a.covariance, b.covariance)
    for name in ("method", "certificate", "preprocessing"):
        assert getattr(a, name) == getattr(b, name), name
    assert strict(json.dumps(a.to_dict())) == strict(json.dumps(b.to_dict()))


@pytest.mark.parametrize(
    "method",
    [
        "ols",
        "lmi-sdp",
        pytest.param("lmi-sdp-entropic", marks=pytest.mark.long),
        pytest.param("lmi-sdp-two-step", marks=pytest.mark.long),
    ],
)
@settings(max_examples=2)
@given(seed=seeds)
def test_a_model_file_predicts_the_same_to_the_last_bit(tmp_path_factory, method, seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    nominal = np.array([link_parameters(rng, 0.5, thickness=0.05) for _ in range(n)])
    problem = open_problem(tree(rng, n, link_frames=bool(rng.integers(2))), nominal)
    estimate = identify(problem, noisy_run(problem, seed % 1000), method)
    path = tmp_path_factory.mktemp("m") / "model.json"
    estimate.save(path)
    again = load_estimate(path)
    motion = sines(rng, problem.robot.n, np.arange(0.0, 1.0, 0.01))
    assert_same_estimate(estimate, again, motion)
    again.save(path.with_name("again.json"))
    assert path.read_bytes() == path.with_name("again.json").read_bytes()


def test_a_model_with_every_effect_survives(two_link, tmp_path):
    """Shape constants, joints, memory, and the current model that some effects refer
    to."""
    own = {n: kind for n, kind in effect_types().items() if kind.forward != "drive"}
    every = [name for name, kind in own.items() if not kind.frozen_only]
    texts = [f"{n}@d=0.02" if n == "presliding_hysteresis" else n for n in every]
    run = noisy_run(two_link, 2)
    run = replace(
        run,
        temperature=20.0 + run.t[:, None] * [1.0, 2.0],
        commanded={"qmot": 1.1 * run.q},
    )
    estimate = identify(two_link, run, "ols", effects=texts)
    # One of them a joint where a constant is estimated joint by joint.
    assert list(dict.fromkeys(e.name for e in estimate.model.effects)) == every
    estimate.save(tmp_path / "model.json")
    again = load_estimate(tmp_path / "model.json")
    motion = sines(np.random.default_rng(1), 2, np.arange(0.0, 3.0, 0.01))
    motion = replace(
        motion, temperature=np.full_like(motion.q, 25.0), motors=1.1 * motion.ddq
    )
    assert_same_estimate(estimate, again, motion)
    hysteresis = next(
        e for e in again.model.effects if e.name == "presliding_hysteresis"
    )
    assert hysteresis.shape == {"d": 0.02}


def test_the_file_holds_what_was_promised(two_link, tmp_path):
    run = noisy_run(two_link, 1)
    estimate = identify(two_link, run, seed=12)
    estimate.save(tmp_path / "model.json")
    data = strict((tmp_path / "model.json").read_text())
    parameters = data["parameters"]
    assert [p["name"] for p in parameters[10:20]] == [
        *("m2", "mx2", "my2", "mz2"),
        *("Ixx2", "Ixy2", "Iyy2", "Ixz2", "Iyz2", "Izz2"),
    ]
    assert {(p["joint"], p["unit"]) for p in parameters[10:12]} == {
        (2, "kg"),
        (2, "kg*m"),
    }
    assert (data["method"], data["robot"]["gravity"]) == ("lmi-sdp", [0.0, 0.0, -9.81])
    made = data["provenance"]
    assert (made["seed"], made["data_hash"]) == (12, run.data_hash)
    assert {"numpy", "scipy", "pin", "python", "sdp_vs_penalty"} <= set(
        made["versions"]
    )
    assert (
        data["settings"] | {"weighting": "noise", "entropy": LmiSdp.entropy}
        == data["settings"]
    )
    names = [p["name"] for p in parameters]
    seen = data["covariance"]["parameters"]
    assert set(seen) <= set(names)
    assert np.shape(data["covariance"]["matrix"]) == (len(seen), len(seen))
    assert {p["name"] for p in parameters if p["std"] is not None} == set(seen)


def test_a_file_without_the_training_motion_loads_and_says_so(two_link, tmp_path):
    run = noisy_run(two_link, 1)
    estimate = identify(two_link, run)
    assert compare(estimate, run)[0].new_motion_share == 0.0
    old = estimate.to_dict()
    del old["training_motion"]
    (tmp_path / "old.json").write_text(json.dumps(old))
    judged = compare(tmp_path / "old.json", run)[0]
    assert judged.new_motion_share is None
    assert (
        add(tmp_path / "old.json", "joint_spring:1", run, frozen=True).training_motion
        is None
    )
    bigger = add(estimate, "joint_spring:1", noisy_run(two_link, 2), frozen=True)
    assert compare(bigger, run)[0].new_motion_share == 0.0
    assert "the model does not record its own" in repr(judged)


def test_what_the_data_tell_is_free_of_units(scara_arm):
    """What no torque shows is the prior's, what is measured again and again the data's."""
    task = posed_task(
        scara_arm, run_of(scara_arm, SCARA_FRICTION, SCARA_NOISE, seconds=8.0)
    )
    names = [p.name for p in task.model.parameters]
    told = is_data_determined(task, np.eye(len(names)))
    # The first axis is vertical: neither weight nor tilting moments of link 1 make
    # torque.
    assert not told[[names.index(name) for name in ("m1", "mz1", "Ixx1", "Iyz1")]].any()
    assert told[[names.index(f"f_v{j}") for j in (1, 2, 3)]].all()
    data = task.data
    scaled = LeastSquares(
        1e3 * data.R,
        1e3 * data.rho,
        1e3 * data.residual_norm,
        1e6 * data.tau_squared,
        data.rows,
    )
    assert np.array_equal(
        is_data_determined(replace(task, data=scaled), np.eye(len(names))), told
    )


def test_a_model_says_who_decides_and_export_what_is_implausible(scara_arm, tmp_path):
    run = run_of(scara_arm, SCARA_FRICTION, SCARA_NOISE)
    made = identify(scara_arm, run)
    made.save(tmp_path / "model.json")
    names = [p.name for p in made.model.parameters]
    sources = dict(
        zip(names, load_estimate(tmp_path / "model.json").sources, strict=True)
    )
    assert sources["m1"] == "prior"
    assert sources["f_v1"] == "data"
    base = made.details["base_parameters"]
    assert sum(b["source"] == "data" for b in base) > len(base) / 2
    entry = made.to_dict()["parameters"][0]
    assert (entry["name"], entry["source"]) == ("m1", "prior")
    assert entry["nominal"] == pytest.approx(8.0)
    # One sentence names the links that are not weighed, and a mass that is far from its
    # nominal value.
    assert "link" in made.unweighed
    # And what a nominal link is drawn to, where no file states it.
    for origin, drawn_to in [
        ("inertial", []),
        ("bounds", ["its bounds"]),
        ("geometry", ["its shapes"]),
        ("kinematics", ["lengths and torque limits"]),
    ]:
        problem = replace(
            made.problem, nominal_from=(origin,) * made.problem.robot.links
        )
        said = replace(made, problem=problem).unweighed
        assert re.findall("a guess, drawn to ([^;.]*)", said) == drawn_to
    heavy = np.where([name == "m1" for name in names], 40.0, made.theta)
    assert (
        "far from nominal: 40 kg for 8 (link 1)" in replace(made, theta=heavy).unweighed
    )
    export(made, tmp_path / "arm.urdf")
    # A mass of a milligram with the same moments: consistent, and nowhere near the arm.
    theta = made.theta.copy()
    theta[:4] *= 1e-6
    wide = replace(made, theta=theta)
    with pytest.raises(InputError, match=r"link 1.*implausible.*--force"):
        export(wide, tmp_path / "wide.urdf")
    assert not (tmp_path / "wide.urdf").exists()
    export(wide, tmp_path / "wide.urdf", force=True)
    loose = identify(scara_arm, run, "lmi-sdp-plain")
    assert "bounds" in loose.sources


def test_an_estimate_is_equal_to_itself_alone(two_link):
    estimate = small_model("ols")
    other = identify(two_link, small_run(two_link), "ols")
    assert estimate != other
    assert estimate.identity == other.identity
    assert {estimate: 1}[estimate] == 1
    assert small_run(two_link) != small_run(two_link)


def test_the_torque_of_a_data_frame_names_predict():
    estimate = small_model("ols")
    frame = pd.DataFrame({"t": [0.0, 1.0]})
    words = r"torque\(motion=DataFrame\) .* predict\(q, dq, ddq\)"
    with pytest.raises(InputError, match=words):
        estimate.torque(frame)


def test_a_certificate_is_of_the_values_that_it_certifies(tmp_path):
    """Not of others that are put in their place: a negative mass is no link."""
    estimate = small_model()
    is_mass = np.array([p.name == "m2" for p in estimate.model.parameters])
    theta = np.where(is_mass, -1.0, estimate.theta)
    for other in (replace(estimate, theta=theta), estimate.with_theta(theta)):
        assert other.certificate.violations["pseudo-inertia"] > 0.1
        assert other.certificate.smallest_thickness < 0.0
        assert np.isnan(other.certificate.loss)
        assert other.certificate.gap is None
        assert other.verdict is None
        other.save(tmp_path / "model.json")
        assert load_estimate(tmp_path / "model.json").certificate == other.certificate
    data = json.loads((tmp_path / "model.json").read_text())
    data["certificate"] = estimate.to_dict()["certificate"]
    assert estimate_of_file(data).certificate == other.certificate
    same = replace(estimate, theta=estimate.theta.copy())
    assert same.certificate is estimate.certificate


def test_values_that_are_given_have_no_intervals():
    estimate = small_model()
    doubled_model = estimate.with_theta(2.0 * estimate.theta)
    assert set(doubled_model.sources) == {"given"}
    assert np.all(np.isnan(doubled_model.uncertainty.std))
    base = [b["value"] for b in estimate.details["base_parameters"]]
    doubled = [b["value"] for b in doubled_model.details["base_parameters"]]
    assert_allclose(doubled, 2.0 * np.array(base), atol=1e-12)
    for wrong in ([1.0], np.nan * estimate.theta, "x", [10**400] * 26):
        refusal(lambda wrong=wrong: estimate.with_theta(wrong), "with_theta(theta=...)")


def test_arrays_of_an_estimate_cannot_be_written():
    estimate = small_model()
    known = estimate.uncertainty
    for array in (estimate.theta, estimate.covariance, known.std, known.spread):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
