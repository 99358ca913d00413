"""The verb ``challenge``: how often is the diagnosis right?

Every case is simulated by its own seed, diagnosed without sight of the truth, and then compared with
it. Cases whose hidden torque, white and with the model partialled out, has less energy than 30 are
counted apart: these data cannot show them; likewise where the effect would have to bend a joint by
more than any machine does to reach the torque that is asked for. Results are kept case by case, so
that an interrupted challenge goes on where it stopped.
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

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.diagnosis.diagnose import conclude
from sdp_vs_penalty.diagnosis.fit import orthonormal
from sdp_vs_penalty.diagnosis.rows import diagnosis_rows
from sdp_vs_penalty.diagnosis.search import search
from sdp_vs_penalty.diagnosis.stage import Stage, model_columns, white_rows
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.signals.segments import SegmentedRuns
from sdp_vs_penalty.simulation.challenge.cases import CLASSES, CaseClass, draw
from sdp_vs_penalty.simulation.experiment import experiment
from sdp_vs_penalty.simulation.hidden_runs import HiddenRuns, hidden_runs, link_deviation, make_world
from sdp_vs_penalty.solvers.certificate import Certificate

Array = NDArray[np.float64]


#: Of the record's format: cases of another version are simulated anew.
VERSION = 2


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

    from sdp_vs_penalty.simulation.challenge.report import write_report

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
    model_runs = data
    if case.frozen:  # identified in another sitting, without the load
        sitting = hidden_runs(problem, [], 0.0, seed + 5_000_000, count=3, world=made.world)
        model_runs = concatenate(sitting.runs)
    estimate = quick_estimate(problem, model_runs, made.truth["model_effects"])
    begin = time.perf_counter()
    rows = diagnosis_rows(data, estimate, estimate.preprocessing)
    search_end = search(rows, estimate, case.frozen, seed)
    result = conclude(search_end, made.runs[3], estimate.preprocessing)
    estimate, state = search_end.estimate, search_end.state
    seconds = time.perf_counter() - begin
    ideal = diagnosis_rows(concatenate(made.ideal[: case.runs]), estimate, estimate.preprocessing)
    floor = noise_std(rows, ideal)
    after: list[float] = []
    if case.what == "library" and case.runs == len(made.runs) - 1:
        test, ideal_test = (
            diagnosis_rows(m, estimate, estimate.preprocessing) for m in (made.runs[-1], made.ideal[-1])
        )
        after = (result.held_out_rmse / noise_std(test, ideal_test)).tolist()
    record = {
        "class": name,
        "seed": seed,
        "truth": made.truth["effects"],
        "energy": hidden_energies(made, ideal, estimate, state.stage, case),
        "deviation": [link_deviation(made, h) for h in made.hidden],
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
        "events": [
            {"joint": e.joint + 1, "t_start": e.t_start, "t_end": e.t_end} for e in result.events
        ],
        "floor": (result.noise_floor / floor).tolist(),
        "after": after,
        "seconds": seconds,
    }
    return {key: rounded(value) for key, value in record.items()}


def rounded(value: Any) -> Any:
    """The same with all floats at six digits: thousands of records are kept."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: rounded(x) for key, x in value.items()}
    return [rounded(x) for x in value] if isinstance(value, (list, tuple)) else value


def quick_estimate(problem: Problem, measurements: Measurements, effects: Sequence[str]) -> Estimate:
    """Least squares on the diagnosis's rows: what `identify --method ols` gives, without its
    certificate. The challenge needs thousands."""
    model = problem.model(effects)
    settings = problem.preprocessing.resolve(measurements)
    theta = problem.nominal(model)
    p = len(theta)
    certificate = Certificate({}, 0.0, None, None, None, None, None)
    start = Estimate(
        problem,
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
    target = rows.residual
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


def hidden_energies(
    made: HiddenRuns, ideal: SegmentedRuns, estimate: Estimate, stage: Stage, case: CaseClass
) -> list[float]:
    """Energy of each hidden effect's torque, white by the tool's own whitener, the model partialled out.

    From what perfect sensors would have logged (ideal: with all effects): what a refitted model cannot
    follow there, less what it cannot follow of the robot without the effect, is the effect.
    """

    def left_of(rows: SegmentedRuns) -> Array:
        base = model_columns(rows, estimate, case.frozen)
        columns, target = white_rows(rows, stage.noise, base, rows.residual)
        Q = orthonormal(columns)
        return np.asarray(target - Q @ (Q.T @ target))

    if not made.hidden:
        return []
    each = [ideal]
    settings = estimate.preprocessing
    if len(made.hidden) > 1:
        seed, world = made.truth["seed"], made.world
        alone = [
            hidden_runs(made.problem, [], case.level, seed, case.runs, [h], world) for h in made.hidden
        ]
        each = [diagnosis_rows(concatenate(one.ideal), estimate, settings) for one in alone]
    plain = left_of(diagnosis_rows(concatenate(made.plain[: case.runs]), estimate, settings))
    left = [left_of(rows) for rows in each]
    return [float(np.sum((x - plain) ** 2)) if len(x) == len(plain) else float("nan") for x in left]


def noise_std(logged: SegmentedRuns, ideal: SegmentedRuns) -> Array:
    """(n,) the true noise of the model's residual [N m or N], filtered like everything else.

    The residual of the log less that of perfect sensors: torque noise, and what quantisation and the
    clock's jitter do to the model's torque.
    """
    keep = logged.keep[:, 0]
    return np.asarray((logged.residual - ideal.residual)[keep].std(axis=0))
