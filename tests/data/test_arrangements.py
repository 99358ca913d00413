"""One motion in other arrangements than one plain table: rows between and below the
samples, packed files, arrays, several files, a row a joint, JSON; the same comes out, or one
sentence says what to do."""

import bz2
import gzip
import json
import lzma
import re
import shlex

import numpy as np
import pandas as pd
import pytest
from commands import run_cli
from recorded import refusal
from scipy.io import savemat
from written_logs import (
    DQ,
    JOINTS,
    RATE,
    SORTED,
    TAU,
    Q,
    T,
    cells_of,
    log,
    names_and_columns,
    read,
    same,
    write,
)

from sdp_vs_penalty import convert, load_measurements
from sdp_vs_penalty.data import describe_columns, read_run, unit_of_clock
from sdp_vs_penalty.data.files import run_files
from sdp_vs_penalty.data.formats.text_file import PIECE
from sdp_vs_penalty.data.hypotheses.orders import layouts
from sdp_vs_penalty.data.hypotheses.weighing import CERTAIN
from sdp_vs_penalty.data.parsing import pairs
from sdp_vs_penalty.data.words.units import unit_of_factor
from sdp_vs_penalty.errors import ColumnsRemark, Remark

OURS = "t=t; q=q{}; tau=tau{}"


# -- rows of a table -------------------------------------------------------------------


def without(lines, row, *places):
    """Lines with empty cells in some columns of a sample."""
    cells = lines[row + 1].split(",")
    for k in places or range(1, 7):
        cells[k] = ""
    return [*lines[: row + 1], ",".join(cells), *lines[row + 2 :]]


def emptied(lines, place, n):
    for row in range(30, 30 + 10 * n, 10):
        lines = without(lines, row, place)
    return lines


def between(lines, row, *more):
    return [*lines[:row], *more, *lines[row:]]


def marked(lines, mark):
    return between(lines[:31] + lines[32:], 31, ",".join(["0.3", *[mark] * 6]))


OTHER_TOPIC = [f"{t + 0.001:.6f},,,,,,,24.1" for t in T[120:150:3]]
#: What changes the lines of a table, which samples are left out, and what is said.
EDITS = {
    "separators at the end": (lambda x: [x[0], *(f"{y},," for y in x[1:])], 0, ""),
    "rows of another topic": (
        lambda x: (
            [f"{x[0]},/battery", *(f"{y}," for y in x[1:121]), *OTHER_TOPIC]
            + [f"{y}," for y in x[121:]]
        ),
        0,
        "10 rows without all channels",
    ),
    **{
        f"{n} empty cells of column {k}": (
            lambda x, k=k, n=n: emptied(x, k, n),
            n,
            f"{n} row{'s' * (n > 1)} without all channels (row 32 is the first) left out",
        )
        for k in (1, 5)
        for n in (1, 2, 12)
    },
    **{
        f"mark {x}": (lambda y, x=x: marked(y, x), 1, "1 row")
        for x in ("null", "#N/A", "-", "---")
    },
    "empty rows and a header": (
        lambda x: between(between(x, 90, x[0]), 40, "", ""),
        0,
        "2 empty rows and 1 repeated header left out",
    ),
    "comments": (
        lambda x: [*between(x, 50, "# the arm was paused, for a second"), "# end"],
        0,
        "2 comments left out",
    ),
    "a cut row": (lambda x: [*x, "0.6,0.1"], 0, "1 incomplete last row left out"),
    "words": (
        lambda x: [*x, "", "Total samples: 150", "END"],
        0,
        "2 incomplete last rows",
    ),
    "sums": (lambda x: [*x, "mean,0,0,0,0,0,0"], 0, "1 incomplete last row left out"),
}


@pytest.mark.parametrize("case", EDITS)
def test_rows_that_are_no_samples_are_left_out_and_counted(case, tmp_path):
    """Nothing is put in the place of an empty cell: the nearest value is a period away."""
    edit, n_lost, words = EDITS[case]
    path = log(tmp_path / "run.csv", OURS)
    write(path, edit(path.read_text().splitlines()))
    run, said = read(path)
    lost = range(30, 30 + 10 * n_lost, 10)
    for values, expected in ((run.t, T), (run.q, Q), (run.tau, TAU)):
        np.testing.assert_allclose(values, np.delete(expected, lost, axis=0), atol=1e-9)
    assert words in said


