"""Whole files of other programs: LabVIEW, TwinCAT, printed ROS messages, JSON, KUKA's RSI,
Feather, Excel, HDF5. The same numbers come out of each."""

import json
import re
import shlex
import sys
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from commands import run_cli
from recorded import refusal
from scipy.io import savemat
from written_logs import DQ, JOINTS, RATE, TAU, Q, T, cells_of, log, read, same, write

from sdp_vs_penalty import Measurements
from sdp_vs_penalty.data import load_measurements
from sdp_vs_penalty.data.formats import open_log

N = len(T)
DEGREES = (*np.degrees(Q).T, *np.degrees(DQ).T, *TAU.T)


def numbered(*patterns):
    return [pattern.format(k) for pattern in patterns for k in (1, 2, 3)]


def lines_of(*columns, mark=",", decimal="."):
    return [mark.join(row) for row in cells_of(columns, decimal)]


def paired(clock, columns):
    """A clock before each column."""
    return [x for column in columns for x in (clock, column)]


def test_a_clock_in_minutes_that_does_not_say_so_is_no_log_in_degrees():
    from sdp_vs_penalty.data import check_plausible
    from sdp_vs_penalty.problem import load_problem

    robot = load_problem(Path(__file__).parents[2] / "docs" / "my_arm.urdf").robot
    run = Measurements(T / 60.0, Q, TAU, DQ)
    refusal(lambda: check_plausible(robot, run), "t from minutes to seconds")


# -- LabVIEW and TwinCAT ----------------------------------------------------------------

CHANNELS = numbered("Position {}", "Velocity {}", "Torque {}")
LABELS = [*["deg"] * 3, *["deg/s"] * 3, *["Nm"] * 3]
ONE = "\t".join(["X_Value", *CHANNELS, "Comment"])
MULTI = "\t".join(x for name in CHANNELS for x in ("X_Value", name))
SIGNALS = numbered("ActPos_J{}", "ActVelo_J{}", "ActTorque_J{}")
UNITS = [*["deg (Angle)"] * 3, *["deg/s (Velocity)"] * 3, *["Nm (Torque)"] * 3]


def labview(names, values, labels=LABELS, decimal="."):
    step = f"{1.0 / RATE:.6f}".replace(".", decimal)
    head = [
        "LabVIEW Measurement\t",
        "Separator\tTab",
        f"Decimal_Separator\t{decimal}",
        "***End_of_Header***\t",
        "\t",
        "Channels\t9",
        "\t".join(["Y_Unit_Label", *labels]),
        "\t".join(["Delta_X", *[step] * 9]),
        "***End_of_Header***\t",
    ]
    return [*head, names, *values]


def scope(mark, names, values, details=()):
    """An export of TwinCAT Scope."""
    head = [
        "Name{0}cell 3",
        "File{0}cell3.csv",
        "Starttime of export{0}132959733843760000{0}Montag, 2. Mai 2022{0}15:56:24.376",
        "",
    ]
    return [*(x.format(mark) for x in head), names, *details, "", *values]


def with_commas(lines):
    return [x.replace("\t", ",").replace("Tab", "Comma") for x in lines]


TABS = lines_of(T, *DEGREES, mark="\t")
NO_CLOCK = [f"\t{x}" for x in lines_of(*DEGREES, mark="\t", decimal=",")]
DETAILS = {
    "SymbolComment": [""] * 9,
    "SampleTime[ms]": ["10"] * 9,
    "Unit": UNITS,
    "Unit ScaleFactor": ["1"] * 9,
}
PROGRAMS = {
    "LabVIEW, one clock": (labview(ONE, TABS), "q in deg"),
    "LabVIEW, comments": (labview(ONE, [f"{x}\tOK" for x in TABS]), "q in deg"),
    "LabVIEW, no clock": (
        labview(ONE, NO_CLOCK, decimal=","),
        "100 rows a second, as the file's header",
    ),
    "LabVIEW, a clock a channel": (
        labview(
            MULTI,
            lines_of(*paired(T, DEGREES), mark="\t"),
            [x for label in LABELS for x in (label, "")],
        ),
        "q in deg",
    ),
    "LabVIEW, commas": (
        with_commas(labview(ONE, [f"\t{x}" for x in lines_of(*DEGREES, mark="\t")])),
        "q in deg",
    ),
    "TwinCAT, a clock a channel": (
        scope(
            "\t",
            "\t".join(x for name in SIGNALS for x in ("Name", name)),
            lines_of(*paired(1e3 * T, DEGREES), mark="\t", decimal=","),
            [
                "\t".join(x for y in cells for x in (key, y))
                for key, cells in DETAILS.items()
            ],
        ),
        "t in ms",
    ),
    **{
        f"TwinCAT, from {start:g}": (
            scope(
                ",",
                ",".join(["Name", *SIGNALS]),
                [
                    f"{start + step * t:.0f},{x}"
                    for t, x in zip(T, lines_of(*Q.T, *DQ.T, *TAU.T), strict=True)
                ]
                + ["EOF"],
            ),
            "t in ",
        )
        for start, step in ((0.0, 1e3), (132_959_733_843_760_000.0, 1e7))
    },
}


