"""The factors of many recordings: every file read and compressed by one worker, then merged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path

from sdp_vs_penalty.data.files import load_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.parallel import spread
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.regression.regression import Regression, compress
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.preprocessing import Preprocessing


@dataclass(frozen=True)
class _File:
    """One file to compress: place counts the files, so that they merge in their own order."""

    place: int
    path: str
    problem: str
    effects: str | None
    settings: Preprocessing


def compress_files(
    problem: str,
    files: Sequence[str | Path],
    effects: str | None = None,
    settings: Preprocessing | None = None,
    scheduler: str | None = None,
    jobs: int = 2,
) -> Regression:
    """The factors of many recordings, each file read and compressed by one worker, then merged.

    problem : a name, folder or URDF file that every worker can open; effects as on the command line.
    The filters are those of the file that needs the lowest cut-offs, for all files alike.
    """
    if not files:
        raise InputError("compress_files: no files are given", "name one or more")
    robot = load_problem(problem)
    start = settings or robot.preprocessing
    items = [_File(k, str(f), problem, effects, start) for k, f in enumerate(files)]
    if len(items) > 1 or start.state_cutoff is None or start.torque_cutoff is None:
        found = list(spread(_resolved, items, scheduler, jobs))
        state = min(s.state_cutoff for s in found if s.state_cutoff is not None)
        torque = min(s.torque_cutoff for s in found if s.torque_cutoff is not None)
        common = replace(start, state_cutoff=state, torque_cutoff=torque)
        items = [replace(item, settings=common) for item in items]
    parts = sorted(spread(_compressed, items, scheduler, jobs), key=lambda part: part[0])
    return reduce(lambda a, b: a.merge(b), (regression for _, regression in parts))


def _resolved(item: _File) -> Preprocessing:
    robot = load_problem(item.problem).robot
    return item.settings.resolve(_run(item, robot))


def _compressed(item: _File) -> tuple[int, Regression]:
    problem = load_problem(item.problem)
    run = _run(item, problem.robot)
    return item.place, compress(run, problem.model(item.effects), item.settings)


def _run(item: _File, robot: Robot) -> Measurements:
    return load_measurements(item.path, joints=robot.n, names=[joint.name for joint in robot.joints])
