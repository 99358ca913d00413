"""Tables of any names, units, order, separators and kinds: never an internal error, and
no column of one joint is ever read as another's.

Forty in the suite, 150 by ``pytest -m long tests/data/test_recogniser_fuzz.py``, two
thousand by ``-m slow``.
"""

import re
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sdp_vs_penalty.data import read_run
from sdp_vs_penalty.errors import InputError

FOLDER = Path(tempfile.mkdtemp(prefix="tables"))
#: Joints' names, in the order of the robot that has them all.
NAMES = ("shoulder_pan_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint")
NUMBERED = {
    "q": (
        "q{}",
        "q_{}",
        "pos[{}]",
        "joint_{}_position",
        "actual_q_{}",
        "position.{}",
        "J{}_pos",
        "Istposition A{}",
    ),
    "dq": (
        "dq{}",
        "qd_{}",
        "vel[{}]",
        "joint_{}_velocity",
        "actual_qd_{}",
        "qdot{}",
        "J{}_vel",
        "vitesse_{}",
    ),
    "tau": (
        "tau{}",
        "tau_{}",
        "effort[{}]",
        "joint_{}_effort",
        "torque_{}",
        "trq{}",
        "J{}_eff",
        "couple_{}",
    ),
}
NAMED = {
    "q": ("{}_position", "/left/{}/position", "q_{}"),
    "dq": ("{}_velocity", "/left/{}/velocity", "dq_{}"),
    "tau": ("{}_effort", "/left/{}/effort", "tau_{}"),
}
#: What names end with, and what the values are multiplied by to be SI.
ENDINGS = {
    "q": {"": 1.0, "_deg": np.pi / 180.0, " [rad]": 1.0, " (mrad)": 1e-3},
    "dq": {"": 1.0, "_deg_s": np.pi / 180.0, " [rad/s]": 1.0, " (rpm)": np.pi / 30.0},
    "tau": {"": 1.0, "_Nm": 1.0, " [mNm]": 1e-3},
}
OTHERS = (
    *("mode", "frame_id", "target_q_{}", "battery", "tcp_pose_{}", "", "note", "id"),
    *("tick", "x", "name", "value", "i", "M{}", "force_{}", "J{} [V]", "T{}", "joint"),
)
CLOCKS = ("t", "time", "timestamp", "Time [s]", "%time", None)


@dataclass(frozen=True)
class Table:
    """A text, how many joints it has, factors to SI, and whether joints are named."""

    text: str
    joints: int
    factors: dict[str, float]
    is_named: bool


@st.composite
def tables(draw):
    """A text table in any order of its columns."""
    joints = draw(st.integers(1, 4))
    first = draw(st.integers(0, 1))
    is_named = draw(st.booleans()) and joints > 1
    style = draw(st.integers(0, 2))
    endings = {g: draw(st.sampled_from(list(units))) for g, units in ENDINGS.items()}
    # One column of one group may be missing.
    lost = draw(st.sampled_from(["q", "dq", "tau", ""])), draw(st.integers(0, 3))
    columns = []
    for group in draw(st.sampled_from([("q", "tau"), ("q", "dq", "tau"), ("q",)])):
        pattern = NAMED[group][style]
        if not is_named:
            pattern = draw(st.sampled_from(NUMBERED[group]))
        for k in range(joints):
            called = NAMES[k] if is_named else str(first + k)
            if (group, k) != lost:
                columns.append((pattern.format(called) + endings[group], group, k))
    # A position alone and its target are a whole log of one joint.
    others = [x for x in OTHERS if lost[0] != "q" or x != "target_q_{}"]
    for name in draw(st.lists(st.sampled_from(others), max_size=3)):
        columns.append((name.format(0), "other", 0))
    clock = draw(st.sampled_from(CLOCKS))
    if clock:
        columns.append((clock, "t", 0))
    columns = draw(st.permutations(columns))
    mark = draw(st.sampled_from([",", ";", "\t", ", ", "|"]))
    is_comma = mark in (";", "\t", "|") and draw(st.booleans())
    strange = draw(st.sampled_from(["x", "", "7", "1e3", "[1 2]", "nan"]))
    rows = [mark.join(name for name, _, _ in columns)]
    for i in range(6):
        cells = []
        for _, group, k in columns:
            cell = strange if group == "other" else f"{value_of(group, k, i):.6f}"
            cells.append(cell.replace(".", ",") if is_comma else cell)
        rows.append(mark.join(cells))
    factors = {group: ENDINGS[group][ending] for group, ending in endings.items()}
    return Table("\n".join(rows) + "\n", joints, factors, is_named)


def value_of(group, joint, row):
    """A number that says whose it is: joint k of q lies in k + 1 to k + 1.1."""
    base = {"t": 0.0, "q": 0.0, "dq": 20.0, "tau": 40.0}[group]
    return base + joint + 1 + 0.01 * row


def require_right_or_refused(table):
    """What is read is each joint's own, in SI units; else one sentence."""
    path = FOLDER / "table.csv"
    path.write_text(table.text)
    names = NAMES[: table.joints] if table.is_named else None
    try:
        with warnings.catch_warnings(action="ignore"):
            run = read_run(path, None, names)
    except InputError:
        return
    assert run.n == table.joints
    expected = 1.0 + np.arange(table.joints)
    factors = table.factors
    np.testing.assert_allclose(run.q[0], factors["q"] * expected, rtol=1e-5)
    if not run.torque_logged:  # commands stand in its place where no torque is there
        assert not re.search(r"\b4[1-4][.,]", table.text)
        return
    tau = factors["tau"] * (40.0 + expected)
    np.testing.assert_allclose(run.tau[0], tau, rtol=1e-5)
    if run.dq is not None:
        dq = factors["dq"] * (20.0 + expected)
        np.testing.assert_allclose(run.dq[0], dq, rtol=1e-5)


ANY = settings(
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=list(HealthCheck),
)


@settings(ANY, max_examples=40)
@given(tables())
def test_a_table_is_read_right_or_refused(table):
    require_right_or_refused(table)


@pytest.mark.long
@settings(ANY, max_examples=150)
@given(tables())
def test_more_tables_are_read_right_or_refused(table):
    require_right_or_refused(table)


@pytest.mark.slow
@settings(ANY, max_examples=2000)
@given(tables())
def test_two_thousand_tables_are_read_right_or_refused(table):
    require_right_or_refused(table)