#: What changes the lines of a table, and the sentence with which it is refused.
WRONG = {
    "behind empty rows": (
        lambda x: between([*x[:60], f"x{x[60]}", *x[61:]], 30, ""),
        "row 62, column 1",
    ),
    "of a sparse table": (
        lambda x: [
            y
            for k, z in enumerate(x)
            for y in (z.replace(",", ",oops", k == 51), f"{k},,,,,,")
        ][::1],
        "row 103, column 2 holds 'oops",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_cell_is_named_by_its_own_row(case, tmp_path):
    edit, words = WRONG[case]
    path = log(tmp_path / "run.csv", OURS)
    write(path, edit(path.read_text().splitlines()))
    refusal(lambda: read(path), words)


def test_a_row_of_values_is_no_header(tmp_path):
    path = log(tmp_path / "run.csv", "t=t; text=state; q=q{}; tau=tau{}")
    write(path, between(path.read_text().splitlines(), 1, "-0.01,idle,0,0,0,0,0,0"))
    run, _ = read(path)
    np.testing.assert_array_equal(run.q[0], np.zeros(3))


PACKERS = {"gz": gzip, "bz2": bz2, "xz": lzma}


@pytest.mark.parametrize("suffix", PACKERS)
def test_packed_tables_are_read_or_refused_where_they_are_broken(suffix, tmp_path):
    path = log(tmp_path / "run.csv", OURS)
    packed = bytearray(PACKERS[suffix].compress(path.read_bytes()))
    packed_path = path.with_suffix(f".csv.{suffix}")
    packed_path.write_bytes(packed)
    same(read(packed_path)[0])
    packed_path.write_bytes(packed[:-200])
    refusal(lambda: read(packed_path), "ends early")
    packed[len(packed) // 2] ^= 0xFF
    path.write_bytes(packed)
    refusal(lambda: read(path))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"header:\n  stamp:\n    sec: 1\n", "ros2 topic echo --csv"),
        (b"<Rob><AIPos A1='1'/></Rob>\n<Rob/>\n", "XML text"),
        (b'{"t": 0.0, "q": [1, 2]}\n{"t": 0.1}\n', "no column tau"),
        (b"PK\x03\x04" + bytes(100), "Excel"),
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "HDF5"),
        (b"\x80\x04\x95" + bytes(100), "pickle"),
        (
            b"version https://git-lfs.github.com/spec/v1\noid x\nsize 9\n",
            "git lfs pull",
        ),
        (b"<!DOCTYPE html>\n<html><body>run.csv</body></html>\n", "a web page"),
    ],
)
def test_what_is_no_table_is_called_by_its_name(content, words, tmp_path):
    path = tmp_path / "run.csv"
    path.write_bytes(content)
    refusal(lambda: read(path), words)


# -- the same motion in files of any form ------------------------------------------------

ARRAYS = {"t": T, "q": Q, "tau": TAU}
TABLE = np.column_stack([T, Q, TAU])
BLOCKS = np.column_stack([Q, DQ, TAU])
HEAD = ["t", "q1", "q2", "q3", "tau1", "tau2", "tau3"]
RECORDS = np.zeros(
    len(T), [("t", "f8"), ("q", "f8", 3), ("tau", "f8", 3), ("mode", "U4")]
)
for _name, _block in ARRAYS.items():
    RECORDS[_name] = _block
NAMES = np.array([JOINTS[k] for k in SORTED])
STRUCTS = np.zeros((1, 3), [("pos", "O"), ("torque", "O")])
for _k in range(3):
    STRUCTS[0, _k] = (Q[:, _k : _k + 1], TAU[:, _k : _k + 1])
SIGNALS = np.zeros((1, 2), [("values", "O"), ("label", "O")])
SIGNALS[0] = [(Q, "q"), (TAU, "tau")]
CELLS = np.empty((2, len(T)), object)
for _k in range(len(T)):
    CELLS[:, _k] = [x[_k, :, None] for x in (Q, TAU)]
LISTS = {
    "Python": lambda row: '"[' + ", ".join(map(str, row)) + ']"',
    "NumPy": lambda row: "[" + " ".join(map(str, row)) + "]",
    "NumPy, wrapped": lambda row: f'"[{row[0]} {row[1]}\n {row[2]}]"',
    "array": lambda row: f"\"array('d', {list(map(float, row))})\"",
    "tuple": lambda row: '"(' + ", ".join(map(str, row)) + ')"',
}


def stamped(form):
    """What writes a frame whose clock is texts that pass midnight, and the frame."""
    names, columns = names_and_columns(
        "@%Y-%m-%d %H:%M:%S.%f=time; q=pos_{}; tau=trq_{}"
    )
    frame = pd.DataFrame(dict(zip(names, columns, strict=True)))
    if form == "parquet":
        return (lambda path: frame.to_parquet(path),)
    lines = {"orient": "records", "lines": True} if form == "jsonl" else {}
    return (lambda path: frame.to_json(path, double_precision=12, **lines),)


UNITS = {
    "units": {"angle": "deg", "torque": "mNm", "time": "ms"},
    "data": {
        "time": (1e3 * T).tolist(),
        "angle": np.degrees(Q).tolist(),
        "torque": (1e3 * TAU).tolist(),
    },
}


def lists(folder, how, order=(0, 1, 2)):
    """A cell of lists a sample, with the joints' names beside them."""
    names = '"' + str([JOINTS[k] for k in order]) + '"'
    cells = [[how(row[list(order)].tolist()) for row in block] for block in (Q, TAU)]
    rows = zip(map(str, T), [names] * len(T), *cells, strict=True)
    return write(
        folder / "run.csv", ["time,name,position,effort", *map(",".join, rows)]
    )


def saved(save, path, *content, **more):
    save(path, *content, **more)
    return path


def json_lines(folder, fields=("position", "effort"), order=(0, 1, 2), **more):
    samples = [
        {
            "time": t,
            fields[0]: q[list(order)].tolist(),
            fields[1]: tau[list(order)].tolist(),
            **more,
        }
        for t, q, tau in zip(T.tolist(), Q, TAU, strict=True)
    ]
    return write(folder / "run.jsonl", [*map(json.dumps, samples), ""])


