"""Which parameters the data determine: what they cannot show is the prior's, whatever the units."""

from dataclasses import replace

import numpy as np
import pytest
from random_arms import SCARA_FRICTION, SCARA_NOISE, run_of
from random_robots import posed_task

from sdp_vs_penalty import InputError, Problem, export, identify, load_estimate
from sdp_vs_penalty.estimation.identify import from_data
from sdp_vs_penalty.estimators import Task
from sdp_vs_penalty.regression import LeastSquares


def task_of(problem: Problem, seconds: float = 8.0) -> Task:
    run = run_of(problem, SCARA_FRICTION, SCARA_NOISE, seconds=seconds)
    return posed_task(problem, run)


def test_what_the_data_tell_is_free_of_units(scara_arm):
    """What no torque shows is the prior's, what is measured again and again the data's."""
    task = task_of(scara_arm)
    names = [p.name for p in task.model.parameters]
    told = from_data(task, np.eye(len(names)))
    # The first axis is vertical: neither weight nor tilting moments of link 1 make torque.
    assert not told[[names.index(name) for name in ("m1", "mz1", "Ixx1", "Iyz1")]].any()
    assert told[[names.index(f"f_v{j}") for j in (1, 2, 3)]].all()
    data = task.data
    scaled = LeastSquares(
        1e3 * data.R, 1e3 * data.rho, 1e3 * data.residual_norm, 1e6 * data.tau_squared, data.rows
    )
    assert np.array_equal(from_data(replace(task, data=scaled), np.eye(len(names))), told)


def test_a_model_says_who_decides_and_export_what_is_implausible(scara_arm, tmp_path):
    run = run_of(scara_arm, SCARA_FRICTION, SCARA_NOISE)
    made = identify(scara_arm, run)
    made.save(tmp_path / "model.json")
    names = [p.name for p in made.model.parameters]
    sources = dict(zip(names, load_estimate(tmp_path / "model.json").sources, strict=True))
    assert sources["m1"] == "prior"
    assert sources["f_v1"] == "data"
    base = made.details["base_parameters"]
    assert sum(b["source"] == "data" for b in base) > len(base) / 2
    entry = made.to_dict()["parameters"][0]
    assert (entry["name"], entry["source"]) == ("m1", "prior")
    assert entry["nominal"] == pytest.approx(8.0)
    # One sentence names the links that are not weighed, and a mass that is far from its nominal value.
    assert "link" in made.unweighed
    heavy = np.where([name == "m1" for name in names], 40.0, made.theta)
    assert "far from nominal: 40 kg for 8 (link 1)" in replace(made, theta=heavy).unweighed
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
