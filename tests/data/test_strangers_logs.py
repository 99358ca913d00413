"""Logs as strangers write them: the same numbers come out of any spelling, and nothing
is guessed where two readings are as good."""

import json
import re
import shlex
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import run_cli
from recorded import refusal
from scipy.io import savemat

from sdp_vs_penalty import convert, load_measurements
from sdp_vs_penalty.data import describe_columns, read_run, save
from sdp_vs_penalty.data.words.units import unit_of_factor
from sdp_vs_penalty.errors import ColumnsRemark, InputError, Remark
from sdp_vs_penalty.simulation import experiment

JOINTS = ("shoulder_pan_joint", "elbow_joint", "wrist_1_joint")
ORDER = (2, 0, 1)
T = np.arange(160) * 0.005
Q, DQ, TAU = np.round(np.random.default_rng(3).normal(size=(3, 160, 3)), 6)
START = 1_740_000_000
WHOLE = [START * 10**9 + round(1e9 * t) for t in T]

Cells = Sequence[Sequence[object]]


def write(path: Path, head: Sequence[str], columns: Cells, mark: str = ",") -> Path:
    """A table of numbers or texts."""
    lines = [mark.join(head)]
    for row in zip(*columns, strict=True):
        lines.append(mark.join(x if isinstance(x, str) else f"{x:.9f}" for x in row))
    path.write_text("\n".join(lines) + "\n")
    return path


def numbered(*patterns: str, first: int = 0) -> list[str]:
    return [pattern.format(first + k) for pattern in patterns for k in range(3)]


def by_joint(*patterns: str) -> list[str]:
    """Names in another order than the robot's."""
    return [p.format(JOINTS[k]) for p in patterns for k in ORDER]


def channels(*blocks: np.ndarray) -> list[np.ndarray]:
    return [column for block in blocks for column in block.T]


def read_silently(path: Path, joints: Sequence[str] | None = JOINTS):
    with warnings.catch_warnings(action="ignore"):
        return read_run(path, 3, joints)


SPELLINGS = {
    "zero based": ("t", numbered("q{}", "dq{}", "tau{}")),
    "capitals": ("TIME", numbered("POS_{}", "VEL_{}", "TORQUE_{}", first=1)),
    "brackets": ("time", numbered("q[{}]", "qd[{}]", "tau[{}]")),
    "parentheses": ("time", numbered("q({})", "qd({})", "tau({})", first=1)),
    "points": ("timestamp", numbered("position.{}", "velocity.{}", "effort.{}")),
    "topics": (
        "__time",
        numbered("joint_states/position[{}]", "js/velocity[{}]", "js/effort[{}]"),
    ),
    "words twice": ("t", numbered("a/position[{}]", "a/vel[{}]", "efforts/effort[{}]")),
    "joint first": ("time", numbered("q{}_pos", "q{}_vel", "q{}_torque", first=1)),
    "dots": ("time", numbered("theta{}", "theta_dot{}", "torque{}", first=1)),
    "blanks": (
        "Time",
        numbered("Joint {} Position", "Joint {} Speed", "Joint {} Torque"),
    ),
    "a robot's number": ("t", numbered("ur10/q_{}", "ur10/qd_{}", "ur10/tau_{}")),
    "MuJoCo's points": ("time", numbered("qpos.{}", "qvel.{}", "qfrc_actuator.{}")),
    "MuJoCo's data": (
        "time",
        numbered("data.qpos[{}]", "data.qvel[{}]", "data.qfrc_actuator[{}]"),
    ),
    "actuators' forces": ("time", numbered("qpos_{}", "qvel_{}", "actuator_force_{}")),
}


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_spellings_of_numbered_columns(spelling, tmp_path):
    clock, names = SPELLINGS[spelling]
    path = write(tmp_path / "run.csv", [clock, *names], [T, *channels(Q, DQ, TAU)])
    run = read_silently(path)
    np.testing.assert_allclose([run.q, run.dq, run.tau], [Q, DQ, TAU], atol=1e-9)


