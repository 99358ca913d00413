"""What a diagnosis costs: processor time and memory, of this program and of another version of it.

    python benchmarks/diagnosis.py --data DATA [--against TREE] [--rows 100000 1000000]

DATA holds the measurements as `sdp-vs-penalty fetch` leaves them (its subfolder panda). The Panda's run
is diagnosed: 0 to 7.6 s, judged on 8 to 13.2 s and on folds; then repeated, with a pause of 1 s, to each
of the --rows. TREE is a checkout of another version: the same work is done by both in turn, on one
thread. Each diagnosis is a process of its own; its memory is what it needs beyond imports and data.
Prints a table, the findings of both where they differ, and the exponent of processor time in rows.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

TRAIN, TEST, PAUSE = (0.0, 7.6), (8.0, 13.2), 1.0
#: Run by each version, in a process of its own.
WORK = """
import json, os, resource, sys, time
import numpy as np
import sdp_vs_penalty as library

assert library.__file__.startswith(os.getcwd()), library.__file__
from sdp_vs_penalty.data.measurements import concatenate

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0

data, train, test, rows = json.loads(sys.argv[1])
run = library.load_measurements(data, joints=7)
model = library.identify("panda", run.window(*train), "ols")
if rows:
    count = -(-rows // len(run.t))
    shift = np.repeat((run.t[-1] - run.t[0] + 1.0) * np.arange(count), len(run.t))[:rows]
    searched = type(run)(
        np.tile(run.t, count)[:rows] + shift,
        *(np.tile(x, (count, 1))[:rows] for x in (run.q, run.tau)),
    )
    judged = None
else:
    searched, judged = run.window(*train), run.window(*test) if test else None
before, start = peak(), time.process_time()
found = library.diagnose(model, searched, judged)
print(json.dumps([time.process_time() - start, peak() - before, found.to_dict()["effects"]]))
"""


def diagnosed(tree: Path, *work: Any) -> tuple[float, float, list[dict[str, Any]]]:
    """Processor time [s], memory [MB] and findings of one diagnosis by the version in a tree."""
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", WORK, json.dumps(work)],
        cwd=tree,  # before everything else on the path: the package of this tree
        env={**os.environ, **threads},
        check=True,
        capture_output=True,
        text=True,
    )
    seconds, memory, effects = json.loads(done.stdout)
    return seconds, memory, effects


def named(effects: list[dict[str, Any]]) -> list[str]:
    return [f"{e['effect']}:{'+'.join(map(str, e['joints']))} {e['size']:.4g}" for e in effects]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--against", type=Path, help="a checkout of another version")
    parser.add_argument("--rows", type=int, nargs="*", default=[], help="lengths of repeated runs")
    given = parser.parse_args()
    here = Path(__file__).resolve().parents[1]
    trees = [here] if given.against is None else [here, given.against.resolve()]
    cases: list[tuple[str, Any, int]] = [("with a test run", TEST, 0), ("on folds", None, 0)]
    cases += [(f"{rows} rows", None, rows) for rows in given.rows]
    print("| Panda | CPU | memory | other version | ratio |\n| --- | ---: | ---: | ---: | ---: |")
    times = []
    for name, test, rows in cases:
        parts = [
            diagnosed(tree, str(given.data.resolve() / "panda"), TRAIN, test, rows) for tree in trees
        ]
        seconds, memory, effects = parts[0]
        times.append(seconds)
        other = f"{parts[1][0]:.2f} s | {parts[1][0] / seconds:.1f}" if len(parts) > 1 else "| "
        print(f"| {name} | {seconds:.2f} s | {memory:.0f} MB | {other} |", flush=True)
        if len(parts) > 1 and named(parts[1][2]) != named(effects):
            print(f"  findings differ: {named(effects)}, other version {named(parts[1][2])}")
    if len(given.rows) > 1:
        slope = np.polyfit(np.log(given.rows), np.log(times[-len(given.rows) :]), 1)[0]
        print(f"exponent of processor time in rows: {slope:.2f}")


if __name__ == "__main__":
    main()
