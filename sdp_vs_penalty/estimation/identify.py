"""From runs behind their filters to a certified estimate."""

import platform
import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import Infeasible, InputError
from sdp_vs_penalty.estimation.build_problem import (
    EstimationProblem,
    PoseOptions,
    pose_filtered,
    with_errors_of_constants,
)
from sdp_vs_penalty.estimation.certificate import Certificate
from sdp_vs_penalty.estimation.estimate import Estimate, Training
from sdp_vs_penalty.estimation.gains import drive_torque_errors
from sdp_vs_penalty.estimation.guessed_bodies import fit_in_bodies
from sdp_vs_penalty.estimation.link_figures import link_figures
from sdp_vs_penalty.estimation.output_error import OUTPUT_ERROR, refine
from sdp_vs_penalty.estimation.proofs import proved
from sdp_vs_penalty.estimation.sources import parameter_sources
from sdp_vs_penalty.estimation.uncertainty import (
    LateUncertainty,
    Uncertainty,
    regression_uncertainty,
)
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task, require_proof
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.black_box import BlackBox
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import ConstraintSet
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.motion import record_motion
from sdp_vs_penalty.solvers.fit import repair
from sdp_vs_penalty.solvers.proof import infeasibility_proof, write_proof
from sdp_vs_penalty.solvers.rigorous_bounds import violations
from sdp_vs_penalty.version import __version__


def build_estimate(
    posed: EstimationProblem, estimator: Estimator, fit: Fit, workers: Workers = ALONE
) -> Estimate:
    """Certify a fit and collect everything that made it in an Estimate.

    Parameters
    ----------
    posed : EstimationProblem
        Optimisation problem and its data.
    workers : Workers
        Processes that compress the columns of the shape constants.

    Returns
    -------
    Estimate
        With certificate and intervals; the intervals of runs that are not long are
        worked out when they are first read.
    """
    problem = posed.problem
    task = posed.task
    measurements = posed.measurements
    runs = posed.runs
    theta, certificate = certify(task, fit)
    certificate = replace(certificate, **link_figures(problem, theta[task.links]))
    sources = parameter_sources(
        task,
        theta,
        task.base,
        estimator.undetermined_by,
        nominal=problem.nominal(task.model),
    )
    is_feasible = certificate.worst == 0.0
    uncertainty_of = partial(_uncertainty, posed, theta, is_feasible, sources)
    # A model must not keep a long recording alive.
    is_long = runs is not None and runs.are_long
    uncertainty = (
        uncertainty_of(workers) if is_long else LateUncertainty(uncertainty_of)
    )
    settings = {**asdict(estimator), "weighting": posed.weighting}  # type: ignore[call-overload]
    bounds = (
        () if fit.multipliers is None else on_bounds(fit.problem.constraints, theta)
    )
    report = replace(posed.report, of_method=fit.details, on_bounds=bounds, **sources)
    if report.servo is not None:
        errors = drive_torque_errors(
            task.model, theta, uncertainty.covariance, posed.regression
        )
        report = replace(
            report, servo=replace(report.servo, torque_error=tuple(errors))
        )
    provenance = {
        "seed": task.seed,
        "data_hash": measurements.data_hash,
        "runs": list(measurements.names),
        "samples": measurements.samples,
        "versions": versions(),
    }
    for name in ("torque_unit", "reading"):  # which a black box does not have
        if stated := getattr(measurements, name, ""):
            provenance[name] = stated
    return Estimate(
        problem=problem,
        model=task.model,
        theta=theta,
        uncertainty=uncertainty,
        method=estimator.name,
        certificate=certificate,
        preprocessing=problem.preprocessing if runs is None else runs.settings,
        settings=settings,
        report=report,
        provenance=provenance,
        training_motion=None if runs is None else record_motion(runs),
        training=None if runs is None or is_long else Training(posed),
    )


