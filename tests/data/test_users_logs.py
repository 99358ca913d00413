"""Logs as people have them: names, units, clocks, headers and numbers in other forms than
RUN.csv's; the same three joints come out of all of them."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from recorded import refusal

from sdp_vs_penalty import load_measurements
from sdp_vs_penalty.data import Measurements, read_run
from sdp_vs_penalty.errors import Remark

JOINTS = ("turn", "shoulder", "elbow")
T = np.arange(60) * 0.01
Q = np.round(np.sin(np.outer(T + 0.1, [3.0, 5.0, 7.0])), 6)
TAU = np.round(30.0 * np.cos(np.outer(T, [4.0, 2.0, 6.0])), 6)
DEGREES = np.degrees(Q)
#: Joints in the order in which loggers sort them.
SORTED = [2, 1, 0]


def table(
    path: Path,
    heads: Sequence[str],
    *columns: np.ndarray,
    mark: str = ",",
    encoding: str = "utf-8",
) -> Path:
    """A text table of numbers or texts; ``heads`` are the lines above it."""
    cells = np.column_stack([np.asarray(c).astype("U60") for c in columns])
    lines = [*heads, *(mark.join(row) for row in cells)]
    path.write_text("\n".join(lines) + "\n", encoding=encoding)
    return path


def names_of(*patterns: str, joints: Sequence[object] = (1, 2, 3)) -> str:
    """Names of columns, a pattern after the other."""
    return ",".join(p.format(joint) for p in patterns for joint in joints)


def read(
    path: Path | str, joints: Sequence[str] | None = JOINTS
) -> tuple[Measurements, str]:
    """A file's run, and what is said of it."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always", Remark)
        run = read_run(path, None, joints)
    return run, " ".join(str(w.message) for w in heard)


def require_the_run(run: Measurements, atol: float = 1e-7) -> None:
    np.testing.assert_allclose(run.q, Q, atol=atol)
    np.testing.assert_allclose(run.tau, TAU, atol=100.0 * atol)
    np.testing.assert_allclose(run.t - run.t[0], T, atol=2e-6)


@pytest.mark.parametrize(
    ("robot", "log"),
    [
        ("{}", "{}_joint"),
        ("{}_joint", "{}"),
        ("arm_{}_joint", "{}"),
        ("l_{}", "left_{}"),
        ("ur_{}_joint", "robot1_{}_motor"),
        ("{}", "{}"),
        ("{}", "LEFT-{}"),
    ],
)
@pytest.mark.parametrize("pattern", ["/joint_states/{}/{}", "{}_{}", "{}.{}"])
def test_joints_with_other_words_around_their_names_are_matched(
    pattern, robot, log, tmp_path
):
    joints = [log.format(JOINTS[k].capitalize()) for k in SORTED]
    heads = [pattern.format(j, x) for x in ("position", "effort") for j in joints]
    columns = (T, Q[:, SORTED], TAU[:, SORTED])
    path = table(tmp_path / "run.csv", [",".join(["__time", *heads])], *columns)
    require_the_run(read(path, [robot.format(j) for j in JOINTS])[0])


def test_joints_with_numbers_are_matched_by_these(tmp_path):
    heads = [
        f"/joint_states/a{k}/{x}" for x in ("position", "effort") for k in (3, 1, 2)
    ]
    columns = (T, Q[:, [2, 0, 1]], TAU[:, [2, 0, 1]])
    path = table(tmp_path / "run.csv", [",".join(["__time", *heads])], *columns)
    require_the_run(read(path, ["joint_1", "joint_2", "joint_3"])[0])


def test_joints_of_other_names_stay_in_the_file_s_order_and_this_is_said(tmp_path):
    heads = "time," + names_of(
        "{}_position", "{}_effort", joints=("hip", "knee", "toe")
    )
    path = table(tmp_path / "run.csv", [heads], T, Q, TAU)
    run, said = read(path)
    require_the_run(run)
    assert "joints hip, knee, toe in the file's order" in said


@pytest.mark.parametrize(
    "words",
    [
        ("Zeit [s]", "Winkel{} [Grad]", "Moment{} [Nm]"),
        ("temps (s)", "angle{} (degrés)", "couple{} (N.m)"),
        ("tiempo (s)", "posición {} (grados)", "par {} (N·m)"),
        ("tempo (s)", "posizione {} (gradi)", "coppia {} (Nm)"),
        ("tempo (s)", "posição {} (graus)", "torque {} (Nm)"),
        ("tijd", "positie{} (graden)", "koppel{}"),
        ("czas", "pozycja{} [stopnie]", "moment{}"),
        ("Время (с)", "Угол {} (град)", "Момент {} (Н·м)"),  # noqa: RUF001
        ("时间(s)", "关节{}角度(度)", "关节{}力矩(Nm)"),
        ("时间戳(秒)", "关节位置{}(°)", "关节扭矩{}"),
        ("時刻[s]", "関節角度{}[deg]", "関節トルク{}[Nm]"),
        ("시간(s)", "관절{} 각도(deg)", "관절{} 토크(Nm)"),
    ],
)
def test_other_languages(words, tmp_path):
    clock, angle, torque = words
    heads = [f"{clock},{names_of(angle, torque)}"]
    require_the_run(read(table(tmp_path / "run.csv", heads, T, DEGREES, TAU))[0])


