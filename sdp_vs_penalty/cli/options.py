"""Options that several verbs share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Data = Annotated[
    list[Path],
    typer.Option(
        "--data", metavar="RUN.csv ...", help="Runs: .csv, .npz, or a folder of the authors' log."
    ),
]
Test = Annotated[
    Path | None, typer.Option("--test", metavar="TEST.csv", help="A run for the held-out error only.")
]
Window = Annotated[
    str | None,
    typer.Option(metavar="START:STOP", help="Part of each data run to use, in seconds from its start."),
]
TestWindow = Annotated[
    str | None, typer.Option(metavar="START:STOP", help="Part of the test run to use, likewise.")
]
Frozen = Annotated[
    bool, typer.Option("--frozen", help="Keep the model's parameters: the only way to see a payload.")
]
Seed = Annotated[int, typer.Option(min=0, help="Of everything random.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