@pytest.mark.parametrize("case", PROGRAMS)
def test_exports_of_labview_and_twincat(case, tmp_path):
    lines, words = PROGRAMS[case]
    run, said = read(write(tmp_path / "run.lvm", lines))
    same(run, "dq=")
    assert words in said


OTHER_CLOCK = [T, DEGREES[0], T + 0.002, *paired(T, DEGREES[1:])[1:]]
SEGMENTS = labview(ONE, TABS)
NO_EXPORTS = {
    "columns 1 and 3 are clocks that differ": labview(
        MULTI, lines_of(*OTHER_CLOCK, mark="\t"), []
    ),
    "row 35 ends the header of another segment": [
        *SEGMENTS[:30],
        *SEGMENTS[4:10],
        *SEGMENTS[30:],
    ],
    "": ["Name", "Starttime of export", "1,2", "3,4"],
}


@pytest.mark.parametrize("words", NO_EXPORTS)
def test_exports_that_cannot_be_one_run_are_refused(words, tmp_path):
    refusal(lambda: read(write(tmp_path / "run.csv", NO_EXPORTS[words])), words)


# -- printed messages of ROS ----------------------------------------------------------

ORDER = [2, 0, 1]


def listed(key, values, blanks=""):
    if not len(values):
        return [f"{blanks}{key}: []"]
    return [f"{blanks}{key}:", *(f"{blanks}- {value}" for value in values)]


def header(k):
    stamp = round(1e9 * T[k])
    return [
        *("header:", "  stamp:", f"    sec: {1_740_000_000 + stamp // 10**9}"),
        *(f"    nanosec: {stamp % 10**9}", "  frame_id: ''"),
    ]


def joint_state(k):
    return [
        *header(k),
        *listed("name", [JOINTS[j] for j in ORDER]),
        *listed("position", Q[k, ORDER]),
        *listed("velocity", DQ[k, ORDER]),
        *listed("effort", TAU[k, ORDER]),
    ]


def flow_joint_state(k):
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


def point(name, q, dq, tau):
    return [
        f"{name}:",
        *listed("positions", q, "  "),
        *listed("velocities", dq, "  "),
        *listed("effort", tau, "  "),
        *("  time_from_start:", "    sec: 0", "    nanosec: 0"),
    ]


def controller_state(k):
    return [
        *header(k),
        *listed("joint_names", JOINTS),
        *point("reference", Q[k] + 0.01, DQ[k], []),
        *point("feedback", Q[k], DQ[k], []),
        *point("error", 0.0 * Q[k] + 0.01, [], []),
        *point("output", [], [], TAU[k]),
        *("multi_dof_joint_names: []", "speed_scaling_factor: 1.0"),
    ]


def dynamic_joint_state(k):
    lines = [*header(k), *listed("joint_names", JOINTS), "interface_values:"]
    for j in range(3):
        names = ["position", "velocity", "effort"]
        first, *others = listed("interface_names", names, "  ")
        values = [Q[k, j], DQ[k, j], TAU[k, j]]
        lines += [f"- {first.strip()}", *others, *listed("values", values, "  ")]
    return lines


def printed(message, count=N):
    return [line for k in range(count) for line in (*message(k), "---")]


@pytest.mark.parametrize(
    "message", [joint_state, flow_joint_state, controller_state, dynamic_joint_state]
)
@pytest.mark.parametrize("name", ["log.yaml", "log.txt"])
def test_printed_messages_are_read(message, name, tmp_path):
    run, said = read(write(tmp_path / name, printed(message)))
    same(run, "dq=")
    if message is controller_state:
        assert (
            "q = feedback.positions, dq = feedback.velocities, tau = output.effort"
            in said
        )


