"""Every figure of speed and memory, by one command.

    python results/benchmarks/run.py [--data DATA] [--only PART ...] [--rows N ...] [--out FOLDER]

DATA holds the measurements as `sdp-vs-penalty fetch` leaves them (its subfolder panda;
default: SDP_VS_PENALTY_DATA). N: rows of the recordings of the memory part. Each part
runs in a process of its own on one thread, figures are ratios within it; memory is a
command's peak beyond that of the same command on an input error (imports). Writes
benchmarks.csv and benchmarks.md; parts that are not measured this time keep what the
files there hold of them, with its date.
"""

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
import timeit
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from multiprocessing import get_context
from pathlib import Path

os.environ |= dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
if __name__ == "__main__":  # for this process and its workers
    sys.path[0] = str(Path(__file__).parents[1])

import numpy as np
import pandas
from benchmarks import decimated
from challenge.worlds.motion import plan
from challenge.worlds.runs import load_arm

from sdp_vs_penalty import (
    Estimate,
    cross_validate,
    identify,
    load_measurements,
    load_problem,
)
from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.estimation.build_problem import build_problem, read_and_filter
from sdp_vs_penalty.estimation.identify import (
    build_estimate,
    estimate_parameters,
    versions,
)
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.results.table import markdown_lines
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.shootout.instances import chain_task
from sdp_vs_penalty.signals.filtered import FilteredRun
from sdp_vs_penalty.signals.phases import phase_folds

#: Measured once, by scripts that left (the commit that had them): they stay in the
#: table.
LEFT = {
    "renewed": "49a864c1",
    "workers": "49a864c1",
    "solvers": "8fe364a0",
    "rivals": "ffa8cd7",
}
LEFT |= {"growth": "204ffd3f"}
NAMES = ["part", "what", "ours", "other", "unit", "ratio", "note", "when"]
#: One figure: what, ours, another way's beside it or None, unit, note.
Row = tuple[str, float, float | None, str, str]


def cpu(call: Callable[[], object], times: int = 1) -> float:
    """Least processor time of a call [s]."""
    return min(
        timeit.repeat(
            call,
            repeat=times,
            number=1,
            timer=time.process_time,
        )
    )


def text(problem: Problem, folder: Path) -> list[Row]:
    """Text files to an estimate against the decimated script, and both on motion not
    seen."""
    model = problem.robot._model
    basis = inertia.PSEUDO_INERTIA_BASIS
    warnings.simplefilter("ignore")  # the script's
    script = partial(decimated.identify, folder, model, basis)

    def ours() -> Estimate:
        runs = read_and_filter(problem, load_measurements(folder, joints=7))
        return estimate_parameters(problem, runs)

    def judged_too() -> Estimate:
        return identify(problem, load_measurements(folder, joints=7), check=False)

    estimate = ours()
    run = load_measurements(folder, joints=7)
    settings = problem.preprocessing.resolve(run)
    split = phase_folds(run, settings, 5)
    judged = FilteredRun(run, settings).all_rows(estimate.model)
    at = judged.motion
    cells = split.cell(0, judged.motion.t)
    t, q, tau = decimated.read(folder, 7)
    rows, torque = decimated.rows(model, q, tau)
    own_cells = split.cell(0, t[decimated.kept(len(t))])
    columns = decimated.columns(
        model,
        at.q,
        at.dq,
        at.ddq,
    )
    left = np.zeros_like(judged.torque)
    for k in range(split.count):
        train = np.isin(own_cells, split.training(k))
        tested = np.isin(cells, split.tested(k))
        theta = decimated.solve(rows[train], torque[train], basis)
        left[tested] = columns[tested] @ theta - judged.torque[tested]
    theirs = 100.0 * float(np.linalg.norm(left) / np.linalg.norm(judged.torque))
    error = cross_validate(problem, run).relative_error_percent
    note = (
        "neither checks the data; theirs: every 28th sample, Pinocchio, CVXPY; no"
        " certificate"
    )
    posed = build_problem(problem, run)
    method = LmiSdp()
    fit = method.fit(posed.task)
    again = partial(
        replace, posed.task
    )  # without what an earlier call has left in its cache
    spent = cpu(ours, 5)
    plain = "theirs: the rows as they are, not their R factor, to CVXPY"
    return [
        ("text files to estimate, CPU", spent, cpu(script, 5), "s", note),
        (
            "the same and its verdict on these data, CPU",
            cpu(judged_too, 5),
            cpu(script, 5),
            "s",
            "noise floor and error of each joint; theirs: as above, without",
        ),
        (
            "the same, rows to CVXPY, CPU",
            spent,
            cpu(partial(script, False), 3),
            "s",
            plain,
        ),
        (
            "its certificate, intervals and record of the motion, CPU",
            cpu(lambda: build_estimate(replace(posed, task=again()), method, fit), 5),
            cpu(lambda: method.fit(again()), 5),
            "s",
            "other: its SDP with the lower bound",
        ),
        (
            "the same, relative error on motion not seen",
            error,
            theirs,
            "%",
            "five folds by phase, 4 928 torques",
        ),
    ]


