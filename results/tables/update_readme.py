"""Make results/README.md anew from results/, the figures that texts quote, and two pictures.

    python results/tables/update_readme.py [--no-pictures]

cited.txt beside this program says where each figure of a README or of a page of docs/ comes
from, page by page and in their order:

    # docs/security.md
    made 400 = FILE of results/ :: words of its row; more :: column

Words before the figure find the place where it alone may be another one; a fourth part says
which number of the cell it is, if it is not the first. tests/test_docs.py checks that all
are as results/ say. The pictures, results/figures/data.png and results/figures/joint_7.png,
need the extra [plot].
"""

from __future__ import annotations

import csv
import re
import statistics
import sys
from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path

from sdp_vs_penalty.colours import AFTER, BEFORE, PALETTE
from sdp_vs_penalty.formatting import words

ROOT = Path(__file__).parents[2]
TABLES = ROOT / "results" / "tables"
BEGIN = "<!-- results: begin -->\n"
END = "<!-- results: end -->\n"
#: The paper's largest weight of the penalty.
LARGEST_WEIGHT = 40.0

#: "SDP" in table_routes.csv and table_arms.csv has the penalty's demands; in
#: table_monte_carlo.csv it has no prior, and links as thin as any.
PLAIN, PLAINEST = "SDP, 20 mm, no prior", "SDP, no prior"

#: Columns of results/tables/table_routes.csv and their headings here.
ROUTE_COLUMNS = {
    "method": "method",
    "unseen_error_percent": "error on unseen motion [%]",
    "interval_percent": "95 % interval",
    "less_sdp_interval": "minus that of the SDP without prior, 95 % interval [points]",
    "excess_loss_percent": "loss above the best possible [%]",
    "links_violation": "violation of the links",
    "friction_violation": "of fitted friction",
    "positive_definite_percent": "M(q) > 0 [% of poses]",
    "seconds": "CPU time [s]",
}
#: What results/README.md shows of the Monte Carlo, and of other arms.
MONTE_CARLO_COLUMNS = {
    "method": "method",
    "draws": "draws",
    "error_percent": "error [%]",
    "less_default_interval": "minus the default's, 95 % interval [points]",
    "bias_percent": "bias [%]",
    "spread_percent": "spread [%]",
    "coverage_percent": "coverage [%]",
    "exist_percent": "links exist [% of draws]",
    "seconds": "CPU time [s]",
}
ARM_COLUMNS = {
    "arm": "arm",
    "method": "method",
    "unseen_error_percent": "error on unseen motion [%]",
    "interval_percent": "95 % interval",
    "less_sdp_interval": "minus that of the SDP without prior, 95 % interval [points]",
    "links_violation": "violation of the links",
    "seconds": "CPU time [s]",
}
#: Methods of the picture and of the second table, in the order of the legend.
SHOWN = (
    "ols, joint prior",
    "lmi-sdp-plain, joint prior",
    "penalty, joint prior",
    "lmi-sdp",
)


def rows_of(table: str, data: str = "measured") -> list[dict[str, str]]:
    """The rows of results/tables/table_<table>.csv that come from real or simulated data."""
    with (TABLES / f"table_{table}.csv").open(newline="") as file:
        return [row for row in csv.DictReader(file) if row["data"] == data]


def rounded(cell: str) -> str:
    """A figure to three digits, a word as it is."""
    try:
        return f"{float(cell):.3g}"
    except ValueError:
        return cell


def interval(cell: str) -> str:
    """The ends of an interval to two decimals, of a narrow one to two digits, of a wide one
    to three."""
    ends = [float(end) for end in cell.split(" to ")] if cell else []
    size = max(map(abs, ends), default=1.0)
    form = "+.2g" if size < 0.1 else "+.2f" if size < 100.0 else "+.3g"
    # An end that rounds to zero keeps a digit: on which side of zero it lies matters.
    return " to ".join(
        f"{end:{'+.1g' if form == '+.2f' and abs(end) < 5e-3 else form}}"
        for end in ends
    )


def shown_cell(column: str, cell: str) -> str:
    """A cell of a table here; "-" where there is none."""
    text = interval(cell) if column.startswith("less") else rounded(cell)
    return text or "-"


