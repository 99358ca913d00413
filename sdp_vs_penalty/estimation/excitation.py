"""Exciting trajectories: Fourier series whose regressor is as well conditioned as the
limits allow.

For W(x), the stacked base regressor of a trajectory with coefficients x = (a, b, q_0) of
:class:`~sdp_vs_penalty.robot.trajectory.FourierTrajectory`,

    minimise log(|W|_F |W^+|_F), a smooth upper bound of log cond W,

subject to limits of position, velocity and acceleration at every instant (Swevers et
al., T-RA 1997; Gautier, Khalil, IJRR 1992): linear inequalities in x, which every step
of the sequential linear programming (in a trust region, x in units of the limits)
keeps. Collisions are not looked at: choose position limits within which the robot is
free. :func:`payload_run` weighs a load: a short motion of the wrist that minimises the
volume of the confidence ellipsoid of its ten parameters, -log det W^T W / p.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import scipy

from sdp_vs_penalty.arguments import checked_arguments, require_in_range
from sdp_vs_penalty.effects import standard_effect
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import Model, depends
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import DIFFERENCE
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.regression.linalg import deviations
from sdp_vs_penalty.results.record import Shown, Summary
from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.robot.robot import Robot, joint_limits
from sdp_vs_penalty.robot.trajectory import (
    FourierTrajectory,
    PointTrajectory,
    random_trajectory,
)
from sdp_vs_penalty.threads import on_one_thread

#: Rate at which motions are looked at [Hz].
RATE = 20.0


@dataclass(frozen=True)
class Regressor:
    """Columns of a model: W (N n, p) of a motion."""

    #: Model of the n joints.
    model: Model
    #: (p,) indices of the model's columns that W consists of.
    columns: Indices
    #: (n,) factor of each joint's rows.
    scale: Array | float = 1.0

    def at(self, t: Array, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the regressor rows of states: instants t (N,) [s], positions q (N, n)
        [rad, m], and their derivatives dq and ddq.

        Returns
        -------
        (N, n, p) array
            Regressor of each instant and joint, rows of a joint times its scale.
        """
        by_joint = self.model.dense_columns(Motion(t, q, dq, ddq))  # (n, N, p)
        by_instant = np.stack(list(by_joint[..., self.columns]), axis=1)
        return by_instant * np.broadcast_to(self.scale, self.model.robot.n)[:, None]

    def along(self, trajectory: FourierTrajectory, rate: float = RATE) -> Array:
        """Return the stacked regressor W of a trajectory, sampled at ``rate`` [Hz].

        Returns
        -------
        (N n, p) array
            W: n rows for each of N instants.
        """
        t = np.arange(0.0, trajectory.duration, 1.0 / rate)
        return self.at(t, *trajectory.states(t)).reshape(-1, len(self.columns))

    def condition(self, trajectory: FourierTrajectory) -> float:
        """Return the condition number of the regressor W along a trajectory.

        Returns
        -------
        float
            Largest over smallest singular value [-].
        """
        return float(np.linalg.cond(self.along(trajectory)))

    @classmethod
    def from_problem(cls, problem: Problem, effects: str | None = None) -> Regressor:
        """Return the regressor of a problem's base parameters.

        Parameters
        ----------
        effects : str, optional
            Names of effects, separated by commas; default: the problem's.

        Returns
        -------
        Regressor
            Its columns are the parameters that lead the base parameters.

        Raises
        ------
        InputError
            For effects whose columns depend on more than the present state.
        """
        model = problem.model(effects)
        for effect in model.effects:
            if effect.has_memory or depends(effect):
                what = (
                    f"effect {effect.name}: its columns depend on more than the state"
                )
                raise InputError(what, "leave it out of the excitation.")
        return cls(model, np.array(base_rows(model, problem.independent).leading))


