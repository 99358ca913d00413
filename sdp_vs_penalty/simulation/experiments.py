"""A problem's simulated experiment: truth, exciting trajectory, sensor, validation trajectories.

Described by simulation.toml in the problem's folder; a robot without one (a URDF) gets its nominal
links as truth, mild friction, a random trajectory and white noise, all stated below.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.files import read_toml
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.problem.published import published_friction, published_links, published_trajectory
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.trajectory import FourierTrajectory, random_trajectory
from sdp_vs_penalty.simulation.simulate import (
    Sensor,
    TorqueSource,
    rigid_body_torque,
    sigmoid_friction,
    simulate,
)

#: Of a robot that describes no experiment: friction and noise relative to the torque it moves with.
_FRICTION_SHARE, _NOISE_SHARE = 0.02, 0.001
#: Keeps validation trajectories and their noise apart from the training ones at any seed.
_VALIDATION_SEED = 100_000


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
