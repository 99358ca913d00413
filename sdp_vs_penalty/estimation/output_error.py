"""Output error: parameters with which the model, run forward, stays with the measured
motion.

    minimise sum_k |q_sim(t_k; theta) - q(t_k)|^2 / s^2   subject to every constraint of the problem

Started at another method's estimate; in each Gauss-Newton step the linearised
simulation takes the place of the torques in that method's convex problem: every iterate
is consistent, the last one certified (of the linearised problem). Where the simulation
cannot stay with the motion (an arm under gravity), it is restarted in windows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.forward import Plant, PlantState, advance
from sdp_vs_penalty.effects.motion import Command
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import EstimationProblem
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task
from sdp_vs_penalty.regression.linalg import column_space
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array, Mask
from sdp_vs_penalty.signals.preprocessing import RunFilter, no_rows
from sdp_vs_penalty.signals.runs import split_at_gaps


@dataclass(frozen=True)
class Course:
    """A stretch of a run, N instants."""

    #: Name of the run.
    name: str
    #: Positions, velocities and accelerations, an instant a row.
    states: PlantState
    #: (N, n) measured torque [N m, N].
    torque: Array
    #: (N, n) which joints move.
    moving: Mask
    #: The command at the same instants, where there is one.
    command: Command | None = None

    @property
    def dt(self) -> float:
        """Time between two rows [s]."""
        return float(self.states.t[1] - self.states.t[0])


def courses_of(
    run: Measurements, estimate: Estimate, plant: Plant, shortest: float
) -> list[Course]:
    """Return the stretches of a run behind the state filter, one row a simulation step.

    A simulation step is one sample, or as many as STEP seconds hold. Torque is averaged
    over a step and its neighbours with triangular weights.

    Parameters
    ----------
    estimate : Estimate
        Model with filters and effects.
    plant : Plant
        The model for forward simulation.
    shortest : float
        Stretches up to this length are left out [s].

    Raises
    ------
    InputError
        If no stretch is long enough, or an effect needs temperatures that were not
        logged.
    """
    filters = RunFilter(run, estimate.preprocessing.resolve(run)).every_sample
    half = filters.state.half  # samples that the filter needs on either side
    stride = max(1, int(STEP / filters.dt + 1e-9))  # samples a simulation step
    on_steps = slice(None, None, stride)
    # Two boxes of a step convolved: a triangle over 2 stride - 1 samples.
    triangle = np.convolve(np.ones(stride), np.ones(stride)) / stride**2
    courses = []
    for part in split_at_gaps(run):
        # The filter has no value within ``half`` samples of both ends.
        first = half
        last = part.count - half - 1
        if (last - first) * filters.dt <= shortest:
            continue
        motion = filters.motion(part, first, last)
        torque = plant.true_torque(motion.t, part.resampled(part.tau, first, last + 1))
        padded = np.pad(torque, ((stride - 1, stride - 1), (0, 0)), "edge")
        smooth_torque = sum(
            weight * padded[k : k + len(torque)] for k, weight in enumerate(triangle)
        )
        memory = plant.inner_states(motion)
        is_moving = filters.movement.at(motion.t)
        # NaN marks states that were not logged and that no effect needs.
        unknown = np.full_like(motion.q, np.nan)
        temperature = unknown
        if any(effect.needs_temperature for effect in estimate.model.effects):
            temperature = motion.joint_temperature
        path = unknown if motion.position_integral is None else motion.position_integral
        states = PlantState(
            motion.t, motion.q, motion.dq, motion.ddq, memory, temperature, path
        )
        course = Course(
            name=run.names[0],
            states=states.rows(on_steps),
            torque=np.asarray(smooth_torque)[on_steps],
            moving=is_moving[on_steps],
            command=motion.command,
        )
        courses.append(course)
    if not courses:
        raise no_rows(run, 2.0 * half * filters.dt + shortest)
    return courses


OUTPUT_ERROR = "output-error"
DESCRIPTION = (
    "started at the default method: the model, run forward by the measured torque,"
    " stays with the motion; each Gauss-Newton step under all constraints (one or two"
    " joints: hours for seven)"
)
#: Longest step of the simulation [s], and the windows that are tried [s], the longest
#: first: one is used if the starting model stays within this share of the motion's
#: size.
STEP = 2.5e-3
_WINDOWS = (np.inf, 10.0, 3.0, 1.0, 0.3, 0.1)
_STAYS = 0.3
#: Gauss-Newton steps at most; shares of a step that are tried; least relative fall of
#: the error of one that is taken.
_MOST_STEPS = 12
_SHARES = (1.0, 0.5, 0.25, 0.1)
_LEAST_FALL = 1e-3
#: Step of the slopes, in standard deviations of the parameters.
_SLOPE_STEP = 0.1


@dataclass(frozen=True)
class _Window:
    """From ``start`` in steps of h [s]: torque (K, n) in their middle, measured q (K,
    n) after."""

    start: PlantState
    h: float
    torque: Array
    q: Array


def refine(
    start: Estimate, posed: EstimationProblem, estimator: Estimator
) -> tuple[EstimationProblem, Fit]:
    """Minimise the error of forward simulations, by Gauss-Newton steps from an
    estimate.

    Each step is solved by the estimator under all its constraints, with the
    simulations' errors, linearised in theta, for data. Of a step that share is taken
    that has the smallest error.

    Parameters
    ----------
    posed : EstimationProblem
        Optimisation problem of the estimate.
    estimator : Estimator
        Method whose constraints and prior hold.

    Returns
    -------
    EstimationProblem
        With the last linearisation for data.
    Fit
        The parameters with the smallest error of forward simulations.

    Raises
    ------
    InputError
        For a model that cannot accelerate.
    """
    model = start.model
    task = posed.task
    measurements = posed.measurements
    assert isinstance(measurements, Measurements)
    plant = Plant(model, start.theta)
    if not plant.can_move or not np.all(np.isfinite(start.theta)):
        raise InputError(
            "M(q) is not positive definite: the model cannot be simulated", "add bounds"
        )
    courses = list[Course]()
    for run in measurements.runs():
        courses += courses_of(run, start, plant, _WINDOWS[-1])
    size = np.concatenate([course.states.q for course in courses]).std(axis=0)
    windows, seconds = _followed_windows(plant, courses, size)
    theta = start.theta
    error = _errors(plant, windows, size)[0]
    # Errors are over the motion's size; joints take turns: times ``units`` [rad, m].
    units = np.resize(size, error.shape)
    begin = _rms(error * units)
    for k in range(_MOST_STEPS):
        thousandths = 1e3 * _rms(error * units)
        task.progress(f"output error, step {k + 1}: {thousandths:.4g} thousandths")
        # A Gauss-Newton step under the constraints, then the best share of it.
        linearised = _linearised(task, theta, windows, size)
        fit = estimator.fit(linearised)
        step = fit.theta - theta
        tried = np.array([theta + share * step for share in _SHARES])
        errors = _errors(Plant(model, tried), windows, size)
        best = int(np.argmin([_rms(e) for e in errors]))
        fall = 1.0 - _rms(errors[best]) / _rms(error)
        if not fall > _LEAST_FALL:  # NaN, too, ends the search
            break
        theta = tried[best]
        error = errors[best]
    fit = replace(fit, theta=theta, details={**fit.details, "window_s": seconds})
    fit.details["simulation_rms"] = [begin, _rms(error * units)]
    return replace(posed, task=linearised), fit


def _linearised(
    task: Task, theta: Array, windows: Sequence[_Window], size: Array
) -> Task:
    """Return the least-squares problem of the simulations' errors, linear about theta
    (p,).

    The errors e(theta) of simulated positions, over ``size`` (n,) (the motion's
    standard deviation [rad, m]), become data |J theta' - (J theta - e)|^2 of theta'. J
    is found by finite differences in the directions that the torque determines. The
    data are scaled to the variance of the torque's residual, so that the estimator's
    prior keeps its weight.
    """
    variance = task.data.loss(task.ols) / task.data.rows
    # (p, k) visible directions, each one standard deviation long.
    directions = column_space(task.data.R)[1] * np.sqrt(variance)
    varied = theta + _SLOPE_STEP * directions.T
    plant = Plant(task.model, np.vstack([theta, varied]))
    errors = _errors(plant, windows, size)
    slopes = (errors[1:] - errors[0]).T / _SLOPE_STEP
    # ``slopes`` are by x with theta = directions x.
    jacobian = slopes @ np.linalg.pinv(directions)
    scale = np.sqrt(variance / np.mean(errors[0] ** 2))
    target = jacobian @ theta - errors[0]
    rows = scale * np.column_stack([jacobian, target])
    return replace(task, data=LeastSquares.stacked([rows], len(rows)))


def _followed_windows(
    plant: Plant, courses: Sequence[Course], size: Array
) -> tuple[list[_Window], float]:
    """Cut the courses into the longest windows in which the simulation follows the
    motion.

    Returns the windows and their length [s]. ``size`` (n,) is the standard deviation of
    the motion [rad, m]; the RMS error may be _STAYS times it.
    """
    for seconds in _WINDOWS:
        windows = [
            window for course in courses for window in _windows_of(course, seconds)
        ]
        if windows and _rms(_errors(plant, windows, size)[0]) <= _STAYS:
            break
    longest = max(len(window.torque) * window.h for window in windows)
    return windows, float(min(seconds, longest))


def _windows_of(course: Course, seconds: float) -> list[_Window]:
    """Cut a course into windows of equal length [s]; a shorter course is one window.

    A last piece that is shorter than a window is left out.
    """
    steps = len(course.torque) - 1
    count = steps
    if seconds < np.inf:
        count = int(min(steps, max(1, round(seconds / course.dt))))
    mean_torque = 0.5 * (course.torque[:-1] + course.torque[1:])
    windows = []
    for first in range(0, steps - count + 1, count):
        start = course.states.rows(np.array([first]))
        torque = mean_torque[first : first + count]
        q = course.states.q[first + 1 : first + 1 + count]
        windows.append(_Window(start, h=course.dt, torque=torque, q=q))
    return windows


def _errors(plant: Plant, windows: Sequence[_Window], size: Array) -> Array:
    """Simulate all windows for all parameter vectors; return the errors of the
    positions.

    Returns (P, R) errors q_simulated - q_measured over ``size`` (n,), the motion's
    standard deviation. One row for each of the plant's P parameter vectors; R counts
    steps, windows and joints. All windows of all parameter vectors are simulated side
    by side. Errors are clipped at 1000, where an unstable simulation ends.
    """
    count = len(plant.theta)
    n_windows = len(windows)
    lengths = np.array([len(window.torque) for window in windows])
    torques = _padded([window.torque for window in windows])  # (K, W, n)
    measured = _padded([window.q for window in windows])
    # Rows of a state: all windows with theta 0, then all with theta 1, and so on.
    repeated_plant = Plant(plant.model, np.repeat(plant.theta, n_windows, axis=0))
    # All windows with the first theta, then all with the next.
    fields = []
    for parts in zip(*(window.start for window in windows), strict=True):
        values = np.concatenate(parts)
        repeats = (count,) + (1,) * (values.ndim - 1)
        fields.append(np.tile(values, repeats))
    state = PlantState(*fields)
    out = []
    with np.errstate(all="ignore"):
        for k in range(len(torques)):
            torque = np.tile(torques[k], (count, 1))
            state = advance(repeated_plant, state, torque, windows[0].h)
            q = state.q.reshape(count, n_windows, -1)
            # A window that is over has no errors.
            is_inside = (k < lengths)[:, None]
            target = np.where(is_inside, measured[k], q[0])
            out.append(is_inside * (q - target) / size)
    errors = np.swapaxes(np.array(out), 0, 1).reshape(count, -1)
    return np.clip(np.nan_to_num(errors, nan=1e3), -1e3, 1e3)


def _padded(courses: Sequence[Array]) -> Array:
    """Stack W courses (K_w, n) to (K, W, n); shorter ones repeat their last row."""
    longest = max(len(course) for course in courses)
    padded = []
    for course in courses:
        n_missing = longest - len(course)
        padded.append(np.pad(course, ((0, n_missing), (0, 0)), "edge"))
    return np.stack(padded, axis=1)


def _rms(error: Array) -> float:
    """Return the root mean square of all entries."""
    return float(np.sqrt(np.mean(error**2)))