@pytest.mark.parametrize("n_characters", [3, 30, 90, 200])
@pytest.mark.parametrize("kind", ["joint_state", "dynamic_joint_state"])
def test_a_message_without_its_end_is_left_out(kind, n_characters, tmp_path):
    """Also where it has as many numbers as the others: the last of them may be cut."""
    message = {x.__name__: x for x in (joint_state, dynamic_joint_state)}[kind]
    cut = "\n".join(message(5))[:-n_characters]
    run, said = read(write(tmp_path / "log.yaml", [*printed(message), cut]))
    same(run)
    assert "the last message ends early" in said


def without_effort(k):
    return [*joint_state(k)[:-4], "effort: []"]


NO_MESSAGES = [
    (printed(without_effort), "tau=NAME --out"),
    (printed(lambda k: dynamic_joint_state(k)[:-1], 3), "line 1 begins no message"),
    (["header:", "  stamp:", "    sec: 1"], "ros2 topic echo"),
    (["a:", "- b", "  - ]: c"], "ros2 topic echo"),
    (["header:", "  stamp: " + 100_000 * "["], "line 1 begins no message"),
    (["---"], "ros2 topic echo"),
    (["joint_names:", "- a", "interface_values:", "-"], "ros2 topic echo"),
    (
        [
            "joint_names:",
            "- a",
            "interface_values:",
            "- interface_names:",
            "  - position",
        ],
        "ros2 topic echo",
    ),
]


@pytest.mark.parametrize(("lines", "words"), NO_MESSAGES)
def test_other_yaml_is_refused_in_one_sentence(lines, words, tmp_path):
    refusal(lambda: read(write(tmp_path / "settings.yaml", lines)), words)


# -- JSON, and the XML of KUKA's RSI ---------------------------------------------------

BLOCKS = {"t": T, "q": Q, "dq": DQ, "tau": TAU}
LISTS = {name: x.tolist() for name, x in BLOCKS.items()}
RECORD = [
    dict(zip(LISTS, row, strict=True)) for row in zip(*LISTS.values(), strict=True)
]
OWN_NAMES = ["t", *numbered("q{}", "dq{}", "tau{}")]
TABLE = np.column_stack([T, Q, DQ, TAU])
NAMED = pd.DataFrame(TABLE, columns=OWN_NAMES)
PANDAS = json.loads(NAMED.to_json(double_precision=12))
#: As a message of Kinova's API becomes JSON.
KORTEX = [
    {
        "time": t,
        "actuators": [
            {"position": a, "velocity": b, "torque": c}
            for a, b, c in zip(*x, strict=True)
        ],
    }
    for t, *x in zip(
        LISTS["t"],
        *(y.tolist() for y in (np.degrees(Q), np.degrees(DQ), TAU)),
        strict=True,
    )
]


def joints_in_lists(key, names, **more):
    """A sample's list of joints begins with another one each time. The columns of Q and
    TAU are those of the second, third and first name."""
    return [
        {
            **more,
            "t": T[k],
            "joints": [
                {key: names[j], "position": Q[k, j - 1], "torque": TAU[k, j - 1]}
                for j in (k % 3, (k + 1) % 3, (k + 2) % 3)
            ],
        }
        for k in range(N)
    ]


SENSORS = {"sensors": [{"name": name, "gain": 1.0} for name in "xyz"]}
NAMED_JOINTS = joints_in_lists("name", ("a", "b", "c"))
CONTACTS = [{**x, "contacts": [{"id": k, "force": 1.0}]} for k, x in enumerate(RECORD)]
BCA = ("b", "c", "a")
JSON_TEXTS = {
    "objects": (json.dumps(RECORD, indent=1), JOINTS),
    "lists": (json.dumps({"robot": "arm", "log": LISTS}), JOINTS),
    "pandas": (json.dumps(PANDAS), JOINTS),
    "pandas, turned": (
        json.dumps(PANDAS | {"q1": dict(reversed(PANDAS["q1"].items()))}),
        JOINTS,
    ),
    **{
        f"pandas, {x}": (NAMED.to_json(orient=x, double_precision=12), JOINTS)
        for x in ("split", "records")
    },
    "lines": ("\n".join(map(json.dumps, RECORD)), JOINTS),
    "Kinova Kortex": ("\n".join(map(json.dumps, KORTEX)), JOINTS),
    "named joints": ("\n".join(map(json.dumps, NAMED_JOINTS)), BCA),
    "names of others before": (
        "\n".join(json.dumps({**SENSORS, **x}) for x in NAMED_JOINTS),
        BCA,
    ),
    "names of others behind": (
        "\n".join(json.dumps({**x, **SENSORS}) for x in NAMED_JOINTS),
        BCA,
    ),
    "a list that changes": ("\n".join(map(json.dumps, CONTACTS)), JOINTS),
}


