"""Logs of common programs are read without a typed column."""

import numpy as np
import pytest

from sdp_vs_penalty import InputError, convert, load_measurements
from sdp_vs_penalty.data.formats.recognition import recognised

UR = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]


def columns(*patterns: str, first: int = 0, n: int = 6) -> list[str]:
    return [p.format(k) for p in patterns for k in range(first, first + n)]


LAYOUTS = {
    "RTDE": ["timestamp", *columns("target_q_{}", "actual_q_{}", "actual_qd_{}", "actual_current_{}")],
    "RTDE in ms": ["timestamp_ms", *columns("actual_q_{}", "actual_current_{}")],
    "rostopic echo": [
        "%time", *columns("field.position{}", "field.velocity{}", "field.effort{}")
    ],
    "joint states by name": [
        "__time", *(f"/joint_states/{j}_joint/{k}" for j in UR for k in ("position", "effort"))
    ],
    "joint states by number": [
        "__time", *columns("/joint_states/position[{}]", "/joint_states/effort[{}]")
    ],
    "franka": ["time", *columns("q[{}]", "dq[{}]", "tau_J[{}]", "tau_ext_hat_filtered[{}]", "q_d[{}]")],
    "xArm": ["time", *columns("joint{}_angle_deg", "joint{}_torque", first=1)],
    "Kinova": ["timestamp", *columns("actuator_{}_position", "actuator_{}_torque")],
    "plain": ["t", *columns("q_{}", "qd_{}", "tau_{}")],
    "axes": ["Time", *columns("A{} position", "A{} torque", first=1)],
    "blocks": ["Time", "jointPositions", "jointVelocities", "jointTorques"],
}  # fmt: skip


@pytest.mark.filterwarnings("ignore:.*columns recognised")
@pytest.mark.parametrize("name", [name for name in LAYOUTS if name != "blocks"])
def test_a_file_of_a_layout_is_read_as_identify_reads_it(name, tmp_path):
    """Each joint's columns go to that joint, whatever their order in the file."""
    path, columns_ = tmp_path / "log.csv", LAYOUTS[name]
    values = np.random.default_rng(2).normal(size=(12, len(columns_)))
    values[:, 0] = np.arange(12.0)
    lines = [",".join(columns_), *(",".join(map(repr, row)) for row in values.tolist())]
    path.write_text("\n".join(lines) + "\n")
    found = recognised(columns_, [f"{j}_joint" for j in UR])
    assert "target" not in " ".join(found.rename.values())
    assert found.scale.get("t") == (1e-3 if "ms" in name else None)
    assert found is not None
    run = load_measurements(path, joints=6, names=[f"{j}_joint" for j in UR])
    for block, ours in ((run.q, "q"), (run.tau, "tau")):
        at = [columns_.index(found.rename[f"{ours}{j}"]) for j in range(1, 7)]
        units = [found.scale.get(f"{ours}{j}", 1.0) for j in range(1, 7)]
        np.testing.assert_allclose(block, values[:, at] * units)


def test_what_is_no_log_is_not_recognised():
    assert recognised(["a", "b", "c"]) is None
    assert recognised(["time", "price", "volume"]) is None
    assert recognised(["time", *columns("q_{}", first=3)]) is None  # three joints are missing


def test_a_log_is_read_and_converted(tmp_path):
    path = tmp_path / "ur.csv"
    t = 8.0 * np.arange(20)
    x = np.random.default_rng(0).normal(size=(20, 4))
    head = "timestamp_ms,actual_q_0,actual_q_1,actual_current_0,actual_current_1"
    rows = np.column_stack([t, x]).tolist()
    path.write_text(head + "\n" + "\n".join(",".join(map(repr, r)) for r in rows) + "\n")
    with pytest.warns(UserWarning, match="columns recognised"):
        run = load_measurements(path)
    np.testing.assert_allclose(run.t, 1e-3 * t)
    np.testing.assert_array_equal(run.q, x[:, :2])
    rename = {"t": "timestamp_ms", "q*": "actual_q_*", "tau*": "actual_current_*"}
    run = convert(path, rename=rename, scale={"t": "ms", "tau": "10:8.5", "q": "deg"})
    np.testing.assert_allclose(run.tau, x[:, 2:] * [10.0, 8.5])
    np.testing.assert_allclose(run.q, np.radians(x[:, :2]))
    with pytest.raises(InputError, match="3 factors"):
        convert(path, rename=rename, scale={"tau": "1:2:3"})
    with pytest.raises(InputError, match="give a number"):
        convert(path, rename=rename, scale={"tau": "furlong"})
