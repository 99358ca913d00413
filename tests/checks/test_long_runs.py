"""Runs too long to be judged at once have one report each, whoever asks."""

from dataclasses import replace
from pathlib import Path

import pytest
from commands import run_cli
from judged import report_of_run
from page_sessions import Here, opened
from small_runs import small_run

from sdp_vs_penalty import check
from sdp_vs_penalty.data import concatenate, save
from sdp_vs_penalty.page import Sessions

#: Samples above which windows stand for a run.
LONG = 8 * 2**15


@pytest.fixture(scope="module")
def long_run(two_link):
    """270 000 rows: 270 s at 1 kHz."""
    run = small_run(two_link, 270.0, rate=1000.0)
    assert run.samples > LONG
    return replace(run, names=("long",))


@pytest.fixture(scope="module")
def flipped(long_run):
    """The same with both torques' signs wrong."""
    return replace(long_run, tau=-long_run.tau, names=("flipped",))


@pytest.fixture(scope="module")
def flipped_report(two_link, flipped):
    """What the check says of both wrong signs."""
    report = report_of_run(two_link, flipped)
    return report


def test_a_long_run_has_one_report(two_link, long_run):
    report = report_of_run(two_link, long_run)
    assert report.run == "long"
    assert report.errors_and_warnings == ()
    assert report.repaired_all.samples == long_run.samples


@pytest.mark.long
def test_long_and_short_runs_have_a_report_each(two_link, long_run):
    short = replace(small_run(two_link, 20.0, seed=1), names=("short",))
    reports = check(two_link, concatenate([short, long_run]), thorough=False)
    assert [r.run for r in reports] == ["short", "long"]


@pytest.mark.long
def test_an_issue_of_all_windows_is_listed_once(flipped_report):
    (issue,) = (i for i in flipped_report.issues if i.kind == "torque sign")
    assert issue.what.startswith(
        "Seen in 4 of 4 stretches; in flipped from sample 1 on"
    )


def test_a_long_run_offers_no_repair(flipped_report):
    assert not any(issue.can_fix for issue in flipped_report.issues)


def test_unusable_rows_of_a_long_run_are_one_error(two_link, long_run):
    q = long_run.q.copy()
    q[LONG + 100, 0] = float("nan")
    report = report_of_run(two_link, replace(long_run, q=q))
    assert [i.severity for i in report.issues] == ["error"]
    assert report.is_long


@pytest.mark.long
def test_fix_of_a_long_run_says_what_to_do(two_link, long_run, tmp_path, capsys):
    file = tmp_path / "long.npz"
    save(long_run, file)
    fix = ["--fix", tmp_path / "fixed.csv"]
    assert run_cli("check", "two_link", "--data", file, *fix) == 2
    said = capsys.readouterr().err
    assert "long.npz: --fix: too long to be repaired: cut it into files" in said


@pytest.mark.long
def test_a_long_run_dropped_on_the_page_becomes_one_run(long_run, tmp_path):
    file = tmp_path / "long.npz"
    save(long_run, file)
    sessions = Sessions(Here())
    session = opened(sessions, "two_link", **{"long.npz": Path(file)})
    (run,) = session.runs
    assert run["samples"] == long_run.samples
    assert len(session.arrays(run["view"])["t"]) < 10_000
    sessions.close()
