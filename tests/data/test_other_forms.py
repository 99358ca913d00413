"""Forms of logs beside one plain table: packed, in other letters, a row a joint, several
files, arrays; read, or refused with what to do."""

import bz2
import gzip
import json
import lzma
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from recorded import refusal
from scipy.io import savemat

from sdp_vs_penalty.data import read_run, unit_of_clock
from sdp_vs_penalty.data.formats.text_file import PIECE
from sdp_vs_penalty.errors import ColumnsRemark, Remark

JOINTS = ("base_yaw", "elbow", "wrist")
T = np.arange(120) * 0.005
Q, DQ, TAU = np.round(np.random.default_rng(5).normal(size=(3, 120, 3)), 6)
HEAD = ["t", "q1", "q2", "q3", "tau1", "tau2", "tau3"]


def table(path: Path, head: Sequence[str] | None, *blocks: np.ndarray) -> Path:
    """A text table; its folder is made."""
    path.parent.mkdir(exist_ok=True)
    rows = np.column_stack(blocks)
    lines = [",".join(f"{x:.9g}" for x in row) for row in rows]
    path.write_text("\n".join([*([",".join(head)] if head else []), *lines]) + "\n")
    return path


def silently(path: Path | str, **options):
    with warnings.catch_warnings(action="ignore"):
        return read_run(path, None, options.pop("names", None), **options)


def remarks(path: Path | str, **options) -> str:
    with pytest.warns(Remark) as heard:
        read_run(path, None, options.pop("names", None), **options)
    return " ".join(str(w.message) for w in heard)


def require_the_run(run, atol: float = 1e-8) -> None:
    np.testing.assert_allclose(run.q, Q, atol=atol)
    np.testing.assert_allclose(run.tau, TAU, atol=atol)
    np.testing.assert_allclose(run.t, T, atol=1e-6)


@pytest.fixture
def plain(tmp_path) -> Path:
    return table(tmp_path / "run.csv", HEAD, T, Q, TAU)


@pytest.mark.parametrize(("suffix", "pack"), [("gz", gzip), ("bz2", bz2), ("xz", lzma)])
def test_packed_tables_are_read(suffix, pack, plain):
    path = plain.with_suffix(f".csv.{suffix}")
    path.write_bytes(pack.compress(plain.read_bytes()))
    require_the_run(silently(path))


def test_a_packed_table_that_ends_early_is_refused(plain):
    path = plain.with_suffix(".csv.gz")
    path.write_bytes(gzip.compress(plain.read_bytes())[:-200])
    refusal(lambda: silently(path), "ends early")


