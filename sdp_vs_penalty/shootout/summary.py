"""What the runs say: a ranking at each accuracy, every setting, every problem, and
sentences that follow from these tables.

A contestant's cell on a problem at an accuracy is its best answer to any of the
accuracies that it was asked for (:func:`best_answers`), judged by its figures. Performance
profiles (Dolan, More, Math. Program. 2002) show the share of problems brought to an
accuracy within a factor of the fastest; work-precision curves the error that each asked
accuracy gives, over the time that it takes.
"""

import importlib.util
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from sdp_vs_penalty.colours import PALETTE
from sdp_vs_penalty.files import write_text, writing
from sdp_vs_penalty.formatting import count, number, words
from sdp_vs_penalty.results.table import markdown_lines
from sdp_vs_penalty.shootout.contestants import Contestant, contestants
from sdp_vs_penalty.shootout.judge import CLASSES, SLACK, classes
from sdp_vs_penalty.shootout.statistics import LEVEL, SHORTEST, beside, can_tell, wilson

#: Accuracies at which every setting is judged.
SHOWN = (1e-4, 1e-6, 1e-8)
#: Shift of the geometric mean of times [s]: shorter times hardly differ in it.
_TIME_SHIFT = 0.01
#: Sets of problems, in the order in which they are reported, and what they are.
SETS = {
    "drawn": "drawn by the hashes of names; settings may be tuned on them",
    "untouched": "drawn likewise, of those that no shootout ran before; nobody tunes on them",
    "conic form": "handed out as a Gram matrix or unscaled rows, to conic solvers only",
    "": "chosen by --problems, in no declared set",
}


def accuracies(runs: pandas.DataFrame) -> list[float]:
    """List the accuracies that contestants were asked for, from loose to tight.

    Those of every setting (SHOWN) if nobody could be asked.
    """
    can_be_asked = [c.name for c in contestants().values() if c.promise is None]
    asked = runs["accuracy"][runs["solver"].isin(can_be_asked)]
    return sorted(set(asked), reverse=True) or list(SHOWN)


def best_answers(runs: pandas.DataFrame, accuracy: float) -> pandas.DataFrame:
    """Return each solver's best answer to each problem, at an accuracy.

    The fastest that is right; else its most accurate claim; else how it failed last.
    Unproved instances count for nobody.

    Returns
    -------
    DataFrame
        Rows of runs.csv, one for each problem and solver, with "class" and "right"; and
        "proved", whether any right answer is proved by the solver's own multipliers.
    """
    kinds = classes(runs, accuracy)
    order = kinds.map({"right": 0, "inaccurate": 1, "silently_wrong": 1}).fillna(2)
    # Says itself that it is inaccurate: behind what is claimed.
    order = order.where((runs["outcome"] == "claim") | (order == 2), 1.5)
    within = runs["seconds"].where(kinds == "right", runs["error"])
    is_right = kinds == "right"
    by_own_dual = runs["own_gap"] <= SLACK * accuracy
    is_proved = is_right & (by_own_dual | (runs["claimed"] == "infeasible"))
    answers = [runs["problem"], runs["solver"]]
    ranked = runs.assign(**{"class": kinds, "right": is_right})
    ranked["proved"] = is_proved.groupby(answers).transform("any")
    ranked = ranked.assign(order=order, within=within)[kinds != "unproved"]
    ranked = ranked.sort_values(["order", "within", "accuracy"], kind="stable")
    return ranked.drop_duplicates(["problem", "solver"]).drop(
        columns=["order", "within"]
    )


