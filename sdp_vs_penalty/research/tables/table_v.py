"""Table V, and the runs that Figures 5 to 7 share: physics engines, published ones and those at hand."""

from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.diagnosis.comparison import predicted
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.research.tables.study import Data, Study
from sdp_vs_penalty.research.tables.table import Row, Table, by_joint, makes
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRun
from sdp_vs_penalty.simulation.engines import comparison, engine_types
from sdp_vs_penalty.simulation.engines.comparison import Course, EngineRun

#: Time step along the real run [s].
MEASURED_STEP = 2e-3
#: The method whose links the engines get.
METHOD = "lmi-sdp"


@dataclass(frozen=True)
class EngineResult:
    """One engine, with its version, on one motion. run is None where it is absent or rejects the robot:
    status says so.

    torque_error (N, n) : engine less identified model on sinusoids; engine plus identified friction
    less measured torque on the real run, both below the torque filter's cut-off.
    """

    engine: str
    motion: str
    status: str
    run: EngineRun | None = None
    torque_error: Array | None = None
    inverse_error: float | None = None


def sinusoidal_runs(study: Study) -> list[EngineResult]:
    """Sinusoidal velocities over the range, with the links identified from the simulated run."""
    motion = comparison.sinusoids(study.problem.robot)
    return _played(study, study.simulated, motion, study.effort.duration, 1e-3)


def measured_runs(study: Study) -> list[EngineResult]:
    """The motion of the real run, with the links identified from it; empty without a real run."""
    data = study.measured
    if data is None:
        return []
    # Decimated: dense enough for splines through the positions.
    rows = FilteredRun(data.train, data.preprocessing).all_rows(data.model)
    theta = study.theta(METHOD, data).copy()
    theta[data.model.rigid_indices] = 0.0
    reference = rows.torque - predicted(rows, theta)
    t = rows.motion.t - rows.motion.t[0]
    out = _played(study, data, comparison.played(t, rows.motion.q), float(t[-1]), MEASURED_STEP)
    for k, result in enumerate(out):
        if result.run is not None:
            at = np.column_stack([np.interp(result.run.t, t, column) for column in reference.T])
            error = result.run.torque - at
            # From rest to the run's velocity, within the first 0.1 s, is no motion of the robot's.
            out[k] = replace(result, torque_error=error[result.run.t > 0.1])
    return out


def _played(
    study: Study, data: Data, motion: Course, duration: float, step: float
) -> list[EngineResult]:
    """Every engine with the links identified from a data set."""
    links, out = study.links(METHOD, data), []
    for name, kind in engine_types().items():
        version = kind.version()
        if version is None:
            out.append(EngineResult(name, data.label, f"absent ({kind.install})"))
            continue
        study.progress(f"engine {name}, {data.label} motion")
        try:
            run = comparison.play(kind, study.problem.robot, links, motion, duration, step)
            more = run, run.error, comparison.inverse_dynamics_error(kind, study.problem.robot, links)
            out.append(EngineResult(f"{name} {version}", data.label, "run", *more))
        except InputError as error:
            out.append(EngineResult(f"{name} {version}", data.label, f"rejected: {error}"))
    return out


@makes("V", "panda")
def engines(study: Study) -> Table:
    """Table V: physics engines with the identified model, published ones and those at hand.

    Rows: the paper's engines inside V-REP, then each of ours on simulated and real motion.
    """
    n, rows = study.problem.robot.n, []
    for row in study.problem.published["table_V"]:
        about = {"motion": "published (V-REP)", **_NO_RUN, "status": "published"}
        rows.append({**row, **by_joint([None] * n, "std_joint"), **about})
    rows += [_row(x, n) for x in (*study.once(sinusoidal_runs), *study.once(measured_runs))]
    formulations = "; ".join(f"{name}: {kind.formulation}" for name, kind in engine_types().items())
    return Table(
        f"Table V: physics engines with the identified {study.problem.title}",
        rows,
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
        digits=3,
    )


_NO_RUN: Row = dict.fromkeys(("position_error_mm", "angle_error_mrad", "inverse_dynamics_error"))


def _row(result: EngineResult, n: int) -> Row:
    error, run, figures = result.torque_error, result.run, _NO_RUN
    if run is not None:
        both = 1e3 * float(np.max(run.position)), 1e3 * float(np.max(run.angle))
        figures = dict(zip(_NO_RUN, (*both, result.inverse_error), strict=True))
    none = [None] * n
    torque = by_joint(none if error is None else map(np.mean, error.T))
    torque |= by_joint(none if error is None else map(np.std, error.T), "std_joint")
    about = {"motion": result.motion, **figures, "status": result.status}
    return {"engine": result.engine, **torque, **about}
