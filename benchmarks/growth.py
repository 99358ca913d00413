"""How cost grows: with samples, joints, runs, the library; memory; 60 links; resamples.

Parts of `benchmarks/run.py`, which says how they are started and draws what they return.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bootstrap
import default_path
import long_runs
import numpy as np
from pairs import METHOD, Row, cpu, peak, to_and_fro

import sdp_vs_penalty.diagnosis.library as library
from sdp_vs_penalty import diagnose, identify
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.estimators import make_estimator
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.shootout.regular import chain_task


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


def samples(problem: Problem, run: Measurements) -> list[Series]:
    """The whole identification in process, of a part of the run and of the run to and fro."""

    def of(count: int) -> Callable[[], object]:
        some = run if count <= len(run.t) else to_and_fro(run, -(-count // len(run.t)))
        part = some.rows(slice(0, count))
        return lambda: identify(problem, part, METHOD)

    sizes = [5_000, 10_000, 20_000, 40_000, 80_000, 160_000]
    return [_series("identify", "samples", sizes, of, 2)]


def runs(problem: Problem, run: Measurements) -> list[Series]:
    """The same of as many runs of 5 s each."""
    piece, rng = run.rows(slice(0, 5_000)), np.random.default_rng(0)

    def of(count: int) -> Callable[[], object]:
        noise = 1e-4 * rng.normal(size=(count, *piece.tau.shape))
        pieces = [Measurements(piece.t + 10.0 * k, piece.q, piece.tau + x) for k, x in enumerate(noise)]
        return lambda: identify(problem, pieces, METHOD)

    return [_series("identify", "runs of 5 000 samples", [1, 2, 4, 8, 16], of, 2)]


def joints() -> list[Series]:
    """From compressed data to a certified fit of chains with so many links."""

    def of(count: int) -> Callable[[], object]:
        task = chain_task(count)
        return lambda: make_estimator(METHOD).fit(task)

    return [_series("certified fit", "joints", [4, 7, 14, 30, 60], of, 3)]


def effects(problem: Problem, run: Measurements) -> list[Series]:
    """A diagnosis of the Panda's first 7.6 s with a part of the library's effects."""
    given, test = run.window(0.0, 7.6), run.window(8.0, 13.2)
    model = identify(
        problem, given, effects="rigid_body,viscous_friction,coulomb_friction,torque_offset"
    )
    every = list(effect_types().items())

    def of(count: int) -> Callable[[], object]:
        chosen = dict(every[k] for k in np.linspace(0, len(every) - 1, count).round().astype(int))

        def work() -> None:
            library.effect_types = lambda: chosen  # type: ignore[assignment]
            diagnose(model, given, test)

        return work

    sizes = [4, 8, 16, len(every)]
    return [_series("diagnose", "effects in the library", sizes, of, 1)]


def chain(links: int = 60) -> list[Row]:
    """A certified fit of a long chain by our own method and by Clarabel, and its memory."""
    task = chain_task(links)
    estimator = make_estimator(METHOD)
    other = cpu(lambda: replace(estimator, solver="clarabel").fit(task), 2)
    ours, memory = cpu(lambda: estimator.fit(task), 3), peak(lambda: estimator.fit(task))
    return [
        Row(f"certified fit of {links} links, CPU", ours, other, "s", other / ours, "<= 0.35 s",
            ours <= 0.35, f"{memory:.0f} MB beyond the data; other: the same loop with Clarabel")
    ]  # fmt: skip


def resamples(draws: int = 1000) -> list[Row]:
    """A block bootstrap, every draw certified, against a loop over fresh CVXPY problems."""
    source, instance, blocks = default_path.measured_panda()
    start = time.process_time()
    found = bootstrap.bootstrap(instance.task, blocks, draws, 0)
    ours = time.process_time() - start
    loop = draws // 50
    start = time.process_time()
    for k in range(loop):
        data = bootstrap.joined(blocks, bootstrap.draw_counts(len(blocks), k, 0))
        default_path.fresh_cvxpy(instance, data)
    other = (time.process_time() - start) / loop * draws
    note = (
        f"{source}; largest certified gap {found.gap.max():.1e}, {found.again} solved again; "
        f"theirs: fresh CVXPY problems, {loop} of the same draws, none certified"
    )
    return [
        Row(
            f"bootstrap, {draws} draws, CPU", ours, other, "s", other / ours, "<= 3 s", ours <= 3.0, note
        )
    ]


def memory(run: Measurements, problem: Problem, rows: Sequence[int]) -> list[list[str]]:
    """Processor seconds and peak memory of whole commands on recordings of so many rows at 1 kHz."""
    verbs = ("identify", "check", "compare", "convert", "diagnose")
    lines = []
    with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
        true = identify(problem, run)
        true.save(Path(folder, "model.json"))
        log, model, out = (str(Path(folder, x)) for x in ("run.csv", "model.json", "out.json"))
        imports = {v: long_runs.measured(*long_runs.commands(log + "x", model, out)[v]) for v in verbs}
        for count in rows:
            long_runs.write(Path(log), count, true)
            for verb in verbs:
                seconds, most = long_runs.measured(*long_runs.commands(log, model, out)[verb])
                lines.append([verb, str(count), f"{seconds:.1f}", f"{most - imports[verb][1]:.0f}"])
                print("  ", *lines[-1], file=sys.stderr, flush=True)
    return lines


def picture(series: Sequence[Series], path: Path) -> None:
    """Seconds against size, a panel for each kind of size, with the exponent of each line."""
    from matplotlib.figure import Figure

    kinds = list(dict.fromkeys(s.of for s in series))
    figure = Figure(figsize=(3.1 * len(kinds), 3.0), layout="constrained")
    for axes, kind in zip(figure.subplots(1, len(kinds), squeeze=False)[0], kinds, strict=True):
        for s in (x for x in series if x.of == kind):
            axes.loglog(s.sizes, s.seconds, "o-", label=f"{s.what}: exponent {s.exponent:.2f}")
        sizes = sorted({x for s in series if s.of == kind for x in s.sizes})
        axes.set_xticks(sizes, [f"{x:g}" if x < 1e4 else f"{1e-3 * x:g}k" for x in sizes], fontsize=7)
        axes.minorticks_off()
        axes.set_xlabel(kind)
        axes.set_ylabel("processor time [s]")
        axes.legend(fontsize=7)
        axes.grid(alpha=0.3, which="both")
    figure.savefig(path, dpi=110)


def growing(problem: Problem, run: Measurements) -> dict[str, Callable[[], list[Series]]]:
    """Each part by its name."""
    return {
        "samples": lambda: samples(problem, run),
        "runs": lambda: runs(problem, run),
        "joints": joints,
        "library": lambda: effects(problem, run),
    }
