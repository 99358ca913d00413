"""EMPS table: the public nonlinear benchmark, by force along a motion and by simulated
position."""

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import PoseOptions, read_and_filter
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.identify import estimate_parameters
from sdp_vs_penalty.estimation.output_error import OUTPUT_ERROR
from sdp_vs_penalty.estimation.resampling import cross_validate
from sdp_vs_penalty.estimators import DEFAULT_METHOD
from sdp_vs_penalty.paper.tables.study import FOLDS, Study, torque_errors
from sdp_vs_penalty.paper.tables.table import Row, StudyTable, notes, register_table
from sdp_vs_penalty.problem.published import VARIABLE, measured_runs
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRuns

#: What the simulation is refined with: of the effects tried on halves of the tracking
#: run alone, the one whose free run on the other half improved most for one parameter
#: more.
REFINED = ("asymmetric_viscous_friction",)


@register_table("emps", "emps", slow=True)
def emps(study: Study) -> StudyTable:
    """EMPS table: the public nonlinear benchmark, by force along a motion and by
    simulated position.

    Every estimate is a mass and friction constants of one prismatic axis. It is judged
    by the force error on both public files, and by the position that it gives when the
    measured force drives it.

    Parameters
    ----------
    study : Study
        The robot's data sets and every method's estimate, computed on demand.

    Returns
    -------
    StudyTable
        Rows of the authors' values and of our methods; notes.
    """
    runs_found = measured_runs(study.problem.name)
    if not runs_found:
        raise InputError(
            "table emps is about measurements that are not at hand",
            f"name the folder that holds emps/ by {VARIABLE}",
        )
    tracking = runs_found["tracking"]
    pulses = runs_found["pulses"]
    # The authors' least-squares values: M [kg], F_v [N s/m], F_c [N], offset [N], and
    # viscous friction's difference between the directions [N s/m], which their model
    # lacks.
    authors = 95.1089, 203.5034, 20.3935, -3.1648, 0.0
    rows = [_row(study, "authors, least squares", authors, tracking, pulses)]
    filtered = read_and_filter(study.problem, tracking)
    # Least squares and the default method, with the authors' four parameters.
    for method in dict.fromkeys(("ols", DEFAULT_METHOD)):
        study.progress(f"EMPS by {method}")
        options = PoseOptions(seed=study.seed)
        estimate = estimate_parameters(study.problem, filtered, method, options)
        unseen = cross_validate(
            study.problem, tracking, method, folds=FOLDS, seed=study.seed
        ).relative_error_percent
        constants = _constants(estimate)
        rows.append(_row(study, method, constants, tracking, pulses, unseen))
    # A fifth parameter: viscous friction that differs with the direction.
    effects = (*study.problem.default_effects, *REFINED)
    for method in (DEFAULT_METHOD, OUTPUT_ERROR):
        study.progress(f"EMPS by {method}, five parameters")
        options = PoseOptions(effects=effects, seed=study.seed)
        estimate = estimate_parameters(study.problem, filtered, method, options)
        name = f"{method}, asymmetric"
        rows.append(_row(study, name, _constants(estimate), tracking, pulses))
    return StudyTable(
        "EMPS, the electro-mechanical positioning system of nonlinearbenchmark.org",
        rows,
        notes("emps", folds=FOLDS, method=OUTPUT_ERROR),
        caption=(
            "Measured: both public files, 24.8 s at 1 kHz each; estimated from the"
            " first (tracking), judged on both. The second follows the same reference"
            " with force pulses."
        ),
    )


def _row(
    study: Study,
    estimate: str,
    constants: tuple[float, ...],
    tracking: Measurements,
    pulses: Measurements,
    unseen: float | None = None,
) -> Row:
    """Return a row: the constants, and the errors of force and simulated position.

    Parameters
    ----------
    constants : tuple of float
        Mass [kg], viscous friction [N s/m], Coulomb friction [N], offset [N], and the
        asymmetry of viscous friction [N s/m].
    tracking, pulses : Measurements
        The two public runs, on each of which errors are computed.
    unseen : float, optional
        Cross-validated relative error of the force [%].
    """
    model = study.problem.model((*study.problem.default_effects, *REFINED))
    theta = np.zeros(len(model.parameters))
    theta[model.rigid_indices[0]] = constants[0]
    theta[np.delete(np.arange(len(theta)), model.rigid_indices)] = constants[1:]
    settings = study.problem.preprocessing.resolve(tracking)
    names = (
        "mass_kg",
        "viscous_N_s_per_m",
        "coulomb_N",
        "offset_N",
        "asymmetric_N_s_per_m",
    )
    forces: Row = {}
    positions: Row = {}
    for name, run in (("tracking", tracking), ("pulses", pulses)):
        rows = compress(FilteredRuns.filtering(run, settings), model)
        forces[f"force_error_{name}_percent"] = torque_errors(rows, theta)[1]
        error = simulated(run, constants) - run.q[:, 0]
        positions[f"position_rmse_{name}_mm"] = 1e3 * float(np.sqrt(np.mean(error**2)))
    return {
        "estimate": estimate,
        **dict(zip(names, constants, strict=True)),
        **forces,
        **positions,
        "unseen_force_error_percent": unseen,
        "data": "measured",
    }


def _constants(estimate: Estimate) -> tuple[float, ...]:
    """Return mass, viscous and Coulomb friction, offset and asymmetry of an estimate.

    Constants that its model lacks are zero.
    """
    mass = float(estimate.links[0, 0])
    others = np.delete(estimate.theta, estimate.model.rigid_indices).tolist()
    missing = [0.0] * (4 - len(others))
    return mass, *others, *missing


def simulated(
    run: Measurements, constants: tuple[float, ...], substeps: int = 4
) -> Array:
    """Simulate the position (N,) [m] of the axis from the measured force alone.

    Dry friction is integrated implicitly, so that the axis can stick.

    Parameters
    ----------
    run : Measurements
        Its force drives the model.
    constants : tuple of float
        Mass [kg], viscous friction [N s/m], Coulomb friction [N], offset [N], asymmetry
        of viscous friction [N s/m].
    substeps : int
        Number of steps within a sample of the log.
    """
    mass, viscous, coulomb, offset, asymmetric = constants
    q = float(run.q[0, 0])
    v = 0.0
    out = np.empty(len(run.t))
    steps = np.diff(run.t, append=2.0 * run.t[-1] - run.t[-2]) / substeps
    for k, (force, h) in enumerate(
        zip(run.tau[:, 0].tolist(), steps.tolist(), strict=True)
    ):
        out[k] = q
        for _ in range(substeps):
            # Without dry friction, which then slows it down, at most to rest.
            without_friction = (
                v + h * (force - offset - viscous * v - asymmetric * abs(v)) / mass
            )
            v = np.sign(without_friction) * max(
                abs(without_friction) - h * coulomb / mass, 0.0
            )
            q += h * v
    return out
