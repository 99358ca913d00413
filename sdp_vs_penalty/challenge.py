"""The verb ``challenge``: how often is the diagnosis right?

Every case is simulated by its own seed, diagnosed without sight of the truth, and then compared with
it. Cases whose hidden torque, white and with the model partialled out, has less energy than 30 are
counted apart: these data cannot show them. Results are kept case by case, so that an interrupted
challenge goes on where it stopped.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.challenge_cases import CLASSES, CaseClass, Draw, draw
from sdp_vs_penalty.diagnosis import Diagnosis
from sdp_vs_penalty.diagnosis.diagnose import (
    Stage,
    conclude,
    model_columns,
    prepare,
    search_through,
    white_rows,
)
from sdp_vs_penalty.diagnosis.rows import DiagnosisRows, diagnosis_rows
from sdp_vs_penalty.diagnosis.scoring import independent
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimate import Estimate
from sdp_vs_penalty.experiment import experiment
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.hidden_runs import HiddenRuns, hidden_runs, make_world
from sdp_vs_penalty.measurements import Measurements, concatenate
from sdp_vs_penalty.preprocessing import Preprocessing
from sdp_vs_penalty.problem import Problem, load_problem
from sdp_vs_penalty.solvers.certificate import Certificate

Array = NDArray[np.float64]

#: White, partialled energy from which a hidden effect counts as identifiable.
IDENTIFIABLE = 30.0
#: Of the record's format: cases of another version are simulated anew.
VERSION = 1


def run_challenge(
    problem: str,
    cases: int,
    seed: int,
    out: Path,
    jobs: int = 2,
    classes: Sequence[str] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Run what is missing of the challenge and write challenge.json, challenge.csv, challenge.md."""
    from joblib import Parallel, delayed

    from sdp_vs_penalty.challenge_report import write_report

    names = list(CLASSES) if classes is None else list(classes)
    for name in names:
        if name not in CLASSES:
            raise InputError(f"class {name!r} is unknown; there are: {', '.join(CLASSES)}.")
    load_problem(problem)
    store = out / "challenge.json"
    records: dict[str, dict[str, Any]] = {}
    if store.is_file():
        kept = json.loads(store.read_text())
        if kept.get("version") == VERSION and kept.get("problem") == problem:
            records = kept["cases"]
    wanted = [
        f"{name}/{seed * 1_000_000 + 10_000 * (1 + list(CLASSES).index(name)) + k}"
        for k in range(cases)
        for name in names
    ]
    todo = [key for key in wanted if key not in records]
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    chunk = 8 * jobs
    with Parallel(n_jobs=jobs) as parallel:
        for first in range(0, len(todo), chunk):
            part = todo[first : first + chunk]
            progress(f"case {first + 1} of {len(todo)}")
            found = parallel(delayed(run_case)(problem, key) for key in part)
            records |= dict(zip(part, found, strict=True))
            content = {"version": VERSION, "problem": problem, "cases": records}
            write_text(store, json.dumps(content) + "\n")
    return [store, *write_report({k: records[k] for k in wanted}, out, problem, cases, seed)]


def run_case(problem_name: str, key: str) -> dict[str, Any]:
    """Simulate, diagnose and score one case; ``key`` is class/seed."""
    name, _, text = key.partition("/")
    case, seed = CLASSES[name], int(text)
    problem = load_problem(problem_name)
    setup = experiment(problem)
    drawn = draw(case, problem, make_world(problem, setup, seed), seed)
    made = hidden_runs(problem, drawn.effects, case.level, seed, count=4, made=drawn.made)
    data = concatenate(made.runs[: case.runs])
    quiet = concatenate(made.quiet[: case.runs])
    model_runs = data
    if case.frozen:  # identified in another sitting, without the load
        sitting = hidden_runs(problem, [], 0.0, seed + 5_000_000, count=3, world=made.world)
        model_runs = concatenate(sitting.runs)
    estimate = quick_estimate(problem, model_runs, made.truth["model_effects"])
    begin = time.perf_counter()
    rows = diagnosis_rows(data, estimate, estimate.preprocessing)
    stage = prepare(rows, estimate, case.frozen, seed)
    stage = search_through(stage, estimate)
    result = conclude(estimate, stage, made.runs[3], estimate.preprocessing)
    seconds = time.perf_counter() - begin
    return {
        "class": name,
        "seed": seed,
        "truth": _truth(made, drawn),
        "energy": hidden_energy(made, quiet, estimate, stage, case),
        "found": [
            {
                "effect": f.effect,
                "joints": list(f.joints),
                "size": f.size,
                "rivals": list(f.indistinguishable_from),
                "confidence": f.confidence,
                "shape": dict(f.shape),
            }
            for f in result.effects
        ],
        "verdict": result.verdict,
        "events": [e.to_dict() for e in result.events],
        "floor": floor_ratio(made, estimate, case, result),
        "after": _after(made, estimate, result),
        "seconds": seconds,
    }


