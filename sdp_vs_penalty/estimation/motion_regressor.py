"""The columns of a model along a motion that is being designed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import Model, depends
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.trajectory import FourierTrajectory


@dataclass(frozen=True)
class Regressor:
    """Columns of a model: W (N n, p) of a motion; scale (n,) : of each joint's rows."""

    model: Model
    columns: NDArray[np.intp]
    scale: Array | float = 1.0

    def at(self, t: Array, q: Array, dq: Array, ddq: Array) -> Array:
        """(N, n, p) rows of each sample and joint."""
        n = self.model.robot.n
        wide = np.zeros((len(t), n, len(self.model.parameters)))
        for j, block in enumerate(self.model.columns(Motion(t, q, dq, ddq))):
            wide[:, j, block.indices] = block.columns
        return wide[:, :, self.columns] * np.broadcast_to(self.scale, n)[:, None]

    def along(self, trajectory: FourierTrajectory, rate: float) -> Array:
        """W of a trajectory, sampled at ``rate`` [Hz]."""
        t = np.arange(0.0, trajectory.duration, 1.0 / rate)
        return self.at(t, *trajectory.states(t)).reshape(-1, len(self.columns))

    def condition(self, trajectory: FourierTrajectory, rate: float = 20.0) -> float:
        """Ratio of the extreme singular values of W."""
        return float(np.linalg.cond(self.along(trajectory, rate)))


@dataclass(frozen=True)
class BaseRegressor(Regressor):
    """The columns that a model's base parameters meet."""

    @classmethod
    def of(cls, problem: Problem, effects: str | None = None) -> BaseRegressor:
        """In the problem's own base parameters. Raises InputError for effects with a memory."""
        model = problem.model(effects)
        for effect in model.effects:
            if effect.has_memory or depends(effect):
                raise InputError(
                    f"effect {effect.name}: its columns depend on more than the state",
                    "leave it out of the excitation.",
                )
        others = np.setdiff1d(np.arange(len(model.parameters)), model.rigid_indices)
        kept = np.arange(0)
        if len(model.rigid_indices):
            kept = model.rigid_indices[list(base_parameters(model, problem.independent)[1])]
        return cls(model, np.concatenate([kept, others]))
