"""What the page shows of a model: errors beside the noise, where it fails, its torques as curves."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.constraints.constraint import BarycentricBound
from sdp_vs_penalty.data.measurements import Runs
from sdp_vs_penalty.diagnosis.comparison import compare, predicted
from sdp_vs_penalty.diagnosis.where_it_fails import sentences, where_it_fails
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.shape_profiles import asked_effects
from sdp_vs_penalty.estimators.estimator import Progress
from sdp_vs_penalty.files import write_bytes
from sdp_vs_penalty.signals.preprocessing import filtered_torque


@dataclass(frozen=True)
class Rung:
    """One model of a session's ladder, judged; plain JSON apart from being a class.

    file, curves : its model.json and the .npz of its torques; runs : names of those, training runs
    first; judged_on : the runs behind comparison and failures (as `compare --json` writes them);
    violation : see :func:`violation`; label, added : what it is called and the effects added to the
    rung below, with the others held where frozen; opened : the file that a person brought, if any.
    """

    file: str
    curves: str
    runs: list[str]
    judged_on: list[str]
    method: str
    effects: list[str]
    parameters: int
    comparison: dict[str, Any]
    failures: list[dict[str, Any]]
    violation: dict[str, float]
    gap: float | None
    thickness: float | None
    on_bounds: list[str]
    seconds: float
    label: str = ""
    added: tuple[str, ...] = ()
    frozen: bool = False
    opened: str = ""


def violation(estimate: Estimate) -> dict[str, float]:
    """The worst violation of the convex constraints, and of those that no convex method can impose."""
    found = estimate.certificate.violations
    family = BarycentricBound.family
    return {
        "convex": max((v for k, v in found.items() if k != family), default=0.0),
        "other": found.get(family, 0.0),
    }


def summary(estimate: Estimate, given: Runs, out: Path, seconds: float, progress: Progress) -> Rung:
    """Save a model at ``out`` and its curves beside it; judge it.

    Curves : t0, torque0, modelled0, t1, ... of every run, training runs first, as .npz.
    """
    train, test, judge = given.train, given.test, given.judge
    progress("comparing measured with modelled")
    comparison = compare({"model": estimate}, judge, noise_from=given.whole)[0]
    settings = estimate.preprocessing.resolve(judge)
    arrays = {}
    runs = [*train.runs(), *([] if test is None else test.runs())]
    for k, run in enumerate(runs):
        rows = filtered_torque(run, estimate.model, settings)
        arrays[f"t{k}"] = rows.motion.t
        arrays[f"torque{k}"] = rows.torque.astype(np.float32)
        arrays[f"modelled{k}"] = predicted(rows, estimate.theta).astype(np.float32)
    progress("looking where it fails")
    try:
        found = where_it_fails(estimate, judge, noise_from=given.whole)
        units = estimate.robot.torque_units
        failures = [{**f.to_dict(), "sentences": sentences(f, units[f.joint - 1])} for f in found]
    except InputError:  # too short to say: the errors stand on their own
        failures = []
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)  # type: ignore[arg-type]
    write_bytes(out.with_suffix(".npz"), buffer.getvalue())
    estimate.save(out)
    certificate = estimate.certificate
    return Rung(
        file=str(out),
        curves=str(out.with_suffix(".npz")),
        runs=[run.names[0] for run in runs],
        judged_on=list(judge.names),
        method=estimate.method,
        effects=asked_effects(estimate.model.effects, estimate.details.get("shapes", ())),
        parameters=len(estimate.theta),
        comparison=comparison.to_dict(),
        failures=failures,
        violation=violation(estimate),
        gap=certificate.gap,
        thickness=certificate.smallest_thickness,
        on_bounds=estimate.details.get("on_bounds") or [],
        seconds=seconds,
    )