@pytest.mark.parametrize("form", JSON_TEXTS)
def test_json(form, tmp_path):
    text, joints = JSON_TEXTS[form]
    run, said = read(write(tmp_path / "run.json", [text]), joints)
    same(run)
    assert form != "Kinova Kortex" or form in said


def test_a_list_of_numbered_joints_is_in_the_order_of_their_numbers(tmp_path):
    lines = map(json.dumps, joints_in_lists("id", (33, 4, 105)))
    run, _ = read(write(tmp_path / "run.jsonl", lines))
    np.testing.assert_allclose(run.q, Q[:, [0, 2, 1]], atol=1e-7)


def test_a_sample_with_another_joint_is_left_out(tmp_path):
    lines = [*map(json.dumps, NAMED_JOINTS)]
    lines[7] = lines[7].replace('"b"', '"d"')
    run, said = read(write(tmp_path / "run.jsonl", lines), BCA)
    np.testing.assert_allclose(run.q, np.delete(Q, 7, axis=0), atol=1e-7)
    assert "1 row without all channels (line 8 is the first) left out" in said


NO_JSON = {
    '{"format": 2, "names": ["a", "b"]}': "JSON text",
    '{"columns": 1, "index": 2, "data": 3}': "JSON text",
    '{"a":' * 100_000: "JSON text",
    '{"t": [1, 2': "JSON text",
}


def test_columns_of_other_rows_come_together_by_their_keys(tmp_path):
    q1 = {str(k + 1): x for k, x in enumerate(Q[:, 0])}
    text = json.dumps({"log": {**PANDAS, "q1": q1}})
    run, _ = read(write(tmp_path / "run.json", [text]))
    np.testing.assert_allclose(run.q[:, 0], Q[:-1, 0])
    np.testing.assert_allclose(run.q[:, 1], Q[1:, 1])


@pytest.mark.parametrize(("text", "words"), NO_JSON.items(), ids=range(len(NO_JSON)))
def test_json_without_samples_is_refused(text, words, tmp_path):
    refusal(lambda: read(write(tmp_path / "model.json", [text])), words)


# -- lines that say name and value, and tables in other arrangements ----------------------

ROWS = [*zip(T, Q, TAU, strict=True)]
PLAIN = ["t,q1,q2,q3,tau1,tau2,tau3", *lines_of(T, *Q.T, *TAU.T)]


def named(line, mark=" "):
    """Each row as the pattern says one number of it, by its name."""
    names = PLAIN[0].split(",")
    rows = (row.split(",") for row in PLAIN[1:])
    return [mark.join(map(line.format, names, row)) for row in rows]


def by_joint(rows, patterns):
    """Each row's stamp, and position and torque of each joint, by a pattern each."""
    clock, position, torque = patterns
    return [
        ", ".join(
            [
                clock.format(t),
                *(position.format(k, x) for k, x in enumerate(q, 1)),
                *(torque.format(k, x) for k, x in enumerate(tau, 1)),
            ]
        )
        for t, q, tau in rows
    ]


def vector(values):
    return f"[{' '.join(f'{x:.9f}' for x in values)}]"


def log_line(t, q, tau):
    stamp = f"2026-05-03 10:11:{12 + t:06.3f}".replace(".", ",")
    return f"{stamp} INFO arm_logger: q={[*map(float, q)]} tau={[*map(float, tau)]}"


