"""Jobs about runs: read, made, checked, repaired; and what another job gets of them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.checks import check
from sdp_vs_penalty.data.cli_parsing import pairs
from sdp_vs_penalty.data.datasets import DATASETS, cache_folder
from sdp_vs_penalty.data.files import check_usable, load_measurements, save, windowed
from sdp_vs_penalty.data.measurements import Measurements, Runs, concatenate
from sdp_vs_penalty.errors import InputError, Remark, other_robot
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.page.options import number
from sdp_vs_penalty.page.summary import placed, save_arrays
from sdp_vs_penalty.problem.convert import convert
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.problem.published import real_data_folder
from sdp_vs_penalty.reports.plots import POINTS
from sdp_vs_penalty.signals.phases import filter_reach, motion_clocks, phase_windows, tracks_of
from sdp_vs_penalty.simulation.hidden_runs import RUN_FILES, hidden_runs

#: Share of a run that is identified from where the rest of it is kept for testing.
SPLIT = 0.7
#: What the page shows of a finding of the check.
_SHOWN = ("severity", "kind", "where", "what", "remedy", "mends", "gravity")
Request = Mapping[str, Any]
Answer = dict[str, Any]
Progress = Callable[[str], None]


def real_files(name: str) -> list[Path]:
    """Runs of a data set that `fetch` has left in the cache, or in the folder that is named."""
    for root in (real_data_folder(), cache_folder()):
        if root is None:
            continue
        runs = sorted((root / name / "runs").glob("*.csv"))
        if runs:
            return runs
        if (root / name / "exciting_traj_time.txt").is_file():
            return [root / name]
    return []


def read(request: Request, progress: Progress) -> Answer:
    """files : {path, name} of each; those that can be used become runs, the others a sentence each."""
    problem = problem_of(request)
    hashes = {run["hash"]: run["name"] for run in request["runs"]}
    runs, refused, remarks = [], [], []
    for file in request["files"]:
        progress(f"reading {file['name']}")
        path = Path(file["path"])
        try:
            with warnings.catch_warnings(record=True) as heard:
                warnings.simplefilter("always", Remark)
                part = _loaded(problem, path, request.get("options", {}))
            said = (str(w.message) for w in heard if w.category is Remark)
            remarks += [text.replace(str(path), file["name"]) for text in said]
            twin = hashes.get(part.data_hash)
            if twin is not None:
                raise InputError(f"holds the same samples as {twin}", "name each run once", path)
            progress(f"checking {file['name']}")
            run = keep(problem, part, Path(request["folder"]), file["name"])
            run["given"] = file.get("given", file["name"])
        except InputError as error:
            refused.append(str(error).replace(str(path), file["name"]))
            continue
        hashes[run["hash"]] = run["name"]
        runs.append(run)
    return {"runs": runs, "refused": refused, "remarks": remarks}


def _loaded(problem: Problem, path: Path, options: Mapping[str, str]) -> Measurements:
    """A run; by the options of `convert` where any is given."""
    if not options:
        return load_measurements(path, joints=problem.robot.n, names=problem.robot.joint_names)
    named = options["joints"].split(",") if "joints" in options else problem.robot.joint_names
    part = convert(
        path,
        problem=problem,
        joints=named,
        topic=options.get("topic"),
        rename=pairs("--rename", options.get("rename")),
        motors=options.get("motors", "motor_side" in options),
        rate=number(options, "rate", 0.0) or None,
    )
    if part.n != problem.robot.n:
        raise other_robot(part.n, problem.robot.n, path)
    check_usable(path, part)
    return part


def look_again(request: Request, progress: Progress) -> Answer:
    """The runs, checked for the robot as it is now."""
    problem, folder = problem_of(request), Path(request["folder"])
    kept = []
    for run in request["runs"]:
        progress(f"checking {run['name']}")
        part = load_measurements(folder / run["file"])
        made = keep(problem, part, folder, run["name"])
        kept.append({**made, "use": run["use"], "given": run["given"]})
    return {"runs": kept}


def real(request: Request, progress: Progress) -> Answer:
    """The real runs of a robot that are on this computer."""
    (name,) = [d.name for d in DATASETS.values() if d.problem == request["robot"]["source"]]
    files = [{"path": str(p), "name": p.stem, "given": str(p)} for p in real_files(name)]
    return read({**request, "files": files}, progress)


def simulate(request: Request, progress: Progress) -> Answer:
    """Three runs and one for testing, with an effect hidden in them; the truth is not shown."""
    problem = problem_of(request)
    level: str | float = request["level"]
    progress("simulating four runs of 20 s")
    joints = [j - 1 for j in request["joints"]]
    hidden = [] if request["effect"] == "none" else [(request["effect"], joints)]
    made = hidden_runs(problem, hidden, level, int(request["seed"]), must_show=True)
    runs = []
    for name, part in zip(RUN_FILES, made.runs, strict=True):
        progress(f"checking {name}")
        run = keep(problem, part, Path(request["folder"]), name)
        runs.append({**run, "use": "test" if name == RUN_FILES[-1] else "train"})
    return {"runs": runs, "refused": [], "effects": made.truth["model_effects"]}


def mend(request: Request, progress: Progress) -> Answer:
    """What `check --fix` does to one of the runs: its repaired copy, and beside it what was changed."""
    problem, folder = problem_of(request), Path(request["folder"])
    (given,) = (run for run in request["runs"] if run["file"] == request["file"])
    part = replace(load_measurements(folder / given["file"]), names=(given["name"],))
    progress(f"repairing {given['name']}")
    (report,) = check(problem, part, thorough=False)
    made = keep(problem, report.fixed, folder, f"{Path(given['name']).stem}_fixed.csv")
    changes = report.changes(given["name"])
    write_text(folder / Path(made["file"]).with_suffix(".txt"), changes)
    return {"run": {**made, "use": given["use"]}, "changes": changes.splitlines()}


def problem_of(request: Request) -> Problem:
    return load_problem(request["robot"]["source"], request["robot"].get("gravity"))


def runs_of(request: Request) -> Runs:
    """The runs of a request for what each is used for, under their shown names.

    A run of use "split" gives part of its motion to the first, the rest to the others.
    """
    chosen = request["runs"]
    if not chosen:
        raise InputError("No run to identify from", "add measurements first")
    loaded = load_measurements(*(Path(request["folder"]) / run["file"] for run in chosen))
    train, test = [], []
    for run, part in zip(chosen, loaded.runs(), strict=True):
        if run["use"] == "load":
            continue
        if run["use"] == "split":
            if run["split"] is None:
                raise InputError(
                    "the motion repeats too fast to be split into one part to identify from and one "
                    "to test on",
                    "use the run for identification only, or record another one",
                    run["name"],
                )
            named = replace(part, names=(run["name"],))
            train.append(windowed(named, [(a, b) for a, b in run["split"]["train"]]))
            test.append(windowed(named, [(a, b) for a, b in run["split"]["test"]]))
        else:
            (test if run["use"] == "test" else train).append(replace(part, names=(run["name"],)))
    if not train:
        raise InputError("No run to identify from", "use at least one for it")
    return Runs(concatenate(train), concatenate(test) if test else None, loaded)


def keep(problem: Problem, part: Measurements, folder: Path, name: str) -> dict[str, Any]:
    """Write a run into the session's folder; what the page shows of it.

    given : how the command line names it; split : the windows of the use "split", by phase where the
    motion repeats, None where it does so too fast.
    """
    part = replace(concatenate([part]), names=(name,))
    (found,) = check(problem, part, thorough=False)
    file = f"run-{part.data_hash[:16]}.npz"
    save(part, folder / file)
    _preview(problem, part, found.mended, folder / f"view-{part.data_hash[:16]}.npz")
    seconds = float(part.t[-1] - part.t[0])
    return {
        "file": file,
        "view": f"view-{part.data_hash[:16]}.npz",
        "name": name,
        "given": name,
        "use": "train",
        "hash": part.data_hash,
        "samples": part.samples,
        "seconds": seconds,
        "split": _split(problem, part),
        "rate": (part.samples - 1) / seconds if seconds > 0.0 else 0.0,
        "findings": [{word: getattr(f, word) for word in _SHOWN} for f in found.problems],
    }


def _preview(problem: Problem, part: Measurements, mended: Measurements, out: Path) -> None:
    """What the page shows of a run at once: t, q, dq, tau at some instants, the positions and torques
    that the check would put there (NaN where it changes nothing), and the arm's poses."""
    raw = np.hstack([part.q, part.tau])
    repaired = np.full(raw.shape, np.nan)
    if len(mended.t) == len(part.t) or np.all(np.diff(mended.t) > 0.0):
        values = np.hstack([mended.q, mended.tau]).T
        there = values.T
        if len(mended.t) != len(part.t):
            there = np.column_stack([np.interp(part.t, mended.t, x) for x in values])
        # What a picture shows; rows that were left out come between their neighbours.
        changed = np.abs(there - raw) > 1e-3 * np.nanmax(np.abs(there), axis=0)
        repaired[changed] = there[changed]
    keep = np.linspace(0, len(part.t) - 1, POINTS).astype(int)
    rare = np.flatnonzero(np.isfinite(repaired).any(axis=1))
    keep = np.unique(np.concatenate([keep, rare[:: 1 + len(rare) // POINTS]]))
    t, q, n = part.t[keep], part.q[keep], part.n
    dq = np.gradient(part.q, part.t, axis=0)[keep] if part.dq is None else part.dq[keep]
    arrays = {"t0": t, "q0": q, "dq0": dq, "torque0": part.tau[keep], "modelled0": part.tau[keep]}
    arrays |= {"repaired_q0": repaired[keep, :n], "repaired_torque0": repaired[keep, n:]}
    arrays["tf0"], arrays["poses0"] = placed(problem.robot, part.t, part.q)
    save_arrays(out, arrays)


def _split(problem: Problem, part: Measurements) -> dict[str, list[tuple[float, float]]] | None:
    """Windows to identify from and to test on, rounded so that a command can name them."""
    try:
        settings = problem.preprocessing.resolve(part)
        reach = filter_reach(part, settings)  # half of it lies between: no filter sees both
    except InputError:  # no motion: the check says so
        return None
    (clock,) = motion_clocks(tracks_of(part))
    windows = phase_windows(clock, float(part.t[-1] - part.t[0]), SPLIT, 0.5 * reach, 1.5 * reach)
    if windows is None:
        return None
    train, test = ([(round(a, 3), round(b, 3)) for a, b in side] for side in windows)
    return {"train": train, "test": test}
