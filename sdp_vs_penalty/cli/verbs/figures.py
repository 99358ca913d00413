"""The verb figures: the paper's figures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdp_vs_penalty.cli.options import Budget


def verb(
    numbers: Annotated[
        list[int] | None,
        typer.Argument(metavar="[1 2 3 5 ... 10]", help="Figure numbers; default: all."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder to write into.")] = Path("results"),
    budget: Annotated[
        Budget, typer.Option(help="Effort: quick, or paper (longer motions, more instants).")
    ] = Budget.quick,
) -> None:
    """Regenerate the paper's figures as PNG and PDF, from simulated and, if available, measured data.

    Example: sdp-vs-penalty figures 1 10 --out results
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.paper.figures import make_figures

    with console.progress("figures") as progress:
        written = make_figures(numbers or (), out, budget.value, progress=progress)
    for path in written:
        print(path)
