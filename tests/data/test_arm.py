"""What names leave open the arm tells: which channel is the torque, whether a register
has a sign bit; and velocities the unit of a clock."""

import json
import re
import shlex
import warnings
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import ELBOW, SHOULDER, TURN, write_urdf
from commands import run_cli
from small_runs import small_run

from sdp_vs_penalty import Problem, convert, load_measurements
from sdp_vs_penalty.data import read_run
from sdp_vs_penalty.data.files import as_measurements
from sdp_vs_penalty.data.hypotheses import by_arm
from sdp_vs_penalty.data.hypotheses.arm import ChannelFit, fit_arm
from sdp_vs_penalty.data.hypotheses.channels import Recognition
from sdp_vs_penalty.data.plausibility import check_plausible
from sdp_vs_penalty.errors import ColumnsRemark, InputError
from sdp_vs_penalty.problem import load_problem

DEGREES = 180.0 / np.pi


@pytest.fixture(scope="module")
def run(two_link):
    return small_run(two_link, seconds=8.0)


def read(path, robot=None):
    """A file's run, and what is said of its columns."""
    names = None if robot is None else robot.joint_names
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        read_ = read_run(path, 2, names)
    (said,) = [str(x.message) for x in heard if issubclass(x.category, ColumnsRemark)]
    return read_, said


def table(path, **blocks):
    head, columns = [], []
    for name, block in blocks.items():
        block = np.reshape(block, (len(block), -1))
        wide = block.shape[1] > 1
        head += [f"{name}_{k + 1}" if wide else name for k in range(block.shape[1])]
        columns.append(block)
    text = "\n".join(",".join(map(repr, x)) for x in np.hstack(columns).tolist())
    header = f"{','.join(head)}\n" if any(blocks) else ""
    path.write_text(f"{header}{text}\n")
    return path


def register(tau):
    """Thousandths of the largest torque in ten bits, and a bit that says that it is
    positive."""
    counts = np.round(1000.0 * np.abs(tau) / np.abs(tau).max())
    return np.where(tau > 0.0, counts + 1024, counts) / 100.0


@pytest.mark.parametrize("turned", [1.0, -1.0])
def test_a_register_with_a_sign_bit_is_read_by_the_arm(turned, run, two_link, tmp_path):
    """Friction takes power: so is known which value of the bit is which sign."""
    written = register(turned * run.tau)
    path = table(tmp_path / "run.csv", time=run.t, pos=run.q, trq=written)
    got, said = read(path, two_link.robot)
    np.testing.assert_allclose(
        got.tau, 10.0 * run.tau / np.abs(run.tau).max(), atol=0.006
    )
    assert "tau is a register whose bit 10 is its sign" in said
    assert "the same by" not in said  # by columns alone it is not


@pytest.mark.parametrize(("lowest", "is_register"), [(-0.5, True), (0.5, False)])
def test_jumps_tell_a_register_where_the_arm_leaves_much(lowest, is_register):
    """Each servo has a scale of its own, so that the arm explains little either way."""
    torque = np.linspace(lowest, 5.0, 3000)[:, None]
    blocks = {"q": np.zeros((3000, 1)), "tau": np.round(register(torque), 2)}

    def fit(q, tau):
        return ChannelFit(0.7 if np.array_equal(tau, blocks["tau"]) else 0.4, 1.0)

    found, read_ = by_arm.with_signed_register(Recognition({}), blocks, fit)
    assert found.is_of_arm == is_register
    assert (read_["tau"].min() < 0.0) == is_register


def test_without_an_arm_a_register_stays_as_it_is_written(run, tmp_path):
    path = table(tmp_path / "run.csv", time=run.t, pos=run.q, trq=register(run.tau))
    np.testing.assert_array_equal(read(path)[0].tau, register(run.tau))


def test_a_torque_that_is_positive_is_no_register(run, two_link, tmp_path):
    tau = np.round(run.tau - run.tau.min(), 2)
    path = table(tmp_path / "run.csv", time=run.t, pos=run.q, trq=tau)
    np.testing.assert_allclose(read(path, two_link.robot)[0].tau, tau)