@pytest.mark.parametrize("pack", [gzip, bz2, lzma])
def test_a_packed_table_that_is_broken_is_refused(pack, plain):
    content = bytearray(pack.compress(plain.read_bytes()))
    content[len(content) // 2] ^= 0xFF
    plain.write_bytes(content)
    refusal(lambda: silently(plain))


@pytest.mark.parametrize("letters", ["utf-16", "cp1252", "utf-8-sig"])
def test_letters_of_other_programs_are_read(letters, tmp_path):
    names = ["t", *(f"q{k} [°]" for k in (1, 2, 3)), *HEAD[4:]]
    path = table(tmp_path / "run.csv", names, T, np.degrees(Q), TAU)
    path.write_text(path.read_text(), encoding=letters)
    require_the_run(silently(path))


def test_empty_rows_and_repeated_headers_are_left_out_and_counted(plain):
    lines = plain.read_text().splitlines()
    lines.insert(90, lines[0])
    lines[40:40] = ["", ""]
    plain.write_text("\n".join(lines))
    require_the_run(silently(plain))
    assert "2 empty rows and 1 repeated header left out" in remarks(plain)


def test_a_wrong_cell_is_named_by_its_own_row_behind_empty_ones(plain):
    lines = plain.read_text().splitlines()
    lines[60] = "x" + lines[60]
    lines.insert(30, "")
    plain.write_text("\n".join(lines))
    refusal(lambda: silently(plain), "row 62, column 1")


def test_a_wrong_cell_of_a_sparse_table_is_named_by_its_own_row(tmp_path):
    rows = ["t,q1,tau1,voltage"]
    for k, t in enumerate(T):
        rows += [f"{t},{Q[k, 0]},{TAU[k, 0]},", f"{t + 0.001},,,24.1"]
    rows[101] = rows[101].replace(str(Q[50, 0]), "oops")
    path = tmp_path / "run.csv"
    path.write_text("\n".join(rows))
    refusal(lambda: silently(path), "row 102, column 2", "'oops'")


ARRAYS = {"t": T, "q": Q, "tau": TAU}


def test_an_array_of_named_fields_is_read(tmp_path):
    kinds = [("t", float), ("q", float, (3,)), ("tau", float, (3,)), ("mode", "U4")]
    array = np.zeros(len(T), kinds)
    for name, block in ARRAYS.items():
        array[name] = block
    np.save(tmp_path / "run.npy", array)
    require_the_run(silently(tmp_path / "run.npy"))


@pytest.mark.parametrize("is_turned", [False, True])
def test_an_array_without_names_is_read_by_its_rate(is_turned, tmp_path):
    array = np.column_stack([Q, DQ, TAU])
    np.save(tmp_path / "run.npy", array.T if is_turned else array)
    require_the_run(silently(tmp_path / "run.npy", rate=200.0))


def test_an_array_without_names_is_refused_with_its_command(tmp_path):
    np.save(tmp_path / "run.npy", np.column_stack([T, Q, TAU]))
    said = refusal(lambda: silently(tmp_path / "run.npy", names=JOINTS), "t, q and tau")
    assert "q3=#4,tau1=#5" in said


@pytest.mark.parametrize("suffix", ["csv", "npy"])
def test_without_header_and_clock_the_rate_is_proposed(suffix, tmp_path):
    q = np.sin(np.outer(T, [9.0, 12.0, 15.0]))
    dq = np.cos(np.outer(T, [9.0, 12.0, 15.0])) * [9.0, 12.0, 15.0]
    path = table(tmp_path / "run.csv", None, q, dq, TAU)
    np.save(tmp_path / "run.npy", np.column_stack([q, dq, TAU]))
    refusal(lambda: silently(path.with_suffix(f".{suffix}")), "tau3=#9' --rate 200 ")


def test_an_array_of_objects_is_refused(tmp_path):
    np.save(tmp_path / "run.npy", np.array({"q": Q}, object))
    refusal(lambda: silently(tmp_path / "run.npy"), "numpy.savez")


def test_an_archive_of_a_table_and_its_names_is_read(tmp_path):
    values = np.column_stack([T, Q, TAU])
    np.savez(tmp_path / "run.npz", data=values, columns=np.array(HEAD))
    require_the_run(silently(tmp_path / "run.npz"))


def test_an_archive_with_texts_beside_its_arrays_is_read(tmp_path):
    np.savez(tmp_path / "run.npz", **ARRAYS, robot=np.array("arm"))
    require_the_run(silently(tmp_path / "run.npz"))


def test_structs_within_structs_are_read(tmp_path):
    joint = {"position": Q, "torque": TAU}
    savemat(tmp_path / "run.mat", {"log": {"time": T, "joint": joint}})
    require_the_run(silently(tmp_path / "run.mat"))


@pytest.mark.parametrize("n_joints", [1, 3])
def test_a_cell_a_sample_is_a_block(n_joints, tmp_path):
    cells = np.empty((2, len(T)), object)
    for k in range(len(T)):
        cells[:, k] = [x[k, :n_joints, None] for x in (Q, TAU)]
    savemat(tmp_path / "run.mat", {"t": T, "q": cells[0], "tau": cells[1]})
    run = silently(tmp_path / "run.mat")
    np.testing.assert_array_equal(run.q, Q[:, :n_joints])
    np.testing.assert_array_equal(run.tau, TAU[:, :n_joints])


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


def test_a_matrix_with_a_channel_a_row_is_read_by_its_rate(tmp_path):
    savemat(tmp_path / "run.mat", {"ans": np.column_stack([Q, DQ, TAU]).T})
    require_the_run(silently(tmp_path / "run.mat", rate=200.0))


def test_two_files_are_joined_by_their_stamps(tmp_path):
    first = table(tmp_path / "joints.csv", HEAD[:4], T, Q)
    second = table(tmp_path / "efforts.csv", ["t", *HEAD[4:]], T + 1e-10, TAU)
    require_the_run(silently(f"{first}+{second}"), atol=1e-6)


@pytest.mark.parametrize("late", [-0.002, 0.001, 0.0025])
def test_positions_are_interpolated_to_the_torque_s_stamps(late, tmp_path):
    """A swing of 2 Hz is followed to a ten-thousandth, the torque is as it was."""
    q = np.sin(np.outer(T, 4.0 * np.pi * np.ones(3)))
    first = table(tmp_path / "joints.csv", HEAD[:4], T, q)
    second = table(tmp_path / "efforts.csv", ["t", *HEAD[4:]], T + late, TAU)
    run = silently(f"{first}+{second}")
    inner = (run.t > T[1]) & (run.t < T[-2])
    expected = np.sin(4.0 * np.pi * run.t)[:, None]
    np.testing.assert_allclose(
        run.q[inner], np.repeat(expected, 3, 1)[inner], atol=1e-4
    )
    first_row = np.searchsorted(T + late, run.t[0] - 1e-6)
    np.testing.assert_array_equal(run.tau, TAU[first_row:][: run.samples])
    said = f"from samples {1e3 * abs(late):.3g} ms away"
    assert said in remarks(f"{first}+{second}")


def test_rows_without_a_partner_are_counted(tmp_path):
    first = table(tmp_path / "joints.csv", HEAD[:4], T, Q)
    second = table(tmp_path / "efforts.csv", ["t", *HEAD[4:]], T[20:], TAU[20:])
    run = silently(f"{first}+{second}")
    np.testing.assert_allclose(run.q, Q[20:])
    np.testing.assert_allclose(run.tau, TAU[20:])
    assert "20 rows without all channels" in remarks(f"{first}+{second}")


def test_columns_of_the_same_name_are_told_apart_by_their_files(tmp_path):
    names = ["time", "joint_1", "joint_2", "joint_3"]
    first = table(tmp_path / "positions.csv", names, T, Q)
    second = table(tmp_path / "torques.csv", names, T, TAU)
    require_the_run(silently(f"{first}+{second}"))
    assert "positions/joint_*" in remarks(f"{first}+{second}")


def test_files_without_clocks_are_joined_row_by_row(tmp_path):
    first = table(tmp_path / "pos.csv", HEAD[1:4], Q)
    table(tmp_path / "tau.csv", HEAD[4:], TAU)
    require_the_run(silently(f"{first}+tau.csv", rate=200.0))


def test_files_without_clocks_have_to_be_as_long(tmp_path):
    first = table(tmp_path / "pos.csv", HEAD[1:4], Q)
    table(tmp_path / "tau.csv", HEAD[4:], TAU[1:])
    words = ("tau.csv has 119 rows, pos.csv has 120", "column t")
    refusal(lambda: silently(f"{first}+tau.csv", rate=200.0), *words)


def test_a_missing_partner_is_named(tmp_path):
    first = table(tmp_path / "pos.csv", HEAD[:4], T, Q)
    refusal(lambda: silently(f"{first}+{tmp_path}/none.csv"), "none.csv")


def test_a_file_without_torque_is_refused_with_the_way_to_join_one(tmp_path):
    path = table(tmp_path / "pos.csv", HEAD[:4], T, Q)
    refusal(lambda: silently(path), "no column tau", f"{path}+TORQUES.csv")


@pytest.mark.parametrize("has_clock", [False, True])
def test_a_folder_with_a_file_a_quantity_is_one_run(has_clock, tmp_path):
    """Without a header; a target is none of the quantities."""
    clock = [T] if has_clock else []
    for stem, block in {"dataQ": Q, "dataCur": TAU, "dataQref": Q + 1.0}.items():
        table(tmp_path / "log" / f"{stem}.txt", None, *clock, block)
    run = silently(tmp_path / "log", rate=None if has_clock else 200.0)
    require_the_run(run)


def test_a_folder_with_a_file_a_joint_and_quantity_is_one_run(tmp_path):
    for k in range(3):
        table(tmp_path / "log" / f"out_theta{k + 1}.txt", None, Q[:, k])
        table(tmp_path / "log" / f"out_torque{k + 1}.txt", None, TAU[:, k])
    table(tmp_path / "log" / "out_time.txt", None, T)
    require_the_run(silently(tmp_path / "log"))


def test_a_folder_of_runs_stays_a_folder_of_runs(tmp_path):
    from sdp_vs_penalty import load_measurements

    for stem in ("position_test", "torque_test"):
        k = len(stem)
        table(tmp_path / "log" / f"{stem}.csv", HEAD, T, Q + k, TAU)
    assert len(load_measurements(tmp_path / "log").runs()) == 2


def long_rows(names: Sequence[str], is_sorted: bool) -> list[str]:
    """A row for each joint and instant."""
    rows = [
        (k, j, f"{t},{name},{Q[k, j]},{TAU[k, j]}")
        for k, t in enumerate(T)
        for j, name in enumerate(names)
    ]
    if is_sorted:
        rows.sort(key=lambda row: (row[1], row[0]))
    return [text for _, _, text in rows]


@pytest.mark.parametrize("names", [JOINTS, ("0", "1", "2"), ("1", "2", "3")])
@pytest.mark.parametrize("is_sorted", [False, True])
def test_a_row_for_each_joint_is_read(names, is_sorted, tmp_path):
    rows = ["time,joint,position,effort", *long_rows(names, is_sorted)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(rows))
    require_the_run(silently(path, names=JOINTS))


def test_joints_of_rows_come_in_the_robot_s_order(tmp_path):
    turned = [2, 0, 1]
    rows = ["time,name,position,effort"]
    for k, t in enumerate(T):
        rows += [f"{t},{JOINTS[j]},{Q[k, j]},{TAU[k, j]}" for j in turned]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(rows))
    require_the_run(silently(path, names=JOINTS))