def _uncertainty(
    posed: EstimationProblem,
    theta: Array,
    is_feasible: bool,
    sources: Mapping[str, Any],
    workers: Workers = ALONE,
) -> Uncertainty:
    """Return the intervals and the covariance of an estimate theta (p,).

    - ``is_feasible``: whether theta satisfies all constraints, as its intervals do
      then.
    - ``sources``: what determines each parameter.
    - ``workers``: processes that compress the columns of the shape constants.
    """
    task = posed.task
    return (
        regression_uncertainty(
            task,
            posed.regression,
            task.base,
            theta,
            wide=with_errors_of_constants(posed, theta, workers),
            constrained=is_feasible,
            gain_errors=posed.gain_errors,
        )
        .agreeing_with_sources(**sources)
        .in_unit(getattr(posed.measurements, "torque_unit", ""))
    )


def on_bounds(constraints: ConstraintSet, theta: Array) -> tuple[str, ...]:
    """List the masses, extents and ranges that lie on their bounds.

    There the bound determines the value, not the data.

    Returns
    -------
    tuple of str
        Such as "mass of link 3".
    """
    families = ("mass", "bounding ellipsoid", "body", "range")
    return tuple(
        f"{c.family} of {c.name}"
        for c in constraints.convex
        if c.family in families and c.is_reached(theta)
    )


def certify(task: Task, fit: Fit) -> tuple[Array, Certificate]:
    """Repair the estimate where the method promises feasibility, and certify it.

    Returns
    -------
    (p,) array
        theta, moved into the feasible set if the fit has multipliers and an interior
        point.
    Certificate
        Violations and loss; for a convex method also the gap to the optimum.
    """
    theta = fit.theta
    constraints = fit.problem.constraints
    # Only with the multipliers of a convex method is there an optimum to certify.
    interior = None if fit.multipliers is None else fit.interior
    if interior is not None:
        theta = repair(constraints, theta, interior)
    # A solver holds what is known to its own accuracy, which nothing else depends on.
    theta = task.model.with_known(theta)
    certificate = Certificate(violations(constraints, theta), task.data.loss(theta))
    if interior is None:
        return theta, certificate
    # The bounds of an unchanged fit are computed already (cached properties).
    is_unchanged = np.array_equal(theta, fit.theta)
    certified = fit if is_unchanged else replace(fit, theta=theta)
    bounds = {name: getattr(certified, name) for name in ("upper", "lower", "gap")}
    return theta, replace(certificate, **bounds)


def certify_beside(
    estimate: Estimate, model: Model, theta: Array, part: Certificate
) -> Certificate:
    """Certify a whole model of which only the last effects were optimised.

    All constraints of the problem are evaluated at the whole theta. Constraints of the
    method alone (a smallest thickness) keep the violations of their own fits.

    Parameters
    ----------
    estimate : Estimate
        The model that was extended.
    model : Model
        The whole model, which begins with the estimate's effects.
    theta : (p,) array
        Parameters of the whole model.
    part : Certificate
        Certificate of the new effects; its objective and gap stay.
    """
    own_violations = violations(estimate.problem.constraints(model), theta)
    return replace(
        part,
        violations={
            **estimate.certificate.violations,
            **part.violations,
            **own_violations,
        },
        certifies="",
        held=[effect.text for effect in estimate.model.effects],
        **link_figures(estimate.problem, estimate.links),
    )


def versions() -> dict[str, str]:
    """Return the versions of this package, Python, and the imported numerical packages.

    Packages that are not imported took no part in a result and are left out.
    """
    found = {"sdp_vs_penalty": __version__, "python": platform.python_version()}
    for module in ("pinocchio", "numpy", "scipy", "clarabel", "cvxpy"):
        if module in sys.modules:
            package = "pin" if module == "pinocchio" else module
            found[package] = sys.modules[module].__version__
    return found


