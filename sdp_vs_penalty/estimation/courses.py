"""Measured runs at the log's rate, ready for a model to run along them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.forward import Plant, State
from sdp_vs_penalty.effects.motion import Command
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import RunFilter, no_rows
from sdp_vs_penalty.signals.runs import stretches


@dataclass(frozen=True)
class Course:
    """A stretch of a run: t (N,) s, states (N, n), the friction's states z, the joints'
    temperature (NaN: not needed) and torque; where there is a command, that and the integral of the
    positions."""

    name: str
    t: Array
    q: Array
    dq: Array
    ddq: Array
    z: Array
    temperature: Array
    torque: Array
    moving: NDArray[np.bool_]
    command: Command | None = None
    sum: Array | None = None

    @property
    def dt(self) -> float:
        return float(self.t[1] - self.t[0])

    def state(self, at: NDArray[np.intp]) -> State:
        return State(self.t[at], self.q[at], self.dq[at], self.ddq[at], self.z[at], self.temperature[at])


def courses_of(run: Measurements, estimate: Estimate, plant: Plant, shortest: float) -> list[Course]:
    """The stretches of a run that last ``shortest`` [s] or more behind the state filter.

    Raises InputError where there is none, or an effect needs temperatures that were not logged.
    """
    filters = RunFilter(run, estimate.preprocessing.resolve(run), every_sample=True)
    half, out = filters.state.half, []
    for part in stretches(run):
        first, last = half, part.count - half - 1
        if (last - first) * filters.dt <= shortest:
            continue
        motion = filters.motion(part, first, last)
        torque = plant.true_torque(motion.t, part.resampled(part.tau, first, last + 1))
        z, moving = plant.remembered(motion), filters.movement.at(motion.t)
        states = (motion.q, motion.dq, motion.ddq)
        warm = np.full_like(motion.q, np.nan)
        if any(effect.needs_temperature for effect in estimate.model.effects):
            warm = motion.joint_temperature
        told = motion.command, motion.sum
        out.append(Course(run.names[0], motion.t, *states, z, warm, torque, moving, *told))
    if not out:
        raise no_rows(run, 2.0 * half * filters.dt + shortest)
    return out
