"""From runs behind their filters to a certified estimate, and ``verify``: what a proof
proves, and whether it is of this model and these data.

Who determines a parameter (:func:`parameter_sources`): of a linear function a^T theta
the data alone know the variance a^T H^-1 a, H = R^T R in units of the residual variance
(infinite where no torque shows it), the prior alone a^T H_prior^-1 a. H_prior is one
independent measurement a link: 1/2 P0^-1 (x) P0^-1, the curvature of the entropic pull
at the nominal robot P0, and of the joints' own parameters one over their scale squared.
It is from the data where their variance is the smaller one.
"""

import platform
import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import Infeasible, InputError
from sdp_vs_penalty.estimation.build_problem import (
    EstimationProblem,
    PoseOptions,
    build_problem,
    in_columns,
    pose_filtered,
)
from sdp_vs_penalty.estimation.certificate import Certificate
from sdp_vs_penalty.estimation.estimate import Estimate, Training
from sdp_vs_penalty.estimation.gains import with_torque_error
from sdp_vs_penalty.estimation.link_figures import link_figures
from sdp_vs_penalty.estimation.output_error import OUTPUT_ERROR, refine
from sdp_vs_penalty.estimation.sensitivity import with_sensitivities
from sdp_vs_penalty.estimation.uncertainty import (
    LateUncertainty,
    Uncertainty,
    of_regression,
)
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.estimator import (
    Estimator,
    Fit,
    Progress,
    Task,
    no_progress,
    sample_variance,
)
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.files import reading
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import BaseParameters, base_rows
from sdp_vs_penalty.regression.black_box import BlackBox
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import ConstraintSet
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.motion import record_motion
from sdp_vs_penalty.solvers import verify_proof
from sdp_vs_penalty.solvers.fit import repair
from sdp_vs_penalty.solvers.proof import (
    Proof,
    difference,
    infeasibility_proof,
    optimum_proof,
    stated,
    write_proof,
)
from sdp_vs_penalty.solvers.rigorous_bounds import TIGHT, violations
from sdp_vs_penalty.version import __version__

DATA = "data"


def parameter_sources(
    task: Task, theta: Array, base: BaseParameters, undetermined_by: str, nominal: Array
) -> dict[str, Any]:
    """Return what determines each standard and base parameter, as fields of an
    estimate's details.

    Parameters
    ----------
    undetermined_by : str
        What decides where the data do not: "prior" or "bounds"
        (:attr:`Estimator.undetermined_by`).
    nominal : (p,) array
        Parameters as the robot's file states them.

    Returns
    -------
    dict
        "undetermined": source by name of each standard parameter that the data do not
        determine; "base_parameters": name, value, nominal value and source of each.
    """
    # Standard parameters are linear functions of theta, too: first them, then the base.
    rows = np.vstack([np.eye(len(theta)), base.rows])
    names = [*(p.name for p in task.model.parameters), *base.names]
    entries = []
    for name, is_determined, value, stated_value in zip(
        names,
        is_data_determined(task, rows).tolist(),
        (rows @ theta).tolist(),
        (rows @ nominal).tolist(),
        strict=True,
    ):
        source = DATA if is_determined else undetermined_by
        if name in task.model.known:
            source = "given"
        entries.append(
            {"name": name, "value": value, "nominal": stated_value, "source": source}
        )
    standard = entries[: len(theta)]
    return {
        "undetermined": {
            entry["name"]: entry["source"]
            for entry in standard
            if entry["source"] != DATA
        },
        "base_parameters": entries[len(theta) :],
    }