ARRANGED = {
    "key=value": named("{}={}"),
    "key: value": named("{}: {}", ", "),
    "key=value with units": by_joint(
        [(1e3 * t, np.degrees(q), tau) for t, q, tau in ROWS],
        ("t={:.3f} ms", "q{}={:.9f} deg", "tau{}={:.6f} N*m"),
    ),
    "Python's logging": [log_line(*row) for row in ROWS],
    "joint: key=value": [
        f"[{t:.2f}] "
        + " ".join(
            f"{x}: pos={y:.9f} eff={z:.6f}"
            for x, y, z in zip(JOINTS, q, tau, strict=True)
        )
        for t, q, tau in ROWS
    ],
    "names with blanks": by_joint(
        ROWS, ("t: {:.2f}", "J{} pos: {:.9f}", "J{} torque: {:.6f}")
    ),
    "a list of YAML": [
        line
        for t, q, tau in ROWS
        for line in (
            f"- t: {t}",
            f"  q: {[*map(float, q)]}",
            f"  tau: {[*map(float, tau)]}",
        )
    ],
    "lists without brackets": [
        f"t: {t:.2f} q: {vector(q)[1:-1]} tau: {vector(tau)[1:-1]}"
        for t, q, tau in ROWS
    ],
    "dicts of Python": [
        str({"t": float(t), "q": [*map(float, q)], "tau": [*map(float, tau)]})
        for t, q, tau in ROWS
    ],
    "a pair a line": ["rate: 100", *"\n".join(named("{}: {}", "\n")).split("\n")],
    "InfluxDB's lines": [
        f"arm,joint={joint} position={x:.9f},torque={y:.6f} {1_763_966_921 + t:.9f}".replace(
            ".00 ", "0"
        )
        for t, q, tau in ROWS
        for joint, x, y in zip(JOINTS, q, tau, strict=True)
    ],
    "a historian's long table": [
        "NodeId,SourceTimestamp,Value,Quality",
        *(
            f"ns=3;s=Axis{k}.Actual{word},2026-04-02T08:00:{t:09.6f}+00:00,{x:.9f},Good"
            for t, q, tau in ROWS
            for word, values in (("Position", q), ("Torque", tau))
            for k, x in enumerate(values, 1)
        ),
    ],
    "R's write.table": [
        " ".join(f'"{x}"' for x in PLAIN[0].split(",")),
        *(f'"{k}" {row}'.replace(",", " ") for k, row in enumerate(PLAIN[1:], 1)),
    ],
    "front matter": ["---", "units: {q: rad, tau: Nm}", "by: me", "---", *PLAIN],
    "a line of JSON above": ['{"robot": "arm", "date": "2026-02-01"}', *PLAIN],
    "OpenSim": [
        *("Coordinates", "nRows=150", "Units are S.I. (second, m)", "", "endheader"),
        *(row.replace(",", "\t") for row in PLAIN),
    ],
    "a row a channel": [
        ",".join(cells)
        for cells in zip(*(row.split(",") for row in PLAIN), strict=True)
    ],
    "a list of lists": [json.dumps([[t, *q, *tau] for t, q, tau in ROWS])],
    "vectors of NumPy": [f"{t:.2f} {vector(q)} {vector(tau)}" for t, q, tau in ROWS],
    "Octave's text": [
        "# Created by Octave 8.4.0, Tue Jun 11 10:01:12 2024 UTC <lab@pc>",
        *(
            line
            for name, matrix in (("t", T[:, None]), ("q", Q), ("tau", TAU))
            for line in (
                f"# name: {name}",
                "# type: matrix",
                f"# rows: {len(matrix)}",
                f"# columns: {matrix.shape[1]}",
                *(f" {' '.join(map(str, row))}" for row in matrix.tolist()),
                "",
            )
        ),
    ],
    "a web page": [
        "<html><body><table><thead>",
        *(f"<tr><td>{row.replace(',', '</td><td>')}</td></tr>\n" for row in PLAIN),
        "</table></body></html>",
    ],
}
BY_NUMBER = {
    "a list of lists": "t=#1,q1=#2,q2=#3,q3=#4,tau1=#5,tau2=#6,tau3=#7",
    "vectors of NumPy": "t=#1,q1=#2_1,q2=#2_2,q3=#2_3,tau1=#3_1,tau2=#3_2,tau3=#3_3",
}


@pytest.mark.parametrize("form", ARRANGED)
def test_named_values_and_other_arrangements_are_read(form, tmp_path):
    rename = dict(x.split("=") for x in BY_NUMBER.get(form, "").split(",") if x)
    run, _ = read(write(tmp_path / "run.txt", ARRANGED[form]), rename=rename or None)
    same(run)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("t=0.5 q1=0.1 q2=0.2", "line 150 names other values than line 1"),
        ("stopped by user", ""),
    ],
)
def test_a_line_of_other_names_is_refused_and_words_are_not(line, words, tmp_path):
    lines = [*ARRANGED["key=value"][:-1], line]
    lines += ARRANGED["key=value"][-1:]
    path = write(tmp_path / "run.txt", lines)
    if words:
        refusal(lambda: read(path), words)
    else:
        same(read(path)[0])


