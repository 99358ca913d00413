"""Forms in which other programs write a clock or a whole log: dates in columns, clocks in
minutes, LabVIEW, TwinCAT, printed ROS messages, MATLAB's names, Feather, Excel, HDF5.
The same numbers come out of each."""

import json
import re
import shlex
import sys
import warnings
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import run_cli
from recorded import refusal

from sdp_vs_penalty import Measurements
from sdp_vs_penalty.data import read_run
from sdp_vs_penalty.errors import ColumnsRemark

JOINTS = ("turn", "shoulder", "elbow")
RATE = 100.0
T = np.arange(300) / RATE
#: The arm moves, so that dq is the derivative of q.
PHASES = np.array([0.0, 1.0, 2.0])
Q = np.sin(2.0 * T[:, None] + PHASES)
DQ = 2.0 * np.cos(2.0 * T[:, None] + PHASES)
TAU = np.round(np.random.default_rng(8).normal(size=(300, 3)), 6)


def read(path: Path, joints: Sequence[str] | None = JOINTS) -> Measurements:
    with warnings.catch_warnings(action="ignore"):
        return read_run(path, 3, joints)


def told(path: Path) -> str:
    """What is said of the columns that were recognised."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        read_run(path, 3, JOINTS)
    (remark,) = [x for x in heard if issubclass(x.category, ColumnsRemark)]
    return str(remark.message)


def same(run: Measurements, *, has_velocities: bool = True) -> None:
    np.testing.assert_allclose(run.t - run.t[0], T, atol=1e-6)
    np.testing.assert_allclose([run.q, run.tau], [Q, TAU], atol=1e-7)
    if has_velocities:
        assert run.dq is not None
        np.testing.assert_allclose(run.dq, DQ, atol=1e-7)


def numbered(*patterns: str) -> list[str]:
    return [pattern.format(k) for pattern in patterns for k in (1, 2, 3)]


def rows(*blocks: np.ndarray, mark: str = ",", decimal: str = ".") -> list[str]:
    """Lines of columns (N,) and blocks (N, n)."""
    table = np.column_stack(blocks)
    lines = [mark.join(f"{x:.12g}" for x in row) for row in table]
    return [line.replace(".", decimal) for line in lines]


def write(path: Path, lines: Sequence[str], encoding: str = "utf-8") -> Path:
    path.write_text("\n".join(lines) + "\n", encoding=encoding)
    return path


# -- clocks ---------------------------------------------------------------------------

#: Two seconds before a midnight: minutes, hours and the day change within the log.
SECONDS = 86_398.0 + T
DAY = 86_400.0
PARTS = np.floor(SECONDS % DAY / [[3600.0], [60.0]]) % [[24.0], [60.0]]
SECOND = SECONDS % 60.0
WHOLE = np.floor(SECOND + 1e-9)
DATE = np.array([np.full(300, 2026.0), np.full(300, 11.0), 28.0 + (SECONDS >= DAY)])
TIMES_OF_DAY = {
    "year,month,day,hour,minute,second": (*DATE, *PARTS, SECOND),
    "Year,Month,Day,Hour,Minute,Second,Millisecond": (
        *(*DATE, *PARTS, WHOLE),
        np.round(1e3 * (SECOND - WHOLE)),
    ),
    "YYYY,MM,DD,hh,mm,ss": (*DATE, *PARTS, SECOND),
    "hour,min,sec": (*PARTS, SECOND),
    "date,hour,minute,second": (20261100.0 + DATE[2], *PARTS, SECOND),
    "stamp_h,stamp_m,stamp_s,stamp_us": (
        *(*PARTS, WHOLE),
        np.round(1e6 * (SECOND - WHOLE)),
    ),
}


@pytest.mark.parametrize("head", TIMES_OF_DAY)
def test_a_time_of_day_in_columns_goes_on_past_midnight(head, tmp_path):
    names = [head, *numbered("pos{}", "vel{}", "trq{}")]
    lines = rows(*TIMES_OF_DAY[head], Q, DQ, TAU)
    path = write(tmp_path / "run.csv", [",".join(names), *lines])
    same(read(path))
    assert "the date is not read" in told(path)


def test_hours_minutes_and_seconds_that_are_three_clocks_are_no_time_of_day(tmp_path):
    """The same stamp in three units; the first hours and minutes are rounded to 0."""
    clocks = T / 3600.0, T / 60.0, T
    head = ",".join(["t_hour", "t_min", "t_sec", *numbered("q{}", "tau{}")])
    path = write(tmp_path / "exact.csv", [head, *rows(*clocks, Q, TAU)])
    assert "t = t_hour+t_min" not in told(path)
    rounded = [np.round(2.0 * clock, 1) for clock in clocks]
    path = write(tmp_path / "rounded.csv", [head, *rows(*rounded, Q, TAU)])
    refusal(lambda: read(path), "no whole numbers", "--rename t=NAME")


def test_another_clock_goes_before_a_time_of_day(tmp_path):
    """Its seconds are whole, and repeat."""
    names = ["hour", "minute", "second", "time", *numbered("pos{}", "vel{}", "trq{}")]
    values = rows(PARTS[0], PARTS[1], WHOLE, T, Q, DQ, TAU)
    path = write(tmp_path / "run.csv", [",".join(names), *values])
    same(read(path))
    assert "t = time" in told(path)


@pytest.mark.parametrize(
    ("clock", "unit"),
    [
        ("minutes", 60.0),
        ("run_minutes", 60.0),
        ("Laufzeit_ms", 1e-3),
        ("gone [h]", 3600.0),
        ("time_min", 60.0),
    ],
)
def test_a_clock_is_known_by_its_unit_where_its_word_is_not(clock, unit, tmp_path):
    head = ",".join([clock, *numbered("pos{}", "vel{}", "trq{}")])
    path = write(tmp_path / "run.csv", [head, *rows(T / unit, Q, DQ, TAU)])
    same(read(path))
    assert f"t = {clock}" in told(path)


@pytest.mark.parametrize("name", ["s", "min", "q_min", "delay_ms"])
def test_what_ends_like_a_unit_of_time_and_is_no_clock(name, tmp_path):
    """A length, limits, and a duration, which does not rise."""
    values = np.zeros(300) if name == "delay_ms" else T
    head = ",".join([name, *numbered("pos{}", "vel{}", "trq{}")])
    path = write(tmp_path / "run.csv", [head, *rows(values, Q, DQ, TAU)])
    refusal(lambda: read(path), "no column t", "--rate 100")


def test_a_clock_in_minutes_that_does_not_say_so_is_no_log_in_degrees(tmp_path):
    from sdp_vs_penalty.data import check_plausible
    from sdp_vs_penalty.problem import load_problem

    urdf = Path(__file__).parents[2] / "docs" / "my_arm.urdf"
    run = Measurements(T / 60.0, Q, TAU, DQ)
    robot = load_problem(urdf).robot
    refusal(lambda: check_plausible(robot, run), "t from minutes to seconds")


# -- LabVIEW --------------------------------------------------------------------------

CHANNELS = numbered("Position {}", "Velocity {}", "Torque {}")
LABELS = [*["deg"] * 3, *["deg/s"] * 3, *["Nm"] * 3]
IN_DEGREES = np.degrees(Q), np.degrees(DQ), TAU


def labview_head(x_columns: str, labels: Sequence[str], decimal: str) -> list[str]:
    """The rows above the names."""
    step = f"{1.0 / RATE:.6f}".replace(".", decimal)
    return [
        "LabVIEW Measurement\t",
        "Separator\tTab",
        f"Decimal_Separator\t{decimal}",
        f"X_Columns\t{x_columns}",
        "Time\t09:51:39",
        "***End_of_Header***\t",
        "\t",
        "Channels\t9",
        "\t".join(["Y_Unit_Label", *labels]),
        "\t".join(["Delta_X", *[step] * 9]),
        "***End_of_Header***\t",
    ]


def test_labview_with_one_clock(tmp_path):
    head = labview_head("One", LABELS, ".")
    names = "\t".join(["X_Value", *CHANNELS, "Comment"])
    values = rows(T, *IN_DEGREES, mark="\t")
    path = write(tmp_path / "run.lvm", [*head, names, *values])
    same(read(path))
    assert "q in deg" in told(path)


def test_labview_with_a_comment_in_each_row(tmp_path):
    head = labview_head("One", LABELS, ".")
    names = "\t".join(["X_Value", *CHANNELS, "Comment"])
    values = [f"{row}\tOK" for row in rows(T, *IN_DEGREES, mark="\t")]
    same(read(write(tmp_path / "run.lvm", [*head, names, *values])))


def test_labview_without_a_clock_says_the_step_in_its_header(tmp_path):
    head = labview_head("No", LABELS, ",")
    names = "\t".join(["X_Value", *CHANNELS, "Comment"])
    values = [f"\t{row}" for row in rows(*IN_DEGREES, mark="\t", decimal=",")]
    path = write(tmp_path / "run.lvm", [*head, names, *values])
    with pytest.warns(UserWarning, match="100 rows a second, as the file's header"):
        run = read_run(path, 3, JOINTS)
    same(run)


def paired(clock: np.ndarray, *blocks: np.ndarray) -> list[np.ndarray]:
    """A clock before each column."""
    return [x for block in blocks for column in block.T for x in (clock, column)]


def test_labview_with_a_clock_for_each_channel(tmp_path):
    labels = [x for label in LABELS for x in (label, "")]
    head = labview_head("Multi", labels, ".")
    names = "\t".join(x for name in CHANNELS for x in ("X_Value", name))
    values = rows(*paired(T, *IN_DEGREES), mark="\t")
    same(read(write(tmp_path / "run.lvm", [*head, names, *values])))


def test_channels_whose_clocks_differ_are_refused(tmp_path):
    head = labview_head("Multi", [], ".")
    names = "\t".join(x for name in CHANNELS for x in ("X_Value", name))
    columns = paired(T, *IN_DEGREES)
    columns[2] = T + 0.002
    path = write(tmp_path / "run.lvm", [*head, names, *rows(*columns, mark="\t")])
    refusal(lambda: read(path), "columns 1 and 3 are clocks that differ")


def test_labview_with_commas_between_the_cells(tmp_path):
    head = labview_head("No", LABELS, ".")
    names = ",".join(["X_Value", *CHANNELS, "Comment"])
    values = [f",{row}" for row in rows(*IN_DEGREES)]
    lines = [line.replace("\t", ",").replace("Tab", "Comma") for line in head]
    path = write(tmp_path / "run.lvm", [*lines, names, *values])
    same(read(path))
    assert "q in deg" in told(path)


def test_labview_with_a_second_segment_is_refused(tmp_path):
    head = labview_head("One", LABELS, ".")
    names = "\t".join(["X_Value", *CHANNELS, "Comment"])
    values = rows(T, *IN_DEGREES, mark="\t")
    segment = [*head[6:], names]
    lines = [*head, names, *values[:20], *segment, *values[20:]]
    path = write(tmp_path / "run.lvm", lines)
    refusal(lambda: read(path), "run.lvm", "row 37 ends the header of another segment")


# -- TwinCAT --------------------------------------------------------------------------

SIGNALS = numbered("ActPos_J{}", "ActVelo_J{}", "ActTorque_J{}")
UNITS = [*["deg (Angle)"] * 3, *["deg/s (Velocity)"] * 3, *["Nm (Torque)"] * 3]
SCOPE = [
    "Name{0}cell 3",
    "File{0}cell3.csv",
    "Starttime of export{0}132959733843760000{0}Montag, 2. Mai 2022{0}15:56:24.376",
    "Endtime of export{0}132959733853750000{0}Montag, 2. Mai 2022{0}15:56:25.375",
    "",
]


def scope_head(mark: str, details: dict[str, Sequence[str]]) -> list[str]:
    """The rows above the values, with a clock for each channel."""
    head = [line.format(mark) for line in SCOPE]
    for key, cells in details.items():
        head.append(mark.join(x for cell in cells for x in (key, cell)))
    return [*head, ""]


def test_twincat_with_a_clock_for_each_channel(tmp_path):
    details = {
        "Name": SIGNALS,
        "SymbolComment": [""] * 9,
        "SampleTime[ms]": ["10"] * 9,
        "Unit": UNITS,
        "Unit ScaleFactor": ["1"] * 9,
    }
    columns = paired(1e3 * T, *IN_DEGREES)
    values = rows(*columns, mark="\t", decimal=",")
    path = write(tmp_path / "run.csv", [*scope_head("\t", details), *values])
    same(read(path))
    assert "t in ms" in told(path)


@pytest.mark.parametrize("start", [0.0, 132_959_733_843_760_000.0])
def test_twincat_with_names_alone_and_one_clock(start, tmp_path):
    """Milliseconds since the start of the export, or the time stamps of Windows."""
    stamps = 1e3 * T if start == 0.0 else start + 1e7 * T
    head = [line.format(",") for line in SCOPE]
    values = [
        f"{stamp:.0f},{row}"
        for stamp, row in zip(stamps, rows(Q, DQ, TAU), strict=True)
    ]
    path = write(
        tmp_path / "run.csv", [*head, ",".join(["Name", *SIGNALS]), *values, "EOF"]
    )
    same(read(path))


def test_twincat_with_a_row_that_ends_early_is_no_export(tmp_path):
    path = write(tmp_path / "run.csv", ["Name", "Starttime of export", "1,2", "3,4"])
    refusal(lambda: read(path))


# -- printed messages of ROS ----------------------------------------------------------

ORDER = (2, 0, 1)


def listed(key: str, values: Sequence[object], blanks: str = "") -> list[str]:
    if not len(values):
        return [f"{blanks}{key}: []"]
    return [f"{blanks}{key}:", *(f"{blanks}- {value}" for value in values)]


def header(k: int) -> list[str]:
    stamp = round(1e9 * T[k])
    return [
        *("header:", "  stamp:", f"    sec: {1_740_000_000 + stamp // 10**9}"),
        *(f"    nanosec: {stamp % 10**9}", "  frame_id: ''"),
    ]


def joint_state(k: int) -> list[str]:
    order = list(ORDER)
    return [
        *header(k),
        *listed("name", [JOINTS[j] for j in order]),
        *listed("position", Q[k, order]),
        *listed("velocity", DQ[k, order]),
        *listed("effort", TAU[k, order]),
    ]


def flow_joint_state(k: int) -> list[str]:
    """As `rostopic echo` of ROS 1 prints lists."""
    stamp = round(1e9 * T[k])
    return [
        *("header: ", "  seq: 7", "  stamp: ", f"    secs: {stamp // 10**9}"),
        *(f"    nsecs: {stamp % 10**9:>9}", "  frame_id: ''"),
        f"name: [{', '.join(JOINTS)}]",
        f"position: {Q[k].tolist()}",
        f"velocity: {DQ[k].tolist()}",
        f"effort: {TAU[k].tolist()}",
    ]


def point(name: str, q: Sequence, dq: Sequence, tau: Sequence) -> list[str]:
    return [
        f"{name}:",
        *listed("positions", q, "  "),
        *listed("velocities", dq, "  "),
        *listed("effort", tau, "  "),
        *("  time_from_start:", "    sec: 0", "    nanosec: 0"),
    ]


def controller_state(k: int) -> list[str]:
    return [
        *header(k),
        *listed("joint_names", JOINTS),
        *point("reference", Q[k] + 0.01, DQ[k], []),
        *point("feedback", Q[k], DQ[k], []),
        *point("error", 0.0 * Q[k] + 0.01, [], []),
        *point("output", [], [], TAU[k]),
        *("multi_dof_joint_names: []", "speed_scaling_factor: 1.0"),
    ]


def dynamic_joint_state(k: int) -> list[str]:
    lines = [*header(k), *listed("joint_names", JOINTS), "interface_values:"]
    for j in range(3):
        names = ["position", "velocity", "effort"]
        first, *others = listed("interface_names", names, "  ")
        values = [Q[k, j], DQ[k, j], TAU[k, j]]
        lines += [f"- {first.strip()}", *others, *listed("values", values, "  ")]
    return lines


@pytest.mark.parametrize(
    "message", [joint_state, flow_joint_state, controller_state, dynamic_joint_state]
)
@pytest.mark.parametrize("name", ["log.yaml", "log.txt"])
def test_printed_messages_are_read(message, name, tmp_path):
    lines = [line for k in range(300) for line in (*message(k), "---")]
    same(read(write(tmp_path / name, lines)))


def test_the_controller_s_output_is_said_to_be_the_torque(tmp_path):
    lines = [line for k in range(300) for line in (*controller_state(k), "---")]
    said = told(write(tmp_path / "log.yaml", lines))
    assert "q = feedback.positions" in said
    assert "tau = output.effort" in said


@pytest.mark.parametrize("field", ["positions", "effort"])
def test_the_controller_s_output_is_left_out_beside_its_feedback(field, tmp_path):
    state = "/controller_state/{}/{}[{{}}]"
    feedback = [state.format("feedback", x) for x in ("positions", "effort")]
    names = [*feedback, state.format("output", field)]
    head = ",".join(["__time", *numbered(*names)]).replace("[", "[0")
    other = 0.5 * (Q if field == "positions" else TAU)
    path = write(tmp_path / "run.csv", [head, *rows(T, Q, TAU, other)])
    same(read(path), has_velocities=False)
    assert "what the controller puts out" in told(path)


def test_what_is_left_out_of_the_controller_s_output_is_named(tmp_path):
    """Its effort is the torque, for there is no other."""
    names = ["feedback/position[{}]", "output/position[{}]", "output/effort[{}]"]
    head = ",".join(["time", *numbered(*names)])
    path = write(tmp_path / "run.csv", [head, *rows(T, Q, 0.5 * Q, TAU)])
    same(read(path), has_velocities=False)
    said = "what the controller puts out as output/position[1] .. output/position[3] is"
    assert f"{said} not used" in told(path)


def test_a_list_of_joints_in_each_sample(tmp_path):
    """As a message of Kinova's API becomes JSON."""
    states = [
        {"position": q, "velocity": dq, "torque": tau}
        for k in range(300)
        for q, dq, tau in zip(
            *(x[k].tolist() for x in (np.degrees(Q), np.degrees(DQ), TAU)), strict=True
        )
    ]
    path = tmp_path / "run.jsonl"
    lines = [
        json.dumps({"time": T[k], "actuators": states[3 * k : 3 * k + 3]})
        for k in range(300)
    ]
    write(path, lines)
    same(read(path))
    assert "Kinova Kortex" in told(path)


