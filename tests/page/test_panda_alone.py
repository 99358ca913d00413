"""The authors' Panda run alone on the page: how much is judged, and which findings hold
on other splits of it."""

import os
from pathlib import Path

import pytest
from page_sessions import do, opened

pytest.importorskip("nicegui", reason="the page needs the extra [page]")

from sdp_vs_penalty import load_measurements
from sdp_vs_penalty.data import save
from sdp_vs_penalty.page.splits import CONFIRMED_SHARE, JUDGED_SHARE, N_SPLITS

pytestmark = [pytest.mark.slow, pytest.mark.real_data]


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """The run dropped, identified and diagnosed."""
    from page_sessions import Here

    from sdp_vs_penalty.page import Sessions

    folder = tmp_path_factory.mktemp("panda")
    run = load_measurements(Path(os.environ["SDP_VS_PENALTY_DATA"]) / "panda", joints=7)
    save(run, folder / "panda.csv")
    sessions = Sessions(Here())
    s = opened(sessions, "panda", **{"panda.csv": folder / "panda.csv"})
    do(s, s.identify, s.diagnose)
    return s


def test_a_fifth_of_the_run_is_judged(session):
    assert session.runs[0]["split"]["judged_share"] >= JUDGED_SHARE
    compared = session.current.comparison
    assert compared["facts"]["judged_seconds"]["value"] >= 4.0
    assert compared["new_motion_share"] == pytest.approx(1.0)


def test_no_finding_is_confident_that_few_splits_show(session):
    for finding in session.findings.effects:
        if finding.rating == "confident":
            assert finding.n_splits >= N_SPLITS - 1
            assert finding.n_splits_showing >= CONFIRMED_SHARE * finding.n_splits - 1e-9
