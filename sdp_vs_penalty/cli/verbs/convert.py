from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from warnings import catch_warnings, warn

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.data.parsing import pairs, time_windows
from sdp_vs_penalty.errors import InputError, Remark

if TYPE_CHECKING:
    from sdp_vs_penalty.data.measurements import Measurements
    from sdp_vs_penalty.problem.check_command import CheckCommand
    from sdp_vs_penalty.problem.problem import Problem


def verb(
    source: Path,
    out: Path,
    problem: str | None = None,
    joints: str | None = None,
    topic: str | None = None,
    rename: str | None = None,
    scale: str | None = None,
    motors: str | None = None,
    motor_side: bool = False,
    joint_torque: bool = False,
    rate: float | None = None,
    cut: str | None = None,
    hold: str | None = None,
) -> None:
    """Convert measurements of another program: MATLAB, Parquet, ROS 2 bags and MCAP (JointState).

    Logs of motors become those of joints by their transmission (--motors, --motor-side).
    With --problem it says what of units and stamps the arm has to decide. Exit code 1 as
    `check`: the file is written, but nothing sensible can be identified from it.

    Example: sdp-vs-penalty convert rosbag2_folder --problem robot.urdf --out run.csv

    source IN: File (.csv .npz .npy .parquet .mat .jsonl .mcap .bag), files of one run
        (a.csv+b.csv), or a ROS 2 bag's folder.
    --out out.csv|.npz|.parquet|.mat: File to write; the suffix chooses the format.
    --problem: Robot whose joint names choose the joints of a ROS bag.
    --joints a,b,c: Joint names of a ROS bag, in the order wanted.
    --topic: JointState topic, where a ROS bag has several.
    --rename t=time,q*=pos_*: Columns that are t, q, dq, tau (or q1 ...); common loggers' are recognised.
    --scale, --units q=deg,tau=10:10.7:8.5: Units (deg, ms, mNm), factors, or one a joint (drive gains);
        of raw counts FACTOR@ZERO.
    --motors '50 q1,32 q2+32 q1': Motor positions by joint positions, for a log of motor positions and
        torques.
    --joint-torque: The torques are the joints' already; --motors is of the positions alone.
    --motor-side: The problem's transmission, for a log of motors.
    --cut 6:7.1,20:21: Spans [s] that are left out, by the run's clock, a quarter of a second on either
        side with them.
    --rate HZ: Samples a second, for a log without a clock (without a header: q1.., dq1.., tau1..).
    """
    from sdp_vs_penalty import formatting
    from sdp_vs_penalty.cli.runs import problem_from_options
    from sdp_vs_penalty.data.measurements import columns_of
    from sdp_vs_penalty.problem.check_command import CheckCommand
    from sdp_vs_penalty.problem.load import columns_note, convert, convert_options

    robot: str | Problem | None = problem
    if problem is not None and hold is not None:
        robot = problem_from_options(problem, hold=hold)
    names = joints.split(",") if joints else None
    sides = motor_side if motors is None else motors
    run = convert(
        source,
        out,
        problem=robot,
        joints=names,
        topic=topic,
        rename=pairs("--rename", rename),
        motors=sides,
        joint_torque=joint_torque,
        rate=rate,
        scale=pairs("--scale", scale),
        cut=[] if cut is None else time_windows(cut, "--cut"),
        options=convert_options(problem, topic, sides, hold, joint_torque=joint_torque),
    )
    velocity = "" if run.dq is None else ", velocities"
    # As they are written, so that a wrong column or unit is seen.
    for name, column in columns_of(run.rows(slice(0, 5))).items():
        console.say(f"  {name:<6} " + " ".join(f"{x:>11.5g}" for x in column))
    console.written(
        out, f"{len(run.t)} samples of {formatting.count(run.n, 'joint')}{velocity}"
    )
    if run.reading:
        console.written(columns_note(out), "what the columns were taken for")
    if robot is not None and problem is not None:
        command = CheckCommand(problem=problem, runs=[out], hold=hold)
        words, is_usable = _what_is_open(robot, run, command)
        console.next_step(words or command.words)
        if not is_usable:
            raise SystemExit(1)


def _what_is_open(
    robot: str | Problem, run: Measurements, command: CheckCommand
) -> tuple[list[str] | None, bool]:
    """Say what the arm decides of units and stamps that the file leaves open, as `check`
    says it.

    Returns the command that mends it, None where there is none; and whether the file is
    free of errors.
    """
    from sdp_vs_penalty.api.remedies import Files, next_command
    from sdp_vs_penalty.checks import check_runs
    from sdp_vs_penalty.checks.report import list_remedies
    from sdp_vs_penalty.cli import printing
    from sdp_vs_penalty.data.files import read_run
    from sdp_vs_penalty.problem.load import as_problem

    if run.unit_command and "UNIT" not in run.unit_command:  # the reading has said why
        return [*shlex.split(run.unit_command)[1:-1], str(command.runs[0])], False
    try:
        known = as_problem(robot)
        # As `check` reads it, which may tell more of what has our names.
        copy = read_run(command.runs[0], known.robot.n, known.channel_names)
        copy = replace(copy, unit_command=run.unit_command, torque_unit=run.torque_unit)
        with catch_warnings(action="ignore"):
            (report,) = check_runs(known, [copy])
    except InputError as error:
        warn(Remark(str(error)), stacklevel=2)
        return None, False
    issues = report.errors_and_warnings
    if not report.meaningless:
        issues = tuple(x for x in issues if x.is_torque_unit)
    if not issues:
        return None, True
    remedies = list_remedies([replace(report, issues=issues)])
    words = next_command(remedies, Files(command))
    open_columns = tuple(
        x
        for x in issues
        if x.severity == "error" or x.is_torque_unit or x.apply in (words or ())
    )
    printing.checks([replace(report, issues=open_columns)], command)
    return words, not report.meaningless
