"""Events are what happens once: what comes back at the same phase of the motion is none."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from sdp_vs_penalty.diagnosis.events import _comes_back, _loudest, _odd_ones, _of_reversals
from sdp_vs_penalty.signals.repetition import Repeat

RATE, PERIOD = 10.0, 20.0
T = np.arange(400) / RATE  # two periods
NEVER = np.zeros((400, 1))


def stage(suspect: Any = None, slow: Any = NEVER) -> Any:
    """Rows of one run of one joint whose second half repeats the first."""
    first = np.arange(200)
    repeats = [Repeat(first, 0, T[first] + PERIOD)]
    return SimpleNamespace(
        rows=SimpleNamespace(segments=[SimpleNamespace(t=T)], rate=RATE, n=1, slow=slow),
        noise=SimpleNamespace(repeats=repeats, suspect=suspect),
    )


def around(*instants: float) -> Any:
    return np.any([np.abs(T - t) < 0.15 for t in instants], axis=0)[:, None]


def test_what_comes_back_faintly_and_a_little_later_is_no_event() -> None:
    loud, faint = around(2.24), around(2.24, 22.44)
    assert _comes_back(loud, faint, stage())[loud].all()
    assert _comes_back(around(22.24), around(2.24, 22.24), stage())[around(22.24)].all()


def test_what_happens_in_one_period_only_is_an_event() -> None:
    assert not _comes_back(around(2.24), around(2.24, 12.0), stage()).any()


def test_of_two_periods_that_differ_the_one_with_more_error_holds_the_event() -> None:
    for true, other in ((2.24, 22.24), (22.24, 2.24)):
        left = 0.01 * np.ones((400, 1)) + around(true)
        found = _odd_ones(stage(around(true, other)), left)
        assert found[around(true)].any()
        assert not found[around(other)].any()


def test_what_is_mostly_of_a_reversal_is_no_event() -> None:
    marked = around(2.24)
    for slow, none in ((around(2.24), True), (around(4.0), False)):
        rows: Any = SimpleNamespace(n=1, slow=slow.astype(float))
        assert _of_reversals(marked, marked.astype(float), rows)[marked].all() == none


def test_an_event_is_as_long_as_what_happens_in_it() -> None:
    left = 0.05 * np.ones(400)
    left[20:24] = 3.0
    assert _loudest(np.arange(10, 60), left).tolist() == [20, 21, 22, 23]
