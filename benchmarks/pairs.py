"""Speed and memory in pairs: this program's way and another one, measured in one process or one run.

Parts of `benchmarks/run.py`, which says how they are started and writes what they return.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import naive
import numpy as np

from sdp_vs_penalty import identify, load_measurements
from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.effects.effect import SIGN_WIDTH
from sdp_vs_penalty.estimators import make_estimator
from sdp_vs_penalty.estimators.barycentric import barycentric_box
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.penalty_paper import PenalisedLoss
from sdp_vs_penalty.estimators.task import make_task
from sdp_vs_penalty.exporters.export import export
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import LeastSquares, compress

#: The default SDP without what only we have: its plain form is what a script would write.
METHOD = "lmi-sdp"
HERE = Path(__file__).parent


@dataclass(frozen=True)
class Row:
    """One comparison; target: what was aimed at, as text; met: whether it was reached."""

    what: str
    ours: float
    other: float
    unit: str
    ratio: float
    target: str
    met: bool
    note: str = ""


def cpu(call: Callable[[], object], times: int = 1) -> float:
    """Least processor time of a call [s]."""
    best = np.inf
    for _ in range(times):
        start = time.process_time()
        call()
        best = min(best, time.process_time() - start)
    return best


def from_text(problem: Problem, folder: Path) -> tuple[Row, np.ndarray]:
    """Text files to a certified estimate, against the naive route; also the naive route's rows."""
    ours = cpu(lambda: identify(problem, load_measurements(folder, joints=7), METHOD), times=7)
    task = task_of(problem, load_measurements(folder, joints=7))  # for its constraints
    kept: list[np.ndarray] = []

    def route() -> None:
        _, q, tau = naive.read(folder, 7)
        rows = naive.all_rows(problem.robot._model, q, tau, SIGN_WIDTH)
        r = naive.triangle(rows)
        data = LeastSquares(
            r[:-1, :-1], r[:-1, -1], abs(r[-1, -1]), float(r[:, -1] @ r[:, -1]), len(rows)
        )
        solve_with_cvxpy(replace(task, data=data))
        kept.append(rows)

    other = cpu(route, times=2)
    row = Row(
        "text files to estimate, CPU", ours, other, "s", other / ours, ">= 15x less", other >= 15 * ours,
        "ours certified; theirs: Pinocchio loop, columns filtered, QR of all rows, CVXPY + Clarabel",
    )  # fmt: skip
    return row, kept[0]


def task_of(problem: Problem, measurements: Measurements) -> Task:
    model = problem.model()
    settings = problem.preprocessing.resolve(measurements)
    return make_task(problem, model, compress(measurements, model, settings))


def solve_with_cvxpy(task: Task) -> np.ndarray:
    """The same problem as the default method's, through CVXPY from nothing."""
    objective, constraints = make_estimator(METHOD).posed(task)  # type: ignore[attr-defined]
    data = objective.least_squares
    norms = data.column_norms
    size = np.sqrt(data.tau_squared) / np.where(norms > 0.0, norms, np.inf)
    scale = np.where(norms > 0.0, np.minimum(size, task.bound), task.bound)
    unit = float(np.sqrt(data.loss(task.ols)))
    return naive.solve(data.R, data.rho, scale, unit, constraints.convex)


def compressed(task: Task) -> Row:
    """The default path with set-up against fresh CVXPY + Clarabel on the same compressed problem."""
    estimator = make_estimator(METHOD)
    ours = cpu(lambda: estimator.fit(task), times=15)
    other = cpu(lambda: solve_with_cvxpy(task), times=7)
    return Row(
        "compressed problem to optimum, CPU", 1e3 * ours, 1e3 * other, "ms", other / ours,
        ">= 2x less", other >= 2 * ours, "ours: set-up, interior point, solve, gap checked",
    )  # fmt: skip


def peak(call: Callable[[], object]) -> float:
    """Memory that a call needs at most beyond what was there before [MB]."""
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    tracemalloc.reset_peak()
    call()
    highest = tracemalloc.get_traced_memory()[1] - before
    tracemalloc.stop()
    return highest / 1e6


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


def flat_in_samples(problem: Problem, run: Measurements, times: int = 8) -> list[Row]:
    """Solve time and memory for the run once and ``times`` as long."""
    long = to_and_fro(run, times)
    again = concatenate([run] * times)  # the same problem; backwards, friction would contradict itself
    model, settings = problem.model(), problem.preprocessing.resolve(run)
    estimator = make_estimator(METHOD)
    tasks = [task_of(problem, data) for data in (run, again)]
    once, over = (cpu(lambda task=task: estimator.fit(task), times=15) for task in tasks)  # type: ignore[misc]
    # Blocks of a few seconds are not full triangles yet: memory saturates with the length of blocks.
    longer = to_and_fro(run, 2 * times)
    lengths = (run, long, longer)
    memory = [peak(lambda data=data: compress(data, model, settings)) for data in lengths]  # type: ignore[misc]
    count = f"{len(run.t)} against {len(long.t)} samples"
    return [
        Row(
            f"solve time, {count}",
            *(1e3 * over, 1e3 * once, "ms", over / once),
            *("flat (within 25 %)", over <= 1.25 * once),
        ),
        Row(
            f"memory of filtering and compression, {len(longer.t)} against {len(long.t)} samples",
            *(memory[2], memory[1], "MB", memory[2] / memory[1]),
            *("flat (within 25 %)", memory[2] <= 1.25 * memory[1]),
            f"beyond the samples; {memory[0]:.3g} MB for {len(run.t)} (blocks not yet full triangles)",
        ),
    ]


