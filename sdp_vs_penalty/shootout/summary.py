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
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.files import write_text, writing
from sdp_vs_penalty.formatting import count, number, sentence, words
from sdp_vs_penalty.results.table import markdown_lines
from sdp_vs_penalty.shootout.catalogue import everything
from sdp_vs_penalty.shootout.contestants import contestants
from sdp_vs_penalty.shootout.judge import CLASSES, FAR, SLACK, classes
from sdp_vs_penalty.shootout.statistics import (
    SAME_TIME,
    SHORTEST,
    beside,
    can_tell,
    level,
    wilson,
)
from sdp_vs_penalty.solvers import SOLVERS

#: Accuracies at which every setting is judged.
SHOWN = (1e-4, 1e-6, 1e-8)
#: Shift of the geometric mean of times [s]: shorter times hardly differ in it.
_TIME_SHIFT = 0.01
#: What claims are that nobody can rely on, by their class, in words.
DOUBTFUL = {
    "false_claim": "false claims",
    "far": "met its own tolerance, but violates a constraint, or its objective is far",
    "far_unchecked": (
        "violates a constraint, or its objective is far; says that its own rule was met,"
        " not checked by us"
    ),
}
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

    It is the fastest right one, whatever accuracy was asked for; else the most accurate
    claim; else how it failed. A claim that was asked for less than the accuracy is neither
    far nor false. Unproved problems are left out, and so are solvers that were never
    asked for the accuracy.

    Returns
    -------
    DataFrame
        Rows of runs.csv, one for each problem and solver, with "class" and "right";
        "proved", whether any right answer is proved by the solver's own multipliers, or
        infeasibility is by a contestant that claims it with a proof only; "proves",
        whether it returns multipliers at all.
    """
    unproved = runs["problem"][runs["outcome"] == "unproved"]
    tightest = runs.groupby("solver")["accuracy"].transform("min")
    runs = runs[~runs["problem"].isin(unproved) & (tightest <= accuracy)]
    kinds = classes(runs, accuracy)
    is_right = kinds == "right"
    is_loose = ~is_right & (runs["error"] > FAR) & (runs["accuracy"] > accuracy)
    is_loose &= runs["outcome"] == "claim"
    kinds = kinds.where(~is_loose, "inaccurate")
    # Best first: right, claimed, inaccurate in its own words, failed; last a claim that
    # is far and was asked for less.
    order = np.select(
        [is_right, is_loose, runs["outcome"] == "claim", kinds == "inaccurate"],
        [0.0, 3.0, 1.0, 1.5],
        2.0,
    )
    # Right answers are ordered by time, the others by error.
    second_key = runs["seconds"].where(is_right, runs["error"])
    by_own_dual = runs["own_gap"] <= SLACK * accuracy
    certifying = {name for name, c in contestants().items() if c.certifies}
    is_checked = (runs["claimed"] == "infeasible") & runs["solver"].isin(certifying)
    is_proved = is_right & (by_own_dual | is_checked)
    answers = [runs["problem"], runs["solver"]]
    ranked = runs.assign(**{"class": kinds, "right": is_right})
    ranked["proved"] = is_proved.groupby(answers).transform("any")
    has_dual = pandas.Series(np.isfinite(runs["own_gap"]), runs.index)
    ranked["proves"] = has_dual.groupby(runs["solver"]).transform("any")
    ranked = ranked.assign(order=order, second_key=second_key)
    ranked = ranked.sort_values(["order", "second_key", "accuracy"], kind="stable")
    return ranked.drop_duplicates(["problem", "solver"]).drop(
        columns=["order", "second_key"]
    )


def is_ranked(cells: pandas.DataFrame) -> bool:
    """Tell whether a table has problems enough to rank its contestants."""
    return can_tell(cells["problem"].nunique(), cells["solver"].nunique())


def ranking(cells: pandas.DataFrame) -> pandas.DataFrame:
    """Rank the contestants by the lower end of the 95 % interval of their share right.

    A table's problems are posed to all of its contestants, as far as they were run. Ties
    are ranked by fewer false and far answers, then by shorter time. Too few problems
    rank nobody (:func:`is_ranked`): the order is that of names.

    Returns
    -------
    DataFrame
        One row for each contestant: "right" of "run" problems; "low", the lower end;
        how many are "false_claim", "far", "far_unchecked"; "proved", by its own
        multipliers (NaN without any); medians of "seconds", the limit where it is not
        right (NaN where half are not), of "spread" and "file_seconds" where it is, and
        of "form_seconds", which are one median of all solvers for each problem; and what
        :func:`~statistics.beside` says of it and the row above.
    """
    # 1. Of each cell, what the table counts and takes medians of.
    is_right = cells["right"]
    spread = (cells["seconds_most"] - cells["seconds_least"]) / cells["seconds"]
    form = cells["form_seconds"].where(cells["form_seconds"] > 0.0)
    form_of_problem = form.groupby(cells["problem"]).transform("median")
    medians = {
        "seconds": cells["seconds"].where(is_right, cells["time_limit"]),
        "spread": spread.where(is_right & (cells["repeats"] > 1)),
        "file_seconds": cells["file_seconds"].where(is_right),
        "form_seconds": form_of_problem.where(form.notna(), 0.0),
    }
    counts = {name: cells["class"] == name for name in DOUBTFUL}
    rows = cells.assign(**counts, **medians)
    # 2. A row a solver.
    columns: dict[str, Any] = {"run": ("problem", "size"), "proves": ("proves", "any")}
    columns |= {name: (name, "sum") for name in ("right", "proved", *DOUBTFUL)}
    columns |= {name: (name, "median") for name in medians}
    table = rows.groupby("solver").agg(**columns).reset_index()
    table["proved"] = table["proved"].where(table["proves"], np.nan)
    pairs_right = zip(table["right"], table["run"], strict=True)
    table["low"] = [wilson(right, n)[0] for right, n in pairs_right]
    table["doubtful"] = table[list(DOUBTFUL)].sum(axis=1)
    # 3. In order, each beside the one above.
    if is_ranked(cells):
        table = table.sort_values(
            by=["low", "doubtful", "seconds"],
            ascending=[False, True, True],
            kind="stable",
            ignore_index=True,
        )
    names = table["solver"].tolist()
    pairs = [beside(cells, *pair) for pair in pairwise(names)]
    is_most = 2 * table["right"] > table["run"]
    table["seconds"] = table["seconds"].where(is_most)
    first = {name: np.nan for name in ("n", "one", "other", "p", "ratio", "p_time")}
    return table.join(pandas.DataFrame([first, *pairs][: len(names)], dtype=float))


def about_as_right(cells: pandas.DataFrame, table: pandas.DataFrame) -> list[str]:
    """List the first of a ranking and all that no test tells from it."""
    names: list[str] = table["solver"][table["right"] > 0].tolist()
    test_level = level(len(table))
    return names[:1] + [
        name for name in names[1:] if beside(cells, names[0], name)["p"] > test_level
    ]


def sentences(runs: pandas.DataFrame) -> list[str]:
    """Say which solvers are right, which of them are fast, and whom to check.

    Returns
    -------
    list of str
        Of each table, at each accuracy: all numbers are of :func:`ranking`.
    """
    text = []
    for name, form, _, part in _tables(runs):
        for accuracy in accuracies(runs):
            text += _advice(part, accuracy, name, form)
        others = sorted(set(runs["solver"]) - set(part["solver"]))
        if others:
            n = part["problem"].nunique()
            verb = "were" if len(others) > 1 else "was"
            text.append(f"{words(others)} {verb} given none of {count(n, name)}{form}.")
    is_far = (runs["error"] > FAR) & np.isfinite(runs["error"])
    far = runs[(runs["outcome"] == "claim") & is_far]
    is_near = ~_beyond_far(far)["objective_error"]
    near_by_solver = [
        f"{near.sum()} of {len(near)} of {solver}"
        for solver, near in is_near.groupby(far["solver"])
        if near.any()
    ]
    if near_by_solver:
        text.append(
            f"Of claimed optima that are far, under any setting, {words(near_by_solver)} have an"
            f" objective within {FAR:g}: only their violation is above."
        )
    tight = runs[runs["accuracy"] == runs["accuracy"].min()]
    modest = tight[tight["outcome"] == "inaccurate"]
    is_within = modest["error"] <= SLACK * modest["accuracy"]
    within_by_solver = [
        f"{solver} {len(within)} ({within.sum()})"
        for solver, within in is_within.groupby(modest["solver"])
    ]
    if within_by_solver:
        asked = tight["accuracy"].iloc[0]
        text.append(
            "An answer that calls itself inaccurate counts as that, whatever its figures."
            f" Asked for {asked:.0e}, so many do (in brackets: within {SLACK * asked:.0e}):"
            f" {words(within_by_solver)}."
        )
    ours = runs[(runs["solver"] == "lmi-sdp") & runs["status"].str.contains(": proved")]
    if len(ours):
        by_clarabel = ours["problem"][~ours["status"].str.startswith("primal-dual")]
        of = f"{by_clarabel.nunique()} of {ours['problem'].nunique()} problems"
        text.append(f"lmi-sdp is a portfolio: it called Clarabel on {of}.")
        of_all = runs[runs["solver"] == "lmi-sdp"]
        tightest = of_all["accuracy"].min()
        alone = of_all[of_all["accuracy"] == tightest]
        kinds = classes(alone, tightest)
        text.append(
            f"lmi-sdp solves to {LmiSdp.accuracy:g} whatever it is asked for, and claims the"
            f" gap that it proves: of its answers asked for {tightest:.0e} alone,"
            f" {(kinds == 'right').sum()} of {len(alone)} are right, and"
            f" {(kinds == 'inaccurate').sum()} it calls inaccurate, whatever their figures."
        )
    return text


def _tables(runs: pandas.DataFrame) -> list[tuple[str, str, str, pandas.DataFrame]]:
    """Return the runs of each table that has any, in the order of SETS.

    Problems with log det have tables of their own, because fewer solvers take them: a
    solver that ran fewer problems is harder to tell from the first.

    Returns
    -------
    list of (str, str, str, DataFrame)
        Name of one of its problems, " with log det" or "", what they are, the runs.
    """
    entropic = {e.name for e in everything() if "regulariser" in e.families}
    has_log_det = runs["problem"].isin(entropic)
    forms = {"": ~has_log_det, " with log det": has_log_det}
    parts = [
        (
            f"{name or 'chosen'} problem",
            form,
            about,
            runs[(runs["set"] == name) & those],
        )
        for name, about in SETS.items()
        for form, those in forms.items()
    ]
    return [part for part in parts if len(part[-1])]


def _advice(runs: pandas.DataFrame, accuracy: float, name: str, form: str) -> list[str]:
    """Return the sentences about one table at one accuracy."""
    cells = best_answers(runs, accuracy)
    ranked = ranking(cells)
    where = count(cells["problem"].nunique(), name) + form
    if not (good := about_as_right(cells, ranked)):
        return [f"At {accuracy:.0e}, nobody is right on any of {where}."]
    table = ranked.set_index("solver")
    if not is_ranked(cells):
        counts = _by_count(table, "right")
        advice = f"{where} cannot rank anybody. Right to {accuracy:.0e}: {counts}"
        return [f"{advice}{_doubtful(table, cells)}."]
    first = good[0]
    same = [
        _share(table, name, "right", common=beside(cells, first, name)["n"])
        for name in good[1:]
    ]
    advice = f"Right to {accuracy:.0e} on {where}: most surely"
    advice += f" {_share(table, first, 'right')}"
    if same:
        advice += f", from which no test tells {words(same)}"
    known = contestants()
    before = table.loc[first, "form_seconds"]
    seconds = table["seconds"]
    if np.isfinite(seconds[first]):
        advice += f"; {first} takes {_milliseconds(seconds[first])} ms (median"
        advice += (
            f"; {_milliseconds(before)} ms before for its form)" if before else ")"
        )
    if "lmi-sdp" in good[1:] and np.isfinite(seconds["lmi-sdp"]):
        ours = _milliseconds(seconds["lmi-sdp"])
        advice += f", lmi-sdp {ours} ms ({known['lmi-sdp'].clock})"
    if proving := [s for s in good if s in known and known[s].certifies]:
        advice += (
            f"; {words(proving)} {'prove' if len(proving) > 1 else 'proves'} each claim"
        )
    solvers_of_ours = [
        name for name in table.index if SOLVERS.provider(name) and name not in good
    ]
    for solver in solvers_of_ours:
        advice += f". {_share(table, solver, 'right')}: {_other_answers(cells, solver)}"
    return [f"{advice}{_doubtful(table, cells)}."]


def _other_answers(cells: pandas.DataFrame, name: str) -> str:
    """List what a contestant's answers are that are not right, the most frequent first."""
    kinds = cells["class"][cells["solver"] == name].value_counts()
    others = [f"{kind} {n}" for kind, n in kinds.items() if kind != "right"]
    hint = " (--time-limit gives more time)" if "timeout" in kinds.index else ""
    return f"{words(others)}{hint}"


