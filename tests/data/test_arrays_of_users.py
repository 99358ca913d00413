"""Measurements from what people hold in a notebook: lists, pandas, dates."""

from typing import Any

import numpy as np
import pandas as pd
import pytest
from small_runs import small_run

from sdp_vs_penalty import InputError, Measurements, Problem, identify


def test_lists_and_pandas_objects_are_arrays(two_link: Problem):
    run = small_run(two_link)
    lists: Any = [x.tolist() for x in (run.t, run.q, run.tau)]
    frames: Any = [pd.Series(run.t), pd.DataFrame(run.q), pd.DataFrame(run.tau)]
    expected = identify(two_link, Measurements(run.t, run.q, run.tau), "ols")
    for t, q, tau in (lists, frames):
        model = identify(two_link, Measurements(t, q, tau), "ols")
        np.testing.assert_array_equal(model.theta, expected.theta)


@pytest.mark.parametrize(
    ("t", "q", "words"),
    [
        (pd.date_range("2026-01-01", periods=3), np.zeros((3, 2)), "t holds dates"),
        (np.arange(3.0), [["a", "b"]] * 3, "q holds dates or texts"),
        (np.arange(3.0), [[0.0, 1.0], [0.0]], "q holds rows of different lengths"),
    ],
)
def test_what_is_no_number_is_refused(t: Any, q: Any, words: str):
    with pytest.raises(InputError, match=words):
        Measurements(t, q, np.zeros((3, 2)))