@pytest.mark.parametrize("has_joints", [False, True])
def test_a_row_for_each_channel_is_read(has_joints, tmp_path):
    """As pandas melts a table, and as time-series databases export one."""
    rows = ["time,joint,field,value" if has_joints else "time,variable,value"]
    for k, t in enumerate(T):
        for j, name in enumerate(JOINTS):
            for field, block in {"position": Q, "effort": TAU}.items():
                label = f"{name},{field}" if has_joints else f"{name}_{field}"
                rows.append(f"{t},{label},{block[k, j]}")
    path = tmp_path / "run.csv"
    path.write_text("\n".join(rows))
    require_the_run(silently(path, names=JOINTS))


THOUSANDS = {"German": ";", "English": "\t"}


@pytest.mark.parametrize("kind", THOUSANDS)
def test_separators_of_thousands_are_no_decimal_marks(kind, tmp_path):
    columns = np.column_stack([1e3 * T + 5000.0, Q, 1e4 * TAU])
    rows = [[f"{x:,.6f}" for x in row] for row in columns]
    if kind == "German":
        rows = [[x.translate(str.maketrans(",.", ".,")) for x in row] for row in rows]
    mark = THOUSANDS[kind]
    path = tmp_path / "run.csv"
    head = mark.join(["Zeit [ms]", *HEAD[1:]])
    path.write_text("\n".join([head, *(mark.join(row) for row in rows)]))
    run = silently(path)
    np.testing.assert_allclose(run.tau, 1e4 * TAU, atol=1e-5)
    np.testing.assert_allclose(run.t, T + 5.0, atol=1e-8)


