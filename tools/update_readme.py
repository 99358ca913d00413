"""Make README.md's results anew from results/: small tables between marker lines, one picture.

    python tools/update_readme.py

tests/test_readme.py checks that the block holds what results/ say. The picture, results/data.png, needs
the extra [plot].
"""

from __future__ import annotations

import csv
from itertools import dropwhile, takewhile
from pathlib import Path

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- results: begin -->\n", "<!-- results: end -->\n"

#: Columns of results/table_methods.csv and their headings here.
METHOD_COLUMNS = {
    "method": "method",
    "excess_loss_percent": "loss over certified optimum [%]",
    "worst_violation": "worst violation",
    "smallest_thickness_mm": "thinnest link [mm]",
    "held_out_error_percent": "held-out error [%]",
    "positive_definite_percent": "M(q) > 0 [% of poses]",
}
#: Methods of the picture and of the second table, in the order of the legend.
SHOWN = ("ols", "lmi-sdp", "lmi-sdp-entropic", "penalty")


def rows_of(table: str, data: str = "measured") -> list[dict[str, str]]:
    """The rows of results/table_<table>.csv that come from real or simulated data."""
    with (ROOT / "results" / f"table_{table}.csv").open(newline="") as file:
        return [row for row in csv.DictReader(file) if row["data"] == data]


def speed() -> list[list[str]]:
    """What was compared, both figures with their unit, and their ratio, from results/benchmarks.csv."""
    with (ROOT / "results" / "benchmarks.csv").open(newline="") as file:
        return [
            [row["what"], f"{row['ours']} {row['unit']}", f"{row['other']} {row['unit']}", row["ratio"]]
            for row in csv.DictReader(file)
        ]


def challenge() -> list[list[str]]:
    """How often the diagnosis is right: the rows of the first table of results/challenge.md."""
    lines = iter((ROOT / "results" / "challenge.md").read_text().splitlines())
    table = takewhile(lambda x: x.startswith("|"), dropwhile(lambda x: not x.startswith("|"), lines))
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table][2:]


def markdown(headings: list[str], rows: list[list[str]]) -> str:
    lines = [headings, [":---", *["---:"] * (len(headings) - 1)], *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def headline() -> str:
    """The README's results: text and tables, every figure as results/ have it."""
    methods = [
        [row[column] for column in METHOD_COLUMNS]
        for row in rows_of("methods")
        if row["method"] != "reverse-engineering"
    ]
    seconds = sorted({int(row["seconds"]) for row in rows_of("data")})
    error = {
        (row["method"], int(row["seconds"])): row["error_percent_median"] for row in rows_of("data")
    }
    data = [[method, *(error[method, s] for s in seconds)] for method in SHOWN]
    return "\n\n".join(
        [
            "Every method on the authors' real run of the Panda, trained on its first 14 s, judged on "
            "the rest (from [table_methods](results/table_methods.md), which says what each figure is):",
            markdown(list(METHOD_COLUMNS.values()), methods),
            "Held-out error [%] after training on so many seconds of the same run, median over several "
            "windows (from [table_data](results/table_data.md)). `lmi-sdp` and `lmi-sdp-entropic` pull "
            "friction that the data leave open to zero, `penalty` has no such prior: at 1 s most of the "
            "difference between them is that.",
            markdown(["method", *(f"{s} s" for s in seconds)], data),
            "Speed and memory on one thread, each pair measured in one run (from "
            "[benchmarks](results/benchmarks.md), made by `benchmarks/run.py`):",
            markdown(["what", "this program", "the other way", "ratio"], speed()),
            "How often `diagnose` is right on simulated runs in which an effect is hidden, with "
            "Wilson's 95 % intervals (from [challenge](results/challenge.md)):",
            markdown(["class", "counted", "cases", "share", "interval", "to reach"], challenge()),
            "![Held-out error against seconds of training data](results/data.png)",
            "[results/](results/README.md): regenerated paper tables and figures, with provenance.",
        ]
    )


def with_results(readme: str, results: str) -> str:
    """The README's text with the block between the markers replaced."""
    before, _, rest = readme.partition(BEGIN)
    _, _, after = rest.partition(END)
    if not (rest and after):
        raise ValueError("README.md has lost its marker lines")
    return f"{before}{BEGIN}\n{results.strip()}\n\n{END}{after}"


def draw(path: Path) -> None:
    """Held-out error against seconds of training data, with the range over the windows."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
    for k, method in enumerate(SHOWN):
        rows = [row for row in rows_of("data") if row["method"] == method]
        x = [float(row["seconds"]) * 1.03 ** (k - 1.5) for row in rows]
        middle, low, high = (
            [float(row[f"error_percent_{name}"]) for row in rows] for name in ("median", "min", "max")
        )
        spread = [[m - a for m, a in zip(middle, low, strict=True)]]
        spread.append([b - m for m, b in zip(middle, high, strict=True)])
        axes.errorbar(x, middle, yerr=spread, marker="o", ms=4, capsize=2, lw=1.4, label=method)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="seconds of training data",
        ylabel="held-out torque error [%]",
        title="Franka Emika Panda, real run: median and range over windows",
    )
    ticks = sorted({int(row["seconds"]) for row in rows_of("data")})
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)


if __name__ == "__main__":
    readme = ROOT / "README.md"
    readme.write_text(with_results(readme.read_text(), headline()))
    draw(ROOT / "results" / "data.png")
