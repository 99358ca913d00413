"""A model's provenance: its verdict and noise are worked out when they are first read."""

import json
import pickle
import time
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from small_runs import small_run

from sdp_vs_penalty import identify
from sdp_vs_penalty.api import identify_and_judge
from sdp_vs_penalty.estimation.build_problem import PoseOptions
from sdp_vs_penalty.estimation.provenance import Provenance
from sdp_vs_penalty.signals import filtered


@pytest.fixture(scope="module")
def run(two_link):
    return small_run(two_link)


def counted():
    """A provenance of three entries, two of them unread, and how often they were made."""
    calls = []

    def make():
        calls.append(1)
        return {"verdict": {"grade": "good"}, "noise": None}

    provenance = Provenance({"seed": 0})
    provenance.work_out_later(("verdict", "noise"), make)
    return provenance, calls


def test_entries_are_made_once_when_one_of_them_is_read():
    provenance, calls = counted()
    assert [*provenance] == ["seed", "verdict", "noise"]
    assert provenance["seed"] == 0
    assert not calls
    provenance["data"] = ["run.csv"]
    assert provenance["noise"] is None
    assert provenance["verdict"] == {"grade": "good"}
    assert [*dict(provenance)] == ["seed", "verdict", "noise", "data"]
    assert len(calls) == 1


def test_what_is_set_or_deleted_before_it_is_read_stays_so():
    provenance, _ = counted()
    provenance["verdict"] = "mine"
    del provenance["noise"]
    assert dict(provenance) == {"seed": 0, "verdict": "mine"}
    provenance, _ = counted()
    provenance["verdict"] = "mine"
    assert dict(provenance) == {"seed": 0, "verdict": "mine", "noise": None}


def test_a_copy_for_another_process_is_complete():
    provenance, calls = counted()
    assert dict(pickle.loads(pickle.dumps(provenance))) == dict(provenance)
    assert len(calls) == 1


def test_verdict_and_noise_are_those_of_a_model_that_is_judged_at_once(run):
    later = identify("two_link", run)
    at_once, _ = identify_and_judge("two_link", run, "lmi-sdp", PoseOptions())
    assert json.dumps(later.to_dict()) == json.dumps(at_once.to_dict())
    assert later.verdict == at_once.verdict is not None


def test_a_model_of_a_long_recording_does_not_keep_it(run, monkeypatch):
    monkeypatch.setattr(filtered, "SAMPLES", run.q.size - 1)
    assert type(identify("two_link", run).provenance) is dict
    monkeypatch.setattr(filtered, "SAMPLES", run.q.size)
    assert type(identify("two_link", run).provenance) is Provenance


def test_a_model_does_not_depend_on_arrays_that_change_later(run):
    tau = np.array(run.tau)
    estimate = identify("two_link", replace(run, tau=tau))
    tau *= 2.0
    assert estimate.verdict == identify("two_link", run).verdict
    assert deepcopy(estimate).verdict == estimate.verdict


def test_threads_work_entries_out_once():
    provenance, calls = counted()
    make = provenance._make

    def slowly():
        time.sleep(0.01)
        return make()

    provenance._make = slowly
    with ThreadPoolExecutor(4) as threads:
        read = list(threads.map(lambda _: provenance["verdict"], range(8)))
    assert read == [{"grade": "good"}] * 8
    assert len(calls) == 1
