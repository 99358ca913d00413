"""Numbers a joint above a table, a rail's units, and several runs of one file."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from recorded import refusal

from sdp_vs_penalty.data.columns import Choice
from sdp_vs_penalty.data.files import load_measurements, read_run
from sdp_vs_penalty.data.hypotheses.by_arm import with_lengths
from sdp_vs_penalty.data.hypotheses.channels import Recognition
from sdp_vs_penalty.data.hypotheses.proposals import proposed
from sdp_vs_penalty.data.hypotheses.recognition import (
    columns_called,
    recognise,
    units_of_chosen,
)
from sdp_vs_penalty.data.hypotheses.renaming import convert_options
from sdp_vs_penalty.data.log import log_of_arrays
from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.data.reading import run_of
from sdp_vs_penalty.data.words.names import facts_of_heading, units_of_heading
from sdp_vs_penalty.errors import InputError, Remark

FACTS = [
    ("# rated torque [Nm]: 60 110", {"rated": [60.0, 110.0]}),
    ("# Nennmomente in Nm: 60,5; 110,0", {"rated": [60.5, 110.0]}),
    ("# Rated motor torque (Nm)\t60\t110", {"rated": [60.0, 110.0]}),
    ("# Rated torque (0x6076) [Nm]: A1=60 A2=110", {"rated": [60.0, 110.0]}),
    ("# torque constants incl. gear [Nm/A]: 14.2, 15.1", {"constant": [14.2, 15.1]}),
    ("Kt 110 mNm/A, gear ratio 101", {"constant": [0.11] * 2, "ratio": [101.0] * 2}),
    ("# gear_ratios = [101:1, 120:1]", {"ratio": [101.0, 120.0]}),
    ("# gear ratio 1:100", {"ratio": [100.0, 100.0]}),
    ("encoder: 4096 counts per revolution, zero at 2048", {"zero": [2048.0] * 2}),
    ("% Offset [counts] = 2048; 2100 (4096 ticks/rev)", {"zero": [2048.0, 2100.0]}),
    ("# home position: 2048 counts", {"zero": [2048.0] * 2}),
    ("# mid position of all joints is 2048", {"zero": [2048.0] * 2}),
    ("# position in ticks, 16384 ticks per turn, 8192 = 0 deg", {"zero": [8192.0] * 2}),
    ("# joint torque = current * k, k [Nm/A] = 6, 4", {"constant": [6.0, 4.0]}),
    ("# max torque [Nm]: 60, 110", {}),
    ("# gear ratios: 101, 120, 101", {}),
    ("# gear ratios: see sheet 3 of 7", {}),
]


@pytest.mark.parametrize(("line", "said"), FACTS)
def test_numbers_a_joint_are_read_off_a_heading(line, said):
    found = {x: numbers for x, (numbers, _) in facts_of_heading([line], 2).items()}
    assert found == {x: pytest.approx(y) for x, y in said.items()}


UNITS_ABOVE = {
    "# torque [mNm], time in ms": {"t": "ms", "tau": "mnm"},
    "# time: s; position: deg": {"t": "s", "q": "deg"},
    "# units: time s, position deg, torque Nm": {"t": "s", "q": "deg", "tau": "nm"},
    "# units: s deg deg/s Nm": {"t": "s", "q": "deg", "dq": "deg/s", "tau": "nm"},
    "# units: position mm, deg, torque N, Nm": {"q": "mm and deg", "tau": "n and nm"},
    "# load: 0.1 % of stall torque": {"tau": "0.1%"},
    "# Present_Current: 2.69 mA per unit": {"tau": "ma"},
    "# stall torque [Nm]: 3.15, 3.15": {},  # a number's unit is no channel's
    "# torque limit in Nm, torque in Nm: 3.15": {},
}


@pytest.mark.parametrize("line", UNITS_ABOVE)
def test_units_of_channels_are_read_off_a_heading(line):
    found = {x: unit for x, (unit, _) in units_of_heading([line]).items()}
    assert found == UNITS_ABOVE[line]


def test_units_of_lengths_and_angles_are_those_of_the_joints_kinds():
    columns = columns_called(["pos_1", "pos_2"])
    lines = ["# units: position mm, deg"]
    found = units_of_chosen(Recognition({"q1": "pos_1", "q2": "pos_2"}), columns, lines)
    joints = [SimpleNamespace(kind="prismatic"), SimpleNamespace(kind="revolute")]
    found = with_lengths(found, SimpleNamespace(n=2, joints=joints))
    assert found.factors("q", 2) == [1e-3, pytest.approx(np.pi / 180.0)]


def test_without_a_robot_two_units_of_a_heading_are_asked_for(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("# units: position mm, deg\nt,pos_1,tau_1\n0,1,2\n1,2,3\n")
    refusal(lambda: load_measurements(path), "q is in mm and deg", "--scale q=mm:deg")


def test_a_clock_under_our_name_has_the_unit_above_the_table():
    arrays = {x: np.arange(9.0) for x in ("t", "theta_1", "theta_2", "T_1", "T_2")}
    log = log_of_arrays(Path("a.csv"), arrays, heading=["# units: time ms"])
    assert proposed(log, ["q", "tau"], None, {"t": "t"}).scale == {"t": 1e-3}


def test_what_a_model_feeds_forward_is_no_measured_torque():
    names = [
        f"Achse {k} Moment {x}" for x in ("gemessen", "Vorsteuerung") for k in (1, 2)
    ]
    found = recognise(["Zeit", "Achse 1 Winkel", "Achse 2 Winkel", *names])
    assert [found.rename["tau1"], found.rename["tau2"]] == names[:2]
    assert not found.torques


ROBOT = ("waist", "shoulder", "elbow")


def test_a_count_of_current_has_the_size_that_a_line_says():
    """Counts were torques by the constant alone, 372 times too large."""
    names = [
        "time",
        *(f"id{k}_present_{x}" for x in ("position", "current") for k in (1, 2)),
    ]
    lines = [
        "# Present_Current: 2.69 mA per unit",
        "# torque constant [Nm/A]: 1.2, 1.5",
    ]
    found = recognise(names, ("waist", "elbow"), lines)
    assert found.factors("tau", 2) == pytest.approx([2.69e-3 * 1.2, 2.69e-3 * 1.5])
    assert not found.torque_unit


@pytest.mark.parametrize(
    ("line", "order"),
    [
        ("# joints: elbow, waist, shoulder", [2, 3, 1]),
        ("% q1=shoulder q2=elbow q3=waist", [3, 1, 2]),
        ("# arm of waist and shoulder", [1, 2, 3]),
        ("# joints: elbow, elbow, waist", [1, 2, 3]),
    ],
)
def test_the_joints_above_a_table_are_those_of_its_columns(line, order):
    """And the numbers a joint above it stand in the same order."""
    names = ["time", *(f"{x}_{k}" for x in ("pos", "current") for k in (1, 2, 3))]
    found = recognise(names, ROBOT, [line, "# kt: 1, 2, 3"])
    assert [found.rename[f"q{k}"] for k in (1, 2, 3)] == [f"pos_{k}" for k in order]
    assert found.factors("tau", 3) == order
    ours = ["t", *(f"{x}{k}" for x in ("q", "tau") for k in (1, 2, 3))]
    t = 0.01 * np.arange(60)
    columns = {x: t if x == "t" else t + float(x[-1]) for x in ours}
    run = run_of(log_of_arrays(Path("run"), columns, heading=[line]), Choice(ROBOT))
    assert run.q[0].tolist() == run.tau[0].tolist() == order


def test_positions_that_are_the_derivative_of_velocities_are_exchanged(tmp_path):
    t = 0.01 * np.arange(300)
    q, dq = 1.3 + np.sin(3.0 * t), 3.0 * np.cos(3.0 * t)
    named = {"t": t, "q1": dq, "dq1": q, "tau1": t}
    run = run_of(log_of_arrays(Path("run"), named))
    np.testing.assert_array_equal(run.q[:, 0], q)
    np.testing.assert_array_equal(run.dq[:, 0], dq)
    written = run_of(log_of_arrays(Path("run"), named), Choice(as_written=True))
    np.testing.assert_array_equal(written.q[:, 0], dq)


def test_rows_of_several_robots_are_asked_about(tmp_path):
    lines = ["robot_id,time,q1,tau1"]
    lines += [f"arm_{'AB'[k % 2]},{0.01 * k},{k},{k}" for k in range(60)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines))
    words = "column robot_id says that rows are of several robots (arm_A, arm_B)"
    refusal(lambda: read_run(path, None, None), words)


def test_commanded_positions_stand_in_place_of_a_torque_that_is_not_logged():
    names = [f"{x}.{y}_position" for y in ("goal", "present") for x in ROBOT]
    found = recognise(["timestamp", *names], ROBOT)
    assert found.rename["qcmd3"] == "elbow.goal_position"
    assert found.rename["q3"] == "elbow.present_position"
    assert recognise(["timestamp", *names, "abc1", "abc2", "abc3"], ROBOT) is None


@pytest.mark.parametrize(
    ("torques", "others"),
    [("τ{}(t)", ()), ("/forceset/A{}_actuator", ()), ("sensor_{}_Mz", ("tau{}_ff",))],
)
def test_torques_are_what_was_measured_of_the_joints(torques, others):
    """A feed-forward was the torque without a word, and q1(t) was proposed as torques."""
    n = range(1, 4)
    named = {"q": "q{}(t)" if "(t)" in torques else "q{}", "tau": torques}
    columns = {x: [y.format(k) for k in n] for x, y in named.items()}
    if "sensor" in torques:
        columns["tau"] = [torques.format(x) for x in ROBOT]
    beside = [x.format(k) for x in others for k in n]
    names = ["t", *columns["q"], *beside, *columns["tau"]]
    found = recognise(names, ROBOT)
    if others:
        assert found is None
        log = log_of_arrays(Path("run"), {x: np.arange(60.0) for x in names})
        found = proposed(log, ["tau"], ROBOT, {})
    assert [found.rename[f"tau{k}"] for k in n] == columns["tau"]


def test_rows_of_zeros_behind_the_run_are_left_out():
    """Of arrays that were made longer than the run."""
    run = {x: np.zeros((30, 2)) for x in ("q", "tau")}
    run = {"t": np.zeros(30), **run}
    run["t"][:20] = 0.01 * np.arange(20)
    for x in ("q", "tau"):
        run[x][:20] = np.random.default_rng(1).normal(size=(20, 2))
    log = log_of_arrays(Path("run.npz"), run)
    with pytest.warns(Remark, match="10 cells of 0 are no measurements"):
        assert run_of(log).samples == 20


@pytest.mark.parametrize(
    ("number", "n", "is_empty"), [(-999, 4, True), (-999, 1, False), (-9, 4, False)]
)
def test_numbers_in_place_of_measurements_are_empty_cells(number, n, is_empty):
    t = 0.01 * np.arange(100)
    run = {"t": t, "q1": np.sin(t), "tau1": np.cos(t)}
    run["tau1"][10 : 10 + n] = number
    read = run_of(log_of_arrays(Path("run.npz"), run))
    assert read.samples == 100 - n * is_empty
    assert np.any(read.tau == number) != is_empty


RATIO, RATED, KT = "# gear ratios: 100, 50", "# rated torque [Nm]: 60, 30", "# kt: 2, 3"
#: Names of positions and torques, lines above the table, and factors of both.
USED = [
    ("q_{}", "torque_{} [% of 50 Nm]", [], {"tau1": 0.5, "tau2": 0.5}),
    ("q_{}", "torque_{} (‰ of 2 mNm)", [], {"tau1": 2e-6, "tau2": 2e-6}),
    ("q_{}", "torque_{} [%]", [RATED], {"tau1": 0.6, "tau2": 0.3}),
    ("q_{}", "torque_{}", [RATED, "# torque [‰]"], {"tau1": 0.06, "tau2": 0.03}),
    ("q_{}", "torque_{} [per mil]", [RATED], {"tau1": 0.06, "tau2": 0.03}),
    ("q_{}", "torque_{} [mN]", [], {"tau1": 1e-3, "tau2": 1e-3}),
    ("q_{}", "torque_{} [%]", [RATIO], {}),
    ("q_{}", "torque_{} [Nm]", [RATED, RATIO], {}),
    ("q_{}", "current_{}", [KT], {"tau1": 2.0, "tau2": 3.0}),
    ("q_{}", "current_{} [mA]", [KT, RATIO], {"tau1": 0.2, "tau2": 0.15}),
    ("q_{}", "current_{}", ["# kt at the joint: 2, 3", RATIO], {"tau1": 2, "tau2": 3}),
    ("q_{}", "motor_torque_{}", [RATIO], {"tau1": 100.0, "tau2": 50.0}),
    (
        "motor_pos_{}",
        "motor_torque_{}",
        [RATIO],
        {"q1": 0.01, "q2": 0.02, "tau1": 100.0, "tau2": 50.0},
    ),
]


@pytest.mark.parametrize(("q", "tau", "heading", "scale"), USED)
def test_numbers_a_joint_make_torques_of_what_was_logged(q, tau, heading, scale):
    names = ["time", *(x.format(k) for x in (q, tau) for k in (1, 2))]
    found = recognise(names, heading=heading)
    assert found.scale == {x: pytest.approx(y) for x, y in scale.items()}
    assert bool(found.torque_unit) is ("[%]" in tau and not scale)


def test_numbers_above_stand_in_the_order_of_the_columns():
    names = [
        "time",
        *(f"{x}_{y}" for x in ("tip", "base") for y in ("pos", "torque_%")),
    ]
    found = recognise(names, ["base", "tip"], heading=[RATED])
    assert found.scale == {"tau1": pytest.approx(0.3), "tau2": pytest.approx(0.6)}


@pytest.mark.parametrize("rail", [1, 3])
def test_a_rail_stands_among_turning_joints(rail):
    of = ["ft-lb", "lbf"], ["deg", "in"], ["Torque", "Force"]
    names = ["time"]
    for what in ("Position", ""):
        for k in (1, 2, 3):
            torque, angle, word = (x[k == rail] for x in of)
            unit = angle if what else torque
            names.append(f"J{k} {what or word} ({unit})")
    found = recognise(names, ["a", "b", "c"])
    assert [*found.rename.values()] == names
    assert found.scale[f"q{rail}"] == 0.0254
    assert found.scale[f"tau{rail}"] == pytest.approx(4.448222)


def test_a_rail_of_another_word_stands_among_turning_joints():
    of_q, of_tau = (
        [f"rail_{rail}_1", f"arm_{arm}_2", f"arm_{arm}_3"]
        for rail, arm in (("pos", "pos"), ("force", "torque"))
    )
    found = recognise(["time", *of_q, *of_tau])
    assert [*found.rename.values()] == ["time", *of_q, *of_tau]


@pytest.mark.parametrize(
    "head", ["data/demo_{}/", "runs[{}].", "episodes/{}/", "run{}_"]
)
def test_runs_of_one_file_stand_one_after_the_other(head, tmp_path):
    t, arrays = 0.01 * np.arange(50.0), {}
    for k, shift in ((9, 0.0), (10, 1.0)):
        inner = {"time": t, "joint_pos": np.sin(t)[:, None] + [shift, 0.0]}
        inner["joint_torques"] = np.cos(t)[:, None] + [shift, 1.0]
        arrays |= {head.format(k) + x: y for x, y in inner.items()}
    run = run_of(log_of_arrays(tmp_path / "runs.h5", arrays))
    assert run.t[[0, 49, 50, 99]] == pytest.approx([0.0, 0.49, 1.49, 1.98])
    assert run.q[[0, 50], 0] == pytest.approx([0.0, 1.0])
    assert concatenate([run, run]).runs()[1].episode.tolist() == [0] * 50 + [1] * 50


def test_joints_and_arms_are_no_runs(tmp_path):
    arrays = {f"{x}{k}/pos": np.zeros(9) for x in ("joint", "arm") for k in (1, 2)}
    assert [*log_of_arrays(tmp_path / "a.h5", arrays).columns] == [*arrays]


@pytest.mark.parametrize("group", ["", "robot/"])
def test_few_numbers_beside_columns_are_facts_too(group, tmp_path):
    blocks = {group + x: np.ones((60, 2)) for x in ("q", "motor_torque")}
    facts = {"gear_ratios": np.array([100.0, 50.0]), f"{group}dt": np.array([0.004])}
    run = run_of(log_of_arrays(tmp_path / "log.npz", {**blocks, **facts}))
    assert run.tau[0].tolist() == [100.0, 50.0]
    assert run.t[1] == pytest.approx(0.004)


def test_an_axis_called_t_is_no_clock():
    """Yaskawa's axes are S, L, U, R, B and T."""
    axes = [f"{axis}_{x}" for axis in "SLURBT" for x in ("FBPOS[deg]", "TRQ[Nm]")]
    found = recognise(["Time", *axes])
    assert found.rename["t"] == "Time"
    assert found.rename["q6"] == "T_FBPOS[deg]"
    assert found.rename["tau6"] == "T_TRQ[Nm]"