def nested(k):
    """A sample with an object a joint."""
    joints = {
        name: {"position": Q[k, j], "effort": TAU[k, j]}
        for j, name in enumerate(JOINTS)
    }
    return {"time": T[k], "joints": joints}


def long_line(folder, name):
    text = json.dumps({"t": T.tolist(), "position": Q.tolist(), "effort": TAU.tolist()})
    return write(folder / name, [text[0] + " " * (2 * PIECE) + text[1:]])


THEIRS = "time,{},position,effort"


def long_rows(
    folder, labels, order=(0, 1, 2), *, is_sorted=False, head="joint", names=THEIRS
):
    """A row for each joint and instant."""
    rows = [
        (j * is_sorted, f"{t},{labels[j]},{Q[k, j]},{TAU[k, j]}")
        for k, t in enumerate(T)
        for j in order
    ]
    rows.sort(key=lambda row: row[0])
    return write(folder / "run.csv", [names.format(head), *(x for _, x in rows)])


def json_rows(folder, key, labels):
    """A line for each joint and instant."""
    samples = [
        {"timestamp": t, key: labels[j], "pos": Q[k, j], "tau_N.m": TAU[k, j]}
        for k, t in enumerate(T.tolist())
        for j in range(3)
    ]
    return write(folder / "run.jsonl", map(json.dumps, samples))


def melted(folder, head, label):
    """A row for each channel and instant, as pandas melts a table."""
    rows = [
        f"{t},{label.format(name, field)},{block[k, j]}"
        for k, t in enumerate(T)
        for j, name in enumerate(JOINTS)
        for field, block in (("position", Q), ("effort", TAU))
    ]
    return write(folder / "run.csv", [head, *rows])


def tidy(folder):
    """A row a channel, with its unit in each."""
    rows = [
        f"{t},{name},{field},{block[k, j]},{unit}"
        for k, t in enumerate(T)
        for j, name in enumerate(JOINTS)
        for field, block, unit in (
            ("angle", np.degrees(Q), "deg"),
            ("torque", TAU, "Nm"),
        )
    ]
    return write(folder / "run.csv", ["time,joint,signal,value,unit", *rows])


def influx(folder):
    """A row a channel, as InfluxDB annotates it."""
    rows = [
        f",,0,{t},{block[k, j]},{field},joint_state,{name}"
        for field, block in (("position", Q), ("effort", TAU))
        for j, name in enumerate(JOINTS)
        for k, t in enumerate(T)
    ]
    head = ",result,table,_time,_value,_field,_measurement,joint"
    return write(folder / "run.csv", ["#group,false", head, *rows])


def several(folder, **texts):
    """Files by their names, with a dot in place of two underlines; and the folder."""
    for name, row in texts.items():
        names = [] if row.startswith("~") else None
        log(folder / "log" / name.replace("__", "."), row.removeprefix("~"), head=names)
    return folder / "log"


def of_joints(folder, stem, first, head, late=0.0):
    for k in range(3):
        clock = T + k * late
        q = np.sin(2.0 * clock + k)
        rows = cells_of([clock, q, np.interp(clock, T, TAU[:, k])])
        write(folder / "log" / f"{stem}{k + first}.csv", [head, *map(",".join, rows)])
    return folder / "log"


def lerobot(folder):
    """Metadata beside the file name the motors of a block."""
    feature = {"names": [f"{x}.pos" for x in NAMES], "unit": "rad"}
    info = json.dumps({"features": {"observation.state": feature}})
    write(folder / "meta" / "info.json", [info])
    blocks = {"observation.state": Q[:, SORTED], "observation.effort": TAU[:, SORTED]}
    frame = pd.DataFrame({"timestamp": T, **{k: list(x) for k, x in blocks.items()}})
    path = folder / "data" / "chunk-000" / "file-000.parquet"
    path.parent.mkdir(parents=True)
    frame.to_parquet(path)
    return path


def units_in_cells(folder):
    cells = cells_of([1e3 * T, *np.degrees(Q).T, *TAU.T])
    lines = [
        ",".join([f"{x[0]} ms", *(f"{y} deg" for y in x[1:4]), *x[4:]]) for x in cells
    ]
    return write(folder / "run.csv", [",".join(HEAD), *lines])


