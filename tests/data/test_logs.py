"""Logs as other programs write them: separators, decimal marks, stamps, names, lists,
columns that nobody needs, no clock; the same numbers come out of all of them."""

import json
import re
import shlex

import numpy as np
import pytest
from commands import run_cli
from logger_samples import SAMPLES, sample_file, sample_run
from recorded import refusal
from scipy.io import savemat
from small_runs import write_bag

from sdp_vs_penalty import convert, load_measurements
from sdp_vs_penalty.data import LOGGERS, read_run, recognise
from sdp_vs_penalty.data.hypotheses.recognition import find_clock
from sdp_vs_penalty.data.log import Column
from sdp_vs_penalty.errors import Remark

JOINTS = ("joint1", "joint2")
RUN = sample_run()
#: What a file keeps of the numbers: floats of 32 bits.
COARSE = {"lerobot.parquet": 2e-6, "lerobot_current.parquet": 2e-6}


def read_sample(name):
    """A sample's run, and the remarks about it."""
    with pytest.warns(Remark) as heard:
        run = read_run(sample_file(name), 2, JOINTS)
    return run, " ".join(str(w.message) for w in heard)


def test_every_logger_of_the_table_has_its_sample():
    assert {logger["sample"] for logger in LOGGERS} <= set(SAMPLES)
    assert all(logger["source"] for logger in LOGGERS)


@pytest.mark.parametrize("name", SAMPLES)
def test_the_same_motion_comes_out_of_every_log(name):
    """At its rate, and a logger of the table is called by its name."""
    run, said = read_sample(name)
    atol = COARSE.get(name, 1e-8)
    np.testing.assert_allclose(run.q, RUN.q, atol=atol)
    np.testing.assert_allclose(run.tau, RUN.tau, atol=20.0 * atol)
    steps = np.diff(run.t)
    np.testing.assert_allclose(steps[np.abs(steps - 0.02) < 0.1], 0.02, atol=1e-6)
    (logger,) = [x["name"] for x in LOGGERS if x["sample"] == name] or [""]
    assert f"columns recognised ({logger}" in said


@pytest.mark.parametrize("name", sorted(set(SAMPLES) - {*COARSE, "lists.csv"}))
def test_the_printed_command_reads_the_same(name, tmp_path, monkeypatch):
    run, said = read_sample(name)
    (command,) = re.findall("the same by `sdp-vs-penalty (.*?)`", said)
    monkeypatch.chdir(tmp_path)
    assert run_cli(*shlex.split(command)) == 0
    again = load_measurements("run.csv")
    np.testing.assert_allclose(again.q, run.q, rtol=1e-10)
    np.testing.assert_allclose(again.t, run.t, rtol=1e-10)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(x, marks=pytest.mark.long if k else ())
        for k, x in enumerate(SAMPLES)
    ],
)
def test_a_sample_goes_from_convert_through_check_to_identify(
    name, tmp_path, monkeypatch
):
    """All are one motion, which each was read right of above: one is enough."""
    monkeypatch.chdir(tmp_path)
    convert_ = ("convert", sample_file(name), "--problem", "two_link", "--out", "a.csv")
    assert run_cli(*convert_) == 0
    options = ("--method", "ols", "--out", "m.json")
    assert run_cli("identify", "two_link", "--data", "a.csv", *options) == 0
    assert run_cli("check", "two_link", "--data", "a.csv") == 0


