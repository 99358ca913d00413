"""The verb ``identify``: from a problem and measurements to a certified estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from sdp_vs_penalty.data.files import Source
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.errors import Infeasible, InputError
from sdp_vs_penalty.estimation.certify import build_estimate, proved
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.output_error import OUTPUT_ERROR, refine
from sdp_vs_penalty.estimation.pose import PoseOptions, pose, readable
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Progress, Task, no_progress
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.black_box import BlackBox
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
    known: Mapping[str, float] | None = None,
    instruments: str | None = None,
    workers: Workers = ALONE,
) -> Estimate:
    """Identify a robot's dynamic parameters from measurements, or from a black box's answers.

    problem : a built-in name, a folder with a problem.toml, a URDF file, or a Problem.
    measurements : whatever :func:`~sdp_vs_penalty.data.files.as_measurements` takes: paths, arrays,
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
        then in true units, and the problem of the estimate keeps the gains; known : parameters of which
        the value is known, by name: without torque they set the scale ({"kp2": 600.0}); instruments :
        "command" or "none", default: the former where no torque was logged
        (:mod:`~sdp_vs_penalty.estimation.servo`); workers : who compresses the
        runs (:class:`~sdp_vs_penalty.parallel.Workers`); the estimate is the same to the last bit.
    A BlackBox knows no friction, filters or noise: its one effect is rigid_body, and no weighting
    applies; ``reverse-engineering`` takes nothing else, every other method takes it too.
    Returns an Estimate with a certificate. Raises InputError for input that cannot be used.
    """
    problem, refined = as_problem(problem, "identify(problem=...)"), method == OUTPUT_ERROR
    estimator = make_estimator(DEFAULT_METHOD if refined else method)
    measurements = readable(problem, measurements, "identify(measurements=...)")
    _check_method(estimator, refined, isinstance(measurements, BlackBox), proof is not None)
    chosen = effects, preprocessing, weighting, gain_uncertainty, known_loads, seed
    if refined and isinstance(measurements, Measurements):
        measurements.require_torque(f"method {OUTPUT_ERROR}")
    options = PoseOptions(*chosen, known or {}, instruments)
    posed = pose(problem, measurements, options, progress, workers)
    fit = _fitted(posed.task, estimator, proof)
    estimate = build_estimate(posed, estimator, fit, workers)
    if refined:
        estimate = refine(estimate, posed, estimator)
    estimate = replace(estimate, details={**estimate.details, **posed.details})
    if proof is not None:
        progress("proving the optimum")
        made_of = {"model": estimate.identity, "data": posed.measurements.data_hash}
        write_proof(proved(posed.task, fit, estimate.theta, estimate.method, made_of), proof)
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


def _check_method(estimator: Estimator, refined: bool, black_box: bool, proof: bool) -> None:
    """InputError where method, data and a wanted proof do not fit each other."""
    if refined and proof:
        raise InputError("proof: a simulation's error is not convex", "leave it out, or take lmi-sdp")
    if black_box and proof:
        what = "proof: a black box's answers are fitted without constraints"
        raise InputError(what, "leave it out")
    if black_box and refined:
        raise InputError(f"method {OUTPUT_ERROR} needs measured runs", "choose another method")
    if estimator.needs_black_box and not black_box:
        raise InputError(
            f"method {estimator.name} needs a black box's .npz of q, gravity and mass_matrix",
            "choose another method for measured runs",
        )
