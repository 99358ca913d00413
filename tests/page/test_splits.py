"""One run alone: what is judged, and what other splits say of a finding."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="the page needs the extra [page]")

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.diagnosis import Finding
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.page import splits

FOUND = Finding(
    effect="torque_gain",
    joints=(6,),
    shape={},
    size=0.2,
    unit="-",
    std=0.01,
    parameters={},
    confidence="confident",
    indistinguishable_from=(),
    held_out_rmse_before=np.full(7, 2.0),
    held_out_rmse_after=np.full(7, 1.0),
    physics="",
    text="torque_gain:6",
    gain=50.0,
)
SHOWS = {("torque_gain", (6,))}


def counted(n_showing, n_splits=6):
    shown = [SHOWS] * n_showing + [set()] * (n_splits - n_showing)
    return splits._with_splits(FOUND, shown)


@pytest.mark.parametrize("n_showing", [4, 5, 6])
def test_two_thirds_of_the_splits_leave_a_finding_confident(n_showing):
    finding = counted(n_showing)
    assert finding.rating == "confident"
    assert finding.splits_sentence == f"Shown by {n_showing} of 6 splits of this run."


@pytest.mark.parametrize("n_showing", [1, 2, 3])
def test_fewer_make_it_weak(n_showing):
    finding = counted(n_showing)
    assert finding.rating == "weak"
    assert not finding.torque_is_certain
    assert f"{n_showing} of 6" in finding.splits_sentence


def test_a_near_tie_is_not_counted():
    tie = replace(FOUND, confidence="weak", doubts=(Doubt("rivals"),))
    assert splits._with_splits(tie, [set()] * 6) == tie


@pytest.fixture(scope="module")
def run(hidden):
    return hidden.runs[0]


def test_a_fifth_of_a_run_is_judged_behind_the_filters(two_link, run):
    assert splits.split_run(two_link, run)["judged_share"] >= splits.JUDGED_SHARE


def test_a_share_that_a_person_chose_is_kept(two_link, run):
    assert splits.split_run(two_link, run, 0.55)["share"] == 0.55


def test_no_window_lies_in_the_rest_after_a_motion(two_link, run):
    """The filters leave no row of such a window: a diagnosis would end in an error."""
    rest = run.t[-1] + 0.01 * np.arange(1, 501)
    many = np.ones((500, 1))
    still = replace(
        run,
        t=np.append(run.t, rest),
        q=np.vstack([run.q, run.q[-1] * many]),
        dq=None,
        tau=np.vstack([run.tau, run.tau[-1] * many]),
        run=None,
    )
    split = splits.split_run(two_link, still)
    assert all(begin < run.t[-1] for begin, _ in split["train"] + split["test"])


def test_other_splits_test_elsewhere(two_link, run):
    split = splits.split_run(two_link, run)
    others = splits.other_splits(two_link, run, split)
    assert len(others) == splits.N_SPLITS - 1
    starts = {round(test[0][0], 2) for _, test in others}
    assert len(starts) == len(others)
    assert round(split["test"][0][0], 2) not in starts


def test_other_splits_judge_as_much(two_link, run):
    split = splits.split_run(two_link, run)
    for _, test in splits.other_splits(two_link, run, split):
        assert sum(b - a for a, b in test) >= 0.8 * split["test_seconds"]


@pytest.mark.long
def test_friction_in_a_run_alone_is_shown_by_its_splits(tmp_path):
    """Dropped alone, identified and diagnosed: the card counts the splits."""
    from page_sessions import Here, Screen, saved

    from sdp_vs_penalty.page import Sessions
    from sdp_vs_penalty.simulation.hidden_runs import hidden_runs

    problem = load_problem("two_link")
    (run, *_) = hidden_runs(problem, [("stribeck_friction", [0])], "strong", 24, 1).runs
    session = Sessions(Here()).new()
    screen = Screen(session)
    screen.do(session.start, session.choose_robot, "two_link")
    thin = run.rows(slice(None, None, 5))
    session.arrived |= saved(tmp_path, [thin], "alone.csv")
    screen.do(session.read_arrived)
    screen.click("identify", "diagnose")
    (found,) = session.findings.effects
    assert (found.effect, found.rating) == ("stribeck_friction", "confident")
    assert found.n_splits == splits.N_SPLITS
    assert found.n_splits_showing >= splits.CONFIRMED_SHARE * found.n_splits - 1e-9
    assert found.splits_sentence in screen.text("findings")
