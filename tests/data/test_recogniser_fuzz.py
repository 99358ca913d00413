"""Two thousand tables of any names, units, order, separators and kinds: never an internal
error, and no column of one joint is ever read as another's."""

import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sdp_vs_penalty.data import read_run
from sdp_vs_penalty.errors import InputError

FOLDER = Path(tempfile.mkdtemp(prefix="tables"))
WORDS = {
    "q": ("q{}", "q_{}", "pos[{}]", "joint_{}_position", "actual_q_{}", "position.{}"),
    "dq": ("dq{}", "qd_{}", "vel[{}]", "joint_{}_velocity", "actual_qd_{}", "dq_{}"),
    "tau": ("tau{}", "tau_{}", "effort[{}]", "joint_{}_effort", "torque_{}", "trq{}"),
}
OTHERS = ("mode", "frame_id", "target_q_{}", "battery", "tcp_pose_{}", "", "note")
CLOCKS = ("t", "time", "timestamp", "time_ms", "%time", None)


@st.composite
def tables(draw: Any) -> tuple[str, int, float]:
    """A text table, how many joints it has, and whether units are degrees."""
    joints = draw(st.integers(1, 4))
    first = draw(st.integers(0, 1))
    style = {group: draw(st.sampled_from(words)) for group, words in WORDS.items()}
    unit = draw(st.sampled_from(["", "_deg", " [rad]"]))
    clock = draw(st.sampled_from(CLOCKS))
    columns: list[tuple[str, str, int]] = []
    # One column of one group may be missing.
    lost = draw(st.sampled_from(["q", "dq", "tau", ""])), draw(st.integers(0, 3))
    for group in draw(st.sampled_from([("q", "tau"), ("q", "dq", "tau"), ("q",)])):
        suffix = unit if group == "q" else ""
        for k in range(joints):
            if (group, k) != lost:
                name = style[group].format(first + k) + suffix
                columns.append((name, group, k))
    for name in draw(st.lists(st.sampled_from(OTHERS), max_size=3)):
        columns.append((name.format(0), "other", 0))
    if clock:
        columns.append((clock, "t", 0))
    columns = draw(st.permutations(columns))
    mark = draw(st.sampled_from([",", ";", "\t", ", "]))
    odd = draw(st.sampled_from(["x", "", "7", "1e3", "[1 2]", "nan"]))
    rows = [mark.join(name for name, _, _ in columns)]
    for i in range(6):
        cells = [
            odd if group == "other" else f"{value_of(group, k, i):.6f}"
            for _, group, k in columns
        ]
        rows.append(mark.join(cells))
    return "\n".join(rows) + "\n", joints, 1.0 if unit != "_deg" else np.pi / 180.0


def value_of(group: str, joint: int, row: int) -> float:
    """A number that says whose it is: joint k of q lies in k + 1 to k + 1.1."""
    base = {"t": 0.0, "q": 0.0, "dq": 20.0, "tau": 40.0}[group]
    return base + joint + 1 + 0.01 * row


@pytest.mark.long
@settings(
    max_examples=2000,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=list(HealthCheck),
)
@given(tables())
def test_a_table_is_read_right_or_refused(made: tuple[str, int, float]) -> None:
    text, joints, unit = made
    path = FOLDER / "table.csv"
    path.write_text(text)
    try:
        with warnings.catch_warnings(action="ignore"):
            run = read_run(path)
    except InputError:
        return
    assert run.n == joints
    expected = 1.0 + np.arange(joints)
    np.testing.assert_allclose(run.q[0], unit * expected, rtol=1e-5)
    np.testing.assert_allclose(run.tau[0], 40.0 + expected, rtol=1e-5)
    if run.dq is not None:
        np.testing.assert_allclose(run.dq[0], 20.0 + expected, rtol=1e-5)
