"""Exciting trajectories: Fourier series whose regressor is as well conditioned as the
limits allow.

For W(x), the stacked base regressor of a trajectory with coefficients x = (a, b, q_0) of
:class:`~sdp_vs_penalty.robot.trajectory.FourierTrajectory`,

    minimise log(|W|_F |W^+|_F)   ("condition", a smooth upper bound of log cond W), or
             -log det W^T W / p   ("d-optimal": the volume of the confidence ellipsoid)

subject to limits of position, velocity and acceleration at every instant (Swevers et
al., T-RA 1997; Gautier, Khalil, IJRR 1992): linear inequalities in x, which every step
of the sequential linear programming (in a trust region, x in units of the limits)
keeps. Collisions are not looked at: choose position limits within which the robot is
free. :func:`payload_run` weighs a load: a short motion of the wrist, d-optimal for its
ten parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.links import Payload
from sdp_vs_penalty.effects.model import Model, depends
from sdp_vs_penalty.errors import InputError, require_known
from sdp_vs_penalty.estimation.constants import DIFFERENCE
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.regression.linalg import deviations
from sdp_vs_penalty.results.record import Shown, Summary
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot, joint_limits
from sdp_vs_penalty.robot.trajectory import (
    FourierTrajectory,
    PointTrajectory,
    random_trajectory,
)

#: Rate at which motions are looked at [Hz].
RATE = 20.0


@dataclass(frozen=True)
class Regressor:
    """Columns of a model: W (N n, p) of a motion; scale (n,) : of each joint's rows."""

    model: Model
    columns: NDArray[np.intp]
    scale: Array | float = 1.0

    def at(
        self,
        t: Array,
        q: Array,
        dq: Array,
        ddq: Array,
    ) -> Array:
        """Rows of states.

        Parameters
        ----------
        t : (N,) array
            Instants [s].
        q : (N, n) array
            Positions [rad, m].
        dq : (N, n) array
            Velocities [rad/s, m/s].
        ddq : (N, n) array
            Accelerations [rad/s^2, m/s^2].

        Returns
        -------
        (N, n, p) array
            Of each instant and joint.
        """
        wide = np.stack(
            list(self.model.dense_columns(Motion(t, q, dq, ddq))[..., self.columns]),
            axis=1,
        )
        return wide * np.broadcast_to(self.scale, self.model.robot.n)[:, None]

    def along(self, trajectory: FourierTrajectory, rate: float = RATE) -> Array:
        """W of a trajectory.

        Parameters
        ----------
        trajectory : FourierTrajectory
            To be sampled.
        rate : float
            At which [Hz].

        Returns
        -------
        (N n, p) array
            W.
        """
        t = np.arange(0.0, trajectory.duration, 1.0 / rate)
        return self.at(t, *trajectory.states(t)).reshape(-1, len(self.columns))

    def condition(self, trajectory: FourierTrajectory) -> float:
        """Condition number of W.

        Parameters
        ----------
        trajectory : FourierTrajectory
            Along which.

        Returns
        -------
        float
            Ratio of the extreme singular values.
        """
        return float(np.linalg.cond(self.along(trajectory)))

    @classmethod
    def of(
        cls,
        problem: Problem,
        effects: str | None = None,
    ) -> Regressor:
        """The columns of a problem's own base parameters.

        Parameters
        ----------
        problem : Problem
            With its robot.
        effects : str, optional
            Names with commas between them; default: the problem's.

        Returns
        -------
        Regressor
            Of the parameters that lead the base parameters.

        Raises
        ------
        InputError
            For effects with a memory.
        """
        model = problem.model(effects)
        for effect in model.effects:
            if effect.has_memory or depends(effect):
                what = (
                    f"effect {effect.name}: its columns depend on more than the state"
                )
                raise InputError(what, "leave it out of the excitation.")
        return cls(model, np.array(base_rows(problem, model).leading))


OBJECTIVES = ("condition", "d-optimal")


