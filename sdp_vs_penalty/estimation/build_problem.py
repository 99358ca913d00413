"""From data to an optimisation problem: the one place where measurements become what is
minimised.

``identify``, ``export-sdp``, proofs, the page and the shootout's instances all ask
:func:`build_problem`, so that what one of them proves is what another solves. Gravity,
bounds and filters belong to the :class:`~sdp_vs_penalty.problem.problem.Problem`, a time
window to the measurements (:func:`~sdp_vs_penalty.cli.runs.problem_from_options` reads
both as users write them); everything else is an option.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import partial
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.parsing import numbers, pairs
from sdp_vs_penalty.data.plausibility import check_plausible
from sdp_vs_penalty.effects import make_effect, standard_effect
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError, other_robot, require_known
from sdp_vs_penalty.estimation.constants import CHANGES, MAX_PASSES, SHAPE_FOLDS
from sdp_vs_penalty.estimation.known_load import (
    KnownLoads,
    gains_from_loads,
    with_scale,
)
from sdp_vs_penalty.estimation.model_file import (
    ChannelGains,
    Details,
    Recipe,
    ServoFields,
)
from sdp_vs_penalty.estimation.sensitivity import with_sensitivities
from sdp_vs_penalty.estimation.servo import loop_beside_torque, servo_filters, servo_log
from sdp_vs_penalty.estimation.shapes import estimate_shapes, with_shapes
from sdp_vs_penalty.estimation.uncertainty import independent_gains
from sdp_vs_penalty.estimators.estimator import (
    Progress,
    Task,
    make_task,
    no_progress,
    residual_variances,
    sample_variance,
)
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.black_box import (
    BlackBox,
    compress_black_box,
    load_answers,
)
from sdp_vs_penalty.regression.instruments import commanded_motion
from sdp_vs_penalty.regression.regression import Regression, compress, compress_cells
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.inertia import link_sizes
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.phases import phase_folds
from sdp_vs_penalty.signals.preprocessing import Preprocessing

if TYPE_CHECKING:
    from sdp_vs_penalty.estimation.estimate import Estimate


def parsed_known_load(text: str) -> tuple[Path, float]:
    """Parse FILE:MASS of the option --known-load; the mass is in kg.

    >>> parsed_known_load("load.csv:2.805")
    (PosixPath('load.csv'), 2.805)
    """
    name, _, mass = text.removeprefix("mass=").rpartition(":")
    with suppress(ValueError):
        if name:
            return Path(name), float(mass)
    remedy = "write the run with the load and its mass in kg, load.csv:2.805"
    raise InputError(f"--known-load {text!r}", remedy)


def parsed_known(text: str | None) -> dict[str, float]:
    """Parse the known parameters of the option --known, "kp2=600,kd2=20".

    >>> parsed_known("kp2=600")
    {'kp2': 600.0}
    """
    texts = pairs("--known", text or None) or {}
    return {name: numbers("--known", x, 1)[0] for name, x in texts.items()}


#: How the text of an option is read that is no plain text.
_READERS: dict[str, Callable[[Any], Any]] = {
    "known": parsed_known,
    "known_loads": lambda texts: list(map(parsed_known_load, texts)),
    "gain_uncertainty": lambda x: numbers("gain uncertainty", str(x), 1)[0],
}


@dataclass(frozen=True)
class PoseOptions:
    """What a user may choose of the posing, as :func:`sdp_vs_penalty.identify` takes
    it, who works on it, and who hears of it."""

    #: Effects of the model; None: the problem's.
    effects: str | Sequence[str | Effect] | None = None
    #: Filter settings; None: the problem's.
    preprocessing: Preprocessing | None = None
    #: Weight of the joints' rows: "noise" or "none".
    weighting: str = "noise"
    #: Relative standard deviation of the torque channels' gains, or an (n, e) factor of
    #: their covariance.
    gain_uncertainty: float | Array = 0.0
    #: Runs with a known load, each with its mass [kg].
    known_loads: KnownLoads = ()
    #: Seed of everything random.
    seed: int = 0
    #: Values of known parameters by name. Without torque they set the scale.
    known: Mapping[str, float] = field(default_factory=dict)
    #: "command" or "none"; None: "command" where no torque was logged.
    instruments: str | None = None
    #: Processes that compress the runs.
    workers: Workers = ALONE
    #: Receives a line of text at each stage.
    progress: Progress = no_progress

    def __post_init__(self) -> None:
        """Refuse instruments and known values that are none."""
        require_known("instruments", self.instruments or "none", ("command", "none"))
        for name, value in self.known.items():
            if not (isinstance(value, Real) and math.isfinite(value)):
                raise InputError(f"--known {name}={value} is no value", "give a number")
        known = {name: float(value) for name, value in self.known.items()}
        object.__setattr__(self, "known", known)

    @classmethod
    def from_texts(cls, **texts: Any) -> PoseOptions:
        """Return the options that a command line or a form states, by their fields'
        names; None stands for a field's default. Fields of _READERS are parsed; others
        are taken as they are."""
        options = {name: text for name, text in texts.items() if text is not None}
        for name, read in _READERS.items():
            if name in options:
                options[name] = read(options[name])
        return cls(**options)

    def recipe(self) -> Recipe:
        """Return the options from which :meth:`from_recipe` poses the problem again.

        Of the effects' shape constants only those that the user gave are kept: the
        others are estimated again.
        """
        chosen = {f.name: getattr(self, f.name) for f in fields(Recipe)}
        if self.effects is not None:
            chosen["effects"] = tuple(
                replace(e.entry, shape={k: e.shape[k] for k in e.given})
                for e in self.effects
                if isinstance(e, Effect)
            )
        return Recipe(**chosen)

    @classmethod
    def from_recipe(cls, recipe: Recipe, robot: Robot, **others: Any) -> PoseOptions:
        """Return the options that a recipe states, the inverse of :meth:`recipe`.

        ``others`` are further fields of the options.
        """
        chosen = dict(vars(recipe))
        if recipe.effects is not None:
            chosen["effects"] = [make_effect(e, robot) for e in recipe.effects]
        return cls(**chosen, **others)

    @classmethod
    def of_model(cls, model: Estimate) -> PoseOptions:
        """Return the options with which a model's problem was posed: the one place that
        knows where a model keeps what a user chose.

        Known loads are in its problem's gains, or in its recipe's known values.
        """
        stored: dict[str, Any] = {
            "preprocessing": model.preprocessing,
            "weighting": model.weighting,
            "gain_uncertainty": model.uncertainty.gain_errors,
        }
        if recipe := model.report.recipe:
            return cls.from_recipe(recipe, model.robot, **stored)
        return cls(model.model.effects, known=model.model.known, **stored)


@dataclass(frozen=True)
class EstimationProblem:
    """An optimisation problem, and what made it."""

    #: The problem, with the gains that known loads determined.
    problem: Problem
    #: The log as the columns of task.model are made of it.
    measurements: Measurements | BlackBox
    #: The same log behind its filters; None for a black box, which needs none.
    runs: FilteredRuns | None
    #: The log, compressed in the columns of task.model.
    regression: Regression
    #: What every estimator minimises.
    task: Task
    #: How the joints' rows are weighted: "noise" or "none".
    weighting: str
    #: (n, e) factor of the covariance of the gains' relative errors.
    gain_errors: Array | None = None
    #: Shapes and gains; where the rows are made with a servo's law, also the recipe from
    #: which the same problem follows, with the scale that known loads gave a log without
    #: torque.
    report: Details = field(default_factory=Details)


def build_problem(
    problem: str | Path | Problem,
    measurements: Source | FilteredRuns | BlackBox,
    options: PoseOptions | None = None,
) -> EstimationProblem:
    """Pose the optimisation problem of an identification, from problem and
    measurements.

    Parameters
    ----------
    options : PoseOptions, optional
        Effects, filters, weighting and further choices.

    Returns
    -------
    EstimationProblem
        Optimisation problem with its data.

    Raises
    ------
    InputError
        For input that cannot be used.
    """
    problem = as_problem(problem, "pose(problem=...)")
    options = options or PoseOptions()
    data = read_and_filter(
        problem, measurements, options.preprocessing, "pose(measurements=...)"
    )
    return pose_filtered(problem, data, options)


def pose_filtered(
    problem: Problem, data: FilteredRuns | BlackBox, options: PoseOptions
) -> EstimationProblem:
    """Pose the optimisation problem of an identification, from filtered runs.

    In this order: shape constants are estimated, gains from known loads, and the
    current model to which torque-dependent effects refer; then rows are compressed and
    weighted by joint. A black box (answers of a simulator) has no friction, filters or
    noise: one effect and equal weights.

    Parameters
    ----------
    problem : Problem
        Robot, bounds and nominal links.
    data : FilteredRuns or BlackBox
        Measurements behind their filters, or answers of a black box.
    options : PoseOptions
        Effects, weighting and further choices.

    Returns
    -------
    EstimationProblem
        Optimisation problem with its data.

    Raises
    ------
    InputError
        For input that cannot be used.
    """
    if isinstance(data, BlackBox):
        return _pose_black_box(problem, data, options)
    model = problem.model(options.effects)
    if options.effects is not None:
        options = replace(options, effects=model.effects)
    if data.measurements.torque_logged:
        return _pose_torque_log(problem, model, data, options)
    return _pose_servo_log(problem, model, data, options)


def _pose_linear(
    problem: Problem,
    model: Model,
    runs: FilteredRuns,
    options: PoseOptions,
    gain_errors: Array,
    report: Details,
) -> EstimationProblem:
    """Compress and weight the rows of a model in which all parameters are linear.

    runs : the filtered log, with instruments where they are used; gain_errors and
    report : fields of the EstimationProblem.
    """
    compressed = partial(in_columns, runs, workers=options.workers)
    model, regression = with_reference(
        problem, model, compressed, options.weighting, options.progress
    )
    task = make_task(
        problem, model, regression, options.weighting, options.seed, options.progress
    )
    return EstimationProblem(
        problem=problem,
        measurements=runs.measurements,
        runs=runs,
        regression=regression,
        task=task,
        weighting=options.weighting,
        gain_errors=gain_errors,
        report=report,
    )


def _pose_black_box(
    problem: Problem, data: BlackBox, options: PoseOptions
) -> EstimationProblem:
    """State the identification problem of a black box, a simulator that answers with
    torque.

    The answers have no noise of sensors: no filters, equal weights of all joints. The
    model has rigid links only, unless the user names effects.
    """
    effects = (
        standard_effect("links").name if options.effects is None else options.effects
    )
    model = with_known(problem.model(effects), options.known)
    options.progress("compressing the black box's answers")
    regression = compress_black_box(data, model)
    task = make_task(
        problem,
        model,
        regression,
        weighting="none",
        seed=options.seed,
        progress=options.progress,
    )
    return EstimationProblem(
        problem,
        measurements=data,
        runs=None,
        regression=regression,
        task=task,
        weighting="none",
    )


def _pose_torque_log(
    problem: Problem, model: Model, runs: FilteredRuns, options: PoseOptions
) -> EstimationProblem:
    """Pose a log with torque: first everything but the linear parameters is fixed.

    These are: gains of the servo loops, shape constants of friction, the choice of the
    motion's signal, and the gains of the torque channels from known loads.
    """
    log = runs.measurements
    gain_errors = independent_gains(options.gain_uncertainty, problem.robot.n)
    found: dict[str, Any] = {}
    # 1. Servo effects are fitted to the torque apart; they are no part of the arm.
    drives = [e for e in model.effects if e.forward == "drive"]
    if drives:
        found["loop"] = loop_beside_torque(drives, log, runs.settings)
        model = model.without_drives
    model = with_known(model, options.known)
    # 2. Shape constants, such as a Stribeck velocity, are nonlinear: estimate them now.
    options.progress("estimating shape constants")
    shapes = estimate_shapes(model, runs, options.weighting, workers=options.workers)
    model = replace(model, effects=with_shapes(model.effects, shapes))
    found["shapes"] = tuple(shapes)
    # 3. Instruments: commands, which are free of the sensors' noise, give the motion.
    if options.instruments == "command":
        runs = FilteredRuns.filtering(commanded_motion(log), runs.settings)
        found["recipe"] = options.recipe()
    # 4. Runs with known loads determine the gains of the torque channels.
    if options.known_loads:
        options.progress("determining the gains from the known loads")
        spread = float(np.max(options.gain_uncertainty))
        gain, gain_errors = gains_from_loads(model, runs, options.known_loads, spread)
        problem = replace(problem, gains=tuple(gain.tolist()))
        model = replace(model, gains=problem.gains)
        std = gain * np.linalg.norm(gain_errors, axis=1)
        found["gains"] = ChannelGains(tuple(gain.tolist()), tuple(std.tolist()))
    # 5. What remains is linear.
    return _pose_linear(problem, model, runs, options, gain_errors, Details(**found))


def _pose_servo_log(
    problem: Problem, model: Model, data: FilteredRuns, options: PoseOptions
) -> EstimationProblem:
    """Pose a log without torque: the servos' control law replaces the torque.

    The law (torque = gain times control error) leaves one common scale of all
    parameters open. A known parameter, motor constant or load sets it. Its relative
    error is one further column of the covariance factor of the gains (n joints, k
    independent errors), common to all joints.
    """
    errors = independent_gains(options.gain_uncertainty, problem.robot.n)
    known_by_bounds = model.known
    model, runs, servo = servo_log(
        problem,
        model.effects,
        data,
        options.weighting,
        options.progress,
        instruments=options.instruments != "none",
        chosen=options.effects is not None,
    )
    known = {**known_by_bounds, **options.known}
    model, scale = with_scale(problem, model, data, known, options.known_loads)
    if options.known_loads:
        # Loads are other runs: the recipe says what they made of the scale instead.
        options = replace(options, known=scale["known"])
    common = np.full(problem.robot.n, scale["scale_error"])
    gain_errors = np.column_stack([errors, common])
    report = Details(servo=ServoFields(**servo, **scale), recipe=options.recipe())
    return _pose_linear(problem, model, runs, options, gain_errors, report)


def with_known(model: Model, known: Mapping[str, float]) -> Model:
    """Return a model some more of whose parameters are known.

    Parameters
    ----------
    known : mapping of str to float
        Values by name, in the units of the parameters.

    Returns
    -------
    Model
        Their values are equalities of its optimisation problems.

    Raises
    ------
    InputError
        For a parameter that the model does not have.
    """
    extended = replace(model, known={**model.known, **known})
    extended.require_known("--known")
    return extended


def in_columns(runs: FilteredRuns, model: Model, workers: Workers) -> Regression:
    """Compress runs in the columns of a model.

    Blocks are stretches of time. Without torque the residual is the model's error,
    which repeats with the motion: blocks then are phases of the motion, over all its
    periods.
    """
    if runs.measurements.torque_logged:
        return compress(runs, model, workers=workers)
    return compress_cells(
        runs, model, phase_folds(runs.measurements, runs.settings, SHAPE_FOLDS)
    )


def with_errors_of_constants(
    posed: EstimationProblem, theta: Array, workers: Workers = ALONE
) -> Regression | None:
    """Compress a posed problem's runs in the columns of its model and of its shape
    constants' errors at theta (p,); None without such constants, or without runs."""
    model = with_sensitivities(posed.task.model, theta)
    if model is posed.task.model or posed.runs is None:
        return None
    return in_columns(posed.runs, model, workers)