def _doubtful(table: pandas.DataFrame, cells: pandas.DataFrame) -> str:
    """Say who claims on how many problems what is false or far, "" if nobody does."""
    sentences = ""
    for kind, what in DOUBTFUL.items():
        if by := _by_count(table, kind, cells[cells["class"] == kind]):
            sentences += f". {sentence(what)}: {by}"
    return sentences


def _by_count(
    table: pandas.DataFrame, column: str, cells: pandas.DataFrame | None = None
) -> str:
    """List the contestants of a ranking whose count in a column is not zero, with it.

    Parameters
    ----------
    cells : DataFrame, optional
        The answers that are counted; with them the text names what is claimed falsely,
        and which figure is far.
    """
    counts = table[column][table[column] > 0]
    texts = []
    for name in counts.sort_values(ascending=False, kind="stable").index:
        claims = list[str]()
        if cells is not None:
            answers = cells[cells["solver"] == name]
            claims = sorted(set(answers["claimed"]) - {"optimal"})
            if np.isfinite(answers["error"]).all():
                n_violation, n_objective = _beyond_far(answers).sum()
                claims.append(f"violation on {n_violation}, objective on {n_objective}")
        texts.append(_share(table, name, column, claims, in_brackets=False))
    return words(texts) if texts else ""


def _beyond_far(answers: pandas.DataFrame) -> pandas.DataFrame:
    """Tell of each answer whether its violation, and whether its objective is far."""
    figures = answers[["violation", "objective_error"]]
    return (figures > FAR) & np.isfinite(figures)