@pytest.mark.parametrize(
    "patterns",
    [
        ("{}_position", "{}_effort"),
        ("position/{}", "effort/{}"),
        ("{}.pos", "{}.torque"),
        ("left_{}/position", "left_{}/effort"),
        ("/arm_2/joint_states/{}/position", "/arm_2/joint_states/{}/effort"),
        ("q_{}", "tau_{}"),
    ],
)
def test_columns_called_by_joints_come_in_the_robot_s_order(patterns, tmp_path):
    columns = [T, *channels(Q[:, ORDER], TAU[:, ORDER])]
    path = write(tmp_path / "run.csv", ["time", *by_joint(*patterns)], columns)
    run = read_silently(path)
    np.testing.assert_allclose([run.q, run.tau], [Q, TAU], atol=1e-9)


def test_without_a_robot_torques_follow_the_order_of_the_positions(tmp_path):
    names = [*by_joint("{}_position"), *(f"{joint}_effort" for joint in JOINTS)]
    columns = [T, *channels(Q[:, ORDER], TAU)]
    run = read_silently(write(tmp_path / "run.csv", ["time", *names], columns), None)
    np.testing.assert_allclose(run.tau, TAU[:, ORDER], atol=1e-9)


UNITS = {
    "deg": (("q{}_deg", "dq{}_deg_s", "tau{}_mNm"), "t_ms"),
    "(deg)": (("q{} (deg)", "dq{} (deg/s)", "tau{} (mNm)"), "Time (ms)"),
    "[deg]": (("pos_deg[{}]", "vel_dps[{}]", "tau_mNm[{}]"), "time [ms]"),
    "camel": (("posDeg{}", "velDeg{}", "torque_mNm_{}"), "time_ms"),
}


@pytest.mark.parametrize("writing", UNITS)
def test_units_that_names_end_with(writing, tmp_path):
    patterns, clock = UNITS[writing]
    blocks = np.degrees(Q), np.degrees(DQ), 1e3 * TAU
    columns = [1e3 * T, *channels(*blocks)]
    path = write(tmp_path / "run.csv", [clock, *numbered(*patterns, first=1)], columns)
    run = read_silently(path)
    np.testing.assert_allclose(run.t, T, atol=1e-9)
    np.testing.assert_allclose([run.q, run.dq, run.tau], [Q, DQ, TAU], atol=1e-9)


def decimal_comma(x: float) -> str:
    return f"{x:.9f}".replace(".", ",")


@pytest.mark.parametrize("mark", [";", "\t", "|"])
def test_decimal_commas(mark, tmp_path):
    columns = [[decimal_comma(x) for x in c] for c in [T, *channels(Q, TAU)]]
    head = ["Zeit", *numbered("q{}", "tau{}", first=1)]
    run = read_silently(write(tmp_path / "run.csv", head, columns, mark))
    np.testing.assert_allclose([run.q, run.tau], [Q, TAU], atol=1e-9)


@pytest.mark.parametrize("tail", [",", ",,"])
def test_separators_at_the_end_of_rows(tail, tmp_path):
    head = ["t", *numbered("q{}", "tau{}", first=1)]
    path = write(tmp_path / "run.csv", head, [T, *channels(Q, TAU)])
    first, *rows = path.read_text().splitlines()
    path.write_text("\n".join([first, *(row + tail for row in rows)]))
    np.testing.assert_allclose(read_silently(path).tau, TAU, atol=1e-9)


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_quotes_byte_order_marks_and_line_ends(ends, tmp_path):
    head = [f'"{name}"' for name in ["t", *numbered("q{}", "tau{}", first=1)]]
    columns = [[f'"{x:.9f}"' for x in c] for c in [T, *channels(Q, TAU)]]
    path = write(tmp_path / "run.csv", head, columns)
    text = path.read_text().replace("\n", ends)
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    np.testing.assert_allclose(read_silently(path).tau, TAU, atol=1e-9)