def test_a_list_of_named_joints_may_change_its_order(tmp_path):
    """The names say whose numbers these are, in the order of the robot."""
    path = write(tmp_path / "run.jsonl", samples_of_joints("name", ("a", "b", "c")))
    same(read(path, ("b", "c", "a")), has_velocities=False)


@pytest.mark.parametrize("is_first", [True, False])
def test_the_names_of_another_list_are_no_joints(is_first, tmp_path):
    sensors = {"sensors": [{"name": name, "gain": 1.0} for name in "xyz"]}
    lines = []
    for line in samples_of_joints("name", ("a", "b", "c")):
        sample = json.loads(line)
        both = {**sensors, **sample} if is_first else {**sample, **sensors}
        lines.append(json.dumps(both))
    path = write(tmp_path / "run.jsonl", lines)
    same(read(path, ("b", "c", "a")), has_velocities=False)


def test_a_list_of_numbered_joints_is_in_the_order_of_their_numbers(tmp_path):
    path = write(tmp_path / "run.jsonl", samples_of_joints("id", (33, 4, 105)))
    run = read(path)
    np.testing.assert_allclose(run.q, Q[:, [0, 2, 1]], atol=1e-7)


def test_a_list_with_another_joint_is_left_out(tmp_path):
    """No column is left of it: the run is refused."""
    lines = samples_of_joints("name", ("a", "b", "c"))
    lines[7] = lines[7].replace('"b"', '"d"')
    path = write(tmp_path / "run.jsonl", lines)
    said = "line 8 names other joints than the first: the list joints is left out"
    with pytest.warns(UserWarning, match=said):
        refusal(lambda: read_run(path, 3), "no column q or tau (columns: t)")


