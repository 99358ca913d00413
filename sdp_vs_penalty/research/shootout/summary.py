"""What the runs say: one table by solver, one by problem, which solver to use, and what each was told.

The shifted geometric mean is exp(mean log(t + s)) - s with s = 10 ms over all runs, those that were not
right at the time limit. Performance profiles (Dolan, More, Math. Program. 2002), by accuracy: for each
solver the share of problems that it brought to it, within a factor of the fastest solver that did. A
run counts by its figures, whatever it was asked for: objective error and violation at most ten times the
accuracy, and a claim of success; or infeasibility, rightly claimed.
"""

import importlib.util
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from sdp_vs_penalty.files import write_bytes, write_text
from sdp_vs_penalty.formatting import markdown_table, number
from sdp_vs_penalty.problem.load import load_problem, problem_names
from sdp_vs_penalty.research.shootout.contestants import contestants
from sdp_vs_penalty.research.shootout.judge import CLASSES, SLACK
from sdp_vs_penalty.research.shootout.runner import Row


def reached(runs: pandas.DataFrame, accuracy: float) -> pandas.Series:
    """Whether each run claims success rightly at this accuracy."""
    error = runs[["objective_error", "violation"]].max(axis=1)
    near = np.isfinite(runs["lower"]) & (error <= SLACK * accuracy)
    refuted = (runs["claimed"] == "infeasible") & (runs["class"] == "right")
    return refuted | (runs["claimed"] == "optimal") & near


def at_accuracy(runs: pandas.DataFrame, accuracy: float) -> pandas.DataFrame:
    """The runs asked for this accuracy, and those of contestants that cannot be asked."""
    return runs[(runs["settings"] == "default") | (runs["accuracy"] == accuracy)]


def accuracies(runs: pandas.DataFrame) -> list[float]:
    """What was asked for, loose to tight; 1e-8 where nobody could be asked."""
    asked = runs.loc[runs["settings"] != "default", "accuracy"].unique()
    return sorted(asked, reverse=True) or [1e-8]


