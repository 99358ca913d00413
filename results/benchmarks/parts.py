"""What is measured of the program itself: fits, commands, memory, two processes, a loop."""

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from picks.pick_runs import simulated_update_times

from benchmarks.recording import write_recording
from benchmarks.timing import BARE, PROGRAM, Figure, in_turn, run_process
from sdp_vs_penalty import identify, load_measurements, load_problem
from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.estimation.build_problem import build_problem
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.problem import measured_runs
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.shootout.instances import chain_task

#: Names of two UR10e runs, and the seconds of each that a diagnosis gets.
UR10E_RUNS = ("ur-20_02_19_15harm50sec", "ur-20_02_19_14harm50sec")
UR10E_SECONDS = 20.0


@dataclass(frozen=True)
class Inputs:
    """What the parts work on.

    data : folder that holds panda and ur10e; counts : rows of the recordings of the
    memory part; repeats : pairs of each figure; rivals : Python of an environment with
    `figaroh`, `mujoco[sysid]` and `scikit-learn`, or None.
    """

    data: Path
    counts: Sequence[int]
    repeats: int
    rivals: str | None

    @cached_property
    def problem(self) -> Problem:
        """The Panda's problem."""
        return load_problem("panda")

    @cached_property
    def run(self) -> Measurements:
        """The Panda's run, 20 544 samples."""
        return load_measurements(self.data / "panda", joints=7)


def fits(inputs: Inputs) -> list[Figure]:
    """Compressed data to a certified fit, by the default solver and by Clarabel."""
    tasks = {"the measured Panda": build_problem(inputs.problem, inputs.run).task}
    tasks |= {f"{n} links": chain_task(n) for n in (7, 20, 60)}
    ours, clarabel = LmiSdp(), LmiSdp(solver="clarabel")
    rows = []
    for name, task in tasks.items():
        repeats = inputs.repeats if len(task.bound) < 300 else 3
        gaps = [method.fit(task).gap for method in (ours, clarabel)]
        # A copy has nothing of what an earlier call has left in its cache.
        pairs = in_turn(
            lambda task=task: ours.fit(replace(task)),
            lambda task=task: clarabel.fit(replace(task)),
            repeats,
            scale=1e3,
        )
        note = (
            f"other: Clarabel; certified gaps {gaps[0]:.0e}, {gaps[1]:.0e} of the loss"
        )
        rows.append(Figure.of_pairs(f"certified fit, {name}", pairs, "ms", note))
    return rows


def commands(inputs: Inputs) -> list[Figure]:
    """Commands as processes, beside one that only imports NumPy and SciPy."""
    with tempfile.TemporaryDirectory() as folder:
        log = str(Path(folder, "run.csv"))
        model = str(Path(folder, "model.json"))
        save(inputs.run, Path(log))
        identified = ["identify", "panda", "--data", log, "--out", model]
        verbs = {
            "identify --no-check": [*identified, "--no-check"],
            "identify": identified,
            "check": ["check", "panda", "--data", log],
            "compare": ["compare", model, "--data", log],
            "report": [
                "report",
                model,
                "--data",
                log,
                "--out",
                f"{folder}/report.html",
            ],
            "convert": ["convert", log, "--out", f"{folder}/run.npz"],
            "demo": ["demo", "--out", f"{folder}/demo"],
        }
        return _beside_import(verbs, inputs.repeats)


def long_commands(inputs: Inputs) -> list[Figure]:
    """Commands of many seconds, with nothing kept from an earlier run."""
    with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
        os.environ["SDP_VS_PENALTY_CACHE"] = str(Path(folder, "cache"))
        panda = str(Path(folder, "panda.csv"))
        panda_model = str(Path(folder, "panda.json"))
        save(inputs.run, Path(panda))
        run_process(
            [*PROGRAM, "identify", "panda", "--data", panda, "--out", panda_model]
        )
        ur10e, ur10e_model = _ur10e_model(inputs.data, Path(folder))

        def into(name: str) -> list[str]:
            return ["--jobs", "1", "--out", str(Path(folder, name))]

        verbs = {
            "diagnose, the Panda's whole run": [
                "diagnose", panda_model, "--data", panda,
            ],
            "diagnose, UR10e, two runs of 20 s": [
                "diagnose", ur10e_model, "--data", *ur10e,
            ],
            "tables III IV VIII IX": ["tables", *into("tables")],
            "figures": ["figures", *into("figures")],
            "shootout --quick": ["shootout", "--quick", *into("shootout")],
        }  # fmt: skip
        return _beside_import(verbs, 1)


