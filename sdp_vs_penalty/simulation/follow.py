"""A model run forward along measured runs: how far ahead it says where the arm will be.

Windows of a tenth of a second are started from the measured state and driven by the
measured torque, a sample or 2.5 ms a step; the free run is started once. With
``drive="servo"`` the command drives it, through the identified law of its servos. With
``drive="pd"`` a proportional and derivative loop on the measured motion acts beside the
measured torque, so that the arm stays with it: what the loop has to add is then the
model's error as a torque.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.forward import Plant, ServoLoop, State, advance
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.drive_torque import driven
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimation.output_error import STEP, Course, courses_of
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.files import JsonRecord
from sdp_vs_penalty.results.facts import fact
from sdp_vs_penalty.results.record import Record, Summary
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.robot.arrays import Array, at_least_tiny, nonzero_or_one
from sdp_vs_penalty.signals.segments import window_subsample

if TYPE_CHECKING:
    import pandas

Drive = Literal["torque", "pd", "servo"]

#: A free run has left the measured one beyond this error [rad, m].
_LEFT = {
    "rad": 0.5,
    "m": 0.1,
}


@dataclass(frozen=True)
class Ahead(JsonRecord):
    """Errors after so many seconds, over all windows, each (n,) in rad (m) or rad/s
    (m/s).

    rms : root mean square; band : (2, n) 5 and 95 % of the absolute errors; naive :
    root mean square of going on at the measured velocity.
    """

    seconds: float
    rms: Array
    band: Array
    naive: Array

    @classmethod
    def of(
        cls,
        seconds: float,
        error: Array,
        naive: Array,
    ) -> Self:
        """From errors (K, n) of K windows so many seconds ahead, and those of standing
        still."""
        band = np.quantile(
            np.abs(error),
            [0.05, 0.95],
            axis=0,
        )
        return cls(
            seconds,
            _rms(error),
            band,
            _rms(naive),
        )


@dataclass(frozen=True)
class FreeRun(JsonRecord):
    """One run from its first state: errors (n,) until ``seconds``, where it ``left``
    the measured motion or that ended; spread : half a 95 % band that the parameters'
    intervals make of it, where they are known; loop : (n,) root mean square of what the
    loop added [N m, N], torque : of the measured one; simulated : the motion; measured
    : (N, n) positions then; cut : whether the run goes on."""

    seconds: float
    left: bool
    rms: Array
    spread: Array | None
    loop: Array | None
    torque: Array
    simulated: Measurements
    measured: Array
    cut: bool

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON of the figures."""
        motion = "simulated", "measured", "cut"
        figures = {k: x for k, x in super().to_dict().items() if k not in motion}
        return {
            "run": self.simulated.names[0],
            "cut": self.cut,
            **figures,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """What :meth:`to_dict` wrote; without the motion."""
        torque = np.array(data["torque"], float)
        nothing = np.zeros((0, len(torque)))
        spread, loop = data["spread"], data["loop"]
        return cls(
            seconds=float(data["seconds"]),
            left=bool(data["left"]),
            rms=np.array(data["rms"], float),
            spread=None if spread is None else np.array(spread, float),
            loop=None if loop is None else np.array(loop, float),
            torque=torque,
            simulated=Measurements(
                np.zeros(0),
                nothing,
                nothing,
                names=(data["run"],),
            ),
            measured=nothing,
            cut=bool(data.get("cut", False)),
        )


@dataclass(
    frozen=True,
    repr=False,
)
class Following(Record):
    """What a model run forward makes of measured runs. one_step : velocity after one
    step; ahead : position after a tenth of a second; left_out : effects that have no
    forward meaning here."""

    drive: Drive
    units: tuple[str, ...]
    one_step: Ahead
    ahead: Ahead
    free: tuple[FreeRun, ...]
    left_out: tuple[str, ...]

    @property
    def share(self) -> Array:
        """(n,) error a tenth of a second ahead over that of going on at constant
        velocity; with a loop, the torque that it adds over the measured one."""
        pairs = [(f.loop, f.torque) for f in self.free if f.loop is not None]
        shares = [
            a / at_least_tiny(b)
            for a, b in pairs or [(self.ahead.rms, self.ahead.naive)]
        ]
        return np.asarray(np.max(shares, axis=0))

    @fact("", digits=9)
    def worst_joint(self) -> int:
        """The joint (from 1) whose simulation is worst against the simplest guess."""
        return int(np.argmax(self.share)) + 1

    @fact("thousandths of rad or m", name="drift of the worst joint")
    def worst_drift(self) -> float:
        """Root mean square error of the worst joint's position after a tenth of a second
        of simulation."""
        return 1e3 * float(self.ahead.rms[self.worst_joint - 1])

    @fact("thousandths of rad or m", name="the same at constant velocity")
    def worst_guess(self) -> float:
        """The same error of going on at the measured velocity."""
        return 1e3 * float(self.ahead.naive[self.worst_joint - 1])

    @fact("%", name="torque from the loop")
    def loop_percent(self) -> float | None:
        """Torque that the control loop adds on the worst joint, over the measured one;
        without a loop there is none."""
        if self.drive != "pd":
            return None
        return 100.0 * float(self.share[self.worst_joint - 1])

    @property
    def verdict(self) -> str:
        """How far ahead it is right, in a sentence; the grade of a model is
        estimation/verdict.py's."""
        facts, j = self.facts(), self.worst_joint - 1
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
    def _stays(self) -> str:
        """How near the free run stays to the measured one."""
        worst = max(self.free, key=lambda f: float(f.rms.max()))
        k = int(np.argmax(worst.rms))
        return (
            f"stays within {said(worst.rms[k], self.units[k])} RMS over"
            f" {worst.seconds:.3g} s"
        )

    @property
    def _free_run_words(self) -> str:
        """What the free run does; "" of one that was not followed to its end."""
        first = min(self.free, key=lambda f: f.seconds if f.left else np.inf)
        if first.left:
            return (
                f"; the free run leaves the measured motion after {first.seconds:.2g} s"
            )
        if any(f.cut for f in self.free):
            return ""
        return f"; the free run {self._stays}"

    def _summary(self) -> Summary:
        return self.verdict, []

    def table(self) -> Table:
        """Headings, and one row a joint, in thousandths of its unit: velocity after one step, position
        0.1 s ahead with 5 and 95 % and what a constant velocity gives, the free run and its spread.
        """
        free, ahead = self.free[0], self.ahead
        columns = {
            "velocity after 1 step [/s]": self.one_step.rms,
            f"after {ahead.seconds:.3g} s": ahead.rms,
            "5 %": ahead.band[0],
            "95 %": ahead.band[1],
            "constant velocity": ahead.naive,
            "free run": free.rms,
        }
        if free.spread is not None:
            columns["95 % band"] = free.spread
        rows = []
        for j, unit in enumerate(self.units):
            numbers = [f"{1e3 * x[j]:.3g}" for x in columns.values()]
            row = [f"{j + 1}", f"m{unit}", *numbers]
            if free.loop is not None:
                row.append(f"{free.loop[j]:.3g} {'N' if unit == 'm' else 'N m'}")
            rows.append(row)
        heads = [
            "joint",
            "unit",
            *columns,
            *["loop"] * (free.loop is not None),
        ]
        return Table(heads, rows, words=(0, 1))

    _table = table

    def to_frame(self) -> pandas.DataFrame:
        """One row a joint (from 1): errors after one step, after the horizon, at
        constant velocity and of the free run; units in the columns' names."""
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
        """What the columns of :meth:`table` are."""
        free = self.free[0]
        text = (
            "RMS errors in thousandths of the unit: of the velocity after one step, of"
            f" the position after {self.ahead.seconds:.3g} s of simulation (5 % and 95 %"
            " of the errors' sizes; the same of going on at constant velocity), and of"
            f" the free run of {free.seconds:.3g} s"
        )
        if free.spread is not None:
            text += " (half the 95 % band that the parameters' intervals make of it)"
        if free.loop is not None:
            text += "; loop: what the control loop had to add"
        return f"{text}."

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """What :meth:`to_dict` wrote; the free runs without their motion."""
        return cls(
            drive=data["drive"],
            units=tuple(data["units"]),
            one_step=Ahead.from_dict(data["one_step_velocity"]),
            ahead=Ahead.from_dict(data["ahead_position"]),
            free=tuple(map(FreeRun.from_dict, data["free_run"])),
            left_out=tuple(data["left_out"]),
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        held = {
            "drive": self.drive,
            "units": list(self.units),
            "left_out": list(self.left_out),
        }
        horizon_fields = {
            "one_step_velocity": self.one_step.to_dict(),
            "ahead_position": self.ahead.to_dict(),
        }
        return {
            "verdict": self.verdict,
            **held,
            **horizon_fields,
            "free_run": [f.to_dict() for f in self.free],
            "facts": self.facts_to_dict(),
        }


def said(value: float, unit: str) -> str:
    """An angle or a length in thousandths.

    >>> said(0.0123, "rad")
    '12.3 mrad'
    """
    return f"{1e3 * value:.3g} m{unit}"


def follow(
    model: Estimate | str | Path,
    measurements: Source,
    *,
    drive: Drive = "torque",
    seed: int = 0,
    steps: int | None = None,
    progress: Progress = no_progress,
    horizon: float = 0.1,
    bandwidth: float = 5.0,
    draws: int = 8,
    windows: int = 200,
) -> Following:
    """Run a model forward along measured runs, and compare the motion.

    Parameters
    ----------
    model : Estimate, str or Path
        The model, or its model.json.
    measurements : path, arrays, DataFrame, Measurements, list of these
        The runs.
    drive : {"torque", "pd", "servo"}
        What moves the arm: the measured torque alone, this torque and a loop on the
        measured motion, or the command, through the model's servos.
    seed : int
        Of the draws.
    steps : int, optional
        Of the free runs, together, at most. Of a long recording windows are followed
        then, as many as show its noise.
    progress : callable
        Hears where the computation stands, a short text each time.
    horizon : float
        Length of a window [s].
    bandwidth : float
        Of the loop [Hz].
    draws : int
        So many models are drawn from the parameters' intervals, for the band of the
        free run.
    windows : int
        So many windows a run, at most.

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
    plant = Plant(estimate.model, estimate.theta)
    if not plant.can_move:
        what = (
            "M(q) is not positive definite: this arm would accelerate against the"
            " torque"
        )
        remedy = "identify with a method that imposes consistency (lmi-sdp, penalty)"
        raise InputError(what, remedy, f"model {estimate.problem.name}")
    if steps is not None:
        runs = window_subsample(runs, estimate.preprocessing.resolve(runs))
    courses = [
        course
        for run in runs.runs()
        for course in courses_of(run, estimate, plant, 2.0 * horizon)
    ]
    loop = (plant, 2.0 * np.pi * bandwidth) if drive == "pd" else None
    servo = ServoLoop(estimate.model, estimate.theta) if drive == "servo" else None
    rides = [
        _Ride(
            plant,
            course,
            loop,
            servo,
        )
        for course in courses
    ]
    progress("simulating windows")
    windows_by_ride = zip(
        *(_windows(ride, horizon, windows) for ride in rides), strict=True
    )
    joined = [np.concatenate(x) for x in windows_by_ride]
    one, far, naive_one, naive_far = joined
    drawn = _drawn(estimate, seed, draws)
    free = []
    for ride in rides:
        progress(f"simulating {ride.course.name} freely")
        most_steps = (
            None if steps is None else 1 + steps // (len(courses) * ride.substeps)
        )
        free.append(
            _free_run(
                estimate,
                drawn[:1] if servo else drawn,
                ride,
                most_steps,
            )
        )
    return Following(
        drive,
        estimate.robot.position_units,
        one_step=Ahead.of(courses[0].dt, one, naive_one),
        ahead=Ahead.of(horizon, far, naive_far),
        free=tuple(free),
        left_out=plant.left_out,
    )


@dataclass(frozen=True)
class _Ride:
    """Plants along a measured course, and what drives them: the measured torque, a loop
    of the model's own mass beside it, at w [rad/s], or a servo."""

    plant: Plant
    course: Course
    loop: tuple[Plant, float] | None
    servo: ServoLoop | None

    @property
    def substeps(self) -> int:
        """Steps within a sample, no longer than the simulation's."""
        return int(np.ceil(self.course.dt / STEP - 1e-9))

    def added(
        self,
        state: State,
        k: NDArray[np.intp],
        share: float,
        h: float,
    ) -> tuple[Array, Array]:
        """M(q) (w^2 e + 2 w de/dt), critically damped: (W, n) at the middle of a step
        of h [s], between samples k and k + 1, and (W, n, n) its fall with the velocity
        there."""
        assert self.loop is not None
        (mass, w), states = self.loop, self.course.states
        q = (1.0 - share) * states.q[k] + share * states.q[k + 1]
        dq = (1.0 - share) * states.dq[k] + share * states.dq[k + 1]
        half = 0.5 * h * state.dq + 0.125 * h * h * state.ddq
        pull = w * w * (q - state.q - half) + 2.0 * w * (
            dq - state.dq - 0.5 * h * state.ddq
        )
        M = mass.mass(states.q[k])
        return np.einsum("kij,kj->ki", M, pull), (2.0 * w + 0.5 * h * w * w) * M

    def step(
        self,
        state: State,
        k: NDArray[np.intp],
    ) -> State:
        """From sample k (W,) of the course to the next. InputError where a servo has no
        command."""
        course = self.course
        h = self.course.dt / self.substeps
        for m in range(self.substeps):
            if self.servo is not None:
                if course.command is None:
                    raise InputError(
                        "this run holds no commands",
                        "log qcmd1..qcmdn",
                        course.name,
                    )
                state = self.servo.step(state, course.command, h)
                continue
            share = (m + 0.5) / self.substeps
            damping = None
            torque = (1.0 - share) * course.torque[k] + share * course.torque[k + 1]
            if self.loop is not None:
                more, damping = self.added(
                    state,
                    k,
                    share,
                    h,
                )
                torque = torque + more
            state = advance(
                self.plant,
                state,
                torque,
                h,
                damping,
            )
        return state


def _windows(
    ride: _Ride,
    horizon: float,
    most_windows: int,
) -> tuple[Array, Array, Array, Array]:
    """Errors (W, n) of windows all over the course: of velocity after one step, of
    position at the horizon; and both at constant velocity."""
    course = ride.course
    states = ride.course.states
    dt = ride.course.dt
    steps = max(1, round(horizon / dt))
    starts = np.flatnonzero(course.moving[: len(states.t) - steps - 1])
    if not len(starts):
        starts = np.arange(len(states.t) - steps - 1)
    at = starts[
        np.unique(
            np.linspace(0, len(starts) - 1, min(most_windows, len(starts))).astype(int)
        )
    ]
    state = states.rows(at)
    first = np.zeros((len(at), states.q.shape[1]))
    for k in range(steps):
        state = ride.step(state, at + k)
        if k == 0:
            first = state.dq - states.dq[at + 1]
    straight = states.q[at] + steps * dt * states.dq[at]
    there = states.q[at + steps]
    return first, state.q - there, states.dq[at] - states.dq[at + 1], straight - there


def _drawn(estimate: Estimate, seed: int, draws: int) -> Array:
    """(1 + draws, p) the parameters, and some drawn from what the data leave open of
    them."""
    factor = np.nan_to_num(estimate.uncertainty.factor)
    if not np.any(factor):
        return estimate.theta[None]
    std = nonzero_or_one(np.linalg.norm(factor, axis=1))
    u, s, _ = np.linalg.svd(factor / std[:, None], full_matrices=False)
    # By the symmetric root of the correlation, which is unique: a factor's signs are
    # rounding's.
    white = np.random.default_rng(seed).normal(size=(draws, len(std))) @ (u * s) @ u.T
    drawn = [
        x for x in estimate.theta + white * std if Plant(estimate.model, x).can_move
    ]
    return np.array([estimate.theta, *drawn])


def _free_run(
    estimate: Estimate,
    drawn: Array,
    measured: _Ride,
    most_steps: int | None,
) -> FreeRun:
    ride = replace(measured, plant=Plant(estimate.model, drawn))
    course = ride.course
    states = ride.course.states
    size = len(drawn)
    limit = np.array([_LEFT[unit] for unit in estimate.robot.position_units])
    start = int(np.flatnonzero(course.moving)[0]) if course.moving.any() else 0
    state = states.rows(np.full(size, start))
    q = [state.q]
    added = []
    left = False
    end = (
        len(course.torque) - 1
        if most_steps is None
        else min(start + most_steps, len(course.torque) - 1)
    )
    for k in range(start, end):
        at = np.full(size, k)
        if ride.loop is not None:
            added.append(
                ride.added(
                    state,
                    at,
                    0.0,
                    0.0,
                )[0][0]
            )
        state = ride.step(state, at)
        q.append(state.q)
        if not np.all(np.abs(state.q[0] - states.q[k + 1]) <= limit):
            left = True
            break
    motion = np.array(q)
    until = start + len(q)
    error = motion[:, 0] - states.q[start:until]
    spread = None
    if size > 2:
        spread = NORMAL_95 * np.sqrt(
            np.nanmean((motion[:, 1:] - motion[:, :1]) ** 2, axis=(0, 1))
        )
    torque = course.torque[start:until]
    t = states.t[start:until]
    return FreeRun(
        seconds=float(t[-1] - t[0]),
        left=left,
        rms=_rms(error),
        spread=spread,
        loop=_rms(np.array(added)) if added else None,
        torque=_rms(torque),
        simulated=Measurements(
            t,
            motion[:, 0],
            torque,
            names=(course.name,),
        ),
        measured=states.q[start:until],
        cut=not left and bool(states.t[-1] - states.t[end] > 1.0),
    )


def _rms(error: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)))
