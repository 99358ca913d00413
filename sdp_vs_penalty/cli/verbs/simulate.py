"""The verb simulate: runs with a hidden effect."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdp_vs_penalty.cli.options import Problem, Seed


def verb(
    problem: Problem,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for run1..3.csv, test.csv, truth.json.")
    ],
    hide: Annotated[
        list[str] | None,
        typer.Option(
            "--hide", metavar="EFFECT[:joints]", help="Effect to hide; repeatable. Default: none."
        ),
    ] = None,
    level: Annotated[
        str,
        typer.Option(help="Size: strong, medium, weak, or the hidden torque's RMS over the raw noise."),
    ] = "strong",
    seed: Seed = 0,
) -> None:
    """Simulate runs in which an effect is hidden; truth.json says which.

    Example: sdp-vs-penalty simulate panda --hide stribeck_friction:3 --seed 7 --out DIR
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.simulation.hide import RUN_FILES, refuse_foreign, simulate

    refuse_foreign(out)  # before the minutes that a simulation may take
    made = simulate(problem, hide or (), level, seed)
    made.save(out)
    effects = ",".join(made.truth["model_effects"])
    runs = [out / name for name in RUN_FILES[:-1]]
    console.next_step(
        ["identify", problem, "--data", *runs, "--effects", effects, "--out", "model.json"]
    )
    console.written(f"{out}/{' '.join(RUN_FILES)} truth.json")
