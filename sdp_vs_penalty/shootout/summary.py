"""What the runs say: one table by solver, one by problem, which solver to use, and what each was told.

The shifted geometric mean is exp(mean log(t + s)) - s with s = 10 ms over all runs, those that were not
right at the time limit.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.formatting import markdown_table
from sdp_vs_penalty.problem.load import load_problem, problem_names
from sdp_vs_penalty.shootout.contestants import Contestant
from sdp_vs_penalty.shootout.judge import CLASSES
from sdp_vs_penalty.shootout.profile import accuracies, at_accuracy, plot_profile, reached
from sdp_vs_penalty.shootout.results import Row, table_text

_COLUMNS = (
    "solver", "settings", "runs", "success_percent", *CLASSES, "mean_seconds", "median_objective_error",
    "median_violation", "median_own_gap", "median_dimacs", "attempts", "version",
)  # fmt: skip
_HEADINGS = {
    "success_percent": "right %", "silently_wrong": "silently wrong", "mean_seconds": "time [ms]",
    "median_objective_error": "error", "median_violation": "violation", "median_own_gap": "dual gap",
    "median_dimacs": "DIMACS",
}  # fmt: skip
#: What is told of the answers called optimal: the median, each for itself.
_FIGURES = ("objective_error", "violation", "own_gap", "dimacs")


def summary_rows(rows: Sequence[Row], time_limit: float) -> list[Row]:
    """One row for each solver and settings: how often right, how often silently wrong, how fast."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for r in sorted(rows, key=lambda r: (r["solver"], r["settings"] != "default", -r["accuracy"])):
        groups.setdefault((r["solver"], r["settings"]), []).append(r)
    out = []
    for (solver, settings), mine in groups.items():
        counts = {kind: sum(r["class"] == kind for r in mine) for kind in CLASSES}
        times = [r["seconds"] if r["class"] == "right" else time_limit for r in mine]
        claims = [r for r in mine if r["claimed"] == "optimal"]
        out.append(
            {
                "solver": solver,
                "settings": settings,
                "runs": len(mine),
                "success_percent": 100.0 * counts["right"] / len(mine),
                **counts,
                "mean_seconds": shifted_geometric_mean(times),
                **{f"median_{k}": _median([r[k] for r in claims]) for k in _FIGURES},
                "attempts": f"{np.mean([r['attempts'] for r in mine]):.1f}",
                "version": mine[-1]["version"],
            }
        )
    return out


def _median(values: Sequence[float]) -> float:
    finite = [v for v in values if np.isfinite(v)]
    return float(np.median(finite)) if finite else float("nan")


def shifted_geometric_mean(seconds: Sequence[float], shift: float = 0.01) -> float:
    """exp(mean log(t + s)) - s [s], s the shift [s]."""
    return float(np.exp(np.mean(np.log(np.asarray(seconds) + shift))) - shift)


def milliseconds(seconds: float) -> str:
    """Three digits, all digits above a second; a dash for what is none."""
    if not np.isfinite(seconds):
        return "-"
    return f"{1e3 * seconds:.3g}" if seconds < 1.0 else f"{1e3 * seconds:.0f}"