def test_a_row_of_octave_s_text_that_is_none_is_refused(tmp_path):
    lines = [*ARRANGED["Octave's text"]]
    lines[-5] = " 0.1 0.2"
    path = write(tmp_path / "run.txt", lines)
    refusal(lambda: read(path), "the name tau is no matrix of numbers")


def test_a_column_without_a_comma_at_first_has_that_of_the_nearest_one(tmp_path):
    """Positions had points, torques commas; one torque was whole for a hundred rows."""
    lines = ["t;q1;q2;q3;tau1;tau2"]
    lines += [
        f"{t:.2f};0.123;0.5;0.25;1,5;{7 if k < 120 else '9728,8'}"
        for k, t in enumerate(T)
    ]
    path = write(tmp_path / "run.csv", lines)
    assert open_log(path).read(["tau2"]).columns["tau2"][-1] == 9728.8


def test_a_number_that_repeats_in_several_channels_is_no_measurement(tmp_path):
    """-9999 stood once in each column, and was a position."""
    rows = [row.split(",") for row in PLAIN]
    rows[20][1], rows[40][5], rows[60][2] = "-9999", "-9999", "#DIV/0!"
    run, said = read(write(tmp_path / "run.csv", map(",".join, rows)))
    assert "2 cells of -9999 are no measurements" in said
    np.testing.assert_allclose(run.q, np.delete(Q, [19, 39, 59], axis=0), atol=1e-7)


def tag(name, values):
    """A tag with one attribute an axis, as RSI writes it."""
    attributes = [f'A{j}="{value:.9f}"' for j, value in enumerate(values, start=1)]
    return f"<{name} {' '.join(attributes)}/>"


def cycle(k):
    """One message of RSI; its clock counts milliseconds."""
    degrees = np.degrees(Q[k])
    tags = tag("AIPos", degrees) + tag("ASPos", degrees + 1.0) + tag("MACur", TAU[k])
    place = '<RIst X="1.0" Y="2.0" Z="3.0"/>'
    return f'<Rob Type="KUKA">{place}{tags}<IPOC>{4_000_000 + 10 * k}</IPOC></Rob>'


@pytest.mark.parametrize("between", ["\n", "", "\n<Sen><IPOC>1</IPOC></Sen>\n"])
def test_messages_of_kuka_s_rsi(between, tmp_path):
    run, said = read(write(tmp_path / "rsi.xml", [between.join(map(cycle, range(N)))]))
    same(run)
    assert "columns recognised (KUKA RSI)" in said


# -- names that say nothing -----------------------------------------------------------

#: Tables as MATLAB's writetable names them.
UNNAMED = [
    "t=Var1; q=Var2_{}; dq=Var3_{}; tau=Var4_{}",
    "t=t; q=Var2_{}; dq=Var3_{}; tau=Var4_{}",
]
COLUMNS = [",".join(f"Var{k}" for k in range(1, 11))]