def _ur10e_model(data: Path, folder: Path) -> tuple[list[str], str]:
    """Write two runs of the UR10e and a model of them."""
    os.environ["SDP_VS_PENALTY_DATA"] = str(data)
    runs = {run.names[0]: run for run in measured_runs("ur10e").values()}
    files = []
    for name in UR10E_RUNS:
        run = next(run for key, run in runs.items() if key.endswith(name))
        file = folder / f"{name}.csv"
        save(run.window(0.0, UR10E_SECONDS), file)
        files.append(str(file))
    model = str(folder / "ur10e.json")
    run_process([*PROGRAM, "identify", "ur10e", "--data", *files, "--out", model])
    return files, model


def _beside_import(verbs: dict[str, list[str]], repeats: int) -> list[Figure]:
    """Processor time of commands beside that of the bare imports, in turn."""
    if repeats > 1:  # the first makes bytecode
        for words in verbs.values():
            run_process([*PROGRAM, *words])
    run_process(BARE)
    used: dict[str, list[tuple[float, float]]] = {what: [] for what in verbs}
    memory: dict[str, float] = {}
    for _ in range(repeats):
        for what, words in verbs.items():
            bare = run_process(BARE)
            usage = run_process([*PROGRAM, *words])
            used[what].append((usage.processor, bare.processor))
            memory[what] = max(memory.get(what, 0.0), usage.memory)
    return [
        Figure.of_pairs(
            what,
            np.array(pairs),
            "s",
            f"other: a process that does `{BARE[2]}`; peak {memory[what]:.0f} MB",
        )
        for what, pairs in used.items()
    ]


def jobs(inputs: Inputs) -> list[Figure]:
    """Time on the wall by two processes and by one."""
    with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
        log = str(Path(folder, "run.csv"))
        save(inputs.run, Path(log))

        def command(what: str, count: int) -> list[str]:
            out = ["--jobs", str(count), "--out", str(Path(folder, f"{what}{count}"))]
            words = {
                "cross-validate, the penalty": [
                    "cross-validate", "panda", "--data", log, "--folds", "20",
                    "--method", "penalty", "--jobs", str(count),
                ],
                "tables III IV VIII IX": ["tables", *out],
                "shootout --quick": ["shootout", "--quick", *out],
            }[what]  # fmt: skip
            return [*PROGRAM, *words]

        rows = []
        for what in (
            "cross-validate, the penalty",
            "tables III IV VIII IX",
            "shootout --quick",
        ):
            wall = []
            for count in (2, 1):
                os.environ["SDP_VS_PENALTY_CACHE"] = str(Path(folder, f"cache{count}"))
                wall.append(run_process(command(what, count)).wall)
            pairs = np.array([wall])
            note = "wall; other: by one process"
            rows.append(Figure.of_pairs(f"{what}, two processes", pairs, "s", note))
        return rows


def memory(inputs: Inputs) -> list[Figure]:
    """Processor time of commands on recordings at 1 kHz; and their memory beyond imports,
    once of their own and once with the pages of files that they have read."""
    rows = []
    with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
        model = Path(folder, "model.json")
        estimate = identify(inputs.problem, inputs.run, check=False)
        estimate.save(model)
        log = Path(folder, "run.csv")
        out = Path(folder, "out")
        verbs = {
            "identify": [
                "identify",
                "panda",
                "--data",
                str(log),
                "--out",
                f"{out}.json",
            ],
            "check": ["check", "panda", "--data", str(log)],
            "compare": ["compare", str(model), "--data", str(log)],
            "convert": ["convert", str(log), "--out", f"{out}.npz"],
            "report": [
                "report",
                str(model),
                "--data",
                str(log),
                "--out",
                f"{out}.html",
            ],
            "diagnose": ["diagnose", str(model), "--data", str(log)],
        }
        # On a file that is missing: imports alone.
        imports = {
            verb: run_process([*PROGRAM, *words], may_fail=True)
            for verb, words in verbs.items()
        }
        for count in inputs.counts:
            write_recording(log, count, estimate)
            for verb, words in verbs.items():
                used = run_process([*PROGRAM, *words])
                what = f"{verb}, {count} rows"
                resident = used.memory - imports[verb].memory
                note = "other: peak of resident memory beyond imports [MB]"
                rows.append(Figure.single(what, used.processor, "s", note, resident))
                own = used.own - imports[verb].own
                note = "peak beyond imports; other: resident, with pages of files"
                own_row = Figure.single(
                    f"{what}, own memory", own, "MB", note, resident
                )
                rows.append(own_row)
    return rows


def loop(inputs: Inputs) -> list[Figure]:
    """A payload's update in a control loop at 1 kHz: median, and the 99th percentile."""
    estimate = identify(inputs.problem, inputs.run, check=False)
    times = simulated_update_times(estimate)
    median, late = np.percentile(times[..., 200:], [50, 99])
    note = "other: the 99th percentile; mass, centre, inertia and friction drift"
    return [Figure.single("payload update", median, "µs", note, late)]


PARTS = {
    "fits": fits,
    "commands": commands,
    "long_commands": long_commands,
    "jobs": jobs,
    "memory": memory,
    "loop": loop,
}