def _share(
    table: pandas.DataFrame,
    name: str,
    column: str,
    more: Sequence[str] = (),
    common: float = np.nan,
    in_brackets: bool = True,
) -> str:
    """Write on how many problems a contestant has what a column counts, with notes.

    Parameters
    ----------
    more : sequence of str
        Words to add behind the share.
    common : float
        Number of problems on which it is compared; written if it ran more.
    in_brackets : bool
        Whether the share is in brackets as well: "scs (3 of 4)", else "scs on 3 of 4".
    """
    n_run = table.loc[name, "run"]
    notes = list(more)
    if common < n_run:
        notes.append(f"compared on {common:.0f}")
    who = contestants().get(name)
    if who is not None and who.promise is not None:
        notes.append(f"unscaled, one setting: {who.promise:g}")
    number_of = f"{table.loc[name, column]} of {n_run}"
    if in_brackets:
        return f"{name} ({'; '.join([number_of, *notes])})"
    in_words = f" ({'; '.join(notes)})" if notes else ""
    return f"{name} on {number_of}{in_words}"


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


def _ranking_in_words(cells: pandas.DataFrame) -> str:
    """Return the ranking of a table as a Markdown table; counts if nobody is ranked."""
    known = contestants()
    table = ranking(cells)
    clocks = {name: c.clock for name, c in known.items()}
    above = ""
    rows = []
    for row in table.to_dict("records"):
        low, high = wilson(row["right"], row["run"])
        name = row["solver"]
        who = known.get(name)
        is_one_clock = clocks.get(above) == clocks.get(name)
        rows.append(
            {
                "solver": name,
                "right": row["right"],
                "of": row["run"],
                "95 % interval": f"{100 * low:.0f} to {100 * high:.0f} %",
                **{DOUBTFUL[kind]: row[kind] for kind in DOUBTFUL},
                "proved": "n/a" if np.isnan(row["proved"]) else f"{row['proved']:.0f}",
                "certifies": "yes" if who is not None and who.certifies else "",
                "median [ms]": _milliseconds(row["seconds"]),
                "its time holds": clocks.get(name, "as stated").partition(";")[0],
                "spread": "-" if np.isnan(row["spread"]) else f"{row['spread']:.0%}",
                "form [ms]": _milliseconds(row["form_seconds"]),
                "files [ms]": _milliseconds(row["file_seconds"]),
                "beside the row above": _beside_in_words(
                    row, level(len(table)), is_one_clock
                ),
            }
        )
        above = name
    printed = pandas.DataFrame(rows)
    if rows and not is_ranked(cells):
        printed = printed.drop(columns=["95 % interval", "beside the row above"])
    return _markdown(printed)


