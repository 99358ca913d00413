"""The verb challenge: how often the diagnosis is right."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdp_vs_penalty.cli.options import Debug, Seed


def verb(
    cases: Annotated[int, typer.Option(min=1, help="Cases of each class.")] = 20,
    seed: Seed = 0,
    problem: Annotated[str, typer.Option(help="Robot to simulate.")] = "panda",
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for challenge.*.")] = Path("results"),
    jobs: Annotated[int, typer.Option(min=1, help="Number of processes.")] = 2,
    only: Annotated[str | None, typer.Option(metavar="a,b", help="Classes; default: all.")] = None,
    nuisance: Annotated[
        str | None,
        typer.Option(metavar="a,b", help="Clean cases under these conditions (all: every one)."),
    ] = None,
    debug: Debug = False,
) -> None:
    """Score diagnose on simulated measurements with hidden effects.

    Example: sdp-vs-penalty challenge --cases 20 --seed 0
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.simulation.challenge.challenge import run_challenge
    from sdp_vs_penalty.simulation.challenge.nuisances import run_clean

    classes = None if only is None else only.split(",")
    with console.progress("challenge") as progress:
        if nuisance is not None:
            names = None if nuisance == "all" else nuisance.split(",")
            written = run_clean(cases, seed, out, names, jobs, progress)
        else:
            written = run_challenge(problem, cases, seed, out, jobs, classes, progress)
    for path in written:
        print(path)
