"""Table V: torque errors of physics engines, published ones and those at hand."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.paper.tables.engine_runs import (
    MEASURED_STEP,
    METHOD,
    EngineResult,
    measured_runs,
    sinusoidal_runs,
)
from sdp_vs_penalty.paper.tables.study import Study, sentence
from sdp_vs_penalty.paper.tables.table import Cell, Column, Table
from sdp_vs_penalty.simulation.engines import engine_types
from sdp_vs_penalty.simulation.engines.comparison import STEP

NAME = "V"
PROBLEMS = ("panda",)


def build(study: Study) -> Table:
    """Rows: the paper's engines inside V-REP, then each of ours on simulated and real motion."""
    n = study.problem.robot.n
    published = study.problem.published["table_V"]
    names = [*published[0], *(f"std_joint_{j + 1}" for j in range(n))]
    names += ["motion", "position_error_mm", "angle_error_mrad", "inverse_dynamics_error", "status"]
    missing: list[Cell] = [None] * n
    rows: list[tuple[Cell, ...]] = [
        (*row.values(), *missing, "published (V-REP)", None, None, None, "published")
        for row in published
    ]
    results = [*sinusoidal_runs(study), *measured_runs(study)]
    rows += [_row(result, n) for result in results]
    formulations = "; ".join(f"{name}: {kind.formulation}" for name, kind in engine_types().items())
    return Table(
        NAME,
        f"Table V: physics engines with the identified {study.problem.title}",
        sentence(study),
        tuple(Column(name, 3) for name in names),
        tuple(rows),
        (
            "joint_k: mean torque error [N m]; std_joint_k: its standard deviation (not published). "
            "Published rows: four engines inside V-REP, which is not on a package index; its versions "
            "and drivers are not ours, so that rows of the same engine need not agree.",
            f"simulated: sinusoidal velocities over 90 % of each joint's range, links of {METHOD} from "
            f"the simulated run, engine less identified model, step {1e3 * STEP:g} ms. measured: the "
            f"filtered motion of the real run, links of {METHOD} from it, engine less measured torque "
            f"less identified friction, step {1e3 * MEASURED_STEP:g} ms.",
            "position and angle: largest distance of the last joint's frame from where the commanded "
            "motion puts it. inverse_dynamics_error: largest difference to Pinocchio's torque over 100 "
            "random states [N m]; ODE has no inverse dynamics.",
            f"Formulations: {formulations}.",
        ),
    )


def _row(result: EngineResult, n: int) -> tuple[Cell, ...]:
    label = f"{result.engine} {result.version}".strip()
    if result.run is None or result.torque_error is None:
        return (label, *[None] * (2 * n), result.motion, None, None, None, result.status)
    return (
        label,
        *map(float, result.torque_error.mean(axis=0)),
        *map(float, result.torque_error.std(axis=0)),
        result.motion,
        1e3 * float(np.max(result.run.position)),
        1e3 * float(np.max(result.run.angle)),
        result.inverse_error,
        result.status,
    )
