"""Work on several processes or a cluster: the same result to the last bit, whoever dies
on the way."""

import os
import pickle
import signal
import threading
import time

import pytest
from numpy.testing import assert_array_equal
from small_runs import write_run
from unchecked import identify

from sdp_vs_penalty import cross_validate
from sdp_vs_penalty.data import load_measurements
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.regression import compress
from sdp_vs_penalty.signals import FilteredRuns


@pytest.fixture(scope="module")
def runs(two_link, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    for seed in range(4):
        write_run(folder / f"run{seed}.csv", two_link, 8.0, seed)
    return load_measurements(folder)


def test_the_workers_of_every_verb_can_be_pickled():
    # What is cached on disk is found by the defaults of its function.
    assert pickle.loads(pickle.dumps(ALONE)) == ALONE


def test_processes_give_the_same_and_a_killed_one_is_replaced(two_link, runs, tmp_path):
    settings = two_link.preprocessing.resolve(runs)
    here = compress(FilteredRuns.filtering(runs, settings), two_link.model())
    there = compress(
        FilteredRuns.filtering(runs, settings), two_link.model(), workers=Workers(2)
    )
    for a, b in zip(here.factors, there.factors, strict=True):
        assert_array_equal(a.triangle, b.triangle)
    assert here.blocks == there.blocks

    def dies_once(mark):  # a local function travels by value
        if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return len(mark.name)

    marks = [tmp_path / name for name in ("a", "bb", "ccc")]
    assert Workers(2).map(dies_once, marks) == [1, 2, 3]


@pytest.mark.long
def test_folds_are_the_same_by_processes(two_link, runs):
    said = []
    alone = cross_validate(two_link, runs, folds=3, workers=ALONE, progress=said.append)
    several = cross_validate(
        two_link, runs, folds=3, workers=Workers(2), progress=said.append
    )
    # Where it takes long, the time that is left stands behind it.
    counted = [text.partition(",")[0] for text in said]
    assert counted == 2 * ["1 of 3 done", "2 of 3 done", "3 of 3 done"]
    assert len(alone.folds) == 3
    for a, b in zip(alone.folds, several.folds, strict=True):
        assert_array_equal(a.theta, b.theta)
        assert_array_equal(a.losses, b.losses)


@pytest.mark.long
def test_a_cluster_gives_the_same_though_a_worker_is_killed(two_link, runs):
    distributed = pytest.importorskip("distributed")
    alone = identify(two_link, runs, workers=ALONE)
    quiet = {"silence_logs": 50, "dashboard_address": None}
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, **quiet
    ) as cluster:
        first = next(iter(cluster.workers.values())).pid
        killer = threading.Timer(0.5, os.kill, (first, signal.SIGKILL))
        killer.start()
        started = time.monotonic()
        found = identify(
            two_link, runs, workers=Workers(scheduler=cluster.scheduler_address)
        )
        killer.join()
        assert time.monotonic() - started > 0.5  # it was killed while they worked
    assert_array_equal(found.theta, alone.theta)