@pytest.mark.parametrize("angle", ["角度{}", "关节角度{}", "関節角度{}", "각도{}"])
def test_the_word_for_an_angle_is_no_degree(angle, tmp_path):
    path = table(tmp_path / "run.csv", [f"t,{names_of(angle, 'tau{}')}"], T, Q, TAU)
    require_the_run(read(path)[0])


@pytest.mark.parametrize(
    ("first", "per_second", "unit"),
    [
        (45_413.5, 1.0 / 86_400.0, "day"),
        (739_373.5, 1.0 / 86_400.0, "day"),
        (2_460_432.0, 1.0 / 86_400.0, "day"),
        (133_590_384_000_000_000, 1e7, "100ns"),
        (638_500_000_000_000_000, 1e7, "100ns"),
        (1_714_560_000_000, 1e3, "ms"),
    ],
)
@pytest.mark.parametrize("mark", [",", ";"])
def test_clocks_that_count_from_a_date(first, per_second, unit, mark, tmp_path):
    is_whole = isinstance(first, int)
    count = [f"{first + (round(x) if is_whole else x):.10f}" for x in T * per_second]
    decimal = "," if mark == ";" else "."
    clock = [x.replace(".", decimal) for x in count]
    numbers = [[f"{x:.6f}".replace(".", decimal) for x in row] for row in np.c_[Q, TAU]]
    heads = ["Timestamp," + names_of("q_{}", "tau_{}")]
    heads = [x.replace(",", mark) for x in heads]
    path = table(tmp_path / "run.csv", heads, clock, numbers, mark=mark)
    run, said = read(path)
    np.testing.assert_allclose(run.q, Q, atol=1e-6)
    np.testing.assert_allclose(run.t - run.t[0], T, atol=1e-4)
    assert f"t in {unit}, for it counts since" in said


def test_seconds_since_a_machine_s_start_are_no_days(tmp_path):
    heads = ["time," + names_of("q_{}", "tau_{}")]
    path = table(tmp_path / "run.csv", heads, 45_413.5 + T, Q, TAU)
    require_the_run(read(path)[0])


CLOCK = [f"{58 + int(x):02d}.{round(1000 * (x % 1.0)):03d}" for x in T]


@pytest.mark.parametrize(
    "stamp",
    [
        "2024-05-01T12:00:{}+02",
        "2024-05-01T12:00:{} CEST",
        "2024-05-01 12:00:{} GMT",
        "2024-05-01T12:00:{}+02:00[Europe/Berlin]",
        "20240501T1200{}",
        "01-May-2024 12:00:{}",
        "Wed May 01 12:00:{} 2024",
        "2024/05/01/12:00:{}",
        "00:{}",
        "0 days 00:00:{}",
    ],
)
@pytest.mark.parametrize("name", ["Time", "datum", "datetime", "", "recorded"])
def test_stamps_in_words(stamp, name, tmp_path):
    heads = [f"{name},{names_of('q_{}', 'tau_{}')}"]
    path = table(tmp_path / "run.csv", heads, [stamp.format(x) for x in CLOCK], Q, TAU)
    require_the_run(read(path)[0])


@pytest.mark.parametrize("name", ["ms", "Millisecond", "msec"])
@pytest.mark.parametrize("date", [[], ["Date"]])
def test_stamps_of_whole_seconds_go_on_in_a_column(name, date, tmp_path):
    heads = [",".join([*date, "Time", name, names_of("q{}", "tau{}")])]
    whole = [f"12:00:{x[:2]}" for x in CLOCK]
    columns = [
        *[["2024-05-01"] * len(T)] * len(date),
        whole,
        [int(x[3:]) for x in CLOCK],
    ]
    require_the_run(read(table(tmp_path / "run.csv", heads, *columns, Q, TAU))[0])


@pytest.mark.parametrize(("unit", "seconds"), [("min", 60.0), ("h", 3600.0)])
def test_clocks_in_minutes_and_hours(unit, seconds, tmp_path):
    heads = [f"Time ({unit}),{names_of('q{}', 'tau{}')}"]
    require_the_run(read(table(tmp_path / "run.csv", heads, T / seconds, Q, TAU))[0])


