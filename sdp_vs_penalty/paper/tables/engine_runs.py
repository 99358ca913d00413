"""What Table V and Figures 5 to 7 share: every engine at hand along the same motions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.paper.tables.study import Study
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
