"""What things cost: this program's way and another one, measured in one process or one run.

Parts of `benchmarks/run.py`, which says how they are started and writes what they return.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bootstrap
import decimated
import numpy as np

from sdp_vs_penalty import Estimate, cross_validate, identify, load_measurements
from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators import make_estimator
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp, PosedSdp, essential, sample_variance
from sdp_vs_penalty.estimators.task import joint_weights, make_task
from sdp_vs_penalty.exporters.export import export
from sdp_vs_penalty.parallel import Workers
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import LeastSquares, compress
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.shootout import regular
from sdp_vs_penalty.shootout.contestants import contestants
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.signals.phases import phase_folds
from sdp_vs_penalty.signals.preprocessing import filtered_torque
from sdp_vs_penalty.solvers.objective import Objective

METHOD = "lmi-sdp"
HERE = Path(__file__).parent


@dataclass(frozen=True)
class Row:
    """One comparison: other / ours is the ratio."""

    what: str
    ours: float
    other: float
    unit: str
    note: str = ""


def cpu(call: Callable[[], object], times: int = 1) -> float:
    """Least processor time of a call [s]."""
    best = np.inf
    for _ in range(times):
        start = time.process_time()
        call()
        best = min(best, time.process_time() - start)
    return best


def peak(call: Callable[[], object]) -> float:
    """Memory that a call needs at most beyond what was there before [MB]."""
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    call()
    highest = tracemalloc.get_traced_memory()[1] - before
    tracemalloc.stop()
    return highest / 1e6


def text(problem: Problem, folder: Path) -> list[Row]:
    """Text files to an estimate against the decimated script, and both on motion not seen."""
    model, basis = problem.robot._model, inertia.PSEUDO_INERTIA_BASIS

    def script() -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            decimated.identify(folder, model, basis)

    def ours() -> Estimate:
        return identify(problem, load_measurements(folder, joints=7), METHOD)

    estimate, run = ours(), load_measurements(folder, joints=7)
    settings = problem.preprocessing.resolve(run)
    split = phase_folds(run, settings, 5)
    judged = filtered_torque(run, estimate.model, settings)
    at, cells = judged.motion, split.cell(0, judged.motion.t)
    t, q, tau = decimated.read(folder, 7)
    rows, torque = decimated.rows(model, q, tau)
    own_cells = split.cell(0, t[decimated.kept(len(t))])
    columns = decimated.columns(model, at.q, at.dq, at.ddq)
    wrong = total = 0.0
    for k in range(split.count):
        train, tested = np.isin(own_cells, split.training(k)), np.isin(cells, split.tested(k))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            theta = decimated.solve(rows[train], torque[train], basis)
        wrong += float(np.sum((columns[tested] @ theta - judged.torque[tested]) ** 2))
        total += float(np.sum(judged.torque[tested] ** 2))
    error = cross_validate(problem, run, METHOD).relative_error_percent
    note = "theirs: filter, every 28th sample, Pinocchio, CVXPY with Clarabel; no bounds, no certificate"
    return [
        Row("text files to estimate, CPU", cpu(ours, 5), cpu(script, 5), "s", note),
        Row("the same, relative error on motion not seen", error, 100.0 * np.sqrt(wrong / total), "%",
            "five folds by phase, 4 928 torques"),
    ]  # fmt: skip


def task_of(problem: Problem, measurements: Measurements) -> Task:
    model = problem.model()
    settings = problem.preprocessing.resolve(measurements)
    return make_task(problem, model, compress(measurements, model, settings))


def fits(problem: Problem, run: Measurements) -> list[Row]:
    """Compressed data to a certified fit, by the default and by Clarabel in the same loop."""
    tasks = {"the measured Panda": task_of(problem, run)}
    tasks |= {f"{n} links": regular.chain_task(n) for n in (7, 20, 60)}
    rows = []
    for name, task in tasks.items():
        times = 9 if len(task.bound) < 300 else 3
        gaps, spent = [], []
        for solver in (None, "clarabel"):
            method = LmiSdp(solver=solver)
            gaps.append(method.fit(task).gap)
            spent.append(1e3 * cpu(lambda method=method, task=task: method.fit(task).gap, times))  # type: ignore[misc]
        note = f"certified gaps {gaps[0]:.0e} and {gaps[1]:.0e} of the loss; other: Clarabel"
        rows.append(Row(f"certified fit, {name}, CPU", *spent, "ms", note))
    task = tasks["60 links"]
    memory = [peak(lambda s=s: LmiSdp(solver=s).fit(task)) for s in (None, "clarabel")]  # type: ignore[misc]
    return [
        *rows,
        Row("certified fit, 60 links, memory beyond the data", *memory, "MB", "other: Clarabel"),
    ]


def renewed(problem: Problem, run: Measurements, draws: int = 200) -> list[Row]:
    """A fit to similar data from the last one's central path, and a certified draw of a bootstrap."""
    model = problem.model()
    regression = compress(run, model, problem.preprocessing.resolve(run))
    weights = joint_weights(regression, make_task(problem, model, regression, "none").ols)
    task = make_task(problem, model, regression)
    blocks = bootstrap.block_data(regression, weights)
    objective, constraints = LmiSdp().posed(task)
    posed = PosedSdp.of(task, objective, constraints)
    last, prior = posed.fit(objective), sample_variance(task)
    spent: tuple[list[float], list[float]] = ([], [])
    for k in range(40):
        data = bootstrap.joined(blocks, bootstrap.draw_counts(len(blocks), k, 0))
        assert task.joint_scale is not None
        again = Objective(data.with_prior(task.joint_scale, prior), objective.entropy)
        for own, near in zip(spent, (last, None), strict=True):
            own.append(1e3 * cpu(lambda near=near, again=again: posed.fit(again, 1e-9, near).gap))  # type: ignore[misc]
    instance = regular.posed("panda", task, "one-step", "gyration")
    start = time.process_time()
    found = bootstrap.bootstrap(instance.task, blocks, draws, 0)
    ours = 1e3 * (time.process_time() - start) / draws
    few = max(draws // 20, 5)
    datas = [bootstrap.joined(blocks, bootstrap.draw_counts(len(blocks), k, 0)) for k in range(few)]
    other = 1e3 * cpu(lambda: [fresh_cvxpy(instance, data) for data in datas]) / few
    return [
        Row("renewed certified fit, CPU", float(np.median(spent[0])), float(np.median(spent[1])), "ms",
            "from the last fit; other: from the nominal robot"),
        Row("bootstrap, a certified draw, CPU", ours, other, "ms",
            f"{draws} draws, largest certified gap {found.gap.max():.0e}, {found.again} by Clarabel; "
            "other: a fresh CVXPY problem each, none certified"),
    ]  # fmt: skip


def fresh_cvxpy(instance: Instance, data: LeastSquares) -> str:
    """The same problem as a user writes it, a new CVXPY problem each time, solved by Clarabel."""
    import cvxpy as cp

    theta = cp.Variable(data.R.shape[1])
    demands = []
    for c in essential(instance.constraints, instance.objective):
        flat = c.coefficients.reshape(len(c.indices), -1).T @ theta[c.indices] + c.constant.ravel()
        if c.cone == "psd":
            demands.append(cp.reshape(flat, c.constant.shape, order="C") >> 0)
        elif c.cone == "soc":
            demands.append(cp.SOC(flat[0], flat[1:]))
        else:
            demands.append(flat >= 0)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(data.R @ theta - data.rho)), demands)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        problem.solve(solver=cp.CLARABEL)
    return str(problem.status)