def test_an_index_without_a_name_is_the_clock_where_it_rises_in_fractions(tmp_path):
    heads = ["," + names_of("q{}", "tau{}")]
    require_the_run(read(table(tmp_path / "run.csv", heads, T, Q, TAU))[0])
    path = table(tmp_path / "counted.csv", heads, np.arange(len(T)), Q, TAU)
    refusal(lambda: read(path), "no column t", "--rate")


@pytest.mark.parametrize("name", [None, "stamp", "recorded"])
@pytest.mark.parametrize("kind", ["dates", "zone", "durations", "texts", "seconds"])
def test_indices_and_stamps_of_parquet(kind, name, tmp_path):
    pandas = pytest.importorskip("pandas")
    columns = names_of("q{}", "tau{}").split(",")
    frame = pandas.DataFrame(np.c_[Q, TAU], columns=columns)
    durations = pandas.to_timedelta(np.round(T * 1e6).astype(int), unit="us")
    dates = pandas.Timestamp("2024-05-01T12:00:00.000001") + durations
    index = {
        "dates": dates,
        "zone": dates.tz_localize("Europe/Berlin"),
        "durations": durations,
        "texts": pandas.Index([x.isoformat() for x in dates]),
        "seconds": pandas.Index(T),
    }[kind]
    frame.index = index.rename(name)
    path = tmp_path / "run.parquet"
    frame.to_parquet(path)
    if (kind, name) == ("seconds", "recorded"):  # nothing says that it is a clock
        refusal(lambda: read(path), "no column t")
    else:
        require_the_run(read(path)[0])


