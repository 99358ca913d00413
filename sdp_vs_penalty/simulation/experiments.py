"""Simulated measurements: a motion, what makes torque, and a sensor; the experiment of
a problem.

    motion  ->  torque(motion)  ->  sensor  ->  Measurements

The torque is any function from a :class:`~sdp_vs_penalty.effects.effect.Motion` to
torques (N, n). The sensor holds what a logger does to the truth: sampling, held values,
coloured torque noise, quantisation, jittered time stamps. Rigid-body torque comes from
recursive Newton-Euler, not from the regressor that estimators use.

An experiment is described by simulation.toml in the problem's folder; a robot without
one (a URDF) gets its nominal links as truth, mild friction, a random trajectory and
white noise, all stated below.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import read_toml
from sdp_vs_penalty.parallel import ALONE, Workers
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.problem.published import (
    published_friction,
    published_links,
    published_trajectory,
)
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.trajectory import FourierTrajectory, random_trajectory
from sdp_vs_penalty.signals.kernels import autoregressive


def sigmoid_torque(phi: ArrayLike, dq: Array) -> Array:
    """Return sigmoid friction (N, n) [N m] at velocities (N, n) [rad/s], which is zero
    at rest (Gaz et al. 2019, eq. 12).

    phi_1 / (1 + exp(-phi_2 (dq + phi_3))) - phi_1 / (1 + exp(-phi_2 phi_3)).

    Parameters
    ----------
    phi : (n, 3)
        phi_1 [N m], phi_2 [s/rad], phi_3 [rad/s] of each joint.
    """
    amplitude, slope, shift = np.asarray(phi, float).T
    expit = scipy.special.expit  # 1 / (1 + exp(-x))
    return amplitude * expit(slope * (dq + shift)) - amplitude * expit(slope * shift)


@dataclass(frozen=True)
class Sensor:
    """What a robot's log shows of the truth."""

    #: Rate at which the controller renews positions and torques [Hz]; between, the log
    #: repeats them.
    rate: float
    #: (n,) standard deviation of the torque noise [N m].
    torque_std: Array
    #: (n,) quantisation of the positions [rad]; 0 for none.
    position_step: ArrayLike = 0.0
    #: (n,) quantisation of the torques [N m]; 0 for none.
    torque_step: ArrayLike = 0.0
    #: (n, k) coefficients of the noise e_i = sum_m torque_ar[m] e_(i-m) + white, at
    #: ``rate``; None: white noise.
    torque_ar: ArrayLike | None = None
    #: Mean time between two log entries [s]; None: the log reads each of the
    #: controller's values exactly once.
    log_step: float | None = None
    #: Standard deviation of the time between two log entries [s].
    log_jitter: float = 0.0

    def __post_init__(self) -> None:
        """Raise InputError if the torque noise is no stable process."""
        for row in self.poles:
            if np.any(np.abs(np.roots(row)) >= 1.0):
                what = (
                    "sensor: the coefficients of the torque noise describe no stable"
                    " process"
                )
                raise InputError(what, "make its poles smaller than 1")

    @property
    def poles(self) -> Array:
        """(n, 1 + k) coefficients of the denominator 1 - sum_m a_m z^-m of each joint's
        torque noise, an autoregressive process; (n, 1) ones for white noise."""
        ones = np.ones((len(self.torque_std), 1))
        if self.torque_ar is None:
            return ones
        return np.hstack([ones, -np.asarray(self.torque_ar, float)])

    @cached_property
    def noise_gains(self) -> Array:
        """(n,) standard deviation of the white noise whose filtered samples have the
        standard deviation ``torque_std`` [N m]."""
        shares = [innovation_share(poles) for poles in self.poles]
        return self.torque_std * np.sqrt(shares)

    def noise(self, count: int, rng: np.random.Generator) -> Array:
        """Draw samples of the torque noise at the controller's rate.

        White noise passes the filter gain / poles (an autoregressive process), with the
        gain of :attr:`noise_gains`.

        Returns
        -------
        (count, n)
            Torque noise [N m]. It is stationary, because 500 samples before it are
            dropped.
        """
        settling = 500
        white = rng.normal(size=(settling + count, len(self.torque_std)))
        joints = zip(white.T, self.noise_gains, self.poles, strict=True)
        columns = []
        for white_noise, gain, poles in joints:
            coloured = autoregressive(poles, gain * white_noise)
            columns.append(coloured[settling:])
        return np.column_stack(columns)

    def instants(self, duration: float) -> Array:
        """Return the instants (N,) [s] at which the controller renews its values, from
        0 until the duration [s] or one sample more."""
        return np.arange(int(np.ceil(duration * self.rate)) + 1) / self.rate

    def log(
        self, duration: float, q: Array, torque: Array, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """Return what the log shows: the controller's last value at each of its
        entries.

        Torque noise is added, then values are rounded to the sensor's steps.

        Parameters
        ----------
        duration : float
            Length of the run [s].
        q : (N, n)
            True positions at :meth:`instants` [rad, m].
        torque : (N, n)
            True torques at the same instants [N m, N].

        Returns
        -------
        tuple
            Time stamps (K,) [s], positions (K, n) and torques (K, n).
        """
        noisy = torque + self.noise(len(q), rng)
        if self.log_step is None:
            # Every sample of the controller is logged; rounding must not lose the last.
            n_steps = int(np.floor(duration * self.rate * (1.0 + 1e-12)))
            times = np.arange(n_steps + 1) / self.rate
        else:
            # Steps vary, so that some more are drawn than fill the duration on average.
            n_entries = int(1.2 * duration / self.log_step) + 10
            steps = rng.normal(self.log_step, self.log_jitter, n_entries)
            # A clock does not stand still: no step is shorter than a fifth of the mean.
            steps = np.maximum(steps, 0.2 * self.log_step)
            times = np.cumsum(steps) - self.log_step
            times = np.concatenate([[0.0], times[times > 0.0]])
            times = times[times <= duration]
        # The controller's sample that is current at each entry; 1e-9 against rounding.
        last_renewed = np.floor(times * self.rate + 1e-9).astype(np.intp)
        rows = np.clip(last_renewed, 0, len(q) - 1)
        return (
            times,
            _rounded_to(q[rows], self.position_step),
            _rounded_to(noisy[rows], self.torque_step),
        )


def innovation_share(poles: Array) -> float:
    """Return the variance of an autoregressive process's white input over the variance
    of the process itself: 1 / sum h_k^2 with the impulse response h of 1 / poles.

    Parameters
    ----------
    poles : (1 + k,)
        Coefficients of the denominator, 1 first.

    Returns
    -------
    float
        From 20 000 terms, enough for a pole of 0.999.
    """
    impulse = np.zeros(20_000)
    impulse[0] = 1.0
    response = autoregressive(poles, impulse)
    return float(1.0 / np.sum(response**2))


def _rounded_to(values: Array, step: ArrayLike) -> Array:
    """Round values to multiples of a step, as an encoder does; a step of 0 leaves
    them.
    """
    unit = nonzero_or_one(np.asarray(step, float))
    return np.where(np.asarray(step) > 0.0, np.round(values / unit) * unit, values)


def simulate(
    trajectory: FourierTrajectory,
    torque: Callable[[Motion], Array],
    sensor: Sensor,
    seed: int | Sequence[int] = 0,
    *,
    name: str = "simulated",
) -> Measurements:
    """Simulate a measurement of the torque along a trajectory.

    Parameters
    ----------
    torque : callable
        Maps a motion to torques (N, n) [N m, N].
    sensor : Sensor
        What a log shows of the truth.
    seed : int or sequence of int
        Seed of noise and time stamps.

    Returns
    -------
    Measurements
        Without measured velocity, which estimators do not use.
    """
    t = sensor.instants(trajectory.duration)
    motion = Motion(t, *trajectory.states(t))
    rng = np.random.default_rng(seed)
    return Measurements(
        *sensor.log(trajectory.duration, motion.q, torque(motion), rng), names=(name,)
    )


@dataclass(frozen=True)
class Experiment:
    """A simulated experiment of a problem."""

    #: The problem.
    problem: Problem
    #: (n, 10) true standard parameters about the link frames.
    links: Array
    #: (n, 3) phi of sigmoid friction; None without friction.
    friction: Array | None
    #: Exciting trajectory.
    trajectory: FourierTrajectory
    #: What a log shows of the truth.
    sensor: Sensor
    #: Number and duration [s] of the trajectories that estimates are judged on.
    validation: tuple[int, float]
    #: Effects that an estimator models by default.
    effects: tuple[str, ...]

    def torque(self, motion: Motion) -> Array:
        """Return the true torque (N, n) [N m, N]: rigid-body torque by Newton-Euler,
        plus friction.

        Parameters
        ----------
        motion : Motion
            N samples of the joints' motion.
        """
        links = self.links.ravel()
        rigid = self.problem.robot.inverse_dynamics(
            links, motion.q, motion.dq, motion.ddq
        )
        if self.friction is None:
            return rigid
        return rigid + sigmoid_torque(self.friction, motion.dq)

    def training_run(self, seed: int = 0) -> Measurements:
        """Simulate one measurement of the exciting trajectory.

        Returns
        -------
        Measurements
            Positions (N, n) and noisy torques (N, n) at the sensor's time stamps.
        """
        return simulate(
            self.trajectory, self.torque, self.sensor, seed, name="exciting trajectory"
        )

    def validation_runs(
        self, seed: int = 0, workers: Workers = ALONE
    ) -> list[Measurements]:
        """Simulate measurements of random trajectories inside the joint limits.

        Parameters
        ----------
        seed : int
            Seed of trajectories and noise, which never equal those of training.
        workers : Workers
            Processes that simulate one run each.

        Returns
        -------
        list of Measurements
            One run for each trajectory.
        """
        count, _ = self.validation
        simulate_run = partial(self._validation_run, seed=seed)
        return workers.map(simulate_run, range(count))

    def _validation_run(self, number: int, seed: int) -> Measurements:
        """Simulate the measurement of random trajectory ``number``, from 0."""
        count, duration = self.validation
        # Far from the seeds of training runs: neither motion nor noise is the same.
        run_seed = 100_000 + count * seed + number
        return simulate(
            random_trajectory(self.problem.robot, run_seed, duration),
            self.torque,
            self.sensor,
            run_seed,
            name=f"validation trajectory {number + 1}",
        )


def experiment(problem: Problem) -> Experiment:
    """Return the simulated experiment of a problem.

    Parameters
    ----------
    problem : Problem
        If its folder has no simulation.toml, the experiment is assumed from its nominal
        links.

    Returns
    -------
    Experiment
        True links and friction, trajectory and sensor.

    Raises
    ------
    InputError
        The problem's simulation.toml is missing or incomplete.
    """
    if problem.folder is None or not (problem.folder / "simulation.toml").is_file():
        return _assumed(problem)
    return read_toml(
        problem.folder / "simulation.toml", lambda data: _described(problem, data)
    )


def _described(problem: Problem, data: Mapping[str, Any]) -> Experiment:
    """Make the experiment that a problem's simulation.toml describes: true links and
    friction, exciting trajectory, sensor, and number and length of the validation runs.
    """
    truth = data["truth"]
    motion = data["trajectory"]
    limits = data["validation"]
    # The trajectory of a published table, or a random one from a seed.
    if "table" in motion:
        trajectory = published_trajectory(problem, motion)
    else:
        length = float(motion["duration"])
        over_pi = float(motion["frequency_over_pi"])
        blend = float(motion["blend"])
        seed = int(motion["seed"])
        trajectory = random_trajectory(
            problem.robot, seed, length, frequency=np.pi * over_pi, blend=blend
        )
    friction = truth.get("friction")
    sensor = dict[str, Any]()
    for name, value in data["sensor"].items():
        sensor[name] = (
            np.array(value, float) if isinstance(value, list) else float(value)
        )
    # The sensor's first three fields in their order; the others are passed by name.
    needed = [sensor.pop(name) for name in ("rate", "torque_std", "position_step")]
    effects = data.get("identification", {}).get("effects", problem.default_effects)
    return Experiment(
        problem,
        links=published_links(problem, truth["column"]),
        friction=None if friction is None else published_friction(problem, friction),
        trajectory=trajectory,
        sensor=Sensor(*needed, **sensor),
        validation=(int(limits["count"]), float(limits["duration"])),
        effects=tuple(effects),
    )


def _assumed(problem: Problem) -> Experiment:
    """Assume an experiment for a robot without simulation.toml.

    The links are the nominal ones, and the trajectory is a random one of 21 s. Friction
    saturates at 2 % and the noise has 0.1 % of each joint's RMS torque.
    """
    robot = problem.robot
    zeros = np.zeros(problem.robot.n)
    trajectory = random_trajectory(robot, seed=1, duration=21.0)
    without_friction = Experiment(
        problem,
        links=problem.nominal_links,
        friction=None,
        trajectory=trajectory,
        sensor=Sensor(rate=50.0, torque_std=zeros),
        validation=(10, 10.0),
        effects=problem.default_effects,
    )
    torque = np.sqrt(np.mean(without_friction.training_run().tau ** 2, axis=0))
    # A motor whose links weigh nothing has friction and noise all the same.
    torque = np.where(torque > 1e-6 * torque.max(), torque, 0.01 * torque.max())
    # The sigmoid saturates at half its amplitude phi_1 on either side. Its steepness phi_2
    # is 10 s/rad, and its shift phi_3 zero.
    phi = np.column_stack([2.0 * 0.02 * torque, zeros + 10.0, zeros])
    return replace(
        without_friction,
        friction=phi,
        sensor=Sensor(rate=1000.0, torque_std=0.001 * torque, position_step=1e-5),
    )