def _truth(made: HiddenRuns, drawn: Draw) -> list[dict[str, Any]]:
    return [
        {"effect": h.effect, "joints": [j + 1 for j in h.joints], "size": h.size, **dict(h.details)}
        for h in made.hidden
    ]


def quick_estimate(problem: Problem, measurements: Measurements, effects: Sequence[str]) -> Estimate:
    """Least squares on the diagnosis's rows: what `identify --method ols` gives, without its
    certificate. The challenge needs thousands."""
    model = problem.model(effects)
    settings = problem.preprocessing.resolve(measurements)
    theta = problem.nominal(model)
    p = len(theta)
    certificate = Certificate({}, 0.0, None, None, None, None, None)
    start = Estimate(
        problem.name,
        model,
        theta,
        np.full((p, p), np.nan),
        "ols",
        certificate,
        settings,
        {},
        {},
        {},
    )
    rows = diagnosis_rows(measurements, start, settings)
    columns = model_columns(rows, start)
    target = np.concatenate([s.torque - s.low_pass @ s.motion.model_torque for s in rows.segments])
    keep = rows.keep.T
    level = np.ones(rows.n)
    for _ in range(2):
        A = (columns * (keep / level[:, None])[:, :, None]).reshape(-1, p)
        b = (target.T * keep / level[:, None]).ravel()
        norms = np.linalg.norm(A, axis=0)
        unit = np.where(norms > 1e-12 * norms.max(), norms, np.inf)
        step = np.linalg.lstsq(A / unit, b, rcond=1e-9)[0] / unit
        left = (target.T - columns @ step) * keep
        level = np.maximum(np.sqrt(np.mean(left**2, axis=1)), 1e-9)
    return replace(start, theta=theta + step)


def hidden_energy(
    made: HiddenRuns, quiet: Measurements, estimate: Estimate, stage: Stage, case: CaseClass
) -> float:
    """Energy of the hidden torque, white by the tool's own whitener, the model partialled out.

    From the runs without torque noise: all that a refitted model cannot follow there is the effect.
    """
    if not made.hidden:
        return 0.0
    plain = hidden_runs(made.problem, [], 0.0, made.truth["seed"], count=4, world=made.world)
    left = []
    for runs in (quiet, concatenate(plain.quiet[: case.runs])):
        rows = diagnosis_rows(runs, estimate, estimate.preprocessing)
        residual = np.concatenate([s.torque - s.low_pass @ s.motion.model_torque for s in rows.segments])
        if residual.shape != stage.residual.shape:
            return float("nan")
        base = np.zeros((rows.n, len(rows.t), 0)) if case.frozen else model_columns(rows, estimate)
        columns, target = white_rows(rows, stage.noise, base, residual)
        Q = independent(columns)
        left.append(target - Q @ (Q.T @ target))
    # The difference: what quantisation and the clock's jitter leave is in both.
    return float(np.sum((left[0] - left[1]) ** 2))


def floor_ratio(made: HiddenRuns, estimate: Estimate, case: CaseClass, result: Diagnosis) -> list[float]:
    """The tool's noise floor over the true one, joint by joint, filtered alike."""
    settings = estimate.preprocessing
    parts = [
        _noise_rows(noisy, silent, estimate, settings)
        for noisy, silent in zip(made.runs[: case.runs], made.quiet[: case.runs], strict=True)
    ]
    true = np.concatenate(parts).std(axis=0)
    return (result.noise_floor / true).tolist()


def _noise_rows(
    noisy: Measurements, silent: Measurements, estimate: Estimate, settings: Preprocessing
) -> Array:
    only = replace(noisy, tau=noisy.tau - silent.tau)
    rows: DiagnosisRows = diagnosis_rows(only, estimate, settings)
    return rows.torque


def _after(made: HiddenRuns, estimate: Estimate, result: Diagnosis) -> float:
    """Held-out error after the ladder over the true noise of the test run, the worst joint's."""
    noise = _noise_rows(made.runs[3], made.quiet[3], estimate, estimate.preprocessing)
    return float((result.held_out_rmse / noise.std(axis=0)).max())
