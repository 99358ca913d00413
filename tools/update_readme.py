"""Make README.md's results anew from results/: small tables between marker lines, two pictures.

    python tools/update_readme.py

tests/test_readme.py checks that the block holds what results/ say. The pictures, results/data.png and
results/joint_7.png, need the extra [plot].
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
    "unseen_error_percent": "error on unseen motion [%]",
    "worst_fold_error_percent": "worst fold [%]",
    "repeatability_error_percent": "repeatability [%]",
    "positive_definite_percent": "M(q) > 0 [% of poses]",
}
#: Of the table of errors on unseen motion.
UNSEEN_HEADINGS = (
    *("method", "effects", "unseen motion [%]", "worst fold [%]", "repeatability [%]"),
    "joint 7, unseen [N m]",
)
#: Methods of the picture and of the second table, in the order of the legend.
SHOWN = ("ols", "lmi-sdp", "lmi-sdp-entropic", "penalty")


def rows_of(table: str, data: str = "measured") -> list[dict[str, str]]:
    """The rows of results/table_<table>.csv that come from real or simulated data."""
    with (ROOT / "results" / f"table_{table}.csv").open(newline="") as file:
        return [row for row in csv.DictReader(file) if row["data"] == data]


def rounded(cell: str) -> str:
    """A figure to three digits, a word as it is."""
    try:
        return f"{float(cell):.3g}"
    except ValueError:
        return cell


def unseen() -> list[dict[str, str]]:
    """The rows of results/table_unseen.csv."""
    with (ROOT / "results" / "table_unseen.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def generalisation() -> list[list[str]]:
    """A row a method and set of effects: unseen motion, its worst fold, repeatability, joint 7."""
    rows: dict[tuple[str, str], dict[str, dict[str, str]]] = {}
    for row in unseen():
        rows.setdefault((row["method"], row["added_effects"]), {})[row["judged_on"]] = row
    out = []
    for (method, added), by_fold in rows.items():
        every, again = by_fold["all"], by_fold["repeatability"]
        folds = [float(row["relative_error_percent"]) for row in by_fold.values()][:-2]
        out.append(
            [
                method,
                added or "the usual effects",
                rounded(every["relative_error_percent"]),
                rounded(str(max(folds))),
                rounded(again["relative_error_percent"]),
                rounded(every["rmse_joint_7"]),
            ]
        )
    return out


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
        [rounded(row[column]) for column in METHOD_COLUMNS]
        for row in rows_of("methods")
        if row["method"] != "reverse-engineering"
    ]
    seconds = sorted({int(row["seconds"]) for row in rows_of("data")})
    error = {
        (row["method"], int(row["seconds"])): row["error_percent_median"] for row in rows_of("data")
    }
    data = [[method, *(rounded(error[method, s]) for s in seconds)] for method in SHOWN]
    return "\n\n".join(
        [
            "The authors' real run of the Panda repeats its motion after 13.3 s: fitted to its first "
            "14 s and judged on the rest, a model shows its repeatability. On motion that it has not "
            "been trained on, in five folds by phase, the methods are close to each other, and what the "
            "model lacks weighs more than the method (from [table_unseen](results/table_unseen.md), "
            "which has every fold):",
            markdown(list(UNSEEN_HEADINGS), generalisation()),
            "![Joint 7 on unseen motion, with and without pre-sliding hysteresis](results/joint_7.png)",
            "Every method on the same run. Loss, violations and thickness are of the fit to its first "
            "14 s; `penalty-paper` has a budget of 3000 loss evaluations a run (its authors' program "
            "allows 1 365 000: `--budget paper`) and the authors' weight, 40 (from "
            "[table_methods](results/table_methods.md), which says what each figure is; "
            "`tables weight` tries other weights):",
            markdown(list(METHOD_COLUMNS.values()), methods),
            "Error [%] on the rest of the motion after training on so many seconds of it, median over "
            "several windows (from [table_data](results/table_data.md)). `lmi-sdp` and "
            "`lmi-sdp-entropic` pull friction that the data leave open to zero, `penalty` has no such "
            "prior: at 1 s most of the difference between them is that.",
            markdown(["method", *(f"{s} s" for s in seconds)], data),
            "Speed and memory on one thread, each pair measured in one run (from "
            "[benchmarks](results/benchmarks.md), made by `benchmarks/run.py`):",
            markdown(["what", "this program", "the other way", "ratio"], speed()),
            "How often `diagnose` is right in simulated worlds that share no code with the library, "
            "under twenty nuisances: three clean cases of each and three of every other class, far too "
            "few for a rate, with Wilson's 95 % intervals (from "
            "[challenge](results/challenge.md)):",
            markdown(["class", "counted", "cases", "share", "interval", "to reach"], challenge()),
            "![Error on unseen motion against seconds of training data](results/data.png)",
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


#: What a method's error is cut off at [%]: after a second nothing is learnt of what never moved.
_CEILING = 20.0


def draw_data(path: Path) -> None:
    """Error on unseen motion against seconds of training data: median, and range over the windows."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
    seconds = sorted({int(row["seconds"]) for row in rows_of("data")})
    for k, method in enumerate(SHOWN):
        rows = [row for row in rows_of("data") if row["method"] == method]
        x = [seconds.index(int(row["seconds"])) + 0.12 * (k - 1.5) for row in rows]
        middle, low, high = (
            [float(row[f"error_percent_{name}"]) for row in rows] for name in ("median", "min", "max")
        )
        (line,) = axes.plot(x, middle, marker="o", ms=4, lw=1.4, label=method)
        axes.vlines(x, low, high, color=line.get_color(), lw=1.2)
        for place, value in zip(x, middle, strict=True):
            if value > _CEILING:
                text = f"{value:.0f} %"
                axes.annotate(
                    text, (place, 0.94 * _CEILING), rotation=90, va="top", ha="right", fontsize=7
                )
    axes.set(
        ylim=(1.0, _CEILING),
        yscale="log",
        xlabel="seconds of training data",
        ylabel="error on unseen motion [%]",
        title="Franka Emika Panda, real run: median and range over windows",
    )
    axes.set_yticks([1, 1.5, 2, 3, 5, 10, 20], ["1", "1.5", "2", "3", "5", "10", "20"])
    axes.set_xticks(range(len(seconds)), [str(s) for s in seconds])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)