@pytest.mark.parametrize(
    ("row", "head"), [(x, None) for x in UNNAMED] + [(UNNAMED[0], COLUMNS)]
)
def test_the_command_for_columns_without_names_reads_them(
    row, head, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    said = refusal(
        lambda: read(log(Path("run.csv"), row, head=head)), "q, dq and tau, say so"
    )
    (command,) = re.findall("`sdp-vs-penalty (.*?)`", said)
    assert run_cli(*shlex.split(command)) == 0
    same(load_measurements("run_converted.csv"), "dq=")


def test_columns_without_names_that_are_not_of_this_robot_get_no_command(tmp_path):
    head = [",".join(f"Var{k}" for k in range(1, 8))]
    path = log(tmp_path / "run.csv", "t=t; q=q{}; tau=tau{}", head=head)
    refusal(lambda: read(path, (*JOINTS, "hand")), "q=NAME,tau=NAME")


# -- files of other libraries ---------------------------------------------------------

FRAME = pd.DataFrame(
    TABLE, columns=["time", *numbered("pos_{}", "vel_{}", "torque_{}")]
)
STAMPS = pd.Timestamp("2026-11-28") + pd.to_timedelta(T, unit="s")
DATED = FRAME.assign(time=STAMPS)
OF_LISTS = {"position": list(Q), "velocity": list(DQ), "effort": list(TAU)}
RECORDS = np.array(
    list(zip(T, Q, DQ, TAU, strict=True)),
    [("time", "f8"), ("position", "f8", 3), ("velocity", "f8", 3), ("effort", "f8", 3)],
)
GAINS = np.array([(1.0, 2.0)], [("kp", "f8"), ("kd", "f8")])
MATRICES = {"t": T[None], "q": Q.T, "dq": DQ.T, "tau": TAU.T}  # as MATLAB's lie in HDF5
LAYOUTS = {
    "blocks": BLOCKS,
    "groups": {
        **{"robot/timestamps": T, "observations/qpos": Q, "observations/qvel": DQ},
        **{"observations/effort": TAU, "observations/images/cam": np.zeros((5, 4, 4))},
    },
    "records": {"log/states": RECORDS},
    "pandas": {
        "df/axis0": np.array(OWN_NAMES, "S"),
        "df/block0_items": np.array(OWN_NAMES, "S"),
        "df/block0_values": TABLE,
    },
}


def hdf5(path, arrays, userblock=0):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=userblock) as file:
        for name, array in arrays.items():
            file[name] = array


def with_units(path):
    """Data sets whose attributes say their units."""
    hdf5(path, {"time": 1e6 * T, "angle": np.degrees(Q), "torque": TAU})
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "r+") as file:
        for name, unit in {"time": "us", "angle": b"deg", "torque": "Nm"}.items():
            file[name].attrs["unit"] = unit


def dspace(path):
    """A recording of ControlDesk."""
    signals = np.zeros((1, 6), [(x, "O") for x in ("Name", "Data", "Unit")])
    for k in range(3):
        signals[0, k] = (f"phi_{k + 1}", np.degrees(Q[:, k]), "deg")
        signals[0, 3 + k] = (f"M_ist_{k + 1}", TAU[:, k], "Nm")
    savemat(path, {"rec": {"X": {"Data": T, "Unit": "s"}, "Y": signals}})


def test_units_and_names_that_stand_beside_the_numbers_are_read(tmp_path):
    for name, make in {"run.h5": with_units, "run.mat": dspace}.items():
        make(tmp_path / name)
        same(read(tmp_path / name)[0])


def matlab_7_3(path):
    hdf5(path, MATRICES, 512)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


FILES = {
    "run.feather": FRAME.to_feather,
    "run.arrow": FRAME.to_feather,
    "lists.feather": pd.DataFrame({"time": STAMPS, **OF_LISTS}).to_feather,
    "texts.feather": pd.DataFrame(
        {"time": list(map(str, STAMPS)), **OF_LISTS}
    ).to_feather,
    "dates.xlsx": lambda x: DATED.to_excel(x, index=False),
    "version_7_3.mat": matlab_7_3,
    "records.npz": lambda x: np.savez(
        x, log=RECORDS, joints=np.array(JOINTS), rate=RATE
    ),
    "gains.npz": lambda x: np.savez(x, **BLOCKS, gains=GAINS),
    **{
        f"{k}.h5": lambda x, arrays=arrays: hdf5(x, arrays)
        for k, arrays in LAYOUTS.items()
    },
}


@pytest.mark.parametrize("name", FILES)
def test_files_of_libraries(name, tmp_path):
    FILES[name](tmp_path / name)
    same(read(tmp_path / name)[0], "dq=")