def test_units_behind_the_numbers_of_cells_are_taken(tmp_path):
    rows = [",".join(HEAD)]
    for k, t in enumerate(T):
        angles = [f"{x:.9f} deg" for x in np.degrees(Q[k])]
        rows.append(",".join([f"{1e3 * t:.6f} ms", *angles, *map(str, TAU[k])]))
    path = tmp_path / "run.csv"
    path.write_text("\n".join(rows))
    require_the_run(silently(path))


def test_names_of_two_rows_are_put_together(tmp_path):
    path = table(tmp_path / "run.csv", ["t", *["q"] * 3, *["tau"] * 3], T, Q, TAU)
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, ",0,1,2,0,1,2", *rows]))
    require_the_run(silently(path))


BY_UNIT = [
    ("J{}(deg)", "J{}(Nm)"),
    ("A{} [°]", "A{} [N m]"),
    ("feedback_joint_{}_deg", "motor_{} (N.m)"),
]


@pytest.mark.parametrize(("q", "tau"), BY_UNIT)
def test_joints_with_a_unit_are_known_by_it(q, tau, tmp_path):
    names = [pattern.format(k) for pattern in (q, tau) for k in (1, 2, 3)]
    path = table(tmp_path / "run.csv", ["time", *names], T, np.degrees(Q), TAU)
    require_the_run(silently(path))


def test_joints_alone_are_not_guessed_but_proposed(tmp_path):
    names = [f"{letter}{k}" for letter in "JT" for k in (1, 2, 3)]
    path = table(tmp_path / "run.csv", ["time", *names], T, Q, TAU)
    said = refusal(lambda: silently(path), "no column t or q or tau")
    assert "--rename 't=time,q*=J*,tau*=T*'" in said


