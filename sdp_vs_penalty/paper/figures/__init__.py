"""The paper's figures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from sdp_vs_penalty.errors import InputError, missing_extra
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.files import writing
from sdp_vs_penalty.paper.figures import engines, panda, two_link
from sdp_vs_penalty.paper.figures.layout import lay_out
from sdp_vs_penalty.paper.figures.style import DPI
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.problem.load import load_problem

#: The files of figures, those that take longest first. Figures of one file share a study.
_FILES: Sequence[Any] = (panda, two_link, engines)
#: By number the file, and what draws the figure of its study: each ``figure_N`` of it.
FIGURES: Mapping[int, tuple[Any, Callable[[Study], Any]]] = {
    int(name.removeprefix("figure_")): (home, draw)
    for home in _FILES
    for name, draw in vars(home).items()
    if name.startswith("figure_")
}


def make_figures(
    numbers: Sequence[int] = (),
    out: str | Path = "results",
    budget: str = "quick",
    progress: Progress = no_progress,
    workers: Workers = ALONE,
) -> list[Path]:
    """Draw figures, and write each at once as figure_N.png and figure_N.pdf.

    Parameters
    ----------
    numbers : sequence of int
        Numbers of the figures; none for all.
    budget : str
        How long searches last, as for :func:`~sdp_vs_penalty.paper.tables.make_tables`.
    progress : callable
        Called with a short text at each step; by several processes, when all figures of a
        file are drawn.
    workers : Workers
        Processes that draw the figures of one file each, and estimate what these need.

    Raises
    ------
    InputError
        For a number without a figure, before anything is computed, or if matplotlib is
        not installed.
    """
    for number in numbers:
        if number not in FIGURES:
            raise InputError(
                f"figure {number} is not made",
                f"choose from {', '.join(map(str, FIGURES))}; 4 is a photograph of"
                " V-REP's window",
            )
    try:
        import matplotlib
    except ImportError:
        raise missing_extra("Figures need matplotlib,", "plot") from None
    matplotlib.use("Agg")
    chosen = list(numbers or sorted(FIGURES))
    groups = [[n for n in chosen if FIGURES[n][0] is home] for home in _FILES]
    groups = [group for group in groups if group]
    draw = partial(_draw_group, out=Path(out), budget=budget)
    processes = min(workers.jobs, len(groups))
    if processes > 1:  # each may start its share of further ones
        draw = partial(draw, workers=Workers(workers.jobs // processes))
    else:
        draw = partial(draw, workers=workers, progress=progress)
    drawn = replace(workers, progress=progress).map(draw, groups)
    paths_by_number = {n: paths for group in drawn for n, paths in group.items()}
    return [path for n in chosen for path in paths_by_number[n]]


def _draw_group(
    numbers: Sequence[int],
    out: Path,
    budget: str,
    workers: Workers,
    progress: Progress = no_progress,
) -> dict[int, list[Path]]:
    """Draw the figures of one file from one study, and write each at once.

    Returns the paths of each figure by its number.
    """
    home, _ = FIGURES[numbers[0]]
    study = Study(load_problem(home.PROBLEM), budget, progress, workers)
    paths = {}
    for number in numbers:
        progress(f"figure {number}")
        _, draw = FIGURES[number]
        paths[number] = save(draw(study), out / f"figure_{number}")
    return paths


def save(figure: Any, base: Path) -> list[Path]:
    """Write a figure as PNG and PDF, each atomically, and close it.

    Parameters
    ----------
    base : Path
        Path of the files without the suffix.
    """
    import matplotlib.pyplot as plt

    lay_out(figure)
    paths = []
    # Without a date the same numbers make the same file.
    for suffix, metadata in (
        (".png", {"Software": None}),
        (".pdf", {"CreationDate": None}),
    ):
        paths.append(base.with_name(base.name + suffix))
        with writing(paths[-1]) as file:
            figure.savefig(file, format=suffix[1:], dpi=DPI, metadata=metadata)
    plt.close(figure)
    return paths