def ranking(cells: pandas.DataFrame) -> pandas.DataFrame:
    """Rank the contestants by the lower end of the 95 % interval of their share right, which
    is fair to those to whom fewer problems can be posed.

    Ties are ranked by fewer silently wrong answers, then by shorter time.

    Returns
    -------
    DataFrame
        One row for each contestant: "right" of "run" problems; "low", the lower end;
        "wrong", silently;
        "proved", by its own multipliers; medians of "seconds", of their "spread", of
        "file_seconds" and "form_seconds" where it is right; and what
        :func:`~statistics.beside` says of it and the row above.
    """
    is_right = cells["right"]
    spread = (cells["seconds_most"] - cells["seconds_least"]) / cells["seconds"]
    by_right = {
        "seconds": cells["seconds"].where(is_right),
        "spread": spread.where(is_right & (cells["repeats"] > 1)),
        "file_seconds": cells["file_seconds"].where(is_right),
        "form_seconds": cells["form_seconds"].where(is_right),
    }
    rows = cells.assign(wrong=cells["class"] == "silently_wrong", **by_right)
    how: dict[str, Any] = {"run": ("problem", "size")}
    how |= {name: (name, "sum") for name in ("right", "wrong", "proved")}
    how |= {name: (name, "median") for name in by_right}
    table = rows.groupby("solver").agg(**how).reset_index()
    pairs_right = zip(table["right"], table["run"], strict=True)
    table["low"] = [wilson(right, n)[0] for right, n in pairs_right]
    table = table.sort_values(
        by=["low", "wrong", "seconds"],
        ascending=[False, True, True],
        kind="stable",
        ignore_index=True,
    )
    names = table["solver"].tolist()
    pairs = [beside(cells, *pair) for pair in pairwise(names)]
    first = {name: np.nan for name in ("one", "other", "p", "ratio", "p_time")}
    return table.join(
        pandas.DataFrame([first, *pairs], index=table.index[: len(names)])
    )


def about_as_right(cells: pandas.DataFrame, table: pandas.DataFrame) -> list[str]:
    """List the first of a ranking and all that no test tells from it."""
    names: list[str] = table["solver"][table["right"] > 0].tolist()
    return names[:1] + [
        name for name in names[1:] if beside(cells, names[0], name)["p"] > LEVEL
    ]


def sentences(runs: pandas.DataFrame) -> list[str]:
    """Say which solvers are right, which of them are fast, and whom to check.

    Returns
    -------
    list of str
        Of each set that was run, at each accuracy: all numbers are of :func:`ranking`.
    """
    said = []
    for name, part in _by_set(runs):
        for accuracy in accuracies(runs):
            said += _advice(part, accuracy, f"{name or 'chosen'} problem")
    ours = runs[(runs["solver"] == "lmi-sdp") & runs["status"].str.contains(": proved")]
    if len(ours):
        by_clarabel = ours["problem"][~ours["status"].str.startswith("primal-dual")]
        of = f"{by_clarabel.nunique()} of {ours['problem'].nunique()} problems"
        said.append(f"lmi-sdp is a portfolio: it called Clarabel on {of}.")
    return said


def _by_set(runs: pandas.DataFrame) -> list[tuple[str, pandas.DataFrame]]:
    """Return the runs of each set that has any, in the order of SETS."""
    parts = [(name, runs[runs["set"] == name]) for name in SETS]
    return [(name, part) for name, part in parts if len(part)]


def _advice(runs: pandas.DataFrame, accuracy: float, where: str) -> list[str]:
    """Return the sentences about one set at one accuracy."""
    cells = best_answers(runs, accuracy)
    ranked = ranking(cells)
    n_problems = runs["problem"].nunique()
    where = count(n_problems, where)
    if not (good := about_as_right(cells, ranked)):
        return [f"At {accuracy:.0e}, nobody is right on any of {where}."]
    table = ranked.set_index("solver")
    if not can_tell(n_problems):
        said = f"{where} cannot rank anybody. Right to {accuracy:.0e}:"
        return [f"{said} {_by_count(table, 'right')}{_silently_wrong(table)}."]
    first, *same = [
        f"{name} ({table.loc[name, 'right']} of {table.loc[name, 'run']})"
        for name in good
    ]
    said = f"Right to {accuracy:.0e} on {where}: most surely {first}"
    if same:
        said += f", from which no test tells {words(same)}"
    known = contestants()
    first = good[0]
    form = table.loc[first, "form_seconds"]
    said += f"; {first} takes {_milliseconds(table.loc[first, 'seconds'])} ms (median"
    said += f"; {_milliseconds(form)} ms before for its form)" if form else ")"
    if "lmi-sdp" in good[1:]:
        pair = beside(cells, first, "lmi-sdp")
        is_slower = pair["p_time"] <= LEVEL
        how = f"{number(pair['ratio'])} times as long" if is_slower else "about as long"
        said += f", lmi-sdp {how} ({known['lmi-sdp'].clock})"
    if proving := [s for s in good if s in known and known[s].certifies]:
        said += (
            f"; {words(proving)} {'prove' if len(proving) > 1 else 'proves'} each claim"
        )
    return [f"{said}{_silently_wrong(table)}."]


def _silently_wrong(table: pandas.DataFrame) -> str:
    """Say on how many problems who is silently wrong, "" if nobody is."""
    by = _by_count(table, "wrong")
    return by and f". Silently wrong: {by}"