def test_the_command_that_is_printed_reads_the_register_again(
    run, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    table(Path("log.csv"), time=run.t, pos=run.q, trq=register(run.tau))
    assert run_cli("convert", "log.csv", "--problem", "two_link", "--out", "a.csv") == 0
    printed = capsys.readouterr()
    (command,) = re.findall("the same by `sdp-vs-penalty (.*?)`", printed.err)
    assert "written: a_columns.txt" in printed.out
    assert "bit 10 is its sign" in Path("a_columns.txt").read_text()
    assert run_cli(*shlex.split(command)) == 0
    run_cli("check", "two_link", "--data", "log.csv", "--json", "c.json")
    (sentence,) = json.loads(Path("c.json").read_text())["columns"]
    assert sentence == Path("a_columns.txt").read_text().strip()
    assert (
        load_measurements("run.csv").data_hash == load_measurements("a.csv").data_hash
    )


def test_the_arm_tells_which_channel_is_the_torque(run, two_link, tmp_path):
    """By names alone the better word wins; of both it is said what the arm leaves."""
    other = np.random.default_rng(1).normal(size=run.tau.shape)
    path = table(
        tmp_path / "run.csv", time=run.t, pos=run.q, torque=other, effort=run.tau
    )
    np.testing.assert_array_equal(read(path)[0].tau, other)
    got, said = read(path, two_link.robot)
    np.testing.assert_array_equal(got.tau, run.tau)
    assert re.search(r"torque_1 to torque_2 \(the arm leaves [\d.e+]+ % of it\)", said)


def test_a_model_s_torque_is_not_taken_although_the_arm_explains_it_best(
    run, two_link, tmp_path
):
    """Rigid bodies alone make it, beside a torque with friction and noise."""
    dq = np.gradient(run.q, run.t, axis=0)
    ddq = np.gradient(dq, run.t, axis=0)
    links = np.ravel(two_link.nominal_links)
    model = two_link.robot.regressor(run.q, dq, ddq) @ links
    noise = 0.01 * np.random.default_rng(2).normal(size=model.shape)
    measured = model + np.ptp(model, axis=0) * (0.1 * np.tanh(9.0 * dq) + noise)
    path = table(
        tmp_path / "run.csv", time=run.t, pos=run.q, torque=model, effort=measured
    )
    got, said = read(path, two_link.robot)
    np.testing.assert_array_equal(got.tau, measured)
    assert "torque_1 to torque_2 (a model's: smooth; the arm leaves" in said


def test_a_pause_tells_the_arm_nothing(run, two_link, tmp_path):
    """Derivatives do not reach over it: by them any channel would look as bad."""
    late = run.t + 3.0 * (run.t > 4.0)
    other = np.random.default_rng(1).normal(size=run.tau.shape)
    path = table(
        tmp_path / "run.csv", time=late, pos=run.q, torque=other, effort=run.tau
    )
    np.testing.assert_array_equal(read(path, two_link.robot)[0].tau, run.tau)


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
@pytest.mark.parametrize(
    ("logs_velocity", "reason"),
    [(True, "dq is the derivative of q at "), (False, "its steps are ")],
)
def test_motion_tells_the_unit_of_a_clock_without_one(
    logs_velocity, reason, unit, factor, run, tmp_path
):
    stamps = run.t + 3.0 * logs_velocity * (run.t > 4.0)  # a pause does not matter
    columns = {"time": factor * stamps, "pos": run.q, "trq": run.tau}
    if logs_velocity:
        columns["vel"] = run.dq
    got, said = read(table(tmp_path / "run.csv", **columns))
    np.testing.assert_allclose(got.t, stamps, atol=1e-9)
    assert f"t in {unit}, {reason}" in said


@pytest.mark.parametrize(
    ("factors", "said_of_them"),
    [
        ((DEGREES, DEGREES), "dq in deg/s, as"),
        ((9.5493, 9.5493), "dq in rpm, as"),
        ((1e3, DEGREES), "dq in mm/s or mrad/s and deg/s, as"),
        ((1.0, 1.0), ""),
        ((1.3, 1.3), ""),
    ],
)
def test_velocities_follow_the_unit_of_positions(factors, said_of_them, run, tmp_path):
    """Whatever the clock counts; a factor that no unit has stays, for the clock has it."""
    logged = run.dq * factors
    path = table(tmp_path / "run.csv", time=run.t, pos=run.q, vel=logged, trq=run.tau)
    got, said = read(path)
    np.testing.assert_allclose(got.t, run.t)
    np.testing.assert_allclose(got.dq, run.dq if said_of_them else logged, rtol=1e-4)
    assert said_of_them in said
    assert ("dq in" in said) == bool(said_of_them)


def test_commands_follow_the_unit_of_positions(run, tmp_path):
    path = tmp_path / "run.csv"
    degrees = {
        "pos_deg": DEGREES * run.q,
        "qcmd": DEGREES * run.q + 0.1,
        "trq": run.tau,
    }
    got, _ = read(table(path, time=run.t, **degrees))
    np.testing.assert_allclose(got.groups["qcmd"], run.q + 0.1 / DEGREES)
    table(path, t=run.t, q=DEGREES * run.q, qcmd=DEGREES * run.q, dq=DEGREES * run.dq)
    got = convert(path, scale={"q": "deg"})
    np.testing.assert_allclose(got.groups["qcmd"], run.q)
    np.testing.assert_allclose(got.dq, run.dq, rtol=1e-4)


def test_a_clock_goes_with_a_unit_of_positions_that_is_possible(tmp_path):
    problem = limited_arm(tmp_path)
    motion = small_run(problem, seconds=8.0)
    counts = np.round(2048.0 + 4096.0 / (2.0 * np.pi) * motion.q)
    columns = {"time": 1e3 * motion.t, "pos": counts, "trq": motion.tau}
    got, _ = reading(table(tmp_path / "run.csv", **columns), problem)
    assert got.unit_command.count("@2048,t=ms ")


def of_gantry(path, unit_of_slides, *names):
    """A table of a rail's and joints' motion, clock first; the problem and the motion."""
    problem = load_problem(Path(__file__).parents[1] / "robot/gantry.urdf")
    motion = small_run(problem)
    slides = [joint.kind == "prismatic" for joint in problem.robot.joints]
    to_file = np.where(slides, unit_of_slides, DEGREES)
    columns = motion.t, to_file * motion.q, to_file * motion.dq, motion.tau
    return table(path, **dict(zip(names, columns, strict=True))), problem, motion


def test_a_slide_s_position_is_no_angle(tmp_path):
    """The lines above a table say degrees, and mean the joints that turn."""
    names = "time", "pos", "vel", "trq"
    path, problem, motion = of_gantry(tmp_path / "run.csv", 1.0, *names)
    path.write_text(f"# units: s deg deg/s Nm\n{path.read_text()}")
    got = convert(path, problem=problem)
    np.testing.assert_allclose(got.q, motion.q)
    np.testing.assert_allclose(got.dq, motion.dq, rtol=1e-4)


@pytest.fixture(scope="module")
def three_joints(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    return load_problem(write_urdf(path, "arm", (TURN, SHOULDER, ELBOW)))


@pytest.fixture(scope="module")
def braked(three_joints):
    """A motion of three joints of which the first, whose axis is vertical, is held."""
    return small_run(three_joints, seconds=8.0, reach=np.array([0.0, 1.0, 1.0]))


@pytest.mark.parametrize("factor", [1.0, np.pi / 180.0, 1e-3, 1e-5])
def test_what_does_not_vary_tells_no_unit(factor, three_joints, braked):
    """Rounding makes spreads of constant channels that are not zero in some units."""
    t, q, tau = braked.t, braked.q, braked.tau
    at_rest, holding = (0.0 * x + x[401] for x in (np.degrees(q), tau))
    robot = three_joints.robot
    assert fit_arm(robot, t, factor * at_rest, tau) is None
    assert fit_arm(robot, t, factor * np.degrees(q), holding) is None


@pytest.mark.parametrize("each_in_its_unit", [True, False])
def test_a_joint_at_rest_tells_no_more_than_its_zero(
    each_in_its_unit, three_joints, braked
):
    fits = []
    for angle, torque in ((0.0, 0.0), (0.7, 1.3)):
        q, tau = braked.q.copy(), braked.tau.copy()
        q[:, 0], tau[:, 0] = angle, torque
        fits.append(
            fit_arm(
                three_joints.robot, braked.t, q, tau, each_in_its_unit=each_in_its_unit
            )
        )
    at_zero, elsewhere = fits
    assert at_zero.share < 0.05
    assert elsewhere.share == pytest.approx(at_zero.share, rel=1e-3)
    assert elsewhere.friction == pytest.approx(at_zero.friction, rel=1e-3)


def test_convert_says_what_the_arm_has_to_decide(run, tmp_path, capsys, monkeypatch):
    """By the command that `check` prints, and with its exit code."""
    monkeypatch.chdir(tmp_path)
    late = np.floor(run.t + 0.2 * np.sin(run.t))
    table(Path("log.csv"), time=late, pos=run.q, trq=run.tau)
    assert run_cli("convert", "log.csv", "--problem", "two_link", "--out", "a.csv") == 1
    said = capsys.readouterr().out
    assert "error coarse time stamps" in said
    assert "Next: sdp-vs-penalty check two_link --data a.csv --fix a_fixed.csv" in said


def test_the_next_step_of_convert_mends_the_file(tmp_path, capsys, monkeypatch):
    """A unit that the arm finds possible, and an order that it corrects."""
    monkeypatch.chdir(tmp_path)
    problem = limited_arm(tmp_path)
    motion = small_run(problem, seconds=8.0)
    counts = np.round(131072.0 / (2.0 * np.pi) * motion.q)
    table(Path("log.csv"), time=motion.t, pos=counts, trq=motion.tau)
    words = ["convert", "log.csv", "--problem", str(tmp_path / "arm.urdf")]
    assert run_cli(*words, "--out", "a.csv") == 1
    (line,) = re.findall("^Next: sdp-vs-penalty (.*)$", capsys.readouterr().out, re.M)
    assert run_cli(*shlex.split(line)) == 0
    np.testing.assert_allclose(read_run("a.csv", 3).q, motion.q, atol=1e-4)


def test_letters_in_a_unit_that_nothing_says_are_confirmed(tmp_path):
    """A rail among joints, velocities as positions; `load` is a letter of torques."""
    names = "clock", "ang", "spd", "load"
    path, problem, motion = of_gantry(tmp_path / "run.csv", 1e3, *names)
    got, _ = reading(path, problem)
    np.testing.assert_allclose(got.q, motion.q, atol=1e-9)
    np.testing.assert_allclose(got.dq, motion.dq, rtol=1e-4)


def test_whole_seconds_are_no_milliseconds(run, tmp_path):
    """Their steps are 1, and most of them 0: the rows are spaced evenly."""
    path = table(tmp_path / "run.csv", time=np.floor(run.t), pos=run.q, trq=run.tau)
    np.testing.assert_allclose(np.diff(read(path)[0].t), 0.01)


def test_rows_that_are_written_twice_keep_their_stamps(run, tmp_path):
    """Their time is the clock's, and the check calls them copies."""
    twice = run.rows(np.repeat(np.arange(run.samples), 2))
    path = table(tmp_path / "run.csv", time=twice.t, pos=twice.q, trq=twice.tau)
    np.testing.assert_array_equal(read(path)[0].t, twice.t)


@pytest.mark.parametrize("clock", ["time", "time [s]"])
def test_poses_that_are_seconds_apart_stay_seconds(clock, run, tmp_path):
    """In milliseconds the joints would move a thousand times as fast as any arm."""
    poses = run.rows(slice(None, None, 40))
    seconds = 3.5 * np.arange(poses.samples)
    blocks = {clock: seconds, "pos": poses.q, "trq": poses.tau}
    got, _ = read(table(tmp_path / "run.csv", **blocks))
    np.testing.assert_allclose(got.t, seconds)


@pytest.mark.parametrize(
    ("name", "asks"), [("pos", True), ("theta", True), ("pos_rad", False), ("q", False)]
)
def test_a_log_whose_names_say_no_unit_brings_the_command_that_does(
    name, asks, run, tmp_path
):
    columns = {f"{name}{k + 1}": run.q[:, k] for k in range(2)}
    columns |= {f"tau{k + 1}": run.tau[:, k] for k in range(2)}
    path = table(tmp_path / "run.csv", t=run.t, **columns)
    with warnings.catch_warnings(action="ignore"):
        got = read_run(path, 2)
    assert ("--scale q=UNIT" in got.unit_command) == asks
    if asks:
        words = shlex.split(got.unit_command.replace("UNIT", "turns"))[1:]
        words[-1] = str(tmp_path / "turns.csv")
        assert run_cli(*words) == 0
        np.testing.assert_allclose(
            read_run(words[-1], 2).q, 2.0 * np.pi * run.q, rtol=1e-6
        )


def limited_arm(folder: Path) -> Problem:
    """Three joints with ranges and masses."""
    return load_problem(write_urdf(folder / "arm.urdf", "arm", (TURN, SHOULDER, ELBOW)))


def reading(path: Path, problem: Problem, **options):
    """A file's run for a problem's robot, and all that is said."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        got = read_run(path, problem.robot.n, problem.channel_names, **options)
    return got, " ".join(str(x.message) for x in heard)


def ours(t, q, tau):
    """Columns under the names of RUN.csv."""
    columns = {f"q{k}": x for k, x in enumerate(q.T, 1)}
    return {"t": t, **columns, **{f"tau{k}": x for k, x in enumerate(tau.T, 1)}}


#: What a table holds by its names, and what is said of it.
CERTAIN = {
    "degrees": (
        lambda x: {"time": x.t, "pos": np.degrees(x.q), "trq": x.tau},
        "q in deg, ",
    ),
    "degrees under our names": (
        lambda x: ours(x.t, np.degrees(x.q), x.tau),
        "q in deg, as radians they leave the joints' ranges",
    ),
    "degrees that are cut": (
        lambda x: {"time": x.t, "pos": np.degrees(x.q) % 360.0, "trq": x.tau},
        "q in deg, ",
    ),
    "milliseconds under our names": (
        lambda x: ours(1e3 * x.t, x.q, x.tau),
        "t in ms, its steps are",
    ),
    "degrees and milliseconds": (
        lambda x: {"time": 1e3 * x.t, "pos": np.degrees(x.q), "trq": x.tau},
        "t in ms, its steps are",
    ),
    "letters of a state": (
        lambda x: {"time": x.t, "x": np.hstack([x.q, x.dq]), "u": x.tau},
        "dq1..dq3 = x_4 .. x_6, tau1..tau3 = u_1 .. u_3",
    ),
    "without a header, torques first": (
        lambda x: {"": np.hstack([x.t[:, None], x.tau, x.q])},
        "t = #1, q1..q3 = #5 .. #7, tau1..tau3 = #2 .. #4",
    ),
    "without a header, joint by joint, the clock last": (
        lambda x: {
            "": np.hstack(
                [np.stack([x.dq, x.tau, x.q], 2).reshape(-1, 9), x.t[:, None]]
            )
        },
        "t = #10, q1..q3 = #3 .. #9, dq1..dq3 = #1 .. #7, tau1..tau3 = #2 .. #8",
    ),
    "letters": (
        lambda x: {"time": x.t, "P": x.q, "V": x.dq, "M": x.tau},
        "columns recognised (by letters and order)",
    ),
}


@pytest.mark.parametrize("name", ["tau_ext", "contact_torque", "residual_torque"])
def test_a_part_of_the_torque_is_asked_for_and_not_taken(name, tmp_path):
    """An arm confirms what is external, too: its friction is a part of it."""
    problem = limited_arm(tmp_path)
    motion = small_run(problem, seconds=8.0)
    path = table(tmp_path / "run.csv", time=motion.t, q=motion.q, **{name: motion.tau})
    with pytest.raises(InputError, match=rf"tau\*={name}_\*.*if they are that"):
        reading(path, problem)


@pytest.mark.parametrize("case", CERTAIN)
def test_what_the_arm_tells_for_certain_is_taken_and_said(case, tmp_path):
    """Of a file that is read as it is written nothing is told: the same is refused later,
    or at once, or names no unit."""
    problem = limited_arm(tmp_path)
    motion = small_run(problem, seconds=8.0)
    make, words = CERTAIN[case]
    path = table(tmp_path / "run.csv", **make(motion))
    got, said = reading(path, problem)
    assert words in said
    np.testing.assert_allclose(got.t, motion.t, atol=1e-9)
    turns = (got.q - motion.q) / (2.0 * np.pi)
    np.testing.assert_allclose(
        turns, np.round(turns[:1]).repeat(len(turns), 0), atol=1e-9
    )
    np.testing.assert_allclose(got.tau, motion.tau)
    with suppress(InputError):
        assert words not in reading(path, problem, as_written=True)[1]


def test_a_block_of_all_channels_is_told_by_its_values(tmp_path):
    """Without an arm the command names its columns."""
    problem = limited_arm(tmp_path)
    motion = small_run(problem, seconds=8.0)
    path = tmp_path / "run.npz"
    np.savez(path, t=motion.t, state=np.hstack([motion.tau, motion.dq, motion.q]))
    got, _ = reading(path, problem)
    with pytest.raises(InputError, match="state holds 9 columns: where its") as error:
        read_run(path)
    (command,) = re.findall("`sdp-vs-penalty (.*?) --out", str(error.value))
    assert run_cli(*shlex.split(command), "--out", tmp_path / "o.npz") == 0
    for run in (got, read_run(tmp_path / "o.npz", 3)):
        np.testing.assert_allclose(run.q, motion.q)
        np.testing.assert_allclose(run.tau, motion.tau)


def test_of_two_torques_without_names_the_arm_takes_none(tmp_path):
    """A model's fits better than the measured one."""
    problem = limited_arm(tmp_path)
    run = small_run(problem, seconds=8.0)
    noise = (
        0.03 * run.tau.std(axis=0) * np.random.default_rng(2).normal(size=run.tau.shape)
    )
    path = tmp_path / "run.csv"
    np.savetxt(
        path, np.hstack([run.t[:, None], run.q, run.dq, run.tau + noise, run.tau])
    )
    with pytest.raises(InputError, match="where its columns are t, q, dq and tau"):
        reading(path, problem)


def test_no_gears_are_sought_of_columns_that_the_arm_has_to_confirm(
    tmp_path, monkeypatch
):
    """Seventy fits of each order that is tried: 9 s of 11, and a ratio confirms none."""
    problem = limited_arm(tmp_path)
    run = small_run(problem, seconds=8.0)
    path = tmp_path / "run.csv"
    np.savetxt(path, np.hstack([run.t[:, None], run.tau, DEGREES * run.q]))
    monkeypatch.delattr(by_arm, "_with_possible_gears")
    got, _ = reading(path, problem)
    np.testing.assert_allclose(got.q, run.q)


@pytest.mark.parametrize("turn", [4096, 65536])
def test_counts_whose_size_is_likely_bring_the_command(turn, tmp_path):
    """Encoders of other sizes are as possible: the user decides."""
    problem = limited_arm(tmp_path)
    motion = small_run(problem, seconds=8.0)
    counts = np.round(0.5 * turn + turn / (2.0 * np.pi) * motion.q)
    columns = {"time": motion.t, "pos": counts, "vel": 10.0 * motion.dq}
    path = table(tmp_path / "run.csv", **columns, trq=motion.tau)
    got, said = reading(path, problem)
    np.testing.assert_allclose(got.q, counts)
    assert f"{turn} a turn, the middle at {turn // 2}" in said
    assert got.unit_command in said
    with pytest.raises(InputError, match=f"@{turn // 2}"):
        check_plausible(problem.robot, got)
    words = [*shlex.split(got.unit_command)[1:-1], str(tmp_path / "si.csv")]
    assert run_cli(*words) == 0
    got = read_run(words[-1], 3)
    np.testing.assert_allclose(got.q, motion.q, atol=1e-3)
    np.testing.assert_allclose(got.dq, motion.dq, rtol=0.01)


def geared_log(tmp_path, side):
    """An arm's file with reductions, a motion, and its log of the motors' positions with
    torques of one side."""
    ratios = np.array([50.0, 80.0, 30.0])
    text = (
        (tmp_path / limited_arm(tmp_path).robot.name).with_suffix(".urdf").read_text()
    )
    gears = "".join(
        f"<transmission name='t{k}'><joint name='{x}'/><actuator name='m{k}'>"
        f"<mechanicalReduction>{ratios[k]}</mechanicalReduction></actuator></transmission>"
        for k, x in enumerate(limited_arm(tmp_path).robot.joint_names)
    )
    arm = tmp_path / "geared.urdf"
    arm.write_text(text.replace("</robot>", f"{gears}</robot>"))
    motion = small_run(load_problem(arm), seconds=8.0)
    tau = motion.tau / ratios if side == "motor" else motion.tau
    columns = {"time": motion.t, "motor pos [rad]": ratios * motion.q}
    return arm, motion, table(tmp_path / "run.csv", **columns, trq=tau)


@pytest.mark.parametrize("side", ["motor", "joint"])
def test_channels_of_motors_are_the_joints_by_the_robot_s_transmission(side, tmp_path):
    """By the file's reductions, where positions are in the joints' ranges only so; once."""
    arm, motion, path = geared_log(tmp_path, side)
    problem = load_problem(arm)
    got, said = reading(path, problem)
    words = "q and tau are" if side == "motor" else "q are"
    assert f"{words} the motors': the robot's transmission makes" in said
    np.testing.assert_allclose(got.q, motion.q)
    np.testing.assert_allclose(got.tau, motion.tau)
    flags = ["--motor-side", *["--joint-torque"] * (side == "joint")]
    out = tmp_path / "si.csv"
    assert run_cli("convert", path, "--problem", arm, *flags, "--out", out) == 0
    np.testing.assert_allclose(read_run(out, 3).tau, motion.tau, rtol=1e-6)


@pytest.mark.parametrize(
    ("declared", "side"), [("motor", "motor"), ("motor", "joint"), ("joint", "joint")]
)
def test_torques_can_be_the_joints_where_a_problem_declares_channels(
    declared, side, tmp_path
):
    arm, motion, path = geared_log(tmp_path, side)
    problem = load_problem(arm)
    positions, torques = ("motor",) * 3, (declared,) * 3
    transmission = replace(
        problem.robot.transmission, positions=positions, torques=torques
    )
    robot = replace(problem.robot, transmission=transmission)
    problem = replace(problem, robot=robot)
    got, said = reading(path, problem)
    is_joint = side == "joint"
    assert "are the motors': the robot's transmission makes" in said
    assert ("q and tau are" in said) != is_joint
    converted = convert(path, problem=problem, motors=True, joint_torque=is_joint)
    for run in (got, converted):
        np.testing.assert_allclose(run.q, motion.q)
        np.testing.assert_allclose(run.tau, motion.tau)


@pytest.mark.parametrize(
    ("arms", "mark"), [(("left", "right"), "_"), (("r1", "r2"), "/")]
)
def test_arms_of_one_file_are_told_apart_by_a_word(arms, mark, tmp_path):
    """The command takes the first one, in the robot's order of joints."""
    problem = limited_arm(tmp_path)
    motion = small_run(problem, seconds=2.0)
    columns = {
        f"{arm}{mark}{joint}.{name}": sign * block[:, k]
        for arm, sign in zip(arms, (1.0, -1.0), strict=True)
        for k, joint in reversed([*enumerate(problem.robot.joint_names)])
        for name, block in (("pos", motion.q), ("eff", motion.tau))
    }
    path = table(tmp_path / "run.csv", time=motion.t, **columns)
    with pytest.raises(
        InputError, match=f"q could be {arms[0]}.* or {arms[1]}"
    ) as refused:
        reading(path, problem)
    command = re.findall("`(.*)`", str(refused.value))[0]
    words = [*shlex.split(command)[1:-1], str(tmp_path / "left.csv")]
    assert run_cli(*words) == 0
    np.testing.assert_allclose(read_run(words[-1], 3).q, motion.q, rtol=1e-6)


def test_files_called_by_the_joints_are_one_run(tmp_path):
    arm = write_urdf(tmp_path / "arm.urdf", "arm", (TURN, SHOULDER, ELBOW))
    words = {"joint1": "turn", "joint2": "shoulder", "joint3": "elbow"}
    arm.write_text(re.sub("joint[123]", lambda x: words[x[0]], arm.read_text()))
    problem = load_problem(arm)
    motion = small_run(problem, seconds=2.0)
    folder = tmp_path / "log"
    folder.mkdir()
    for k, joint in enumerate(problem.robot.joint_names):
        columns = {"pos": motion.q[:, k], "trq": motion.tau[:, k]}
        table(folder / f"{joint}.csv", time=motion.t, **columns)
    got = as_measurements(folder, names=problem.channel_names)
    np.testing.assert_allclose(got.q, motion.q)
    with pytest.raises(InputError, match="the file holds one joint") as refused:
        reading(folder / f"{joint}.csv", problem)
    command = re.findall("`(.*)`", str(refused.value))[0]
    words = [*shlex.split(command)[1:-1], str(tmp_path / "all.csv")]
    assert run_cli(*words) == 0
    np.testing.assert_allclose(read_run(words[-1], 3).tau, motion.tau, rtol=1e-6)


def test_whole_runs_called_by_the_joints_stay_runs(two_link, tmp_path):
    names = ("shoulder", "elbow")
    motions = [small_run(two_link, seed=seed, seconds=2.0) for seed in (0, 1)]
    for name, run in zip(names, motions, strict=True):
        table(tmp_path / f"{name}.csv", t=run.t, q=run.q, tau=run.tau)
    runs = as_measurements(tmp_path, names=names).runs()
    assert len(runs) == 2
    for got, name in zip(runs, sorted(names), strict=True):
        np.testing.assert_allclose(got.q, motions[names.index(name)].q)


def test_torques_that_no_arm_explains_confirm_no_columns(tmp_path):
    problem = limited_arm(tmp_path)
    motion = small_run(problem, seconds=8.0)
    noise = np.random.default_rng(3).normal(size=motion.q.shape)
    for tau in (noise, motion.dq):  # a velocity is proportional to friction's column
        path = table(tmp_path / "run.csv", time=motion.t, P=motion.q, M=tau)
        with pytest.raises(InputError, match="no column t or q or tau"):
            reading(path, problem)


@pytest.mark.parametrize(
    "factor", [50.0, 64.0, 80.0, np.array([50.0, 85.0, 120.0]), 36000.0 / (2.0 * np.pi)]
)
def test_angles_of_motors_and_counts_are_in_no_certain_unit(factor, tmp_path):
    """They are near degrees, and near counts of a power of two: the check weighs them."""
    problem = limited_arm(tmp_path)
    motion = small_run(problem, seconds=8.0)
    q = factor * motion.q
    q = np.round(q) if np.max(factor) > 1000.0 else q
    path = table(tmp_path / "run.csv", time=motion.t, pos=q, trq=motion.tau)
    got, said = reading(path, problem)
    assert "q in " not in said
    np.testing.assert_allclose(got.q, q)