def one_loss(task: Task, rows: np.ndarray) -> Row:
    """One penalised loss of the paper's method, against the residual of all rows."""
    box = barycentric_box(task)
    loss = PenalisedLoss(task, task.data, box, np.arange(len(task.bound)), box.p(task.ols))
    u = np.random.default_rng(0).uniform(size=len(task.bound))
    y, tau, theta = rows[:, :-1], rows[:, -1], task.ols

    def all_rows() -> None:
        residual = y @ theta - tau
        residual @ residual

    count = 2000
    ours = cpu(lambda: [loss.value(u, 10.0) for _ in range(count)], times=3) / count
    other = cpu(lambda: [all_rows() for _ in range(20)], times=3) / 20
    return Row(
        "one penalised loss, CPU", 1e6 * ours, 1e6 * other, "us", other / ours, "< 50 us", ours < 50e-6,
        "ours: loss, triangle inequalities, total mass; theirs: the loss alone on all rows",
    )  # fmt: skip


#: A small process that starts the command and reports on it: its own memory stays out of the figure.
_LAUNCH = """
import os, subprocess, sys, time
start = time.perf_counter()
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(child.pid, 0)
print(time.perf_counter() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e3, status)
"""


def process(command: list[str]) -> tuple[float, float, float]:
    """Wall time [s], processor time [s] and peak memory [MB] of a process, its bytecode in place."""
    env = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    result = subprocess.run(
        [sys.executable, "-c", _LAUNCH, *command], capture_output=True, text=True, env=env
    )
    wall, processor, memory, status = map(float, result.stdout.split())
    if status != 0:
        raise RuntimeError(f"{command[0]} failed: {result.stderr[-500:]}")
    return wall, processor, memory


def whole_process(problem: Problem, run: Measurements, python: str | None) -> list[Row]:
    """`identify` as a process against FIGAROH's script, both from the same RUN.csv (uniform 1 kHz)."""
    if python is None:
        return []
    grid = np.arange(run.t[0], run.t[-1], 0.001)
    q, tau = (np.column_stack([np.interp(grid, run.t, c) for c in x.T]) for x in (run.q, run.tau))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save(Measurements(grid, q, tau), folder / "run.csv")
        save(run, folder / "recorded.csv")
        export(identify(problem, run, METHOD), folder / "robot.urdf")
        ours = [sys.executable, "-m", "sdp_vs_penalty", "identify", problem.name]
        ours += ["--out", str(folder / "model.json"), "--data"]
        # The check would refuse what was resampled for FIGAROH, which has none.
        plain, checked = (
            [*ours, str(folder / "run.csv"), "--no-check"],
            [*ours, str(folder / "recorded.csv")],
        )
        theirs = [python, str(HERE / "figaroh_identify.py"), str(folder / "run.csv")]
        theirs += [str(folder / "robot.urdf"), "1000", str(folder / "figaroh.json")]
        process(plain)  # bytecode
        measured = [[process(command) for command in (plain, checked, theirs)] for _ in range(3)]
        accepted = '"accepted": true' in (folder / "figaroh.json").read_text()
    least = np.array(measured).min(axis=0)  # (3 programs, 3 figures)
    note = "FIGAROH 1.0.2 from PyPI, physical_fit, decimation by 10; it " + (
        "accepts its result" if accepted else "rejects its result"
    )
    rows = []
    for mine, how in ((0, "without the data check"), (1, "with the data check, run as recorded")):
        for k, (what, unit, most) in enumerate(
            (("wall", "s", 0.6), ("CPU", "s", 0.6), ("peak memory", "MB", least[2, 2]))
        ):
            used, other = float(least[mine, k]), float(least[2, k])
            rows.append(
                Row(f"whole identify process {how}, {what}", used, other, unit, other / used,
                    "<= 0.6 s" if unit == "s" else "less", bool(used <= most), note)
            )  # fmt: skip
    return rows


def text_and_loss(problem: Problem, folder: Path, run: Measurements) -> list[Row]:
    """From text to a certified estimate, and what follows from the naive way's rows."""
    solve_with_cvxpy(task_of(problem, run))  # imports and caches: "after import"
    identify(problem, run, METHOD)
    first, rows = from_text(problem, folder)
    task = task_of(problem, run)
    return [first, compressed(task), one_loss(task, rows)]