def shown(
    rows: list[dict[str, str]], columns: Mapping[str, str], plain: str = PLAIN
) -> str:
    """Rows of a table in results/ as Markdown, under other headings; the row "SDP" under
    the name ``plain``."""
    rows = [{**row, "method": plain_named(row["method"], plain)} for row in rows]
    cells = [[shown_cell(column, row[column]) for column in columns] for row in rows]
    return markdown(list(columns.values()), cells)


def plain_named(method: str, plain: str = PLAIN) -> str:
    """The name of a method; what the SDP demands is part of its name here."""
    return plain if method == "SDP" else method


def table(name: str) -> list[dict[str, str]]:
    """The rows of results/tables/table_<name>.csv; none where it is not there."""
    path = TABLES / f"table_{name}.csv"
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def unseen() -> list[dict[str, str]]:
    """The rows of results/tables/table_unseen.csv."""
    with (TABLES / "table_unseen.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def markdown(headings: list[str], rows: list[list[str]]) -> str:
    lines = [headings, [":---", *["---:"] * (len(headings) - 1)], *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def beside_least_squares() -> list[str]:
    """What folds say of least squares and of two steps beside the default SDP."""
    rows = [row for row in table("sensitivity") if not row["choice"]]
    rows += [row for row in table("sensitivity") if "guard" in row["choice"]]
    cells = [
        [
            ", ".join(filter(None, [row["folds"], row["choice"]])),
            points(row, "ols"),
            points(row, "two_step"),
        ]
        for row in rows
    ]
    return [
        (
            "What folds tell depends on how many there are, and on the guard between what is"
            " fitted and judged. Where an interval holds zero, they do not tell a method from"
            " the default SDP. Folds share most of their training data, so that intervals are"
            " somewhat too narrow."
        ),
        markdown(
            [
                "folds",
                "least squares less default [points]",
                "two steps less default [points]",
            ],
            cells,
        ),
        (
            f"With added effects two steps {two_steps_with_effects()}"
            f" ([all, with weights and bounds](tables/table_sensitivity.md))."
            f" {after_a_part_of_the_motion()}"
        ),
    ]


def after_a_part_of_the_motion() -> str:
    """How much two steps and the SDP of the same problem err where less than a period of
    the motion is trained on."""
    path = ROOT / "results" / "default_method" / "default_method.csv"
    with path.open(newline="") as file:
        error = {
            (row["arm"], row["method"]): float(row["error_percent"])
            for row in csv.DictReader(file)
            if row["arm"].startswith("Panda, ")
        }
    splits = list(dict.fromkeys(arm for arm, _ in error))
    pairs = [
        (error[x, "penalty-two-step"], error[x, "body, thickness 20 mm"])
        for x in splits
    ]
    worse = [two > sdp for two, sdp in pairs]
    far = max(range(len(pairs)), key=lambda k: pairs[k][0] - pairs[k][1])
    trained, judged = splits[far].removeprefix("Panda, ").split(" / ")
    return (
        f"Trained on less than a period, two steps err more on {sum(worse)} of {len(worse)}"
        f" splits, which overlap. The widest apart: from {trained} s, judged on {judged}, two steps"
        f" {pairs[far][0]:.2g} %, the SDP of the same problem {pairs[far][1]:.2g} %"
        " ([splits](default_method/default_method.md))."
    )


def two_steps_with_effects() -> str:
    """On how many folds two steps err more or less than the default, each with the same
    added effects."""
    of: dict[tuple[str, str], list[str]] = {}
    for row in table("sensitivity"):
        if row["choice"].startswith("+"):
            low, high = map(float, row["two_step_interval_points"].split(" to "))
            word = "more" if low > 0.0 else "less" if high < 0.0 else ""
            effects = row["choice"].removeprefix("+ ")
            of.setdefault((word, effects), []).append(row["folds"])
    told = [
        f"err {word} with {effects} on {words(folds)} folds"
        for (word, effects), folds in of.items()
        if word
    ]
    return f"{words(told) or 'are told apart on none'}"


def points(row: Mapping[str, str], method: str) -> str:
    """A difference of errors [percentage points] with its interval."""
    value = float(row[f"{method}_less_sdp_points"])
    return f"{value:+.2f} ({interval(row[f'{method}_interval_points'])})"


def retrieved() -> str:
    """How far the published links lie above the optimum of their own objective."""
    p_hat, optimum, *_ = table("p_hat")
    phi, best = float(p_hat["phi"]), float(optimum["phi"])
    return (
        "The published links are far from the optimum of their own objective. Theirs is"
        f" phi(p_hat) = {phi:.4g}, {float(p_hat['above_optimum_percent']):.0f} % above"
        f" {best:.4g}: the certified least value of links that meet every published demand"
        f" (gap {float(optimum['gap']):.0e}). In size it is little: a base parameter is"
        f" {float(p_hat['rms_coefficient']):.4f} off its target instead of"
        f" {float(optimum['rms_coefficient']):.4f} (RMS), the torque along their run"
        f" {float(p_hat['rms_torque']):.3f} instead of"
        f" {float(optimum['rms_torque']):.3f} N m. The optimum is nearer to the targets, which"
        " have errors of their own: it is no better robot for that. p_hat has c6z corrected by"
        " us"
    )


def strongest_penalty() -> str:
    """What the published two-step formulation reaches by each search, and by which best."""
    annealed, published, _, best = table("opponent")
    first = [row for row in annealing_runs() if row["xi"] == f"{LARGEST_WEIGHT:.1f}"]
    ends = [float(row["above_bound_percent"]) for row in first]
    spent = [int(row["evaluations"]) for row in first]
    n_weights = len(annealed["weights"].split())
    return (
        "The published two-step formulation reaches its optimum by the best of our four"
        f" searches, a local search with the weights {best['weights']} and a tight tolerance."
        f" That ends {float(best['above_percent_median']):.1g} % above the certified optimum"
        f" in the median ({best['runs_that_found_it']} of {best['runs']} starts find it, the"
        f" worst ends {float(best['above_percent_worst']):.0f} % above). The published"
        " weights, our looser tolerance and the same search end"
        f" {float(published['above_percent_median']):.0f} % above. Annealing before that"
        " search, as published, ends"
        f" {float(annealed['above_percent_median']):.0f} % above in the median, and"
        f" {float(annealed['above_percent_best']):.0f} % in the best of {annealed['runs']}"
        " runs. A run spends"
        f" {float(annealed['evaluations_median']) / n_weights:.0f} evaluations a weight,"
        " half of 3000 for each of 70 parameters; the authors kept the best of ten."
        " An earlier series, with"
        f" {statistics.median(spent):.0f} a weight (half of 3000 for each of 91), ends"
        f" {statistics.median(ends):.0f} % above in the median and {min(ends):.0f} % in the"
        f" best of {len(ends)} runs ([runs](global/annealing_runs.csv))"
    )


def annealing_runs() -> list[dict[str, str]]:
    """Where the two-step runs of annealing of results/global ended on the real run."""
    with (ROOT / "results" / "global" / "annealing_runs.csv").open(newline="") as file:
        return [
            row
            for row in csv.DictReader(file)
            if (row["data"], row["problem"], row["search"])
            == ("measured", "two-step", "annealing")
        ]


def without_triangle() -> str:
    """What the triangle inequalities buy."""
    _, weak = table("triangle")
    return (
        "The triangle inequalities matter: without them (Sousa and Cortesao's 6x6 matrix)"
        f" the certified loss is {-float(weak['above_percent']):.2f} % lower, and"
        f" {weak['links_violated']} of 7 links cannot exist"
    )


def weight_is_too_small() -> str:
    """What the largest published weight makes of the one-step loss, by what it sums."""
    ours, alike, samples = table("xi")
    return (
        "The published one-step penalty is too small on this run; that of two steps, by"
        f" which p_hat was made, is exact from {exact_two_step():.2g}. At"
        f" {LARGEST_WEIGHT:g}, one-step and inside the published box, the certified optimum lies"
        f" {-float(ours['boxed_excess_percent']):.2f} % below the best consistent loss, and"
        f" {ours['boxed_links_violated']} links cannot exist. Without the box it is"
        f" {-float(ours['free_excess_percent']):.2f} % and"
        f" {ours['free_links_violated']} links. That is of our {ours['rows']} decimated rows,"
        f" joints weighted by their residuals: there xi is exact from"
        f" {float(ours['exact_weight']):.0f}. With all joints alike it is exact from"
        f" {float(alike['exact_weight']):.0f}, and for all {samples['rows']} samples, as in"
        f" the authors' sum, from {float(samples['exact_weight']):.0f}"
        f" ([proof and figure](global/README.md))"
    )


def exact_two_step() -> float:
    """The weight from which the two-step penalty is exact on the measured run."""
    with (ROOT / "results" / "global" / "table_global.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            if (row["data"], row["problem"]) == ("measured", "two-step"):
                return float(row["exact_weight"])
    raise LookupError(
        "results/global/table_global.csv has no measured two-step problem"
    )


def by_monte_carlo() -> str:
    """Who errs least where the truth is known, and what the default costs or buys."""
    rows = table("monte_carlo")
    sentences = []
    for name in dict.fromkeys(row["setting"] for row in rows):
        mine = {row["method"]: row for row in rows if row["setting"] == name}
        squares = mine["weighted least squares"]
        sentences.append(
            f"{name.capitalize()}: default {rounded(mine[DEFAULT]['error_percent'])} %,"
            f" weighted least squares {rounded(squares['error_percent'])} %"
            f" ({interval(squares['less_default_interval'])} points)."
        )
    return " ".join(sentences)


def published_draws() -> str:
    """How often the published method is drawn in the Monte Carlo, if it is."""
    rows = [
        row
        for row in table("monte_carlo")
        if row["method"].startswith("penalty as pub")
    ]
    if not rows:
        return ""
    return (
        " The published method, one run in our code with half of its allowance for"
        " annealing, has"
        f" {rows[0]['draws']} draws a setting. It is compared with the default's same draws."
    )


#: The default's name in the table of the Monte Carlo.
DEFAULT = "SDP, entropic (default)"


def times() -> str:
    """How many times the SDP's time the penalty takes on the same problem."""
    by_method = {row["method"]: row for row in table("routes")}
    ratio = float(by_method["penalty, one-step"]["seconds"]) / float(
        by_method["SDP"]["seconds"]
    )
    return f"{ratio:.0f}"


def quick_times() -> str:
    """How long the published method takes with 1000 evaluations, and how far it gets."""
    by_method = {row["method"]: row for row in rows_of("methods")}
    names = {"one step": "penalty-paper", "two steps": "penalty-paper-two-step"}
    found = {name: by_method[method] for name, method in names.items()}
    return words(
        [
            f"{float(row['seconds']):.2g} s in {name} (loss"
            f" {float(row['excess_loss_percent']):+.3g} %)"
            for name, row in found.items()
        ]
    )


def all_routes() -> str:
    """All methods on one problem, other arms and the Monte Carlo, for results/README.md."""
    rows = table("routes")
    sdp, penalty = rows[:2]
    loss = float(sdp["excess_loss_percent"])
    apart = abs(float(penalty["excess_loss_percent"]) - loss)
    parts = [
        (
            "**Choose the SDP** (`lmi-sdp`, the default, whose prior is the nominal robot)."
            " On one problem (links at least 20 mm thick, no prior) both routes end at the"
            f" same loss, {loss:.3f} % above the best possible and {apart:.0e} points apart."
            " Their error on unseen motion is the same. The"
            f" penalty, ours as well, takes {times()} times as long and proves its optimum too."
            " Take it (`--method penalty`) only where a"
            " demand is not convex, such as a box on inertias about centres of mass."
        ),
        (
            "Measured on the authors' run of the Panda. The first two rows solve one"
            " problem. Errors are of all five stretches of motion together that were not"
            " trained on, intervals by the jackknife over these. Where one holds zero, the"
            " folds do not tell a method from that SDP. A loss below 0 belongs to links that"
            " cannot exist. As published: the authors' method in our code, with SciPy's"
            " annealer in place of simulannealbnd and SLSQP with analytic gradients in place of"
            " fmincon. It is one run,"
            " and they took the best of ten. Annealing spends half of the 3000 evaluations a"
            " parameter and weight that their program allows, and the local search stops long"
            f" before its half. With 1000 in all, one run each, it takes {quick_times()}"
            f" ([table](tables/table_methods.md)). The links p_hat have c6z corrected by us,"
            " delta is as printed. Neither was fitted to this run; friction beside them is our"
            " fit, and its violation ours. The motion repeats after 13.3 s, and no stretch"
            " that was left out repeats one that was fitted. Times are of the fit alone, for"
            " every method the median of three after a first one, beyond 10 s that of one"
            " run, on one thread."
        ),
        shown(rows, ROUTE_COLUMNS),
        *beside_least_squares(),
        f"{retrieved()} ([table](tables/table_p_hat.md)).",
        f"{strongest_penalty()} ([table](tables/table_opponent.md)).",
        f"{without_triangle()} ([table](tables/table_triangle.md)).",
        f"{weight_is_too_small()}.",
    ]
    if table("arms"):
        parts += [
            "Other arms, the same rules ([table](tables/table_arms.md)):",
            shown(table("arms"), ARM_COLUMNS),
        ]
    drawn = table("monte_carlo")
    if drawn:
        parts.append(
            "Where the truth is known ([Monte Carlo](tables/table_monte_carlo.md),"
            f" {drawn[0]['draws']} draws a setting), weighted least squares less the default"
            f" stands in brackets, with its interval. {by_monte_carlo()}{published_draws()}"
        )
        for name in dict.fromkeys(row["setting"] for row in drawn):
            mine = [row for row in drawn if row["setting"] == name]
            parts += [f"*{name}*", shown(mine, MONTE_CARLO_COLUMNS, PLAINEST)]
    parts.append(
        "All methods, what each figure means, and what effects add:"
        " [results](tables/README.md)."
    )
    return "\n\n".join(parts)


# --- figures that texts quote ------------------------------------------------------------

NUMBER = r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
CITED = TABLES / "cited.txt"


def citations() -> dict[Path, list[str]]:
    """The lines of cited.txt, by page."""
    _, *parts = re.split(r"^# (.+)\n", CITED.read_text(), flags=re.MULTILINE)
    pages = zip(parts[::2], parts[1::2], strict=True)
    return {ROOT / page: lines.split("\n") for page, lines in pages}


def cell(file: str, words: str, column: str) -> str:
    """The cell of the first row that holds all words (between semicolons), in any table
    of a file in results/."""
    path = ROOT / "results" / file
    wanted = [word.strip() for word in words.split(";")]
    if path.suffix == ".csv":
        rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
    else:
        lines = (line.strip() for line in path.read_text(encoding="utf-8").splitlines())
        rows = [
            [part.strip() for part in line.strip("|").split("|")]
            for line in lines
            if line.startswith("|")
        ]
    heads: list[str] = rows[0] if path.suffix == ".csv" else []
    for row, following in pairwise([*rows, []]):
        if following and all(re.fullmatch(":?-+:?", cell) for cell in following):
            heads = row  # a rule follows the headings
        elif column in heads and all(word in row for word in wanted):
            return row[heads.index(column)]
    raise AssertionError(f"{file}: no row with {wanted} under {column!r}")


def refreshed(text: str, lines: Iterable[str]) -> tuple[str, list[str]]:
    """A page and its lines of cited.txt with every figure as its cell has it, with as many
    digits as it had."""
    done, rest, anew = "", text, []
    for line in lines:
        if not line:
            anew.append(line)
            continue
        said, source = line.split(" = ", 1)
        file, words, column, *place = (part.strip() for part in source.split("::"))
        *before, figure = said.split()
        now = as_said(figure, cell(file, words, column), *map(int, place))
        shown_as = r"\s+".join(map(re.escape, said.split()))
        found_at = re.search(rf"(?<![\d.]){shown_as}(?!\.?\d)", rest)
        assert found_at, f"{line}: no {said} on the page, or not in this order"
        done += rest[: found_at.end() - len(figure)] + now
        rest = rest[found_at.end() :]
        anew.append(f"{' '.join([*before, now])} = {source}")
    return done + rest, anew


def as_said(said: str, cell: str, place: int = 1) -> str:
    """A number of a cell, by its place, with as many digits as it was said with."""
    numbers = re.findall(NUMBER, cell)
    assert len(numbers) >= place, f"{cell}: no number {place}"
    mantissa, _, power = said.partition("e")
    digits = len(mantissa.partition(".")[2])
    value = f"{float(numbers[place - 1]):.{digits}{'e' if power else 'f'}}"
    return re.sub(r"e([-+])0*", lambda sign: "e" + sign[1].strip("+"), value)


def with_results(readme: str, results: str) -> str:
    """The README's text with the block between the markers replaced."""
    before, _, rest = readme.partition(BEGIN)
    _, _, after = rest.partition(END)
    if not (rest and after):
        raise ValueError("README.md has lost its marker lines")
    return f"{before}{BEGIN}\n{results.strip()}\n\n{END}{after}"


def dated(readme: str) -> str:
    """The list of folders with the days and commits at which each was made, and the
    processor time that it took, by its machine.txt."""

    def row(found: re.Match[str]) -> str:
        note = (ROOT / "results" / found[2] / "machine.txt").read_text()
        days = sorted(re.findall(r"^(\d{4}-\d\d-\d\d)[ ,]", note, re.MULTILINE))
        noted = re.findall(r"(\bafter )?\bcommit ([0-9a-f]{7,9})( with changes)?", note)
        commits = dict.fromkeys(
            f"{clock}{name}{'+' * bool(more)}" for clock, name, more in noted
        )
        made = " to ".join(dict.fromkeys([days[0], days[-1]]))
        seconds = [float(s) for s in re.findall(r"(\d+) s of processor time", note)]
        known = [f"{sum(seconds) / 60.0:.2g}"] if seconds else []
        rest = ["not noted" if not known else "a part not noted"]
        minutes = "; ".join(known + rest * ("time was not noted" in note))
        cells = [found[1], made, ", ".join(commits) or "not noted", minutes]
        return " | ".join(cells) + " |"

    head = r"^(\| \[(\w+)\]\(\2/README\.md\) \| [^|\n]*?) \|[^\n]*$"
    return re.sub(head, row, readme, flags=re.MULTILINE)


#: What a method's error is cut off at [%]: after a second nothing is learnt of what
#: never moved.
_CEILING = 20.0


def draw_data(path: Path) -> None:
    """Error on unseen motion against seconds of training data: median, and range over
    the windows."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
    seconds = sorted({int(row["seconds"]) for row in rows_of("data")})
    for k, method in enumerate(SHOWN):
        rows = [row for row in rows_of("data") if row["method"] == method]
        x = [seconds.index(int(row["seconds"])) + 0.12 * (k - 1.5) for row in rows]
        middle = [float(row[f"error_percent_{'median'}"]) for row in rows]
        low = [float(row[f"error_percent_{'min'}"]) for row in rows]
        high = [float(row[f"error_percent_{'max'}"]) for row in rows]
        (line,) = axes.plot(
            x, middle, marker="o", ms=4, lw=1.4, color=PALETTE[k], label=method
        )
        axes.vlines(x, low, high, color=line.get_color(), lw=1.2)
        for place, value in zip(x, middle, strict=True):
            if value > _CEILING:
                text = f"{value:.0f} %"
                axes.annotate(
                    text,
                    (place, 0.94 * _CEILING),
                    rotation=90,
                    va="top",
                    ha="right",
                    fontsize=7,
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
    """RMSE of one joint on every fold of unseen motion, with the usual effects and with
    hysteresis."""
    import matplotlib.pyplot as plt

    looks = {
        "": (BEFORE, "usual effects"),
        "+ presliding_hysteresis": (AFTER, "with hysteresis"),
    }
    figure, axes = plt.subplots(figsize=(7.0, 3.0), layout="constrained")
    for k, (added, (color, label)) in enumerate(looks.items()):
        rows = [
            r for r in unseen() if r["method"] == method and r["added_effects"] == added
        ]
        rows = [r for r in rows if r["judged_on"] != "repeatability"]
        values = [float(row[f"rmse_joint_{joint}"]) for row in rows]
        bars = axes.bar(
            [x + 0.4 * (k - 0.5) for x in range(len(rows))], values, 0.38, color=color
        )
        axes.bar_label(bars, fmt="%.3f", fontsize=8)
        bars.set_label(label)
        axes.set_xticks(range(len(rows)), [row["judged_on"] for row in rows])
    axes.set_ylim(top=1.2 * axes.get_ylim()[1])
    axes.set(
        xlabel="unseen part of the motion",
        ylabel=f"RMSE of joint {joint} [N m]",
        title=(
            f"Panda, real run, {method}: joint {joint} on motion that was not"
            " trained on"
        ),
    )
    axes.legend(frameon=False, ncols=2, loc="upper center")
    figure.savefig(path, dpi=110, metadata={"Software": None})
    plt.close(figure)


if __name__ == "__main__":
    readme = ROOT / "results" / "README.md"
    readme.write_text(dated(with_results(readme.read_text(), all_routes())))
    cited = ""
    for page, lines in citations().items():
        text, anew = refreshed(page.read_text(), lines)
        page.write_text(text)
        cited += f"# {page.relative_to(ROOT).as_posix()}\n" + "\n".join(anew)
    CITED.write_text(cited)
    if "--no-pictures" not in sys.argv:
        import matplotlib

        matplotlib.use("Agg")
        draw_data(ROOT / "results" / "figures" / "data.png")
        draw_joint(ROOT / "results" / "figures" / "joint_7.png")