@dataclass(frozen=True)
class Limits:
    """(n,) lower and upper position [rad, m], velocity and acceleration limits; all in
    one clock [s].

    Raises InputError naming the joint for limits within which nothing can move.
    """

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array

    def __post_init__(self) -> None:
        rows = np.column_stack(
            [self.lower, self.upper, self.velocity, self.acceleration]
        )
        for j, (low, high, v, a) in enumerate(rows.tolist(), start=1):
            if not -np.inf < low < high < np.inf:
                what = f"joint {j}: no trajectory fits between {low:g} and {high:g}"
                raise InputError(what, "give finite limits, the lower below the upper")
            if not (0.0 < v < np.inf and 0.0 < a < np.inf):
                what = (
                    f"joint {j}: velocity limit {v:g} or acceleration limit {a:g} is"
                    " not above 0"
                )
                raise InputError(what, "correct it")

    @property
    def middle(self) -> Array:
        """(n,) of the range [rad, m]."""
        return 0.5 * (self.lower + self.upper)

    @property
    def half(self) -> Array:
        """(n,) half of the range [rad, m]."""
        return 0.5 * (self.upper - self.lower)

    @classmethod
    def of_robot(cls, robot: Robot) -> Limits:
        """The robot's own limits, with plain assumptions where it states none.

        Parameters
        ----------
        robot : Robot
            With its joints.

        Returns
        -------
        Limits
            Of its n joints.
        """
        lower, upper, velocity = joint_limits(robot)
        # Acceleration limit of a joint whose robot states none: reached from rest
        # within so many seconds of its velocity limit.
        return cls(lower, upper, velocity, velocity / 0.25)

    @classmethod
    def of_trajectory(cls, trajectory: FourierTrajectory) -> Limits:
        """The limits that a trajectory uses up.

        Parameters
        ----------
        trajectory : FourierTrajectory
            Any.

        Returns
        -------
        Limits
            Its extremes of position, velocity and acceleration.
        """
        q, dq, ddq = trajectory.states(_instants(trajectory))
        return cls(
            q.min(axis=0),
            q.max(axis=0),
            np.abs(dq).max(axis=0),
            np.abs(ddq).max(axis=0),
        )

    def excess(self, trajectory: FourierTrajectory) -> float:
        """Largest ratio of a motion to its limits, about the middle of the range.

        Parameters
        ----------
        trajectory : FourierTrajectory
            Looked at 1000 times a second.

        Returns
        -------
        float
            At most 1 where all limits are kept.
        """
        q, dq, ddq = trajectory.states(_instants(trajectory))
        ratios = (
            (q - self.middle) / self.half,
            dq / self.velocity,
            ddq / self.acceleration,
        )
        return float(np.abs(ratios).max())


@dataclass(frozen=True, repr=False)
class Excitation(Shown):
    """An optimised trajectory; condition : of its base regressor, history : after each
    iteration."""

    trajectory: FourierTrajectory
    condition: float
    history: tuple[float, ...]

    def _summary(self) -> Summary:
        n = self.trajectory.a.shape[0]
        rows = [("length", f"{self.trajectory.duration:g} s"), ("joints", str(n))]
        return (
            f"Excitation: condition number {self.condition:.4g} of the base regressor",
            rows,
        )

    def save(self, path: str | Path) -> None:
        """Write t, q, dq, ddq at 1 kHz.

        Parameters
        ----------
        path : str or Path
            A .csv file.

        Returns
        -------
        None
            The file is written whole, or not at all.
        """
        save_trajectory(self.trajectory, path)