FORMS = {
    "fields": lambda x: saved(np.save, x / "run.npy", RECORDS),
    "rate, array": lambda x: saved(np.save, x / "run.npy", BLOCKS),
    "rate, turned": lambda x: saved(np.save, x / "run.npy", BLOCKS.T),
    "table and names": lambda x: saved(
        np.savez, x / "run.npz", data=TABLE, columns=np.array(HEAD)
    ),
    "texts beside": lambda x: saved(
        np.savez, x / "run.npz", **ARRAYS, robot=np.array("arm")
    ),
    "objects beside": lambda x: saved(
        np.savez, x / "run.npz", **ARRAYS, meta=np.array({"a": 1}, object)
    ),
    "times as texts": lambda x: saved(
        np.savez,
        x / "run.npz",
        time=np.array([f"12:00:{t:09.6f}" for t in T]),
        q=Q,
        tau=TAU,
    ),
    "names beside": lambda x: saved(
        np.savez,
        x / "run.npz",
        joint_names=NAMES,
        t=T,
        q=Q[:, SORTED],
        tau=TAU[:, SORTED],
    ),
    "names beside, MATLAB": lambda x: saved(
        savemat,
        x / "run.mat",
        {
            "joint_names": np.array(NAMES, object),
            "t": T,
            "q": Q[:, SORTED],
            "tau": TAU[:, SORTED],
        },
    ),
    "names and words": lambda x: saved(
        np.savez,
        x / "run.npz",
        **{
            "joint_names": NAMES,
            "time": T,
            "positions": Q[:, SORTED],
            "efforts": TAU[:, SORTED],
        },
    ),
    **{
        f"axis {k}": lambda x, k=k: saved(
            np.savez,
            x / "run.npz",
            t=T,
            q=np.expand_dims(Q, k),
            tau=np.expand_dims(TAU, k),
        )
        for k in (1, 2)
    },
    "structs": lambda x: saved(
        savemat,
        x / "run.mat",
        {"log": {"time": T, "joint": {"position": Q, "torque": TAU}}},
    ),
    "cells": lambda x: saved(
        savemat, x / "run.mat", {"t": T, "q": CELLS[0], "tau": CELLS[1]}
    ),
    "rate, matrix": lambda x: saved(savemat, x / "run.mat", {"ans": BLOCKS.T}),
    "array of structs": lambda x: saved(
        savemat, x / "run.mat", {"t": T[:, None], "joint": STRUCTS}
    ),
    "Simulink": lambda x: saved(
        savemat, x / "run.mat", {"ScopeData": {"time": T[:, None], "signals": SIGNALS}}
    ),
    **{f"lists, {k}": lambda x, how=how: lists(x, how) for k, how in LISTS.items()},
    "lists in another order": lambda x: lists(x, LISTS["Python"], SORTED),
    "JSON lines": json_lines,
    "JSON lines in another order": lambda x: json_lines(
        x, order=SORTED, name=list(NAMES)
    ),
    "JSON with empty fields": lambda x: json_lines(x, error=None),
    "JSON, objects of joints": lambda x: write(
        x / "run.json", [json.dumps({"log": list(map(nested, range(len(T))))})]
    ),
    "JSON on a long line": lambda x: long_line(x, "run.json"),
    "JSON as text": lambda x: long_line(x, "run.txt"),
    **{
        f"a row a joint, {labels[0]}, {is_sorted}": lambda x, a=labels, b=is_sorted: (
            long_rows(x, a, is_sorted=b)
        )
        for labels in (JOINTS, "012", "123", ("0x14a", "0x14b", "0x14c"))
        for is_sorted in (False, True)
    },
    "a JSON line a joint": lambda x: json_rows(x, "name", JOINTS),
    "a JSON line a number": lambda x: json_rows(x, "id", (1, 2, 3)),
    "a row a joint under our names": lambda x: long_rows(x, JOINTS, names="t,{},q,tau"),
    "a row a joint, turned": lambda x: long_rows(x, JOINTS, SORTED, head="name"),
    "a row a channel": lambda x: melted(x, "time,variable,value", "{}_{}"),
    "a row a joint's channel": lambda x: melted(x, "time,joint,field,value", "{},{}"),
    "a row a channel with its unit": tidy,
    "a row a channel of InfluxDB": influx,
    "units in cells": units_in_cells,
    **{
        f"texts of times in {form}": lambda x, form=form: saved(
            *stamped(form), x / f"run.{form}"
        )
        for form in ("jsonl", "json", "parquet")
    },
    "an object of units": lambda x: write(x / "run.json", [json.dumps(UNITS)]),
    **{
        f"a model's {word} beside": lambda x, word=word: saved(
            np.savez, x / "run.npz", **{"time": T, "pos": Q, word: TAU, "tau_model": Q}
        )
        for word in ("tau", "torque")
    },
    "LeRobot": lerobot,
    "a file a quantity": lambda x: several(
        x,
        dataQ__txt="~t=; q={}",
        dataCur__txt="~t=; tau={}",
        dataQref__txt="~t=; q+1={}",
    ),
    "rate, a file a quantity": lambda x: several(
        x, dataQ__txt="~q={}", dataCur__txt="~tau={}", dataQref__txt="~q+1={}"
    ),
    "two files": lambda x: (
        f"{several(x, a__csv='t=t; q=q{}', b__csv='t=t; tau=tau{}')}/a.csv+b.csv"
    ),
    "rate, two files": lambda x: (
        f"{several(x, a__csv='q=q{}', b__csv='tau=tau{}')}/a.csv+b.csv"
    ),
    "two files of one head": lambda x: (
        f"{several(x, positions__csv='t=time; q=joint_{}', torques__csv='t=time; tau=joint_{}')}"
        "/positions.csv+torques.csv"
    ),
    "files of joints": lambda x: of_joints(x, "joint", 1, "t,q,tau"),
    "files of joints from 0": lambda x: of_joints(x, "joint_", 0, "time,pos,effort"),
    "files of axes": lambda x: of_joints(
        x, "axis", 1, "Time (s),Position (rad),Torque (Nm)"
    ),
    "files of an arm": lambda x: of_joints(x, "arm-J", 1, "timestamp,position,torque"),
}


