"""Events are what happens once: what comes back at the same phase of the motion is none."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sdp_vs_penalty.diagnosis import ladder
from sdp_vs_penalty.diagnosis.remaining import _odd_ones, _repeating
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
    assert _repeating(loud, faint, stage())[loud].all()
    assert _repeating(around(22.24), around(2.24, 22.24), stage())[around(22.24)].all()


def test_what_happens_in_one_period_only_is_an_event() -> None:
    assert not _repeating(around(2.24), around(2.24, 12.0), stage()).any()


def test_of_two_periods_that_differ_the_one_with_more_error_holds_the_event() -> None:
    for true, other in ((2.24, 22.24), (22.24, 2.24)):
        left = 0.01 * np.ones((400, 1)) + around(true)
        state: Any = SimpleNamespace(stage=stage(around(true, other)), residual=left)
        found = _odd_ones(state)
        assert found[around(true)].any()
        assert not found[around(other)].any()


def test_periods_that_differ_where_friction_turns_round_hold_no_event() -> None:
    # The window that stands out is wider than the reversal; the other period has none of its error.
    left = 0.01 * np.ones((400, 1)) + around(2.24)
    wide = np.any([np.abs(T - t) < 1.0 for t in (2.24, 22.24)], axis=0)[:, None]
    for slow, found in ((around(2.24, 22.24), False), (around(4.0, 24.0), True)):
        state: Any = SimpleNamespace(stage=stage(wide, slow.astype(float)), residual=left)
        assert _odd_ones(state).any() == found


def test_opposed_causes_of_the_whole_robot_are_neither(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    rate, third = rng.normal(size=(2, 60, 1))
    curved = rate + 0.3 * rng.normal(size=(60, 1))
    monkeypatch.setattr(ladder, "spread_columns", lambda rows, effect: effect[None])

    def candidate(name: str, joint: int | None, columns: Any) -> Any:
        return SimpleNamespace(key=(name, joint), columns=columns, effect=columns, beta=np.ones(1))

    def beside(pick: Any, left: Any) -> Any:
        fit = SimpleNamespace(scaled=lambda x: x, partialled=lambda x: x, residual=left[:, 0])
        one = SimpleNamespace(candidate=candidate("torque_filter", None, pick))
        rows = SimpleNamespace(torque=left)
        found = SimpleNamespace(stage=SimpleNamespace(rows=rows), picks=(one,))
        found.without = lambda k: SimpleNamespace(fit=fit)
        return found

    early = candidate("global_delay", None, curved)
    assert ladder._cancels(beside(rate, 8.0 * rate - 7.0 * curved), early)
    assert not ladder._cancels(beside(rate, 8.0 * rate + 7.0 * curved), early)
    assert not ladder._cancels(beside(third, 8.0 * third - 7.0 * curved), early)
    late = candidate("torque_delay", 2, curved)
    assert not ladder._cancels(beside(rate, 8.0 * rate - 7.0 * curved), late)


def test_a_zero_that_is_off_is_named_before_errors_of_every_joint() -> None:
    def candidate(name: str, chi2: float, mostly: str = "") -> Any:
        return SimpleNamespace(
            key=(name, None), chi2=chi2, effect=SimpleNamespace(name=name, mostly=mostly)
        )

    whole = candidate("kinematic_error", 100.0, "joint_zero_error")
    zeros = {0: 20.0, 1: 60.0, 2: 55.0}

    def contenders(only: Any) -> list[Any]:
        return [candidate(only[0], zeros[only[1]])]

    state: Any = SimpleNamespace(contenders=contenders, fit=SimpleNamespace(rows=SimpleNamespace(n=3)))
    assert [h.chi2 for h in ladder._mostly(state, whole)] == [60.0]
    zeros[1] = zeros[2] = 40.0
    assert ladder._mostly(state, whole) == []
    assert ladder._mostly(state, candidate("base_tilt", 10.0)) == []
    assert not ladder._says_most(candidate("base_tilt", 90.0), whole)