@pytest.mark.parametrize("heads", [1, 2])
def test_a_workbook_s_longest_sheet_is_read(heads, tmp_path):
    """Of equally long ones it is the first; from its first full row on."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    names, rows = (
        ["t", *numbered("q{}", "tau{}")],
        np.column_stack([T, Q, TAU]).tolist(),
    )
    units, degrees = (
        ["s", *["°"] * 3, *["Nm"] * 3],
        np.column_stack([T, np.degrees(Q), TAU]),
    )
    book.active.append(["Robot", "cell 3"])
    for title in ("log", "other")[:heads]:
        sheet = book.create_sheet(title)
        for cells in (
            ([], [], names, *rows)
            if heads > 1
            else (["Log"], names, units, *degrees.tolist())
        ):
            sheet.append(cells)
    path = tmp_path / "run.xlsx"
    book.save(path)
    run, said = read(path)
    same(run)
    why = "the first of 2 equally long" if heads > 1 else "the longest"
    assert f"sheet 'log' of {heads + 1} is read, {why}" in said
    for sheet in book.worksheets[1:]:
        sheet.delete_rows(N)  # a changed file is read anew
    book.save(path)
    assert len(read(path)[0].t) < N


def test_sheets_of_a_quantity_each_are_read_side_by_side(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for title, block in (("Position", Q), ("Torque", TAU)):
        sheet = book.create_sheet(title)
        for cells in (["time", *"abc"], *np.column_stack([T, block]).tolist()):
            sheet.append(cells)
    path = tmp_path / "run.xlsx"
    book.save(path)
    run, said = read(path)
    same(run)
    assert "sheets Position, Torque are read side by side" in said


def test_groups_with_clocks_of_their_own_come_to_the_torque_s(tmp_path):
    groups = {"position": (T, Q), "torque": (T[::2], TAU[::2])}
    arrays = {
        f"{x}/{leaf}": y
        for x, pair in groups.items()
        for leaf, y in zip(("time", "data"), pair, strict=True)
    }
    hdf5(tmp_path / "run.h5", {**arrays, "rated_current": np.ones(3)})
    run, _ = read(tmp_path / "run.h5")
    np.testing.assert_allclose(run.t, T[::2])
    np.testing.assert_allclose(run.q, Q[::2])
    np.testing.assert_allclose(run.tau, TAU[::2])


@pytest.mark.parametrize("layout", ["records", "pandas"])
def test_of_tables_with_columns_of_the_same_name_the_measured_one_is_read(
    layout, tmp_path
):
    arrays = LAYOUTS[layout]
    desired = {f"desired/{x}": y for x, y in arrays.items()}
    hdf5(tmp_path / "run.h5", {**arrays, **desired})
    run, said = read(tmp_path / "run.h5")
    same(run)
    assert "= desired/" not in said


@pytest.mark.parametrize("layout", ["records", "pandas"])
def test_tables_of_two_runs_stand_one_after_the_other(layout, tmp_path):
    arrays = {f"demo_{k}/{x}": y for k in (0, 1) for x, y in LAYOUTS[layout].items()}
    hdf5(tmp_path / "run.h5", arrays)
    run, _ = read(tmp_path / "run.h5")
    np.testing.assert_allclose(run.q, np.vstack([Q, Q]), atol=1e-7)


def test_data_sets_in_other_files_are_not_read(tmp_path):
    h5py = pytest.importorskip("h5py")
    hdf5(tmp_path / "other.h5", {"q": Q})
    hdf5(tmp_path / "run.h5", {"t": T, "tau": TAU})
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        file["q"] = h5py.ExternalLink("other.h5", "q")
    refusal(lambda: read(tmp_path / "run.h5"), "no column q")


def broken(path):
    """A file that begins as one of its format does, and is none."""
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(200))
    if path.suffix == ".xlsx":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("xl/workbook.xml", "<workbook/>")
    return path


@pytest.mark.parametrize(
    ("module", "name", "words"),
    [
        ("h5py", "run.h5", ["HDF5 files need the extra [formats]"]),
        ("h5py", "run.mat", ["'-v7'", "[formats]"]),
        ("openpyxl", "run.xlsx", ["Excel workbooks need the extra [formats]"]),
        ("", "run.h5", ["not a readable"]),
        ("", "run.feather", ["not a readable"]),
        ("", "run.xlsx", ["not a readable"]),
    ],
)
def test_a_file_without_its_library_or_that_is_broken_is_refused(
    module, name, words, tmp_path, monkeypatch
):
    pytest.importorskip("h5py")
    pytest.importorskip("openpyxl")
    if module:
        monkeypatch.setitem(sys.modules, module, None)
    refusal(lambda: read(broken(tmp_path / name)), *words)


def test_a_zip_archive_of_a_newer_version_is_refused(tmp_path):
    path = tmp_path / "run.csv"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("run.csv", "t,q1,tau1")
    content = path.read_bytes()
    needed = content.index(b"PK\x01\x02") + 6  # the version that the archive needs
    path.write_bytes(content[:needed] + b"\x63" + content[needed + 1 :])
    refusal(lambda: read(path), "a zip archive, and no Excel workbook")