@pytest.mark.parametrize(
    "heads",
    [
        ["s,deg,deg,deg,Nm,Nm,Nm", "t," + names_of("q{}", "tau{}")],
        ["t," + names_of("q{}", "tau{}"), ",deg,deg,deg,Nm,Nm,Nm"],
        ["time,position [deg],,,torque,,", ",1,2,3,1,2,3"],
        [",position,,,torque,,", "t [s],1 [deg],2 [deg],3 [deg],1,2,3"],
        ["Time,Position [deg],,,Torque [Nm],,", "[s],J1,J2,J3,J1,J2,J3"],
        [
            "Zeit,Achse 1,Achse 2,Achse 3,Achse 1,Achse 2,Achse 3",
            ",Position,Position,Position,Moment,Moment,Moment",
            "s,Grad,Grad,Grad,Nm,Nm,Nm",
        ],
        [
            ",Position,,,Torque,,",
            "Time,J1,J2,J3,J1,J2,J3",
            "[s],[deg],[deg],[deg],[Nm],[Nm],[Nm]",
        ],
        [
            "File version,1.0,,,,,",
            "Rate,100,Hz,,,,",
            "t," + names_of("q{}_deg", "tau{}"),
        ],
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-32"])
def test_headers_of_several_rows(heads, encoding, tmp_path):
    path = table(tmp_path / "run.csv", heads, T, DEGREES, TAU, encoding=encoding)
    require_the_run(read(path, None)[0])


def test_a_row_of_values_is_no_header(tmp_path):
    heads = ["t,state," + names_of("q{}", "tau{}"), "0,idle,0,0,0,0,0,0"]
    states = ["moving"] * len(T)
    path = table(tmp_path / "run.csv", heads, T + 0.01, states, Q, TAU)
    run, _ = read(path)
    assert run.q.shape == (len(T) + 1, 3)
    np.testing.assert_array_equal(run.q[0], np.zeros(3))


@pytest.mark.parametrize(
    "writing",
    [
        lambda x: f"{x:,.6f}".replace(",", " ").replace(".", ","),
        lambda x: f"{x:,.6f}".replace(",", "\u00a0").replace(".", ","),
        lambda x: f"{x:,.6f}".replace(",", "\u202f").replace(".", ","),
        lambda x: f"{x:,.6f}".replace(",", "'"),
        lambda x: f"{x:.6f}".replace("-", "\u2212"),
        lambda x: f"{x:.9E}".replace("E", "D"),
    ],
)
def test_numbers_as_people_write_them(writing, tmp_path):
    heads = ["t [ms];q1 [deg];q2 [deg];q3 [deg];tau1 [mNm];tau2 [mNm];tau3 [mNm]"]
    values = np.c_[1000.0 * T, DEGREES, 1000.0 * TAU]
    cells = [[writing(x) for x in row] for row in values]
    require_the_run(read(table(tmp_path / "run.csv", heads, cells, mark=";"))[0])


@pytest.mark.parametrize(
    ("encoding", "words"),
    [
        ("gbk", "时间,关节{}角度,关节{}力矩"),
        ("shift_jis", "時刻,関節角度{},関節トルク{}"),
        ("euc_kr", "시간,관절{}각도,관절{}토크"),
        ("cp1251", "Время,Угол{},Момент{}"),
    ],
)
def test_letters_of_other_scripts(encoding, words, tmp_path):
    clock, angle, torque = words.split(",")
    heads = [f"{clock},{names_of(angle, torque)}"]
    path = table(tmp_path / "run.csv", heads, T, Q, TAU, encoding=encoding)
    require_the_run(read(path)[0])


@pytest.mark.parametrize(
    "names",
    [
        ("motor_position_{}", "joint_position_{}", "joint_torque_{}"),
        ("motor_pos_{}", "link_pos_{}", "torque_{}"),
        ("pos_motor_{}", "pos_link_{}", "tau_{}"),
        ("q{}_motor", "q{}_link", "tau{}"),
        ("qm{}", "ql{}", "tau{}"),
        ("q_m_{}", "q_l_{}", "tau_{}"),
        ("theta_m_{}", "theta_l_{}", "tau_{}"),
        ("theta_m{}", "q_{}", "tau_{}"),
    ],
)
def test_links_come_before_motors(names, tmp_path):
    motor, link, torque = names
    heads = [f"time,{names_of(motor, link, torque)}"]
    path = table(tmp_path / "run.csv", heads, T, 50.0 * Q, Q, TAU)
    run, said = read(path)
    require_the_run(run)
    if not motor.startswith("theta_m{"):  # another word, which comes behind q
        first, last = motor.format(1), motor.format(3)
        assert f"the motors' ({first} to {last}) are not used" in said


def test_torques_of_links_come_before_those_of_motors(tmp_path):
    patterns = "theta_{}", "q_{}", "tau_m_{}", "tau_j_{}"
    heads = [f"time,{names_of(*patterns)}"]
    path = table(tmp_path / "run.csv", heads, T, 50.0 * Q, Q, 0.01 * TAU, TAU)
    require_the_run(read(path)[0])


def test_links_and_motors_of_named_joints(tmp_path):
    patterns = "{}_motor_position", "{}_position", "{}_effort"
    heads = [f"time,{names_of(*patterns, joints=JOINTS)}"]
    require_the_run(read(table(tmp_path / "run.csv", heads, T, 50.0 * Q, Q, TAU))[0])


def test_measured_positions_alone_are_no_motors(tmp_path):
    heads = [f"time,{names_of('q_m_{}', 'q_d_{}', 'tau_{}')}"]
    require_the_run(read(table(tmp_path / "run.csv", heads, T, Q, Q + 1.0, TAU))[0])


def test_torques_of_motors_are_said(tmp_path):
    heads = [f"time,{names_of('joint_position_{}', 'motor_torque_{}')}"]
    _, said = read(table(tmp_path / "run.csv", heads, T, Q, TAU))
    assert "tau are the motors' torques" in said


@pytest.mark.parametrize(
    ("stem", "first", "heads"),
    [
        ("joint", 1, "t,q,tau"),
        ("joint_", 0, "time,pos,effort"),
        ("axis", 1, "Time (s),Position (rad),Torque (Nm)"),
        ("arm-J", 1, "timestamp,position,torque"),
    ],
)
@pytest.mark.parametrize("late", [0.0, 0.0007])
def test_a_folder_with_a_file_a_joint_is_one_run(stem, first, heads, late, tmp_path):
    for k in range(3):
        path = tmp_path / f"{stem}{k + first}.csv"
        clock = T + k * late
        q = np.sin((clock + 0.1) * [3.0, 5.0, 7.0][k])
        tau = 30.0 * np.cos(clock * [4.0, 2.0, 6.0][k])
        table(path, [heads], clock, q, tau)
    for run in (read(tmp_path)[0], load_measurements(tmp_path)):
        require_the_run(run, atol=1e-3 if late else 1e-6)


def test_ten_files_of_joints_come_in_the_order_of_their_numbers(tmp_path):
    for k in range(10):
        path = tmp_path / f"joint{k + 1}.csv"
        table(path, ["t,q,tau"], T, Q[:, 0] + k, TAU[:, 0])
    run, _ = read(tmp_path, None)
    np.testing.assert_allclose(run.q[0] - Q[0, 0], np.arange(10), atol=1e-9)


def test_runs_in_which_one_joint_moves_stay_runs(tmp_path):
    for k in range(3):
        path = tmp_path / f"joint{k + 1}.csv"
        table(path, ["t," + names_of("q{}", "tau{}")], T, Q + k, TAU)
    assert len(load_measurements(tmp_path).runs()) == 3


@pytest.mark.parametrize(
    "names",
    [
        ("{}_pos", "{}_frc"),
        ("jointpos_{}", "jointactuatorfrc_{}"),
        ("{}_jointpos", "{}_actuatorfrc"),
    ],
)
def test_sensors_of_mujoco(names, tmp_path):
    heads = [f"time,{names_of(*names, joints=JOINTS)}"]
    require_the_run(read(table(tmp_path / "run.csv", heads, T, Q, TAU))[0])
