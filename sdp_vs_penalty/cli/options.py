"""Options that several verbs share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

PROBLEM_HELP = "Built-in name, folder with a problem.toml, or URDF file."

Problem = Annotated[str, typer.Argument(help=PROBLEM_HELP)]
Model = Annotated[
    Path, typer.Argument(metavar="model.json", help="Model written by `identify` or `add`.")
]
Data = Annotated[
    list[Path],
    typer.Option(
        "--data",
        metavar="RUN.csv ...",
        help="Measured runs: .csv, .npz, .mat, .parquet, .mcap, .bag; a folder or pattern of these.",
    ),
]
Test = Annotated[
    Path | None, typer.Option("--test", metavar="TEST.csv", help="Run for the held-out error only.")
]
Window = Annotated[
    str | None,
    typer.Option(
        metavar="START:STOP", help="Part of each run to use, in seconds from its start; or A:B,C:D."
    ),
]
TestWindow = Annotated[
    str | None,
    typer.Option(metavar="START:STOP", help="Part of the test run to use, in seconds from its start."),
]
Frozen = Annotated[
    bool,
    typer.Option("--frozen", help="Fixed model parameters: the only way to identify a payload."),
]
Gravity = Annotated[
    str | None, typer.Option(metavar="x,y,z", help="Gravity in the base frame, in m/s^2.")
]
Filters = Annotated[
    str | None,
    typer.Option(metavar="5,8", help="Filters of states and torque [Hz]; default: chosen."),
]
Bounds = Annotated[
    str | None,
    typer.Option(
        metavar="m2=1:5,c2x=-0.1:0.1",
        help="Bounds of links [kg, m, kg m^2], in place of the problem's; total=:20: of all.",
    ),
]
KnownLoad = Annotated[
    list[str] | None,
    typer.Option(
        "--known-load",
        metavar="LOAD.csv:KG",
        help="Run with a load of this mass on the last link; determines the torque channels' gains.",
    ),
]
Known = Annotated[
    str | None,
    typer.Option(
        metavar="kp2=600",
        help="Known parameters, which set the scale of a log without torque (names: model.json).",
    ),
]
Instruments = Annotated[
    str | None,
    typer.Option(
        metavar="command|none",
        help="Instruments against noise of positions: the command's simulated motion, or none. "
        "Default: command where no torque was logged.",
    ),
]
Method = Annotated[str, typer.Option(help="Method, of `sdp-vs-penalty list methods`.")]
Effects = Annotated[
    str | None,
    typer.Option(
        metavar="a,b,c", help="Effects, of `sdp-vs-penalty list effects`; default: the problem's."
    ),
]
NoCheck = Annotated[bool, typer.Option("--no-check", help="No data check before the work.")]
Seed = Annotated[int, typer.Option(min=0, help="Random seed.")]
GainUncertainty = Annotated[
    float | None,
    typer.Option(
        "--gain-uncertainty",
        min=0.0,
        max=0.999,
        metavar="0.01",
        help="Relative standard deviation of the torque channels' gains; widens the intervals.",
    ),
]
Jobs = Annotated[int, typer.Option(min=1, help="Number of processes.")]
Scheduler = Annotated[
    str | None,
    typer.Option(metavar="tcp://HOST:PORT", help="Dask scheduler; default: this computer."),
]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="All tables.")]


class Budget(StrEnum):
    """How much effort tables and figures may take."""

    quick = "quick"
    paper = "paper"


def json_option(what: str) -> object:
    """--json FILE, which also writes ``what``."""
    return typer.Option("--json", metavar="out.json", help=f"JSON file for the {what}.")
