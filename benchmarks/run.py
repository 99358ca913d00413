"""Every figure of speed and memory, by one command.

    python benchmarks/run.py [--data DATA] [--only PART ...] [--rows N ...] [--out results]

DATA holds the measurements as `sdp-vs-penalty fetch` leaves them (its subfolder panda; default:
SDP_VS_PENALTY_DATA). Each part runs in a process of its own on one thread; figures are ratios within one
part. Writes benchmarks.csv and benchmarks.md; parts that are not measured this time keep what the files
there hold of them, with its date.
"""

import argparse
import csv
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
    "processes": "commands as processes, beside bare imports",
    "memory": "processor time and peak memory of whole commands on long recordings",
}
#: Measured once, by scripts that left (the commit that had them): they stay in the table.
LEFT = {"solvers": "8fe364a0", "rivals": "ffa8cd7", "growth": "204ffd3f"}
NAMES = ["part", "what", "ours", "other", "unit", "ratio", "note", "when"]


def measure(part: str, given: argparse.Namespace) -> list[dict[str, Any]]:
    """Rows of the table."""
    import speed

    from sdp_vs_penalty import load_measurements, load_problem
    from sdp_vs_penalty.estimation.identify import versions

    problem, folder = load_problem("panda"), given.data / "panda"
    run = load_measurements(folder, joints=7)
    more = {"text": (folder,), "memory": (run, given.rows)}.get(part, (run,))
    rows = getattr(speed, part)(problem, *more)
    used = " ".join(f"{name} {version}" for name, version in versions().items())
    when = f"{datetime.now(UTC):%Y-%m-%d %H:%M}, load {os.getloadavg()[0]:.0f}, {used}"
    ratios = ["" if r.other is None else r.other / r.ours for r in rows]
    return [
        asdict(r) | {"part": part, "ratio": x, "when": when} for r, x in zip(rows, ratios, strict=True)
    ]


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
    rows: list[dict[str, Any]] = []
    for number, part in enumerate(given.only, 1):
        print(f"{number}/{len(given.only)} {part}: {PARTS[part]}", flush=True)
        command = [sys.executable, __file__, "--measure", part, *words]
        done = subprocess.run(command, env=os.environ | threads, stdout=subprocess.PIPE, text=True)
        if done.returncode:
            print(f"  {part} failed; the others go on", flush=True)
        else:
            rows += json.loads(done.stdout.splitlines()[-1])
    write(given.out, rows)


def write(out: Path, rows: list[dict[str, Any]]) -> None:
    """Both files, of what was measured now and of what they hold of other parts."""
    from sdp_vs_penalty.files import as_csv, write_text
    from sdp_vs_penalty.formatting import markdown_table

    table, new = out / "benchmarks.csv", {row["part"] for row in rows}
    if table.exists():
        with table.open(newline="") as file:
            rows = [*rows, *(row for row in csv.DictReader(file) if row["part"] not in new)]
    order = [*PARTS, *LEFT]
    cells = [
        [f"{x:.3g}" if isinstance(x, float) else str(x or "") for x in map(row.get, NAMES)]
        for row in sorted(rows, key=lambda row: order.index(row["part"]))
    ]
    write_text(table, as_csv(NAMES, cells))
    left = ", ".join(f"{part} by one of commit {commit}" for part, commit in LEFT.items())
    about = (
        "Panda, the authors' run of 20 544 samples; ratios are within one process or in turn, by "
        f"`python benchmarks/run.py` ({platform.machine()}, one thread). By scripts that are no longer "
        f"here: {left}."
    )
    text = ["# Speed and memory", "", about, "", *markdown_table(NAMES, cells), ""]
    write_text(out / "benchmarks.md", "\n".join(text))
    print("\n".join(text))


if __name__ == "__main__":
    main()
