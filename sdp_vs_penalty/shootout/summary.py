"""What the runs say: one table by solver, one by problem, which solver to use, and what
each was told.

The shifted geometric mean is exp(mean log(t + s)) - s with s = 10 ms over all runs,
those that were not right at the time limit. Performance profiles (Dolan, More, Math.
Program. 2002), by accuracy: for each solver the share of problems that it brought to
it, within a factor of the fastest solver that did. A run counts by its figures,
whatever it was asked for: objective error and violation at most ten times the accuracy,
and a claim of success; or infeasibility, rightly claimed.
"""

import importlib.util
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from sdp_vs_penalty.colours import PALETTE
from sdp_vs_penalty.files import write_text, writing
from sdp_vs_penalty.formatting import number
from sdp_vs_penalty.problem.load import load_problem, problem_names
from sdp_vs_penalty.results.table import markdown_lines
from sdp_vs_penalty.shootout.contestants import contestants
from sdp_vs_penalty.shootout.judge import CLASSES, SLACK


def reached(runs: pandas.DataFrame, accuracy: float) -> pandas.Series:
    """Whether each run rightly claims success at an accuracy.

    That is an optimum within SLACK times the accuracy of the proved interval, or a
    proved infeasibility.

    Parameters
    ----------
    runs : DataFrame
        Rows of runs.csv.
    accuracy : float
        Relative.

    Returns
    -------
    Series of bool
        One value for each run.
    """
    error = runs[["objective_error", "violation"]].max(axis=1)
    is_accurate = np.isfinite(runs["lower"]) & (error <= SLACK * accuracy)
    is_optimum = (runs["claimed"] == "optimal") & is_accurate
    is_refutation = (runs["claimed"] == "infeasible") & (runs["class"] == "right")
    return is_refutation | is_optimum


def at_accuracy(runs: pandas.DataFrame, accuracy: float) -> pandas.DataFrame:
    """Select the runs that were asked for an accuracy.

    Runs of contestants that have no setting for accuracy ("default") are included.

    Parameters
    ----------
    runs : DataFrame
        Rows of runs.csv.
    accuracy : float
        Relative.

    Returns
    -------
    DataFrame
        The selected rows.
    """
    return runs[(runs["settings"] == "default") | (runs["accuracy"] == accuracy)]


def accuracies(runs: pandas.DataFrame) -> list[float]:
    """List the accuracies that contestants were run at, from loose to tight.

    Parameters
    ----------
    runs : DataFrame
        Rows of runs.csv.

    Returns
    -------
    list of float
        [1e-8], which certified fits promise, if no contestant has a setting for
        accuracy.
    """
    values = runs.loc[runs["settings"] != "default", "accuracy"].unique()
    return sorted(values, reverse=True) or [1e-8]


