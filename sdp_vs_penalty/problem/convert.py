"""The verb ``convert``: measurements of another program, for the robot of a problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from sdp_vs_penalty.data.files import read_run, save
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem


def convert(
    source: str | Path,
    out: str | Path | None = None,
    *,
    problem: str | Path | Problem | None = None,
    joints: Sequence[str] | None = None,
    topic: str | None = None,
    rename: Mapping[str, str] | None = None,
) -> Measurements:
    """Read measurements of another program, and write them in the format of ``out``'s suffix.

    source : a .csv, .npz, .mat, .parquet, .mcap or .bag file, or a ROS 2 bag's folder; out : .csv, .npz,
        .parquet or .mat (default: nothing is written).
    problem : the robot whose joint names choose the joints of a ROS bag; joints : these names, instead.
    topic : the JointState topic, where a bag has several; rename : from t, q, dq, tau (or q1, ...) to
        the names of the file's columns or variables.
    Raises InputError for a file that cannot be read, or columns that are missing.
    """
    if joints is None and problem is not None:
        joints = as_problem(problem, "convert(problem=...)").robot.joint_names
    run = read_run(source, None, joints, topic, rename)
    if out is not None:
        save(run, out)
    return run
