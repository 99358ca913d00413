"""A page for each class of problem, and the answer to the question that most readers come with."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.shootout.profile import accuracies, at_accuracy, reached
from sdp_vs_penalty.shootout.results import Row, cell
from sdp_vs_penalty.show import markdown_table

#: What most readers want: an arm of seven links, to six digits.
LINKS, ACCURACY = 7, 1e-6
_LOOP = " certified"


def milliseconds(seconds: float) -> str:
    """Three digits, all digits above a second; a dash for what is none."""
    if not np.isfinite(seconds):
        return "-"
    return f"{1e3 * seconds:.3g}" if seconds < 1.0 else f"{1e3 * seconds:.0f}"


def links(row: Row) -> int | None:
    """How many links a regular problem has; None for a hostile one."""
    if "hostile" in row["group"]:
        return None
    known = {"emps": 1, "two_link": 2, "tx40": 6, "ur10e": 6, "panda": 7}
    named = re.match(r"chain of (\d+)", row["problem"])
    robot = row["group"] if row["group"] in known else row["problem"].partition(" ")[0]
    return int(named.group(1)) if named else known.get(robot)


def ranking(rows: Sequence[Row]) -> list[Row]:
    """The contestants on arms of LINKS links, those that reach ACCURACY most often first.

    A problem that cannot be posed to a contestant is one that it does not solve. seconds : the median
    where it was right.
    """
    mine = at_accuracy([r for r in rows if links(r) == LINKS], ACCURACY)
    problems = {r["problem"] for r in mine}
    out = []
    for solver in sorted({r["solver"] for r in mine}):
        runs = [r for r in mine if r["solver"] == solver]
        right = [r for r in runs if reached(r, ACCURACY)]
        out.append(
            {
                "solver": solver,
                "right": len(right),
                "problems": len(problems),
                "silently wrong": sum(r["class"] == "silently_wrong" for r in runs),
                "seconds": float(np.median([r["seconds"] for r in right])) if right else np.inf,
                "attempts": float(np.mean([r["attempts"] for r in runs])),
            }
        )
    return sorted(out, key=lambda r: (-r["right"], r["silently wrong"], r["seconds"]))


def answer(rows: Sequence[Row]) -> str:
    """Markdown: which solver for seven links at 1e-6, and why; empty where nothing was run on them."""
    table = ranking(rows)
    if not table:
        return ""
    best = table[0]
    enough = [r for r in table if r["right"] >= 0.9 * best["right"] and not r["silently wrong"]]
    quick = min(enough, key=lambda r: r["seconds"], default=best)
    text = [
        f"## Which solver for {LINKS} links at {ACCURACY:.0e}",
        "",
        f"Take **{best['solver']}**: right on {best['right']} of {best['problems']} problems of "
        f"{LINKS} links at {ACCURACY:.0e}, {best['silently wrong']} times silently wrong, "
        f"{milliseconds(best['seconds'])} ms (median), {best['attempts']:.1f} attempts on average.",
        f"The fastest of those never silently wrong and right at least nine tenths as often is "
        f"**{quick['solver']}**: {quick['right']} of {quick['problems']}, "
        f"{milliseconds(quick['seconds'])} ms.",
        "",
    ]
    cells = [
        (r["solver"], f"{r['right']} of {r['problems']}", str(r["silently wrong"]),
         milliseconds(r["seconds"]), f"{r['attempts']:.1f}")
        for r in table
    ]  # fmt: skip
    text += markdown_table(("solver", "right", "silently wrong", "median [ms]", "attempts"), cells)
    return "\n".join(text) + "\n"


def alone_and_in_the_loop(rows: Sequence[Row]) -> str:
    """Markdown: each solver by itself at the tightest accuracy, and inside our certified loop."""
    heads = ["solver", "problems", "alone: right", "silently wrong", "mean [ms]", "in our loop: right"]
    lines = []
    for name in sorted({r["solver"] for r in rows}):
        loop = "lmi-sdp" if name == "clarabel" else name + _LOOP
        alone = [r for r in rows if r["solver"] == name and r["settings"] != "default"]
        inside = [r for r in rows if r["solver"] == loop]
        if not alone or not inside:
            continue
        tightest = min(r["accuracy"] for r in alone)
        cells = [name if loop != "lmi-sdp" else "clarabel (lmi-sdp)", str(len(inside))]
        for runs in ([r for r in alone if r["accuracy"] == tightest], inside):
            wrong = sum(r["class"] == "silently_wrong" for r in runs)
            mean = milliseconds(float(np.mean([r["seconds"] for r in runs])))
            cells += [str(sum(reached(r, tightest) for r in runs)), str(wrong), mean]
        cells.append(f"{np.mean([r['attempts'] for r in inside]):.1f}")
        lines.append(cells)
    return "\n".join(markdown_table([*heads, "silently wrong", "mean [ms]", "attempts"], lines)) + "\n"


def class_page(group: str, rows: Sequence[Row]) -> str:
    """Markdown: every problem of a class, its proved interval and what each contestant made of it."""
    asked = accuracies(rows)
    text = [
        f"# Solver shootout: {group}",
        "",
        "Verdict and time [ms] at each accuracy asked for; a contestant that cannot be asked stands in "
        "all columns. error, violation, dual gap and attempts are of the tightest run. Made by "
        "`sdp-vs-penalty shootout`; how runs are judged is in summary.md.",
        "",
    ]
    mine = [r for r in rows if r["group"] == group]
    for problem in sorted({r["problem"] for r in mine}):
        runs = [r for r in mine if r["problem"] == problem]
        text += [f"## {problem}", "", _interval(runs), ""]
        heads = ["solver", *(f"{a:.0e}" for a in asked), "error", "violation", "dual gap", "attempts"]
        solvers = sorted({r["solver"] for r in runs})
        cells = [_solver_line([r for r in runs if r["solver"] == solver], asked) for solver in solvers]
        text += [*markdown_table(heads, cells), ""]
    return "\n".join(text)


def _interval(runs: Sequence[Row]) -> str:
    lower, upper = max(r["lower"] for r in runs), min(r["upper"] for r in runs)
    if not np.isfinite(upper):
        return f"No interval: infeasible, or not proved (instance {runs[0]['hash']})."
    low, high = cell(lower, "ROUND_FLOOR"), cell(upper, "ROUND_CEILING")
    return f"Optimum proved between {low} and {high} (instance {runs[0]['hash']})."


def _solver_line(runs: Sequence[Row], asked: Sequence[float]) -> list[str]:
    by_accuracy = {r["accuracy"]: r for r in runs}
    cells = [runs[0]["solver"]]
    for accuracy in asked:
        row = runs[0] if runs[0]["settings"] == "default" else by_accuracy.get(accuracy)
        said = "" if row is None else row["class"].replace("_", " ")
        said = "**silently wrong**" if said == "silently wrong" else said
        cells.append("" if row is None else f"{said} {milliseconds(row['seconds'])}")
    last = min(runs, key=lambda r: r["accuracy"])
    for name in ("objective_error", "violation", "own_gap"):
        cells.append(f"{last[name]:.0e}" if np.isfinite(last[name]) else "-")
    return [*cells, str(last["attempts"])]
