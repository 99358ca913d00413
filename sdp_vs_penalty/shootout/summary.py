"""What the runs say: tables in Markdown, LaTeX and CSV, three sentences, the answer to a question.

The shifted geometric mean is exp(mean log(t + s)) - s with s = 10 ms, over the runs that a solver got
right, unsolved ones at the time limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.shootout import pages
from sdp_vs_penalty.shootout.judge import CLASSES
from sdp_vs_penalty.shootout.profile import COLUMNS as PROFILE_COLUMNS
from sdp_vs_penalty.shootout.profile import plot_profile, profile_rows
from sdp_vs_penalty.shootout.results import Row, table_text
from sdp_vs_penalty.show import markdown_table

_SHIFT = 0.01  # s
_COLUMNS = (
    "solver", "settings", "runs", "success_percent", *CLASSES, "mean_seconds", "median_objective_error",
    "median_violation", "median_own_gap", "median_dimacs", "attempts", "version",
)  # fmt: skip
_HEADINGS = {
    "success_percent": "right %",
    "silently_wrong": "silently wrong",
    "mean_seconds": "time [ms]",
    "median_objective_error": "error",
    "median_violation": "violation",
    "median_own_gap": "dual gap",
    "median_dimacs": "DIMACS",
}
#: What is told of the answers called optimal: the median, each for itself.
_FIGURES = ("objective_error", "violation", "own_gap", "dimacs")


def summary_rows(rows: Sequence[Row], time_limit: float) -> list[Row]:
    """One row for each solver and settings: how often right, how often silently wrong, how fast."""
    out = []
    for solver, settings in sorted({(r["solver"], r["settings"]) for r in rows}, key=_order):
        mine = [r for r in rows if (r["solver"], r["settings"]) == (solver, settings)]
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


def _order(pair: tuple[str, str]) -> tuple[str, float]:
    solver, settings = pair
    return solver, 0.0 if settings == "default" else -float(settings)


def shifted_geometric_mean(seconds: Sequence[float]) -> float:
    """exp(mean log(t + s)) - s."""
    return float(np.exp(np.mean(np.log(np.asarray(seconds) + _SHIFT))) - _SHIFT)


def markdown(rows: Sequence[Row], headings: Sequence[str]) -> str:
    """A table whose numbers are short enough to read."""
    names = [_HEADINGS.get(h, h) for h in headings]
    cells = [[_short(h, row[h]) for h in headings] for row in rows]
    return "\n".join(markdown_table(names, cells)) + "\n"


def latex(rows: Sequence[Row], headings: Sequence[str]) -> str:
    """The same table as a tabular of booktabs."""
    names = [_HEADINGS.get(h, h).replace("_", r"\_").replace("%", r"\%") for h in headings]
    body = [
        " & ".join(_short(h, row[h]).replace("_", r"\_").replace("%", r"\%") for h in headings) + r" \\"
        for row in rows
    ]
    columns = "ll" + "r" * (len(headings) - 2)
    top = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", " & ".join(names) + r" \\", r"\midrule"]
    return "\n".join([*top, *body, r"\bottomrule", r"\end{tabular}"]) + "\n"


def _short(name: str, value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    if name == "mean_seconds":
        return pages.milliseconds(value)
    if name == "success_percent":
        return f"{value:.0f}"
    return "-" if np.isnan(value) else f"{value:.1e}"


def by_problem(rows: Sequence[Row]) -> str:
    """Markdown: problems down, solvers across, the class at the tightest accuracy asked for.

    Beside a wrong answer stands the larger of its error and its violation, both relative.
    """
    solvers = sorted({r["solver"] for r in rows})
    lines = []
    for problem in dict.fromkeys(r["problem"] for r in rows):
        cells = [problem]
        for solver in solvers:
            mine = [r for r in rows if r["problem"] == problem and r["solver"] == solver]
            tightest = min(mine, key=lambda r: r["accuracy"], default=None)
            if tightest is None:
                cells.append("n/a")
            elif tightest["class"] == "silently_wrong":
                worst = max(tightest["objective_error"], tightest["violation"])
                cells.append(f"**WRONG** {worst:.0e}" if np.isfinite(worst) else "**WRONG**")
            else:
                cells.append(tightest["class"])
        lines.append(cells)
    return "\n".join(markdown_table(["problem", *solvers], lines)) + "\n"


def sentences(rows: Sequence[Row], time_limit: float) -> list[str]:
    """Which solver to use, from the data alone: the most often right, the fastest, whom to doubt."""
    table = summary_rows(rows, time_limit)
    if not table:
        return []
    best = max(table, key=lambda r: (r["success_percent"], -r["silently_wrong"], -r["mean_seconds"]))
    first = (
        f"Most often right is {_named(best)}: {best['right']} of {best['runs']} runs, "
        f"{best['silently_wrong']} silently wrong, {pages.milliseconds(best['mean_seconds'])} ms on "
        "average."
    )
    safe = [r for r in table if r["silently_wrong"] == 0 and r["right"] > 0]
    reliable = [r for r in safe if r["success_percent"] >= 0.8 * best["success_percent"]]
    if reliable:
        quick = min(reliable, key=lambda r: r["mean_seconds"])
        second = (
            f"Of those never silently wrong and nearly as often right the fastest is "
            f"{_named(quick)} with {pages.milliseconds(quick['mean_seconds'])} ms."
        )
    else:
        second = "No solver was both often right and never silently wrong."
    worst = max(table, key=lambda r: (r["silently_wrong"] / r["runs"], r["runs"]))
    if worst["silently_wrong"]:
        third = (
            f"Check every answer of {_named(worst)}: it claimed success wrongly in "
            f"{worst['silently_wrong']} of {worst['runs']} runs, and all solvers together in "
            f"{sum(r['silently_wrong'] for r in table)} of {sum(r['runs'] for r in table)}."
        )
    else:
        third = f"No solver claimed success wrongly in any of {sum(r['runs'] for r in table)} runs."
    return [first, second, third]


def _named(row: Row) -> str:
    return row["solver"] if row["settings"] == "default" else f"{row['solver']} at {row['settings']}"


def write_summary(
    folder: Path,
    rows: Sequence[Row],
    time_limit: float,
    absent: dict[str, str],
    not_applicable: Sequence[tuple[str, str, str]],
) -> list[Path]:
    """summary.*, a page a class and profile.csv, .svg beside runs.csv; the paths written."""
    table = summary_rows(rows, time_limit)
    left_out: dict[tuple[str, str], int] = {}
    for _, solver, reason in not_applicable:
        left_out[solver, reason] = left_out.get((solver, reason), 0) + 1
    missing = [f"{name}: {reason}" for name, reason in sorted(absent.items())]
    for (solver, reason), count in sorted(left_out.items()):
        missing.append(f"{solver}: not applicable to {count} problem(s): {reason}")
    # The text is a file beside this one.
    text = Path(__file__).with_suffix(".md").read_text()
    said = text.format(
        sentences="".join(f"- {sentence}\n" for sentence in sentences(rows, time_limit)),
        minutes=sum(r["seconds"] for r in rows) / 60.0,
        limit=time_limit,
        answer=pages.answer(rows),
        loop=pages.alone_and_in_the_loop(rows),
        table=markdown(table, _COLUMNS),
        problems=by_problem(rows),
        left_out="".join(f"- {line}.\n" for line in missing),
        machines=", ".join(sorted({r["machine"] for r in rows})),
    )
    paths = [folder / name for name in ("summary.md", "summary.tex", "summary.csv")]
    write_text(paths[0], said)
    write_text(paths[1], latex(table, _COLUMNS))
    write_text(paths[2], table_text(_COLUMNS, table))
    for group in sorted({r["group"] for r in rows}):
        paths.append(folder / f"{group}.md")
        write_text(paths[-1], pages.class_page(group, rows))
    paths.append(folder / "profile.csv")
    write_text(paths[-1], table_text(PROFILE_COLUMNS, profile_rows(rows)))
    picture = folder / "profile.svg"
    if plot_profile(rows, picture):
        paths.append(picture)
    return paths
