import os
from pathlib import Path
from typing import TYPE_CHECKING

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.cli.options import Budget
from sdp_vs_penalty.errors import InputError

if TYPE_CHECKING:
    from sdp_vs_penalty.paper.tables.table import StudyTable


def verb(
    names: list[str] | None = None,
    all_: bool = False,
    problem: str | None = None,
    budget: Budget = Budget.quick,
    out: Path = Path("results"),
    jobs: int = 0,
    scheduler: str | None = None,
    quick: bool = False,
) -> None:
    """Regenerate the paper's comparison tables.

    Each table is written when it is made, and what it took is kept on the disk: a run
    that was stopped goes on where it was (SDP_VS_PENALTY_CACHE names the folder).
    Example: sdp-vs-penalty tables III --out results

    names [III IV VIII IX ...]: Tables, of `sdp-vs-penalty list tables`; default: these four.
    --all: All tables but the slow ones, such as methods and data.
    --problem: Problem: two_link or panda.
    --budget: Effort: quick, single (annealing once as long as in the paper), or paper (ten runs).
    --jobs >=0: Parallel estimates on this computer; 0: one per core.
    --quick: As --budget quick, the default: monte_carlo draws 20 times and leaves slow methods out.
    """
    from sdp_vs_penalty.paper.tables import make_tables, makers
    from sdp_vs_penalty.parallel import Workers

    if quick:
        budget = Budget.quick
    if all_:
        if names or problem:
            raise InputError("--all makes every table", "leave out names and --problem")
        names = [name for name, maker in makers().items() if not maker.slow]
    outside = list[Path]()

    def report(table: "StudyTable", paths: list[Path]) -> None:
        first, *other_lines = table.lines()
        console.say(first, style="bold")
        for line in other_lines:
            console.paragraph(line)
        for path in paths:
            console.say(str(path))
        if paths[0].parent != out:
            outside.append(paths[0])

    with console.progress("tables") as progress:
        workers = Workers(jobs or os.cpu_count() or 1, scheduler)
        make_tables(
            names or None,
            problem,
            budget.value,
            out,
            progress,
            workers=workers,
            report=report,
        )
    if outside:
        console.paragraph(
            f"{out} holds measured tables, and no real run is at hand (name its folder"
            " by SDP_VS_PENALTY_DATA): tables without it were written to"
            f" {out / 'simulated'}."
        )
