"""The verb excite: an exciting trajectory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdp_vs_penalty.cli.options import Debug

if TYPE_CHECKING:
    pass


def verb(
    problem: Annotated[
        str, typer.Argument(help="A built-in name, a folder with a problem.toml, or a URDF file.")
    ],
    out: Annotated[
        Path, typer.Option(metavar="trajectory.csv", help="File to write: t, q, dq, ddq at 1 kHz.")
    ],
    duration: Annotated[float, typer.Option(help="Of the motion, in seconds.")] = 21.0,
    harmonics: Annotated[int, typer.Option(min=1, help="Of the Fourier series.")] = 5,
    frequency: Annotated[float, typer.Option(help="Of the first harmonic, in rad/s.")] = 0.4712389,
    objective: Annotated[str, typer.Option(help="condition or d-optimal.")] = "condition",
    iterations: Annotated[int, typer.Option(min=1, help="At most so many.")] = 60,
    seed: Annotated[int, typer.Option(min=0, help="Of the start.")] = 0,
    debug: Debug = False,
) -> None:
    """Optimise an exciting trajectory within the robot's limits. It does not look at collisions.

    Example: sdp-vs-penalty excite panda --out trajectory.csv
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.estimation.excitation import excite, save_trajectory
    from sdp_vs_penalty.problem.load import load_problem

    robot = load_problem(problem)
    with console.progress("excitation") as progress:
        found = excite(
            robot,
            objective=objective,
            harmonics=harmonics,
            frequency=frequency,
            duration=duration,
            iterations=iterations,
            seed=seed,
            progress=progress,
        )
    save_trajectory(found.trajectory, out)
    console.out.print(
        f"condition number of the base regressor: {found.history[0]:.1f} at the start, "
        f"{found.condition:.1f} after {len(found.history) - 1} iterations"
    )
    console.out.print(f"written: {out}", markup=False, soft_wrap=True)
