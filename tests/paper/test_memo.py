"""What is kept on the disk: read where the content is the same, computed where it is
not."""

from dataclasses import replace

import numpy as np
import pytest
from random_robots import posed_task

from sdp_vs_penalty.estimators import LmiSdp, PenaltyPaper
from sdp_vs_penalty.paper import memo
from sdp_vs_penalty.simulation import experiment


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(memo.VARIABLE, str(tmp_path / "memo"))
    return tmp_path / "memo"


@pytest.fixture
def task(two_link):
    return posed_task(two_link, experiment(two_link).training_run(seed=1))


def never():
    raise AssertionError("computed again")


def test_what_was_computed_is_read(folder):
    computed = {"a": [0.1, np.float64(0.2)], "b": np.array([[np.nan, 1.0]])}
    memo.load_or_compute("x", (1,), lambda: computed)
    held = memo.load_or_compute("x", (1,), never)
    for name, values in computed.items():
        np.testing.assert_array_equal(held[name], values)


def test_a_damaged_file_is_computed_again(folder):
    memo.load_or_compute("x", ("a",), lambda: 1)
    (path,) = folder.iterdir()
    path.write_text("{")
    assert memo.load_or_compute("x", ("a",), lambda: 3) == 3
    assert memo.load_or_compute("x", ("a",), never) == 3


def test_an_empty_variable_keeps_nothing(monkeypatch):
    monkeypatch.setenv(memo.VARIABLE, "")
    assert memo.memo_folder() is None
    assert memo.load_or_compute("x", ("a",), lambda: 4) == 4


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (1, 1.0),
        ("1", 1),
        (("a", "b"), ("ab", "")),
        (np.array([0.0]), np.array([-0.0])),
        (np.zeros(2), np.zeros((2, 1))),
        ({"a": 1}, {"a": 2}),
        (LmiSdp(), LmiSdp(entropy=2.0)),
        (None, "None"),
    ],
)
def test_different_content_has_different_keys(one, other):
    assert memo.content_key([one]) != memo.content_key([other])


def test_what_has_no_content_is_refused():
    with pytest.raises(TypeError, match="no content"):
        memo.content_key([object()])


def test_a_kept_estimate_is_the_computed_one(folder, task, monkeypatch):
    computed = memo.estimate_once(LmiSdp(), task)
    monkeypatch.setattr(memo, "_estimated", never)
    read = memo.estimate_once(LmiSdp(), replace(task))
    np.testing.assert_array_equal(read.theta, computed.theta)
    assert read.certificate == computed.certificate


def test_another_weight_of_a_joint_is_another_estimate(folder, task):
    memo.estimate_once(LmiSdp(), task)
    more = replace(task, weights=2.0 * task.weights)
    assert memo.content_key(memo.task_content(more)) != memo.content_key(
        memo.task_content(task)
    )


def test_kept_steps_of_annealing_end_where_the_method_does(folder, task, monkeypatch):
    method = PenaltyPaper(runs=1, evaluations=200)
    fit = method.fit(task)
    kept = method.fit_with(task, memo.anneal_once)
    monkeypatch.setattr(memo, "anneal_and_search", never)
    read = method.fit_with(task, memo.anneal_once)
    np.testing.assert_array_equal(kept.theta, fit.theta)
    np.testing.assert_array_equal(read.theta, fit.theta)