PARTS = [
    ("header.stamp.sec", "header.stamp.nanosec", 1),
    ("stamp_s", "stamp_ns", 1),
    ("Time (s)", "Time (ns)", 1),
    ("tv_sec", "tv_usec", 1000),
    ("time.sec", "time.msec", 10**6),
    ("stampSec", "stampNanoSec", 1),
    ("sec_", "nanosec_", 1),
    ("timestamp.seconds", "timestamp.nanos", 1),
    ("/js/header/stamp/sec", "/js/header/stamp/nanosec", 1),
]


@pytest.mark.parametrize(("first", "second", "unit"), PARTS)
@pytest.mark.parametrize("is_turned", [False, True])
def test_stamps_in_two_parts(first, second, unit, is_turned, tmp_path):
    parts = {first: [str(x // 10**9) for x in WHOLE]}
    parts[second] = [str(x % 10**9 // unit) for x in WHOLE]
    names = [second, first] if is_turned else [first, second]
    columns = [*(parts[name] for name in names), *channels(Q, TAU)]
    path = write(tmp_path / "run.csv", [*names, *numbered("q_{}", "tau_{}")], columns)
    np.testing.assert_allclose(read_silently(path).t - START, T, atol=1e-6)


def text_stamps(layout: str) -> list[str]:
    """Stamps from two tenths of a second before a midnight on."""
    import datetime

    begin = datetime.datetime(2025, 4, 30, 23, 59, 59, 800_000)
    stamps = [begin + datetime.timedelta(microseconds=round(1e6 * t)) for t in T]
    return [stamp.strftime(layout) for stamp in stamps]


@pytest.mark.parametrize(
    "layout",
    [
        "%Y-%m-%dT%H:%M:%S.%f",
        "%Y-%m-%dT%H:%M:%S.%fZ",
        "%Y-%m-%dT%H:%M:%S.%f+02:00",
        "%Y-%m-%d %H:%M:%S.%f -0500",
        "%Y/%m/%d %H:%M:%S.%f",
        "%d.%m.%Y %H:%M:%S.%f",
        "%m/%d/%Y %I:%M:%S.%f %p",
        "%H:%M:%S.%f",
    ],
)
def test_stamps_as_texts_go_on_past_midnight(layout, tmp_path):
    head = ["time", *numbered("q{}", "tau{}", first=1)]
    columns = [text_stamps(layout), *channels(Q, TAU)]
    run = read_silently(write(tmp_path / "run.csv", head, columns))
    np.testing.assert_allclose(run.t - run.t[0], T, atol=1e-6)


LISTS: dict[str, Callable[[np.ndarray], str]] = {
    "Python": lambda row: '"[' + ", ".join(map(str, row)) + ']"',
    "NumPy": lambda row: "[" + " ".join(map(str, row)) + "]",
    "NumPy, wrapped": lambda row: f'"[{row[0]} {row[1]}\n {row[2]}]"',
    "array": lambda row: f"\"array('d', {list(map(float, row))})\"",
    "tuple": lambda row: '"(' + ", ".join(map(str, row)) + ')"',
}


@pytest.mark.parametrize("kind", LISTS)
def test_lists_in_cells(kind, tmp_path):
    cells = [[LISTS[kind](row) for row in block] for block in (Q, TAU)]
    path = write(tmp_path / "run.csv", ["time", "position", "effort"], [T, *cells])
    run = read_silently(path)
    np.testing.assert_allclose([run.q, run.tau], [Q, TAU], atol=1e-9)


def test_lists_follow_the_names_in_the_row(tmp_path):
    names = '"' + str([JOINTS[k] for k in ORDER]) + '"'
    cells = [[LISTS["Python"](row[list(ORDER)]) for row in b] for b in (Q, TAU)]
    head = ["time", "name", "position", "effort"]
    run = read_silently(
        write(tmp_path / "run.csv", head, [T, [names] * len(T), *cells])
    )
    np.testing.assert_allclose([run.q, run.tau], [Q, TAU], atol=1e-9)


def test_rows_of_another_topic_may_begin_after_the_first_hundred(tmp_path):
    head = ["__time", *numbered("/js/position[{}]", "/js/effort[{}]"), "/battery"]
    path = write(tmp_path / "run.csv", head, [T, *channels(Q, TAU), [""] * len(T)])
    lines = path.read_text().splitlines()
    for k in range(120, 160, 3)[::-1]:
        lines.insert(k + 2, f"{T[k] + 0.001:.6f},,,,,,,24.1")
    path.write_text("\n".join(lines))
    run = read_silently(path)
    np.testing.assert_allclose([run.q, run.tau], [Q, TAU], atol=1e-9)


@pytest.mark.parametrize("n_empty", [1, 2, 3, 12])
@pytest.mark.parametrize("column", ["q1", "tau2"])
def test_rows_with_an_empty_cell_are_left_out_however_many_they_are(
    tmp_path, n_empty, column
):
    """Nothing is put in their place: the nearest value is a period away."""
    head = ["t", *numbered("q{}", "tau{}", first=1)]
    path = write(tmp_path / "run.csv", head, [T, *channels(Q, TAU)])
    lines = path.read_text().splitlines()
    empty = range(30, 30 + 10 * n_empty, 10)  # rows of the run
    for k in empty:
        cells = lines[k + 1].split(",")
        cells[head.index(column)] = ""
        lines[k + 1] = ",".join(cells)
    path.write_text("\n".join(lines))
    words = rf"{n_empty} rows? without all channels \(row 32 is the first\) left out"
    with pytest.warns(Remark, match=words):
        run = load_measurements(path)
    np.testing.assert_allclose(run.t, np.delete(T, empty))
    np.testing.assert_allclose(run.q, np.delete(Q, empty, axis=0))
    np.testing.assert_allclose(run.tau, np.delete(TAU, empty, axis=0))


def test_two_arms_in_one_file_are_not_guessed(tmp_path):
    names = numbered("left_q_{}", "left_tau_{}", "right_q_{}", "right_tau_{}")
    columns = [T, *channels(Q, TAU, Q, TAU)]
    path = write(tmp_path / "run.csv", ["time", *names], columns)
    said = refusal(lambda: read_silently(path), "left_q_0 to left_q_2 or right_q_0")
    assert "--rename 't=time,q*=left_q_*,tau*=left_tau_*'" in said


def test_without_a_header_the_robot_tells_the_number_of_joints(tmp_path):
    path = tmp_path / "run.csv"
    np.savetxt(path, np.column_stack([T, Q, TAU]), delimiter=",")
    said = refusal(lambda: read_silently(path), "where its columns are t, q and tau")
    assert "q3=#4,tau1=#5" in said


def test_a_guess_shows_the_first_rows(tmp_path):
    head = ["time", *numbered("q_{}_deg", "tau_{}")]
    columns = [T, *channels(np.degrees(Q), TAU)]
    with pytest.warns(ColumnsRemark) as heard:
        run = read_run(write(tmp_path / "run.csv", head, columns), 3, JOINTS)
    (remark,) = [w.message for w in heard if isinstance(w.message, ColumnsRemark)]
    name, *values, theirs = remark.rows[1].split()
    assert (name, theirs) == ("q1", "q_0_deg")
    np.testing.assert_allclose([float(x) for x in values], run.q[:5, 0], rtol=1e-4)


def test_the_table_of_columns_is_the_recogniser_s(tmp_path):
    head = ["time", *numbered("q_{}_deg", "tau_{}"), "note"]
    columns = [T, *channels(np.degrees(Q), TAU), ["ok"] * len(T)]
    report = describe_columns(write(tmp_path / "run.csv", head, columns), JOINTS)
    assert report is not None
    with pytest.warns(Remark, match="columns recognised") as heard:
        read_run(report.path, 3, JOINTS)
    assert report.sentence in [str(w.message) for w in heard]
    assert [row.meaning for row in report.rows] == [
        "t",
        *numbered("q{}", "tau{}", first=1),
        "",
    ]
    assert {row.unit for row in report.rows if row.meaning.startswith("q")} == {"deg"}
    assert report.rows[-1].kind == "text"


def test_what_is_missing_is_in_the_table_of_columns(tmp_path):
    path = write(tmp_path / "run.csv", numbered("q_{}", "tau_{}"), channels(Q, TAU))
    report = describe_columns(path)
    assert report is not None
    assert report.missing == ("t",)


@pytest.mark.parametrize("cut", [360.0, 180.0])
def test_degrees_that_are_cut_at_a_full_turn_go_on(cut, tmp_path):
    turning = np.column_stack([np.linspace(a, 14.0, 160) for a in (-9.0, 2.0, 0.0)])
    wrapped = (np.degrees(turning) + 360.0 - cut) % 360.0 - (360.0 - cut)
    head = ["time", *numbered("q_{}_deg", "tau_{}")]
    path = write(tmp_path / "run.csv", head, [T, *channels(wrapped, TAU)])
    with pytest.warns(Remark, match="cut at a full turn in"):
        run = read_run(path, 3, JOINTS)
    np.testing.assert_allclose(np.diff(run.q, axis=0), np.diff(turning, axis=0))


def test_units_of_a_command_unwrap_too(tmp_path):
    turning = np.linspace(-7.0, 7.5, 160)[:, None]
    columns = [T, *channels(np.degrees(turning) % 360.0, TAU[:, :1])]
    path = write(tmp_path / "run.csv", ["t", "q1", "tau1"], columns)
    with pytest.warns(Remark, match="cut at a full turn in 3 places"):
        run = convert(path, scale={"q": "deg"})
    np.testing.assert_allclose(run.q, turning, atol=1e-8)


def test_what_the_check_repairs_is_refused_with_its_command(tmp_path, capsys):
    rounded = [f"{t:.2f}" for t in T]
    columns = [rounded, *channels(Q[:, :2], TAU[:, :2])]
    path = write(tmp_path / "run.csv", ["t", "q1", "q2", "tau1", "tau2"], columns)
    words = ("identify", "two_link", "--data", path, "--out", tmp_path / "m.json")
    assert run_cli(*words) == 2
    said = capsys.readouterr().err
    fixed = tmp_path / "run_fixed.csv"
    assert f"check two_link --data {path} --fix {fixed}" in said


def test_the_command_that_a_refusal_prints_repairs_milliseconds(
    two_link, tmp_path, capsys
):
    run = experiment(two_link).training_run(0).rows(slice(None, None, 4))
    slow = replace(run, t=1e3 * (run.t - run.t[0]), dq=None)
    save(slow, tmp_path / "run.csv")
    fixed = tmp_path / "run_fixed.csv"
    words = ("identify", "two_link", "--data", tmp_path / "run.csv")
    assert run_cli(*words, "--out", tmp_path / "m.json") == 2
    printed = re.search(r"`sdp-vs-penalty (check [^`]*)`", capsys.readouterr().err)
    assert printed is not None
    run_cli(*shlex.split(printed[1]))
    np.testing.assert_allclose(load_measurements(fixed).t, slow.t / 1e3, atol=1e-9)


def test_raw_files_of_public_data_are_fetched(tmp_path):
    path = write(tmp_path / "curr_data.csv", numbered("Joint_{}", first=1), [*Q.T])
    refusal(lambda: read_silently(path), "sdp-vs-penalty fetch tx40")


@pytest.mark.parametrize(
    "above",
    [
        "%% logged by matlab\n%% units SI\n",
        "Robot log export\nDate: 2026-01-02\n\n",
        "sep=,\n",
        "# made by hand, on Monday\n",
    ],
)
def test_lines_above_the_header_are_no_table(above, tmp_path):
    path = write(
        tmp_path / "run.csv",
        ["t", *numbered("q{}", "tau{}", first=1)],
        [T, *channels(Q, TAU)],
    )
    path.write_text(above + path.read_text())
    run = read_silently(path)
    np.testing.assert_allclose(run.q, Q)
    np.testing.assert_allclose(run.tau, TAU)


@pytest.mark.parametrize("unit", ["mN.m", "mN*m", "mN m", "mNm", "N mm"])
def test_a_thousandth_of_a_newton_metre_in_any_writing(unit, tmp_path):
    path = write(
        tmp_path / "run.csv",
        ["t", *numbered("q{}", first=1), *numbered("tau{} (" + unit + ")", first=1)],
        [T, *channels(Q, 1e3 * TAU)],
    )
    np.testing.assert_allclose(read_silently(path).tau, TAU, atol=1e-8)


@pytest.mark.parametrize("unit", ["oz-in", "ozf in", "oz*in"])
def test_ounces_and_inches(unit, tmp_path):
    path = write(
        tmp_path / "run.csv",
        ["t", *numbered("q{}", first=1), *numbered("tau{} (" + unit + ")", first=1)],
        [T, *channels(Q, TAU / (0.02834952 * 9.80665 * 0.0254))],
    )
    np.testing.assert_allclose(read_silently(path).tau, TAU, rtol=1e-6, atol=1e-8)


def test_the_printed_unit_is_one_of_the_quantity():
    assert unit_of_factor(1e-3, "tau") == "mnm"
    assert unit_of_factor(1e-3, "t") == "ms"
    assert unit_of_factor(1e-3, "q") == "mm"
    assert unit_of_factor(0.3, "tau") is None


def orders_that_change() -> list[np.ndarray]:
    """The place of each joint in the rows of a log that has them in any order."""
    return [np.random.default_rng(k).permutation(3) for k in range(len(T))]


def message(k: int, order: np.ndarray) -> dict[str, list]:
    return {
        "name": [JOINTS[j] for j in order],
        "position": Q[k, order].tolist(),
        "effort": TAU[k, order].tolist(),
    }


def rows_with_names(layout: str, path: Path) -> Path:
    """Rows that each name their joints, in an order of their own."""
    messages = [message(k, order) for k, order in enumerate(orders_that_change())]
    if layout == "json":
        lines = [json.dumps({"time": t, **m}) for t, m in zip(T, messages, strict=True)]
        path = path / "run.jsonl"
        path.write_text("\n".join(lines))
        return path
    if layout == "parquet":
        table = pd.DataFrame({"time": T, **pd.DataFrame(messages)})
        table.to_parquet(path / "run.parquet")
        return path / "run.parquet"
    path = path / "run.csv"
    if layout == "lists":
        fields = ["name", "position", "effort"]
        columns = [[f'"{m[field]}"' for m in messages] for field in fields]
        return write(path, ["time", *fields], [T, *columns])
    head = numbered("name[{}]", "position[{}]", "effort[{}]")
    columns = zip(
        *[[*m["name"], *m["position"], *m["effort"]] for m in messages], strict=True
    )
    return write(path, ["time", *head], [T, *columns])


@pytest.mark.parametrize("layout", ["json", "lists", "columns", "parquet"])
def test_joints_may_change_their_order_from_row_to_row(layout, tmp_path):
    run = read_silently(rows_with_names(layout, tmp_path))
    np.testing.assert_allclose(run.q, Q, atol=1e-9)
    np.testing.assert_allclose(run.tau, TAU, atol=1e-9)


@pytest.mark.parametrize("layout", ["json", "lists", "columns"])
def test_a_row_with_other_joints_is_refused(layout, tmp_path):
    path = rows_with_names(layout, tmp_path)
    lines = path.read_text().split("\n")
    lines[40] = lines[40].replace(JOINTS[1], "finger_joint")
    path.write_text("\n".join(lines))
    sentence = f"{path}: (row|line) 41 names other joints than the first"
    with pytest.raises(InputError, match=sentence):
        read_silently(path)


def test_joints_of_a_json_log_come_in_the_robot_s_order(tmp_path):
    lines = [
        json.dumps({"time": t, **message(k, np.array(ORDER))})
        for k, t in enumerate(T.tolist())
    ]
    path = tmp_path / "run.jsonl"
    path.write_text("\n".join(lines))
    np.testing.assert_array_equal(read_silently(path).q, Q)


@pytest.mark.parametrize("words", [("t", "q", "tau"), ("time", "positions", "efforts")])
def test_arrays_follow_the_names_beside_them(words, tmp_path):
    time, positions, efforts = words
    names = np.array([JOINTS[k] for k in ORDER])
    arrays = {time: T, positions: Q[:, ORDER], efforts: TAU[:, ORDER]}
    path = tmp_path / "run.npz"
    np.savez(path, joint_names=names, **arrays)
    run = read_silently(path)
    np.testing.assert_array_equal(run.q, Q)
    np.testing.assert_array_equal(run.tau, TAU)
    without_robot = read_silently(path, None)
    np.testing.assert_array_equal(without_robot.q, Q[:, ORDER])


def test_comments_between_and_below_the_rows_are_left_out(tmp_path):
    head = ["t", *numbered("q{}", "tau{}", first=1)]
    path = write(tmp_path / "run.csv", head, [T, *channels(Q, TAU)])
    lines = path.read_text().splitlines()
    lines.insert(50, "# the arm was paused, for a second")
    path.write_text("\n".join([*lines, "# end of the log"]))
    with pytest.warns(Remark, match="2 comments left out"):
        run = read_run(path, None, JOINTS)
    np.testing.assert_allclose(run.q, Q)


def test_structs_of_matlab_in_an_array(tmp_path):
    joints = np.zeros((1, 3), [("pos", "O"), ("torque", "O")])
    for k in range(3):
        joints[0, k] = (Q[:, k : k + 1], TAU[:, k : k + 1])
    path = tmp_path / "run.mat"
    savemat(path, {"t": T[:, None], "joint": joints})
    run = read_silently(path)
    np.testing.assert_array_equal(run.q, Q)
    np.testing.assert_array_equal(run.tau, TAU)


def test_signals_of_simulink_are_called_by_their_labels(tmp_path):
    signals = np.zeros((1, 2), [("values", "O"), ("label", "O")])
    signals[0, 0] = (Q, "q")
    signals[0, 1] = (TAU, "tau")
    path = tmp_path / "run.mat"
    savemat(path, {"ScopeData": {"time": T[:, None], "signals": signals}})
    run = read_silently(path)
    np.testing.assert_array_equal(run.t, T)
    np.testing.assert_array_equal(run.q, Q)
    np.testing.assert_array_equal(run.tau, TAU)


def test_positions_of_motors_are_said(tmp_path):
    head = ["time", *numbered("motor_position_{}", "motor_torque_{}", first=1)]
    path = write(tmp_path / "run.csv", head, [T, *channels(Q, TAU)])
    with pytest.warns(ColumnsRemark, match="q are the motors' positions: .* --motors"):
        read_run(path, None, JOINTS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("version https://git-lfs.github.com/spec/v1\noid x\nsize 9\n", "git lfs pull"),
        ("<!DOCTYPE html>\n<html><body>run.csv</body></html>\n", "a web page"),
    ],
)
def test_what_a_download_leaves_is_no_log(text, words, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(text)
    refusal(lambda: read_run(path, None, JOINTS), words)
