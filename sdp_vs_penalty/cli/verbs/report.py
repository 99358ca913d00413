"""The verb report: one self-contained HTML file."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdp_vs_penalty.cli.arguments import bounds_for, time_window
from sdp_vs_penalty.cli.options import Debug
from sdp_vs_penalty.errors import InputError

if TYPE_CHECKING:
    pass


def verb(
    models: Annotated[
        list[Path],
        typer.Argument(metavar="model.json ...", help="In the order in which effects were added."),
    ],
    data: Annotated[
        list[Path], typer.Option("--data", metavar="RUN.csv ...", help="Runs to judge the models on.")
    ],
    out: Annotated[Path, typer.Option(metavar="report.html", help="File to write.")],
    problem: Annotated[
        str | None, typer.Option(help="Whose bounds hold; default: the model's own problem.")
    ] = None,
    window: Annotated[
        str | None,
        typer.Option(metavar="START:STOP", help="Part of each run, in seconds from its start."),
    ] = None,
    debug: Debug = False,
) -> None:
    """Write one self-contained HTML file: torques, errors, parameters, certificate, data check.

    Example: sdp-vs-penalty report model.json model2.json --data test.csv --out report.html
    """

    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.data.files import load_measurements
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.files import write_text
    from sdp_vs_penalty.report import make_report

    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{out}: the report is an HTML file: let --out end in .html.")
    estimates = {str(path): load_estimate(path) for path in models}
    start, stop = time_window(window)
    robot = next(iter(estimates.values())).robot
    bounds = bounds_for(robot, problem)
    names = [joint.name for joint in robot.joints]
    with console.progress("reading the measurements") as progress:
        measurements = load_measurements(*data, start=start, stop=stop, names=names)
        command = shlex.join(["sdp-vs-penalty", *sys.argv[1:]])
        made = make_report(
            estimates, measurements, problem=bounds, commands=[command], progress=progress
        )
    write_text(out, made)
    console.out.print(f"written: {out}", markup=False, soft_wrap=True)
