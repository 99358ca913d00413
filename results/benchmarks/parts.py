"""What is measured of the program itself: fits, commands, memory, two processes, a loop."""

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from picks.pick_runs import simulated_update_times

from benchmarks.recording import write_recording
from benchmarks.timing import BARE, PROGRAM, Figure, in_turn, run_process
from sdp_vs_penalty import identify, load_measurements, load_problem
from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.estimation.build_problem import build_problem
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.problem import measured_runs
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.shootout.contestants import solve_by_default, solve_cvxpy
from sdp_vs_penalty.shootout.instances import Instance, chain_task
from sdp_vs_penalty.shootout.judge import Answer

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


def after(inputs: Inputs) -> list[Figure]:
    """Commands on a model that was checked and diagnosed, beside the same on one that
    was made by `identify --no-check`: what is kept between commands, in turn."""
    rows = []
    with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
        ur10e, _ = _ur10e_model(inputs.data, Path(folder))
        panda = str(Path(folder, "panda.csv"))
        save(inputs.run, Path(panda))
        for robot, files in (("panda", [panda]), ("ur10e", ur10e)):
            used = _kept_and_alone(robot, files, folder, min(inputs.repeats, 3))
            note = "other: of a model by `identify --no-check`, with nothing kept"
            rows += [
                Figure.of_pairs(f"{verb}, {robot}", np.array(pairs), "s", note)
                for verb, pairs in used.items()
            ]
    return rows


def _kept_and_alone(
    robot: str, files: list[str], folder: str, repeats: int
) -> dict[str, list[tuple[float, float]]]:
    """Return pairs of processor times of diagnose and report: after `identify`, and with
    nothing kept."""
    data = ["--data", *files]
    models = {"kept": [], "alone": ["--no-check"]}
    for name, words in models.items():
        out = f"{folder}/{robot}_{name}.json"
        run_process([*PROGRAM, "identify", robot, *data, "--out", out, *words])

    def used(verb: str, name: str) -> float:
        model = f"{folder}/{robot}_{name}.json"
        found = f"{folder}/{robot}_{name}_findings.json"
        words = {
            "diagnose": ["diagnose", model, *data, "--json", found],
            "report": [
                "report", model, *data, "--out", f"{folder}/report.html",
                *(["--findings", found] if name == "kept" else []),
            ],
        }[verb]  # fmt: skip
        return run_process([*PROGRAM, *words]).processor

    pairs: dict[str, list[tuple[float, float]]] = {}
    for _ in range(repeats):
        for verb, what in (
            ("diagnose", "diagnose after identify"),
            ("report", "report after identify and diagnose"),
        ):
            pair = used(verb, "kept"), used(verb, "alone")
            pairs.setdefault(what, []).append(pair)
    return pairs


#: Work for several processes: words of the command, without how many.
SHARED_WORK = {
    "cross-validate, the penalty": [
        "cross-validate", "panda", "--folds", "20", "--method", "penalty",
    ],
    "cross-validate, the penalty, 80 folds": [
        "cross-validate", "panda", "--folds", "80", "--method", "penalty",
    ],
    "Monte Carlo of methods": ["tables", "monte_carlo"],
    "tables III IV VIII IX": ["tables"],
    "shootout --quick": ["shootout", "--quick"],
}  # fmt: skip
#: Of these what is also given to a cluster.
WORK_OF_CLUSTERS = ("cross-validate, the penalty, 80 folds", "Monte Carlo of methods")


def jobs(inputs: Inputs) -> list[Figure]:
    """Time on the wall by two processes and by one; also by two workers of Dask."""
    rows = []
    with tempfile.TemporaryDirectory(dir="/var/tmp") as folder, _dask() as address:
        log = str(Path(folder, "run.csv"))
        save(inputs.run, Path(log))

        def wall(what: str, way: str) -> float:
            words = [*PROGRAM, *SHARED_WORK[what]]
            if what.startswith("cross-validate"):
                words += ["--data", log]
            else:
                words += ["--out", str(Path(folder, f"{what}{way}"))]
            workers = {"one": "--jobs=1", "two": "--jobs=2"}
            words.append(workers.get(way, f"--scheduler={address}"))
            os.environ["SDP_VS_PENALTY_CACHE"] = str(Path(folder, f"{what}{way} kept"))
            return run_process(words).wall

        for what in SHARED_WORK:
            alone = wall(what, "one")
            ways = {"two": "two processes"}
            if address is not None and what in WORK_OF_CLUSTERS:
                ways["dask"] = "two workers of Dask"
            for way, by in ways.items():
                pairs = np.array([[wall(what, way), alone]])
                note = "wall; other: by one process"
                rows.append(Figure.of_pairs(f"{what}, {by}", pairs, "s", note))
    return rows


@contextmanager
def _dask() -> Iterator[str | None]:
    """The address of two workers of Dask on this computer; None where it is not
    installed."""
    try:
        from distributed import LocalCluster
    except ImportError:
        yield None
        return
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


def links(inputs: Inputs) -> list[Figure]:
    """Compressed data to a solution: of chains, beside CVXPY with Clarabel."""
    rows = []
    for n in (7, 20, 40, 60):
        task = chain_task(n)

        def solve(by: Callable[[Instance], Answer], task: Task = task) -> Answer:
            return by(Instance(replace(task)))  # nothing of an earlier call's cache

        answers = [solve(by) for by in (_by_default, _by_cvxpy)]
        losses = [task.data.loss(answer.theta) for answer in answers]
        pairs = in_turn(
            partial(solve, _by_default), partial(solve, _by_cvxpy), 3 if n < 30 else 1
        )
        note = (
            f"other: CVXPY with Clarabel; its loss {losses[1] / losses[0] - 1.0:+.0e}"
        )
        rows.append(Figure.of_pairs(f"certified fit, {n} links", pairs, "s", note))
    return rows


def _by_default(instance: Instance) -> Answer:
    """Solve an instance by the default method, with its certificate."""
    return solve_by_default(instance, LmiSdp.accuracy)


def _by_cvxpy(instance: Instance) -> Answer:
    """Solve an instance by CVXPY's formulas with Clarabel."""
    return solve_cvxpy(instance, LmiSdp.accuracy, "CLARABEL")


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
    "links": links,
    "after": after,
    "jobs": jobs,
    "memory": memory,
    "loop": loop,
}
