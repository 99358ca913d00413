"""What long recordings cost: processor time and peak memory of whole commands, and their exponents.

    python benchmarks/long_runs.py --data DATA [--rows 100000 1000000 10000000] [--verbs identify ...]

DATA holds the measurements as `sdp-vs-penalty fetch` leaves them (its subfolder panda). A Panda moves
for so many samples at 1 kHz on sums of sines that never come back; its torque is that of a model of the
authors' run, with a Stribeck friction that this lacks and white noise. Each command is a process of its
own on one thread; memory is its peak beyond that of the same command on an input error (imports).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from sdp_vs_penalty import Estimate, identify, load_measurements

_PART = 50_000
_NOISE = np.array([0.15, 0.2, 0.15, 0.15, 0.08, 0.08, 0.06])  # N m
_CENTRE = np.array([0.0, -0.3, 0.0, -1.8, 0.0, 1.9, 0.3])  # rad


def write(path: Path, rows: int, model: Estimate) -> None:
    """A recording as CSV, a part at a time."""
    rng, n = np.random.default_rng(5), 7
    omega = 2.0 * np.pi * rng.uniform(0.05, 0.6, (n, 6))
    size = 0.14 * rng.uniform(0.6, 1.4, omega.shape) / (1.0 + omega / 4.0)
    phase = rng.uniform(0.0, 2.0 * np.pi, omega.shape)
    with path.open("w") as file:
        file.write(",".join(["t", *(f"{x}{j + 1}" for x in ("q", "tau") for j in range(n))]) + "\n")
        for start in range(0, rows, _PART):
            t = np.arange(start, min(rows, start + _PART)) / 1000.0
            at = t[:, None, None] * omega + phase
            q = _CENTRE + (size * np.sin(at)).sum(axis=2)
            dq = (size * omega * np.cos(at)).sum(axis=2)
            tau = model.predict(q, dq, (-size * omega**2 * np.sin(at)).sum(axis=2))
            tau[:, 3] += 0.8 * np.exp(-((dq[:, 3] / 0.05) ** 2)) * np.tanh(dq[:, 3] / 0.005)
            q, tau = q + rng.normal(0.0, 2e-5, q.shape), tau + rng.normal(size=q.shape) * _NOISE
            np.savetxt(file, np.column_stack([t, q, tau]), ["%.3f"] + ["%.6f"] * n + ["%.4f"] * n, ",")


#: Run by a small process: a child's peak begins with the memory of the process that starts it.
_WORK = """
import resource, subprocess, sys
quiet = subprocess.DEVNULL
subprocess.run([sys.executable, "-m", "sdp_vs_penalty", *sys.argv[1:]], stdout=quiet, stderr=quiet)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0)
"""


def measured(*words: str) -> tuple[float, float]:
    """Processor time [s] and peak memory [MB] of one command."""
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command, env = [sys.executable, "-c", _WORK, *words], {**os.environ, **threads}
    done = subprocess.run(command, env=env, check=True, capture_output=True, text=True)
    seconds, peak = map(float, done.stdout.split())
    return seconds, peak


def commands(run: str, model: str, out: str) -> dict[str, list[str]]:
    return {
        "identify": ["identify", "panda", "--data", run, "--out", out],
        "identify --no-check": ["identify", "panda", "--data", run, "--no-check", "--out", out],
        "check": ["check", run, "--problem", "panda"],
        "compare": ["compare", model, "--data", run],
        "convert": ["convert", run, "--out", out.replace(".json", ".npz")],
        "diagnose": ["diagnose", model, "--data", run],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--rows", type=int, nargs="+", default=[100_000, 1_000_000])
    parser.add_argument("--verbs", nargs="+", default=list(commands("", "", "")))
    given = parser.parse_args()
    print("| command | rows | CPU [s] | memory beyond imports [MB] | exponent of CPU |")
    print("| --- | ---: | ---: | ---: | ---: |")
    with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
        true = identify("panda", load_measurements(given.data / "panda", joints=7))
        true.save(Path(folder, "model.json"))
        last: dict[str, tuple[int, float]] = {}
        run, model, out = (str(Path(folder, x)) for x in ("run.csv", "model.json", "out.json"))
        absent = commands(run + ".csv", model, out)
        imports = {verb: measured(*absent[verb])[1] for verb in given.verbs}
        for rows in given.rows:
            write(Path(run), rows, true)
            for verb in given.verbs:
                seconds, peak = measured(*commands(run, model, out)[verb])
                slope = ""
                if verb in last:
                    slope = f"{np.log(seconds / last[verb][1]) / np.log(rows / last[verb][0]):.2f}"
                last[verb] = rows, seconds
                print(
                    f"| {verb} | {rows} | {seconds:.1f} | {peak - imports[verb]:.0f} | {slope} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
