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
from sdp_vs_penalty.errors import ColumnsRemark, Remark

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


def test_without_a_clock_velocities_tell_a_usual_rate(tmp_path):
    """As a run of another program says with its command; what is as written is refused."""
    path = table(tmp_path / "bare.csv", HEAD, BARE)
    with pytest.warns(ColumnsRemark, match="t = rows at 50 Hz") as heard:
        run = load_measurements(path)
    np.testing.assert_allclose(run.t, RUN.t, atol=1e-9)
    assert "--rate 50 " in str(heard[0].message)
    refusal(lambda: read_run(path, as_written=True), "no column t", "--rate 50")


@pytest.mark.parametrize("factor", [57.3, 0.73])
def test_a_rate_at_which_nobody_logs_is_asked_for(factor, tmp_path):
    """Velocities in another unit than the positions make it."""
    rows = np.column_stack([RUN.q, factor * RUN.dq, RUN.tau])
    path = table(tmp_path / "bare.csv", HEAD, rows)
    refusal(lambda: load_measurements(path), "no column t", "--rate")


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


def test_columns_that_nobody_chose_may_hold_anything(tmp_path):
    path = tmp_path / "run.csv"
    rows = [
        ",".join([f"{t:.10g}", "ok", "", f"{q:.10g}", f"{tau:.10g}", "{1;2}"])
        for t, q, tau in zip(RUN.t, RUN.q[:, 0], RUN.tau[:, 0], strict=True)
    ]
    path.write_text("\n".join(["t,mode,note,q1,tau1,extra", *rows]))
    with pytest.warns(Remark, match="not used: mode, note, extra"):
        run = load_measurements(path)
    np.testing.assert_allclose(run.q[:, 0], RUN.q[:, 0])


def test_a_chosen_column_of_words_is_named_once(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,q1,tau1\n" + "".join(f"0.{k},0.1,off\n" for k in range(1, 9)))
    refusal(lambda: load_measurements(path), "column tau1 is never a number", "'off'")


def test_a_channel_that_is_never_a_number_is_named_once(tmp_path):
    rows = np.column_stack([RUN.t, RUN.q, RUN.tau])
    rows[:, 4] = np.nan
    path = table(tmp_path / "run.csv", "t,q1,q2,tau1,tau2", rows)
    refusal(
        lambda: read_run(path), "column tau2 is never a number", "nothing to repair"
    )


def test_velocities_that_are_never_numbers_are_left_out(tmp_path):
    rows = np.column_stack([RUN.t, RUN.q, np.full_like(RUN.q, np.nan), RUN.tau])
    path = table(tmp_path / "run.csv", "t,q1,q2,dq1,dq2,tau1,tau2", rows)
    with pytest.warns(Remark, match="dq is left out"):
        assert load_measurements(path).dq is None


def test_topics_with_stamps_of_their_own_come_together(tmp_path):
    """Efforts a fifth of a period after the positions."""
    rows = ["t,q1,q2,tau1,tau2"]
    for t, q, tau in zip(RUN.t, RUN.q, RUN.tau, strict=True):
        rows += [f"{t:.6f},{q[0]},{q[1]},,", f"{t + 0.004:.6f},,,{tau[0]},{tau[1]}"]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(rows))
    with pytest.warns(Remark, match="400 rows without all channels"):
        run = load_measurements(path)
    np.testing.assert_allclose(run.tau, RUN.tau)


def test_joints_of_the_robot_that_a_log_lacks_do_not_change_the_order():
    columns = [
        "time",
        *(f"{j}_position" for j in "bca"),
        *(f"{j}_effort" for j in "bca"),
    ]
    found = recognise(columns, ["a", "b", "c", "finger"])
    assert [found.rename[f"q{k}"][0] for k in (1, 2, 3)] == ["a", "b", "c"]


def test_commands_quote_what_a_shell_would_read(tmp_path):
    path = table(tmp_path / "my $(run).csv", HEAD, BARE)
    said = refusal(lambda: read_run(path, as_written=True), "--rate 50")
    (command,) = re.findall("`sdp-vs-penalty (.*?)` \\(", said)
    assert shlex.split(command)[1] == str(path)


