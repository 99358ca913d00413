"""The verb ``identify``: from a problem and measurements to a certified estimate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import check_plausible
from sdp_vs_penalty.data.sources import Source, as_measurements
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import Infeasible, InputError, other_robot
from sdp_vs_penalty.estimation.certify import build_estimate, proved
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.fit_shapes import estimate_shapes
from sdp_vs_penalty.estimation.known_load import gains_from_loads, independent_gains
from sdp_vs_penalty.estimation.output_error import OUTPUT_ERROR, refine
from sdp_vs_penalty.estimation.shape_profiles import with_shapes
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Progress, Task, no_progress
from sdp_vs_penalty.estimators.task import make_task
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.black_box import BlackBox, as_black_box, compress_black_box
from sdp_vs_penalty.regression.regression import Regression, compress
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.solvers.proof import infeasibility_proof, write_proof


def identify(
    problem: str | Path | Problem,
    measurements: Source | BlackBox,
    method: str | Estimator = DEFAULT_METHOD,
    *,
    effects: str | Sequence[str] | Sequence[Effect] | None = None,
    preprocessing: Preprocessing | None = None,
    weighting: str = "noise",
    seed: int = 0,
    progress: Progress = no_progress,
    proof: str | Path | None = None,
    gain_uncertainty: float | Array = 0.0,
    known_loads: Sequence[tuple[Source, float]] = (),
    workers: Workers = ALONE,
) -> Estimate:
    """Identify a robot's dynamic parameters from measurements, or from a black box's answers.

    problem : a built-in name, a folder with a problem.toml, a URDF file, or a Problem.
    measurements : whatever :func:`~sdp_vs_penalty.data.sources.as_measurements` takes: paths, arrays,
        a DataFrame, Measurements, a list of runs; or a BlackBox, or the path of its .npz file.
    method : a name (`sdp-vs-penalty list methods`) or an Estimator with its own settings; "output-error"
        refines the default method's estimate by simulation (:mod:`~estimation.output_error`).
    effects : names or Effects (default: the problem's); the velocity over which Coulomb friction turns
        round is estimated joint by joint, where motion left out confirms it, unless it is given
        (``coulomb_friction@v_s=``).
    preprocessing : filter settings (default: the problem's); weighting : "noise" divides each joint's
        rows by its residual in a first least-squares pass, "none" leaves newton metres of all joints
        equal; seed : of everything random; progress : hears where the computation stands; proof : a
        file to write the proof of optimality to, or that nothing satisfies all constraints
        (:mod:`~sdp_vs_penalty.solvers.proof`).
    gain_uncertainty : relative standard deviation of the torque channels' gains (0.01: known to a
        per cent), or a factor (n, e) of their covariance, which widens the intervals; known_loads :
        further runs, each with the mass [kg] that the last link carried in it, which determine the
        gains (:mod:`~sdp_vs_penalty.estimation.known_load`): the parameters are
        then in true units, and the problem of the estimate keeps the gains; workers : who compresses the
        runs (:class:`~sdp_vs_penalty.parallel.Workers`); the estimate is the same to the last bit.
    A BlackBox knows no friction, filters or noise: its one effect is rigid_body, and no weighting
    applies; ``reverse-engineering`` takes nothing else, every other method takes it too.
    Returns an Estimate with a certificate. Raises InputError for input that cannot be used.
    """
    problem, refined = as_problem(problem, "identify(problem=...)"), method == OUTPUT_ERROR
    estimator = make_estimator(DEFAULT_METHOD if refined else method)
    if refined and proof is not None:
        raise InputError("proof: a simulation's error is not convex", "leave it out, or take lmi-sdp")
    measurements = _usable(problem, measurements, estimator, proof is not None)
    if isinstance(measurements, BlackBox):
        if refined:
            raise InputError(f"method {OUTPUT_ERROR} needs measured runs", "choose another method")
        return _identify_black_box(problem, measurements, estimator, effects, seed, progress)
    model = problem.model(effects)
    settings = (preprocessing or problem.preprocessing).resolve(measurements)
    progress("estimating shape constants")
    shapes = estimate_shapes(model, measurements, settings, weighting, workers=workers)
    model = replace(model, effects=with_shapes(model.effects, shapes))
    errors = independent_gains(gain_uncertainty, problem.robot.n)
    details: dict[str, Any] = {"shapes": [s.to_dict() for s in shapes]} if shapes else {}
    if known_loads:
        progress("determining the gains from the known loads")
        prior = float(np.max(gain_uncertainty))
        found = gains_from_loads(model, measurements, known_loads, settings, prior)
        problem = replace(problem, gains=tuple(found.gain.tolist()))
        model, errors = replace(model, gains=problem.gains), found.factor
        details["gains"] = found.to_dict()
    if model.needs_reference:

        def compressed(part: Model) -> Regression:
            return compress(measurements, part, settings, workers=workers)

        model = with_reference(problem, model, compressed, weighting, progress)
    progress("compressing the measurements")
    regression = compress(measurements, model, settings, workers=workers)
    task = make_task(problem, model, regression, weighting, seed, progress)
    fit = _fitted(task, estimator, proof)
    estimate = build_estimate(
        problem, task, estimator, fit, regression, settings, measurements, weighting, errors, workers
    )
    if refined:
        estimate = refine(estimate, measurements, estimator, regression, weighting, seed, progress)
    estimate = replace(estimate, details={**estimate.details, **details})
    if proof is not None:
        progress("proving the optimum")
        write_proof(proved(task, fit, estimate), proof)
    return estimate


def _fitted(task: Task, estimator: Estimator, proof: str | Path | None) -> Fit:
    """What the estimator makes of it; a proof is written where nothing satisfies all constraints."""
    task.progress(f"estimating by {estimator.name}")
    try:
        return estimator.fit(task)
    except Infeasible as error:
        if proof is not None and error.proof:
            write_proof(infeasibility_proof(*error.proof, task.bound), proof)
        raise


def _usable(
    problem: Problem, measurements: Source | BlackBox, estimator: Estimator, proof: bool
) -> Measurements | BlackBox:
    """What was given as measurements, read; InputError where problem, method and data do not fit."""
    n, names = problem.robot.n, problem.robot.joint_names
    if not isinstance(measurements, BlackBox):
        measurements = as_black_box(measurements, n) or as_measurements(
            measurements, n, names, "identify(measurements=...)"
        )
    if measurements.n != n:
        raise other_robot(measurements.n, n, f"measurements for {problem.name}")
    if isinstance(measurements, BlackBox):
        if proof:
            what = "proof: a black box's answers are fitted without constraints"
            raise InputError(what, "leave it out")
        return measurements
    if estimator.needs_black_box:
        raise InputError(
            f"method {estimator.name} needs a black box's .npz of q, gravity and mass_matrix",
            "choose another method for measured runs",
        )
    check_plausible(problem.robot, measurements)
    return measurements


def _identify_black_box(
    problem: Problem,
    box: BlackBox,
    estimator: Estimator,
    effects: str | Sequence[str] | Sequence[Effect] | None,
    seed: int,
    progress: Progress,
) -> Estimate:
    model = problem.model("rigid_body" if effects is None else effects)
    progress("compressing the black box's answers")
    regression = compress_black_box(box, model)
    task = make_task(problem, model, regression, "none", seed, progress)
    fit = _fitted(task, estimator, None)
    settings = problem.preprocessing
    return build_estimate(problem, task, estimator, fit, regression, settings, box, "none")


def with_reference(
    problem: Problem,
    model: Model,
    compressed: Callable[[Model], Regression],
    weighting: str = "noise",
    progress: Progress = no_progress,
    passes: int = 2,
) -> Model:
    """The model with the current model that its torque-dependent effects refer to.

    Least squares without those effects, then ``passes - 1`` times with them: the reference is what
    the other effects are estimated to be when these have taken their share. compressed : the training
    data in the columns of a model.
    """
    reference = np.zeros(len(model.parameters))
    for k in range(passes):
        progress(f"the current model, pass {k + 1} of {passes}")
        part = model.reference_free if k == 0 else replace(model, reference=reference)
        regression = compressed(part)
        theta = make_task(problem, part, regression, weighting).ols
        free = theta if k == 0 else theta[model.reference_free_indices]
        reference = np.zeros(len(model.parameters))
        reference[model.reference_free_indices] = free
    return replace(model, reference=reference)
