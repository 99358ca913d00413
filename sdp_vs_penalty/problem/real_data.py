"""The real measurements that the tables use where they are at hand; never replaced silently."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.datasets import DATA_VARIABLE as VARIABLE
from sdp_vs_penalty.data.files import load_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.arrays import Array


def real_data_folder() -> Path | None:
    """The folder that SDP_VS_PENALTY_DATA names, else shared/data beside a checkout, else None.

    Raises InputError where the variable names a folder that does not exist.
    """
    named = os.environ.get(VARIABLE)
    if named:
        folder = Path(named)
        if not folder.is_dir():
            raise InputError(f"{VARIABLE} names {named}, which is not a folder", "correct or unset it")
        return folder
    checkout = Path(__file__).parents[2]
    folder = checkout.parent / "shared" / "data"
    return folder if (checkout / "pyproject.toml").is_file() and folder.is_dir() else None


def real_file(problem: str, name: str) -> Path | None:
    """One of the files about a robot, None without it."""
    folder = real_data_folder()
    file = None if folder is None else folder / problem / name
    return file if file is not None and file.is_file() else None


def measured_run(problem: Problem) -> Measurements | None:
    """The authors' identification run of a robot (their four text files), or None without it."""
    file = real_file(problem.name, "exciting_traj_time.txt")
    return None if file is None else load_measurements(file.parent, joints=problem.robot.n)


def commanded_coefficients(problem: Problem) -> tuple[Array, Array] | None:
    """a, b (n, L) of the trajectory that the authors' generator commanded, or None without its file.

    Raises InputError where gen_params.txt has not two rows a joint.
    """
    file = real_file(problem.name, "gen_params.txt")
    if file is None:
        return None
    n = problem.robot.n
    try:
        rows = np.loadtxt(file, ndmin=2)
    except ValueError as error:
        raise InputError(
            f"not rows of numbers ({error})", "give each row as many numbers", file
        ) from error
    if len(rows) != 2 * n:
        raise InputError(f"{len(rows)} rows instead of {2 * n}", "give a and b of each joint", file)
    return rows[:n], rows[n:]