@pytest.mark.parametrize("case", FORMS)
def test_the_same_motion_comes_out_of_every_form(case, tmp_path):
    rate = {"rate": RATE} if case.startswith("rate") else {}
    same(read(FORMS[case](tmp_path), **rate)[0])


def test_the_runs_of_a_data_set_of_lerobot_are_those_of_its_folder(tmp_path):
    run = lerobot(tmp_path)
    assert run_files(tmp_path) == run_files(tmp_path / "data") == [run]


REFUSED = {
    "an array without names": (
        lambda x: saved(np.save, x / "run.npy", TABLE),
        ["t, q and tau", "q3=#4,tau1=#5"],
    ),
    "without a clock": (
        lambda x: saved(np.save, x / "run.npy", BLOCKS),
        ["tau3=#9' --rate 100 "],
    ),
    "a table without a clock": (
        lambda x: several(x, a__csv="~q={}; dq={}; tau={}") / "a.csv",
        ["tau3=#9' --rate 100 "],
    ),
    "an object": (
        lambda x: saved(np.save, x / "run.npy", np.array({"q": Q}, object)),
        ["numpy.savez"],
    ),
    "two lengths": (
        lambda x: (
            f"{several(x, a__csv='q=q{}')}/a.csv+{write(x / 'b.csv', ['tau1', '1', '2'])}"
        ),
        ["b.csv has 2 rows, a.csv has 150", "column t"],
    ),
    "no partner": (
        lambda x: f"{several(x, a__csv='t=t; q=q{}')}/a.csv+none.csv",
        ["none.csv"],
    ),
    "raw data": (
        lambda x: several(x, curr_data__csv="q=Joint_{}") / "curr_data.csv",
        ["sdp-vs-penalty fetch tx40"],
    ),
    **{
        f"a line {line[:9]}": (
            lambda x, line=line: write(
                x / "run.jsonl", ['{"t": 0.0, "q": [1, 2], "tau": [1, 2]}', line]
            ),
            [],
        )
        for line in ("{", "[1, 2]", "[" * 100_000, '{"q": [1]}')
    },
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_form_that_cannot_be_read_is_refused(case, tmp_path):
    make, words = REFUSED[case]
    refusal(lambda: read(make(tmp_path)), *words)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("table", "writetable(log, 'run.csv')"),
        ("timetable", "writetable(timetable2table(log), 'run.csv')"),
        ("timeseries", "save its numbers as a matrix"),
    ],
)
def test_an_object_of_matlab_is_refused_by_its_class(kind, words, monkeypatch):
    from scipy.io.matlab import MatlabOpaque

    from sdp_vs_penalty.data.formats.matlab import numeric_variables

    names = [(field, "O") for field in ("s0", "s1", "s2", "arr")]
    log = MatlabOpaque(np.array([(b"log", b"MCOS", kind.encode(), None)], dtype=names))
    monkeypatch.setattr("scipy.io.loadmat", lambda *_, **__: {"None": log})
    said = f"log is a MATLAB {kind}, which only MATLAB reads"
    refusal(lambda: list(numeric_variables("run.mat")), said, words)


@pytest.mark.parametrize("name", [None, "stamp", "recorded", "shijian"])
@pytest.mark.parametrize("kind", ["dates", "zone", "durations", "texts", "seconds"])
def test_indices_and_stamps_of_parquet(kind, name, tmp_path):
    durations = pd.to_timedelta(np.round(T * 1e6).astype(int), unit="us")
    dates = pd.Timestamp("2024-05-01T12:00:00.000001") + durations
    index = {
        "dates": dates,
        "zone": dates.tz_localize("Europe/Berlin"),
        "durations": durations,
        "texts": pd.Index([x.isoformat() for x in dates]),
        "seconds": pd.Index(T),
    }[kind]
    frame = pd.DataFrame(TABLE[:, 1:], index.rename(name), HEAD[1:])
    path = saved(lambda x: frame.to_parquet(x), tmp_path / "run.parquet")
    same(read(path)[0])


def named_rows(folder, layout):
    """Rows that each name their joints, in an order of their own."""
    orders = [np.random.default_rng(k).permutation(3) for k in range(len(T))]
    rows = [
        {
            "name": [JOINTS[j] for j in x],
            "position": Q[k, x].tolist(),
            "effort": TAU[k, x].tolist(),
        }
        for k, x in enumerate(orders)
    ]
    if layout == "json":
        lines = [json.dumps({"time": t, **row}) for t, row in zip(T, rows, strict=True)]
        return write(folder / "run.jsonl", lines)
    if layout == "parquet":
        frame = pd.DataFrame({"time": T, **pd.DataFrame(rows)})
        return saved(lambda x: frame.to_parquet(x), folder / "run.parquet")
    fields = ("name", "position", "effort")
    if layout == "lists":
        lines = [
            ",".join([str(t), *(f'"{x[y]}"' for y in fields)])
            for t, x in zip(T, rows, strict=True)
        ]
        return write(folder / "run.csv", [",".join(["time", *fields]), *lines])
    head = [f"{x}[{k}]" for x in fields for k in range(3)]
    lines = [
        ",".join(map(str, [t, *x["name"], *x["position"], *x["effort"]]))
        for t, x in zip(T, rows, strict=True)
    ]
    return write(folder / "run.csv", [",".join(["time", *head]), *lines])


