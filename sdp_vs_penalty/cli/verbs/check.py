from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sdp_vs_penalty.errors import InputError

if TYPE_CHECKING:
    from sdp_vs_penalty.checks.report import Report


def verb(
    data: list[Path],
    problem: str,
    gravity: str | None = None,
    hold: str | None = None,
    json_: Path | None = None,
    fix: Path | None = None,
    apply: list[str] | None = None,
) -> None:
    """Check measurements before identification: units, signs, order, gravity, clock, noise, excitation.

    Exit code 1 where nothing sensible can be identified: a fact of the file says so.
    Example: sdp-vs-penalty check run.csv --problem panda --fix mended.csv

    --json out.json: JSON file for the findings.
    data RUN.csv ...: Runs to check.
    --problem: Built-in name, folder with a problem.toml, or URDF file.
    --fix fixed.csv: Repaired copy to write (and beside it what was changed), or a folder.
    --apply sign:tau3 ...: Explanations to repair as well, by their words.
    """
    from sdp_vs_penalty.checks import check_runs
    from sdp_vs_penalty.checks.fixing import fix_runs
    from sdp_vs_penalty.cli import console, printing
    from sdp_vs_penalty.cli.runs import problem_from_options, read_and_hold
    from sdp_vs_penalty.data.files import for_testing, read_run, run_files, save
    from sdp_vs_penalty.data.measurements import Measurements
    from sdp_vs_penalty.files import write_text

    data = [file for path in data for file in run_files(path)]
    if apply and fix is None:
        raise InputError("--apply: nothing to write", "name the copy with --fix")
    if fix is not None and len(data) > 1 and fix.suffix:
        raise InputError(
            f"--fix {fix}: {len(data)} runs are given", "name a folder for their copies"
        )
    if fix is not None and any(path.resolve() == fix.resolve() for path in data):
        raise InputError(
            f"--fix {fix}: this is the file that is checked", "choose another name"
        )
    with console.progress("checking") as progress:
        robot, measured, hold = read_and_hold(
            lambda held: problem_from_options(problem, gravity, hold=held),
            hold,
            lambda of: [
                read_run(path, of.robot.n, of.robot.joint_names) for path in data
            ],
        )
        runs = [run for run in measured if isinstance(run, Measurements)]
        progress(f"judging {len(runs)} runs" if len(runs) > 1 else data[0].name)
        reports = check_runs(robot, runs, robot.preprocessing)
    printing.checks(reports)
    mounting = [] if gravity is None else ["--gravity", gravity]
    mounting += [] if hold is None else ["--hold", hold]
    words = [*data, "--problem", problem, *mounting]
    meaningless = any(report.meaningless for report in reports)
    content = {"problem": robot.name, "runs": [r.to_dict() for r in reports]}
    console.save_json(json_, content)
    if fix is not None:
        too_long = [path for path, r in zip(data, reports, strict=True) if r.is_long]
        if too_long:
            remedy = "cut it into files of 250 000 rows"
            raise InputError("--fix: too long to be repaired", remedy, too_long[0])
        repaired = fix_runs(robot, runs, reports, apply or [])
        console.say(repaired.sentence)
        folder = len(data) > 1 or not fix.suffix or fix.is_dir()
        copies = [fix / f"{path.stem}.csv" if folder else fix for path in data]
        each = zip(data, reports, copies, repaired.runs, repaired.issues, strict=True)
        for path, report, copy, run, done in each:
            save(run, copy)
            console.written(copy)
            note = copy.with_name(f"{copy.stem}_changes.txt")
            write_text(note, report.changes(path.name, done))
            console.written(note)
        console.next_step(["check", *copies, "--problem", problem, *mounting])
    elif (repair_words := _repair_words(reports)) is not None:
        fixed_file = data[0].with_name(
            f"{data[0].stem}_fixed.csv" if len(data) == 1 else "fixed"
        )
        console.next_step(["check", *words, "--fix", fixed_file, *repair_words])
    elif not meaningless:
        train = [path for path in data if not for_testing(path)] or data
        console.next_step(
            ["identify", problem, "--data", *train, *mounting, "--out", "model.json"]
        )
    if meaningless:
        raise SystemExit(1)


def _repair_words(reports: Sequence[Report]) -> list[str] | None:
    """What --fix needs besides: explanations are repaired by their words only. None
    where there is nothing to repair."""
    issues = [issue for report in reports for issue in report.errors_and_warnings]
    named = list(dict.fromkeys(issue.apply for issue in issues if issue.apply))
    if named:
        return ["--apply", *named]
    return [] if any(issue.mends for issue in issues) else None