def profile(
    runs: pandas.DataFrame, accuracy: float
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the performance profile of each solver (Dolan, More 2002).

    It is the share of problems solved within a factor of the fastest solver's time.

    Parameters
    ----------
    runs : DataFrame
        Rows of runs.csv.
    accuracy : float
        Relative.

    Returns
    -------
    dict of str to ((k,) array, (k,) array)
        By solver: factors of time in increasing order, and the share of problems at
        each.
    """
    runs_at_accuracy = at_accuracy(runs, accuracy)
    count = runs["problem"].nunique()
    right = runs_at_accuracy[reached(runs_at_accuracy, accuracy)]
    seconds = right["seconds"].clip(lower=1e-6)
    # Time over that of the fastest solver on the same problem.
    ratio = seconds / seconds.groupby(right["problem"]).transform("min")
    profiles = {}
    for solver in sorted(runs_at_accuracy["solver"].unique()):
        factors = np.sort(ratio[right["solver"] == solver])
        shares = np.arange(1, len(factors) + 1) / count
        profiles[solver] = factors, shares
    return profiles


def _pyplot() -> Any:
    """Return matplotlib.pyplot, which draws into files only; None if it is not
    installed.
    """
    if importlib.util.find_spec("matplotlib") is None:
        return None
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def plot_profile(runs: pandas.DataFrame, path: Path) -> bool:
    """Draw the performance profiles, one panel for each accuracy.

    Solvers that ran on less than four fifths of the problems are left out, because
    their shares could not be compared.

    Parameters
    ----------
    runs : DataFrame
        Rows of runs.csv.
    path : Path
        The SVG file to write.

    Returns
    -------
    bool
        False if matplotlib is not installed.
    """
    plt = _pyplot()
    if plt is None:
        return False
    shown = accuracies(runs)
    count = runs.groupby("solver")["problem"].nunique()
    count = count[~count.index.str.endswith(" certified")]
    solvers = sorted(count.index[count >= 0.8 * count.max()])
    with _panels(plt, path, len(shown), legend_width=1.6, height=3.4) as panels:
        figure, axes = panels
        for panel, accuracy in zip(axes, shown, strict=True):
            _plot_profiles_at(panel, runs, accuracy, solvers)
        axes[0].set_ylabel("share of problems got right")
        labels = axes[0].get_legend_handles_labels()
        figure.legend(*labels, loc="outside right upper", frameon=False)
    return True


@contextmanager
def _panels(
    plt: Any, path: Path, count: int, *, legend_width: float, height: float
) -> Iterator[tuple[Any, Any]]:
    """Give a figure with ``count`` panels side by side, and write it as SVG at the end.

    Yields the figure and its axes (count,). ``legend_width`` and ``height`` are in
    inches. The same drawing gives the same bytes: names of elements have a fixed salt,
    and the file has no date.
    """
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with plt.rc_context({"svg.hashsalt": "shootout", "font.size": 9}):
        figure, (axes,) = plt.subplots(
            1,
            count,
            figsize=(3.2 * count + legend_width, height),
            sharey=True,
            squeeze=False,
            dpi=72,  # of SVG: the layout is that of the file
        )
        yield figure, axes
        # A figure that has a layout engine would be laid out and drawn twice.
        ConstrainedLayoutEngine().execute(figure)
        with writing(path) as file:
            figure.savefig(file, format="svg", metadata={"Date": None})
        plt.close(figure)


#: Of the solvers that share a colour, the first, the second and the third.
_LINES = ("-", "--", ":")


def _plot_profiles_at(
    panel: Any, runs: pandas.DataFrame, accuracy: float, solvers: Sequence[str]
) -> None:
    """Draw the performance profiles of some solvers at one accuracy into axes."""
    curves = profile(runs, accuracy)
    for k, solver in enumerate(solvers):
        ratios, shares = curves.get(solver, (np.zeros(0), np.zeros(0)))
        # The curve goes on to the right end of the axis, at 1e4.
        last = shares[-1:] if len(shares) else 0.0
        panel.step(
            np.append(ratios, 1e5),
            np.append(shares, last),
            where="post",
            label=solver,
            linewidth=2.2 if solver == "lmi-sdp" else 1.2,
            color=PALETTE[k % len(PALETTE)],
            linestyle=_LINES[k // len(PALETTE) % len(_LINES)],
        )
    panel.set(xscale="log", xlim=(0.9, 1e4), ylim=(0.0, 1.03), title=f"{accuracy:.0e}")
    panel.set_xlabel("time over the fastest that was right")
    panel.grid(alpha=0.3)


def solved_over_time(
    runs: pandas.DataFrame, accuracy: float
) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return the share of all problems that each solver has solved over time.

    Parameters
    ----------
    runs : DataFrame
        Rows of runs.csv.
    accuracy : float
        Relative.

    Returns
    -------
    dict of str to ((k,) array, (k,) array, (w,) array)
        By solver: times [s] in increasing order, the share of problems at each, and the
        times of its silently wrong answers [s].
    """
    runs_at_accuracy = at_accuracy(runs, accuracy)
    count = runs["problem"].nunique()
    is_right = reached(runs_at_accuracy, accuracy)
    curves = {}
    for solver, rows in runs_at_accuracy.groupby("solver"):
        seconds = np.sort(rows["seconds"][is_right[rows.index]])
        shares = np.arange(1, len(seconds) + 1) / count
        wrong = np.sort(rows["seconds"][rows["class"] == "silently_wrong"])
        curves[str(solver)] = seconds, shares, wrong
    return curves


def plot_over_time(runs: pandas.DataFrame, path: Path) -> bool:
    """Draw the share of problems solved over time, one panel for each accuracy.

    Crosses mark silently wrong answers.

    Parameters
    ----------
    runs : DataFrame
        Rows of runs.csv.
    path : Path
        The SVG file to write.

    Returns
    -------
    bool
        False if matplotlib is not installed.
    """
    plt = _pyplot()
    if plt is None:
        return False
    shown = accuracies(runs)
    with _panels(plt, path, len(shown), legend_width=1.9, height=3.6) as panels:
        figure, axes = panels
        for panel, accuracy in zip(axes, shown, strict=True):
            _plot_solved_at(panel, runs, accuracy)
        axes[0].set_ylabel("share of problems solved")
        handles, labels = axes[0].get_legend_handles_labels()
        # An empty curve: the sample of a cross in the legend.
        (cross,) = axes[0].plot([], [], "kx", markersize=6)
        figure.legend(
            [*handles, cross],
            [*labels, "silently wrong answer"],
            loc="outside right upper",
            frameon=False,
        )
    return True


#: Solvers in the picture over time, and their labels: enough to tell apart.
_SOLVERS_OVER_TIME = {
    "lmi-sdp": "lmi-sdp (ours)",
    "clarabel": "Clarabel",
    "scs": "SCS",
    "cvxopt": "CVXOPT",
    "csdp": "CSDP",
    "sdpa-program": "SDPA",
    "penalty": "penalty (ours)",
    "log-cholesky L-BFGS": "log-Cholesky",
}


def _plot_solved_at(panel: Any, runs: pandas.DataFrame, accuracy: float) -> None:
    """Draw the share of problems solved over time at one accuracy into axes.

    Crosses mark the silently wrong answers of each solver.
    """
    longest = max(float(runs["seconds"].max()), 1.0)
    curves = solved_over_time(runs, accuracy)
    for k, (solver, label) in enumerate(_SOLVERS_OVER_TIME.items()):
        if solver not in curves:
            continue
        seconds, shares, wrong = curves[solver]
        # The curve begins at share 0 left of the axis, and goes on to the right end; a
        # solver without any success stays at 0.
        x = np.concatenate([[1e-4], seconds, [longest]])
        y = np.concatenate([[0.0], shares, shares[-1:], [0.0]])[: len(x)]
        panel.step(
            x,
            y,
            where="post",
            label=label,
            color=PALETTE[k % len(PALETTE)],
            linestyle=_LINES[k // len(PALETTE) % len(_LINES)],
            linewidth=2.2 if solver == "lmi-sdp" else 1.2,
        )
        # Crosses lie on the curve, at the times of the wrong answers.
        share_at_cross = y[np.searchsorted(x, wrong, side="right") - 1]
        panel.plot(
            wrong, share_at_cross, "x", color=PALETTE[k % len(PALETTE)], markersize=6
        )
    panel.set(
        xscale="log",
        xlim=(1e-3, longest),
        ylim=(-0.02, 1.03),
        title=f"to {accuracy:.0e}",
    )
    panel.set_xlabel("processor time [s]")
    panel.grid(alpha=0.3)


def _milliseconds(seconds: float) -> str:
    """Write seconds as a number of milliseconds."""
    return number(1e3 * seconds)


def _small(value: float) -> str:
    """Write a small number as "1.2e-07"; "-" stands for NaN, an unknown number."""
    return "-" if np.isnan(value) else f"{value:.1e}"


#: Shift s of the geometric mean of times [s]: shorter times hardly differ in it.
_TIME_SHIFT = 0.01
#: Headings and forms of the summary's columns, where these are not the column's own.
_SHOWN: dict[str, tuple[str, Callable[[Any], str]]] = {
    "success_percent": ("right %", "{:.0f}".format),
    "silently_wrong": ("silently wrong", str),
    "mean_seconds": ("time [ms]", _milliseconds),
    "objective_error": ("error", _small),
    "violation": ("violation", _small),
    "own_gap": ("dual gap", _small),
}


def summary_table(runs: pandas.DataFrame, time_limit: float) -> pandas.DataFrame:
    """Summarise for each solver how often it is right or silently wrong, and how fast.

    The mean time is the shifted geometric mean exp(mean log(t + s)) - s with s = 10 ms,
    in which a run that is not right counts with the time limit. Errors are medians over
    the answers that claim an optimum.

    Parameters
    ----------
    runs : DataFrame
        Rows of runs.csv.
    time_limit : float
        Time limit of each run [s].

    Returns
    -------
    DataFrame
        One row for each solver and setting: runs, success_percent, the number of runs
        of each class, mean_seconds, medians of the errors, attempts, version.
    """
    # ``where`` keeps values of the rows that fulfil it, and replaces the others.
    errors = runs[["objective_error", "violation", "own_gap"]].where(
        runs["claimed"] == "optimal"
    )
    times = runs["seconds"].where(runs["class"] == "right", time_limit)
    runs_with_errors = runs.assign(
        **errors.replace(np.inf, np.nan), mean_seconds=np.log(times + _TIME_SHIFT)
    )
    # A column for each class with 1 for its runs, whose sum counts them.
    is_of_class = pandas.get_dummies(runs["class"], dtype=int)
    runs_with_errors = runs_with_errors.join(
        is_of_class.reindex(columns=CLASSES, fill_value=0)
    )
    runs_with_errors = runs_with_errors.sort_values(
        ["solver", "accuracy"], ascending=[True, False]
    )
    # Of each column of the result: the column that it is computed from, and how.
    how: dict[str, Any] = {
        "runs": ("problem", "size"),
        "success_percent": ("right", "mean"),
    }
    how |= {name: (name, "sum") for name in CLASSES} | {
        "mean_seconds": ("mean_seconds", "mean")
    }
    how |= {name: (name, "median") for name in errors}
    how |= {"attempts": ("attempts", "mean"), "version": ("version", "last")}
    table = runs_with_errors.groupby(
        ["solver", "settings"], sort=False, as_index=False
    ).agg(**how)
    table["success_percent"] *= 100.0
    table["mean_seconds"] = np.exp(table["mean_seconds"]) - _TIME_SHIFT
    return table.assign(attempts=table["attempts"].map("{:.1f}".format))


def by_problem(runs: pandas.DataFrame) -> list[str]:
    """Return a table of how each solver did on each problem, at its tightest accuracy.

    A silently wrong answer is followed by the larger of its relative error and
    violation.

    Parameters
    ----------
    runs : DataFrame
        Rows of runs.csv.

    Returns
    -------
    list of str
        Lines of a Markdown table: a row for each problem, a column for each solver.
    """
    tightest = runs.sort_values("accuracy").drop_duplicates(["problem", "solver"])
    worst = tightest[["objective_error", "violation"]].max(axis=1)
    wrong = [f"**WRONG** {x:.0e}" if np.isfinite(x) else "**WRONG**" for x in worst]
    class_words = np.where(
        tightest["class"] == "silently_wrong", wrong, tightest["class"]
    )
    grid = tightest.assign(said=class_words).pivot(
        index="problem", columns="solver", values="said"
    )
    return _markdown(grid.fillna("n/a").loc[runs["problem"].unique()].reset_index())


def _markdown(table: pandas.DataFrame) -> list[str]:
    """Return the lines of a data frame as a Markdown table."""
    return markdown_lines(list(table.columns), table.astype(str).to_numpy().tolist())


def ranking(
    runs: pandas.DataFrame, accuracy: float, links: int | None = None
) -> pandas.DataFrame:
    """Rank the contestants: those that reach the accuracy most often first.

    Ties are ranked by fewer silently wrong answers, then by shorter time.

    Parameters
    ----------
    runs : DataFrame
        Rows of runs.csv.
    accuracy : float
        Relative.
    links : int, optional
        Number of links of the arms that count; by default all problems count.

    Returns
    -------
    DataFrame
        One row for each contestant: "right", "silently wrong"; "run", on how many of
        the "problems" it ran; "seconds", the median where it was right; "attempts".
    """
    rows = at_accuracy(runs, accuracy)
    if links is not None:
        # A chain's name says its number of links, or else its robot (the group) has it;
        # an ill-conditioned problem has neither.
        links_by_robot = {name: load_problem(name).robot.n for name in problem_names()}
        of_chain = rows["problem"].str.extract(r"^chain of (\d+)")[0].astype(float)
        n_links = of_chain.fillna(rows["group"].map(links_by_robot))
        rows = rows[n_links == links]
    right = reached(rows, accuracy)
    runs_with_class = rows.assign(right=right, wrong=rows["class"] == "silently_wrong")
    runs_with_class["seconds"] = runs_with_class["seconds"].where(right)
    table = runs_with_class.groupby("solver").agg(
        **{"right": ("right", "sum"), "run": ("problem", "nunique")},
        **{"silently wrong": ("wrong", "sum"), "seconds": ("seconds", "median")},
        attempts=("attempts", "mean"),
    )
    table = table.assign(problems=rows["problem"].nunique()).reset_index()
    order = {
        "by": ["right", "silently wrong", "seconds"],
        "ascending": [False, True, True],
    }
    return table.sort_values(
        **order, na_position="first", kind="stable", ignore_index=True
    )


def advice(table: pandas.DataFrame, where: str) -> list[str]:
    """Say which solver to use, and whose answers to check.

    Parameters
    ----------
    table : DataFrame
        Result of :func:`ranking`.
    where : str
        The problems in words, such as "on 7 links at 1e-06".

    Returns
    -------
    list of str
        Sentences.
    """
    if table.empty:
        return []
    wrong = table["silently wrong"]
    # The first of those never silently wrong: whoever is not is never recommended, since
    # the last sentence says to check it.
    best = table[wrong == 0].iloc[0] if np.any(wrong == 0) else table.iloc[0]
    # Nearly as often right as the best one, and never silently wrong.
    is_reliable = (table["right"] >= 0.9 * best["right"]) & (wrong == 0)
    reliable = table[is_reliable].sort_values("seconds", kind="stable")
    worst = table.loc[wrong.idxmax()]
    quick = best if reliable.empty else reliable.iloc[0]
    sentences = [
        (
            f"{where[:1].upper()}{where[1:]}, take {best['solver']}: right on"
            f" {best['right']} of {best['problems']} problems,"
            f" {best['silently wrong']} times silently wrong,"
            f" {_milliseconds(best['seconds'])} ms (median)."
        )
    ]
    if quick["solver"] != best["solver"]:
        sentences.append(
            f"Where time matters more, take {quick['solver']}, never silently wrong"
            f" either: right on {quick['right']} of {quick['problems']},"
            f" {_milliseconds(quick['seconds'])} ms."
        )
    if worst["silently wrong"]:
        of = f"{worst['silently wrong']} of {worst['run']}"
        sentences.append(
            f"Check every answer of {worst['solver']}: silently wrong on {of}."
        )
    return sentences


def answer(runs: pandas.DataFrame) -> str:
    """Answer which solver to use for an arm of seven links, with the ranking behind it.

    Parameters
    ----------
    runs : DataFrame
        Rows of runs.csv.

    Returns
    -------
    str
        Markdown; "" if no problem of seven links was run.
    """
    links = 7
    accuracy = 1e-6
    table = ranking(runs, accuracy, links)
    if not (advice_words := advice(table, f"on {links} links at {accuracy:.0e}")):
        return ""
    shown = {
        "solver": table["solver"],
        "right": table["right"],
        "of problems run": table["run"],
    }
    shown |= {"silently wrong": table["silently wrong"]}
    shown |= {"median [ms]": table["seconds"].map(_milliseconds)}
    shown |= {"attempts": table["attempts"].map("{:.1f}".format)}
    return (
        "\n".join([" ".join(advice_words), "", *_markdown(pandas.DataFrame(shown))])
        + "\n"
    )


def sentences(runs: pandas.DataFrame) -> list[str]:
    """Advise on solvers from all runs at the tightest accuracy asked for.

    Parameters
    ----------
    runs : DataFrame
        Rows of runs.csv.

    Returns
    -------
    list of str
        Sentences.
    """
    tightest = accuracies(runs)[-1]
    return advice(ranking(runs, tightest), f"at {tightest:.0e}")


def _option_rows(runs: pandas.DataFrame) -> list[list[str]]:
    """Return a row (name, options) for each solver that ran, at the loosest and at the
    tightest accuracy.
    """
    asked = accuracies(runs)
    loosest_and_tightest = asked[0], asked[-1]
    solvers = runs["solver"].unique()
    return [
        [contestant.name, contestant.options_in_words(accuracy)]
        for name, contestant in contestants().items()
        if name in solvers and contestant.options
        for accuracy in contestant.asked(loosest_and_tightest)
    ]


def write_summary(
    folder: Path,
    runs: pandas.DataFrame,
    time_limit: float,
    absent: dict[str, str],
    not_applicable: Sequence[tuple[str, str, str]],
) -> list[Path]:
    """Write the summary of a shootout: summary.md, summary.csv and two pictures.

    Parameters
    ----------
    folder : Path
        The shootout's output folder.
    runs : DataFrame
        Rows of runs.csv.
    time_limit : float
        Of each run [s].
    absent : dict of str to str
        Why a solver or problem was left out, by its name.
    not_applicable : sequence of (str, str, str)
        Problem, solver, and why the one cannot be posed to the other.

    Returns
    -------
    list of Path
        The files written.
    """
    table = summary_table(runs, time_limit)
    missing = [f"{name}: {reason}" for name, reason in sorted(absent.items())]
    n_by_solver_and_reason = Counter(
        (solver, reason) for _, solver, reason in not_applicable
    )
    for (solver, reason), count in sorted(n_by_solver_and_reason.items()):
        missing.append(f"{solver}: not applicable to {count} problem(s): {reason}")
    option_rows = _option_rows(runs)
    # _SHOWN has (heading, function that writes a cell) of columns; others use str.
    texts = {
        name: column.map(_SHOWN.get(name, ("", str))[1])
        for name, column in table.items()
    }
    headings = {name: heading for name, (heading, _) in _SHOWN.items()}
    shown = pandas.DataFrame(texts).rename(columns=headings)
    # summary.md beside this module is the template.
    template = Path(__file__).with_suffix(".md").read_text("utf-8")
    content = template.format(
        sentences="".join(f"- {sentence}\n" for sentence in sentences(runs)),
        minutes=runs["seconds"].sum() / 60.0,
        limit=time_limit,
        answer=answer(runs),
        told="\n".join(markdown_lines(["solver", "told"], option_rows)),
        table="\n".join(_markdown(shown)),
        problems="\n".join(by_problem(runs)) + "\n",
        left_out="".join(f"- {line}.\n" for line in missing),
        machines=", ".join(sorted(runs["machine"].unique())),
    )
    paths = [folder / name for name in ("summary.md", "summary.csv")]
    write_text(paths[0], content)
    write_text(paths[1], table.to_csv(index=False, lineterminator="\n"))
    pictures = {"solved_over_time.svg": plot_over_time, "profile.svg": plot_profile}
    drawn = [
        folder / name for name, plot in pictures.items() if plot(runs, folder / name)
    ]
    return [*paths, *drawn]
