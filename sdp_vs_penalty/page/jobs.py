"""What a worker can be asked to do: one function a job, from a request to an answer, both plain JSON.

Every job loads what it needs from files of the session's folder and leaves its models there, so that
a job that is killed has changed nothing.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.checks import urdf
from sdp_vs_penalty.data.cli_parsing import numbers, time_windows
from sdp_vs_penalty.data.datasets import DATASETS
from sdp_vs_penalty.data.files import load_measurements, save, windowed
from sdp_vs_penalty.diagnosis.adding import add
from sdp_vs_penalty.diagnosis.comparison import compare
from sdp_vs_penalty.diagnosis.diagnose import diagnose
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.errors import InputError, other_robot
from sdp_vs_penalty.estimation.cross_validation import cross_validate
from sdp_vs_penalty.estimation.estimate import load_estimate
from sdp_vs_penalty.estimation.excitation import save_trajectory
from sdp_vs_penalty.estimation.identify import identify
from sdp_vs_penalty.estimation.known_load import parsed_known_load
from sdp_vs_penalty.estimation.pose import PoseOptions
from sdp_vs_penalty.estimation.separation import separate as separation
from sdp_vs_penalty.estimation.verify import verify_proof_file
from sdp_vs_penalty.estimators import estimator_types, with_solver
from sdp_vs_penalty.exporters import sdp
from sdp_vs_penalty.exporters.export import export
from sdp_vs_penalty.files import write_bytes, write_text
from sdp_vs_penalty.formatting import number as figure
from sdp_vs_penalty.page.options import number
from sdp_vs_penalty.page.run_jobs import (
    Answer,
    Progress,
    Request,
    look_again,
    mend,
    problem_of,
    read,
    real,
    real_files,
    runs_of,
    simulate,
)
from sdp_vs_penalty.page.summary import drawn_arm, held, placed, save_arrays, summary
from sdp_vs_penalty.parallel import Workers
from sdp_vs_penalty.problem.fields import entries
from sdp_vs_penalty.problem.load import load_problem, with_bounds, with_filters
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.reports import report as write_report
from sdp_vs_penalty.robot.geometry import link_hulls
from sdp_vs_penalty.simulation.follow import follow
from sdp_vs_penalty.simulation.hidden_runs import MAKERS
from sdp_vs_penalty.simulation.worlds.hidden import LEVELS


def catalogue(request: Request, progress: Progress) -> Answer:
    """Everything that the page offers to choose from, but the robots."""
    return {
        "effects": [
            {"name": name, "explanation": kind.explanation, "frozen_only": kind.frozen_only}
            for name, kind in effect_types().items()
        ],
        "methods": [
            {"name": name, "description": kind.description}
            for name, kind in estimator_types().items()
            if not kind.needs_black_box
        ],
        "hideable": [name for name in MAKERS if not effect_types()[name].frozen_only],
        "whole_robot": [name for name, kind in effect_types().items() if kind.whole_robot],
        "levels": list(LEVELS),
        "real": {d.problem: d.title for d in DATASETS.values() if real_files(d.name)},
    }


def robot(request: Request, progress: Progress) -> Answer:
    """source : a built-in name or a URDF file; what the page shows of that robot."""
    source = request["source"]
    problem = load_problem(source, request.get("gravity"))
    hulls = link_hulls(source) if source.lower().endswith(".urdf") else []
    return {
        "title": problem.title
        if problem.folder is not None
        else f"{formatting.count(problem.robot.n, 'joint')}, from URDF",
        "name": problem.name,
        "n": problem.robot.n,
        "joints": list(problem.robot.joint_names),
        "units": [formatting.plain_unit(unit) for unit in problem.robot.torque_units],
        "effects": list(problem.default_effects),
        "drawn": drawn_arm(problem.robot, problem.nominal_links, hulls),
        "torque_side": problem.torque_side,
        "own_gravity": list(problem.robot.gravity),
        "known": _known(problem),
        "bounds": _bounds(problem),
    }


def _known(problem: Problem) -> str:
    """Bounds and filters in a sentence."""
    bounds = np.isfinite(problem.box).any(axis=2).sum(axis=1)
    settings = problem.preprocessing
    cutoffs = (
        "chosen from the data" if f is None else f"{f:g} Hz"
        for f in (settings.state_cutoff, settings.torque_cutoff)
    )
    return (
        f"Bounds on {bounds.sum()} of {10 * len(bounds)} link parameters; filters of states and torque: "
        f"{', '.join(cutoffs)}. The stage Identify, or a folder with a problem.toml, sets others."
    )


def _bounds(problem: Problem) -> list[list[str]]:
    """Name, ends as text ("" for none) and unit of everything of a link that a bound may be on."""
    units = ("kg", *["m"] * 3, *["kg m^2"] * 6)
    return [
        [name, *(f"{x:.4g}" if np.isfinite(x) else "" for x in problem.box[place]), units[place[1]]]
        for name, place in entries(problem.robot.links).items()
    ]


def fit(request: Request, progress: Progress) -> Answer:
    """Identify a model and look where it fails."""
    runs, options = runs_of(request), request["options"]
    bounded = with_bounds(problem_of(request), options.get("bounds"))
    problem = with_filters(bounded, options.get("filters"))
    begin = time.perf_counter()
    estimate = identify(
        problem,
        windowed(runs.train, time_windows(options.get("window"))),
        with_solver(request["method"], options.get("solver")),
        effects=request["effects"],
        seed=int(request["seed"]),
        progress=progress,
        gain_uncertainty=number(options, "gain_uncertainty", 0.0),
        known_loads=_known_loads(request, options.get("known_load")),
        workers=Workers(int(number(options, "jobs", 1)), progress=progress),
    )
    seconds = time.perf_counter() - begin
    return asdict(summary(estimate, runs, Path(request["out"]), seconds, progress))


def _known_loads(request: Request, text: str | None) -> list[tuple[str, float]]:
    """Runs with a load, by their shown names: "load.csv:2.8", several separated by commas."""
    files = {run["name"]: run["file"] for run in request["runs"]}
    loads = []
    for word in text.split(",") if text else []:
        run, mass = parsed_known_load(word)
        if str(run) not in files:
            raise InputError(f"{run}: not a run of this page", f"choose one of {', '.join(files)}")
        loads.append((str(Path(request["folder"]) / files[str(run)]), mass))
    return loads


def open_model(request: Request, progress: Progress) -> Answer:
    """A model.json that somebody brings, judged on these runs."""
    runs = runs_of(request)
    estimate = load_estimate(request["model"])
    if estimate.robot.n != runs.train.n:
        raise other_robot(runs.train.n, estimate.robot.n, request["model"], "model")
    return asdict(summary(estimate, runs, Path(request["out"]), 0.0, progress))


def extend(request: Request, progress: Progress) -> Answer:
    """Add effects to a model: what `sdp-vs-penalty add` does."""
    runs = runs_of(request)
    begin = time.perf_counter()
    estimate = add(
        load_estimate(request["model"]),
        request["effect"],
        runs.train,
        frozen=bool(request["frozen"]),
        seed=int(request["seed"]),
        progress=progress,
    )
    seconds = time.perf_counter() - begin
    return asdict(summary(estimate, runs, Path(request["out"]), seconds, progress))


def find(request: Request, progress: Progress) -> Answer:
    """Which effects a model misses: what `sdp-vs-penalty diagnose` does."""
    runs = runs_of(request)
    model = load_estimate(request["model"])
    result = diagnose(
        model,
        runs.train,
        runs.test,
        frozen=bool(request["frozen"]),
        seed=int(request["seed"]),
        progress=progress,
        noise_from=runs.whole,
    )
    return {
        "diagnosis": result.to_dict(),
        "curves": [curve.effect(model.robot).text for curve in result.curves],
    }


def separate(request: Request, progress: Progress) -> Answer:
    """The run that would tell two effects apart: what `sdp-vs-penalty excite --separate` does."""
    options = request["options"]
    found = separation(
        load_estimate(request["model"]),
        request["effects"],
        duration=number(options, "duration", 20.0),
        level=number(options, "level", 1.0),
        iterations=int(number(options, "iterations", 200)),
        seed=int(request["seed"]),
        progress=progress,
    )
    out = Path(request["folder"]) / "trajectory.csv"
    save_trajectory(found.trajectory, out)
    said = (
        f"To tell {request['effects']} apart: right in {100 * found.right:.0f} % of runs like "
        f"trajectory.csv, {100 * found.default_right:.0f} % on the default excitation.",
        "Collisions are not checked: look at the motion before it is run.",
    )
    return {"notice": said, "files": [out.name]}


def methods(request: Request, progress: Progress) -> Answer:
    """The same effects by other methods, judged alike: headings, and a row a method."""
    runs, current = runs_of(request), load_estimate(request["model"])
    if not request["methods"]:
        raise InputError("No method is chosen", "choose at least one to compare")
    heads = ["method", "error", "constraints", "thinnest link", "widest link", "certified gap", "time"]
    heads += ["error on unseen motion"] * bool(request["folds"])
    rows = []
    for name in request["methods"]:
        begin = time.perf_counter()
        given: dict[str, Any] = {
            "effects": current.model.effects,
            "seed": int(request["seed"]),
            "progress": lambda text, name=name: progress(f"{name}: {text}"),
        }
        try:
            made = identify(current.problem, runs.train, name, **given)
            seconds = time.perf_counter() - begin
            folds = request["folds"] and cross_validate(current.problem, runs.train, name, **given)
        except InputError as error:
            rows.append([name, str(error), *[""] * (len(heads) - 2)])
            continue
        c = compare({name: made}, runs.judge, noise_from=runs.whole)[0]
        thick, share = made.certificate.smallest_thickness, made.certificate.body_share
        row = [name, f"{c.relative_error_percent:.4g} %", held(made)]
        row += ["-" if thick is None else f"{1e3 * thick:.3g} mm", figure(share, 2)]
        row += [figure(made.certificate.gap, 2), f"{seconds:.2g} s"]
        rows.append([*row, *([f"{folds.relative_error_percent:.4g} %"] if folds else [])])
    return {"heads": heads, "rows": rows}


def take(request: Request, progress: Progress) -> Answer:
    """A file to take away: a run as it was used, the diagnosis, the report, or the model in the format
    of the name's suffix; says which effects have no place in it."""
    name, folder, found = request["name"], Path(request["folder"]), request.get("findings")
    progress(f"writing {name}")
    lost: Sequence[str] = ()
    if name.startswith("run-"):
        run = request["runs"][int(name[4:-4]) - 1]
        save(load_measurements(folder / run["file"]), folder / name)
    elif name == "findings.json":
        write_text(folder / name, json.dumps(found, indent=1, allow_nan=False) + "\n")
    elif name == "model.json":
        write_bytes(folder / name, Path(request["model"]).read_bytes())
    elif name == "report.html":
        runs = runs_of(request)
        write_report(
            {m["label"]: load_estimate(m["file"]) for m in request["models"]},
            runs.judge,
            folder / name,
            commands=request["commands"],
            noise_from=runs.whole,
            findings=found and Diagnosis.from_dict(found),
            progress=progress,
        )
    else:
        given = request.get("urdf") if name == "robot.urdf" else None
        x, y, z = numbers("flange", request.get("flange") or "0,0,0", 3)
        lost = export(load_estimate(request["model"]), folder / name, given, flange=(x, y, z))
    said = f"{Path(name).suffix} files cannot hold {', '.join(lost)}; model.json can."
    return {"files": [name], "notice": [said] if lost else []}


