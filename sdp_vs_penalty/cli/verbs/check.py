from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from sdp_vs_penalty import formatting
from sdp_vs_penalty.cli import console
from sdp_vs_penalty.errors import InputError

if TYPE_CHECKING:
    from sdp_vs_penalty.checks.report import Report
    from sdp_vs_penalty.data.measurements import Measurements
    from sdp_vs_penalty.problem.problem import Problem
    from sdp_vs_penalty.race.race import HeldRaces


def verb(
    problem: str,
    data: list[Path],
    gravity: str | None = None,
    hold: str | None = None,
    json_: Path | None = None,
    fix: Path | None = None,
    apply: list[str] | None = None,
    as_written: bool = False,
) -> None:
    """Check measurements before identification: units, signs, order, gravity, clock, noise, excitation.

    Exit code 1 where nothing sensible can be identified: a fact of the file says so.
    Example: sdp-vs-penalty check panda --data run.csv --fix fixed.csv

    --json out.json: JSON file for the findings.
    --fix fixed.csv: Repaired copy to write (and beside it what was changed), or a folder.
    --apply sign:tau3 ...: Explanations to repair as well, by their words.
    """
    from sdp_vs_penalty.api.remedies import Files, next_command
    from sdp_vs_penalty.checks.report import list_remedies
    from sdp_vs_penalty.cli import printing
    from sdp_vs_penalty.data.files import run_files
    from sdp_vs_penalty.problem.check_command import CheckCommand
    from sdp_vs_penalty.race.race import HeldRaces
    from sdp_vs_penalty.records import to_json

    files = [file for path in data for file in run_files(path)]
    _refuse(files, fix, apply)
    races = HeldRaces()
    robot, runs, reports, hold = _read_and_check(
        files, problem, gravity, hold, races, as_written=as_written
    )
    command = CheckCommand(
        problem=problem,
        runs=files,
        hold=hold,
        gravity=gravity,
        joints=runs[0].joint_names if runs else (),
    )
    printing.checks(reports, command)
    content = {
        "problem": robot.name,
        "columns": [run.reading for run in runs],
        "runs": [r.to_dict() for r in reports],
        "remedies": to_json(list_remedies(reports)),
    }
    console.save_json(json_, content)
    copies = None
    if fix is not None:
        copies = _write_copies(robot, files, runs, reports, fix, apply or [], races)
    meaningless = any(report.meaningless for report in reports)
    if copies is not None:
        console.next_step(replace(command, runs=copies).words)
    elif (words := next_command(list_remedies(reports), Files(command))) is not None:
        console.next_step(words)
    elif not meaningless:
        issues = [issue for report in reports for issue in report.by_cause]
        # A model of torques in another unit would have wrong masses.
        if not any(issue.is_torque_unit for issue in issues):
            _say_identify(files, problem, command.options)
    if meaningless:
        raise SystemExit(1)


def _refuse(files: Sequence[Path], fix: Path | None, apply: list[str] | None) -> None:
    """Raise InputError for options that exclude each other."""
    if fix is None:
        if apply:
            raise InputError("--apply: nothing to write", "name the copy with --fix")
        return
    if len(files) > 1 and fix.suffix:
        raise InputError(
            f"--fix {fix}: {len(files)} runs are given",
            "name a folder for their copies",
        )
    if any(path.resolve() == fix.resolve() for path in files):
        raise InputError(
            f"--fix {fix}: this is the file that is checked", "choose another name"
        )


