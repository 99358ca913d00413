import os
from pathlib import Path

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.cli.options import Budget


def verb(
    numbers: list[int] | None = None,
    out: Path = Path("results"),
    budget: Budget = Budget.quick,
    jobs: int = 0,
) -> None:
    """Regenerate the paper's figures as PNG and PDF, from simulated and, if available, measured data.

    Example: sdp-vs-penalty figures 1 10 --out results

    numbers [1 2 3 5 ... 10]: Figure numbers; default: all.
    --budget: Effort: quick, single (as quick), or paper (longer motions, more instants).
    --jobs >=0: Processes on this computer, which estimate and draw; 0: one per core.
    """
    from sdp_vs_penalty.paper.figures import make_figures
    from sdp_vs_penalty.parallel import Workers

    with console.progress("figures") as progress:
        workers = Workers(jobs or os.cpu_count() or 1)
        written = make_figures(numbers or (), out, budget.value, progress, workers)
    for path in written:
        console.say(str(path))