def forward(request: Request, progress: Progress) -> Answer:
    """A model run along the judged runs: what `sdp-vs-penalty simulate --follow` does.

    Its arrays, as .npz : t0, measured0, simulated0 of the first free run, t1, ...; and of some instants
    tf0 (F,), poses0 (F, 2 joints, 4, 4), the measured arm before the simulated one.
    """
    estimate = load_estimate(request["model"])
    made = follow(
        estimate,
        runs_of(request).judge,
        drive=request["drive"],
        seed=int(request["seed"]),
        progress=progress,
    )
    arrays: dict[str, Any] = {}
    for k, free in enumerate(made.free):
        both = free.measured, free.simulated.q
        arrays |= {f"t{k}": free.simulated.t, f"measured{k}": both[0], f"simulated{k}": both[1]}
        arms = [placed(estimate.robot, free.simulated.t, q) for q in both]
        arrays |= {f"tf{k}": arms[0][0], f"poses{k}": np.concatenate([a[1] for a in arms], axis=1)}
    file = Path(request["folder"]) / f"forward-{made.drive}.npz"
    save_arrays(file, arrays)
    heads, rows = made.table()
    return {
        "file": str(file),
        "runs": [f"{f.simulated.names[0]}, from {f.simulated.t[0]:.4g} s" for f in made.free],
        "verdict": made.verdict,
        "explained": made.explained,
        "units": list(made.units),
        "heads": heads,
        "rows": rows,
        "left_out": list(made.left_out),
    }


