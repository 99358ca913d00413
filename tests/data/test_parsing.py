"""What users write in a word: numbers, windows of time, pairs of names."""

import numpy as np
import pytest
from drawn import given, st
from recorded import refusal

from sdp_vs_penalty.data import parsing

lists_of_numbers = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=4)


@given(lists_of_numbers)
def test_numbers_are_read_as_they_are_written(values):
    text = ",".join(map(repr, values))
    assert parsing.numbers("--x", text) == values


@given(lists_of_numbers)
def test_so_many_numbers_are_read(values):
    text = ",".join(map(repr, values))
    assert parsing.numbers("--x", text, len(values)) == values


@given(lists_of_numbers)
def test_another_count_of_numbers_is_refused(values):
    text = ",".join(map(repr, values))
    count = len(values) + 1
    refusal(
        lambda: parsing.numbers("--x", text, count),
        "--x ",
        str(count),
        "numbers separated by commas",
    )


@pytest.mark.parametrize("text", ["1,", "", "a"])
def test_what_is_no_list_of_numbers_is_refused(text):
    refusal(lambda: parsing.numbers("--x", text), "--x ", "numbers separated by commas")


@pytest.mark.parametrize(
    ("text", "windows"),
    [
        (None, [(0.0, np.inf)]),
        ("2:", [(2.0, np.inf)]),
        (":3.5", [(0.0, 3.5)]),
        (":", [(0.0, np.inf)]),
        ("0:1,1:2", [(0.0, 1.0), (1.0, 2.0)]),
        ("0:14,20:", [(0.0, 14.0), (20.0, np.inf)]),
    ],
)
def test_windows_of_time_are_read(text, windows):
    assert parsing.time_windows(text) == windows


@pytest.mark.parametrize("text", ["3", "-1:2", "2:2", "1:2,0:1", "0:2,1:3", "a:b"])
def test_windows_that_are_not_in_order_are_refused(text):
    refusal(lambda: parsing.time_windows(text), "START:STOP")


def test_pairs_are_ours_and_theirs():
    pairs = parsing.pairs("--rename", " t = time,q=q m")
    assert pairs == {"t": "time", "q": "q m"}


def test_no_pairs_are_none():
    assert parsing.pairs("--rename", None) is None


@pytest.mark.parametrize("text", ["t", "t=", "=x", "t=x,"])
def test_half_a_pair_is_refused(text):
    refusal(lambda: parsing.pairs("--rename", text), "OURS=THEIRS")
