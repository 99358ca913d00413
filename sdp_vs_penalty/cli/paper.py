"""Verbs about the paper besides its tables: figures, and trajectories that excite better than its own.

Registered by cli.py.
"""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]


class FigureBudget(StrEnum):
    """How dense the figures are sampled and how long engines run."""

    quick = "quick"
    paper = "paper"


def register(app: typer.Typer) -> None:
    """Add this file's verbs to the command line."""
    app.command("figures")(draw_figures)
    app.command("excite")(excite)


def draw_figures(
    numbers: Annotated[
        list[int] | None, typer.Argument(metavar="[1 2 3 5 ... 10]", help="Default: all.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder to write into.")] = Path("results"),
    budget: Annotated[
        FigureBudget, typer.Option(help="quick, or longer motions and more instants.")
    ] = FigureBudget.quick,
    debug: Debug = False,
) -> None:
    """Draw the paper's figures as PNG and PDF, with simulated and, where at hand, measured data.

    Example: [cyan]sdp-vs-penalty figures 1 10 --out results[/cyan]
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.paper.figures import make_figures

    with console.progress("figures") as progress:
        written = make_figures(numbers or (), out, budget.value, progress=progress)
    for path in written:
        print(path)


def excite(
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

    Example: [cyan]sdp-vs-penalty excite panda --out trajectory.csv[/cyan]
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.estimation.excitation import optimise_excitation, save_trajectory
    from sdp_vs_penalty.problem.load import load_problem

    robot = load_problem(problem)
    with console.progress("excitation") as progress:
        found = optimise_excitation(
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