def estimate_parameters(
    problem: Problem,
    data: FilteredRuns | BlackBox,
    method: str | Estimator = DEFAULT_METHOD,
    options: PoseOptions | None = None,
    *,
    proof: str | Path | None = None,
) -> Estimate:
    """Identify a problem from filtered runs by one method, with a certificate.

    :func:`sdp_vs_penalty.identify` calls this once runs are read, checked and filtered
    (:func:`~sdp_vs_penalty.estimation.build_problem.read_and_filter`).

    Parameters
    ----------
    problem : Problem
        Robot, bounds and nominal links.
    data : FilteredRuns or BlackBox
        Measurements behind their filters, or answers of a black box.
    options : PoseOptions, optional
        Effects, filters, weighting and further choices.
    proof : str or Path, optional
        File for the proof of optimality, or of infeasibility.

    Raises
    ------
    InputError
        For a method that these data or the proof do not suit; Infeasible (a subclass)
        if nothing satisfies all constraints.
    """
    options = options or PoseOptions()
    by_simulation = method == OUTPUT_ERROR
    estimator = make_estimator(DEFAULT_METHOD if by_simulation else method)
    _require_suitable(estimator, by_simulation, data, proof is not None)
    posed = pose_filtered(problem, data, options)
    options.progress(f"estimating by {estimator.name}")
    try:
        posed, fit = _fit(posed, estimator)
    except Infeasible as error:
        if proof is not None and error.proof:
            write_proof(infeasibility_proof(*error.proof), proof)
        raise
    estimate = build_estimate(posed, estimator, fit, options.workers)
    if by_simulation:
        refined, refined_fit = refine(estimate, posed, estimator)
        estimate = build_estimate(refined, estimator, refined_fit)
        estimate = replace(estimate, method=OUTPUT_ERROR)
    if proof is not None:  # never by simulation: _require_suitable
        options.progress("proving the optimum")
        made_of = {"model": estimate.identity, "data": estimate.provenance["data_hash"]}
        optimum = proved(posed.task, fit, estimate.theta, estimate.method, made_of)
        write_proof(optimum, proof)
    return estimate


def estimate_posed(posed: EstimationProblem, method: str | Estimator) -> Estimate:
    """Identify a model from a posed problem of a log with torque, without a verdict.

    Several methods may share the posed problem: its shape constants and compressed rows
    are worked out once.
    """
    estimator = make_estimator(method)
    # A copy of the task: the original may hold cached results of another method.
    posed = replace(posed, task=replace(posed.task))
    posed, fit = _fit(posed, estimator)
    return build_estimate(posed, estimator, fit)


def _fit(
    posed: EstimationProblem, estimator: Estimator
) -> tuple[EstimationProblem, Fit]:
    """Return a posed problem with the bodies that its data ask for, and its estimate."""
    task, fit = fit_in_bodies(posed.task, estimator)
    require_proof(estimator, fit)
    if task is posed.task:
        return posed, fit
    problem = replace(posed.problem, bodies=task.link_bodies)
    return replace(posed, problem=problem, task=task), fit


def _require_suitable(
    estimator: Estimator,
    by_simulation: bool,
    data: FilteredRuns | BlackBox,
    with_proof: bool,
) -> None:
    """Raise InputError if the method needs other data, or has no optimum to prove.

    ``by_simulation``: the method minimises the error of a forward simulation.
    """
    is_black_box = isinstance(data, BlackBox)
    remedy = "choose another method, or leave the proof out"
    if estimator.needs_black_box and not is_black_box:
        what = (
            f"method {estimator.name} needs a black box's .npz of q, gravity and"
            " mass_matrix"
        )
        raise InputError(what, remedy)
    if by_simulation and with_proof:
        what = (
            "proof: a simulation's error is not convex: leave it out, or take lmi-sdp"
        )
        raise InputError(what, remedy)
    if is_black_box and with_proof:
        what = "proof: a black box's answers are fitted without constraints"
        raise InputError(what, remedy)
    if not by_simulation:
        return
    if isinstance(data, BlackBox):
        raise InputError(f"method {OUTPUT_ERROR} needs measured runs", remedy)
    data.measurements.require_torque(f"method {OUTPUT_ERROR}")