def test_a_rate_beside_the_arrays_of_json_stands_for_the_clock(tmp_path):
    joints = {
        f"j{k}": {"position": [0.1 * k, 0.2, 0.4], "torque": [1.0, 2.0, float(k)]}
        for k in (1, 2)
    }
    path = tmp_path / "run.json"
    path.write_text(json.dumps({"sample_rate_hz": 50, "joints": joints}))
    np.testing.assert_allclose(load_measurements(path).t, [0.0, 0.02, 0.04])


def test_a_number_beside_the_data_sets_of_hdf5_is_the_rate(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        for name in ("q", "tau"):
            file[f"robot/{name}"] = np.ones((60, 2))
        file["robot/rate_hz"] = 200.0
    assert load_measurements(tmp_path / "run.h5").t[1] == pytest.approx(0.005)


@pytest.mark.parametrize("name", ["qd", "qdot", "vel"])
def test_velocities_by_another_name_are_read_beside_our_names(name, tmp_path):
    """MATLAB's toolboxes call them qd."""
    t = 0.01 * np.arange(200)
    q = np.sin(np.outer(t, [1.0, 2.0]))
    dq = np.cos(np.outer(t, [1.0, 2.0])) * [1.0, 2.0]
    arrays = {"t": t, "q": q, name: dq, "tau": q}
    run = run_of(log_of_arrays(tmp_path / "log.npz", arrays))
    np.testing.assert_array_equal(run.dq, dq)
    np.testing.assert_array_equal(run.q, q)


@pytest.mark.parametrize("others", ["t q tau", "time q torque"])
def test_desired_positions_are_no_velocities(others, tmp_path):
    """They are called qd as well."""
    t = 0.01 * np.arange(200)
    q = np.sin(np.outer(t, [1.0, 2.0]))
    arrays = dict(zip(others.split(), (t, q, q), strict=True)) | {"qd": q + 1e-3}
    run = run_of(log_of_arrays(tmp_path / "log.npz", arrays))
    assert run.dq is None


GRIPPERS = {
    "by names": (("grip", "a", "b"), ("a", "b"), ["a", "b"], [1, 2]),
    "by names alone": (("grip", "b", "a"), ("b", "a"), None, [1, 2]),
    "the last one": ((), (), ["a", "b"], [0, 1]),
}


@pytest.mark.parametrize("case", GRIPPERS)
def test_a_gripper_without_torque_is_left_out(case, tmp_path):
    """LeRobot's state and action hold it."""
    of_q, of_tau, joints, places = GRIPPERS[case]
    t = 0.01 * np.arange(200.0)
    q = np.sin(np.outer(t, [1.0, 2.0, 3.0]))
    arrays = {"timestamp": t, "observation.state": q, "observation.effort": q[:, :2]}
    facts = {
        "observation.state": {"joints": of_q, "unit": "rad"},
        "observation.effort": {"joints": of_tau},
    }
    run = run_of(
        log_of_arrays(tmp_path / "a.parquet", arrays, facts=facts), Choice(joints)
    )
    np.testing.assert_array_equal(run.q, q[:, places])
    np.testing.assert_array_equal(run.tau, q[:, :2])


@pytest.mark.parametrize("n_joints", [None, 3])
def test_other_columns_without_torque_are_refused(n_joints, tmp_path):
    joints = n_joints and [f"j{k}" for k in range(n_joints)]
    blocks = {"t": np.arange(9.0), "pos": np.ones((9, 5)), "torque": np.ones((9, 3))}
    log = log_of_arrays(tmp_path / "a.npz", blocks)
    refusal(lambda: run_of(log, Choice(joints)), "different numbers of joints")


@pytest.mark.parametrize(
    ("zero", "words"),
    [
        ("", "q=0.00153398078789"),
        (", zero at 2048", "q=0.00153398078789@2048"),
        (", offsets 5, 7", "q=0.00153398078789@5:0.00153398078789@7"),
    ],
)
def test_size_and_zero_of_counts_stand_above_the_table(zero, words, tmp_path):
    line = f"# encoder: 4096 counts per joint revolution{zero}"
    names = ["t", "enc_counts_1", "enc_counts_2", "torque_1_Nm", "torque_2_Nm"]
    found = recognise(names, heading=[line])
    assert found.scale == dict.fromkeys(("q1", "q2"), pytest.approx(np.pi / 2048.0))
    assert not any("whose size" in x for x in found.said)
    assert convert_options(found, names)[-1] == words
    rows = [f"{k / 100},{3000 + k},{2000 - k},{k},1" for k in range(9)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join([line, ",".join(names), *rows]))
    run = load_measurements(path)
    at = [float(x.partition("@")[2] or 0.0) for x in words.split(":")]
    assert run.q[0] * 2048.0 / np.pi == pytest.approx([3000 - at[0], 2000 - at[-1]])


@pytest.mark.parametrize("n_damaged", [2, 20])
def test_few_rows_of_another_length_are_left_out(n_damaged, tmp_path):
    """As a line that two programs wrote at once; many are a table of another form."""
    rows = [f"{0.01 * k:.2f},{np.sin(k):.6f},{np.cos(k):.6f}" for k in range(400)]
    for k in range(n_damaged):
        rows[10 * k + 9] = ["0.1,0.2", "0.1,0.2,0.3,0.4"][k % 2]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["t,q1,tau1", *rows]) + "\n")
    if n_damaged > 4:
        refusal(lambda: load_measurements(path), "row 11 has 2 cells")
    else:
        with pytest.warns(Remark, match="2 damaged rows left out"):
            assert load_measurements(path).samples == 398


def test_a_header_that_comes_again_may_have_another_order(tmp_path):
    t = 0.01 * np.arange(60)
    rows = [f"{x:.2f},{np.sin(x):.6f},{np.cos(x):.6f}" for x in t]
    rows[30:] = [",".join(x.split(",")[k] for k in (2, 0, 1)) for x in rows[30:]]
    path = tmp_path / "run.csv"
    path.write_text(
        "\n".join(["t,q1,tau1", *rows[:30], "tau1,t,q1", *rows[30:]]) + "\n"
    )
    with pytest.warns(Remark, match="1 repeated header"):
        run = load_measurements(path)
    np.testing.assert_allclose(run.t, t)
    np.testing.assert_allclose(run.q[:, 0], np.sin(t), atol=1e-6)


def test_a_command_keeps_the_columns_that_it_names(tmp_path):
    """It lost t=clk, and asked for t again."""
    path = tmp_path / "run.csv"
    rows = "0.1,1,2,3,4\n0.1,2,3,4,5\n0.3,1,2,5,6\n"
    path.write_text("clk,P1,P2,M1,M2\n" + rows)
    with pytest.raises(InputError, match=r"--rename 't=clk,q\*=P\*,tau\*=M\*"):
        read_run(path, rename={"t": "clk"})