def test_a_proposal_keeps_the_units_of_the_names(tmp_path):
    names = ["stamp (ms)", *(f"Q{k}" for k in (1, 2, 3)), *(f"M{k}" for k in (1, 2, 3))]
    path = table(tmp_path / "run.csv", names, 1e3 * T, Q, TAU)
    refusal(lambda: silently(path), "tau*=M*", "--scale t=ms")


@pytest.mark.parametrize("unit", ["[%]", "percent", "permil"])
def test_torques_in_per_cent_are_said(unit, tmp_path):
    names = [f"torque_{k} {unit}" for k in (1, 2, 3)]
    path = table(tmp_path / "run.csv", [*HEAD[:4], *names], T, Q, TAU)
    assert "of a rating that the file does not say" in remarks(path)


def test_a_unit_that_nobody_knows_is_said(tmp_path):
    names = [f"torque_{k} [st-furlong]" for k in (1, 2, 3)]
    path = table(tmp_path / "run.csv", [*HEAD[:4], *names], T, Q, TAU)
    assert "the unit 'st-furlong' of tau is not known" in remarks(path)


def test_joints_in_brackets_are_no_units(tmp_path):
    names = [f"{x}[{joint}]" for x in ("position", "effort") for joint in JOINTS]
    path = table(tmp_path / "run.csv", ["time", *names], T, Q, TAU)
    assert "is not known" not in remarks(path, names=JOINTS)


@pytest.mark.parametrize("joints", ["ABC", ("base", "shoulder", "elbow")])
def test_letters_and_words_tell_joints_apart(joints, tmp_path):
    names = [f"{joint} {x}" for x in ("angle", "torque") for joint in joints]
    path = table(tmp_path / "run.csv", ["time", *names], T, Q, TAU)
    require_the_run(silently(path, names=JOINTS))
    require_the_run(silently(path))


def test_two_encoders_of_each_joint_are_not_guessed(tmp_path):
    patterns = ("primary_pos_{}", "secondary_pos_{}", "torque_{}")
    names = [pattern.format(k) for pattern in patterns for k in (1, 2, 3)]
    path = table(tmp_path / "run.csv", ["time", *names], T, 50.0 * Q, Q, TAU)
    refusal(
        lambda: silently(path), "primary_pos_1 to primary_pos_3 or secondary_pos_1 to"
    )


@pytest.mark.parametrize("step", [0.001, 1.0])
def test_libfranka_s_clock_is_judged_by_its_steps(step, tmp_path):
    names = [f"{x}_{k}" for x in ("q", "dq", "tau_J") for k in range(3)]
    clock = step * np.arange(len(T))
    path = table(tmp_path / "run.csv", ["time", *names], clock, Q, DQ, TAU)
    np.testing.assert_allclose(np.diff(silently(path).t), 0.001, atol=1e-9)


@pytest.mark.parametrize(("step", "unit"), [(0.001, "s"), (1.0, "ms")])
def test_stamps_that_repeat_do_not_count_for_the_unit_of_a_clock(step, unit):
    rows = np.arange(120.0)
    assert unit_of_clock(step * np.maximum(rows - 80.0, 0.0)).answer == unit


@pytest.mark.parametrize("step", [0.001, 1.0])
def test_libfranka_s_json_has_the_clock_of_its_steps(step, tmp_path):
    path = tmp_path / "run.jsonl"
    rows = [
        {"q": q.tolist(), "dq": dq.tolist(), "tau_J": tau.tolist(), "time": step * k}
        for k, (q, dq, tau) in enumerate(zip(Q, DQ, TAU, strict=True))
    ]
    path.write_text("\n".join(map(json.dumps, rows)))
    np.testing.assert_allclose(np.diff(silently(path).t), 0.001, atol=1e-9)


def test_velocities_tell_the_unit_of_a_slow_clock():
    assert unit_of_clock(0.2 * np.arange(100), rate=5.0).answer == "s"


def test_a_clock_that_stands_still_counts_milliseconds():
    assert unit_of_clock(np.zeros(50)).answer == "ms"


