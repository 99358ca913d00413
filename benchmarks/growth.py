"""How cost grows: with samples, runs, joints; and what long recordings cost.

Parts of `benchmarks/run.py`, which says how they are started and writes what they return. For
recordings a Panda moves for so many samples at 1 kHz on sums of sines that never come back; its torque
is that of a model of the authors' run, with a Stribeck friction that this lacks and white noise. Each
command is a process of its own on one thread; memory is its peak beyond that of the same command on an
input error (imports).
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from speed import METHOD, cpu

from sdp_vs_penalty import Estimate, identify
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.estimators import make_estimator
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.shootout import standard_instances

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


@dataclass(frozen=True)
class Series:
    """Processor seconds of one work at several sizes."""

    what: str
    of: str
    sizes: list[float]
    seconds: list[float]

    @property
    def exponent(self) -> float:
        """Of the power law through the larger half of the sizes: small ones are all set-up."""
        half = len(self.sizes) // 2
        x, y = np.log(self.sizes[half - 1 :]), np.log(self.seconds[half - 1 :])
        return float(np.polyfit(x, y, 1)[0])


def _series(
    what: str, of: str, sizes: Sequence[int], work: Callable[[int], Callable[[], object]], times: int
) -> Series:
    seconds = []
    for size in sizes:
        seconds.append(cpu(work(size), times))
        print(f"  {what}: {size} {of}: {seconds[-1]:.3g} s", file=sys.stderr, flush=True)
    return Series(what, of, [float(x) for x in sizes], seconds)


def to_and_fro(run: Measurements, times: int) -> Measurements:
    """One long run: the motion forwards, backwards, forwards, ... under one clock."""
    span = run.t[-1] - run.t[0] + float(np.median(np.diff(run.t)))
    t, q, tau = [], [], []
    for k in range(times):
        forth = k % 2 == 0
        t.append(k * span + (run.t - run.t[0] if forth else run.t[-1] - run.t[::-1]))
        q.append(run.q if forth else run.q[::-1])
        tau.append(run.tau if forth else run.tau[::-1])
    return Measurements(np.concatenate(t), np.concatenate(q), np.concatenate(tau))


def growing(problem: Problem, run: Measurements) -> dict[str, Callable[[], Series]]:
    """How cost grows: with samples, runs of 5 s, and joints."""
    piece, rng = run.rows(slice(0, 5_000)), np.random.default_rng(0)

    def of_samples(count: int) -> Callable[[], object]:
        some = run if count <= len(run.t) else to_and_fro(run, -(-count // len(run.t)))
        part = some.rows(slice(0, count))
        return lambda: identify(problem, part, METHOD, check=False)

    def of_runs(count: int) -> Callable[[], object]:
        noise = 1e-4 * rng.normal(size=(count, *piece.tau.shape))
        pieces = [Measurements(piece.t + 10.0 * k, piece.q, piece.tau + x) for k, x in enumerate(noise)]
        return lambda: identify(problem, pieces, METHOD, check=False)

    def of_joints(count: int) -> Callable[[], object]:
        task = standard_instances.chain_task(count)
        return lambda: make_estimator(METHOD).fit(task).gap

    samples, runs = [5_000, 10_000, 20_000, 40_000, 80_000, 160_000], [1, 2, 4, 8, 16]
    links = [4, 7, 14, 30, 60]
    return {
        "samples": lambda: _series("identify", "samples", samples, of_samples, 2),
        "runs": lambda: _series("identify", "runs of 5 000 samples", runs, of_runs, 2),
        "joints": lambda: _series("certified fit", "joints", links, of_joints, 3),
    }


def memory(run: Measurements, problem: Problem, rows: Sequence[int]) -> list[list[str]]:
    """Processor seconds and peak memory of whole commands on recordings of so many rows at 1 kHz."""
    verbs = ("identify", "check", "compare", "convert", "diagnose")
    lines = []
    with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
        true = identify(problem, run, check=False)
        true.save(Path(folder, "model.json"))
        log, model, out = (str(Path(folder, x)) for x in ("run.csv", "model.json", "out.json"))
        imports = {v: measured(*commands(log + "x", model, out)[v]) for v in verbs}
        for count in rows:
            write(Path(log), count, true)
            for verb in verbs:
                seconds, most = measured(*commands(log, model, out)[verb])
                lines.append([verb, str(count), f"{seconds:.1f}", f"{most - imports[verb][1]:.0f}"])
                print("  ", *lines[-1], file=sys.stderr, flush=True)
    return lines


def picture(series: Sequence[Series], path: Path) -> None:
    """Seconds against size, a panel for each kind of size, with the exponent of each line."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.1 * len(series), 3.0), layout="constrained")
    for axes, s in zip(figure.subplots(1, len(series), squeeze=False)[0], series, strict=True):
        axes.loglog(s.sizes, s.seconds, "o-", label=f"{s.what}: exponent {s.exponent:.2f}")
        ticks = [f"{x:g}" if x < 1e4 else f"{1e-3 * x:g}k" for x in s.sizes]
        axes.set_xticks(s.sizes, ticks, fontsize=7)
        axes.minorticks_off()
        axes.set(xlabel=s.of, ylabel="CPU [s]")
        axes.legend(fontsize=7)
    figure.savefig(path, dpi=150, metadata={"Software": None})