def test_a_list_that_changes_is_left_out_beside_the_channels(tmp_path):
    lines = [
        json.dumps({**sample, "contacts": [{"id": k, "force": 1.0}]})
        for k, sample in enumerate(RECORD)
    ]
    same(read(write(tmp_path / "run.jsonl", lines)))


def samples_of_joints(key: str, names: Sequence) -> list[str]:
    """A JSON object a sample, whose list of joints begins with another one each time.
    The columns of Q and TAU are those of the second, third and first name."""
    lines = []
    for k in range(300):
        joints = [
            {key: names[j], "position": Q[k, j - 1], "torque": TAU[k, j - 1]}
            for j in (k % 3, (k + 1) % 3, (k + 2) % 3)
        ]
        lines.append(json.dumps({"t": T[k], "joints": joints}))
    return lines


def test_printed_messages_without_efforts_are_refused_with_what_is_there(tmp_path):
    lines = [x for k in range(300) for x in (*joint_state(k)[:-4], "effort: []", "---")]
    path = write(tmp_path / "log.yaml", lines)
    said = refusal(lambda: read(path), "q=position,tau=NAME")
    assert "--scale" not in said


def test_a_message_that_is_cut_at_the_end_is_left_out(tmp_path):
    lines = [line for k in range(300) for line in (*joint_state(k), "---")]
    lines += joint_state(5)[:-2]
    path = write(tmp_path / "log.yaml", lines)
    with pytest.warns(UserWarning, match="the last message ends early"):
        run = read_run(path, 3, JOINTS)
    same(run)