def test_degrees_that_show_late_are_degrees_in_every_row(tmp_path):
    q = np.linspace(0.0, 90.0, 120)[:, None]
    path = table(tmp_path / "run.csv", ["time", "j1", "torque1"], T, q, TAU[:, :1])
    np.testing.assert_allclose(silently(path).q, np.radians(q), atol=1e-8)


def test_a_joint_that_is_named_without_torque_is_missing(tmp_path):
    names = [f"{joint}_pos" for joint in (*JOINTS, "gripper")]
    names += [f"{joint}_eff" for joint in JOINTS]
    path = table(tmp_path / "run.csv", ["time", *names], T, Q, 0.0 * T, TAU)
    said = refusal(lambda: silently(path, names=(*JOINTS, "gripper")), "--hold")
    assert "gripper is in no column" in said


def test_the_log_of_one_arm_of_several_says_how_to_hold_the_others(tmp_path):
    """Three joints of seven are called by their names: the others are held."""
    names = [f"{kind}.{joint}" for kind in ("position", "effort") for joint in JOINTS]
    path = table(tmp_path / "run.csv", ["time", *names], T, Q, TAU)
    others = ("right_yaw", "right_elbow", "right_wrist", "head")
    held = "--hold right_yaw=0,right_elbow=0,right_wrist=0,head=0"
    refusal(lambda: silently(path, names=(*JOINTS, *others)), held)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"header:\n  stamp:\n    sec: 1\n", "ros2 topic echo --csv"),
        (b"<Rob><AIPos A1='1'/></Rob>\n<Rob/>\n", "XML text"),
        (b'{"t": 0.0, "q": [1, 2]}\n{"t": 0.1}\n', "no column q or tau"),
        (b"PK\x03\x04" + bytes(100), "Excel"),
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "HDF5"),
        (b"\x80\x04\x95" + bytes(100), "pickle"),
    ],
)
def test_what_is_no_table_is_called_by_its_name(content, words, tmp_path):
    path = tmp_path / "run.csv"
    path.write_bytes(content)
    refusal(lambda: silently(path), words)


def test_other_words_for_the_same(tmp_path):
    languages = {
        "temps": ("position_{}", "couple_{}"),
        "tiempo": ("posición_{}", "par_{}"),
        "Zeit": ("Istposition A{}", "Istmoment A{}"),
        "时间": ("位置{}", "力矩{}"),
        "時間": ("関節角{}", "トルク{}"),
    }
    for clock, patterns in languages.items():
        names = [pattern.format(k) for pattern in patterns for k in (1, 2, 3)]
        path = table(tmp_path / "run.csv", [clock, *names], T, Q, TAU)
        require_the_run(silently(path))


def test_what_was_taken_is_said_with_the_rate(tmp_path):
    names = [f"{x}_{k}" for x in ("pos", "trq") for k in range(3)]
    path = table(tmp_path / "run.csv", names, Q, TAU)
    with pytest.warns(ColumnsRemark, match="--rate 200 --out run_converted.csv"):
        read_run(path, None, None, rate=200.0)


def test_json_lines_are_read(tmp_path):
    lines = [
        json.dumps({"header": {"t": t}, "position": list(q), "effort": list(tau)})
        for t, q, tau in zip(T, Q, TAU, strict=True)
    ]
    path = tmp_path / "run.jsonl"
    path.write_text("\n".join([*lines, ""]))
    require_the_run(silently(path))


@pytest.mark.parametrize("name", ["run.json", "run.txt"])
def test_json_on_one_long_line_is_read(name, tmp_path):
    channels = {"t": T.tolist(), "position": Q.tolist(), "effort": TAU.tolist()}
    text = json.dumps(channels)
    path = tmp_path / name
    path.write_text(text[0] + " " * (2 * PIECE) + text[1:])
    require_the_run(silently(path))


@pytest.mark.parametrize("line", ["{", "[1, 2]", "[" * 100_000, '{"q": [1]}'])
def test_a_broken_json_line_is_refused(line, tmp_path):
    path = tmp_path / "run.jsonl"
    path.write_text(f'{{"t": 0.0, "q": [1, 2], "tau": [1, 2]}}\n{line}\n')
    refusal(lambda: silently(path))


