"""Simulated measurements: a motion, what makes torque, and a sensor; the experiment of a problem.

    motion  ->  torque = sum of sources(motion)  ->  sensor  ->  Measurements

A torque source is any function from a :class:`~sdp_vs_penalty.effects.effect.Motion` to torques
(N, n), so that a hidden effect is one more function in the list. The sensor holds what a logger
does to the truth: sampling, held values, coloured torque noise, quantisation, jittered time stamps.
Rigid-body torque comes from recursive Newton-Euler, not from the regressor that estimators use.

An experiment is described by simulation.toml in the problem's folder; a robot without one (a URDF) gets
its nominal links as truth, mild friction, a random trajectory and white noise, all stated below.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal
from scipy.special import expit

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import read_toml
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.problem.published import published_friction, published_links, published_trajectory
from sdp_vs_penalty.robot.arrays import Array, or_one
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.robot.trajectory import FourierTrajectory, random_trajectory

#: From a motion to joint torques (N, n) [N m or N].
TorqueSource = Callable[[Motion], Array]

#: Of a robot that describes no experiment: friction and noise relative to the torque it moves with.
_FRICTION_SHARE, _NOISE_SHARE = 0.02, 0.001
#: Keeps validation trajectories and their noise apart from the training ones at any seed.
_VALIDATION_SEED = 100_000


def rigid_body_torque(robot: Robot, links: ArrayLike) -> TorqueSource:
    """Newton-Euler torque of links (n, 10), standard parameters."""
    theta = np.asarray(links, float).ravel()
    return lambda motion: robot.inverse_dynamics(theta, motion.q, motion.dq, motion.ddq)


def sigmoid_friction(phi: ArrayLike) -> TorqueSource:
    """phi_1 / (1 + exp(-phi_2 (dq + phi_3))) - phi_1 / (1 + exp(-phi_2 phi_3)), phi (n, 3).

    phi_1 [N m], phi_2 [s/rad], phi_3 [rad/s] (Gaz et al. 2019, eq. 12): zero at rest.
    """
    amplitude, slope, shift = np.asarray(phi, float).T
    rest = amplitude * expit(slope * shift)
    return lambda motion: amplitude * expit(slope * (motion.dq + shift)) - rest


@dataclass(frozen=True)
class Sensor:
    """What a robot's log shows of the truth.

    rate : [Hz] at which the controller renews positions and torques; between, the log repeats them.
    torque_std : (n,) standard deviation of the torque noise [N m]; torque_ar : (n, k) coefficients of
        the autoregressive process e_i = sum_m torque_ar[m] e_(i-m) + white, at ``rate``.
    torque_step, position_step : (n,) quantisation [N m], [rad]; 0 for none.
    log_step, log_jitter : mean and standard deviation [s] of the time between two log entries;
        None: the log reads each of the controller's values exactly once.
    """

    rate: float
    torque_std: Array
    torque_ar: Array
    torque_step: Array
    position_step: Array
    log_step: float | None = None
    log_jitter: float = 0.0

    def __post_init__(self) -> None:
        for row in self.torque_ar:
            roots = np.roots(np.concatenate([[1.0], -row]))
            if np.any(np.abs(roots) >= 1.0):
                raise InputError(
                    "sensor: the coefficients of the torque noise describe no stable process",
                    "make its poles smaller than 1",
                )

    @classmethod
    def ideal(cls, n: int, rate: float = 1000.0) -> Self:
        """No noise, no quantisation, no jitter."""
        return cls.white(np.zeros(n), np.zeros(n), rate)

    @classmethod
    def white(cls, torque_std: ArrayLike, position_step: ArrayLike = 1e-5, rate: float = 1000.0) -> Self:
        """White torque noise (n,) [N m] and an encoder's step (n,) [rad]."""
        std, step = np.broadcast_arrays(np.asarray(torque_std, float), position_step)
        return cls(rate, std, np.zeros((len(std), 0)), np.zeros(len(std)), step)

    def noise(self, count: int, rng: np.random.Generator, burn_in: int = 500) -> Array:
        """(count, n) samples of the torque noise at ``rate``, stationary from the first on: as many as
        ``burn_in`` before them are thrown away."""
        white, out = rng.normal(size=(count + burn_in, len(self.torque_std))), []
        for x, std, row in zip(white.T, self.torque_std, self.torque_ar, strict=True):
            innovation = std * np.sqrt(innovation_share(row))
            out.append(signal.lfilter([innovation], np.concatenate([[1.0], -row]), x)[burn_in:])
        return np.column_stack(out)

    def log_times(self, duration: float, rng: np.random.Generator) -> Array:
        """(N,) instants of the log entries in [0, duration] [s]."""
        if self.log_step is None:
            return np.arange(int(np.floor(duration * self.rate * (1.0 + 1e-12))) + 1) / self.rate
        steps = rng.normal(self.log_step, self.log_jitter, int(1.2 * duration / self.log_step) + 10)
        times = np.cumsum(np.maximum(steps, 0.2 * self.log_step)) - self.log_step
        times = np.concatenate([[0.0], times[times > 0.0]])
        return times[times <= duration]

    def instants(self, duration: float) -> Array:
        """(N,) when the controller renews its values in [0, duration] [s]."""
        return np.arange(int(np.ceil(duration * self.rate)) + 1) / self.rate

    def log(
        self, duration: float, q: Array, torque: Array, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """Times, positions and torques as logged, of true ones (N, n) at :meth:`instants`: the log's
        clock reads whatever value was last."""
        noisy = torque + self.noise(len(q), rng)
        times = self.log_times(duration, rng)
        held = np.clip(np.floor(times * self.rate + 1e-9).astype(np.intp), 0, len(q) - 1)
        return (
            times,
            _quantise(q[held], self.position_step),
            _quantise(noisy[held], self.torque_step),
        )


def innovation_share(coefficients: ArrayLike) -> float:
    """White noise's variance over the process's, of an autoregression with these coefficients: one over
    the sum of its squared answer to an impulse."""
    a = np.concatenate([[1.0], -np.asarray(coefficients, float)])
    impulse = np.zeros(20_000)  # as long as a pole of 0.999 needs
    impulse[0] = 1.0
    return float(1.0 / np.sum(signal.lfilter([1.0], a, impulse) ** 2))


def simulate(
    trajectory: FourierTrajectory,
    sources: Sequence[TorqueSource],
    sensor: Sensor,
    seed: int = 0,
    *,
    name: str = "simulated",
) -> Measurements:
    """Measure the torque that the sources make along a trajectory.

    seed : of the noise and the clock. The measured velocity is left out: estimators do not use it.
    """
    t = sensor.instants(trajectory.duration)
    motion = Motion(t, *trajectory.states(t))
    torque = np.sum([source(motion) for source in sources], axis=0)
    log, q, tau = sensor.log(trajectory.duration, motion.q, torque, np.random.default_rng(seed))
    return Measurements(log, q, tau, names=(name,))


def _quantise(values: Array, step: Array) -> Array:
    unit = or_one(step)
    return np.where(step > 0.0, np.round(values / unit) * unit, values)


@dataclass(frozen=True)
class Experiment:
    """links : (n, 10) true standard parameters; friction : (n, 3) phi of sigmoid friction or None.

    effects : what an estimator models by default; validation : how many trajectories of how many
    seconds the estimates are judged on.
    """

    problem: Problem
    links: Array
    friction: Array | None
    trajectory: FourierTrajectory
    sensor: Sensor
    validation: tuple[int, float]
    effects: tuple[str, ...]

    @property
    def sources(self) -> list[TorqueSource]:
        """What makes the true torque."""
        rigid = rigid_body_torque(self.problem.robot, self.links)
        return [rigid] if self.friction is None else [rigid, sigmoid_friction(self.friction)]

    def training_run(self, seed: int = 0) -> Measurements:
        """The exciting trajectory, measured once."""
        return simulate(self.trajectory, self.sources, self.sensor, seed, name="exciting trajectory")

    def validation_runs(self, seed: int = 0) -> list[Measurements]:
        """Random trajectories inside the joint limits, each measured once."""
        count, duration = self.validation
        first = _VALIDATION_SEED + count * seed
        return [
            simulate(
                random_trajectory(self.problem.robot, first + k, duration),
                self.sources,
                self.sensor,
                first + k,
                name=f"validation trajectory {k + 1}",
            )
            for k in range(count)
        ]


def experiment(problem: Problem) -> Experiment:
    """The simulated experiment of a problem. Raises InputError for an incomplete simulation.toml."""
    if problem.folder is None or not (problem.folder / "simulation.toml").is_file():
        return _assumed(problem)
    return read_toml(problem.folder / "simulation.toml", lambda data: _described(problem, data))


def _described(problem: Problem, data: Mapping[str, Any]) -> Experiment:
    truth, motion, limits = data["truth"], data["trajectory"], data["validation"]
    if "table" in motion:
        trajectory = published_trajectory(problem, motion)
    else:
        trajectory = random_trajectory(
            problem.robot,
            int(motion["seed"]),
            float(motion["duration"]),
            frequency=np.pi * float(motion["frequency_over_pi"]),
            blend=float(motion["blend"]),
        )
    friction, sensor = truth.get("friction"), data["sensor"]
    std = np.array(sensor["torque_std"], float)
    chosen = data.get("identification", {}).get("effects", problem.default_effects)
    return Experiment(
        problem,
        published_links(problem, truth["column"]),
        None if friction is None else published_friction(problem, friction),
        trajectory,
        Sensor(
            float(sensor["rate"]),
            std,
            np.array(sensor.get("torque_ar", np.zeros((len(std), 0))), float),
            np.array(sensor.get("torque_step", np.zeros(len(std))), float),
            np.array(sensor["position_step"], float),
            sensor.get("log_step"),
            float(sensor.get("log_jitter", 0.0)),
        ),
        (int(limits["count"]), float(limits["duration"])),
        tuple(chosen),
    )


def _assumed(problem: Problem) -> Experiment:
    robot = problem.robot
    trajectory = random_trajectory(robot, seed=1, duration=21.0)
    quiet = Sensor.ideal(robot.n, rate=50.0)
    bare = Experiment(
        problem, problem.nominal_links, None, trajectory, quiet, (10, 10.0), problem.default_effects
    )
    size = np.sqrt(np.mean(bare.training_run().tau ** 2, axis=0))
    # A motor whose links weigh nothing rubs all the same, and is measured with noise.
    size = np.where(size > 1e-6 * size.max(), size, 0.01 * size.max())
    phi = np.column_stack([2.0 * _FRICTION_SHARE * size, np.full(robot.n, 10.0), np.zeros(robot.n)])
    return replace(bare, friction=phi, sensor=Sensor.white(_NOISE_SHARE * size))
