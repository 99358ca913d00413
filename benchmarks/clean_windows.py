"""Clean windows of every real log and of geared simulated arms: the check has to be silent on them.

    python benchmarks/clean_windows.py --data DATA [--kept] [--only panda]

Prints every window with a problem, errors first, and how many there were. ``--kept`` : the windows and
arms that were not looked at while the check was made.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from corruption_arms import panda_run, rows, tx40_run, ur10e_run
from geared_arms import geared
from unseen_arms import unseen

from sdp_vs_penalty import load_measurements, load_problem
from sdp_vs_penalty.checks import check
from sdp_vs_penalty.data.datasets import converted
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.problem.problem import Problem

Window = tuple[str, Problem, Measurements]

_UR10E = (
    "12-50sec_12harm",
    "19_14harm50sec",
    "19_15harm50sec",
    "19_14harm50secLoad",
    "19_15harm50secLoad",
)
_LOOKED_AT, _KEPT = (1, 2, 3, 4, 5, 6), (41, 42, 43, 44, 45, 46)


def windows(data: Path, kept: bool) -> Iterator[Window]:
    yield from panda(data, kept)
    yield from ur10e(data, kept)
    yield from others(data, kept)
    for seed in _KEPT if kept else _LOOKED_AT:
        arm = geared(seed)
        for k, run in enumerate((arm.train, arm.test)):
            yield f"{arm.name} run {k}", arm.problem, run
            yield f"{arm.name} run {k} 0-9 s", arm.problem, run.window(0.0, 9.0).runs()[0]
    names = ("drawn51", "drawn52", "drawn53") if kept else ("seven", "desk6", "drawn1", "drawn2")
    for arm in unseen(data, names):
        for k, run in enumerate((arm.train, arm.test)):
            yield f"{arm.name} run {k}", arm.problem, run


def panda(data: Path, kept: bool) -> Iterator[Window]:
    problem = load_problem("panda")
    spans = [(0.0, 6.5), (8.0, 13.2), (0.0, 7.6), (0.0, 14.0), (0.0, 99.0), (7.6, 14.0)]
    if kept:
        spans = [(3.0, 10.0), (12.0, 19.5), (15.0, 22.0), (14.0, 20.5), (10.0, 25.0), (5.0, 11.0)]
    for word, run in (
        ("raw", load_measurements(data / "panda", joints=7)),
        ("every fifth", panda_run(data)),
    ):
        for span in spans:
            yield f"panda {word} {span[0]:g}-{span[1]:g} s", problem, run.window(*span).runs()[0]
    for hertz in (150.0, 330.0, 2200.0) if kept else (100.0, 250.0, 1000.0, 2000.0):
        yield f"panda every fifth resampled at {hertz:g} Hz", problem, resampled(panda_run(data), hertz)


def resampled(run: Measurements, hertz: float) -> Measurements:
    """On an even clock, linearly interpolated, as converters of bags write it."""
    t = np.arange(run.t[0], run.t[-1], 1.0 / hertz)
    q, tau = (np.column_stack([np.interp(t, run.t, x) for x in y.T]) for y in (run.q, run.tau))
    return replace(run, t=t, q=q, tau=tau, dq=None, run=None)


def ur10e(data: Path, kept: bool) -> Iterator[Window]:
    problem = load_problem("ur10e")
    for name in _UR10E:
        run = ur10e_run(data, f"ur-20_02_{name}")
        for length in (14.0, 25.0) if kept else (10.0, 20.0):
            for begin in np.arange(3.0 if kept else 0.0, 49.0 - length, length):
                span = float(begin), float(begin + length)
                yield f"ur10e {name} {span[0]:g}-{span[1]:g} s", problem, run.window(*span).runs()[0]
        if not kept:
            yield f"ur10e {name} resampled at 250 Hz", problem, resampled(run, 250.0)


def others(data: Path, kept: bool) -> Iterator[Window]:
    for name, run in converted("emps", data / "emps").items():
        for span in ((3.0, 12.0),) if kept else ((0.0, 99.0), (0.0, 10.0)):
            yield (
                f"emps {name} {span[0]:g}-{span[1]:g} s",
                load_problem("emps"),
                run.window(*span).runs()[0],
            )
    run, problem = tx40_run(data), load_problem("tx40")
    for a, b in ((10_000, 40_000),) if kept else ((0, 45_000), (0, 22_500), (22_500, 45_000)):
        yield f"tx40 {a / 5e3:g}-{b / 5e3:g} s", problem, rows(run, np.arange(a, b, 10))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--kept", action="store_true")
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    begin, count, bad = time.process_time(), 0, {"error": 0, "warning": 0}
    for name, problem, run in windows(given.data, given.kept):
        if given.only not in name:
            continue
        count += 1
        (report,) = check(problem, run)
        for issue in report.problems:
            print(f"{issue.severity}: {name}: {issue.kind} ({issue.where}): {issue.what}", flush=True)
        for severity in bad:
            bad[severity] += any(f.severity == severity for f in report.problems)
    print(f"{count} clean windows: {bad['error']} with errors, {bad['warning']} with warnings; "
          f"{time.process_time() - begin:.0f} CPU s")  # fmt: skip


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    main()