def _by_count(table: pandas.DataFrame, column: str) -> str:
    """List the contestants of a ranking that are right or wrong on any problem."""
    some = table[column][table[column] > 0].sort_values(ascending=False, kind="stable")
    texts = [f"{name} on {n} of {table.loc[name, 'run']}" for name, n in some.items()]
    return words(texts) if texts else ""


def profile(
    runs: pandas.DataFrame, accuracy: float
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the performance profile of each solver (Dolan, More 2002).

    Returns
    -------
    dict of str to ((k,) array, (k,) array)
        By solver: factors of the fastest solver's time in increasing order, and at each
        the share of the problems that could be posed to the solver.
    """
    cells = best_answers(runs, accuracy)
    right = cells[cells["right"]]
    seconds = right["seconds"].clip(lower=SHORTEST)
    ratio = seconds / seconds.groupby(right["problem"]).transform("min")
    profiles = {}
    for solver, n_run in cells.groupby("solver")["problem"].nunique().items():
        factors = np.sort(ratio[right["solver"] == solver])
        profiles[str(solver)] = factors, np.arange(1, len(factors) + 1) / n_run
    return profiles


def by_setting(runs: pandas.DataFrame) -> pandas.DataFrame:
    """Summarise each solver at each of its settings.

    Returns
    -------
    DataFrame
        One row for each solver and setting: runs; how many are right to each accuracy;
        how many of each other class at the tightest; shifted geometric means of the time at
        each of these accuracies; medians of error, violation and dual gap over the optima
        claimed; time of files, attempts, version.
    """
    columns: dict[str, Any] = {"runs": ("problem", "size")}
    table = runs.copy()
    shown = accuracies(runs)
    for accuracy in shown:
        kinds = classes(runs, accuracy)
        table[f"right {accuracy:.0e}"] = kinds == "right"
        seconds = runs["seconds"].where(kinds == "right", runs["time_limit"])
        table[f"mean seconds {accuracy:.0e}"] = np.log(seconds + _TIME_SHIFT)
    for name in CLASSES[1:]:
        table[name] = kinds == name
    figures = ["error", "objective_error", "violation", "own_gap"]
    is_optimum = (runs["claimed"] == "optimal") & (runs["outcome"] == "claim")
    table[figures] = table[figures].where(is_optimum).replace(np.inf, np.nan)
    columns |= {f"right {a:.0e}": (f"right {a:.0e}", "sum") for a in shown}
    columns |= {name: (name, "sum") for name in CLASSES[1:]}
    means = [f"mean seconds {a:.0e}" for a in shown]
    columns |= {name: (name, "mean") for name in means}
    columns |= {name: (name, "median") for name in (*figures, "file_seconds")}
    columns |= {"attempts": ("attempts", "mean"), "version": ("version", "last")}
    table = table.sort_values(["solver", "accuracy"], ascending=[True, False])
    table = table.groupby(["solver", "settings"], sort=False, as_index=False)
    summary = table.agg(**columns)
    summary[means] = np.exp(summary[means]) - _TIME_SHIFT
    return summary


@contextmanager
def _panels(runs: pandas.DataFrame, path: Path) -> Iterator[Any]:
    """Give a figure with a panel for each accuracy, and write it as SVG at the end.

    The same drawing gives the same bytes: names of elements have a fixed salt, and the
    file has no date.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    n_panels = len(accuracies(runs))
    with pyplot.rc_context({"svg.hashsalt": "shootout", "font.size": 9}):
        figure, (axes,) = pyplot.subplots(
            1,
            n_panels,
            figsize=(3.2 * n_panels + 1.9, 3.6),
            sharey=True,
            squeeze=False,
            dpi=72,  # of SVG: the layout is that of the file
        )
        yield axes
        labels = axes[0].get_legend_handles_labels()
        figure.legend(*labels, loc="outside right upper", frameon=False)
        # A figure that has a layout engine would be laid out and drawn twice.
        ConstrainedLayoutEngine().execute(figure)
        with writing(path) as file:
            figure.savefig(file, format="svg", metadata={"Date": None})
        pyplot.close(figure)


def _line_of(runs: pandas.DataFrame) -> dict[str, dict[str, Any]]:
    """Return how the line of each contestant is drawn, by its name."""
    styles = ("-", "--", ":")
    return {
        solver: {
            "label": solver,
            "linewidth": 2.2 if solver == "lmi-sdp" else 1.2,
            "color": PALETTE[k % len(PALETTE)],
            "linestyle": styles[k // len(PALETTE) % len(styles)],
        }
        for k, solver in enumerate(sorted(runs["solver"].unique()))
    }


def plot_profile(runs: pandas.DataFrame, path: Path) -> None:
    """Draw the performance profiles of all contestants, one panel for each accuracy."""
    with _panels(runs, path) as axes:
        for panel, accuracy in zip(axes, accuracies(runs), strict=True):
            curves = profile(runs, accuracy)
            for solver, style in _line_of(runs).items():
                ratios, shares = curves.get(solver, (np.zeros(0), np.zeros(0)))
                # The curve goes on to the right end of the axis.
                last = shares[-1:] if len(shares) else 0.0
                x, y = np.append(ratios, 1e5), np.append(shares, last)
                panel.step(x, y, where="post", **style)
            panel.set(xscale="log", xlim=(0.9, 1e4), ylim=(0.0, 1.03))
            panel.set(title=f"{accuracy:.0e}", xlabel="time over the fastest right one")
            panel.grid(alpha=0.3)
        axes[0].set_ylabel("share of the problems posed to it")


def plot_work_precision(runs: pandas.DataFrame, path: Path) -> None:
    """Draw the share right at each accuracy over the mean time, a point a setting."""
    table = by_setting(runs)
    with _panels(runs, path) as axes:
        for panel, accuracy in zip(axes, accuracies(runs), strict=True):
            for solver, style in _line_of(runs).items():
                own = table[table["solver"] == solver]
                seconds = own[f"mean seconds {accuracy:.0e}"]
                share = own[f"right {accuracy:.0e}"] / own["runs"]
                panel.plot(seconds, share, marker="o", markersize=4, **style)
            panel.set(xscale="log", ylim=(-0.03, 1.03), title=f"{accuracy:.0e}")
            panel.set_xlabel("mean time, the limit where not right [s]")
            panel.grid(alpha=0.3)
        axes[0].set_ylabel("share right; a point a setting")


def _milliseconds(seconds: float) -> str:
    """Write seconds as a number of milliseconds, "-" for NaN."""
    return "-" if np.isnan(seconds) else number(1e3 * seconds)


def _small(value: float) -> str:
    """Write a small number as "1.2e-07"; "-" stands for NaN, an unknown number."""
    return "-" if np.isnan(value) else f"{value:.1e}"


def _markdown(table: pandas.DataFrame) -> str:
    """Return a data frame as a Markdown table."""
    cells = table.astype(str).to_numpy().tolist()
    return "\n".join(markdown_lines(list(table.columns), cells))


def _ranking_in_words(table: pandas.DataFrame) -> str:
    """Return a ranking as a Markdown table."""
    known = contestants()
    rows = []
    for row in table.to_dict("records"):
        low, high = wilson(row["right"], row["run"])
        who = known.get(row["solver"])
        rows.append(
            {
                "solver": row["solver"],
                "right": row["right"],
                "of": row["run"],
                "95 % interval": f"{100 * low:.0f} to {100 * high:.0f} %",
                "silently wrong": row["wrong"],
                "proved": row["proved"],
                "certifies": "yes" if who is not None and who.certifies else "",
                "median [ms]": _milliseconds(row["seconds"]),
                "spread": "-" if np.isnan(row["spread"]) else f"{row['spread']:.0%}",
                "form [ms]": _milliseconds(row["form_seconds"]),
                "files [ms]": _milliseconds(row["file_seconds"]),
                "beside the row above": _beside_in_words(row),
            }
        )
    return _markdown(pandas.DataFrame(rows))


def _beside_in_words(row: dict[str, float]) -> str:
    """Say how a contestant compares with the one above it in the ranking."""
    if np.isnan(row["p"]):
        return ""
    how = "about as right" if row["p"] > LEVEL else "less often right"
    said = f"{how} ({row['one']:.0f} to {row['other']:.0f}, p {row['p']:.2g})"
    if np.isnan(row["ratio"]):
        return said
    if row["p_time"] > LEVEL:
        return f"{said}, about as fast"
    return f"{said}, {number(row['ratio'])} times as long (p {row['p_time']:.1g})"


def _settings_in_words(table: pandas.DataFrame) -> str:
    """Return the summary by setting as a Markdown table."""
    forms: dict[str, Callable[[Any], str]] = dict.fromkeys(
        ("error", "objective_error", "violation", "own_gap"), _small
    )
    forms |= {name: _milliseconds for name in table if "seconds" in str(name)}
    forms["attempts"] = "{:.1f}".format
    texts = {
        name: column.map(forms.get(str(name), str)) for name, column in table.items()
    }
    shown = pandas.DataFrame(texts).drop(columns=["error", "version"])
    names = {
        "objective_error": "error",
        "own_gap": "dual gap",
        "file_seconds": "files [ms]",
    }
    heads = {
        name: str(name).replace("mean seconds", "time [ms]").replace("_", " ")
        for name in shown
    }
    return _markdown(shown.rename(columns=heads | names))


def _contestants_in_words(runs: pandas.DataFrame) -> str:
    """Return who took part as a Markdown table: what it is, its version, its clock."""
    versions = dict(zip(runs["solver"], runs["version"], strict=True))
    nobody = Contestant("", "answers made elsewhere", None, None, clock="as stated")  # type: ignore[arg-type]
    known = contestants()
    rows = [
        (name, version, (who := known.get(name, nobody)).description, who.clock)
        for name, version in sorted(versions.items())
    ]
    heads = ["solver", "version", "what it is", "its time holds"]
    return _markdown(pandas.DataFrame(rows, columns=heads))


def by_problem(runs: pandas.DataFrame, accuracy: float) -> pandas.DataFrame:
    """Return how each solver did on each problem: rows are problems, columns solvers.

    A silently wrong answer is followed by its error.
    """
    cells = best_answers(runs, accuracy)
    wrong = [
        f"**WRONG** {x:.0e}" if np.isfinite(x) else "**WRONG**" for x in cells["error"]
    ]
    said = np.where(cells["class"] == "silently_wrong", wrong, cells["class"])
    grid = cells.assign(said=said).pivot(
        index="problem", columns="solver", values="said"
    )
    order = [x for x in runs["problem"].unique() if x in grid.index]
    return grid.fillna("n/a").loc[order].reset_index()


def write_summary(
    folder: Path,
    runs: pandas.DataFrame,
    absent: dict[str, str],
    not_applicable: Sequence[tuple[str, str, str]],
) -> list[Path]:
    """Write the summary of a shootout: summary.md, summary.csv and two pictures.

    Parameters
    ----------
    absent : dict of str to str
        Why a solver or problem was left out, by its name.
    not_applicable : sequence of (str, str, str)
        Problem, solver, and why the one cannot be posed to the other.
    """
    missing = [f"{name}: {reason}" for name, reason in sorted(absent.items())]
    n_by_solver_and_reason = Counter((solver, why) for _, solver, why in not_applicable)
    for (solver, reason), n in sorted(n_by_solver_and_reason.items()):
        missing.append(f"{solver}: not applicable to {count(n, 'problem')}: {reason}")
    unproved = sorted(set(runs["problem"][runs["outcome"] == "unproved"]))
    missing += [f"{name}: no interval is proved that could judge" for name in unproved]
    rankings = []
    for name, part in _by_set(runs):
        n = part["problem"].nunique()
        rankings.append(
            f"## {(name or 'other').capitalize()} problems: {n} {SETS[name]}"
        )
        for accuracy in accuracies(runs):
            table = _ranking_in_words(ranking(best_answers(part, accuracy)))
            rankings.append(f"### At {accuracy:.0e}, {name or 'other'}\n\n{table}")
    settings = by_setting(runs)
    tightest = accuracies(runs)[-1]
    template = Path(__file__).with_suffix(".md").read_text("utf-8")
    content = template.format(
        sentences="".join(f"- {sentence}\n" for sentence in sentences(runs)),
        limits=" and ".join(f"{x:g}" for x in sorted(runs["time_limit"].unique())),
        repeats=runs["repeats"].max(),
        rankings="\n\n".join(rankings) + "\n",
        settings=_settings_in_words(settings),
        contestants=_contestants_in_words(runs),
        tightest=tightest,
        problems=_markdown(by_problem(runs, tightest)),
        left_out="".join(f"- {line}.\n" for line in missing),
        machines=", ".join(sorted(runs["machine"].unique())),
        minutes=(runs["seconds"] * runs["repeats"]).sum() / 60.0,
    )
    paths = [folder / name for name in ("summary.md", "summary.csv")]
    write_text(paths[0], content)
    write_text(paths[1], settings.to_csv(index=False, lineterminator="\n"))
    if importlib.util.find_spec("matplotlib") is None:
        return paths
    pictures = {"work_precision.svg": plot_work_precision, "profile.svg": plot_profile}
    for name, plot in pictures.items():
        plot(runs, folder / name)
    return [*paths, *(folder / name for name in pictures)]
