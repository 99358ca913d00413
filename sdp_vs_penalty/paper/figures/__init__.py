"""The paper's figures."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from sdp_vs_penalty.errors import InputError, missing_extra
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.files import writing
from sdp_vs_penalty.paper.figures import panda, two_link
from sdp_vs_penalty.paper.figures.style import DPI
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.problem.load import load_problem

#: By number the problem, and what draws the figure of its study: each ``figure_N`` of a
#: problem's file.
FIGURES: Mapping[int, tuple[str, Callable[[Study], Any]]] = {
    int(name.removeprefix("figure_")): (home.PROBLEM, draw)
    for home in (panda, two_link)
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
    out : str or Path
        Folder to write to.
    budget : str
        How long searches last, as for :func:`~sdp_vs_penalty.paper.tables.make_tables`.
    progress : callable
        Called with a short text at each step.
    workers : Workers
        Processes for estimates that are needed at the same time.

    Returns
    -------
    list of Path
        The files written.

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
    study_of = cache(
        lambda problem: Study(load_problem(problem), budget, progress, workers)
    )
    paths = []
    chosen = list(numbers or FIGURES)
    for n_done, number in enumerate(chosen):
        problem, draw = FIGURES[number]
        progress(f"{n_done} of {len(chosen)} done, figure {number}")
        paths += save(draw(study_of(problem)), Path(out) / f"figure_{number}")
    return paths


def save(figure: Any, base: Path) -> list[Path]:
    """Write a figure as PNG and PDF, each atomically, and close it.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.
    base : Path
        Path of the files without the suffix.

    Returns
    -------
    list of Path
        base.png and base.pdf.
    """
    import matplotlib.pyplot as plt
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    # Once for both files: a figure that has a layout engine is laid out and drawn twice
    # by each savefig.
    ConstrainedLayoutEngine().execute(figure)
    paths = []
    # Without a date the same numbers make the same file.
    for suffix, metadata in (
        (".png", {"Software": None}),
        (".pdf", {"CreationDate": None}),
    ):
        paths.append(base.with_name(base.name + suffix))
        with writing(paths[-1]) as file:
            figure.savefig(
                file,
                format=suffix[1:],
                dpi=DPI,
                metadata=metadata,
            )
    plt.close(figure)
    return paths