def _read_and_check(
    files: Sequence[Path],
    problem: str,
    gravity: str | None,
    hold: str | None,
    races: HeldRaces,
    *,
    as_written: bool,
) -> tuple[Problem, list[Measurements], Sequence[Report], str | None]:
    """Read the runs and check them.

    Returns the problem, its runs, a report for each run, and the text of --hold with
    the joints that stand still.
    """
    from sdp_vs_penalty.checks import check_runs
    from sdp_vs_penalty.cli.runs import problem_from_options, read_and_hold
    from sdp_vs_penalty.data.files import read_run
    from sdp_vs_penalty.data.measurements import Measurements
    from sdp_vs_penalty.data.recorder import Recorder
    from sdp_vs_penalty.data.together import read_by_recorder, require_runs

    def read(robot: Problem) -> list[Measurements]:
        joints, n = robot.channel_names, robot.robot.n

        def read_one(place: int, told: Sequence[Recorder]) -> Measurements:
            return read_run(
                files[place], n, joints, as_written=as_written, recorders=told
            )

        return require_runs(read_by_recorder(read_one, len(files)))

    with console.progress("checking") as progress:
        robot, measured, hold = read_and_hold(
            lambda held: problem_from_options(problem, gravity, hold=held), hold, read
        )
        runs = [run for run in measured if isinstance(run, Measurements)]
        progress(f"judging {len(runs)} runs" if len(runs) > 1 else files[0].name)
        return robot, runs, check_runs(robot, runs, races=races), hold


def _write_copies(
    robot: Problem,
    files: Sequence[Path],
    runs: Sequence[Measurements],
    reports: Sequence[Report],
    fix: Path,
    apply: Sequence[str],
    races: HeldRaces,
) -> list[Path] | None:
    """Write a repaired copy of each run, and a text file of what was changed.

    Returns the paths of the copies; None for runs without a problem, of which no copy
    is written. Raises InputError where problems were found, and none can be repaired.
    """
    from sdp_vs_penalty.checks.fixing import fix_runs
    from sdp_vs_penalty.data.files import save
    from sdp_vs_penalty.files import write_text

    for path, report in zip(files, reports, strict=True):
        if report.is_long:
            remedy = "cut it into files of 250 000 rows"
            raise InputError("--fix: too long to be repaired", remedy, path)
    repaired = fix_runs(robot, runs, reports, apply, races)
    if not any(repaired.issues):
        _refuse_unrepaired(reports, fix)
        console.say(f"{repaired.sentence} No copy was written.")
        return None
    console.say(repaired.sentence)
    is_folder = len(files) > 1 or not fix.suffix or fix.is_dir()
    copies = [fix / f"{path.stem}.csv" if is_folder else fix for path in files]
    for path, report, copy, run, done in zip(
        files, reports, copies, repaired.runs, repaired.issues, strict=True
    ):
        save(run, copy)
        console.written(copy)
        note = copy.with_name(f"{copy.stem}_changes.txt")
        write_text(note, report.changes(path.name, done))
        console.written(note)
    return copies


def _refuse_unrepaired(reports: Sequence[Report], fix: Path) -> None:
    """Raise InputError if no problem was repaired: the copy would have all of them."""
    problems = [issue for report in reports for issue in report.errors_and_warnings]
    if not problems:
        return
    kinds = formatting.words(list(dict.fromkeys(issue.kind for issue in problems)))
    what = f"--fix {fix}: the program cannot repair this ({kinds})"
    remedy = "see what to do above"
    if words := list(dict.fromkeys(issue.apply for issue in problems if issue.apply)):
        what = f"--fix {fix}: repairs unasked only what is safe ({kinds})"
        remedy = f"name it with --apply {' '.join(words)}"
    raise InputError(what, f"{remedy}; nothing was written")


def _say_identify(files: Sequence[Path], problem: str, options: Sequence[str]) -> None:
    """Print the command that identifies from all runs except those for testing, and the
    last of several: a model is judged by what it has not seen."""
    from sdp_vs_penalty.cli.next_step import free_name
    from sdp_vs_penalty.cli.runs import NamedRuns
    from sdp_vs_penalty.data.files import for_testing

    named = [path for path in files if not for_testing(path)] or files
    train = [path for path in named if path != files[-1]] or named
    if kept := [path.name for path in files if path not in train]:
        console.say(f"Kept unseen, to judge the model: {formatting.words(kept)}.")
    words = ["--data", *NamedRuns(train).words, *options]
    words += ["--out", str(free_name("model.json"))]
    console.next_step(["identify", problem, *words])