@pytest.mark.parametrize("layout", ["json", "lists", "columns", "parquet"])
def test_joints_may_change_their_order_from_row_to_row(layout, tmp_path):
    path = named_rows(tmp_path, layout)
    same(read(path)[0])
    if layout != "parquet":
        lines = path.read_text().split("\n")
        lines[40] = lines[40].replace(JOINTS[1], "finger_joint")
        path.write_text("\n".join(lines))
        refusal(lambda: read(path), " 41 names other joints than the first")


def test_what_is_as_written_is_not_told_by_velocities(tmp_path):
    """The command quotes what a shell would read."""
    path = log(tmp_path / "my $(run).csv", "q=q{}; dq=dq{}; tau=tau{}")
    said = refusal(lambda: read(path, as_written=True), "no column t", "--rate 100")
    (command,) = re.findall("`sdp-vs-penalty (.*?)`", said)
    assert shlex.split(command)[1] == str(path)


def test_columns_are_chosen_by_their_numbers_without_a_header(tmp_path):
    path = log(tmp_path / "run.csv", "t=; q={}; tau={}", head=[])
    refusal(lambda: read(path), "row 1 holds numbers instead of a header")
    same(
        convert(
            path, rename=dict(zip(HEAD, (f"#{k}" for k in range(1, 8)), strict=True))
        )
    )


@pytest.mark.parametrize("form", ["blocks", "our names"])
def test_of_a_joint_more_than_the_robot_has_a_command_takes_the_first(form, tmp_path):
    """A gripper that moves and has a torque, which no name tells."""
    blocks = {
        x: np.column_stack([y, np.sin(T)])
        for x, y in (("qpos", Q), ("qvel", DQ), ("effort", TAU))
    }
    path = tmp_path / "run.npz"
    np.savez(path, time=T, **blocks)
    if form == "our names":
        row = "t=t; q=q{}; ms=q4; tau=tau{}; ms=tau4"
        path = log(tmp_path / "run.csv", row)
    run, said = read(path)
    assert run.n == 4
    (command,) = re.findall(
        "where the last is a gripper's, convert it by `(.*?)`", said
    )
    assert run.unit_command == command
    words = shlex.split(command)
    same(convert(path, rename=pairs("--rename", words[words.index("--rename") + 1])))


def test_velocities_tell_an_order_before_an_arm_does(tmp_path):
    """Each order that the values allow is fitted in every unit."""
    noisy = DQ + np.random.default_rng(2).normal(0.0, 0.2, DQ.shape)
    columns = {f"#{k}": x for k, x in enumerate(np.hstack([TAU, Q, noisy]).T, 1)}
    first, second, *_ = layouts(columns, 3, t=T)
    assert [first.names["tau1"], first.names["q1"], first.names["dq1"]] == [
        *("#1", "#4", "#7")
    ]
    assert first.weight > CERTAIN * second.weight


def test_torn_rows_at_an_end_change_no_order():
    """A recorder that starts inside a packet writes fields that are no samples."""
    whole = np.column_stack([T + 3048.0, Q, DQ, TAU])
    torn = np.full((3, whole.shape[1]), 253.0)
    torn[:, 0] = -0.1231, 0.7932, 0.0
    torn[1, 1:] = 1e280
    orders = []
    for rows in ([whole], [whole[:1], torn, whole[1:]], [whole, torn]):
        table = np.vstack(rows)
        columns = {f"#{k}": x for k, x in enumerate(table.T, 1)}
        orders.append(layouts(columns, 3)[0].names)
    assert orders[0]["t"] == "#1"
    assert orders[1] == orders[2] == orders[0]


def test_without_a_robot_the_file_s_order_stays(tmp_path):
    path = log(tmp_path / "run.csv", "t=time; q={s}_position; tau={j}_effort")
    run, _ = read(path, None)
    np.testing.assert_allclose(run.tau, TAU[:, SORTED], atol=1e-9)
    run, _ = read(FORMS["names beside"](tmp_path), None)
    np.testing.assert_array_equal(run.q, Q[:, SORTED])


# -- several files ---------------------------------------------------------------------


@pytest.mark.parametrize("late", [-0.002, 0.001, 0.0025])
def test_positions_are_interpolated_to_the_torque_s_stamps(late, tmp_path):
    """A swing of 2 Hz is followed to a ten-thousandth, the torque is as it was."""
    folder = several(tmp_path, a__csv="t=t; q=q{}")
    rows = cells_of([T + late, *TAU.T])
    write(folder / "b.csv", ["t,tau1,tau2,tau3", *map(",".join, rows)])
    run, said = read(f"{folder}/a.csv+b.csv")
    inner = (run.t > T[1]) & (run.t < T[-2])
    expected = np.sin(2.0 * run.t[:, None] + [0.0, 1.0, 2.0])
    np.testing.assert_allclose(run.q[inner], expected[inner], atol=1e-4)
    first = np.searchsorted(T + late, run.t[0] - 1e-6)
    np.testing.assert_allclose(run.tau, TAU[first:][: run.samples], atol=1e-9)
    assert f"from samples {1e3 * abs(late):.3g} ms away" in said