@pytest.mark.parametrize("mcap", [False, True])
def test_a_bag_goes_from_convert_through_check_to_identify(mcap, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_bag(tmp_path / "bag", RUN, mcap=mcap, names=["joint2", "joint1"])
    assert run_cli("convert", "bag", "--problem", "two_link", "--out", "a.csv") == 0
    np.testing.assert_allclose(load_measurements("a.csv").tau, RUN.tau)
    assert run_cli("check", "two_link", "--data", "a.csv") == 0
    options = ("--method", "ols", "--out", "m.json")
    assert run_cli("identify", "two_link", "--data", "bag", *options) == 0


def test_joints_that_are_called_otherwise_keep_the_order_of_the_file():
    with pytest.warns(Remark, match="in the file's order"):
        run = read_run(sample_file("ros2_echo.csv"), 2, ("shoulder", "elbow"))
    np.testing.assert_allclose(run.q, RUN.q[:, ::-1])


def table(path, head, rows, mark=","):
    lines = [mark.join(f"{x:.10g}" for x in row) for row in rows]
    path.write_text("\n".join([head, *lines]) + "\n")
    return path


BARE = np.column_stack([RUN.q, RUN.dq, RUN.tau])
HEAD = "q1,q2,dq1,dq2,tau1,tau2"


def test_a_rate_stands_for_the_clock_in_every_format(tmp_path):
    import pyarrow as arrow
    from pyarrow import parquet

    columns = dict(zip(HEAD.split(","), BARE.T, strict=True))
    table(tmp_path / "a.csv", HEAD, BARE)
    table(tmp_path / "headless.csv", ",".join(f"{x:.10g}" for x in BARE[0]), BARE[1:])
    np.savez(tmp_path / "a.npz", **columns)
    savemat(tmp_path / "a.mat", columns)
    parquet.write_table(arrow.table(columns), tmp_path / "a.parquet")
    table(tmp_path / "named.csv", HEAD.replace("q", "x"), BARE)
    for path in sorted(tmp_path.iterdir()):
        rename = {"q*": "x*", "tau*": "tau*"} if path.stem == "named" else None
        run = convert(path, rate=50.0, rename=rename)
        np.testing.assert_allclose(run.t, RUN.t, atol=1e-9, err_msg=path.name)
        np.testing.assert_allclose(run.q, RUN.q, err_msg=path.name)
    refusal(lambda: convert(tmp_path / "a.csv", rate=-1.0), "not a frequency")


@pytest.mark.parametrize("clock", [0, 1])
def test_more_columns_of_each_joint_than_three_are_ambiguous(tmp_path, clock):
    """Of a robot of six joints: velocities tell positions, not which others are torques."""
    t = 0.01 * np.arange(300)
    speeds = np.random.default_rng(0).uniform(1.0, 6.0, (5, 6))
    blocks = np.sin(np.einsum("k,bj->kbj", t, speeds))
    blocks[:, 2] = speeds[1] * np.cos(np.outer(t, speeds[1]))
    rows = np.hstack([np.tile(t[:, None], clock), blocks.reshape(300, 30)])
    path = tmp_path / "run.csv"
    np.savetxt(path, rows, delimiter=",")
    said = refusal(
        lambda: read_run(path, 6, tuple("abcdef")), f"{30 + clock} columns may be"
    )
    assert "5 columns of each of 6 joints" in said
    assert f"q1=#{7 + clock},q2" in said
    assert f"dq6=#{18 + clock}" in said
    assert "q7" not in said
    assert ("a clock and" in said) is bool(clock)
    assert ("--rate 100" in said) is not bool(clock)


def test_the_column_that_counts_runs_puts_them_apart(tmp_path):
    """Two of three rows; their clocks begin at 0 again, a second apart."""
    path = tmp_path / "episodes.csv"
    rows = [f"{t},{t},{take},{take}" for take in (0, 1) for t in (0.0, 0.1, 0.2)]
    path.write_text("\n".join(["t,q1,tau1,take", *rows]) + "\n")
    run = read_run(path)
    np.testing.assert_allclose(run.t, [0.0, 0.1, 0.2, 1.2, 1.3, 1.4])


@pytest.mark.parametrize("word", ["effort", "torque", "current"])
def test_torques_of_lerobot_have_any_of_its_words(word):
    columns = ["timestamp", "observation.state", f"observation.{word}"]
    recognition = recognise(columns)
    assert recognition.rename == dict(zip(("t", "q", "tau"), columns, strict=True))
    assert recognition.logger.startswith("LeRobot")
    assert recognition.torque_unit == ("A" if word == "current" else "")


def test_a_duration_is_no_clock():
    """Its word ranks before that of the clock, but its values fall."""
    cells = {"timestamp": ["0", "5", "10"], "cycle_time_us": ["5003", "4999", "5002"]}
    assert find_clock({x: Column(cells=y) for x, y in cells.items()}) == "timestamp"


def test_one_column_is_of_the_joint_that_it_numbers():
    assert recognise(["t", "q1", "target_q_0"]) is None
    assert recognise(["t", "q1", "target_q_1"]) is not None


def test_commands_of_a_known_logger_hide_no_torques():
    """Columns of LeRobot a joint, with efforts that its entry does not list."""
    state = [f"observation.joint{k}.{x}" for x in ("pos", "effort") for k in (1, 2)]
    found = recognise(["timestamp", *state, "action.joint1.pos", "action.joint2.pos"])
    assert found.logger == "LeRobot"
    assert [*found.rename.values()] == ["timestamp", *state]


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("word", ["joint{}", "motor{}"])
def test_numbers_tell_a_robot_s_joints_where_its_names_do_not(first, word):
    """A robot's joint_1 is a file's joint0, and a rail has a force."""
    of_joints = {"pos_deg": "torque_Nm", "pos_mm": "force_N"}
    units = ["pos_deg", "pos_mm", "pos_deg"]
    q = [f"joint{k}_{x}" for k, x in enumerate(units, first)]
    tau = [f"{word.format(k)}_{of_joints[x]}" for k, x in enumerate(units, first)]
    found = recognise(["t", *q, *tau], ("joint_1", "joint_2", "joint_3"))
    names = [found.rename[f"{x}{k}"] for x in ("q", "tau") for k in (1, 2, 3)]
    assert names == q + tau


SIDES = [f"{side}_joint_{k}" for side in ("left", "right") for k in (1, 2, 3)]
PAIRS = ["shoulder_1", "shoulder_2", "elbow_1", "wrist_1"]
#: Joints of a file, in its order, and those of the robot, which are called alike.
CALLED = [
    (SIDES, SIDES[3:]),
    ([f"joint_{k}" for k in range(1, 8)], [f"joint_{k}" for k in range(2, 6)]),
    (["a1", "a2", "b1", "b2"], ["b1", "b2", "a1", "a2"]),
    (PAIRS[::-1], PAIRS),
    (PAIRS[::-1], [f"arm_{x}_joint" for x in PAIRS]),
    (["torque_motor", "speed_motor"], ["speed_motor", "torque_motor"]),
    (["pan", "tilt", "gripper"], ["tilt", "pan"]),
    (["j1", "j2", "finger_1", "finger_2"], ["j1", "j2"]),
]


@pytest.mark.parametrize(("in_file", "robot"), CALLED)
def test_joints_called_as_the_robot_s_are_these(in_file, robot):
    """Whatever else their names say, and whatever other joints are there."""
    columns = [f"{j}_{x}" for j in in_file for x in ("position", "effort")]
    found = recognise(["time", *columns], robot)
    assert found.joints == tuple(robot)
    for k, joint in enumerate(robot, start=1):
        core = joint.removeprefix("arm_").removesuffix("_joint")
        assert found.rename[f"q{k}"] == f"{core}_position"
        assert found.rename[f"tau{k}"] == f"{core}_effort"


#: Words of columns, that of the torque taken, and those of all that compete for it.
TORQUES = [
    (["Velocity", "TorqueSm", "TorqueCur", "Torque", "Cur"], "Torque", [1, 2, 3, 4]),
    # T1 is no clock, since it has a number; the arm weighs it against currents.
    (["T", "current"], "current", [0, 1]),
    # An encoder's velocity was proposed as a torque.
    (["encoder.vel_estimate", "motor.Iq_setpoint", "Iq_measured"], "Iq_measured", []),
]


@pytest.mark.parametrize(("words", "taken", "rivals"), TORQUES)
def test_of_several_torques_one_is_taken_and_the_others_are_named(words, taken, rivals):
    names = [f"{x}{k}" for x in ("theta", *words) for k in (1, 2, 3)]
    found = recognise(["Time", *names])
    assert found.rename["tau3"] == f"{taken}3"
    labels = [f"{words[k]}1 to {words[k]}3" for k in rivals]
    assert sorted(found.torques) == sorted(labels)


@pytest.mark.parametrize("unit", [None, "degrees", "radians"])
@pytest.mark.parametrize("largest", [60.0, 130.0])
def test_positions_of_lerobot_are_degrees_only_where_something_says_so(
    unit, largest, tmp_path
):
    """They may be per cent of each joint's range, as LeRobot writes them by default;
    the state's is not the action's."""
    import pyarrow as arrow
    from pyarrow import parquet

    path = tmp_path / "data" / "chunk-000" / "episode_000000.parquet"
    path.parent.mkdir(parents=True)
    q = largest * np.sin(np.outer(RUN.t, [1.0, 2.0]))
    columns = {"timestamp": RUN.t, "observation.state": list(q), "action": list(q)}
    columns["observation.effort"] = list(RUN.tau)
    parquet.write_table(arrow.table(columns), path)
    if unit is not None:
        info = {"features": {"observation.state": {"unit": unit}}}
        (tmp_path / "meta").mkdir()
        (tmp_path / "meta" / "info.json").write_text(json.dumps(info))
    with pytest.warns(Remark) as heard:
        run = read_run(path)
    said = " ".join(str(w.message) for w in heard)
    is_open = unit is None and largest < 100.0
    is_in_degrees = unit == "degrees" or (unit is None and largest > 100.0)
    np.testing.assert_allclose(run.q, np.radians(q) if is_in_degrees else q)
    assert ("; q in degrees or per cent of each joint's range" in said) == is_open
    assert ("as the file's metadata say" in said) == (unit is not None)
    assert ("qcmd" in run.commanded) == (largest > 100.0)
