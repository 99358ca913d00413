"""What the search over repairs compares: faults by their size, each beside what is kept."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_runs import small_run

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.checks.check import judge_facts
from sdp_vs_penalty.checks.dynamics import LoggerJudge
from sdp_vs_penalty.checks.facts.lockstep import LockstepMotion
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.regression_data import RegressionData
from sdp_vs_penalty.checks.repair import LogEvent
from sdp_vs_penalty.checks.report import Report
from sdp_vs_penalty.checks.search import RepairSearch

PROBLEM = load_problem("two_link")
RUN = replace(small_run(PROBLEM, seconds=8.0), dq=None)


@pytest.fixture
def search() -> RepairSearch:
    settings = PROBLEM.preprocessing.resolve(RUN)
    return RepairSearch(Likelihood(PROBLEM, RegressionData.of(PROBLEM, RUN, settings)))


def test_each_fault_is_judged_beside_those_that_were_kept(search, monkeypatch):
    """The first of two gains is not confirmed: the second is judged without it."""
    as_logged = search.log.as_logged
    first = as_logged.with_entries("gain", (0,), 2.0)
    second = as_logged.with_entries("gain", (1,), 3.0)
    both = first.with_entries("gain", (1,), 3.0)
    judged = []

    def beats_physics(log, repair, now, strict):
        judged.append((repair, now))
        return repair != both

    monkeypatch.setattr(search, "beats_physics", beats_physics)
    assert search.drop_unconfirmed(both) == second
    assert judged == [(both, second), (second, as_logged)]


def test_each_run_judges_a_fault_beside_those_that_were_kept(search, monkeypatch):
    """As above, where a run objects to the first gain."""
    as_logged = search.log.as_logged
    second = as_logged.with_entries("gain", (1,), 3.0)
    both = second.with_entries("gain", (0,), 2.0)
    search.logs = [search.log, search.log]
    judged = []

    def holds(log, net, without):
        judged.append((net, without))
        return net != both

    monkeypatch.setattr(search, "beats_physics", lambda *_, **__: True)
    monkeypatch.setattr(search, "_holds", holds)
    assert search.drop_unconfirmed(both) == second
    assert judged == [(both, second)] + 2 * [(second, as_logged)]


def test_sizes_that_round_to_one_sentence_are_two_sizes(search):
    now = search.log.as_logged.with_entries("gain", (1,), 1.2341)
    other = now.with_entries("gain", (1,), 1.2339)
    (fault,) = search.new_faults(other, now)
    assert (fault.kind, fault.joints) == ("torque gain", (1,))
    assert fault.what == search.list_faults(now)[0].what
    assert search.new_faults(now, now) == []


def test_what_is_only_taken_back_is_no_sign_and_no_law(search, monkeypatch):
    """An exchange of channels is taken back where the error does not rise clearly."""
    as_logged = search.log.as_logged
    now = as_logged.with_swap(0, 1, "tau_order")
    assert search.new_faults(as_logged, now) == []
    for rise, is_right in ((1.9, True), (2.1, False)):
        monkeypatch.setattr(search.log, "clearness_of_fall", lambda *_, r=rise: r)
        search.is_confirmed.cache_clear()
        assert search.is_confirmed(as_logged, now) is is_right


def test_nothing_new_is_no_rival(search, monkeypatch):
    as_logged = search.log.as_logged
    now = as_logged.with_swap(0, 1, "tau_order")
    gain = now.with_entries("gain", (1,), 2.0)
    monkeypatch.setattr(search, "posterior", lambda repair: 0.0)
    monkeypatch.setattr(search, "is_confirmed", lambda repair, now: True)
    assert search._as_likely(gain, now, [gain, as_logged]) == []
    search.log.problem = SimpleNamespace(guessed_links=[False])
    assert search._of_most_plausible_size([as_logged, now], now) == as_logged


def test_a_mended_clock_moves_the_instants_of_later_runs():
    """Half the rate makes the first run twice as long in the log of both."""
    runs = [RUN, replace(RUN, names=("later",))]
    settings = PROBLEM.preprocessing
    reports = [judge_facts(PROBLEM, run, settings) for run in runs]
    judge = LoggerJudge(PROBLEM, reports, settings)
    judge._search()
    assert judge._time_in_run(1, 0.0) is None  # it lies in the first run
    as_logged = judge.logs[0].as_logged
    begin = judge.logs[1].data.motion.t[0]
    assert judge._try_to_repair(0, as_logged.with_rate(0.5))
    t = judge._search().log.data.motion.t
    first_of_later = float(t[np.argmax(np.diff(t)) + 1])  # a second lies between
    assert judge._time_in_run(1, first_of_later) == pytest.approx(begin)


@pytest.mark.parametrize(
    ("ranks", "is_poor"),
    [((), False), ((1,), True), ((1, 1), True), ((1, 2), False), ((1, None), False)],
)
def test_a_motion_is_poor_where_that_of_every_run_is(search, ranks, is_poor):
    """Of three moving joints; None: no joints move in proportion."""
    runs = [
        None if rank is None else LockstepMotion(((0, 1),), 3, rank) for rank in ranks
    ]
    reports = [Report("run", (), RUN, RUN, lockstep=lockstep) for lockstep in runs]
    several = RepairSearch(search.log, [search.log] * len(reports), reports)
    assert several.has_few_directions is is_poor
    assert several.has_lockstep is bool(ranks)


def test_a_step_is_told_by_the_clock_of_its_run(search):
    """The sentence is made anew: nothing in it is replaced."""
    net = search.log.as_logged.with_event(LogEvent(1, 4.0))
    (issue,) = search.describe_faults(net)
    assert (issue.kind, issue.figures["t"]) == ("torque step", 4.0)
    assert "at t = 4 s and stays" in issue.what
    told = issue.by_clock(1.25)
    assert told.figures["t"] == 1.25
    assert told.where == "joint 2, t = 1.25 s"
    assert told.what == issue.what.replace("t = 4 s", "t = 1.25 s")
    assert told.figures["size"] == issue.figures["size"]