def solvers(problem: Problem, run: Measurements) -> list[Row]:
    """One problem, every installed solver, each asked for 1e-8: time and what its answer proves."""
    instance = regular.posed("panda", task_of(problem, run), "one-step", "gyration")
    fit = make_estimator("lmi-sdp-thickness").fit
    ours = 1e3 * cpu(lambda: fit(instance.task).gap, 9)
    rows = []
    for name, contestant in contestants().items():
        if contestant.absent or not contestant.tunable:
            continue
        try:
            answer = contestant.solve(instance, 1e-8)
            spent = 1e3 * cpu(lambda c=contestant: c.solve(instance, 1e-8), 3)  # type: ignore[misc]
            assert answer.multipliers is not None
            lower = instance.lower_bound(answer.theta, answer.multipliers, answer.entropy_slopes)
        except (InputError, AssertionError, ValueError, np.linalg.LinAlgError):
            continue
        gap = instance.data.gap(instance.data.loss(answer.theta), lower, answer.theta)
        worst = max(instance.constraints.worst(answer.theta).values())
        note = f"{answer.claims}; gap {gap:.0e} of the loss, violation {worst:.0e}"
        rows.append(Row(f"Panda, minimum thickness, beside {name}, CPU", ours, spent, "ms", note))
    return rows


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


