from pathlib import Path

from sdp_vs_penalty.errors import InputError, printable


def verb(
    data: list[Path],
    problem: str,
    gravity: str | None = None,
    hold: str | None = None,
    json_: Path | None = None,
    fix: Path | None = None,
) -> None:
    """Check measurements before identification: units, signs, order, gravity, clock, noise, excitation.

    Exit code 1 where an identification would be meaningless.
    Example: sdp-vs-penalty check run.csv --problem panda --fix mended.csv

    --json out.json: JSON file for the findings.
    data RUN.csv ...: Runs to check.
    --problem: Built-in name, folder with a problem.toml, or URDF file.
    --fix fixed.csv: Repaired copy to write (and beside it what was changed), or a folder.
    """
    from rich.markup import escape

    from sdp_vs_penalty.checks import check, of_one_arm
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.cli.runs import problem_from_options, read_and_hold
    from sdp_vs_penalty.data.files import for_testing, read_run, run_files, save
    from sdp_vs_penalty.data.measurements import Measurements
    from sdp_vs_penalty.files import write_text

    data = [file for path in data for file in run_files(path)]
    if fix is not None and len(data) > 1 and fix.suffix:
        raise InputError(
            f"--fix {fix}: {len(data)} runs are given", "name a folder for their copies"
        )
    if fix is not None and any(path.resolve() == fix.resolve() for path in data):
        raise InputError(
            f"--fix {fix}: this is the file that is checked", "choose another name"
        )
    reports = []
    with console.progress("checking") as progress:
        robot, measured, hold = read_and_hold(
            lambda held: problem_from_options(problem, gravity, hold=held),
            hold,
            lambda of: [
                read_run(path, of.robot.n, of.robot.joint_names) for path in data
            ],
        )
        for run in measured:
            assert isinstance(run, Measurements)
            progress(run.names[0])
            reports += check(robot, run)
    reports = of_one_arm(reports)
    colours = {"error": "red", "warning": "yellow", "note": "dim"}
    for report in reports:
        console.say(report.verdict, style="bold")
        for f in report.issues:
            word = f"[{colours[f.severity]}]{f.severity}[/]"
            console.out.print(
                f"  {word} {escape(printable(f.kind))} ({escape(printable(f.where))})"
            )
            fixed = " (--fix does it)" if f.mends else ""
            for text in (
                f.what,
                f"How sure: {f.certainty}.",
                f"What to do: {f.remedy}{fixed}.",
            ):
                console.say(f"    {text}")
    mounting = [] if gravity is None else ["--gravity", gravity]
    mounting += [] if hold is None else ["--hold", hold]
    meaningless = any(report.meaningless for report in reports)
    if fix is not None:
        too_long = [path for path, r in zip(data, reports, strict=True) if r.is_long]
        if too_long:
            remedy = "cut it into files of 250 000 rows"
            raise InputError("--fix: too long to be repaired", remedy, too_long[0])
        folder = len(data) > 1 or not fix.suffix or fix.is_dir()
        copies = [fix / f"{path.stem}.csv" if folder else fix for path in data]
        for path, report, copy in zip(data, reports, copies, strict=True):
            save(report.repaired_certain, copy)
            console.written(copy)
            note = copy.with_name(f"{copy.stem}_changes.txt")
            write_text(note, report.changes(path.name))
            console.written(note)
    console.save_json(
        json_, {"problem": robot.name, "runs": [r.to_dict() for r in reports]}
    )
    if fix is not None:
        console.next_step(["check", *copies, "--problem", problem, *mounting])
    elif any(f.mends for report in reports for f in report.errors_and_warnings):
        fixed_file = data[0].with_name(
            f"{data[0].stem}_fixed.csv" if len(data) == 1 else "fixed"
        )
        console.next_step(
            ["check", *data, "--problem", problem, *mounting, "--fix", fixed_file]
        )
    elif not meaningless:
        train = [path for path in data if not for_testing(path)] or data
        console.next_step(
            ["identify", problem, "--data", *train, *mounting, "--out", "model.json"]
        )
    if meaningless:
        raise SystemExit(1)