def fits(problem: Problem, run: Measurements) -> list[Row]:
    """Compressed data to a certified fit, by the default and by Clarabel in the same
    loop."""
    tasks = {"the measured Panda": build_problem(problem, run).task}
    tasks |= {f"{n} links": chain_task(n) for n in (7, 20, 60)}
    rows = []
    methods = (LmiSdp(), LmiSdp(solver="clarabel"))
    for name, task in tasks.items():
        times = 9 if len(task.bound) < 300 else 3
        gaps = [method.fit(task).gap for method in methods]
        spent = [
            1e3 * cpu(lambda m=m, task=task: m.fit(task).gap, times) for m in methods
        ]
        note = (
            f"certified gaps {gaps[0]:.0e} and {gaps[1]:.0e} of the loss; other:"
            " Clarabel"
        )
        rows.append((f"certified fit, {name}, CPU", *spent, "ms", note))
    return rows


PROGRAM = [sys.executable, "-m", "sdp_vs_penalty"]
#: Run by a small process: a child's peak begins with the memory of the process that
#: starts it.
_WORK = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0)
"""


def measured(command: list[str]) -> tuple[float, ...]:
    """Processor time [s] and peak memory [MB] of a process on one thread."""
    env = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    around = [sys.executable, "-c", _WORK, *command]
    done = subprocess.run(
        around,
        env=env,
        check=True,
        capture_output=True,
        text=True,
    )
    return tuple(map(float, done.stdout.split()))


def processes(problem: Problem, run: Measurements) -> list[Row]:
    """Commands as processes against importing NumPy and SciPy."""
    with tempfile.TemporaryDirectory() as name:
        log = str(Path(name, "run.csv"))
        model = str(Path(name, "model.json"))
        out = str(Path(name, "report.html"))
        save(run, Path(log))
        identified = [
            *PROGRAM,
            "identify",
            problem.name,
            "--data",
            log,
            "--out",
            model,
        ]
        bare = [sys.executable, "-c", "import numpy, scipy.linalg, scipy.signal"]
        commands = {
            "bare": bare,
            "identify without the check": [*identified, "--no-check"],
            "identify": identified,
            "report": [*PROGRAM, "report", model, "--data", log, "--out", out],
        }
        # In turn; the first for bytecode.
        used = np.array(
            [[measured(command)[0] for command in commands.values()] for _ in range(4)]
        )
    least = used[1:].min(axis=0).tolist()
    note = f"other: a process that does `{bare[2]}`"
    pairs = list(zip(commands, least, strict=True))[1:]
    return [(f"{key} as a process, CPU", x, least[0], "s", note) for key, x in pairs]


def recorded(path: Path, rows: int, model: Estimate) -> None:
    """A recording as CSV, a part at a time: a Panda at 1 kHz on a motion that never
    comes back; its torque is a model's, with a Stribeck friction that this lacks and
    white noise."""
    rng = np.random.default_rng(5)
    n = 7
    part = 50_000
    noise = np.array([0.15, 0.2, 0.15, 0.15, 0.08, 0.08, 0.06])  # N m
    states = plan(load_arm("panda"), "aperiodic", rows / 1000.0, rng)
    with path.open("w") as file:
        file.write(
            ",".join(["t", *(f"{x}{j + 1}" for x in ("q", "tau") for j in range(n))])
            + "\n"
        )
        for start in range(0, rows, part):
            t = np.arange(start, min(rows, start + part)) / 1000.0
            q, dq, ddq = states(t)
            tau = model.predict(q, dq, ddq)
            tau[:, 3] += (
                0.8 * np.exp(-((dq[:, 3] / 0.05) ** 2)) * np.tanh(dq[:, 3] / 0.005)
            )
            q, tau = (
                q + rng.normal(0.0, 2e-5, q.shape),
                tau + rng.normal(size=q.shape) * noise,
            )
            np.savetxt(
                file,
                np.column_stack([t, q, tau]),
                ["%.3f"] + ["%.6f"] * n + ["%.4f"] * n,
                ",",
            )


def memory(
    problem: Problem,
    run: Measurements,
    counts: Sequence[int],
) -> list[Row]:
    """Processor seconds and peak memory of whole commands on recordings of so many rows
    at 1 kHz."""
    rows = []
    with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
        true = identify(problem, run, check=False)
        true.save(Path(folder, "model.json"))
        log = str(Path(folder, "run.csv"))
        model = str(Path(folder, "model.json"))
        out = str(Path(folder, "out.json"))
        commands = {
            "identify": ["identify", "panda", "--data", log, "--out", out],
            "check": ["check", "panda", "--data", log],
            "compare": ["compare", model, "--data", log],
            "convert": ["convert", log, "--out", out.replace(".json", ".npz")],
            "diagnose": ["diagnose", model, "--data", log],
        }
        imports = {
            verb: measured([*PROGRAM, *words])[1] for verb, words in commands.items()
        }
        for count in counts:
            recorded(Path(log), count, true)
            for verb, words in commands.items():
                seconds, most = measured([*PROGRAM, *words])
                note = f"peak memory {most - imports[verb]:.0f} MB beyond imports"
                rows.append((f"{verb}, {count} rows", seconds, None, "s", note))
    return rows


PARTS = {part.__name__: part for part in (text, fits, processes, memory)}


def measure(
    part: str,
    data: Path,
    counts: Sequence[int],
) -> pandas.DataFrame:
    """Rows of the table."""
    run = load_measurements(folder := data / "panda", joints=7)
    more = {"text": (folder,), "memory": (run, counts)}.get(part, (run,))
    rows = PARTS[part](load_problem("panda"), *more)
    found = pandas.DataFrame(rows, columns=["what", "ours", "other", "unit", "note"])
    used = " ".join(f"{name} {version}" for name, version in versions().items())
    when = f"{datetime.now(UTC):%Y-%m-%d %H:%M}, load {os.getloadavg()[0]:.0f}, {used}"
    return found.assign(
        part=part,
        ratio=found["other"].astype(float) / found["ours"],
        when=when,
    )[NAMES]


def main() -> None:
    parser = argparse.ArgumentParser(usage=__doc__)
    data = os.environ.get("SDP_VS_PENALTY_DATA")
    parser.add_argument(
        "--data",
        type=Path,
        default=data,
        required=data is None,
    )
    parser.add_argument(
        "--only",
        nargs="+",
        choices=PARTS,
        default=list(PARTS),
    )
    parser.add_argument(
        "--rows",
        type=int,
        nargs="+",
        default=[100_000, 1_000_000],
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path(__file__).parent,
    )
    given = parser.parse_args()
    work = partial(
        measure,
        data=Path(given.data),
        counts=given.rows,
    )
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool:
        write(given.out, list(pool.map(work, given.only)))


def write(out: Path, tables: list[pandas.DataFrame]) -> None:
    """Both files, of what was measured now and of what they hold of other parts."""
    new = [
        t.map(lambda x: f"{x:.3g}" if isinstance(x, float) else x).fillna("")
        for t in tables
    ]
    if (table := out / "benchmarks.csv").exists():
        old = pandas.read_csv(table, dtype=str, keep_default_na=False)
        new.append(old[~old["part"].isin([part for t in tables for part in t["part"]])])
    order = [*PARTS, *LEFT]
    cells = pandas.concat(new).replace("nan", "")
    cells = cells.sort_values(
        "part",
        key=lambda x: x.map(order.index),
        kind="stable",
    )
    write_text(table, cells.to_csv(index=False, lineterminator="\n"))
    left = ", ".join(
        f"{part} by one of commit {commit}" for part, commit in LEFT.items()
    )
    about = (
        "Panda, the authors' run of 20 544 samples; ratios are within one process or"
        f" in turn, by `python results/benchmarks/run.py` ({platform.machine()}, one thread)."
        f" By scripts that are no longer here: {left}."
    )
    text = [
        "# Speed and memory",
        "",
        about,
        "",
        *markdown_lines(NAMES, cells.to_numpy().tolist()),
        "",
    ]
    write_text(out / "benchmarks.md", "\n".join(text))
    print("\n".join(text))


if __name__ == "__main__":
    main()