def _beside_in_words(row: dict[str, float], at: float, is_one_clock: bool) -> str:
    """Say how a contestant compares with the one above it in the ranking."""
    if np.isnan(row["p"]):
        return ""
    comparison = "about as right" if row["p"] > at else "less often right"
    sentence = (
        f"{comparison} ({row['one']:.0f} to {row['other']:.0f} of {row['n']:.0f},"
    )
    sentence += f" p {row['p']:.2g})"
    if np.isnan(row["ratio"]):
        return sentence
    if not is_one_clock:
        return f"{sentence}; another clock"
    is_near = 1.0 / SAME_TIME < row["ratio"] < SAME_TIME
    if is_near:
        return f"{sentence}, about as fast"
    if row["p_time"] > at:
        return f"{sentence}, speeds not told apart"
    return f"{sentence}, {number(row['ratio'])} times as long (p {row['p_time']:.1g})"


def false_claims(runs: pandas.DataFrame) -> pandas.DataFrame:
    """List the false claims, one row for each problem, solver and claim.

    Returns
    -------
    DataFrame
        In words, with the accuracies that were asked for, and the size of the optimum in
        the units that were handed out.
    """
    those = runs[classes(runs, FAR / SLACK) == "false_claim"]
    rows = [
        {
            "problem": problem,
            "solver": solver,
            "claims": claimed,
            "asked for": ", ".join(f"{a:.0e}" for a in part["accuracy"]),
            "status": part["status"].iloc[0],
            "optimum": _small(part["upper"].iloc[0]),
        }
        for (problem, solver, claimed), part in those.groupby(
            ["problem", "solver", "claimed"], sort=False
        )
    ]
    return pandas.DataFrame(rows)