def is_data_determined(task: Task, rows: Array) -> NDArray[np.bool_]:
    """Return whether the data determine linear functions of theta better than the
    prior.

    The data alone know a' theta with the variance a' H^-1 a, H = R' R over the residual
    variance; the prior with a' H_prior^-1 a. H_prior is one measurement a link (the
    curvature of the entropic pull at the nominal pseudo-inertia P0), and 1 / scale^2
    for the parameters of joints. The data determine the function if their variance is
    smaller.

    Returns
    -------
    (b,) array of bool
        True where the data determine a function.
    """
    variance = max(sample_variance(task), 1e-18 * task.data.tau_squared) or 1.0
    scale = task.bound if task.joint_scale is None else task.joint_scale
    # Root of the prior's information: upper triangular, half^T half = H_prior.
    half = np.diag(np.sqrt(variance) / np.where(np.isfinite(scale), scale, task.bound))
    for indices, p0 in zip(
        task.links, inertia.pseudo_inertia(task.prior_links), strict=True
    ):
        root = np.linalg.inv(np.linalg.cholesky(p0))
        whitened = (root @ inertia.PSEUDO_INERTIA_BASIS @ root.T).reshape(10, 16)
        # -log det has the curvature |P0^-1 dP|^2 / 2 beside |R theta|^2.
        curvature = 0.5 * LmiSdp.entropy * variance * (whitened @ whitened.T)
        # Unit diagonal before the factorisation: masses and moments differ by 1e6.
        size = np.sqrt(np.diagonal(curvature))
        upper = scipy.linalg.cholesky(curvature / np.outer(size, size)) * size
        half[np.ix_(indices, indices)] = upper
    # In coordinates z = half theta the prior's information is the identity, and that of
    # the data A^T A with A = R half^-1.
    inverse_half = scipy.linalg.solve_triangular(half, np.eye(len(half)), lower=False)
    _, s, vt = np.linalg.svd(task.data.R @ inverse_half, full_matrices=True)
    information = np.zeros(len(half))  # of the data, along each singular direction
    information[: len(s)] = s**2
    weight = (rows @ inverse_half @ vt.T) ** 2
    # Directions that no torque shows have next to no information: 1e-12 of the prior's.
    variance_by_data = weight @ (1.0 / np.maximum(information, 1e-12))
    variance_by_prior = weight.sum(axis=1)
    return np.asarray(variance_by_data < variance_by_prior)


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
    base = base_rows(problem, task.model)
    is_feasible = certificate.worst == 0.0
    sources = parameter_sources(
        task,
        theta,
        base,
        estimator.undetermined_by,
        nominal=problem.nominal(task.model),
    )
    uncertainty_of = partial(_uncertainty, posed, base, theta, is_feasible, sources)
    # A model must not keep a long recording alive.
    if runs is not None and runs.are_long:
        uncertainty = uncertainty_of(workers)
    else:
        uncertainty = LateUncertainty(uncertainty_of)
    bounds = [] if fit.multipliers is None else on_bounds(fit.constraints, theta)
    settings = {**asdict(estimator), "weighting": posed.weighting}  # type: ignore[call-overload]
    details = {**fit.details, "on_bounds": bounds, **sources}
    provenance = {
        "seed": task.seed,
        "data_hash": measurements.data_hash,
        "runs": list(measurements.names),
        "samples": measurements.samples,
        "versions": versions(),
    }
    if isinstance(measurements, Measurements) and measurements.torque_unit:
        provenance["torque_unit"] = measurements.torque_unit
    return Estimate(
        problem=problem,
        model=task.model,
        theta=theta,
        uncertainty=uncertainty,
        method=estimator.name,
        certificate=certificate,
        preprocessing=problem.preprocessing if runs is None else runs.settings,
        settings=settings,
        details=details,
        provenance=provenance,
        training_motion=None if runs is None else record_motion(runs),
        # A model must not keep a long recording alive.
        training=None if runs is None or runs.are_long else Training(posed),
    )