def logged(data: Measurements | FilteredRuns) -> Measurements:
    """Return the measurements of a log with or without filters."""
    return data.measurements if isinstance(data, FilteredRuns) else data


def load_and_check(
    problem: Problem, measurements: Source | FilteredRuns | BlackBox, what: str
) -> Measurements | FilteredRuns | BlackBox:
    """Read measurements in any form that users give, and check that they fit the robot.

    Filtered runs have been read before and are returned as they are.

    Parameters
    ----------
    what : str
        Name of the argument in messages.

    Raises
    ------
    InputError
        For another number of joints or implausible values.
    """
    n = problem.robot.n
    names = problem.channel_names
    if not isinstance(measurements, FilteredRuns | BlackBox):
        measurements = load_answers(measurements, n) or as_measurements(
            measurements, n, names, what
        )
    data = measurements if isinstance(measurements, BlackBox) else logged(measurements)
    if data.n != n:
        raise other_robot(data.n, n, f"measurements for {problem.name}")
    if isinstance(measurements, Measurements):
        check_plausible(problem.robot, measurements)
    return measurements


def read_and_filter(
    problem: Problem,
    measurements: Source | FilteredRuns | BlackBox,
    settings: Preprocessing | None = None,
    what: str = "measurements",
) -> FilteredRuns | BlackBox:
    """Read, check and filter measurements; a black box's answers have no filters.

    Parameters
    ----------
    what : str
        Name of the argument in messages.

    Raises
    ------
    InputError
        For another number of joints or implausible values.
    """
    data = load_and_check(problem, measurements, what)
    if isinstance(data, BlackBox):
        return data
    return filter_runs(problem, data, settings)


