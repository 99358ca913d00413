"""Every figure of speed and memory, by one command.

    python results/benchmarks/run.py --data DATA [--only PART ...] [--busy N] [--rows N ...]
        [--rivals PYTHON] [--repeats N] [--out FOLDER]

DATA holds panda and ur10e as `sdp-vs-penalty fetch` leaves them (default:
SDP_VS_PENALTY_DATA). Each part runs in a process of its own on one thread; what is
compared is measured in turn, the ratio is that of the medians, its spread the smallest and
the largest of the single pairs. --busy N keeps N processes busy meanwhile: figures of a
loaded machine, which stand beside the quiet ones. Where others keep it busy, the column
machine says loaded. --rivals: Python of an environment with
figaroh, mujoco[sysid] and scikit-learn. Writes benchmarks.csv and benchmarks.md; parts that
are not measured this time stay as they are, with their date.
"""

import argparse
import os
import platform
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path

os.environ |= dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
if __name__ == "__main__":  # for this process and its workers
    sys.path[0] = str(Path(__file__).parents[1])

import pandas

from benchmarks import other_tools, parts
from benchmarks.timing import Figure, busy_machine
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.results.table import markdown_lines

PARTS: dict[str, Callable[[parts.Inputs], list[Figure]]] = (
    other_tools.PARTS | parts.PARTS
)
COLUMNS = [
    "part",
    "machine",
    "what",
    "ours",
    "other",
    "unit",
    "ratio",
    "spread",
    "note",
    "when",
]
#: Processes that wait or run, beyond which a machine counts as loaded.
_LOAD = 2.5
LIBRARIES = ("numpy", "scipy", "pin", "clarabel", "cvxpy")


def measure(part: str, inputs: parts.Inputs, busy: int) -> pandas.DataFrame:
    """Measure one part; return its rows of the table."""
    # Parts before have used two processes at most.
    others = "loaded" if os.getloadavg()[0] > _LOAD else "quiet"
    with busy_machine(busy):
        figures = PARTS[part](inputs)
    versions = " ".join(f"{name} {version(name)}" for name in LIBRARIES)
    python = platform.python_version()
    when = f"{datetime.now(UTC):%Y-%m-%d %H:%M}, python {python} {versions}"
    machine = f"{busy} busy" if busy else others
    rows = [(part, machine, *cells(figure), when) for figure in figures]
    return pandas.DataFrame(rows, columns=COLUMNS)


def cells(figure: Figure) -> tuple[str, ...]:
    """Return a figure's cells: what, ours, other, unit, ratio, spread, note."""
    other = ratio = spread = ""
    if figure.other is not None:
        other = f"{figure.other:.3g}"
    if figure.other is not None and figure.low is not None:  # of pairs
        ratio = f"{figure.other / figure.ours:.3g}"
        spread = f"{figure.low:.3g} to {figure.high:.3g}"
    return (
        figure.what,
        f"{figure.ours:.3g}",
        other,
        figure.unit,
        ratio,
        spread,
        figure.note,
    )


def write(out: Path, tables: list[pandas.DataFrame]) -> None:
    """Write both files, of what was measured now and of what they hold of other parts."""
    new = pandas.concat(tables)
    file = out / "benchmarks.csv"
    if file.exists():
        old = pandas.read_csv(file, dtype=str, keep_default_na=False)
        measured = set(zip(new["part"], new["machine"], strict=True))
        stays = [
            pair not in measured
            for pair in zip(old["part"], old["machine"], strict=True)
        ]
        new = pandas.concat([new, old[stays]])
    order = [*PARTS]
    new = new.sort_values(
        ["part", "machine"],
        key=lambda column: (
            column.map(order.index) if column.name == "part" else column != "quiet"
        ),
        kind="stable",
    )
    write_text(file, new.to_csv(index=False, lineterminator="\n"))
    about = (
        "Panda, the authors' run of 20 544 samples, unless said. ratio: other / ours, of"
        " medians; spread: of the single pairs. By `python results/benchmarks/run.py`"
        f" ({platform.machine()}, one thread)."
    )
    table = markdown_lines(COLUMNS, new.to_numpy().tolist())
    text = "\n".join(["# Speed and memory", "", about, "", *table, ""])
    write_text(out / "benchmarks.md", text)
    print(text)


def main() -> None:
    """Measure the chosen parts, and write the table after each."""
    parser = argparse.ArgumentParser(usage=__doc__)
    data = os.environ.get("SDP_VS_PENALTY_DATA")
    parser.add_argument("--data", type=Path, default=data, required=data is None)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS))
    lengths = [100_000, 1_000_000, 10_000_000]
    parser.add_argument("--rows", type=int, nargs="+", default=lengths)
    parser.add_argument("--busy", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--rivals")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    options = parser.parse_args()
    inputs = parts.Inputs(
        Path(options.data).resolve(), options.rows, options.repeats, options.rivals
    )
    work = partial(measure, inputs=inputs, busy=options.busy)
    context = get_context("spawn")
    with ProcessPoolExecutor(1, context, max_tasks_per_child=1) as pool:
        for table in pool.map(work, options.only):
            write(options.out, [table])


if __name__ == "__main__":
    main()
