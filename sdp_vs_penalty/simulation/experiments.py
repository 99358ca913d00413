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
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import read_toml
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.problem.published import (
    published_friction,
    published_links,
    published_trajectory,
)
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.trajectory import FourierTrajectory, random_trajectory


def sigmoid_friction(phi: ArrayLike, dq: Array) -> Array:
    """phi_1 / (1 + exp(-phi_2 (dq + phi_3))) - phi_1 / (1 + exp(-phi_2 phi_3)): zero
    at rest (Gaz et al. 2019, eq. 12).

    Parameters
    ----------
    phi : (n, 3)
        phi_1 [N m], phi_2 [s/rad], phi_3 [rad/s].
    dq : (N, n)
        Velocities [rad/s].

    Returns
    -------
    (N, n)
        [N m].
    """
    amplitude, slope, shift = np.asarray(phi, float).T
    return amplitude * scipy.special.expit(
        slope * (dq + shift)
    ) - amplitude * scipy.special.expit(slope * shift)


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
    position_step: ArrayLike = 0.0
    torque_step: ArrayLike = 0.0
    torque_ar: ArrayLike | None = None
    log_step: float | None = None
    log_jitter: float = 0.0

    def __post_init__(self) -> None:
        for row in self.poles:
            if np.any(np.abs(np.roots(row)) >= 1.0):
                what = (
                    "sensor: the coefficients of the torque noise describe no stable"
                    " process"
                )
                raise InputError(what, "make its poles smaller than 1")

    @property
    def poles(self) -> Array:
        """(n, 1 + k) the filter that whitens each joint's torque noise."""
        ones = np.ones((len(self.torque_std), 1))
        return (
            ones
            if self.torque_ar is None
            else np.hstack([ones, -np.asarray(self.torque_ar, float)])
        )

    def noise(
        self,
        count: int,
        rng: np.random.Generator,
    ) -> Array:
        """Samples of the torque noise at ``rate``.

        Parameters
        ----------
        count : int
            How many.
        rng : numpy.random.Generator
            Of everything random.

        Returns
        -------
        (count, n)
            Stationary from the first on: 500 before them are thrown away.
        """
        white = rng.normal(size=(count + 500, len(self.torque_std)))
        out = []
        for x, std, row in zip(
            white.T,
            self.torque_std,
            self.poles,
            strict=True,
        ):
            innovation = std * np.sqrt(innovation_share(row))
            out.append(scipy.signal.lfilter([innovation], row, x)[500:])
        return np.column_stack(out)

    def instants(self, duration: float) -> Array:
        """When the controller renews its values.

        Parameters
        ----------
        duration : float
            [s].

        Returns
        -------
        (N,)
            [s], in [0, duration].
        """
        return np.arange(int(np.ceil(duration * self.rate)) + 1) / self.rate

    def log(
        self,
        duration: float,
        q: Array,
        torque: Array,
        rng: np.random.Generator,
    ) -> tuple[Array, Array, Array]:
        """What is logged: the log's clock reads whatever value was last.

        Parameters
        ----------
        duration : float
            [s].
        q : (N, n)
            True positions at :meth:`instants`.
        torque : (N, n)
            True torques there.
        rng : numpy.random.Generator
            Of everything random.

        Returns
        -------
        tuple
            Times (K,), positions and torques (K, n).
        """
        noisy = torque + self.noise(len(q), rng)
        times = (
            np.arange(int(np.floor(duration * self.rate * (1.0 + 1e-12))) + 1)
            / self.rate
        )
        if self.log_step is not None:
            steps = rng.normal(
                self.log_step,
                self.log_jitter,
                int(1.2 * duration / self.log_step) + 10,
            )
            times = np.cumsum(np.maximum(steps, 0.2 * self.log_step)) - self.log_step
            times = np.concatenate([[0.0], times[times > 0.0]])
            times = times[times <= duration]
        held = np.clip(
            np.floor(times * self.rate + 1e-9).astype(np.intp),
            0,
            len(q) - 1,
        )
        return (
            times,
            _counted(q[held], self.position_step),
            _counted(noisy[held], self.torque_step),
        )


def innovation_share(poles: Array) -> float:
    """White noise's variance over the process's, of an autoregression 1 / poles.

    Parameters
    ----------
    poles : (k,)
        Coefficients of the denominator.

    Returns
    -------
    float
        One over the sum of its squared answer to an impulse, as long as a pole
        of 0.999 needs.
    """
    return float(
        1.0
        / np.sum(
            scipy.signal.lfilter([1.0], poles, scipy.signal.unit_impulse(20_000)) ** 2
        )
    )


def _counted(values: Array, step: ArrayLike) -> Array:
    unit = nonzero_or_one(np.asarray(step, float))
    return np.where(
        np.asarray(step) > 0.0,
        np.round(values / unit) * unit,
        values,
    )


