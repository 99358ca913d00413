"""How cost grows: with samples, runs, joints; and what long recordings cost.

Parts of `benchmarks/run.py`, which says how they are started and writes what they return. For
recordings a Panda moves for so many samples at 1 kHz on sums of sines that never come back; its torque
is that of a model of the authors' run, with a Stribeck friction that this lacks and white noise. Each
command is a process of its own on one thread; memory is its peak beyond that of the same command on an
input error (imports).
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from speed import METHOD, PROGRAM, Row, cpu, measured

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


def commands(run: str, model: str, out: str) -> dict[str, list[str]]:
    return {
        "identify": ["identify", "panda", "--data", run, "--out", out],
        "check": ["check", run, "--problem", "panda"],
        "compare": ["compare", model, "--data", run],
        "convert": ["convert", run, "--out", out.replace(".json", ".npz")],
        "diagnose": ["diagnose", model, "--data", run],
    }


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


def growth(problem: Problem, run: Measurements) -> list[Row]:
    """The exponent of the power law through the larger half of the sizes: small ones are all set-up."""
    piece, rng = run.rows(slice(0, 5_000)), np.random.default_rng(0)

    def of_samples(count: int) -> Callable[[], object]:
        part = to_and_fro(run, -(-count // len(run.t))).rows(slice(0, count))
        return lambda: identify(problem, part, METHOD, check=False)

    def of_runs(count: int) -> Callable[[], object]:
        noise = 1e-4 * rng.normal(size=(count, *piece.tau.shape))
        pieces = [Measurements(piece.t + 10.0 * k, piece.q, piece.tau + x) for k, x in enumerate(noise)]
        return lambda: identify(problem, pieces, METHOD, check=False)

    def of_joints(count: int) -> Callable[[], object]:
        task = standard_instances.chain_task(count)
        return lambda: make_estimator(METHOD).fit(task).gap

    rows = []
    for what, work, sizes in (
        ("identify, samples", of_samples, [5_000 * 2**k for k in range(6)]),
        ("identify, runs of 5 000 samples", of_runs, [2**k for k in range(5)]),
        ("certified fit, joints", of_joints, [4, 7, 14, 30, 60]),
    ):
        seconds = [cpu(work(size), 2) for size in sizes]
        half = len(sizes) // 2 - 1
        exponent = float(np.polyfit(np.log(sizes[half:]), np.log(seconds[half:]), 1)[0])
        note = f"{sizes[0]} to {sizes[-1]}: {seconds[0]:.3g} to {seconds[-1]:.3g} s CPU"
        rows.append(Row(what, exponent, None, "exponent", note))
    return rows


def memory(run: Measurements, problem: Problem, counts: Sequence[int]) -> list[Row]:
    """Processor seconds and peak memory of whole commands on recordings of so many rows at 1 kHz."""
    rows = []
    with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
        true = identify(problem, run, check=False)
        true.save(Path(folder, "model.json"))
        log, model, out = (str(Path(folder, x)) for x in ("run.csv", "model.json", "out.json"))
        imports = {
            v: measured([*PROGRAM, *words])[1] for v, words in commands(log + "x", model, out).items()
        }
        for count in counts:
            write(Path(log), count, true)
            for verb, words in commands(log, model, out).items():
                seconds, most = measured([*PROGRAM, *words])
                note = f"peak memory {most - imports[verb]:.0f} MB beyond imports"
                rows.append(Row(f"{verb}, {count} rows", seconds, None, "s", note))
                print("  ", rows[-1].what, f"{seconds:.1f} s", note, file=sys.stderr, flush=True)
    return rows
