"""Table V, and the runs that Figures 5 to 7 share: physics engines, published ones and those at hand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.paper.tables.study import Study, sentence
from sdp_vs_penalty.paper.tables.table import Cell, Column, Table
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import filtered_torque
from sdp_vs_penalty.simulation.engines import engine_types
from sdp_vs_penalty.simulation.engines.comparison import (
    EngineRun,
    PlayedMotion,
    Sinusoids,
    inverse_dynamics_error,
    play,
)

NAME = "V"
PROBLEMS = ("panda",)
#: Of the sinusoidal motion [s].
DURATION = {"quick": 10.0, "paper": 30.0}
#: Time step along the real run, and what is left out of the comparison at its start [s].
MEASURED_STEP, _SETTLE = 2e-3, 0.1
#: The method whose links the engines get.
METHOD = "lmi-sdp"


@dataclass(frozen=True)
class EngineResult:
    """One engine on one motion. run is None where it is absent or rejects the robot: status says so.

    torque_error (N, n) : engine less identified model on sinusoids; engine plus identified friction
    less measured torque on the real run, both below the torque filter's cut-off.
    """

    engine: str
    version: str
    motion: str
    status: str
    run: EngineRun | None = None
    torque_error: Array | None = None
    inverse_error: float | None = None


@lru_cache(maxsize=4)
def sinusoidal_runs(study: Study) -> tuple[EngineResult, ...]:
    """Sinusoidal velocities over the range, with the links identified from the simulated run."""
    links = study.links(METHOD, study.simulated)
    motion = Sinusoids.over_range(study.problem.robot)
    return tuple(
        _result(study, name, "simulated", links, motion, DURATION[study.budget], 1e-3)
        for name in engine_types()
    )


@lru_cache(maxsize=4)
def measured_runs(study: Study) -> tuple[EngineResult, ...]:
    """The motion of the real run, with the links identified from it; empty without a real run."""
    data = study.measured
    if data is None:
        return ()
    links = study.links(METHOD, data)
    # Decimated: dense enough for splines through the positions.
    rows = filtered_torque(data.train, data.model, data.preprocessing)
    theta = study.result(METHOD, data).theta.copy()
    theta[data.model.rigid_indices] = 0.0
    friction = np.column_stack([c.columns @ theta[c.indices] for c in rows.columns])
    t = rows.motion.t - rows.motion.t[0]
    motion = PlayedMotion(t, rows.motion.q)
    out = []
    for name in engine_types():
        result = _result(study, name, "measured", links, motion, float(t[-1]), MEASURED_STEP)
        if result.run is not None:
            reference = rows.torque - friction
            at = np.column_stack([np.interp(result.run.t, t, column) for column in reference.T])
            error = result.run.followed.torque - at
            # From rest to the run's velocity, within the first steps, is no motion of the robot's.
            moving = result.run.t > _SETTLE
            result = replace(result, torque_error=error[moving])
        out.append(result)
    return tuple(out)


def _result(
    study: Study,
    name: str,
    what: str,
    links: Array,
    motion: Sinusoids | PlayedMotion,
    duration: float,
    step: float,
) -> EngineResult:
    kind = engine_types()[name]
    version = kind.version()
    if version is None:
        return EngineResult(name, "", what, f"absent ({kind.install})")
    study.progress(f"engine {name}, {what} motion")
    robot = study.problem.robot
    try:
        run = play(kind, robot, links, motion, duration, step)
        inverse = inverse_dynamics_error(kind, robot, links)
    except InputError as error:
        return EngineResult(name, version, what, f"rejected: {error}")
    return EngineResult(name, version, what, "run", run, run.error, inverse)


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
            f"the simulated run, engine less identified model, step 1 ms. measured: the "
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
