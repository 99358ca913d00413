"""The runs that a model is fitted to and tested on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sdp_vs_penalty import formatting
from sdp_vs_penalty.cli import console
from sdp_vs_penalty.data.files import (
    as_measurements,
    load_measurements,
    run_files,
    windowed,
)
from sdp_vs_penalty.data.measurements import Measurements, Runs, concatenate
from sdp_vs_penalty.data.parsing import numbers, time_windows
from sdp_vs_penalty.data.plausibility import check_plausible, find_idle_joints
from sdp_vs_penalty.data.recorded import NamedRuns as NamedRuns
from sdp_vs_penalty.data.recorder import Recorder
from sdp_vs_penalty.errors import InputError, MissingJoints, command_line
from sdp_vs_penalty.estimation.estimate import Estimate, load_estimate
from sdp_vs_penalty.problem.load import load_problem, with_bounds, with_filters
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.black_box import BlackBox, load_answers
from sdp_vs_penalty.robot.joint import parse_held

if TYPE_CHECKING:
    from sdp_vs_penalty.checks.gate import Gate
    from sdp_vs_penalty.problem.check_command import CheckCommand


def gate(command: CheckCommand | None) -> Gate:
    """Return what a terminal hears of the check before a verb, and the ways on."""
    from sdp_vs_penalty.checks.gate import Gate  # which most verbs do not need

    return Gate(console.warn, "pass --no-check to", command)


def problem_from_options(
    source: str,
    gravity: str | None = None,
    bounds: str | None = None,
    filters: str | None = None,
    hold: str | None = None,
) -> Problem:
    """Load a problem with the options --gravity, --bounds, --filters and --hold
    applied.

    The options are texts as the user wrote them.
    """
    mounting = None if gravity is None else numbers("--gravity", gravity, 3)
    problem = load_problem(source, mounting, parse_held(hold) if hold else None)
    return with_filters(with_bounds(problem, bounds), filters)


def read_and_hold(
    make: Callable[[str | None], Problem],
    hold: str | None,
    read: Callable[[Problem], Sequence[Measurements | BlackBox]],
) -> tuple[Problem, Sequence[Measurements | BlackBox], str | None]:
    """Read runs, and hold the joints that do not move in any of them.

    A joint that the runs lack, or that stands still without torque in all of them,
    becomes fixed: its link belongs to its parent. One line on stderr says so.

    Parameters
    ----------
    make : callable
        Makes the problem from the text of --hold.
    hold : str or None
        That text as the user wrote it.
    read : callable
        Reads the runs for a problem.

    Returns
    -------
    Problem, sequence of runs, str or None
        The last is the text of --hold with the joints that were found.
    """
    problem = make(hold)
    try:
        runs = read(problem)
        idle = _idle_in_all(problem, runs)
        if not idle:
            return problem, runs, hold
        why = "stands still without torque", "stand still without torque"
    except MissingJoints as error:
        idle = dict.fromkeys(error.joints, 0.0)
        why = "is in no column", "are in no column"
    held = ",".join(f"{name}={value:.6g}" for name, value in idle.items())
    links = "its link belongs to its parent", "their links belong to their parents"
    are_many = len(idle) > 1
    console.warn(
        f"{formatting.words(list(idle))} {why[are_many]}: held, {links[are_many]};"
        f" the same by `--hold {command_line([held])}`"
    )
    hold = f"{hold},{held}" if hold else held
    problem = make(hold)
    return problem, read(problem), hold


def _idle_in_all(
    problem: Problem, runs: Sequence[Measurements | BlackBox]
) -> dict[str, float]:
    """Return the joints that stand still without torque in all runs, with positions.

    A black box's answers have no motion, so no joint is idle then.
    """
    idle_by_run = [
        find_idle_joints(problem.robot, run) if isinstance(run, Measurements) else {}
        for run in runs
    ]
    if not idle_by_run:
        return {}
    return {
        name: position
        for name, position in idle_by_run[0].items()
        if all(name in idle for idle in idle_by_run)
    }


def runs_from_options(
    problem: Problem, named: NamedRuns
) -> tuple[Measurements | BlackBox, Measurements | BlackBox]:
    """Load the runs, or a black box's answers, of the option --data.

    Returns
    -------
    two Measurements or BlackBox
        The full runs, and what --window leaves of them.
    """
    windows = time_windows(named.window)
    n = problem.robot.n
    runs = load_answers(list(named.files), joints=n) or load_measurements(
        *named.files, joints=n, names=problem.channel_names, as_written=named.as_written
    )
    if not isinstance(runs, Measurements):  # answers have no time
        return runs, runs
    return runs, windowed(runs, windows)


def model_from_options(
    path: Path,
    gravity: str | None = None,
    gain_uncertainty: float | None = None,
    load: Callable[[Path], Estimate] = load_estimate,
) -> Estimate:
    """Load a model, with what --gravity and --gain-uncertainty say of it."""
    estimate = load(path)
    if gravity is not None:
        estimate = estimate.with_gravity(numbers("--gravity", gravity, 3))
    if gain_uncertainty is not None:
        estimate = estimate.with_gain_uncertainty(gain_uncertainty)
    return estimate


def judging_runs(
    estimate: Estimate,
    data: list[Path] | None,
    window: str | None,
    test: NamedRuns | None = None,
) -> Runs | None:
    """Return the runs to judge a model on: those of --test or --data, or those it was
    judged on last.

    None if the latter no longer exist.
    """
    named = test if data is None else NamedRuns(data, window)
    named = named or NamedRuns.recorded(estimate.provenance.get("judged_data", ()))
    return None if named is None else runs_for(estimate, named, test)


def named_test(
    test: Path | None, window: str | None, *, as_written: bool
) -> NamedRuns | None:
    """Return the run of --test, and the window of it that counts; None without --test.

    as_written : whether it is read without any guess of its units, as --data is. Raises
    InputError for a window without a run.
    """
    if test is None and window is not None:
        remedy = "name the run that it is a part of with --test"
        raise InputError(f"--test-window {window!r}", remedy)
    return None if test is None else NamedRuns([test], window, as_written)


def runs_for(
    estimate: Estimate, data: NamedRuns, test: NamedRuns | None = None
) -> Runs:
    """Load the runs to fit, and the run to test on, and check that they suit the model.

    Verbs that fit replace a folder by its runs to train on first. A folder that is left
    is judged on as a whole, and its runs are named on stderr.

    Parameters
    ----------
    estimate : Estimate
        The model; the runs need its number of joints and plausible positions.
    test : NamedRuns, optional
        Run to test on; without it the runs to fit are judged on as well.
    """
    robot = estimate.robot
    train = time_windows(data.window)
    judge = time_windows(test.window if test else None, "--test-window")

    for folder in filter(Path.is_dir, data.files):
        files = [file.name for file in run_files(folder)]
        if len(files) > 1:
            console.warn(f"{folder}: judged on {formatting.words(files)}")

    def loaded(named: NamedRuns, recorders: Sequence[Recorder] = ()) -> Measurements:
        runs = as_measurements(
            [*named.files],
            names=estimate.problem.channel_names,
            as_written=named.as_written,
            recorders=recorders,
        )
        estimate.require_joints(runs, runs.names[0])
        check_plausible(robot, runs)
        return runs

    measured = loaded(data)
    if test is None:
        return Runs(windowed(measured, train), None, measured, measured)
    tested = loaded(test, measured.recorders)
    if tested.data_hash in {run.data_hash for run in measured.runs()}:
        all_runs = measured
    else:
        all_runs = concatenate([measured, tested])
    return Runs(windowed(measured, train), windowed(tested, judge), all_runs, tested)
