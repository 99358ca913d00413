"""A pause, or a clock that was set, cuts a file into runs; the stamps' span is nothing."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from small_runs import small_run

from sdp_vs_penalty import compare, identify
from sdp_vs_penalty.cli.main import main
from sdp_vs_penalty.data.stretches import is_set_back, rows_behind_gaps
from sdp_vs_penalty.signals import Preprocessing
from sdp_vs_penalty.signals.segments import segmented

_EPOCH = 1.7e9


def with_jump(run, seconds, row=500):
    """The run with its clock set ahead, or back, by some seconds before a row."""
    return replace(run, t=run.t + seconds * (np.arange(run.samples) >= row))


@pytest.fixture(scope="module")
def run(two_link):
    return small_run(two_link, seconds=10.0)


@pytest.mark.parametrize("jump", [60.0, 600.0, _EPOCH, -2.0, -_EPOCH])
def test_the_size_of_a_jump_of_the_clock_changes_nothing(run, two_link, jump):
    # Of the same samples the torque errors are those of two files to the last digits.
    halves = [run.rows(slice(0, 500), "a"), run.rows(slice(500, None), "b")]
    expected = identify(two_link, halves, "ols")
    model = identify(two_link, with_jump(run, jump), "ols", check=False)
    # Stamps since 1970 have seven digits behind the point.
    np.testing.assert_allclose(model.theta, expected.theta, rtol=5e-3, atol=5e-3)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("samples", [1, 20])
def test_a_stretch_that_is_too_short_for_the_filters_is_left_out(
    run, two_link, samples
):
    jumped = with_jump(with_jump(run, 60.0), 60.0, 500 + samples)
    without = run.rows(np.r_[0:500, 500 + samples : 1000])
    expected = identify(two_link, with_jump(without, 60.0), "ols", check=False)
    model = identify(two_link, jumped, "ols", check=False)
    np.testing.assert_allclose(model.theta, expected.theta, rtol=1e-9, atol=1e-9)


def test_a_diagnosis_judges_without_a_stretch_that_is_too_short(run):
    jumped = with_jump(with_jump(run, 60.0), 60.0, 520)
    rows = segmented(jumped, Preprocessing(5.0, 8.0))
    assert [segment.run for segment in rows.segments] == [0, 2]


def test_nothing_is_as_large_as_the_span_of_the_stamps(run, two_link):
    jumped = with_jump(run, _EPOCH)
    tracemalloc.start()
    model = identify(two_link, jumped, "ols", check=False)
    compare(model, jumped)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 200e6


@pytest.mark.parametrize("jump", [60.0, pytest.param(-60.0, marks=pytest.mark.long)])
def test_every_verb_takes_a_file_whose_clock_was_set(
    run, tmp_path, monkeypatch, capsys, jump
):
    monkeypatch.chdir(tmp_path)
    text = "\n".join(
        ",".join(f"{x:.9g}" for x in row)
        for row in np.column_stack([with_jump(run, jump).t, run.q, run.tau])
    )
    (tmp_path / "run.csv").write_text(f"t,q1,q2,tau1,tau2\n{text}\n", "utf-8")
    for words in (
        "identify two_link --data run.csv --out m.json",
        "check two_link --data run.csv",
        "compare m.json --data run.csv",
        "report m.json --data run.csv --out r.html",
        "diagnose m.json --data run.csv --json f.json",
    ):
        with pytest.raises(SystemExit) as end:
            main(words.split())
        assert end.value.code in (None, 0), words
    printed = capsys.readouterr()
    assert "the clock" in printed.out + printed.err


def test_runs_have_the_names_of_their_file(run):
    cut = with_jump(run, 60.0).cut_at_pauses
    (name,) = run.names
    assert cut.names == (f"{name}, stretch 1 of 2", f"{name}, stretch 2 of 2")
    assert [part.samples for part in cut.runs()] == [500, 500]
    assert cut.seconds == pytest.approx(9.98)
    assert cut.cut_at_pauses is cut
    assert run.cut_at_pauses is run


def test_a_second_between_episodes_is_a_gap_and_no_pause(run):
    apart = with_jump(run, 0.99)
    assert apart.cut_at_pauses is apart
    assert rows_behind_gaps(apart.t).tolist() == [500]


def test_misplaced_rows_are_no_clock_that_was_set_back(run):
    assert is_set_back(with_jump(run, -60.0).t)
    assert not is_set_back(with_jump(run, -60.0, 970).t)
    assert not is_set_back(run.t[::-1])
    assert not is_set_back(run.t)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_run_between_infinite_stamps_is_shown(run):
    t = np.r_[np.inf, run.t[1:-1], np.inf]
    assert "length: nan s, 100 Hz, 1000 samples" in " ".join(
        repr(replace(run, t=t)).split()
    )