@pytest.mark.parametrize("n_characters", [3, 30, 90])
@pytest.mark.parametrize("message", ["joint_state", "dynamic_joint_state"])
def test_a_message_without_its_end_is_left_out(message, n_characters, tmp_path):
    """Also where it has as many numbers as the others: the last of them may be cut."""
    print_message = {f.__name__: f for f in (joint_state, dynamic_joint_state)}[message]
    lines = [line for k in range(300) for line in (*print_message(k), "---")]
    cut = "\n".join(print_message(5))[:-n_characters]
    path = write(tmp_path / "log.yaml", [*lines, cut])
    with pytest.warns(UserWarning, match="the last message ends early"):
        run = read_run(path, 3, JOINTS)
    same(run)


def test_a_message_with_fewer_values_than_names_is_refused(tmp_path):
    lines = [line for k in range(3) for line in (*dynamic_joint_state(k)[:-1], "---")]
    path = write(tmp_path / "log.yaml", lines)
    refusal(lambda: read(path), "line 1 begins no message")


@pytest.mark.parametrize(
    "text",
    [
        "header:\n  stamp:\n    sec: 1\n",
        "a:\n- b\n  - ]: c\n",
        "---\n",
        "joint_names:\n- a\ninterface_values:\n-\n",
        "joint_names:\n- a\ninterface_values:\n- interface_names:\n  - position\n",
    ],
)
def test_other_yaml_is_refused_in_one_sentence(text, tmp_path):
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    refusal(lambda: read(path), "ros2 topic echo")


