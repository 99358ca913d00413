"""Every figure of speed and memory, by one command.

    python benchmarks/run.py [--data DATA] [--figaroh PYTHON] [--mujoco PYTHON]
                             [--only PART ...] [--again] [--out results]

DATA holds the measurements as `sdp-vs-penalty fetch` leaves them (its subfolder panda; default:
SDP_VS_PENALTY_DATA). PYTHON is the interpreter of an environment with figaroh==1.0.2, and of one with
mujoco[sysid]==4.0.0; without it that comparison says so. Each part runs in a process of its own on one
thread and leaves its figures in build/benchmarks; a part that is there is not measured again unless
--again is given, so that a run that was stopped goes on. Figures are ratios within one part. Writes
benchmarks.csv, benchmarks.md and benchmarks.png of all parts that are there.
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
import time
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
STATE = HERE.parent / "build" / "benchmarks"
#: Name of each part, and what it measures.
PARTS = {
    "text": "text files to a certified estimate against the naive way; one penalised loss",
    "flat": "solve time and memory against the length of a run",
    "process": "identify as a process against FIGAROH's",
    "mujoco": "identification beside MuJoCo's toolbox: time, errors, consistency",
    "chain": "a chain of 60 links",
    "bootstrap": "1000 certified draws",
    "samples": "exponent in samples",
    "runs": "exponent in runs",
    "joints": "exponent in joints",
    "library": "exponent of a diagnosis in the library's size",
    "memory": "processor time and peak memory of whole commands on long recordings",
}


def measure(part: str, given: argparse.Namespace) -> dict[str, Any]:
    """Rows of pairs, series of growth, or lines of the memory table."""
    import growth
    import mujoco_pair
    import pairs

    from sdp_vs_penalty import load_measurements, load_problem
    from sdp_vs_penalty.estimation.certify import versions

    problem = load_problem("panda")
    folder = given.data / "panda"
    run = load_measurements(folder, joints=7)
    rows, series, lines = [], [], []
    if part == "text":
        rows = pairs.text_and_loss(problem, folder, run)
    elif part == "flat":
        rows = pairs.flat_in_samples(problem, run)
    elif part == "process":
        rows = pairs.whole_process(problem, run, given.figaroh)
    elif part == "mujoco":
        rows = mujoco_pair.beside_mujoco(problem, run, given.mujoco)
    elif part == "chain":
        rows = growth.chain()
    elif part == "bootstrap":
        rows = growth.resamples()
    elif part == "memory":
        lines = growth.memory(run, problem, given.rows)
    else:
        series = growth.growing(problem, run)[part]()
    return {
        "rows": [asdict(r) for r in rows],
        "series": [asdict(s) for s in series],
        "lines": lines,
        "versions": versions(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=os.environ.get("SDP_VS_PENALTY_DATA"))
    parser.add_argument("--figaroh", help="interpreter of an environment with figaroh")
    parser.add_argument("--mujoco", help="interpreter of an environment with mujoco[sysid]")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART",
                        help=", ".join(PARTS))  # fmt: skip
    parser.add_argument("--again", action="store_true", help="measure parts that are there, too")
    parser.add_argument("--rows", type=int, nargs="+", default=[100_000, 1_000_000],
                        help="lengths of the memory part")  # fmt: skip
    parser.add_argument("--out", type=Path, default=HERE.parent / "results")
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.data is None:
        parser.error("name the folder of the measurements: --data, or SDP_VS_PENALTY_DATA")
    if given.measure:
        print(json.dumps(measure(given.measure, given)))
        return
    STATE.mkdir(parents=True, exist_ok=True)
    words = ["--data", str(given.data), "--rows", *map(str, given.rows)]
    for name in ("figaroh", "mujoco"):
        words += [f"--{name}", getattr(given, name)] if getattr(given, name) else []
    threads = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
    for number, part in enumerate(given.only, 1):
        kept = STATE / f"{part}.json"
        if kept.exists() and not given.again:
            print(f"{number}/{len(given.only)} {part}: there already", flush=True)
            continue
        print(f"{number}/{len(given.only)} {part}: {PARTS[part]}", flush=True)
        command = [sys.executable, __file__, "--measure", part, *words]
        begin = time.monotonic()
        done = subprocess.run(command, env=os.environ | threads, stdout=subprocess.PIPE, text=True)
        if done.returncode:
            print(f"  {part} failed; the others go on", flush=True)
            continue
        found = json.loads(done.stdout.splitlines()[-1])
        found |= {"when": f"{datetime.now(UTC):%Y-%m-%d %H:%M}", "seconds": time.monotonic() - begin}
        found["load"] = os.getloadavg()[0]
        kept.write_text(json.dumps(found))
    write(given.out)


def write(out: Path) -> None:
    """benchmarks.csv, benchmarks.md and benchmarks.png of the parts that are there."""
    from growth import Series, picture

    from sdp_vs_penalty.files import write_text

    parts = {
        p: json.loads((STATE / f"{p}.json").read_text()) for p in PARTS if (STATE / f"{p}.json").exists()
    }
    names = ["what", "ours", "other", "unit", "ratio", "target", "met", "note"]
    cells = [
        [r["what"], f"{r['ours']:.3g}", f"{r['other']:.3g}", r["unit"], f"{r['ratio']:.3g}", r["target"],
         "yes" if r["met"] else "no", r["note"]]
        for found in parts.values() for r in found["rows"]
    ]  # fmt: skip
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows([names, *cells])
    write_text(out / "benchmarks.csv", buffer.getvalue())
    series = [Series(**s) for found in parts.values() for s in found["series"]]
    text = ["# Speed and memory", "", _about(parts), "", *_table(names, cells)]
    if series:
        picture(series, out / "benchmarks.png")
        grown = [
            [
                s.what,
                s.of,
                f"{s.sizes[0]:.6g} to {s.sizes[-1]:.6g}",
                f"{s.seconds[0]:.3g} to {s.seconds[-1]:.3g}",
                f"{s.exponent:.2f}",
            ]
            for s in series
        ]
        text += [
            "",
            "## How cost grows",
            "",
            "Processor seconds; the exponent is that of the larger sizes.",
            "",
        ]
        text += _table(["what", "in", "sizes", "seconds", "exponent"], grown)
        text += ["", "![Processor time against size](benchmarks.png)"]
    if parts.get("memory"):
        head = ["command", "rows", "CPU [s]", "peak memory beyond imports [MB]"]
        text += [
            "",
            "## Long recordings",
            "",
            "Whole commands, a process each, on recordings at 1 kHz.",
            "",
        ]
        text += _table(head, parts["memory"]["lines"])
    absent = [
        p for p in PARTS if p not in parts or not any(parts[p][k] for k in ("rows", "series", "lines"))
    ]
    if absent:
        text += ["", f"Not measured: {', '.join(f'{p} ({PARTS[p]})' for p in absent)}."]
    write_text(out / "benchmarks.md", "\n".join([*text, ""]))
    print("\n".join(text))


def _table(head: list[str], lines: list[list[str]]) -> list[str]:
    return ["| " + " | ".join(line) + " |" for line in [head, ["---"] * len(head), *lines]]


def _about(parts: dict[str, Any]) -> str:
    used = next((f["versions"] for f in parts.values()), {})
    when = [f["when"] for f in parts.values()] or [""]
    loads = [f["load"] for f in parts.values()] or [0.0]
    machine = f"{platform.machine()}, one thread used, load {min(loads):.0f} to {max(loads):.0f}"
    return (
        "Panda, the authors' run of 20 544 samples; the figures of a row or a line were measured in one "
        "process or in turn, part by part, by `python benchmarks/run.py` between "
        f"{min(when)} and {max(when)} UTC ({machine}; "
        f"{', '.join(f'{name} {version}' for name, version in used.items())})."
    )


if __name__ == "__main__":
    main()