def filter_runs(
    problem: Problem, data: Measurements | FilteredRuns, settings: Preprocessing | None
) -> FilteredRuns:
    """Return a log behind its filters.

    Parameters
    ----------
    data : Measurements or FilteredRuns
        The log; filtered runs keep their filters.
    settings : Preprocessing, optional
        Filters; default: the problem's. A log without torque gets the cut-off of
        :func:`servo_filters`.
    """
    if isinstance(data, FilteredRuns):
        return data
    settings = settings or problem.preprocessing
    return FilteredRuns.filtering(
        data, settings if data.torque_logged else servo_filters(settings, data)
    )


def _near_the_file(task: Task, problem: Problem) -> Array:
    """Return theta (p,) by least squares with links near those of the robot's file.

    Each parameter of a link has the weight of one more row: it differs from the file's
    by about a link's size. Rows hardly tell a rotor's inertia from its link's, for
    example, and least squares alone then makes both thousands of times too large, with
    opposite signs.
    """
    links = task.model.rigid_indices
    if not len(links):
        return task.ols
    sizes = link_sizes(problem.nominal_links).ravel()
    rows = np.zeros((len(links), len(task.nominal)))
    rows[np.arange(len(links)), links] = 1.0 / sizes
    data = task.data.with_observations(
        rows, rows @ task.nominal, weight=sample_variance(task)
    )
    return data.nearest(task.nominal)


