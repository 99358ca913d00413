"""Bounds, noise and many logs, as arguments of Python."""

import numpy as np
import pytest
from small_runs import small_run

from sdp_vs_penalty import InputError, identify, identify_many
from sdp_vs_penalty.data import Measurements, save
from sdp_vs_penalty.simulation import experiment


def test_bounds_are_kept_whether_text_or_mapping(two_link):
    run = small_run(two_link)
    text = identify(two_link, run, bounds="m2=0.7:0.8")
    pairs = identify(two_link, run, bounds={"m2": (0.7, 0.8)})
    np.testing.assert_array_equal(text.theta, pairs.theta)
    assert 0.7 <= text.links[1, 0] <= 0.8


def test_an_open_end_is_none(two_link):
    model = identify(two_link, small_run(two_link), bounds={"m2": (None, 2.5)})
    assert model.problem.box[1, 0].tolist() == [0.0, 2.5]


def test_noise_comes_from_a_file(two_link, tmp_path):
    run = experiment(two_link).training_run(seed=0)
    save(run, tmp_path / "whole.csv")
    half = run.window(float(run.t[0]), float(run.t[len(run.t) // 2]))
    part = Measurements(half.t, half.q, half.tau)  # remembers no recording
    alone = identify(two_link, part).provenance["noise"]
    by_file = identify(two_link, part, noise_from=tmp_path / "whole.csv")
    by_runs = identify(two_link, part, noise_from=run)
    noise = [model.provenance["noise"]["floor"] for model in (by_file, by_runs)]
    np.testing.assert_allclose(*noise, rtol=1e-6)
    assert alone["floor"] != noise[0]


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.long)])
def test_many_logs_make_the_models_of_each(two_link, jobs):
    logs = {name: small_run(two_link, seed=k) for k, name in enumerate("ab")}
    models = identify_many(two_link, logs, jobs=jobs)
    for name, run in logs.items():
        alone = identify(two_link, run)
        np.testing.assert_array_equal(models[name].theta, alone.theta)
        assert models[name].verdict.to_dict() == alone.verdict.to_dict()


def test_a_log_that_cannot_be_used_is_named(two_link):
    with pytest.raises(InputError, match=r"^unit 7: "):
        identify_many(two_link, {"unit 7": "nowhere.csv"})
