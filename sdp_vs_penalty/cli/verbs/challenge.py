"""The verb challenge: how often the diagnosis is right."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdp_vs_penalty.cli.options import Jobs, Scheduler, Seed


def verb(
    cases: Annotated[
        int, typer.Option(min=1, help="Cases of each class (of clean robots: of each nuisance).")
    ] = 20,
    seed: Seed = 0,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for challenge.*.")] = Path("results"),
    jobs: Jobs = 2,
    scheduler: Scheduler = None,
    classes: Annotated[str | None, typer.Option(metavar="a,b", help="Classes; default: all.")] = None,
    nuisance: Annotated[
        str | None, typer.Option(metavar="a,b", help="Conditions of measurement; default: all.")
    ] = None,
) -> None:
    """Score diagnose on robots that are simulated independently of this library.

    Example: sdp-vs-penalty challenge --classes clean --nuisance sign,dahl --cases 4 --seed 1000
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.parallel import Workers
    from sdp_vs_penalty.simulation.challenge.challenge import run_challenge

    kinds = None if classes is None else classes.split(",")
    conditions = None if nuisance in (None, "all") else str(nuisance).split(",")
    with console.progress("challenge") as progress:
        written = run_challenge(cases, seed, out, Workers(jobs, scheduler), kinds, conditions, progress)
    for path in written:
        print(path)
