"""The verb that makes a model, ``identify``, from measured runs or from the answers of a
simulator or a manufacturer's library."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.data.files import Source, as_measurements, training_runs
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.recorded import words_of_source
from sdp_vs_penalty.diagnosis.comparison import Comparison, compare_filtered
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import (
    PoseOptions,
    filter_runs,
    load_and_check,
)
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.identify import estimate_parameters
from sdp_vs_penalty.estimation.provenance import Provenance
from sdp_vs_penalty.estimation.verdict import NoiseFloor
from sdp_vs_penalty.estimators import DEFAULT_METHOD
from sdp_vs_penalty.estimators.estimator import Estimator, Progress, no_progress
from sdp_vs_penalty.memory import give_back_memory
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.problem.check_command import CheckCommand
from sdp_vs_penalty.problem.load import as_problem, with_bounds
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.records import to_json
from sdp_vs_penalty.regression.black_box import BlackBox
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.constants import SAMPLES
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.threads import on_one_thread

if TYPE_CHECKING:
    from sdp_vs_penalty.checks.gate import Gate
    from sdp_vs_penalty.checks.issue import Issue


@on_one_thread
@checked_arguments
def identify(
    problem: str | Path | Problem,
    measurements: Source | FilteredRuns | BlackBox,
    method: str | Estimator = DEFAULT_METHOD,
    *,
    effects: str | Sequence[str | Effect] | None = None,
    preprocessing: Preprocessing | None = None,
    weighting: str = "noise",
    seed: int = 0,
    progress: Progress = no_progress,
    proof: str | Path | None = None,
    gain_uncertainty: float | Array = 0.0,
    known_loads: Sequence[tuple[Source, float]] = (),
    known: Mapping[str, float] | None = None,
    bounds: str | Mapping[str, tuple[float | None, float | None]] | None = None,
    instruments: str | None = None,
    workers: Workers = ALONE,
    noise_from: Source = None,
    check: bool = True,
) -> Estimate:
    """Identify a robot's dynamic parameters from measured runs.

    The torque is tau = sum over effects of Y_e(q, dq, ddq) theta_e. The method
    minimises the weighted squares of what is left, behind one filter for columns and
    torque, under the constraints that make every link physically consistent.

    Parameters
    ----------
    problem : str, Path or Problem
        A built-in name, a folder with a problem.toml, a URDF file, or a Problem.
    measurements : path, arrays, DataFrame, Measurements, list of these, FilteredRuns
        What :func:`~sdp_vs_penalty.data.files.as_measurements` takes: t (N,) s, q (N,
        n) rad or m, tau (N, n) N m or N. The filters of FilteredRuns hold. A BlackBox,
        or its .npz file, answers without noise and friction: q (K, n) rad or m, gravity
        (K, n) N m or N, mass_matrix (K, n, n) kg m^2. Nothing is weighted or filtered,
        and there is no verdict.
    method : str or Estimator, default "lmi-sdp"
        A name of `sdp-vs-penalty list methods`, or an Estimator with its own settings.
        "output-error" refines the default method's estimate by simulation.
    effects : str, names or Effects, optional
        Default: the problem's. Coulomb friction's velocity is estimated joint by joint
        where motion left out confirms it, unless it is given
        (``coulomb_friction@v_s=0.02``).
    preprocessing : Preprocessing, optional
        Filter settings; default: the problem's.
    weighting : {"noise", "none"}
        "noise" divides each joint's rows by its residual in a first least-squares pass.
        "none" leaves the newton metres of all joints equal.
    seed : int
        Seed of the method's random choices.
    progress : callable
        Hears where the computation stands, a short text each time.
    proof : str or Path, optional
        A file for the proof of optimality, or that nothing satisfies all constraints.
    gain_uncertainty : float or (n, e) array
        Relative standard deviation of the torque channels' gains (0.01: known to a per
        cent), or a factor of their covariance. It widens the intervals.
    known_loads : sequence of (run, mass)
        Further runs, each with the mass [kg] that the last link carried. They determine
        the gains, so that parameters are in true units.
    known : mapping of str to float, optional
        Parameters of known value, by name. Without torque they set the scale
        (``{"kp2": 600.0}``).
    bounds : str or mapping, optional
        Bounds in place of the problem's: ``{"m2": (1.0, 5.0), "total": (None, 20.0)}``, or
        the text of --bounds (kg, m, kg m^2; equal ends of a mass: a known value).
    instruments : {"command", "none"}, optional
        Default: "command" where no torque was logged.
    workers : Workers
        Who compresses the runs. The estimate is the same to the last bit.
    noise_from : the same as measurements, optional
        The runs whose repetition shows the noise; default: the measurements. Name all
        that was recorded where these are a window of it.
    check : bool
        Whether the fast part of `check` looks at the measurements first. What it finds
        wrong for certain raises InputError, other remarks are issued as UserWarning.

    Returns
    -------
    Estimate
        Parameters with intervals, a certificate, and a verdict on these measurements.
        Intervals, verdict and noise are worked out when they are first read, unless the
        measurements are long.

    Raises
    ------
    InputError
        For input that cannot be used.

    References
    ----------
    Sousa, Cortesao, IJRR 2014; Traversaro et al., IROS 2016; Wensing et al., RA-L 2018.

    Examples
    --------
    >>> from sdp_vs_penalty import identify, simulate
    >>> runs = simulate("two_link", seed=1)
    >>> model = identify("two_link", runs.train)
    >>> model.certificate.worst  # the largest violation of a constraint
    0.0
    """
    options = PoseOptions(
        effects=effects,
        preprocessing=preprocessing,
        weighting=weighting,
        gain_uncertainty=gain_uncertainty,
        known_loads=known_loads,
        seed=seed,
        known=known or {},
        instruments=instruments,
        workers=workers,
        progress=progress,
    )
    robot = with_bounds(as_problem(problem, "identify(problem=...)"), bounds)
    recorded = None
    if noise_from is not None:
        names, what = robot.channel_names, "identify(noise_from=...)"
        recorded = as_measurements(noise_from, names=names, what=what)
    source = training_runs(measurements)
    estimate, runs = _identify(robot, source, method, options, proof, check)
    if isinstance(runs, BlackBox):
        return estimate
    if words := words_of_source(source):
        estimate.provenance.update(data=words, judged_data=words)
    is_window = recorded is not None and recorded is not runs.measurements
    if runs.are_long or is_window:
        # A model must not keep a long recording alive.
        estimate.provenance.update(_judge(estimate, runs, recorded)[1])
        return estimate
    provenance = Provenance(estimate.provenance)
    # What is returned is another object: its provenance does not hold itself.
    provenance.work_out_later(
        ("verdict", "noise"), lambda: _judge(estimate, runs, recorded)[1]
    )
    return replace(estimate, provenance=provenance)


def identify_many(
    problem: str | Path | Problem,
    logs: Mapping[str, Source] | Sequence[str | Path],
    method: str | Estimator = DEFAULT_METHOD,
    *,
    jobs: int = 1,
    **options: Any,
) -> dict[str, Estimate]:
    """Identify one model from each of many logs: units of a series, days, loads.

    Parameters
    ----------
    problem : str, Path or Problem
        The robot with its bounds, as :func:`identify` takes it.
    logs : mapping or sequence of paths
        What each model is identified from, by a name; files go by their own.
    method : str or Estimator, default "lmi-sdp"
        A name or an Estimator, as :func:`identify` takes it.
    jobs : int
        Number of processes that share the logs.
    **options
        The other arguments of :func:`identify`.

    Returns
    -------
    dict of str to Estimate
        Models by name. ``pandas.DataFrame({k: m.links_frame()["mass [kg]"] for k, m in
        models.items()})`` is a table of their masses.

    Raises
    ------
    InputError
        For input that cannot be used, by the log's name.

    Examples
    --------
    >>> from sdp_vs_penalty import identify_many, simulate
    >>> runs = {f"seed {k}": simulate("two_link", seed=k).train for k in (1, 2)}
    >>> list(identify_many("two_link", runs))
    ['seed 1', 'seed 2']
    """
    if not isinstance(logs, Mapping):
        logs = {str(path): path for path in logs}
    robot = as_problem(problem, "identify_many(problem=...)")
    one = partial(_identify_one, robot, method, options)
    models = Workers(jobs).map(one, logs.items())
    return dict(zip(logs, models, strict=True))


def _identify_one(
    problem: Problem,
    method: str | Estimator,
    options: Mapping[str, Any],
    log: tuple[str, Source],
) -> Estimate:
    """Identify the model of one log, (name, runs); what is refused names the log.

    A worker takes one argument, so that both are one.
    """
    name, source = log
    try:
        return identify(problem, source, method, **options)
    except InputError as error:
        raise error.within(name) from error


def identify_and_judge(
    problem: str | Path | Problem,
    measurements: Source | FilteredRuns | BlackBox,
    method: str | Estimator,
    options: PoseOptions,
    *,
    proof: str | Path | None = None,
    noise_from: Measurements | None = None,
    check: bool | Gate = True,
) -> tuple[Estimate, Comparison | None]:
    """Identify a model as :func:`identify`, and return the comparison behind its
    verdict.

    Problem and runs are read, checked and filtered once.

    Parameters
    ----------
    options : PoseOptions
        The other arguments of :func:`identify`.
    check : bool or Gate
        Whether the data check looks at the measurements first, and who hears it.

    Returns
    -------
    Estimate
        The model, with its verdict.
    Comparison or None
        Of the model with its own measurements; None for a black box's answers, which
        are no torque along a motion.

    Raises
    ------
    InputError
        For input that cannot be used.
    """
    robot = as_problem(problem, "identify(problem=...)")
    estimate, runs = _identify(robot, measurements, method, options, proof, check)
    if isinstance(runs, BlackBox):
        return estimate, None
    comparison, judgement = _judge(estimate, runs, noise_from)
    estimate.provenance.update(judgement)
    return estimate, comparison


def _identify(
    problem: Problem,
    measurements: Source | FilteredRuns | BlackBox,
    method: str | Estimator,
    options: PoseOptions,
    proof: str | Path | None,
    check: bool | Gate,
) -> tuple[Estimate, FilteredRuns | BlackBox]:
    """Identify a model without a verdict; return it with what it was identified from.

    The arguments are those of :func:`identify_and_judge`.
    """
    data = load_and_check(problem, measurements, "identify(measurements=...)")
    is_of_caller = not isinstance(measurements, (str, Path))
    if isinstance(data, Measurements) and is_of_caller and data.q.size <= SAMPLES:
        # The model's verdict may be read after the caller has changed the arrays.
        data = data.copied()
    issues: Mapping[str, Sequence[Issue]] = {}
    if check and isinstance(data, Measurements):
        options.progress("checking the measurements")
        from sdp_vs_penalty.checks.gate import raise_on_errors

        issues = raise_on_errors(
            problem,
            data,
            "identify",
            gate_of(check, problem, measurements, stacklevel=6),
            gains=bool(options.known_loads),
            are_plausible=True,
        )
        give_back_memory(data.samples)
    if isinstance(data, BlackBox):
        runs: FilteredRuns | BlackBox = data
    else:
        runs = filter_runs(problem, data, options.preprocessing)
    estimate = estimate_parameters(problem, runs, method, options, proof=proof)
    estimate.provenance.update(checked=bool(check), checks=to_json(issues))
    return estimate, runs


@on_one_thread
def _judge(
    estimate: Estimate, runs: FilteredRuns, noise_from: Measurements | None
) -> tuple[Comparison, dict[str, Any]]:
    """Compare a model with the runs that it was identified from; return the comparison,
    and its verdict and their noise as entries of the model's provenance."""
    judged = runs
    if runs.settings != estimate.preprocessing:
        judged = filter_runs(
            estimate.problem, runs.measurements, estimate.preprocessing
        )
    comparison = compare_filtered({estimate.method: estimate}, judged, noise_from)[0]
    recording = (noise_from or runs.measurements).recording
    noise = NoiseFloor(*comparison.noise, recording.data_hash)
    verdict = comparison.verdict.to_dict()
    return comparison, {"verdict": verdict, "noise": noise.to_dict()}


def gate_of(check: bool | Gate, problem: Problem, source: Any, stacklevel: int) -> Gate:
    """Return who hears the check of runs: by default a UserWarning that points to the
    line which called the verb, ``stacklevel`` calls above the check's caller."""
    # Imported late: `identify` of a black box needs no check.
    from sdp_vs_penalty.checks.gate import Gate

    if isinstance(check, Gate):
        return check
    warn = partial(warnings.warn, stacklevel=stacklevel)
    return Gate(warn, command=CheckCommand.for_source(problem, source))