def _settings_in_words(table: pandas.DataFrame) -> str:
    """Return a table of :func:`by_setting` in Markdown: errors with few digits, times in
    milliseconds, headings in words."""
    format_by_column: dict[str, Callable[[Any], str]] = dict.fromkeys(
        ("error", "objective_error", "violation", "own_gap"), _small
    )
    format_by_column |= {
        name: _milliseconds for name in table if "seconds" in str(name)
    }
    format_by_column["attempts"] = "{:.1f}".format
    texts = {
        name: column.map(format_by_column.get(str(name), str))
        for name, column in table.items()
    }
    printed = pandas.DataFrame(texts).drop(columns=["error", "version"])
    headings = {
        name: str(name).replace("mean seconds", "time [ms]").replace("_", " ")
        for name in printed
    }
    headings |= {
        "objective_error": "error",
        "own_gap": "dual gap",
        "file_seconds": "files [ms]",
    }
    return _markdown(printed.rename(columns=headings))


def _contestants_in_words(runs: pandas.DataFrame) -> str:
    """Return who took part as a Markdown table: what it is, its version, its clock."""
    versions = dict(zip(runs["solver"], runs["version"], strict=True))
    known = contestants()
    rows = []
    for name, version in sorted(versions.items()):
        about = ("answers made elsewhere", "as stated")
        if who := known.get(name):
            about = (who.description, who.clock)
        rows.append((name, version, *about))
    heads = ["solver", "version", "what it is", "its time holds"]
    return _markdown(pandas.DataFrame(rows, columns=heads))


