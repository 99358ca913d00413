"""The verb check: measurements before identification."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdp_vs_penalty.cli.arguments import numbers
from sdp_vs_penalty.cli.options import Debug
from sdp_vs_penalty.errors import InputError

if TYPE_CHECKING:
    from sdp_vs_penalty.check import Report


def verb(
    data: Annotated[list[Path], typer.Argument(metavar="RUN.csv ...", help="The runs to check.")],
    problem: Annotated[
        str, typer.Option(help="A built-in name, a folder with a problem.toml, or a URDF file.")
    ],
    gravity: Annotated[
        str | None, typer.Option(metavar="x,y,z", help="Gravity in the base frame, m/s^2.")
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="out.json", help="Write the findings to this file.")
    ] = None,
    fix: Annotated[
        Path | None,
        typer.Option(
            metavar="fixed.csv",
            help="Write a mended copy (a folder for several runs); data stay as they are.",
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """Check measurements before identification: units, signs, order, gravity, clock, noise, excitation.

    Exit code 1 where to identify would be meaningless.
    Example: sdp-vs-penalty check run.csv --problem panda --fix mended.csv
    """
    from sdp_vs_penalty.check import check
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.data.files import read_run, save
    from sdp_vs_penalty.files import write_text
    from sdp_vs_penalty.problem.load import load_problem

    robot = load_problem(problem, None if gravity is None else numbers("--gravity", gravity, 3))
    if fix is not None and len(data) > 1 and fix.suffix:
        raise InputError(f"--fix {fix}: {len(data)} runs are given: name a folder for their copies.")
    if fix is not None and any(path.resolve() == fix.resolve() for path in data):
        raise InputError(f"--fix {fix}: this is the file that is checked: choose another name.")
    reports = []
    with console.progress("checking") as progress:
        for path in data:
            progress(path.name)
            run = read_run(path, robot.robot.n, [j.name for j in robot.robot.joints])
            reports += check(robot, run)
    if json_file is not None:
        content = {"problem": robot.name, "runs": [r.to_dict() for r in reports]}
        write_text(json_file, json.dumps(content, indent=1) + "\n")
    for path, report in zip(data, reports, strict=True):
        _show(report)
        if fix is not None:
            target = fix if len(data) == 1 else fix / f"{path.stem}.csv"
            save(report.mended, target)
            console.out.print(f"written: {target}", markup=False, soft_wrap=True)
    if any(report.meaningless for report in reports):
        raise typer.Exit(1)


def _show(report: Report) -> None:
    from rich.markup import escape

    from sdp_vs_penalty.cli.console import out

    colours = {"error": "red", "warning": "yellow", "note": "dim"}
    if report.unexplained is None:
        verdict = "nothing to identify from"
    else:
        verdict = (
            f"the arm's dynamics leave {100.0 * report.unexplained**0.5:.2g} % of the torque unexplained"
        )
    out.print(
        f"[bold]{escape(report.run)}[/bold]: {len(report.problems)} problem(s); {verdict}",
        soft_wrap=True,
    )
    for f in report.findings:
        word = f"[{colours[f.severity]}]{f.severity}[/]"
        out.print(f"  {word} {escape(f.kind)} ({escape(f.where)})")
        fixed = " (--fix does it)" if f.repair is not None else ""
        for text in (f.what, f"How sure: {f.certainty}.", f"What to do: {f.remedy}{fixed}."):
            out.print(f"    {escape(text)}", soft_wrap=True)