def _uncertainty(
    posed: EstimationProblem,
    base: BaseParameters,
    theta: Array,
    is_feasible: bool,
    sources: Mapping[str, Any],
    workers: Workers = ALONE,
) -> Uncertainty:
    """Return the intervals and the covariance of an estimate theta (p,).

    base : its base parameters; is_feasible : whether theta satisfies all constraints,
    as its intervals do then; sources : what determines each parameter; workers :
    compress the columns of the shape constants.
    """
    task = posed.task
    wide = None
    model_with_constants = with_sensitivities(task.model, theta)
    if model_with_constants is not task.model and posed.runs is not None:
        wide = in_columns(posed.runs, model_with_constants, workers)
    return of_regression(
        task,
        posed.regression,
        base,
        theta,
        wide=wide,
        constrained=is_feasible,
        gain_errors=posed.gain_errors,
    ).named_by_sources(sources)


def proved(
    task: Task,
    fit: Fit,
    theta: Array,
    method: str,
    made_of: Mapping[str, str] | None = None,
) -> Proof:
    """Build the proof that theta's objective is within its interval of the optimum.

    Parameters
    ----------
    fit : Fit
        The method's solution with its multipliers.
    made_of : mapping of str to str, optional
        Hashes of model and data, which the proof names.

    Raises
    ------
    InputError
        For a method without a lower bound (not convex, or without constraints).
    """
    if fit.multipliers is None:
        what = f"method {method} has no lower bound to prove"
        raise InputError(
            what, "choose one that solves the SDP, such as lmi-sdp, or penalty"
        )
    certified = replace(fit, theta=theta, bound=task.bound)
    return optimum_proof(certified, [p.name for p in task.model.parameters], made_of)


def on_bounds(constraints: ConstraintSet, theta: Array) -> list[str]:
    """List the masses, extents and ranges that lie on their bounds.

    There the bound determines the value, not the data.

    Returns
    -------
    list of str
        Such as "mass of link 3".
    """
    active = []
    for c in constraints.convex:
        if c.family in ("mass", "bounding ellipsoid", "body", "range"):
            # A constraint is active if its value is a millionth of its terms.
            terms = np.abs(c.coefficients.T) @ np.abs(theta[c.indices])
            size = np.abs(c.constant) + terms
            if np.any(c.value(theta) <= 1e-6 * size):
                active.append(f"{c.family} of {c.name}")
    return active


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
    if fit.multipliers is not None and fit.interior is not None:
        theta = repair(fit.constraints, theta, fit.interior)
    # A solver holds what is known to its own accuracy, which nothing else depends on.
    theta = task.model.with_known(theta)
    certificate = Certificate(violations(fit.constraints, theta), task.data.loss(theta))
    if fit.multipliers is not None and fit.interior is not None:
        # The bounds of an unchanged fit are computed already (cached properties).
        is_unchanged = np.array_equal(theta, fit.theta) and fit.bound is not None
        certified = fit if is_unchanged else replace(fit, theta=theta, bound=task.bound)
        certificate = replace(
            certificate, upper=certified.upper, lower=certified.lower, gap=certified.gap
        )
    return theta, certificate


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
    module_by_package = {"pin": "pinocchio"}
    module_by_package |= {
        name: name for name in ("numpy", "scipy", "clarabel", "cvxpy")
    }
    by_package = {"sdp_vs_penalty": __version__, "python": platform.python_version()}
    return by_package | {
        package: sys.modules[module].__version__
        for package, module in module_by_package.items()
        if module in sys.modules
    }