def prove(request: Request, progress: Progress) -> Answer:
    """The model identified again with a proof, as `identify --proof` does, and that verified."""
    model, out = load_estimate(request["model"]), Path(request["folder"]) / "proof.json"
    runs = windowed(runs_of(request).train, time_windows(request["window"]))
    identify(
        model.problem,
        runs,
        model.method,
        effects=model.model.effects,
        weighting=model.weighting,
        seed=int(request["seed"]),
        progress=progress,
        proof=out,
    )
    progress("checking the proof")
    return {**verify({"proof": str(out)}, progress), "files": [out.name]}


def verify(request: Request, progress: Progress) -> Answer:
    """What `sdp-vs-penalty verify` says of a proof."""
    holds, said = verify_proof_file(request["proof"])
    return {"holds": holds, "said": said}


def pose(request: Request, progress: Progress) -> Answer:
    """The SDP behind a model as a file, and what it means: what `sdp-vs-penalty export-sdp` does."""
    model, out = load_estimate(request["model"]), Path(request["folder"]) / request["name"]
    runs = windowed(runs_of(request).train, time_windows(request["window"]))
    options = PoseOptions(model.model.effects, weighting=model.weighting, seed=int(request["seed"]))
    sdp.write_posed(model.problem, runs, out, model.method, options, progress)
    return {"files": [out.name, f"{out.name}.json"]}


def check_urdf(request: Request, progress: Progress) -> Answer:
    """What `sdp-vs-penalty check-urdf` says, and its mended copy."""
    path, out = request["robot"]["source"], Path(request["folder"]) / "fixed.urdf"
    checks = urdf.check_urdf(path)
    broken = [c for c in checks if not c.consistent]
    if broken:
        urdf.write_nearest(path, checks, out)
    return {
        "urdf": path,
        "possible": not broken,
        "said": urdf.sentences(checks, urdf.massless_links(path)),
        "rows": urdf.table(checks),
        "files": [out.name] if broken else [],
    }


#: By the name in a request.
JOBS: dict[str, Callable[[Request, Progress], Answer]] = {
    job.__name__: job
    for job in (
        *(catalogue, robot, read, look_again, real, simulate, mend, fit, open_model, separate),
        *(extend, find, methods, take),
        *(forward, prove, verify, pose, check_urdf),
    )
}