#: Of a regressor W (rows, p) what is minimised, and its gradient by W (rows, p).
Objective = Callable[[Array], tuple[float, Array]]


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
        """Raise InputError for limits within which nothing can move, with the joint's
        number."""
        rows = np.column_stack(
            [self.lower, self.upper, self.velocity, self.acceleration]
        )
        # Comparisons are written so that NaN fails them, too.
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
        """(n,) middle of the position range [rad, m]."""
        return 0.5 * (self.lower + self.upper)

    @property
    def half(self) -> Array:
        """(n,) half of the position range [rad, m]."""
        return 0.5 * (self.upper - self.lower)

    @classmethod
    def from_robot(cls, robot: Robot) -> Limits:
        """Return the robot's limits, with assumptions where it states none.

        Returns
        -------
        Limits
            Acceleration limits are such that a joint reaches its velocity limit in 0.25
            s.
        """
        lower, upper, velocity = joint_limits(robot)
        # Robot files state no acceleration limits: a joint reaches its velocity limit
        # from rest in 0.25 s.
        seconds_to_velocity = 0.25
        return cls(lower, upper, velocity, velocity / seconds_to_velocity)

    @classmethod
    def from_trajectory(cls, trajectory: FourierTrajectory) -> Limits:
        """Return the limits that a trajectory just keeps.

        Returns
        -------
        Limits
            Extremes of its position, velocity and acceleration.
        """
        q, dq, ddq = trajectory.states(_instants(trajectory))
        return cls(
            q.min(axis=0),
            q.max(axis=0),
            np.abs(dq).max(axis=0),
            np.abs(ddq).max(axis=0),
        )

    def excess(self, trajectory: FourierTrajectory) -> float:
        """Return the largest ratio of position, velocity or acceleration to its limit.

        Parameters
        ----------
        trajectory : FourierTrajectory
            Trajectory of n joints, sampled at 1 kHz.

        Returns
        -------
        float
            At most 1 if all limits hold. Positions count from the middle of their
            range.
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
    """An optimised trajectory."""

    #: The trajectory of n joints.
    trajectory: FourierTrajectory
    #: Condition number of its base regressor [-].
    condition: float
    #: Condition number at the start and after each iteration [-].
    history: tuple[float, ...]

    def _summary(self) -> Summary:
        """Return the title and the (label, text) lines of the printed summary."""
        n = self.trajectory.a.shape[0]
        rows = [("length", f"{self.trajectory.duration:g} s"), ("joints", str(n))]
        return (
            f"Excitation: condition number {self.condition:.4g} of the base regressor",
            rows,
        )

    def save(self, path: str | Path) -> None:
        """Write t, q, dq and ddq at 1 kHz to a CSV file, atomically.

        Returns
        -------
        None
            The file is written completely, or not at all.
        """
        save_trajectory(self.trajectory, path)


@on_one_thread
@checked_arguments
def excite(
    problem: str | Path | Problem,
    *,
    limits: Limits | None = None,
    start: FourierTrajectory | None = None,
    duration: float = 21.0,
    iterations: int = 60,
    seed: int = 0,
    progress: Progress = no_progress,
) -> Excitation:
    """Plan a trajectory that excites the base parameters of a problem.

    Base parameters are the combinations of parameters that the torque depends on. The
    trajectory is a Fourier series for each joint, within the limits.

    Parameters
    ----------
    problem : str, Path or Problem
        A built-in name, a folder with a problem.toml, a URDF file, or a Problem.
    limits : Limits, optional
        Limits of positions, velocities and accelerations; default: the robot's.
    start : FourierTrajectory, optional
        Start of the search; its frequency, duration, harmonics and blend are kept.
        Default: a random trajectory.
    duration : float
        Duration of the random start, from rest to rest [s].
    iterations : int
        Largest number of steps of the search.
    seed : int
        Seed of the random start.
    progress : callable
        Receives a line of text with the condition number at each step.

    Returns
    -------
    Excitation
        The trajectory, and the condition number of its base regressor.

    Raises
    ------
    InputError
        For limits that admit no trajectory.
    """
    problem = as_problem(problem, "excite(problem=...)")
    for name, value, low, high in (
        ("duration", duration, 0.1, 1e4),
        ("iterations", iterations, 0, 10_000),
    ):
        require_in_range(f"excite({name})", value, low, high)
    bounds = Limits.from_robot(problem.robot) if limits is None else limits
    if start is None:
        start = random_trajectory(problem.robot, seed, duration)
    regressor = Regressor.from_problem(problem)
    return optimised(
        regressor, bounds, start, condition_bound, iterations, progress=progress
    )


def optimised(
    regressor: Regressor,
    limits: Limits,
    start: FourierTrajectory,
    objective: Objective,
    iterations: int,
    moving: Sequence[int] | None = None,
    progress: Progress = no_progress,
) -> Excitation:
    """Improve a trajectory for a regressor within limits, by sequential linear
    programming.

    Each step minimises the linearised objective in a trust region. The region shrinks
    if the step gains less than 5 % of the prediction and grows if it gains more than
    half.

    Parameters
    ----------
    limits : Limits
        Limits of position, velocity and acceleration.
    start : FourierTrajectory
        Where the search begins; first shrunk into the limits.
    iterations : int
        Largest number of accepted steps.
    moving : sequence of int, optional
        Joints (from 0) whose motion is free, default all; others move as in the start.
    progress : callable
        Receives a line of text a step.

    Returns
    -------
    Excitation
        Best trajectory, its condition number, and the condition number after each step.
    """
    start = shrunk(start, limits)
    search = _Search(regressor, limits, start, objective, moving)
    x = np.column_stack([start.a, start.b, start.q_0])
    history = [regressor.condition(start)]
    # The trust region's half-width, as a share of the limits: at first, and at which
    # the search ends.
    radius = 0.2
    smallest_radius = 1e-4
    value, slope = search.evaluated(x)
    while len(history) <= iterations and radius > smallest_radius:
        candidate = search.best_of_linear_model(x, slope, radius)
        predicted_change = float(np.sum(slope * (candidate - x)))  # negative
        _, new_value, _ = search.at(candidate)
        # The predicted change must be a fall, and 5 % of it come true.
        is_gain = new_value < value + 0.05 * predicted_change < value
        if not is_gain:
            radius *= 0.4
            continue
        if new_value < value + 0.5 * predicted_change:
            radius *= 2.0
        x = candidate
        value, slope = search.evaluated(x)
        history.append(regressor.condition(_with_coefficients(start, x)))
        progress(
            f"excitation: iteration {len(history) - 1}, condition number"
            f" {history[-1]:.2f}"
        )
    best = shrunk(_with_coefficients(start, x), limits)
    return Excitation(best, regressor.condition(best), tuple(history))


def _with_coefficients(trajectory: FourierTrajectory, x: Array) -> FourierTrajectory:
    """Return a trajectory with other Fourier coefficients, x (n, 2 L + 1) = (a, b, q_0) of
    L harmonics; frequency, blend and duration stay."""
    a, b = np.split(x[:, :-1], 2, axis=1)
    return replace(trajectory, a=a.copy(), b=b.copy(), q_0=x[:, -1].copy())


class _Search:
    """What the steps of a search have in common."""

    def __init__(
        self,
        regressor: Regressor,
        limits: Limits,
        start: FourierTrajectory,
        objective: Objective,
        moving: Sequence[int] | None,
    ) -> None:
        """Precompute the linear maps from Fourier coefficients to states and to limits.

        A joint's coefficients x (w,) are a and b of L harmonics and the centre q_0.

        - ``t`` (K,): instants at which the regressor is sampled [s].
        - ``maps`` (3, K, w): x to position, velocity and acceleration there.
        - ``rows`` (n, M, w) x + ``offset`` (n, M): states over their limits, positions
          about the middle of their range.
        - ``unit`` (n, w): sizes of the coefficients.

        ``moving``: joints (from 0) whose coefficients are free; None: all.
        """
        self.regressor = regressor
        self.objective = objective
        self.joints = range(start.a.shape[0]) if moving is None else moving
        # 160 instants at which the regressor is sampled, and twice as many at which
        # limits are kept.
        self.t = np.linspace(0.0, start.duration, 160)
        instants = _instants(start, 2 * len(self.t) - 1)
        limits_of_states = np.column_stack(
            [limits.half, limits.velocity, limits.acceleration]
        )
        width = 2 * start.a.shape[1] + 1  # a (L), b (L) and q_0 of a joint
        # States are linear in the coefficients: with the unit matrix for coefficients,
        # "joint" k moves as the kth coefficient alone makes a joint move.
        unit_motions = _with_coefficients(start, np.eye(width))
        sizes = np.repeat(limits_of_states, len(instants), axis=1)[:, :, None]
        self.rows = np.concatenate(unit_motions.states(instants)) / sizes
        # Only positions, the first third of the rows, count from the middle.
        is_position = np.arange(3 * len(instants)) < len(instants)
        self.offset = np.outer(-limits.middle / limits.half, is_position)
        # Sizes of a joint's coefficients: amplitudes of velocity, then the centre q_0.
        self.unit = np.column_stack([*[limits.velocity] * (width - 1), limits.half])
        self.maps = np.array(unit_motions.states(self.t))

    def at(self, x: Array) -> tuple[Array, float, Array]:
        """Return states, objective and the objective's gradient by W.

        Parameters
        ----------
        x : (n, w) array
            Fourier coefficients of each joint, w = 2 L + 1.

        Returns
        -------
        (3, K, n) array
            Positions, velocities and accelerations at K instants.
        float
            Value of what is minimised [-].
        (K, n, p) array
            Gradient of the objective by the regressor W.
        """
        states = np.stack([linear @ x.T for linear in self.maps])
        regressor = self.regressor.at(self.t, *states)
        value, outer = self.objective(regressor.reshape(-1, regressor.shape[2]))
        return states, value, outer.reshape(regressor.shape)

    def evaluated(self, x: Array) -> tuple[float, Array]:
        """Return the objective and (n, w) its gradient by the Fourier coefficients x
        (n, w); zero for joints that are not free.

        The regressor's derivative by the states is a central difference.
        """
        states, value, outer = self.at(x)
        slope = np.zeros_like(x)
        # derivative: 0 for position, 1 for velocity, 2 for acceleration.
        for (derivative, linear), j in product(enumerate(self.maps), self.joints):
            step = np.zeros_like(states)
            step[derivative, :, j] = DIFFERENCE
            above = self.regressor.at(self.t, *(states + step))
            below = self.regressor.at(self.t, *(states - step))
            # Sum over joints j and columns c at each instant k.
            change = np.einsum("kjc,kjc->k", outer, above - below)
            rate = change / (2.0 * DIFFERENCE)
            slope[j] += rate @ linear
        return value, slope

    def best_of_linear_model(self, x: Array, slope: Array, radius: float) -> Array:
        """Minimise the linear model of the objective by one linear program a joint, since
        the limits do not couple joints.

        Parameters
        ----------
        x : (n, w) array
            Present Fourier coefficients.
        slope : (n, w) array
            Gradient of the objective at x.
        radius : float
            Half-width of the trust region, as a share of each coefficient's ``unit``.

        Returns
        -------
        (n, w) array
            Coefficients within the trust region and the limits.
        """
        best = x.copy()
        for j in self.joints:
            rows = self.rows[j]
            offset = self.offset[j]
            unit = self.unit[j]
            # Limits are kept to 99.8 % at the instants, for what happens between them;
            # where the present motion uses more, to what it uses.
            bound = np.maximum(0.998, np.abs(rows @ x[j] + offset))
            scaled_rows = rows * unit
            present = x[j] / unit
            solution = scipy.optimize.linprog(
                slope[j] * unit,
                A_ub=np.vstack([scaled_rows, -scaled_rows]),
                b_ub=np.concatenate([bound - offset, bound + offset]),
                bounds=np.column_stack([present - radius, present + radius]),
                method="highs-ds",
            )
            is_solved = solution.status == 0
            if is_solved:
                best[j] = solution.x * unit
        return best


def condition_bound(w: Array) -> tuple[float, Array]:
    """Return log(|W|_F |W^+|_F) of a regressor w (rows, p), and its gradient (rows, p).

    It is half the logarithm of tr(W^T W) tr((W^T W)^-1).
    """
    gram = w.T @ w
    inverse = np.linalg.pinv(gram, hermitian=True)
    trace = float(np.trace(gram))
    trace_of_inverse = float(np.trace(inverse))
    value = 0.5 * float(np.log(trace * trace_of_inverse))
    gradient = w / trace - w @ (inverse @ inverse) / trace_of_inverse
    return value, gradient


def log_volume(w: Array) -> tuple[float, Array]:
    """Return -log det(W^T W) / p of a regressor w (rows, p), which grows with the volume
    of the parameters' confidence ellipsoid, and its gradient (rows, p).
    """
    gram = w.T @ w
    p = len(gram)
    log_det = float(np.linalg.slogdet(gram)[1])
    return -log_det / p, -2.0 / p * (w @ np.linalg.pinv(gram, hermitian=True))


def shrunk(trajectory: FourierTrajectory, limits: Limits) -> FourierTrajectory:
    """Return the trajectory, scaled about the middle of the ranges until it keeps the
    limits.

    Parameters
    ----------
    trajectory : FourierTrajectory
        Any trajectory of n joints.

    Returns
    -------
    FourierTrajectory
        The same trajectory if it keeps the limits.
    """
    excess = limits.excess(trajectory)
    if excess <= 1.0:
        return trajectory
    share = (1.0 - 1e-9) / excess  # rounding stays inside of the limits
    q_0 = limits.middle + share * (trajectory.q_0 - limits.middle)
    return replace(trajectory, a=trajectory.a * share, b=trajectory.b * share, q_0=q_0)


def save_trajectory(
    trajectory: FourierTrajectory | PointTrajectory, path: str | Path
) -> None:
    """Write t, q1..qn, dq1..dqn, ddq1..ddqn at 1 kHz, for a robot's controller.

    Parameters
    ----------
    trajectory : FourierTrajectory or PointTrajectory
        The motion of n joints, written from its begin to its end [s; rad, m].
    path : str or Path
        A .csv file, which is written completely or not at all.
    """
    rate = 1e3  # Hz
    # A duration of whole milliseconds keeps its last one, in spite of rounding.
    n_instants = int(np.floor(trajectory.duration * rate + 1e-9)) + 1
    t = np.arange(n_instants) / rate
    q, dq, ddq = trajectory.states(t)  # (N, n) each
    joints = range(1, q.shape[1] + 1)
    header = ["t", *(f"{name}{j}" for name in ("q", "dq", "ddq") for j in joints)]
    rows = np.column_stack([t, q, dq, ddq])
    row_format = ",".join(["%.9g"] * len(header))
    lines = [",".join(header)]
    lines += [row_format % tuple(row) for row in rows.tolist()]
    write_text(path, "\n".join(lines) + "\n")


def _instants(trajectory: FourierTrajectory, count: int = 0) -> Array:
    """Return the instants [s] at which the limits of a trajectory are checked.

    They are ``count`` evenly spaced ones (0: 1 kHz), and those at which the blends'
    acceleration jumps or peaks: the ends and the middles of the blends.
    """
    blend = trajectory.blend
    end = trajectory.duration - trajectory.blend
    instants = np.linspace(
        0.0, trajectory.duration, count or round(1000.0 * trajectory.duration) + 1
    )
    return np.union1d(instants, [0.5 * blend, blend, end, end + 0.5 * blend])


def independent_rate(estimate: Estimate) -> float:
    """Return how many independent rows a second filtered torque contains [Hz].

    Parameters
    ----------
    estimate : Estimate
        Model with the filters of its identification.

    Returns
    -------
    float
        Twice the torque's cut-off frequency [Hz].
    """
    # Two independent samples a period of the cut-off; 8 Hz where a model states none.
    return 2.0 * (estimate.preprocessing.torque_cutoff or 8.0)


def noise_of_model(estimate: Estimate) -> Array:
    """Return the standard deviation of the torque that a model leaves unexplained.

    Returns
    -------
    (n,) array
        Standard deviation [N m or N], at least 1e-12 so that it can be a divisor.
    """
    return np.maximum(estimate.uncertainty.torque_noise, 1e-12)


@dataclass(frozen=True)
class PayloadRun:
    """A motion that shows the body on the flange well."""

    #: The motion that was found.
    trajectory: FourierTrajectory
    #: (10,) standard deviations of mass [kg], first moments [kg m] and inertia about
    #: the flange [kg m^2] after one such motion.
    deviation: Array
    #: (10,) the same of the random motion that the search began with.
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
    """Plan a short motion that determines the ten parameters of a load at the flange.

    It is d-optimal for the noise and cut-off of the model's data. Joints that do not
    move stay in the middle of their ranges.

    Parameters
    ----------
    joints : sequence of int, optional
        Joints (from 0) that move; default: the last three.
    duration : float
        Length of the motion [s].
    harmonics : int
        Harmonics of each joint's Fourier series.
    iterations : int
        Largest number of steps of the search.
    seed : int
        Seed of the random start.
    progress : callable
        Receives a line of text a step.

    Returns
    -------
    PayloadRun
        Trajectory, and standard deviations of the load's parameters after one such run.

    Raises
    ------
    InputError
        For a joint that does not exist.
    """
    robot = estimate.robot
    last_three = range(max(robot.n - 3, 0), robot.n)
    moving = list(last_three if joints is None else joints)
    if not moving or not all(0 <= j < robot.n for j in moving):
        numbers = ", ".join(str(j + 1) for j in moving) or "none"
        raise InputError(f"joints that move: {numbers}", f"name some of 1 to {robot.n}")
    limits = Limits.from_robot(robot)
    # One period of the first harmonic, blended from and to rest over an eighth of it.
    start = random_trajectory(
        robot,
        seed,
        duration,
        harmonics,
        frequency=2 * np.pi / duration,
        blend=0.125 * duration,
    )
    still = np.setdiff1d(np.arange(robot.n), moving)
    start.a[still] = 0.0
    start.b[still] = 0.0
    start.q_0[still] = limits.middle[still]
    regressor = Regressor(
        Model(robot, (standard_effect("payload")(robot),)),
        columns=np.arange(10),
        scale=1.0 / noise_of_model(estimate),
    )
    excitation = optimised(
        regressor,
        limits,
        start,
        objective=log_volume,
        iterations=iterations,
        moving=moving,
        progress=progress,
    )
    rate = independent_rate(estimate)
    return PayloadRun(
        excitation.trajectory,
        deviation=deviations(regressor.along(excitation.trajectory, rate)),
        started=deviations(regressor.along(start, rate)),
    )
