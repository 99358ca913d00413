"""The verb ``convert``: measurements of another program, for the robot of a problem."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from sdp_vs_penalty.data.datasets import to_joints
from sdp_vs_penalty.data.files import read_run, save
from sdp_vs_penalty.data.formats.csv import read_headerless
from sdp_vs_penalty.data.formats.recognition import scaled
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.joint import Transmission, parse_transmission


def convert(
    source: str | Path,
    out: str | Path | None = None,
    *,
    problem: str | Path | Problem | None = None,
    joints: Sequence[str] | None = None,
    topic: str | None = None,
    rename: Mapping[str, str] | None = None,
    motors: str | Sequence[str] | bool = False,
    rate: float | None = None,
    scale: Mapping[str, str] | None = None,
) -> Measurements:
    """Read measurements of another program, and write them in the format of ``out``'s suffix.

    source : a .csv, .npz, .mat, .parquet, .mcap or .bag file, or a ROS 2 bag's folder; out : .csv, .npz,
        .parquet or .mat (default: nothing is written).
    problem : the robot whose joint names choose the joints of a ROS bag; joints : these names, instead.
    topic : the JointState topic, where a bag has several; rename : from t, q, dq, tau (or q1, ...) to
        the names of the file's columns or variables.
    motors : the channels were logged at the motors: each motor's position as a formula of the joints'
        ("32 q5 + 32 q6"), several separated by commas or in a sequence, or True for the transmission of
        ``problem``. The run is written on the joint side, which is what every other verb reads.
        Columns of common loggers are recognised without it; ``{"q*": "actual_q_*"}`` names one a joint.
    scale : what t, q, dq, tau are multiplied by: a unit (deg, ms, mNm), a number, or numbers joint by
        joint separated by colons, as drive gains are.
    rate : of a table without header and clock [Hz]: 3 n columns, q1..qn, dq1..dqn, tau1..taun.
    Raises InputError for a file that cannot be read, or columns that are missing.
    """
    if joints is None and problem is not None:
        joints = as_problem(problem, "convert(problem=...)").robot.joint_names
    transmission = _transmission(motors, problem)
    run = read_headerless(source, rate) if rate else read_run(source, None, joints, topic, rename)
    if scale:
        run = scaled(run, scale)
    if transmission is not None:
        run = to_joints(run, transmission)
    if out is not None:
        save(run, out)
    return run


def _transmission(
    motors: str | Sequence[str] | bool, problem: str | Path | Problem | None
) -> Transmission | None:
    if motors is False:
        return None
    if motors is not True:
        return parse_transmission(motors.split(",") if isinstance(motors, str) else motors)
    found = None if problem is None else as_problem(problem).robot.transmission
    if found is None:
        raise InputError(
            "no transmission is known",
            "name a problem that has one, or write each motor's position, such as 50 q1,30 q2",
            "convert(motors=True)",
        )
    return found