def processes(problem: Problem, run: Measurements, figaroh: str | None) -> list[Row]:
    """Commands as processes against importing NumPy and SciPy, and against FIGAROH's script."""
    with tempfile.TemporaryDirectory() as name:
        log, model, out = (str(Path(name, x)) for x in ("run.csv", "model.json", "report.html"))
        save(run, Path(log))
        ours = [sys.executable, "-m", "sdp_vs_penalty"]
        identified = [*ours, "identify", problem.name, "--data", log, "--out", model]
        commands = {
            "bare": [sys.executable, "-c", "import numpy, scipy.linalg, scipy.signal"],
            "identify without the check": [*identified, "--no-check"],
            "identify": identified,
            "report": [*ours, "report", model, "--data", log, "--out", out],
        }
        for command in commands.values():
            process(command)  # bytecode
        used = {key: [] for key in commands}  # type: dict[str, list[tuple[float, float, float]]]
        for _ in range(3):  # in turn
            for key, command in commands.items():
                used[key].append(process(command))
        least = {key: np.array(values).min(axis=0) for key, values in used.items()}
        bare = "other: a process that imports numpy, scipy.linalg and scipy.signal"
        rows = [
            Row(f"{key} as a process, CPU", float(least[key][1]), float(least["bare"][1]), "s", bare)
            for key in commands
            if key != "bare"
        ]
        if figaroh is None:
            return rows
        grid = np.arange(run.t[0], run.t[-1], 0.001)
        q, tau = (np.column_stack([np.interp(grid, run.t, c) for c in x.T]) for x in (run.q, run.tau))
        save(Measurements(grid, q, tau), Path(log))
        export(identify(problem, run, METHOD), Path(name, "robot.urdf"))
        script = [figaroh, str(HERE / "figaroh_identify.py"), log, str(Path(name, "robot.urdf")), "1000"]
        theirs = min(process([*script, str(Path(name, "out.json"))]) for _ in range(3))
    note = "FIGAROH 1.0.2, physical_fit, decimation by 10"
    mine = least["identify without the check"]
    return [
        *rows,
        Row("identify without the check beside FIGAROH, CPU", float(mine[1]), theirs[1], "s", note),
        Row(
            "identify without the check beside FIGAROH, peak memory",
            float(mine[2]),
            theirs[2],
            "MB",
            note,
        ),
    ]


def workers(problem: Problem, run: Measurements) -> list[Row]:
    """Cross-validation by two processes against one: wall time."""
    spent = []
    for jobs in (2, 1):
        start = time.perf_counter()
        cross_validate(problem, run, METHOD, workers=Workers(jobs))
        spent.append(time.perf_counter() - start)
    return [
        Row(
            "cross-validate by two processes against one, wall",
            *spent,
            "s",
            f"load {os.getloadavg()[0]:.0f}",
        )
    ]