def excite(
    problem: str | Path | Problem,
    *,
    limits: Limits | None = None,
    start: FourierTrajectory | None = None,
    effects: str | None = None,
    objective: str = "condition",
    harmonics: int = 5,
    frequency: float = 0.15 * np.pi,
    duration: float = 21.0,
    blend: float = 0.5,
    iterations: int = 60,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Excitation:
    """Plan a trajectory that excites the base parameters of a problem.

    Within the limits it shows all of them as evenly as possible.

    Parameters
    ----------
    problem : str, Path or Problem
        A built-in name, a folder with a problem.toml, a URDF file, or a Problem.
    limits : Limits, optional
        Of positions, velocities and accelerations; default: the robot's.
    start : FourierTrajectory, optional
        Where the search begins; its frequency, duration and blend hold. Default: a
        random trajectory.
    effects : str, optional
        The effects whose columns count; default: the problem's.
    objective : {"condition", "d-optimal"}
        What is minimised: the columns' condition number, or the volume of the
        parameters' ellipsoid.
    harmonics : int
        Of a random start.
    frequency : float
        Of the first harmonic of a random start [rad/s].
    duration : float
        Of a random start [s].
    blend : float
        Time from rest to the trajectory and back [s], of a random start.
    iterations : int
        At most so many steps of the search.
    seed : int
        Of the random start.
    progress : callable
        Hears the condition number so far, a short text each time.

    Returns
    -------
    Excitation
        The trajectory, and how well it shows the parameters.

    Raises
    ------
    InputError
        For limits that admit no trajectory, or an objective that does not exist.
    """
    problem = as_problem(problem, "excite(problem=...)")
    require_known("objective", objective, OBJECTIVES)
    bounds = Limits.of_robot(problem.robot) if limits is None else limits
    if start is None:
        start = random_trajectory(
            problem.robot,
            seed,
            duration,
            harmonics,
            frequency,
            blend,
        )
    regressor = Regressor.of(problem, effects)
    return optimised(regressor, bounds, start, objective, iterations, progress=progress)


def optimised(
    regressor: Regressor,
    limits: Limits,
    start: FourierTrajectory,
    objective: str,
    iterations: int,
    moving: Sequence[int] | None = None,
    progress: Progress = no_progress,
) -> Excitation:
    """The best motion for a regressor that is found from a start, and within limits.

    moving : the joints (from 0) whose motion is free, default all; the others move as
    in the start.
    """
    start = shrunk(start, limits)
    search = _Search(regressor, limits, start, objective, moving)
    x = np.column_stack(
        [
            start.a,
            start.b,
            start.q_0,
        ]
    )
    history = [regressor.condition(start)]
    radius = 0.2
    value, slope = search.evaluated(x)
    # A trust region smaller than this share of the limits ends the search.
    while len(history) <= iterations and radius > 1e-4:
        candidate = search.best_of_linear_model(x, slope, radius)
        predicted = float(np.sum(slope * (candidate - x)))
        new = search.at(candidate)[1]
        if not new < value + 0.05 * predicted < value:
            radius *= 0.4
            continue
        radius *= 2.0 if new < value + 0.5 * predicted else 1.0
        x = candidate
        value, slope = search.evaluated(x)
        history.append(regressor.condition(_with(start, x)))
        progress(
            f"excitation: iteration {len(history) - 1}, condition number"
            f" {history[-1]:.2f}"
        )
    best = shrunk(_with(start, x), limits)
    return Excitation(best, regressor.condition(best), tuple(history))


def _with(like: FourierTrajectory, x: Array) -> FourierTrajectory:
    """The motion of x (n, 2 L + 1) = (a, b, q_0), of the same frequency, blend and
    duration."""
    a, b = np.split(
        x[:, :-1],
        2,
        axis=1,
    )
    return replace(
        like,
        a=a.copy(),
        b=b.copy(),
        q_0=x[:, -1].copy(),
    )


class _Search:
    """What the steps of a search have in common, over x (n, 2 L + 1).

    t (K,) : where the regressor is sampled; maps (3, K, 2 L + 1) : of a joint's x to
    its states there; rows (n, M, 2 L + 1), offset (n, M) : rows x + offset are states
    over their limits, the position about the middle; unit (n, 2 L + 1) : sizes of x.
    """

    def __init__(
        self,
        regressor: Regressor,
        limits: Limits,
        start: FourierTrajectory,
        objective: str,
        moving: Sequence[int] | None,
    ) -> None:
        self.regressor = regressor
        self.objective = objective
        self.joints = range(start.a.shape[0]) if moving is None else moving
        # Instants at which the regressor is sampled, and twice as many at which limits
        # are kept.
        self.t = np.linspace(0.0, start.duration, 160)
        instants = _instants(start, 2 * len(self.t) - 1)
        units = np.column_stack(
            [
                limits.half,
                limits.velocity,
                limits.acceleration,
            ]
        )
        width = 2 * start.a.shape[1] + 1
        constraints = _with(
            start, np.eye(width)
        )  # as if each coefficient moved a joint of its own
        sizes = np.repeat(units, len(instants), axis=1)[:, :, None]
        self.rows = np.concatenate(constraints.states(instants)) / sizes
        self.offset = np.outer(
            -limits.middle / limits.half, np.arange(3 * len(instants)) < len(instants)
        )
        # A joint's amplitudes of velocity are of the size of its limit, its centre of
        # the range.
        self.unit = np.column_stack(
            [
                *[limits.velocity] * (width - 1),
                limits.half,
            ]
        )
        self.maps = np.array(constraints.states(self.t))

    def at(self, x: Array) -> tuple[Array, float, Array]:
        """The objective of coefficients.

        Parameters
        ----------
        x : (n, w) array
            Coefficients of each joint.

        Returns
        -------
        (3, K, n) array
            Positions, velocities and accelerations at K instants.
        float
            The objective.
        (K, n, p) array
            Its gradient with respect to W.
        """
        states = np.stack([linear @ x.T for linear in self.maps])
        regressor = self.regressor.at(self.t, *states)
        value, outer = _objective(
            regressor.reshape(-1, regressor.shape[2]), self.objective
        )
        return states, value, outer.reshape(regressor.shape)

    def evaluated(self, x: Array) -> tuple[float, Array]:
        """The objective of coefficients, and its slope.

        Parameters
        ----------
        x : (n, w) array
            Coefficients of each joint.

        Returns
        -------
        float
            The objective.
        (n, w) array
            Its gradient with respect to x.
        """
        states, value, outer = self.at(x)
        slope = np.zeros_like(x)
        for (which, linear), j in product(enumerate(self.maps), self.joints):
            step = np.zeros_like(states)
            step[which, :, j] = DIFFERENCE
            above = self.regressor.at(self.t, *states + 1.0 * step)
            below = self.regressor.at(self.t, *states + -1.0 * step)
            rate = np.einsum("kjc,kjc->k", outer, above - below) / (2.0 * DIFFERENCE)
            slope[j] += rate @ linear
        return value, slope

    def best_of_linear_model(
        self,
        x: Array,
        slope: Array,
        radius: float,
    ) -> Array:
        """The coefficients with the least linear model of the objective.

        Parameters
        ----------
        x : (n, w) array
            Present coefficients.
        slope : (n, w) array
            Gradient of the objective there.
        radius : float
            Of the trust region, in units of the amplitudes.

        Returns
        -------
        (n, w) array
            Within the trust region and the limits, which do not couple joints.
        """
        out = x.copy()
        for j in self.joints:
            rows = self.rows[j]
            offset = self.offset[j]
            unit = self.unit[j]
            # A share is kept for what happens between the instants; what the start
            # uses, it may.
            room = np.maximum(0.998, np.abs(rows @ x[j] + offset))
            scaled = rows * unit
            now = x[j] / unit
            solution = scipy.optimize.linprog(
                slope[j] * unit,
                A_ub=np.vstack([scaled, -scaled]),
                b_ub=np.concatenate([room - offset, room + offset]),
                bounds=np.column_stack([now - radius, now + radius]),
                method="highs-ds",
            )
            if solution.status == 0:
                out[j] = solution.x * unit
        return out


def _objective(w: Array, objective: str) -> tuple[float, Array]:
    """The objective and its gradient (rows, p) with respect to W."""
    gram = w.T @ w
    inverse = np.linalg.pinv(gram, hermitian=True)
    p = len(gram)
    if objective == "d-optimal":
        return -float(np.linalg.slogdet(gram)[1]) / p, -2.0 / p * (w @ inverse)
    outer = float(np.trace(gram))
    inner = float(np.trace(inverse))
    return (
        0.5 * float(np.log(outer * inner)),
        w / outer - w @ (inverse @ inverse) / inner,
    )


def shrunk(trajectory: FourierTrajectory, limits: Limits) -> FourierTrajectory:
    """The trajectory, or its largest part about the middle of the range that keeps the
    limits.

    Parameters
    ----------
    trajectory : FourierTrajectory
        Any.
    limits : Limits
        To be kept.

    Returns
    -------
    FourierTrajectory
        Within them.
    """
    excess = limits.excess(trajectory)
    if excess <= 1.0:
        return trajectory
    share = (1.0 - 1e-9) / excess
    q_0 = limits.middle + share * (trajectory.q_0 - limits.middle)
    return replace(
        trajectory,
        a=trajectory.a * share,
        b=trajectory.b * share,
        q_0=q_0,
    )


def save_trajectory(
    trajectory: FourierTrajectory | PointTrajectory, path: str | Path
) -> None:
    """Write t, q1..qn, dq1..dqn, ddq1..ddqn at 1 kHz: what a robot's controller plays.

    Parameters
    ----------
    trajectory : FourierTrajectory
        To be played.
    path : str or Path
        A .csv file.

    Returns
    -------
    None
        The file is written whole, or not at all.
    """
    t = np.arange(int(np.floor(trajectory.duration * 1e3 + 1e-9)) + 1) / 1e3
    n = trajectory.states(t[:1])[0].shape[1]
    header = [
        "t",
        *(f"{name}{j + 1}" for name in ("q", "dq", "ddq") for j in range(n)),
    ]
    rows = np.column_stack([t, *trajectory.states(t)])
    row_format = ",".join(["%.9g"] * len(header))
    lines = [",".join(header)]
    lines += [row_format % tuple(row) for row in rows.tolist()]
    write_text(path, "\n".join(lines) + "\n")


def _instants(trajectory: FourierTrajectory, count: int = 0) -> Array:
    """So many evenly, or 1 kHz, and those where the acceleration jumps or peaks in the
    blends."""
    blend = trajectory.blend
    end = trajectory.duration - trajectory.blend
    instants = np.linspace(
        0.0,
        trajectory.duration,
        count or round(1000.0 * trajectory.duration) + 1,
    )
    return np.union1d(instants, [0.5 * blend, blend, end, end + 0.5 * blend])


def independent_rate(estimate: Estimate) -> float:
    """How many independent rows a second has, below the cut-off of a model's torque.

    Parameters
    ----------
    estimate : Estimate
        With its filters.

    Returns
    -------
    float
        [Hz].
    """
    # Two independent samples a period of the cut-off; 8 Hz where a model states none.
    return 2.0 * (estimate.preprocessing.torque_cutoff or 8.0)


def noise_of_model(estimate: Estimate) -> Array:
    """Standard deviation of the torque that a model has left.

    Parameters
    ----------
    estimate : Estimate
        With its uncertainty.

    Returns
    -------
    (n,) array
        [N m or N].
    """
    return np.maximum(estimate.uncertainty.torque_noise, 1e-12)


@dataclass(frozen=True)
class PayloadRun:
    """trajectory : found; deviation (10,) : standard deviations of mass [kg], first
    moments [kg m] and inertia about the flange [kg m^2] after one such motion; started
    (10,) : those of the random motion that the search began with."""

    trajectory: FourierTrajectory
    deviation: Array
    started: Array


def payload_run(
    estimate: Estimate,
    *,
    joints: Sequence[int] | None = None,
    duration: float = 2.0,
    harmonics: int = 3,
    iterations: int = 60,
    seed: int = 0,
    progress: Progress = no_progress,
) -> PayloadRun:
    """A motion of ``joints`` (from 0; default the last three) that determines a load at
    the flange, the others in the middle of their ranges; noise and cut-off are those of
    the model's data.

    Raises InputError for a joint that does not exist.
    """
    robot = estimate.robot
    moving = (
        list(range(max(robot.n - 3, 0), robot.n)) if joints is None else list(joints)
    )
    if not moving or not all(0 <= j < robot.n for j in moving):
        named = ", ".join(str(j + 1) for j in moving) or "none"
        raise InputError(f"joints that move: {named}", f"name some of 1 to {robot.n}")
    limits = Limits.of_robot(robot)
    # Periods of the motion's own length, blended over an eighth of it.
    start = random_trajectory(
        robot,
        seed,
        duration,
        harmonics,
        2 * np.pi / duration,
        0.125 * duration,
    )
    still = np.setdiff1d(np.arange(robot.n), moving)
    start.a[still], start.b[still], start.q_0[still] = 0.0, 0.0, limits.middle[still]
    scale = 1.0 / noise_of_model(estimate)
    rate = independent_rate(estimate)
    regressor = Regressor(
        Model(robot, (Payload(robot),)),
        np.arange(10),
        scale,
    )
    excitation = optimised(
        regressor,
        limits,
        start,
        "d-optimal",
        iterations,
        moving,
        progress,
    )
    deviation_by_run = (
        deviations(regressor.along(x, rate)) for x in (excitation.trajectory, start)
    )
    return PayloadRun(excitation.trajectory, *deviation_by_run)
