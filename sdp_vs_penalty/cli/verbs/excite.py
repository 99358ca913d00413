"""The verb excite: an exciting trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdp_vs_penalty.cli.options import Problem, Seed


def verb(
    problem: Problem,
    out: Annotated[
        Path, typer.Option(metavar="trajectory.csv", help="File to write: t, q, dq, ddq at 1 kHz.")
    ],
    duration: Annotated[float, typer.Option(help="Duration of the motion, in seconds.")] = 21.0,
    harmonics: Annotated[int, typer.Option(min=1, help="Harmonics of the Fourier series.")] = 5,
    frequency: Annotated[
        float, typer.Option(help="Frequency of the first harmonic, in rad/s.")
    ] = 0.4712389,
    objective: Annotated[str, typer.Option(help="Objective: condition or d-optimal.")] = "condition",
    iterations: Annotated[int, typer.Option(min=1, help="Maximum iterations.")] = 60,
    seed: Seed = 0,
) -> None:
    """Design an exciting trajectory within the robot's limits. Collisions are not checked.

    Example: sdp-vs-penalty excite panda --out trajectory.csv
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.estimation.excitation import excite

    with console.progress("excitation") as progress:
        found = excite(
            problem,
            objective=objective,
            harmonics=harmonics,
            frequency=frequency,
            duration=duration,
            iterations=iterations,
            seed=seed,
            progress=progress,
        )
    found.save(out)
    console.say(
        f"condition number of the base regressor: {found.history[0]:.1f} at the start, "
        f"{found.condition:.1f} after {len(found.history) - 1} iterations"
    )
    console.written(out)