def draw_joint(path: Path, joint: int = 7, method: str = "lmi-sdp") -> None:
    """RMSE of one joint on every fold of unseen motion, with the usual effects and with hysteresis."""
    import matplotlib.pyplot as plt

    looks = {"": ("#999999", "usual effects"), "+ presliding_hysteresis": ("#0072b2", "with hysteresis")}
    figure, axes = plt.subplots(figsize=(7.0, 3.0), layout="constrained")
    for k, (added, (color, label)) in enumerate(looks.items()):
        rows = [r for r in unseen() if r["method"] == method and r["added_effects"] == added]
        rows = [r for r in rows if r["judged_on"] != "repeatability"]
        values = [float(row[f"rmse_joint_{joint}"]) for row in rows]
        bars = axes.bar([x + 0.4 * (k - 0.5) for x in range(len(rows))], values, 0.38, color=color)
        axes.bar_label(bars, fmt="%.3f", fontsize=8)
        bars.set_label(label)
        axes.set_xticks(range(len(rows)), [row["judged_on"] for row in rows])
    axes.set_ylim(top=1.2 * axes.get_ylim()[1])
    axes.set(
        xlabel="unseen part of the motion",
        ylabel=f"RMSE of joint {joint} [N m]",
        title=f"Panda, real run, {method}: joint {joint} on motion that was not trained on",
    )
    axes.legend(frameon=False, ncols=2, loc="upper center")
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)


if __name__ == "__main__":
    import matplotlib

    matplotlib.use("Agg")
    readme = ROOT / "README.md"
    readme.write_text(with_results(readme.read_text(), headline()))
    draw_data(ROOT / "results" / "data.png")
    draw_joint(ROOT / "results" / "joint_7.png")
