"""Every figure of speed and memory, by one command.

    python benchmarks/run.py [--data DATA] [--only PART ...] [--rows N ...] [--out results]

DATA holds the measurements as `sdp-vs-penalty fetch` leaves them (its subfolder panda; default:
SDP_VS_PENALTY_DATA). Each part runs in a process of its own on one thread; figures are ratios within one
part. Writes benchmarks.csv, benchmarks.md and benchmarks.png; parts that are not measured this time keep
what the files there hold of them, with its date.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import os
import platform
import subprocess
import sys
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PARTS = {
    "text": "from text to an estimate, beside a decimating script",
    "fits": "compressed data to a certified fit, beside Clarabel",
    "renewed": "a renewed fit",
    "solvers": "every installed solver on one problem",
    "processes": "commands as processes, beside bare imports",
    "samples": "exponent in samples",
    "runs": "exponent in runs",
    "joints": "exponent in joints",
    "memory": "processor time and peak memory of whole commands on long recordings",
}
#: Measured once, by scripts that left: they stay in the table.
LEFT = {"rivals": "ffa8cd7"}
NAMES = ["part", "what", "ours", "other", "unit", "ratio", "note", "when"]


def measure(part: str, given: argparse.Namespace) -> dict[str, Any]:
    """Rows of pairs, series of growth, or lines of the memory table."""
    import growth
    import speed

    from sdp_vs_penalty import load_measurements, load_problem
    from sdp_vs_penalty.estimation.certify import versions

    problem, folder = load_problem("panda"), given.data / "panda"
    run = load_measurements(folder, joints=7)
    rows: list[speed.Row] = []
    series, lines = [], []
    if part == "text":
        rows = speed.text(problem, folder)
    elif part == "memory":
        lines = growth.memory(run, problem, given.rows)
    elif part in ("fits", "renewed", "solvers", "processes"):
        rows = getattr(speed, part)(problem, run)
    else:
        one = growth.growing(problem, run)[part]()
        series = [asdict(one) | {"exponent": one.exponent}]
    when = f"{datetime.now(UTC):%Y-%m-%d %H:%M}, load {os.getloadavg()[0]:.0f}"
    return {
        "rows": [asdict(r) | {"part": part, "ratio": r.other / r.ours, "when": when} for r in rows],
        "series": series,
        "lines": lines,
        "versions": versions(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=os.environ.get("SDP_VS_PENALTY_DATA"))
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART",
                        help=", ".join(PARTS))  # fmt: skip
    parser.add_argument("--rows", type=int, nargs="+", default=[100_000, 1_000_000],
                        help="lengths of the memory part")  # fmt: skip
    parser.add_argument("--out", type=Path, default=HERE.parent / "results")
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.data is None:
        parser.error("name the folder of the measurements: --data, or SDP_VS_PENALTY_DATA")
    given.data = Path(given.data)
    if given.measure:
        print(json.dumps(measure(given.measure, given)))
        return
    words = ["--data", str(given.data), "--rows", *map(str, given.rows)]
    threads = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
    found = {}
    for number, part in enumerate(given.only, 1):
        print(f"{number}/{len(given.only)} {part}: {PARTS[part]}", flush=True)
        command = [sys.executable, __file__, "--measure", part, *words]
        done = subprocess.run(command, env=os.environ | threads, stdout=subprocess.PIPE, text=True)
        if done.returncode:
            print(f"  {part} failed; the others go on", flush=True)
            continue
        found[part] = json.loads(done.stdout.splitlines()[-1])
    write(given.out, found)


def write(out: Path, found: dict[str, Any]) -> None:
    """The three files, of what was measured now and of what they hold of other parts."""
    from growth import Series, picture

    from sdp_vs_penalty.files import write_text

    rows = [row for part in found.values() for row in part["rows"]]
    new = {(row["part"], row["what"]) for row in rows}
    kept = []
    if (out / "benchmarks.csv").exists():
        with (out / "benchmarks.csv").open(newline="") as file:
            old = list(csv.DictReader(file))
        kept = [row for row in old if (row["part"], row["what"]) not in new and
                (row["part"] not in found or not found[row["part"]]["rows"])]  # fmt: skip
    order = [*PARTS, *LEFT]
    cells = [
        [str(row[name]) if isinstance(row[name], str) else f"{row[name]:.3g}" for name in NAMES]
        for row in sorted([*kept, *rows], key=lambda row: order.index(row["part"]))
    ]
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows([NAMES, *cells])
    write_text(out / "benchmarks.csv", buffer.getvalue())
    state = out / "benchmarks.json"
    grown: dict[str, Any] = (
        json.loads(state.read_text()) if state.exists() else {"series": {}, "lines": []}
    )
    grown["series"] |= {name: part["series"][0] for name, part in found.items() if part["series"]}
    for part in found.values():
        grown["lines"] = part["lines"] or grown["lines"]
        grown["versions"] = grown.get("versions", {}) | part["versions"]
    write_text(state, json.dumps(grown, indent=1) + "\n")
    text = ["# Speed and memory", "", _about(grown.get("versions", {})), ""]
    text += _table(NAMES[1:], [c[1:] for c in cells])
    series = list(grown["series"].values())
    if series:
        own = ("what", "of", "sizes", "seconds")
        picture([Series(**{name: s[name] for name in own}) for s in series], out / "benchmarks.png")
        about = "Processor seconds; the exponent is that of the larger sizes."
        text += ["", "## How cost grows", "", about, ""]
        lines = [
            [s["what"], s["of"], f"{s['sizes'][0]:.6g} to {s['sizes'][-1]:.6g}",
             f"{s['seconds'][0]:.3g} to {s['seconds'][-1]:.3g}", f"{s['exponent']:.2f}"]
            for s in series
        ]  # fmt: skip
        text += _table(["what", "in", "sizes", "seconds", "exponent"], lines)
        text += ["", "![Processor time against size](benchmarks.png)"]
    if grown["lines"]:
        about = "Whole commands, a process each, on recordings at 1 kHz."
        text += ["", "## Long recordings", "", about, ""]
        text += _table(["command", "rows", "CPU [s]", "peak memory beyond imports [MB]"], grown["lines"])
    write_text(out / "benchmarks.md", "\n".join([*text, ""]))
    print("\n".join(text))


def _table(head: list[str], lines: list[list[str]]) -> list[str]:
    return ["| " + " | ".join(line) + " |" for line in [head, ["---"] * len(head), *lines]]


def _about(used: dict[str, str]) -> str:
    return (
        "Panda, the authors' run of 20 544 samples; ratios are within one process or in turn, by "
        f"`python benchmarks/run.py` ({platform.machine()}, one thread; "
        f"{', '.join(f'{name} {version}' for name, version in used.items())}). Rows beside MuJoCo, of "
        f"the bootstrap, of two processes, and growth with the library: by scripts of commit "
        f"{LEFT['rivals']}, which are no longer here."
    )


if __name__ == "__main__":
    main()