def simulate(
    trajectory: FourierTrajectory,
    torque: Callable[[Motion], Array],
    sensor: Sensor,
    seed: int | Sequence[int] = 0,
    *,
    name: str = "simulated",
) -> Measurements:
    """Measure a torque along a trajectory.

    Parameters
    ----------
    trajectory : FourierTrajectory
        Of the joints.
    torque : callable
        (N, n) of a motion [N m, N].
    sensor : Sensor
        What it is measured with.
    seed : int or sequence of int
        Of the noise and the clock.
    name : str
        Of the run.

    Returns
    -------
    Measurements
        Without the measured velocity: estimators do not use it.
    """
    t = sensor.instants(trajectory.duration)
    motion = Motion(t, *trajectory.states(t))
    rng = np.random.default_rng(seed)
    return Measurements(
        *sensor.log(
            trajectory.duration,
            motion.q,
            torque(motion),
            rng,
        ),
        names=(name,),
    )


@dataclass(frozen=True)
class Experiment:
    """links : (n, 10) true standard parameters; friction : (n, 3) phi of sigmoid
    friction or None.

    effects : what an estimator models by default; validation : how many trajectories of
    how many seconds the estimates are judged on.
    """

    problem: Problem
    links: Array
    friction: Array | None
    trajectory: FourierTrajectory
    sensor: Sensor
    validation: tuple[int, float]
    effects: tuple[str, ...]

    def torque(self, motion: Motion) -> Array:
        """The true torque: Newton-Euler's of the links, and friction.

        Parameters
        ----------
        motion : Motion
            Of the joints.

        Returns
        -------
        (N, n)
            [N m, N].
        """
        links = self.links.ravel()
        rigid = self.problem.robot.inverse_dynamics(
            links,
            motion.q,
            motion.dq,
            motion.ddq,
        )
        return (
            rigid
            if self.friction is None
            else rigid + sigmoid_friction(self.friction, motion.dq)
        )

    def training_run(self, seed: int = 0) -> Measurements:
        """The exciting trajectory, measured once.

        Parameters
        ----------
        seed : int
            Of the noise.

        Returns
        -------
        Measurements
            One run.
        """
        return simulate(
            self.trajectory,
            self.torque,
            self.sensor,
            seed,
            name="exciting trajectory",
        )

    def validation_runs(self, seed: int = 0) -> list[Measurements]:
        """Random trajectories inside the joint limits, each measured once.

        Parameters
        ----------
        seed : int
            Of trajectories and noise.

        Returns
        -------
        list of Measurements
            A run each.
        """
        count, duration = self.validation
        # Apart from the training ones, noise included, at any seed.
        first = 100_000 + count * seed
        runs = []
        for k in range(count):
            path = random_trajectory(self.problem.robot, first + k, duration)
            name = f"validation trajectory {k + 1}"
            runs.append(
                simulate(
                    path,
                    self.torque,
                    self.sensor,
                    first + k,
                    name=name,
                )
            )
        return runs


def experiment(problem: Problem) -> Experiment:
    """The simulated experiment of a problem.

    Parameters
    ----------
    problem : Problem
        With or without a simulation.toml.

    Returns
    -------
    Experiment
        Links, friction, trajectory and sensor.

    Raises
    ------
    InputError
        For an incomplete simulation.toml.
    """
    if problem.folder is None or not (problem.folder / "simulation.toml").is_file():
        return _assumed(problem)
    return read_toml(
        problem.folder / "simulation.toml", lambda data: _described(problem, data)
    )


def _described(problem: Problem, data: Mapping[str, Any]) -> Experiment:
    truth = data["truth"]
    motion = data["trajectory"]
    limits = data["validation"]
    if "table" in motion:
        trajectory = published_trajectory(problem, motion)
    else:
        length = float(motion["duration"])
        over_pi = float(motion["frequency_over_pi"])
        blend = float(motion["blend"])
        seed = int(motion["seed"])
        trajectory = random_trajectory(
            problem.robot,
            seed,
            length,
            frequency=np.pi * over_pi,
            blend=blend,
        )
    friction = truth.get("friction")
    sensor = dict[str, Any]()
    for name, value in data["sensor"].items():
        sensor[name] = (
            np.array(value, float) if isinstance(value, list) else float(value)
        )
    needed = [sensor.pop(name) for name in ("rate", "torque_std", "position_step")]
    return Experiment(
        problem,
        published_links(problem, truth["column"]),
        None if friction is None else published_friction(problem, friction),
        trajectory,
        Sensor(*needed, **sensor),
        (int(limits["count"]), float(limits["duration"])),
        tuple(data.get("identification", {}).get("effects", problem.default_effects)),
    )


def _assumed(problem: Problem) -> Experiment:
    """Friction of 2 % and noise of 0.1 % of the torque that it moves with."""
    robot = problem.robot
    none = np.zeros(problem.robot.n)
    trajectory = random_trajectory(robot, seed=1, duration=21.0)
    bare = Experiment(
        problem,
        problem.nominal_links,
        None,
        trajectory,
        Sensor(50.0, none),
        (10, 10.0),
        problem.default_effects,
    )
    size = np.sqrt(np.mean(bare.training_run().tau ** 2, axis=0))
    # A motor whose links weigh nothing rubs all the same, and is measured with noise.
    size = np.where(
        size > 1e-6 * size.max(),
        size,
        0.01 * size.max(),
    )
    phi = np.column_stack(
        [
            2.0 * 0.02 * size,
            none + 10.0,
            none,
        ]
    )
    return replace(
        bare,
        friction=phi,
        sensor=Sensor(1000.0, 0.001 * size, 1e-5),
    )