def test_rows_without_a_partner_are_counted(tmp_path):
    folder = several(tmp_path, a__csv="t=t; q=q{}", b__csv="t=t; tau=tau{}")
    lines = (folder / "b.csv").read_text().splitlines()
    write(folder / "b.csv", [lines[0], *lines[21:]])
    run, said = read(f"{folder}/a.csv+b.csv")
    np.testing.assert_allclose([run.q, run.tau], [Q[20:], TAU[20:]], atol=1e-9)
    assert "20 rows without all channels" in said


def test_files_of_joints_with_stamps_of_their_own_are_one_run(tmp_path):
    run = load_measurements(of_joints(tmp_path, "joint", 1, "t,q,tau", late=0.0007))
    np.testing.assert_allclose(run.q, Q[: run.samples], atol=1e-3)


def test_ten_files_of_joints_come_in_the_order_of_their_numbers(tmp_path):
    for k in range(10):
        path = tmp_path / f"joint{k + 1}.csv"
        write(path, ["t,q,tau", *(f"{t},{k + t},{t}" for t in T)])
    np.testing.assert_allclose(read(tmp_path, None)[0].q[0], np.arange(10), atol=1e-9)


@pytest.mark.parametrize(
    "stems", [("joint1", "joint2"), ("position_test", "torque_test")]
)
def test_a_folder_of_runs_stays_a_folder_of_runs(stems, tmp_path):
    files = {
        f"{stem}__csv": row
        for stem, row in zip(stems, (OURS, "t=t; q+1=q{}; tau=tau{}"), strict=True)
    }
    assert len(load_measurements(several(tmp_path, **files)).runs()) == 2


# -- clocks, units, torques --------------------------------------------------------------


@pytest.mark.parametrize("kind", ["t", "ms"])
@pytest.mark.parametrize("form", ["csv", "jsonl"])
def test_libfranka_s_clock_is_judged_by_its_steps(kind, form, tmp_path):
    path = log(
        tmp_path / "run.csv", f"{kind}=time; q=q_{{z}}; dq=dq_{{z}}; tau=tau_J_{{z}}"
    )
    if form == "jsonl":
        path = json_lines(tmp_path, ("q", "tau_J"))
        samples = [json.loads(x) for x in path.read_text().splitlines()[:-1]]
        factor = 1e3 if kind == "ms" else 1.0
        write(path, [json.dumps({**x, "time": factor * x["time"]}) for x in samples])
    same(read(path)[0])


@pytest.mark.parametrize(
    ("stamps", "how", "unit"),
    [
        (0.001 * np.maximum(np.arange(120.0) - 80.0, 0.0), {}, "s"),
        (np.maximum(np.arange(120.0) - 80.0, 0.0), {}, "ms"),
        (0.2 * np.arange(100), {"rate": 5.0}, "s"),
        (np.zeros(50), {}, "ms"),
        (8e3 * np.arange(50), {"way": 4.0, "kind": "time"}, "us"),
        (4.0 * np.arange(50), {"way": 0.002, "kind": "time"}, "ms"),
        (3.5 * np.arange(50), {"way": 1.0, "kind": "time"}, "s"),
        (0.5 * np.arange(50), {"way": 0.005, "kind": "time"}, "s"),
    ],
)
def test_the_unit_of_a_clock(stamps, how, unit):
    """Stamps that repeat do not count; positions may be in thousandths."""
    assert unit_of_clock(stamps, **how).answer == unit


def test_degrees_that_show_late_are_degrees_in_every_row(tmp_path):
    lines = [f"{t},{60.0 * t},{t}" for t in T]
    run, _ = read(write(tmp_path / "run.csv", ["time,j1,torque1", *lines]), None)
    np.testing.assert_allclose(run.q[:, 0], np.radians(60.0 * T), atol=1e-8)


@pytest.mark.parametrize(
    "joints", [(*JOINTS, "gripper"), (*JOINTS, "right_1", "right_2", "head")]
)
def test_joints_of_the_robot_that_a_log_lacks_are_to_be_held(joints, tmp_path):
    row = "t=time; q={j}_pos; tau={j}_eff" + "; 0=gripper_pos" * (len(joints) == 4)
    held = ",".join(f"{name}=0" for name in joints[3:])
    said = refusal(
        lambda: read(log(tmp_path / "run.csv", row), joints), f"--hold {held}"
    )
    assert "in no column" in said


def test_a_gripper_s_silent_joint_is_left_out(tmp_path):
    row = "t=time; t=q0; q=q{}; dq=dq{}; 0=tau0; tau=tau{}"
    run, said = read(log(tmp_path / "run.csv", row))
    same(run)
    assert "joint 1 of the log has no torque in any row" in said