def by_problem(runs: pandas.DataFrame, accuracy: float) -> pandas.DataFrame:
    """Return how each solver did on each problem: rows are problems, columns solvers.

    A false claim is followed by what it claims, a far answer by both figures. "says
    inaccurate" is one that says so itself.
    """
    cells = best_answers(runs, accuracy)
    claims = []
    for row in cells.to_dict("records"):
        text = row["class"]
        if text == "false_claim":
            text = f"**FALSE** {row['claimed']}"
        elif text in ("far", "far_unchecked"):
            text = text.replace("_", ", ")
            text += f": objective {row['objective_error']:.0e}"
            text += f", violation {row['violation']:.0e}"
        elif row["outcome"] == text == "inaccurate":
            text = "says inaccurate"
        claims.append(text)
    grid = cells.assign(said=claims).pivot(
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
    left_out = [f"{name}: {reason}" for name, reason in sorted(absent.items())]
    n_by_solver_and_reason = Counter((solver, why) for _, solver, why in not_applicable)
    for (solver, reason), n in sorted(n_by_solver_and_reason.items()):
        left_out.append(f"{solver}: not applicable to {count(n, 'problem')}: {reason}")
    unproved = sorted(set(runs["problem"][runs["outcome"] == "unproved"]))
    left_out += [f"{name}: no interval is proved that could judge" for name in unproved]
    false = false_claims(runs)
    settings = by_setting(runs)
    tightest = accuracies(runs)[-1]
    timeouts = runs["status"][runs["outcome"] == "timeout"]
    template = Path(__file__).with_suffix(".md").read_text("utf-8")
    content = template.format(
        sentences="".join(f"- {sentence_list}\n" for sentence_list in sentences(runs)),
        limits=" and ".join(f"{x:g}" for x in sorted(runs["time_limit"].unique())),
        timeouts=len(timeouts),
        not_run=timeouts.str.startswith("not run").sum(),
        repeats=runs["repeats"].max(),
        rankings="\n\n".join(_rankings_in_words(runs)) + "\n",
        settings=_settings_in_words(settings),
        contestants=_contestants_in_words(runs),
        tightest=tightest,
        problems=_markdown(by_problem(runs, tightest)),
        false_claims=_markdown(false) if len(false) else "Nobody made any.",
        left_out="".join(f"- {line}.\n" for line in left_out),
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


def _rankings_in_words(runs: pandas.DataFrame) -> list[str]:
    """Return the headed rankings of each table at each accuracy, in Markdown."""
    parts = []
    for name, form, about, part in _tables(runs):
        title = f"{name.capitalize()}s{form}"
        parts.append(f"## {title}: {part['problem'].nunique()} {about}")
        for accuracy in accuracies(runs):
            cells = best_answers(part, accuracy)
            head = f"### At {accuracy:.0e}, {title.lower()}"
            if len(cells) and not is_ranked(cells):
                head += ": too few to rank anybody; counts, by name"
            parts.append(f"{head}\n\n{_ranking_in_words(cells)}")
    return parts
