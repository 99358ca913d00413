"""The verb tables: the paper's tables made again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdp_vs_penalty.cli.options import Budget, Jobs, Scheduler
from sdp_vs_penalty.errors import InputError

_TABLES_HELP = "Tables, of `sdp-vs-penalty list tables`; default: these four."


def verb(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[III IV VIII IX ...]", help=_TABLES_HELP)
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="All tables but the slow ones, such as methods and data.")
    ] = False,
    problem: Annotated[str | None, typer.Option(help="Problem: two_link or panda.")] = None,
    budget: Annotated[
        Budget, typer.Option(help="Effort: quick, or paper (as many runs as there).")
    ] = Budget.quick,
    out: Annotated[Path, typer.Option(help="Folder to write into.")] = Path("results"),
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
) -> None:
    """Regenerate the paper's comparison tables.

    Example: sdp-vs-penalty tables III --out results
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.paper.tables import all_tables, make_tables
    from sdp_vs_penalty.parallel import Workers

    if every:
        if names or problem:
            raise InputError(
                "--all makes every table with its own problem", "leave out names and --problem"
            )
        names = list(all_tables())
    with console.progress("tables") as progress:
        workers = Workers(jobs, scheduler)
        made = make_tables(names or None, problem, budget.value, out, progress, workers=workers)
    for table, paths in made:
        first, *rest = table.lines()
        console.say(first, style="bold")
        for line in rest:
            console.explain(line)
        for path in paths:
            console.say(str(path))
    if any(paths[0].parent != out for _, paths in made):
        console.explain(
            f"{out} holds measured tables, and no real run is at hand (name its folder by "
            f"SDP_VS_PENALTY_DATA): tables without it were written to {out / 'simulated'}."
        )