# -- JSON, and the XML of KUKA's RSI ---------------------------------------------------

RECORD = [
    {"t": t, "q": q, "dq": dq, "tau": tau}
    for t, q, dq, tau in zip(*(x.tolist() for x in (T, Q, DQ, TAU)), strict=True)
]
LISTS = {"t": T.tolist(), "q": Q.tolist(), "dq": DQ.tolist(), "tau": TAU.tolist()}
OWN_NAMES = ["t", *numbered("q{}", "dq{}", "tau{}")]
NAMED = pd.DataFrame(np.column_stack([T, Q, DQ, TAU]), columns=OWN_NAMES)
JSON_TEXTS = {
    "objects": json.dumps(RECORD, indent=1),
    "lists": json.dumps({"robot": "arm", "log": LISTS}),
    "pandas": NAMED.to_json(double_precision=12),
    "pandas, split": NAMED.to_json(orient="split", double_precision=12),
    "pandas, records": NAMED.to_json(orient="records", double_precision=12),
    "lines": "\n".join(map(json.dumps, RECORD)),
}


@pytest.mark.parametrize("form", JSON_TEXTS)
def test_json(form, tmp_path):
    path = tmp_path / "run.json"
    path.write_text(JSON_TEXTS[form])
    same(read(path))


@pytest.mark.parametrize(
    "text",
    [
        '{"format": 2, "names": ["a", "b"]}',
        '{"columns": 1, "index": 2, "data": 3}',
        '{"a":' * 100_000,
        '{"t": [1, 2',
    ],
)
def test_json_without_samples_is_refused(text, tmp_path):
    path = tmp_path / "model.json"
    path.write_text(text)
    refusal(lambda: read(path), "JSON text")