def estimate_parameters(
    problem: Problem,
    data: FilteredRuns | BlackBox,
    method: str | Estimator = DEFAULT_METHOD,
    options: PoseOptions | None = None,
    *,
    progress: Progress = no_progress,
    proof: str | Path | None = None,
    workers: Workers = ALONE,
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
    progress : callable
        Receives a line of text at each stage.
    proof : str or Path, optional
        File for the proof of optimality, or of infeasibility.
    workers : Workers
        Processes that compress the runs.

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
    posed = pose_filtered(problem, data, options, progress, workers)
    posed.task.progress(f"estimating by {estimator.name}")
    try:
        fit = estimator.fit(posed.task)
    except Infeasible as error:
        if proof is not None and error.proof:
            write_proof(infeasibility_proof(*error.proof, posed.task.bound), proof)
        raise
    estimate = build_estimate(posed, estimator, fit, workers)
    if by_simulation:
        linear, fit = refine(estimate, posed, estimator)
        estimate = replace(build_estimate(linear, estimator, fit), method=OUTPUT_ERROR)
    estimate = replace(estimate, details={**estimate.details, **posed.details})
    if "servo" in posed.details:
        estimate = with_torque_error(estimate, posed.regression)
    if proof is not None:
        progress("proving the optimum")
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
    estimate = build_estimate(posed, estimator, estimator.fit(posed.task))
    return replace(estimate, details={**estimate.details, **posed.details})


def _wider_than_certified(proof: Mapping[str, Any], model: Estimate) -> str:
    """Return a sentence if the proof's interval is wider than the model's certified
    one, else "".

    The two are computed in different arithmetic, so that a difference of TIGHT is
    allowed, as a share of the objective's size.
    """
    gap = verify_proof.relative_gap(proof)
    upper, lower = model.certificate.upper, model.certificate.lower
    if upper is None or lower is None:
        return ""
    width = float(Fraction(proof["upper"]) - Fraction(proof["lower"]))
    allowed = upper - lower
    if gap is not None and gap:
        allowed += TIGHT * width / float(gap)
    if width <= allowed:
        return ""
    return (
        f"its interval of {width:.1e} is wider than the {upper - lower:.1e} of the"
        " model's certificate"
    )


def _require_suitable(
    estimator: Estimator,
    by_simulation: bool,
    data: FilteredRuns | BlackBox,
    with_proof: bool,
) -> None:
    """Raise InputError if the method needs other data, or has no optimum to prove.

    ``by_simulation``: the method minimises the error of a forward simulation.
    """
    black_box = isinstance(data, BlackBox)
    remedy = "choose another method, or leave the proof out"
    if estimator.needs_black_box and not black_box:
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
    if black_box and with_proof:
        what = "proof: a black box's answers are fitted without constraints"
        raise InputError(what, remedy)
    if not by_simulation:
        return
    if isinstance(data, BlackBox):
        raise InputError(f"method {OUTPUT_ERROR} needs measured runs", remedy)
    data.measurements.require_torque(f"method {OUTPUT_ERROR}")


#: What a proof that is wrong in any way raises: a form or claim that does not hold, an
#: index out of range, an operation of numbers, too deep a nesting, too large a content.
_FAILURES_OF_PROOFS = (
    ValueError,
    LookupError,
    ArithmeticError,
    RecursionError,
    MemoryError,
)


def verify_proof_file(
    path: str | Path, model: Estimate | None = None, data: Source | None = None
) -> tuple[bool, str]:
    """Return whether the proof in a file holds and belongs to a model and its
    measurements, and what it proves or why it is refused.

    See :mod:`~sdp_vs_penalty.solvers.verify_proof`.

    Parameters
    ----------
    model : Estimate, optional
        Model to which it should belong.
    data : path, arrays, Measurements, optional
        Measurements from which the model was identified.

    Raises
    ------
    InputError
        For a file that cannot be read, and for measurements without a model.
    """
    if data is not None and model is None:
        raise InputError("verify(data=...) without a model", "give the model too")
    try:
        with reading(path, verify_proof.MAX_BYTES):
            proof = verify_proof.read(path)
        problems = verify_proof.check(proof)
    except InputError:
        raise
    except _FAILURES_OF_PROOFS as error:
        return False, f"refused: {path}: {error or type(error).__name__}"
    sentences = [f"accepted: {path}: {_what_is_proved(proof, problems)}"]
    if model is None:
        sentences.append("name --model and --data to see what the numbers are made of")
        fault = ""
    else:
        fault = _other_model(proof, model)
        sentences.append("it is of this model")
        if not fault and data is not None:
            runs = as_measurements(
                data, model.robot.n, model.robot.joint_names, "verify(data=...)"
            )
            fault, sentence = _other_data(proof, model, runs)
            sentences.append(sentence)
    if not fault and problems is not None:
        fault = verify_proof.weakness(proof)
        if not fault and model is not None:
            fault = _wider_than_certified(proof, model)
    if fault:
        return False, f"refused: {path}: {fault}"
    return True, "; ".join(sentences)


def _what_is_proved(
    proof: Mapping[str, Any], interval: tuple[Fraction, Fraction] | None
) -> str:
    """Return what a proof says of the numbers in its file, in a sentence.

    ``interval`` contains the smallest objective; None means that the proof shows that
    nothing satisfies the constraints.
    """
    if interval is None:
        claims = [c["name"] for c in proof["constraints"] if c["family"] == "claim"]
        with_claim = f" and have {claims[0]}" if claims else ""
        return f"no parameters satisfy all constraints{with_claim}, in exact arithmetic"
    low, high = map(float, interval)
    sentences = [
        f"the least objective lies in [{low!r}, {high!r}], in exact arithmetic"
    ]
    gap = verify_proof.relative_gap(proof)
    if gap is not None:
        sentences.append(f"its gap is {verify_proof.in_words(gap)} of the objective")
    sentences.append(
        "proved is this of the numbers in the file; that the model describes the robot"
        " is not"
    )
    return "; ".join(sentences)


def _other_data(
    proof: dict[str, Any], model: Estimate, runs: Measurements
) -> tuple[str, str]:
    """Compare a proof with measurements.

    Returns two sentences: how the proof differs from the problem that these
    measurements make ("" if it does not), and what was compared ("" if it differs).
    """
    if proof["data"] != runs.data_hash:
        return "it is of other measurements (or of another --window)", ""
    reposed = _reposed(model, runs)
    how = "make its numbers, constraints and bounds (recomputed in floating point)"
    if reposed is None:
        how = (
            "are the ones it names (its numbers, constraints and bounds were not"
            " recomputed)"
        )
    elif other := difference(proof, reposed):
        return f"these measurements make another problem: {other}", ""
    return "", f"these measurements {how}"


def _other_model(proof: Mapping[str, Any], model: Estimate) -> str:
    """Return a sentence on how a proof differs from a model, "" if it is of this model."""
    if proof["model"] != model.identity or "theta" not in proof:
        return "it is of another model"
    if proof["parameters"] != [p.name for p in model.model.parameters]:
        return "its parameters, or their order, are not the model's"
    theta = [Fraction(repr(x)) for x in model.theta.tolist()]
    if [Fraction(x) for x in proof["theta"]] != theta:
        return "its theta is not the model's"
    return ""


def posed_again(model: Estimate, data: Measurements) -> EstimationProblem | None:
    """Pose the optimisation problem of a model again, from measurements.

    None for a log without torque whose recipe (how the servos' law and scale were
    found) the model does not keep.
    """
    recipe = model.details.get("recipe")
    if recipe is None and not data.torque_logged:
        return None
    settings: dict[str, Any] = {
        "preprocessing": model.preprocessing,
        "weighting": model.weighting,
    }
    options = PoseOptions(model.model.effects, known=model.model.known, **settings)
    if recipe is not None:
        options = PoseOptions.following(recipe, model.robot, **settings)
    return build_problem(model.problem, data, options)


def _reposed(model: Estimate, data: Measurements) -> Proof | None:
    """State the optimisation problem of a model again, from its measurements.

    The result is compared with a proof. It is None for a method that solves no SDP, and
    for a log without torque whose recipe (how the servos' law and scale were found) the
    model does not keep.
    """
    estimator = model.estimator
    if not isinstance(estimator, LmiSdp):
        return None
    posed = posed_again(model, data)
    if posed is None:
        return None
    task = posed.task
    objective, constraints = estimator.posed(task)
    return stated(
        objective,
        constraints.convex,
        task.bound,
        [p.name for p in task.model.parameters],
    )
