"""One run alone: what is identified from, and what is judged."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="the page needs the extra [page]")

from sdp_vs_penalty.page import splits
from sdp_vs_penalty.signals.phases import filter_reach


@pytest.fixture(scope="module")
def run(hidden):
    return hidden.runs[0]


def test_a_fifth_of_a_run_is_judged_behind_the_filters(two_link, run):
    split = splits.split_run(two_link, run)
    reach = filter_reach(run, two_link.preprocessing.resolve(run))
    judged = sum(max(end - begin - reach, 0.0) for begin, end in split["test"])
    assert judged >= splits.JUDGED_SHARE * (run.t[-1] - run.t[0] - reach)


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