def profile(runs: pandas.DataFrame, accuracy: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Of each solver (ratios, shares): the corners of its step."""
    asked, count = at_accuracy(runs, accuracy), runs["problem"].nunique()
    right = asked[reached(asked, accuracy)]
    seconds = right["seconds"].clip(lower=1e-6)
    ratio = seconds / seconds.groupby(right["problem"]).transform("min")
    steps = {s: np.sort(ratio[right["solver"] == s]) for s in sorted(asked["solver"].unique())}
    return {solver: (x, np.arange(1, len(x) + 1) / count) for solver, x in steps.items()}


def plot_profile(runs: pandas.DataFrame, path: Path) -> bool:
    """SVG of the solvers that ran on four fifths of the problems at least, an accuracy a panel; False
    without matplotlib."""
    if importlib.util.find_spec("matplotlib") is None:
        return False
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    asked = accuracies(runs)
    alone = runs[~runs["solver"].str.endswith(" certified")]
    count = alone.groupby("solver")["problem"].nunique()
    shown = sorted(count.index[count >= 0.8 * count.max()])
    with plt.rc_context({"svg.hashsalt": "shootout", "font.size": 9}):
        size = (3.2 * len(asked) + 1.6, 3.4)
        shared: dict[str, Any] = {"sharey": True, "squeeze": False, "layout": "constrained"}
        figure, (axes,) = plt.subplots(1, len(asked), figsize=size, **shared)
        for panel, accuracy in zip(axes, asked, strict=True):
            curves = profile(runs, accuracy)
            for k, solver in enumerate(shown):
                ratios, shares = curves.get(solver, (np.zeros(0), np.zeros(0)))
                ends = np.append(ratios, 1e5), np.append(shares, shares[-1:] if len(shares) else 0.0)
                style = {"color": f"C{k % 10}", "linestyle": "-" if k < 10 else "--"}
                width = 2.2 if solver == "lmi-sdp" else 1.2
                panel.step(*ends, where="post", label=solver, linewidth=width, **style)
            panel.set(xscale="log", xlim=(0.9, 1e4), ylim=(0.0, 1.03), title=f"{accuracy:.0e}")
            panel.set_xlabel("time over the fastest that was right")
            panel.grid(alpha=0.3)
        axes[0].set_ylabel("share of problems got right")
        labels = axes[0].get_legend_handles_labels()
        figure.legend(*labels, loc="outside right upper", frameon=False)
        file = io.BytesIO()
        figure.savefig(file, format="svg", metadata={"Date": None})
        plt.close(figure)
    write_bytes(path, file.getvalue())
    return True


_HEADINGS = {
    "success_percent": "right %", "silently_wrong": "silently wrong", "mean_seconds": "time [ms]",
    "objective_error": "error", "own_gap": "dual gap", "dimacs": "DIMACS",
}  # fmt: skip
#: What is told of the answers called optimal: the median, each for itself.
_FIGURES = ["objective_error", "violation", "own_gap", "dimacs"]


def summary_rows(runs: pandas.DataFrame, time_limit: float) -> list[Row]:
    """One row for each solver and settings: how often right, how often silently wrong, how fast."""
    ordered = runs.sort_values(["solver", "accuracy"], ascending=[True, False])
    out = []
    for (solver, settings), mine in ordered.groupby(["solver", "settings"], sort=False):
        counts = mine["class"].value_counts().reindex(CLASSES, fill_value=0)
        times = mine["seconds"].where(mine["class"] == "right", time_limit)
        claims = mine.loc[mine["claimed"] == "optimal", _FIGURES].replace(np.inf, np.nan)
        out.append(
            {
                "solver": solver,
                "settings": settings,
                "runs": len(mine),
                "success_percent": 100.0 * counts["right"] / len(mine),
                **counts,
                "mean_seconds": float(np.exp(np.mean(np.log(times.to_numpy() + 0.01))) - 0.01),
                **claims.median(),
                "attempts": f"{mine['attempts'].mean():.1f}",
                "version": mine["version"].iloc[-1],
            }
        )
    return out


def _milliseconds(seconds: float) -> str:
    return number(1e3 * seconds)


def _short(name: str, value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    if name == "mean_seconds":
        return _milliseconds(value)
    if name == "success_percent":
        return f"{value:.0f}"
    return "-" if np.isnan(value) else f"{value:.1e}"


def by_problem(runs: pandas.DataFrame) -> str:
    """Markdown: problems down, solvers across, the class at the tightest accuracy asked for.

    Beside a wrong answer stands the larger of its error and its violation, both relative.
    """
    tightest = runs.sort_values("accuracy").drop_duplicates(["problem", "solver"])
    worst = tightest[["objective_error", "violation"]].max(axis=1)
    wrong = [f"**WRONG** {x:.0e}" if np.isfinite(x) else "**WRONG**" for x in worst]
    said = np.where(tightest["class"] == "silently_wrong", wrong, tightest["class"])
    grid = tightest.assign(said=said).pivot(index="problem", columns="solver", values="said")
    grid = grid.fillna("n/a").loc[runs["problem"].unique()].reset_index()
    return "\n".join(markdown_table(list(grid.columns), grid.to_numpy().tolist())) + "\n"


def ranking(runs: pandas.DataFrame, accuracy: float, links: int | None = None) -> list[Row]:
    """The contestants, on arms of so many links (None: on everything), those that reach the accuracy
    most often first.

    run : on how many of the ``problems`` it ran: log det cannot be posed to all, time ran out for some.
    seconds : the median where it was right.
    """
    mine = at_accuracy(runs, accuracy)
    if links is not None:
        # By its name or its robot; an ill-conditioned problem has neither.
        robots = {name: load_problem(name).robot.n for name in problem_names()}
        named = mine["problem"].str.extract(r"^chain of (\d+)")[0].astype(float)
        mine = mine[named.fillna(mine["group"].map(robots)) == links]
    right = reached(mine, accuracy)
    found = mine.assign(right=right, wrong=mine["class"] == "silently_wrong")
    found["seconds"] = found["seconds"].where(right)
    table = found.groupby("solver").agg(
        **{"right": ("right", "sum"), "run": ("problem", "nunique")},
        **{"silently wrong": ("wrong", "sum"), "seconds": ("seconds", "median")},
        attempts=("attempts", "mean"),
    )
    table = table.assign(problems=mine["problem"].nunique()).reset_index()
    order = {"by": ["right", "silently wrong", "seconds"], "ascending": [False, True, True]}
    return table.sort_values(**order, na_position="first", kind="stable").to_dict("records")


def advice(table: Sequence[Row], where: str) -> list[str]:
    """Sentences from a ranking that is not empty: which solver to take, and whose answers to check."""
    best, worst = table[0], max(table, key=lambda r: r["silently wrong"])
    enough = [r for r in table if r["right"] >= 0.9 * best["right"] and not r["silently wrong"]]
    quick = min(enough, key=lambda r: r["seconds"], default=best)
    said = [
        f"Take {best['solver']}: right on {best['right']} of {best['problems']} problems {where}, "
        f"{best['silently wrong']} times silently wrong, {_milliseconds(best['seconds'])} ms (median).",
        "The fastest of those never silently wrong and right at least nine tenths as often is "
        f"{quick['solver']}: {quick['right']} of {quick['problems']}, "
        f"{_milliseconds(quick['seconds'])} ms.",
    ]
    if worst["silently wrong"]:
        of = f"{worst['silently wrong']} of {worst['run']}"
        said.append(f"Check every answer of {worst['solver']}: silently wrong on {of}.")
    return said


def answer(runs: pandas.DataFrame, links: int = 7, accuracy: float = 1e-6) -> str:
    """Markdown: which solver for so many links, and why; empty where nothing was run on them."""
    if not (table := ranking(runs, accuracy, links)):
        return ""
    cells = [
        (r["solver"], *(str(r[k]) for k in ("right", "run", "silently wrong")),
         _milliseconds(r["seconds"]), f"{r['attempts']:.1f}")
        for r in table
    ]  # fmt: skip
    heads = ("solver", "right", "of problems run", "silently wrong", "median [ms]", "attempts")
    words = " ".join(advice(table, f"of {links} links at {accuracy:.0e}"))
    return "\n".join([words, "", *markdown_table(heads, cells)]) + "\n"


def sentences(runs: pandas.DataFrame) -> list[str]:
    """Advice from all runs at the tightest accuracy asked for."""
    tightest = accuracies(runs)[-1]
    table = ranking(runs, tightest)
    return advice(table, f"at {tightest:.0e}") if table else []


def write_summary(
    folder: Path,
    runs: pandas.DataFrame,
    time_limit: float,
    absent: dict[str, str],
    not_applicable: Sequence[tuple[str, str, str]],
) -> list[Path]:
    """summary.md, summary.csv and profile.svg beside runs.csv; the paths written."""
    table = summary_rows(runs, time_limit)
    missing = [f"{name}: {reason}" for name, reason in sorted(absent.items())]
    for (solver, reason), count in sorted(Counter(x[1:] for x in not_applicable).items()):
        missing.append(f"{solver}: not applicable to {count} problem(s): {reason}")
    asked = accuracies(runs)
    ran = [c for name, c in contestants().items() if name in runs["solver"].unique()]
    told = [[c.name, c.told(a)] for c in ran if c.tunable for a in dict.fromkeys((asked[0], asked[-1]))]
    heads = [_HEADINGS.get(h, h) for h in table[0]] if table else []
    cells = [[_short(h, x) for h, x in row.items()] for row in table]
    text = Path(__file__).with_suffix(".md").read_text()  # a file beside this one
    said = text.format(
        sentences="".join(f"- {sentence}\n" for sentence in sentences(runs)),
        minutes=runs["seconds"].sum() / 60.0,
        limit=time_limit,
        answer=answer(runs),
        told="\n".join(markdown_table(["solver", "told"], told)),
        table="\n".join(markdown_table(heads, cells)),
        problems=by_problem(runs),
        left_out="".join(f"- {line}.\n" for line in missing),
        machines=", ".join(sorted(runs["machine"].unique())),
    )
    paths = [folder / name for name in ("summary.md", "summary.csv")]
    write_text(paths[0], said)
    write_text(paths[1], pandas.DataFrame(table).to_csv(index=False, lineterminator="\n"))
    picture = folder / "profile.svg"
    return [*paths, picture] if plot_profile(runs, picture) else paths