def test_columns_of_pandas_are_in_the_order_of_their_rows(tmp_path):
    columns = json.loads(JSON_TEXTS["pandas"])
    columns["q1"] = dict(reversed(columns["q1"].items()))
    path = tmp_path / "run.json"
    path.write_text(json.dumps(columns))
    same(read(path))


def test_columns_of_pandas_with_other_rows_are_refused(tmp_path):
    columns = json.loads(JSON_TEXTS["pandas"])
    columns["q1"]["300"] = columns["q1"].pop("0")
    path = tmp_path / "run.json"
    path.write_text(json.dumps({"log": columns}))
    refusal(lambda: read(path), "columns t and q1 are of different rows")


def tag(name: str, values: np.ndarray) -> str:
    """A tag with one attribute an axis, as RSI writes it."""
    attributes = [f'A{j}="{value:.9f}"' for j, value in enumerate(values, start=1)]
    return f"<{name} {' '.join(attributes)}/>"


def cycle(k: int) -> str:
    """One message of RSI; its clock counts milliseconds."""
    degrees = np.degrees(Q[k])
    tags = tag("AIPos", degrees) + tag("ASPos", degrees + 1.0) + tag("MACur", TAU[k])
    place = '<RIst X="1.0" Y="2.0" Z="3.0"/>'
    clock = f"<IPOC>{4_000_000 + 10 * k}</IPOC>"
    return f'<Rob Type="KUKA">{place}{tags}{clock}</Rob>'


@pytest.mark.parametrize("between", ["\n", "", "\n<Sen><IPOC>1</IPOC></Sen>\n"])
def test_messages_of_kuka_s_rsi(between, tmp_path):
    path = tmp_path / "rsi.xml"
    path.write_text(between.join(map(cycle, range(300))))
    same(read(path), has_velocities=False)
    assert "columns recognised (KUKA RSI)" in told(path)


# -- names that say nothing -----------------------------------------------------------