def test_columns_are_chosen_by_their_numbers_without_a_header(tmp_path):
    rows = np.column_stack([RUN.t, RUN.q, RUN.tau])
    path = tmp_path / "run.csv"
    path.write_text("\n".join(",".join(map(str, row)) for row in rows.tolist()))
    refusal(lambda: load_measurements(path), "row 1 holds numbers instead of a header")
    pairs = {"t": "#1", "q1": "#2", "q2": "#3", "tau1": "#4", "tau2": "#5"}
    np.testing.assert_array_equal(convert(path, rename=pairs).tau, RUN.tau)


@pytest.mark.parametrize("clock", [0, 1])
def test_more_columns_of_each_joint_than_three_are_ambiguous(tmp_path, clock):
    """Of a robot of six joints; 31 columns were called ten joints."""
    path = tmp_path / "run.csv"
    rows = np.random.default_rng(0).normal(size=(60, 30 + clock))
    path.write_text("\n".join(",".join(map(str, row)) for row in rows.tolist()))
    said = refusal(
        lambda: read_run(path, 6, tuple("abcdef")), f"{30 + clock} columns may be"
    )
    assert "5 columns of each of 6 joints" in said
    assert f"q1=#{1 + clock},q2" in said
    assert f"tau6=#{18 + clock}" in said
    assert "q7" not in said
    assert ("a clock and" in said) is bool(clock)
    assert ("--rate HZ" in said) is not bool(clock)


def test_the_column_that_counts_episodes_is_the_loggers(tmp_path, monkeypatch):
    """Two episodes of three rows; their clocks begin at 0 again, a second apart."""
    from sdp_vs_penalty.data.words import loggers

    changed = [
        {**logger, "episode": "take"} if "episode" in logger else logger
        for logger in loggers.LOGGERS
    ]
    monkeypatch.setattr(loggers, "LOGGERS", changed)
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


@pytest.mark.parametrize("torques", ["tau", "torque"])
def test_a_block_of_torques_is_not_lost_beside_another_one(torques, tmp_path):
    """A block that is called as we call it stayed out: "no torque was logged"."""
    path = tmp_path / "run.npz"
    np.savez(path, time=RUN.t, pos=RUN.q, **{torques: RUN.tau, "tau_model": RUN.q})
    with pytest.warns(ColumnsRemark):
        run = load_measurements(path)
    assert run.torque_logged
    np.testing.assert_allclose(run.tau, RUN.tau)


def test_an_object_of_units_says_those_of_a_json_file(tmp_path):
    path = tmp_path / "run.json"
    units = {"angle": "deg", "torque": "mNm", "time": "ms"}
    data = {
        "time": (1e3 * RUN.t).tolist(),
        "angle": np.degrees(RUN.q).tolist(),
        "torque": (1e3 * RUN.tau).tolist(),
    }
    path.write_text(json.dumps({"units": units, "data": data}))
    with pytest.warns(ColumnsRemark):
        run = load_measurements(path)
    for group in ("t", "q", "tau"):
        np.testing.assert_allclose(getattr(run, group), getattr(RUN, group), atol=1e-12)


def test_the_command_that_gives_the_rate_keeps_the_robot_s_joints(tmp_path):
    """The file's order is another one: a copy in it was another arm's."""
    path = tmp_path / "run.csv"
    names = [
        f"{joint}_{x}" for x in ("position", "effort") for joint in ("elbow", "base")
    ]
    rows = np.column_stack([RUN.q[:, ::-1], RUN.tau[:, ::-1]]).tolist()
    lines = [",".join(names), *(",".join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(lines))
    joints = ("base", "elbow")
    said = refusal(lambda: read_run(path, 2, joints), "--rate HZ --joints base,elbow")
    assert "no column t" in said
    run = convert(path, rate=200.0, joints=joints)
    np.testing.assert_allclose(run.q, RUN.q)


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