def _short(name: str, value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    if name == "mean_seconds":
        return milliseconds(value)
    if name == "success_percent":
        return f"{value:.0f}"
    return "-" if np.isnan(value) else f"{value:.1e}"


def by_problem(rows: Sequence[Row]) -> str:
    """Markdown: problems down, solvers across, the class at the tightest accuracy asked for.

    Beside a wrong answer stands the larger of its error and its violation, both relative.
    """
    solvers = sorted({r["solver"] for r in rows})
    tightest = {(r["problem"], r["solver"]): r for r in sorted(rows, key=lambda r: -r["accuracy"])}

    def said(row: Row | None) -> str:
        if row is None or row["class"] != "silently_wrong":
            return "n/a" if row is None else str(row["class"])
        worst = max(row["objective_error"], row["violation"])
        return "**WRONG**" + (f" {worst:.0e}" if np.isfinite(worst) else "")

    problems = dict.fromkeys(r["problem"] for r in rows)
    lines = [[p, *(said(tightest.get((p, s))) for s in solvers)] for p in problems]
    return "\n".join(markdown_table(["problem", *solvers], lines)) + "\n"


def _links(row: Row, robots: Mapping[str, int]) -> int | None:
    """How many links a standard problem has, by its robot or name; None for an ill-conditioned one."""
    named = re.match(r"chain of (\d+)", row["problem"])
    return int(named.group(1)) if named else robots.get(row["group"])


def ranking(rows: Sequence[Row], size: int, accuracy: float) -> list[Row]:
    """The contestants on arms of ``size`` links, those that reach the accuracy most often first.

    run : on how many of the ``problems`` it ran: log det cannot be posed to all, time ran out for some.
    seconds : the median where it was right.
    """
    robots = {name: load_problem(name).robot.n for name in problem_names()}
    mine = at_accuracy([r for r in rows if _links(r, robots) == size], accuracy)
    out = []
    for solver in sorted({r["solver"] for r in mine}):
        runs = [r for r in mine if r["solver"] == solver]
        right = [r for r in runs if reached(r, accuracy)]
        out.append(
            {
                "solver": solver,
                "right": len(right),
                "run": len({r["problem"] for r in runs}),
                "problems": len({r["problem"] for r in mine}),
                "silently wrong": sum(r["class"] == "silently_wrong" for r in runs),
                "seconds": float(np.median([r["seconds"] for r in right])) if right else np.inf,
                "attempts": float(np.mean([r["attempts"] for r in runs])),
            }
        )
    return sorted(out, key=lambda r: (-r["right"], r["silently wrong"], r["seconds"]))


def answer(rows: Sequence[Row], size: int = 7, accuracy: float = 1e-6) -> str:
    """Markdown: which solver for seven links at 1e-6, and why; empty where nothing was run on them."""
    table = ranking(rows, size, accuracy)
    if not table:
        return ""
    best = table[0]
    enough = [r for r in table if r["right"] >= 0.9 * best["right"] and not r["silently wrong"]]
    quick = min(enough, key=lambda r: r["seconds"], default=best)
    cells = [
        (r["solver"], *(str(r[k]) for k in ("right", "run", "silently wrong")),
         milliseconds(r["seconds"]), f"{r['attempts']:.1f}")
        for r in table
    ]  # fmt: skip
    heads = ("solver", "right", "of problems run", "silently wrong", "median [ms]", "attempts")
    text = [
        f"Take **{best['solver']}**: right on {best['right']} of {best['problems']} problems of "
        f"{size} links at {accuracy:.0e}, {best['silently wrong']} times silently wrong, "
        f"{milliseconds(best['seconds'])} ms (median). The fastest of those never silently wrong and "
        f"right at least nine tenths as often is **{quick['solver']}**: {quick['right']} of "
        f"{quick['problems']}, {milliseconds(quick['seconds'])} ms.",
        "",
        *markdown_table(heads, cells),
    ]
    return "\n".join(text) + "\n"


def sentences(rows: Sequence[Row], time_limit: float) -> list[str]:
    """From the data alone: who is right most often, and who claims success wrongly."""
    table = summary_rows(rows, time_limit)
    if not table:
        return []
    best = max(table, key=lambda r: (r["success_percent"], -r["silently_wrong"], -r["mean_seconds"]))
    first = (
        f"Most often right is {_named(best)}: {best['right']} of {best['runs']} runs, "
        f"{best['silently_wrong']} silently wrong, {milliseconds(best['mean_seconds'])} ms on average."
    )
    worst = max(table, key=lambda r: (r["silently_wrong"] / r["runs"], r["runs"]))
    if not worst["silently_wrong"]:
        return [first, f"No solver claimed success wrongly in any of {len(rows)} runs."]
    return [
        first,
        f"Check every answer of {_named(worst)}: it claimed success wrongly in "
        f"{worst['silently_wrong']} of {worst['runs']} runs, and all solvers together in "
        f"{sum(r['silently_wrong'] for r in table)} of {len(rows)}.",
    ]


def _named(row: Row) -> str:
    return row["solver"] if row["settings"] == "default" else f"{row['solver']} at {row['settings']}"


def write_summary(
    folder: Path,
    rows: Sequence[Row],
    time_limit: float,
    absent: dict[str, str],
    not_applicable: Sequence[tuple[str, str, str]],
    people: dict[str, Contestant],
) -> list[Path]:
    """summary.md, summary.csv and profile.svg beside runs.csv; the paths written.

    people : the contestants by name, whose settings are told.
    """
    table = summary_rows(rows, time_limit)
    missing = [f"{name}: {reason}" for name, reason in sorted(absent.items())]
    for (solver, reason), count in sorted(Counter(x[1:] for x in not_applicable).items()):
        missing.append(f"{solver}: not applicable to {count} problem(s): {reason}")
    asked = accuracies(rows)
    ran = [people[name] for name in sorted({r["solver"] for r in rows}) if name in people]
    told = [[c.name, c.told(a)] for c in ran if c.tunable for a in (*asked[:1], *asked[-1:])]
    cells = [[_short(h, row[h]) for h in _COLUMNS] for row in table]
    text = Path(__file__).with_suffix(".md").read_text()  # a file beside this one
    said = text.format(
        sentences="".join(f"- {sentence}\n" for sentence in sentences(rows, time_limit)),
        minutes=sum(r["seconds"] for r in rows) / 60.0,
        limit=time_limit,
        answer=answer(rows),
        told="\n".join(markdown_table(["solver", "told"], told)),
        table="\n".join(markdown_table([_HEADINGS.get(h, h) for h in _COLUMNS], cells)),
        problems=by_problem(rows),
        left_out="".join(f"- {line}.\n" for line in missing),
        machines=", ".join(sorted({r["machine"] for r in rows})),
    )
    paths = [folder / name for name in ("summary.md", "summary.csv")]
    write_text(paths[0], said)
    write_text(paths[1], table_text(_COLUMNS, table))
    picture = folder / "profile.svg"
    return [*paths, picture] if plot_profile(rows, picture) else paths
