"""A model simulated along measured runs: how well it predicts where the arm will be.

Windows of a tenth of a second start from the measured state, and the measured torque
drives them, in steps of a sample or at most 2.5 ms. The free run starts once. With
``drive="servo"`` the command drives the arm, through the identified law of its servos. With
``drive="pd"`` a proportional and derivative loop on the measured motion acts beside the
measured torque, so that the arm stays with it: what the loop has to add is then the
model's error as a torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, Self

import numpy as np

from sdp_vs_penalty.arguments import checked_arguments, require_in_range
from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.forward import Plant, PlantState, ServoLoop, advance
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.drive_torque import driven
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimation.output_error import STEP, Course, courses_of
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.records import NOT_STORED, JsonRecord, stored_as
from sdp_vs_penalty.results.facts import fact
from sdp_vs_penalty.results.record import Record, Summary
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.robot.arrays import Array, Indices, at_least_tiny, nonzero_or_one
from sdp_vs_penalty.signals.segments import window_subsample

if TYPE_CHECKING:
    import pandas

Drive = Literal["torque", "pd", "servo"]

#: Length of the windows that are simulated [s].
_HORIZON = 0.1
#: Bandwidth of the loop of drive "pd" [Hz].
_LOOP_BANDWIDTH = 5.0
#: How many models are drawn from the parameters' intervals for the free runs' band.
_DRAWS = 8
#: A free run has left the measured one beyond this error [rad, m].
_LEFT = {"rad": 0.5, "m": 0.1}


@dataclass(frozen=True)
class Ahead(JsonRecord):
    """Errors of simulated windows, of positions [rad, m] or velocities [rad/s, m/s]."""

    #: Time after the window's start [s].
    seconds: float
    #: (n,) root mean square error over all windows.
    rms: Array
    #: (2, n) 5 and 95 % of the absolute errors.
    band: Array
    #: (n,) root mean square error of going on at the measured velocity.
    naive: Array

    @classmethod
    def from_errors(cls, seconds: float, error: Array, naive: Array) -> Self:
        """Summarise the errors of K windows at one horizon.

        Parameters
        ----------
        seconds : float
            Horizon: time from the start of a window [s].
        error : (K, n) array
            Simulated minus measured, for each window and joint.
        naive : (K, n) array
            The same for a guess of constant velocity.

        Returns
        -------
        Ahead
            RMS of the errors (n,), 5 % and 95 % quantiles of their sizes (2, n), and
            RMS of the guess (n,).
        """
        band = np.quantile(np.abs(error), [0.05, 0.95], axis=0)
        return cls(seconds, _rms(error), band, _rms(naive))


@dataclass(frozen=True)
class FreeRun(JsonRecord):
    """One run, simulated from its first state until it leaves the measured motion, or
    the measured motion ends."""

    derived = ("run",)

    #: Duration of the simulation [s].
    seconds: float
    #: Whether it left the measured motion.
    left: bool
    #: (n,) root mean square error of the positions [rad, m].
    rms: Array
    #: (n,) half a 95 % band of the positions that the parameters' intervals make [rad,
    #: m]; None where they are not known.
    spread: Array | None
    #: (n,) root mean square torque that the loop added [N m, N]; None without a loop.
    loop: Array | None
    #: (n,) root mean square of the measured torque [N m, N].
    torque: Array
    #: Simulated motion at N instants.
    simulated: Measurements = field(metadata=NOT_STORED)
    #: (N, n) measured positions at these instants [rad, m].
    measured: Array = field(metadata=NOT_STORED)
    #: Whether the measured run goes on after a simulation that did not leave it.
    cut: bool

    @property
    def run(self) -> str:
        """Name of the measured run."""
        return self.simulated.names[0]

    def spread_within_sight(self, units: Sequence[str]) -> Array:
        """Return ``spread`` (n,), infinite where it is so large that a run of that error
        counts as having left the measured motion."""
        spread = np.full(len(units), np.inf) if self.spread is None else self.spread
        limit = np.array([_LEFT[unit] for unit in units])
        return np.where(spread <= limit, spread, np.inf)


@dataclass(frozen=True, repr=False)
class Following(Record, JsonRecord):
    """Errors of a model that is simulated along measured runs."""

    derived = ("verdict", "facts")

    #: What drives the simulation: "torque", "pd" or "servo".
    drive: Drive
    #: Unit of each joint's position, "rad" or "m".
    units: tuple[str, ...]
    #: Errors of the velocity after one step.
    one_step: Ahead = field(metadata=stored_as("one_step_velocity"))
    #: Errors of the position after a tenth of a second.
    ahead: Ahead = field(metadata=stored_as("ahead_position"))
    #: Each run, simulated from its first state.
    free: tuple[FreeRun, ...] = field(metadata=stored_as("free_run"))
    #: Effects that the simulation leaves out.
    left_out: tuple[str, ...]

    @property
    def share(self) -> Array:
        """(n,) error of each joint relative to a simple alternative.

        That is the position error at the horizon over that of a constant velocity; with
        a control loop, the torque that the loop adds over the measured torque.
        """
        shares = [
            run.loop / at_least_tiny(run.torque)
            for run in self.free
            if run.loop is not None
        ]
        if not shares:  # no control loop
            return np.asarray(self.ahead.rms / at_least_tiny(self.ahead.naive))
        return np.max(shares, axis=0)

    @fact("", digits=9)
    def worst_joint(self) -> int:
        """The joint (from 1) with the largest share: its error relative to the simple
        alternative of constant velocity, or its loop torque relative to the measured
        torque."""
        return int(np.argmax(self.share)) + 1

    @fact("thousandths of rad or m", name="drift of the worst joint")
    def worst_drift(self) -> float:
        """Root mean square error of the worst joint's position at the horizon (a tenth
        of a second by default), in thousandths of rad or m."""
        return 1e3 * float(self.ahead.rms[self.worst_joint - 1])

    @fact("thousandths of rad or m", name="the same at constant velocity")
    def worst_guess(self) -> float:
        """Root mean square error of the worst joint's position, in thousandths of rad
        or m, if it went on at the measured velocity."""
        return 1e3 * float(self.ahead.naive[self.worst_joint - 1])

    @fact("%", name="torque from the loop")
    def loop_percent(self) -> float | None:
        """Torque that the control loop adds on the worst joint, in per cent of its
        measured torque; None without a loop."""
        if self.drive != "pd":
            return None
        return 100.0 * float(self.share[self.worst_joint - 1])

    @property
    def verdict(self) -> str:
        """Sentence on how well the simulated motion follows the measured one, of the
        worst joint.

        With drive "pd" it says the torque that the loop adds; otherwise the drift over
        the horizon beside the guess of constant velocity. It grades nothing: the grade
        of a model comes from estimation/verdict.py.
        """
        # Numbers with their units, as all texts show them.
        facts = self.facts()
        j = self.worst_joint - 1
        if self.drive == "pd":
            return (
                f"Simulated under control, joint {j + 1} needs"
                f" {facts['loop_percent'].text} of its measured torque from the loop, the"
                f" others less; the arm {self._stays}."
            )
        unit = f"m{self.units[j]}"
        return (
            f"Simulated {self.ahead.seconds:.3g} s, joint {j + 1} drifts"
            f" {facts['worst_drift'].texts[0]} {unit} (constant-velocity guess:"
            f" {facts['worst_guess'].texts[0]} {unit}){self._free_run_words}."
        )

    @property
    def _shown_free_run(self) -> FreeRun | None:
        """The first run, which stands for all free runs; None where it was stopped before
        its end, so that no two places show free runs of different lengths."""
        free = self.free[0]
        return None if free.cut else free

    @property
    def _stays(self) -> str:
        """Phrase on how close the free run with the largest error stays to the
        measured motion.
        """
        worst = max(self.free, key=lambda run: float(run.rms.max()))
        joint = int(np.argmax(worst.rms))
        return (
            f"stays within {in_thousandths(worst.rms[joint], self.units[joint])} RMS over"
            f" {worst.seconds:.3g} s"
        )

    @property
    def _free_run_words(self) -> str:
        """Phrase on the free run: when it leaves the measured motion, or how close it
        stays.

        "" if it was stopped before the end of the run.
        """
        # The run that leaves first, if any does.
        first = min(self.free, key=lambda run: run.seconds if run.left else np.inf)
        if first.left:
            return (
                f"; the free run leaves the measured motion after {first.seconds:.2g} s"
            )
        if any(f.cut for f in self.free):
            return ""
        return f"; the free run {self._stays}"

    def _summary(self) -> Summary:
        """Return the title for the repr: the verdict is all."""
        return self.verdict, []

    def table(self) -> Table:
        """Return a table of the errors, one row for each joint, in thousandths of its
        unit.

        Columns: velocity after one step; position at the horizon with its 5 % and 95 %
        quantiles, and for a constant velocity; the free run with its 95 % band.
        """
        free, ahead = self._shown_free_run, self.ahead
        columns = {
            "velocity after 1 step [/s]": self.one_step.rms,
            f"after {ahead.seconds:.3g} s": ahead.rms,
            "5 % are below": ahead.band[0],
            "95 % are below": ahead.band[1],
            "constant velocity": ahead.naive,
        }
        if free is not None:
            columns["free run"] = free.rms
            if np.isfinite(band := free.spread_within_sight(self.units)).any():
                columns["± (95 %)"] = band
        loop = None if free is None else free.loop
        rows = []
        for j, unit in enumerate(self.units):
            numbers = [
                f"{1e3 * x[j]:.3g}" if np.isfinite(x[j]) else "unbounded"
                for x in columns.values()
            ]
            row = [f"{j + 1}", f"m{unit}", *numbers]
            if loop is not None:
                row.append(f"{loop[j]:.3g} {'N' if unit == 'm' else 'N m'}")
            rows.append(row)
        heads = ["joint", "unit", *columns, *["loop"] * (loop is not None)]
        return Table(heads, rows, words=(0, 1))

    _table = table

    def to_frame(self) -> pandas.DataFrame:
        """Return the errors as a data frame, one row for each joint (from 1).

        The names of the columns include their units.
        """
        import pandas

        columns = {
            "unit of position": self.units,
            "velocity after 1 step [unit/s]": self.one_step.rms,
            f"after {self.ahead.seconds:.3g} s [unit]": self.ahead.rms,
            "constant velocity [unit]": self.ahead.naive,
            "free run [unit]": self.free[0].rms,
        }
        joints = pandas.Index(range(1, len(self.units) + 1), name="joint")
        return pandas.DataFrame(columns, joints)

    @property
    def explained(self) -> str:
        """Sentence that explains the columns of :meth:`table`: what each error is, in
        which unit, over which time."""
        free = self._shown_free_run
        text = (
            "RMS errors, in the unit of the joint's row: of the velocity after one step, of"
            f" the position after {self.ahead.seconds:.3g} s of simulation (and below which"
            " size 5 % and 95 % of its errors are; the same of going on at constant velocity)"
        )
        if free is None:
            return f"{text}."
        text += f", and of the free run of {free.seconds:.3g} s"
        if np.isfinite(free.spread_within_sight(self.units)).any():
            text += (
                " (±: what the parameters' 95 % intervals make of it; unbounded: wider than a"
                " motion that still follows)"
            )
        if free.loop is not None:
            text += "; loop: what the control loop had to add"
        return f"{text}."


def in_thousandths(value: float, unit: str) -> str:
    """Write an angle or a length in thousandths of its unit.

    >>> in_thousandths(0.0123, "rad")
    '12.3 mrad'
    """
    return f"{1e3 * value:.3g} m{unit}"


@checked_arguments
def follow(
    model: Estimate | str | Path,
    measurements: Source,
    *,
    drive: Drive = "torque",
    seed: int = 0,
    steps: int | None = None,
    progress: Progress = no_progress,
    windows: int = 200,
) -> Following:
    """Run a model forward along measured runs, and compare the motion.

    Short windows of each run are simulated from measured states, and each run as a
    whole from its first moving state ("free run").

    Parameters
    ----------
    model : Estimate, str or Path
        The model, or its model.json.
    measurements : path, arrays, DataFrame, Measurements, list of these
        The runs to follow, with their torques or commands.
    drive : {"torque", "pd", "servo"}
        What moves the arm: the measured torque alone, this torque and a loop on the
        measured motion, or the command, through the model's servos.
    seed : int
        Seed of the random models that give the free runs' band.
    steps : int, optional
        Largest number of simulation steps of all free runs together. If it is given,
        a long recording is reduced to windows, as many as show its noise.
    progress : callable
        Called with a short text at each step of the computation.
    windows : int
        Largest number of windows of each run.

    Returns
    -------
    Following
        Errors of the simulated motion over the horizon and in the free run.

    Raises
    ------
    InputError
        For a model that cannot accelerate, or runs too short for its filters.
    """
    estimate = as_estimate(model, "follow(model=...)")
    if drive not in ("torque", "pd", "servo"):
        raise InputError(f"unknown drive {drive!r}", "choose torque, pd or servo")
    require_in_range("follow(steps)", 1 if steps is None else steps, 1, 10**9)
    require_in_range("follow(windows)", windows, 1, 1e5)
    runs = as_measurements(
        measurements,
        estimate.robot.n,
        estimate.robot.joint_names,
        "follow(measurements=...)",
    )
    if drive == "servo" and not estimate.model.drives.any():
        raise InputError(
            "this model knows no servo", "identify it from a log with commands"
        )
    if drive != "servo":
        estimate, runs = driven(estimate, runs)
    plant = _movable_plant(estimate)
    if steps is not None:
        runs = window_subsample(runs, estimate.preprocessing.resolve(runs))
    driven_plants = _drive_along(runs, estimate, plant, drive)
    progress("simulating windows")
    of_runs = [_simulate_windows(x, windows) for x in driven_plants]
    errors = _WindowErrors(*map(np.concatenate, zip(*of_runs, strict=True)))
    samples = _sampled_parameters(estimate, seed)
    # A servo loop simulates the model itself only, so that it has no band.
    parameters = samples[:1] if drive == "servo" else samples
    free = []
    for driven_plant in driven_plants:
        progress(f"simulating {driven_plant.course.name} freely")
        most_steps = None
        if steps is not None:
            most_steps = 1 + steps // (len(driven_plants) * driven_plant.substeps)
        free.append(_simulate_free_run(estimate, parameters, driven_plant, most_steps))
    first = driven_plants[0]
    return Following(
        drive,
        estimate.robot.position_units,
        one_step=Ahead.from_errors(
            first.course.dt, errors.velocity, errors.naive_velocity
        ),
        ahead=Ahead.from_errors(_HORIZON, errors.position, errors.naive_position),
        free=tuple(free),
        left_out=plant.left_out,
    )


def _movable_plant(estimate: Estimate) -> Plant:
    """Return the plant of a model. Raises InputError if its mass matrix is not positive
    definite."""
    plant = Plant(estimate.model, estimate.theta)
    if not plant.can_move:
        what = (
            "M(q) is not positive definite: this arm would accelerate against the"
            " torque"
        )
        remedy = "identify with a method that imposes consistency (lmi-sdp, penalty)"
        raise InputError(what, remedy, f"model {estimate.problem.name}")
    return plant


def _drive_along(
    runs: Measurements, estimate: Estimate, plant: Plant, drive: Drive
) -> list[_DrivenPlant]:
    """Return the plant along each course of the runs, with what drives it."""
    courses = list[Course]()
    shortest = 2.0 * _HORIZON  # stretches up to two windows are left out
    for run in runs.runs():
        courses += courses_of(run, estimate, plant, shortest)
    loop = (plant, 2.0 * np.pi * _LOOP_BANDWIDTH) if drive == "pd" else None
    servo = ServoLoop(estimate.model, estimate.theta) if drive == "servo" else None
    return [_DrivenPlant(plant, course, loop, servo) for course in courses]


@dataclass(frozen=True)
class _DrivenPlant:
    """Plants (one model, or several samples of it) along a measured course, and what
    drives them."""

    #: The plants that are simulated.
    plant: Plant
    #: The measured course.
    course: Course
    #: Loop beside the measured torque: plant of the model's mass and bandwidth w
    #: [rad/s]; None without a loop.
    loop: tuple[Plant, float] | None
    #: Servo that drives the plants in place of the measured torque; None without one.
    servo: ServoLoop | None

    @property
    def substeps(self) -> int:
        """Number of simulation steps within a sample of the log: as few as make no step
        longer than STEP [s]; 1e-9 allows for rounding."""
        return int(np.ceil(self.course.dt / STEP - 1e-9))

    def added(
        self, state: PlantState, k: Indices, share: float, h: float
    ) -> tuple[Array, Array]:
        """Return the torque of the control loop, M(q) (w^2 e + 2 w de/dt), critically
        damped.

        e is the measured minus the simulated position at the middle of a step. The
        derivative lets the integrator treat the stiff loop implicitly.

        Parameters
        ----------
        state : PlantState
            Simulated states of W windows.
        k : (W,) array
            Sample at which each window's step begins.
        share : float
            Middle of the step between samples k and k + 1, from 0 to 1.
        h : float
            Length of the step [s].

        Returns
        -------
        (W, n) array and (W, n, n) array
            Torque [N m, N], and minus its derivative by the velocity.
        """
        assert self.loop is not None
        plant, w = self.loop
        states = self.course.states
        # Measured and simulated motion at the middle of the step.
        q = (1.0 - share) * states.q[k] + share * states.q[k + 1]
        dq = (1.0 - share) * states.dq[k] + share * states.dq[k + 1]
        half_step = 0.5 * h * state.dq + 0.125 * h * h * state.ddq
        position_error = q - state.q - half_step
        velocity_error = dq - state.dq - 0.5 * h * state.ddq
        acceleration = w * w * position_error + 2.0 * w * velocity_error
        M = plant.mass(states.q[k])  # (W, n, n)
        torque = np.einsum("kij,kj->ki", M, acceleration)  # M times vector, each window
        return torque, (2.0 * w + 0.5 * h * w * w) * M

    def step(self, state: PlantState, k: Indices) -> PlantState:
        """Simulate from sample k (W,) of the measured run to the next one, for W
        windows.

        Raises InputError if a servo drives the arm, and the run has no commands.
        """
        course = self.course
        h = self.course.dt / self.substeps
        for m in range(self.substeps):
            # A servo follows the command; otherwise a torque drives the arm.
            if self.servo is not None:
                if course.command is None:
                    raise InputError(
                        "this run holds no commands", "log qcmd1..qcmdn", course.name
                    )
                state = self.servo.step(state, course.command, h)
                continue
            # The measured torque at the middle of the step, and that of the loop.
            share = (m + 0.5) / self.substeps
            damping = None
            torque = (1.0 - share) * course.torque[k] + share * course.torque[k + 1]
            if self.loop is not None:
                loop_torque, damping = self.added(state, k, share, h)
                torque = torque + loop_torque
            state = advance(self.plant, state, torque, h, damping)
        return state


class _WindowErrors(NamedTuple):
    """Errors (W, n) over W short windows, simulated minus measured."""

    #: Of the velocity after one sample [rad/s, m/s].
    velocity: Array
    #: Of the position at the horizon [rad, m].
    position: Array
    #: Of the velocity, if it stayed as it was.
    naive_velocity: Array
    #: Of the position at the horizon, at constant velocity.
    naive_position: Array


def _simulate_windows(driven_plant: _DrivenPlant, most_windows: int) -> _WindowErrors:
    """Simulate short windows spread evenly over the moving part of a run, at most so
    many."""
    course = driven_plant.course
    states = driven_plant.course.states
    dt = driven_plant.course.dt
    steps = max(1, round(_HORIZON / dt))
    candidates = np.flatnonzero(course.moving[: len(states.t) - steps - 1])
    if not len(candidates):
        candidates = np.arange(len(states.t) - steps - 1)
    n_windows = min(most_windows, len(candidates))
    spread = np.unique(np.linspace(0, len(candidates) - 1, n_windows).astype(int))
    start = candidates[spread]  # (W,) first sample of each window
    state = states.rows(start)
    velocity_error = np.zeros((len(start), states.q.shape[1]))
    for k in range(steps):
        state = driven_plant.step(state, start + k)
        if k == 0:
            velocity_error = state.dq - states.dq[start + 1]
    measured = states.q[start + steps]
    at_constant_velocity = states.q[start] + steps * dt * states.dq[start]
    return _WindowErrors(
        velocity_error,
        state.q - measured,
        states.dq[start] - states.dq[start + 1],
        at_constant_velocity - measured,
    )


def _sampled_parameters(estimate: Estimate, seed: int) -> Array:
    """Return the parameters, and samples of them from their estimated covariance.

    Samples with a mass matrix that is not positive definite are left out, because they
    cannot be simulated.

    Parameters
    ----------
    estimate : Estimate
        The model; its uncertainty holds a factor of the covariance.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    (1 + d, p) array
        The estimate itself first; d <= _DRAWS.
    """
    # (p, r) factor L of the covariance L L^T, and the standard deviations (p,).
    factor = np.nan_to_num(estimate.uncertainty.factor)
    if not np.any(factor):
        return estimate.theta[None]
    std = nonzero_or_one(np.linalg.norm(factor, axis=1))
    u, s, _ = np.linalg.svd(factor / std[:, None], full_matrices=False)
    # The symmetric root U S U^T of the correlation is unique; signs of the factor's
    # columns depend on rounding.
    normal = np.random.default_rng(seed).normal(size=(_DRAWS, len(std)))
    correlated = normal @ (u * s) @ u.T
    samples = estimate.theta + correlated * std
    movable = [x for x in samples if Plant(estimate.model, x).can_move]
    return np.array([estimate.theta, *movable])


def _simulate_free_run(
    estimate: Estimate,
    samples: Array,
    driven_by_model: _DrivenPlant,
    most_steps: int | None,
) -> FreeRun:
    """Simulate a run from its first moving state until it ends or leaves the measured
    one.

    Parameters
    ----------
    samples : (1 + d, p) array
        The parameters, then samples of them, which give the band of the result.
    most_steps : int, optional
        Largest number of samples to simulate.
    """
    # All samples of the parameters are simulated at once; row 0 is the model itself.
    driven_plant = replace(driven_by_model, plant=Plant(estimate.model, samples))
    course = driven_plant.course
    states = course.states
    # Distance from which the simulation counts as having left the measured motion.
    limit = np.array([_LEFT[unit] for unit in estimate.robot.position_units])
    start = int(np.flatnonzero(course.moving)[0]) if course.moving.any() else 0
    end = len(course.torque) - 1
    if most_steps is not None:
        end = min(end, start + most_steps)
    motion, loop_torque = _simulate_until_it_leaves(driven_plant, start, end, limit)
    until = start + len(motion)
    # "not <=" is true for nan as well, where the simulation has overflown.
    last_error = np.abs(motion[-1, 0] - states.q[until - 1])
    has_left = not np.all(last_error <= limit)
    # Half width of the 95 % band that the parameters' uncertainty makes of the motion.
    spread = None
    if len(samples) > 2:
        deviation = motion[:, 1:] - motion[:, :1]
        spread = NORMAL_95 * np.sqrt(np.nanmean(deviation**2, axis=(0, 1)))
    torque = course.torque[start:until]
    t = states.t[start:until]
    return FreeRun(
        seconds=float(t[-1] - t[0]),
        left=has_left,
        rms=_rms(motion[:, 0] - states.q[start:until]),
        spread=spread,
        loop=_rms(loop_torque) if len(loop_torque) else None,
        torque=_rms(torque),
        simulated=Measurements(t, motion[:, 0], torque, names=(course.name,)),
        measured=states.q[start:until],
        cut=not has_left and bool(states.t[-1] - states.t[end] > 1.0),
    )


def _simulate_until_it_leaves(
    driven_plant: _DrivenPlant, start: int, end: int, limit: Array
) -> tuple[Array, Array]:
    """Simulate the samples from ``start`` to ``end``, from the measured state; stop where
    the first model is farther than limit (n,) from the measured motion.

    Returns
    -------
    (samples, models, n) array
        Positions of all models of the driven_plant's plant.
    (steps, n) array
        Torque that the loop adds for the first model; no steps without a loop.
    """
    measured = driven_plant.course.states
    n_models = len(driven_plant.plant.theta)
    state = measured.rows(np.full(n_models, start))
    motion = [state.q]
    loop_torque = []
    for k in range(start, end):
        sample = np.full(n_models, k)
        if driven_plant.loop is not None:
            loop_torque.append(
                driven_plant.added(state, sample, share=0.0, h=0.0)[0][0]
            )
        state = driven_plant.step(state, sample)
        motion.append(state.q)
        if not np.all(np.abs(state.q[0] - measured.q[k + 1]) <= limit):
            break
    return np.array(motion), np.array(loop_torque)


def _rms(error: Array) -> Array:
    """Return the root mean square over the rows (N, n), one for each joint: (n,)."""
    return np.sqrt(np.mean(error**2, axis=0))