def test_a_torque_that_a_model_has_made_is_not_taken_beside_a_measured_one(tmp_path):
    """Its word is the better one, but it carries no noise; an empty cell says nothing."""
    smooth = 10.0 * np.sin(np.outer(T, [4.0, 5.0, 6.0]))
    measured = smooth + 0.05 * TAU
    columns = [T, *Q.T, *smooth.T, *(1e3 * measured).T, *(measured / 9.13).T]
    words = ("pos{}", "Torque{}", "TorqueSm{} [mNm]", "Cur{}")
    names = ["time", *(word.format(k) for word in words for k in (1, 2, 3))]
    lines = [",".join(names), *map(",".join, cells_of(columns))]
    path = write(tmp_path / "run.csv", without(lines, 30, 8))
    run, said = read(path, None)
    np.testing.assert_allclose(run.tau, np.delete(measured, 30, axis=0), atol=1e-7)
    assert "Torque1 to Torque3 (a model's: smooth)" in said
    assert "tau1..tau3 = TorqueSm1 [mNm] .. TorqueSm3 [mNm]" in said
    assert "tau in mnm" in said


def test_a_rate_is_asked_with_the_columns_where_there_is_no_clock(tmp_path):
    path = log(tmp_path / "run.csv", "q=aa_{}; tau=tau_{}")
    said = refusal(lambda: read(path), "name its clock with --rename t=NAME")
    words = shlex.split(said.split("`")[1].replace("HZ", "100"))
    out = tmp_path / "out.csv"
    assert run_cli(*words[1:-1], out) == 0
    same(read(out)[0])


def test_velocities_tell_the_rate_across_lost_rows(tmp_path):
    path = log(tmp_path / "run.csv", "deg=q_deg_{}; dq=dq_{}; tau=tau_{}")
    lines = path.read_text().splitlines()
    write(path, np.delete(lines, [20, 21, 60]).tolist())
    run, said = read(path)
    np.testing.assert_allclose(run.t, np.arange(147) / 100.0)
    assert "t = rows at 100 Hz, at which dq is the derivative of q" in said
    assert "--rate 100 --out run_converted.csv" in said


def test_a_column_is_one_channel(tmp_path):
    path, pairs = log(tmp_path / "run.csv", OURS), {"t": "#5", "tau1": "#5"}
    refusal(lambda: read(path, rename=pairs), "column tau1 is taken as t and tau1")


@pytest.mark.parametrize("cut", [360.0, 180.0])
def test_degrees_that_are_cut_at_a_full_turn_go_on(cut, tmp_path):
    """Also where a command says the unit."""
    turning = np.linspace(-9.0, 14.0, len(T))
    wrapped = (np.degrees(turning) + 360.0 - cut) % 360.0 - (360.0 - cut)
    rows = [f"{t},{x},{t}" for t, x in zip(T, wrapped, strict=True)]
    for head in ("time,q_deg,tau", "t,q1,tau1"):
        path = write(tmp_path / "run.csv", [head, *rows])
        with pytest.warns(Remark, match="cut at a full turn in"):
            run = read_run(path) if "deg" in head else convert(path, scale={"q": "deg"})
        np.testing.assert_allclose(np.diff(run.q[:, 0]), np.diff(turning))


def test_the_printed_unit_is_one_of_the_quantity():
    pairs = {
        ("tau", 1e-3): "mnm",
        ("t", 1e-3): "ms",
        ("q", 1e-3): "mrad",
        ("tau", 0.3): None,
    }
    assert {x: unit_of_factor(x[1], x[0]) for x in pairs} == pairs


# -- what is shown ---------------------------------------------------------------------


def test_a_guess_shows_the_first_rows_and_is_the_table_of_columns(tmp_path):
    path = log(tmp_path / "run.csv", "ms=time; deg=q_{z}_deg; tau=tau_{z}; text=note")
    with pytest.warns(ColumnsRemark) as heard:
        run = read_run(path, 3, JOINTS)
    (remark,) = [w.message for w in heard if isinstance(w.message, ColumnsRemark)]
    name, *values, theirs = remark.rows[1].split()
    assert (name, theirs) == ("q1", "q_0_deg")
    np.testing.assert_allclose(
        [float(x) for x in values], run.q[:5, 0], rtol=1e-4, atol=1e-9
    )
    report = describe_columns(path, JOINTS)
    assert report.sentence == str(remark)
    assert [row.meaning for row in report.rows] == [*HEAD, ""]
    assert [row.unit for row in report.rows[:4]] == ["ms", "deg", "deg", "deg"]
    assert report.rows[-1].kind == "text"


def test_what_is_missing_is_in_the_table_of_columns(tmp_path):
    path = log(tmp_path / "run.csv", "q=q_{}; tau=tau_{}")
    assert describe_columns(path).missing == ("t",)


def test_what_the_check_repairs_is_refused_with_its_command(tmp_path, capsys):
    path = write(
        tmp_path / "run.csv",
        ["t,q1,q2,tau1,tau2", *(f"{t:.1f},{t},1,1,{t}" for t in T)],
    )
    words = ("identify", "two_link", "--data", path, "--out", tmp_path / "m.json")
    assert run_cli(*words) == 2
    fixed = f"check two_link --data {path} --fix {tmp_path / 'run_fixed.csv'}"
    assert fixed in capsys.readouterr().err


@pytest.mark.parametrize("case", ["a row a joint, turned", "a JSON line a number"])
def test_the_command_that_is_printed_reads_rows_of_joints(case, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (command,) = re.findall(
        "the same by `sdp-vs-penalty (.*?)`", read(FORMS[case](tmp_path))[1]
    )
    words = shlex.split(command)
    assert run_cli(*words) == 0
    same(load_measurements(words[-1]))