@pytest.mark.parametrize(
    ("q", "tau"),
    [
        ("j{}", "trq{}"),  # Staubli
        ("AxisAct_A{}", "TorqueAct_A{}"),  # KUKA
        ("robax_{}", "torque_{}"),  # ABB
    ],
)
def test_joints_alone_beside_torques_are_positions(q, tau, tmp_path):
    """Controllers log them in degrees; what reaches no two turns is in radians."""
    names = [pattern.format(k) for pattern in (q, tau) for k in (1, 2, 3)]
    degrees = table(tmp_path / "deg.csv", ["time", *names], T, np.degrees(Q), TAU)
    assert "q in deg, it reaches" in remarks(degrees)
    require_the_run(silently(degrees))
    radians = table(tmp_path / "rad.csv", ["time", *names], T, Q, TAU)
    assert "q in rad, it reaches" in remarks(radians)
    require_the_run(silently(radians))


def test_joints_alone_are_no_positions_beside_positions(tmp_path):
    names = [f"{word}{k}" for word in ("j", "position", "trq") for k in (1, 2, 3)]
    path = table(tmp_path / "run.csv", ["time", *names], T, DQ, Q, TAU)
    require_the_run(silently(path))


@pytest.mark.parametrize("mark", ["^", ":"])
def test_tables_with_rare_separators_are_read(mark, plain):
    plain.write_text(plain.read_text().replace(",", mark))
    require_the_run(silently(plain))


@pytest.mark.parametrize("axis", [1, 2])
def test_axes_of_one_entry_are_left_out(axis, tmp_path):
    path = tmp_path / "run.npz"
    q, tau = (np.expand_dims(x, axis) for x in (Q, TAU))
    np.savez(path, t=T, q=q, tau=tau)
    require_the_run(silently(path))


def test_a_torque_that_a_model_has_made_is_not_taken_beside_a_measured_one(tmp_path):
    """Its word is the better one, but it carries no noise; an empty cell says nothing."""
    smooth = 10.0 * np.sin(np.outer(T, [4.0, 5.0, 6.0]))
    measured = smooth + 0.05 * TAU
    measured[30, 1] = np.nan
    words = ("pos{}", "Torque{}", "TorqueSm{} [mNm]", "Cur{}")
    names = [word.format(k) for word in words for k in (1, 2, 3)]
    path = tmp_path / "run.csv"
    columns = (
        T,
        np.sin(np.outer(T, [1, 2, 3])),
        smooth,
        1e3 * measured,
        measured / 9.13,
    )
    table(path, ["time", *names], *columns)
    path.write_text(path.read_text().replace("nan", ""))
    run = silently(path)
    np.testing.assert_allclose(run.tau, np.delete(measured, 30, axis=0), atol=1e-7)
    said = remarks(path)
    assert "Torque1 to Torque3 (a model's: smooth)" in said
    assert "tau1..tau3 = TorqueSm1 [mNm] .. TorqueSm3 [mNm]" in said
    assert "tau in mnm" in said


def test_a_rate_is_proposed_in_the_units_of_the_names_and_across_lost_rows(tmp_path):
    q, dq = np.sin(np.outer(T, [9, 12, 5.0])), np.cos(np.outer(T, [9, 12, 5.0]))
    names = [f"{x}_{k}" for x in ("q_deg", "dq", "tau") for k in (1, 2, 3)]
    rows = np.column_stack([np.degrees(q), dq * [9, 12, 5.0], TAU])
    path = table(tmp_path / "run.csv", names, np.delete(rows, [20, 21, 60], axis=0))
    refusal(lambda: silently(path), "no column t", "--rate 200 ")


def test_a_column_is_one_channel(plain):
    pairs = {"t": "#5", "tau1": "#5"}
    refusal(lambda: silently(plain, rename=pairs), "column tau1 is taken as t and tau1")


def test_metadata_of_lerobot_name_the_motors_of_a_block(tmp_path):
    from pyarrow import parquet
    from pyarrow import table as arrow_table

    order = [2, 0, 1]
    blocks = {"observation.state": Q[:, order], "observation.effort": TAU[:, order]}
    columns = {"timestamp": T, **{k: list(x) for k, x in blocks.items()}}
    names = [f"{JOINTS[k]}.pos" for k in order]
    feature = {"names": names, "unit": "rad"}
    (tmp_path / "meta").mkdir()
    info = json.dumps({"features": {"observation.state": feature}})
    (tmp_path / "meta" / "info.json").write_text(info)
    path = tmp_path / "data" / "chunk-000" / "file-000.parquet"
    path.parent.mkdir(parents=True)
    parquet.write_table(arrow_table(columns), path)
    require_the_run(silently(path, names=JOINTS))
