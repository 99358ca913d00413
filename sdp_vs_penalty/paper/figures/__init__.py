"""The paper's figures."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from sdp_vs_penalty.errors import InputError, missing_extra
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.files import writing
from sdp_vs_penalty.paper.figures import engines, panda, two_link
from sdp_vs_penalty.paper.figures.style import DPI
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.problem.load import load_problem

#: The files of figures. Figures of one problem share a study.
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
        Called with a short text at each step.
    workers : Workers
        Processes that estimate what the figures need.

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
    studies: dict[str, Study] = {}
    paths = list[Path]()
    for number in numbers or sorted(FIGURES):
        progress(f"figure {number}")
        home, draw = FIGURES[number]
        if home.PROBLEM not in studies:
            problem = load_problem(home.PROBLEM)
            studies[home.PROBLEM] = Study(problem, budget, progress, workers)
        paths += save(draw(studies[home.PROBLEM]), Path(out) / f"figure_{number}")
    return paths


def save(figure: Any, base: Path) -> list[Path]:
    """Write a figure as PNG and PDF, each atomically, and close it.

    Parameters
    ----------
    base : Path
        Path of the files without the suffix.
    """
    import matplotlib.pyplot as plt

    # Laid out once for both files, and before labels are aligned: room for a label takes
    # the place of every label in line with it.
    figure.set_dpi(DPI)
    figure.get_layout_engine().execute(figure)
    figure.set_layout_engine(None)
    figure.align_labels([axes for axes in figure.axes if axes.name != "3d"])
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