def with_reference(
    problem: Problem,
    model: Model,
    compressed: Callable[[Model], Regression],
    weighting: str,
    progress: Progress = no_progress,
) -> tuple[Model, Regression]:
    """Return the model with its reference, the current model's parameters (p,), and the
    training data in its columns.

    The columns of torque-dependent effects are computed with the torque and the links of
    the current model. Passes of least squares find it: the first without these effects,
    the others with all effects and the parameters of the pass before, until these are its
    own: with its own as the reference no joint's error would change by more than CHANGES.
    The reference holds the parameters of all effects but those of the torque channels. A
    model without such effects is returned as it is.

    Parameters
    ----------
    problem : Problem
        Robot, bounds and nominal links.
    compressed : callable
        Returns the training data in the columns of a model.
    weighting : {"noise", "none"}
        Weight the joints' rows by their noise, or equally.
    progress : callable
        Receives a line of text at each pass.
    """
    if not model.needs_reference:
        progress("compressing the measurements")
        return model, compressed(model)

    def least_squares_of(part: Model, number: int) -> tuple[Regression, Array]:
        """Fit a model with some or all of the effects; return its data and parameters."""
        progress(f"the current model, pass {number}")
        data = compressed(part)
        task = make_task(problem, part, data, weighting)
        return data, _near_the_file(task, problem)

    first_part = model.reference_free
    theta = np.zeros(len(model.parameters))
    _, theta[model.places(first_part)] = least_squares_of(first_part, 1)
    kept = model.places(model.before_channels)
    error = np.inf
    for number in range(2, MAX_PASSES + 1):
        reference = np.zeros(len(theta))
        reference[kept] = theta[kept]
        model = replace(model, reference=reference)
        regression, theta = least_squares_of(model, number)
        before, error = error, _error_of_reference(model, regression, theta)
        # The first reference knows nothing of these effects, and its errors are larger.
        is_own = number > 2 and error < CHANGES
        does_not_converge = number > 3 and error >= before
        if is_own or does_not_converge:
            break
    return model, regression


def _error_of_reference(model: Model, regression: Regression, theta: Array) -> float:
    """Return the largest share by which a joint's error may change if the parameters theta
    (p,) of a fit become its reference.

    A joint's torque-dependent columns are taken to change by the same share as the torque
    of its other effects, which is exact for a gain.
    """
    is_reference_free = np.zeros(len(theta), bool)
    is_reference_free[model.places(model.reference_free)] = True
    reference = model.reference
    assert reference is not None  # :func:`with_reference` has set it
    free = np.where(is_reference_free, theta, 0.0)
    change = np.where(is_reference_free, theta - reference, 0.0)
    torque, changed, dependent = (
        regression.torque_norms(x) for x in (free, change, theta - free)
    )
    of_columns = (dependent * changed / nonzero_or_one(torque)) ** 2
    of_residuals = residual_variances(regression, theta) * regression.joint_rows()
    return float(np.sqrt(1.0 + np.max(of_columns / nonzero_or_one(of_residuals))) - 1.0)