#: Tables as MATLAB's writetable names them.
UNNAMED = {
    "blocks": ["Var1", *numbered("Var2_{}", "Var3_{}", "Var4_{}")],
    "blocks beside a clock": ["t", *numbered("Var2_{}", "Var3_{}", "Var4_{}")],
    "columns": [f"Var{k}" for k in range(1, 11)],
}


@pytest.mark.parametrize("form", UNNAMED)
def test_the_command_for_columns_without_names_reads_them(form, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = write(Path("run.csv"), [",".join(UNNAMED[form]), *rows(T, Q, DQ, TAU)])
    said = refusal(lambda: read(path), "if they are that")
    (command,) = re.findall("`sdp-vs-penalty (.*?)`", said)
    assert run_cli(*shlex.split(command)) == 0
    same(read(Path("run_converted.csv")))


def test_columns_without_names_that_are_not_of_this_robot_get_no_command(tmp_path):
    names = [f"Var{k}" for k in range(1, 10)]
    path = write(tmp_path / "run.csv", [",".join(names), *rows(T, Q, DQ, TAU[:, :2])])
    refusal(lambda: read(path), "q=NAME,tau=NAME")


def test_the_port_of_a_block_is_no_joint(tmp_path):
    """As Simulink and dSPACE call the signals of a model."""
    names = numbered(
        "Model/Arm/q{}/Out1", "Model/Arm/dq{}/Out1", "Model/Arm/tau{}/Out1"
    )
    path = write(
        tmp_path / "run.csv", [",".join(["time", *names]), *rows(T, Q, DQ, TAU)]
    )
    same(read(path))


# -- files of other libraries ---------------------------------------------------------


def frame(clock: str = "time") -> pd.DataFrame:
    names = [clock, *numbered("pos_{}", "vel_{}", "torque_{}")]
    return pd.DataFrame(np.column_stack([T, Q, DQ, TAU]), columns=names)


@pytest.mark.parametrize("name", ["run.feather", "run.arrow"])
def test_feather(name, tmp_path):
    frame().to_feather(tmp_path / name)
    same(read(tmp_path / name))


def test_feather_with_stamps_and_lists(tmp_path):
    stamps = pd.Timestamp("2026-11-28") + pd.to_timedelta(T, unit="s")
    blocks = {"position": Q, "velocity": DQ, "effort": TAU}
    lists = {name: list(block) for name, block in blocks.items()}
    pd.DataFrame({"time": stamps, **lists}).to_feather(tmp_path / "run.feather")
    same(read(tmp_path / "run.feather"))


def test_a_workbook_s_longest_sheet_is_read(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["Robot", "cell 3"])
    sheet = book.create_sheet("log")
    sheet.append(["Log of cell 3"])
    sheet.append(["Zeit", *numbered("Winkel {}", "Moment {}")])
    sheet.append(["s", *["°"] * 3, *["Nm"] * 3])
    for row in np.column_stack([T, np.degrees(Q), TAU]).tolist():
        sheet.append(row)
    path = tmp_path / "run.xlsx"
    book.save(path)
    with pytest.warns(UserWarning, match="sheet 'log' of 2 is read"):
        run = read_run(path, 3, JOINTS)
    same(run, has_velocities=False)
    sheet.delete_rows(len(T))  # a changed file is read anew
    book.save(path)
    assert len(read(path).t) == len(T) - 1


def test_of_equally_long_sheets_the_first_is_read_from_its_first_full_row(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for sheet in (book.active, book.create_sheet("other")):
        for cells in ([], [], ["t", *numbered("q{}", "tau{}")]):
            sheet.append(cells)
        for row in np.column_stack([T, Q, TAU]).tolist():
            sheet.append(row)
    path = tmp_path / "run.xlsx"
    book.save(path)
    with pytest.warns(UserWarning, match="'Sheet' of 2 is read, the first of 2 equal"):
        run = read_run(path, 3, JOINTS)
    same(run, has_velocities=False)


@pytest.mark.parametrize(
    "above", ["\n\n", "\n# of the arm\n", "\nLog of the arm\n\n", ",,\n"]
)
def test_empty_rows_above_a_table_are_skipped(above, tmp_path):
    lines = [",".join(["t", *numbered("q{}", "tau{}")]), *rows(T, Q, TAU)]
    path = tmp_path / "run.csv"
    path.write_text(above + "\n".join(lines))
    same(read(path), has_velocities=False)


def test_a_workbook_with_dates(tmp_path):
    pytest.importorskip("openpyxl")
    table = frame()
    table["time"] = pd.Timestamp("2026-11-28") + pd.to_timedelta(T, unit="s")
    table.to_excel(tmp_path / "run.xlsx", index=False)
    same(read(tmp_path / "run.xlsx"))


def hdf5_of(path: Path, arrays: dict[str, np.ndarray], userblock: int = 0) -> Path:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=userblock) as file:
        for name, array in arrays.items():
            file[name] = array
    return path


RECORDS = np.array(
    list(zip(T, Q, DQ, TAU, strict=True)),
    [("time", "f8"), ("position", "f8", 3), ("velocity", "f8", 3), ("effort", "f8", 3)],
)
LAYOUTS = {
    "blocks": {"t": T, "q": Q, "dq": DQ, "tau": TAU},
    "groups": {
        **{"robot/timestamps": T, "observations/qpos": Q, "observations/qvel": DQ},
        **{"observations/effort": TAU, "observations/images/cam": np.zeros((5, 4, 4))},
    },
    "records": {"log/states": RECORDS},
    "pandas": {
        "df/axis0": np.array(OWN_NAMES, "S"),
        "df/block0_items": np.array(OWN_NAMES, "S"),
        "df/block0_values": np.column_stack([T, Q, DQ, TAU]),
    },
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_hdf5(layout, tmp_path):
    same(read(hdf5_of(tmp_path / "run.h5", LAYOUTS[layout])))


@pytest.mark.parametrize("layout", ["records", "pandas"])
def test_tables_with_columns_of_the_same_name_are_refused(layout, tmp_path):
    """Such as a measured and a desired state, or two runs."""
    arrays = LAYOUTS[layout]
    other = {f"desired/{name}": array for name, array in arrays.items()}
    path = hdf5_of(tmp_path / "run.h5", {**arrays, **other})
    refusal(lambda: read(path), "two columns are called t", "in desired/", "of its own")


def test_a_mat_file_of_version_7_3(tmp_path):
    """MATLAB's matrices lie the other way round in HDF5."""
    arrays = {"t": T[None], "q": Q.T, "dq": DQ.T, "tau": TAU.T}
    path = hdf5_of(tmp_path / "run.mat", arrays, userblock=512)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    same(read(path))


def test_data_sets_in_other_files_are_not_read(tmp_path):
    h5py = pytest.importorskip("h5py")
    hdf5_of(tmp_path / "other.h5", {"q": Q})
    path = hdf5_of(tmp_path / "run.h5", {"t": T, "tau": TAU})
    with h5py.File(path, "r+") as file:
        file["q"] = h5py.ExternalLink("other.h5", "q")
    refusal(lambda: read(path), "no column q")


@pytest.mark.parametrize(
    ("module", "name", "words"),
    [
        ("h5py", "run.h5", ["HDF5 files need the extra [formats]"]),
        ("h5py", "run.mat", ["'-v7'", "[formats]"]),
        ("openpyxl", "run.xlsx", ["Excel workbooks need the extra [formats]"]),
    ],
)
def test_without_its_library_a_file_is_refused_in_one_sentence(
    module, name, words, tmp_path, monkeypatch
):
    path = tmp_path / name
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(200))
    if name == "run.xlsx":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("xl/workbook.xml", "<workbook/>")
    monkeypatch.setitem(sys.modules, module, None)
    refusal(lambda: read(path), *words)


@pytest.mark.parametrize("name", ["run.h5", "run.feather", "run.xlsx"])
def test_broken_files_of_libraries_are_refused(name, tmp_path):
    pytest.importorskip("h5py")
    pytest.importorskip("openpyxl")
    path = tmp_path / name
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(200))
    if name == "run.xlsx":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("xl/workbook.xml", "<workbook/>")
    refusal(lambda: read(path), "not a readable")


def test_a_table_in_an_archive_is_read_beside_other_arrays(tmp_path):
    np.savez(tmp_path / "run.npz", log=RECORDS, joints=np.array(JOINTS), rate=RATE)
    same(read(tmp_path / "run.npz"))


def test_a_zip_archive_of_a_newer_version_is_refused(tmp_path):
    path = tmp_path / "run.csv"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("run.csv", "t,q1,tau1")
    content = path.read_bytes()
    entry = content.index(b"PK\x01\x02")
    needed = entry + 6  # the place of the version that the archive needs
    path.write_bytes(content[:needed] + b"\x63" + content[needed + 1 :])
    refusal(lambda: read(path), "a zip archive, and no Excel workbook")


def test_a_run_in_an_archive_is_read_beside_a_table(tmp_path):
    gains = np.array([(1.0, 2.0)], [("kp", "f8"), ("kd", "f8")])
    np.savez(tmp_path / "run.npz", t=T, q=Q, dq=DQ, tau=TAU, gains=gains)
    same(read(tmp_path / "run.npz"))
