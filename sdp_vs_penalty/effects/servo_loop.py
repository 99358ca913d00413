"""The drives' part of a model, run forward: from the command and a simulated state to joint torques."""

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Motion
from sdp_vs_penalty.effects.forward import Plant, State, advance
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.motion import Command

#: Change of velocity [rad/s, m/s] by which the damping is taken; the laws are linear in it.
_STEP = 1e-3


class ServoLoop:
    """A model with servo effects and its parameters theta (p,): the plant, and what drives it."""

    def __init__(self, model: Model, theta: Array) -> None:
        own = zip(model.effects, model.indices, strict=True)
        self.drives = [(e, theta[k]) for e, k in own if e.forward == "drive"]
        self.plant = Plant(model, theta)

    def drive(self, motion: Motion) -> Array:
        """(N, n) torque of the drives [N m, N]."""
        return -sum((e.torque(own, motion) for e, own in self.drives), np.zeros_like(motion.q))

    def start(self, command: Command, t: Array, q: Array, path: Array) -> State:
        """States (W) at positions q (W, n) whose integrals are path (W, n), with the velocity of the
        command, at instants t (W,)."""
        dq, rest = command.velocity(t), np.zeros_like(q)
        motion = Motion(t, q, dq, rest, command=command, sum=path)
        z = self.plant.remembered(motion) if self.plant.states else np.zeros((len(t), 0))
        return State(t, q, dq, rest, z, np.full_like(q, np.nan), path)

    def step(self, state: State, command: Command, h: float) -> State:
        """One step of h [s] of all states, the drives' stiffness and damping implicit."""
        half = 0.5 * h
        dq = state.dq + half * state.ddq
        q = state.q + half * state.dq + 0.5 * half * half * state.ddq
        path = state.sum + half * state.q
        middle = Motion(state.t + half, q, dq, state.ddq, command=command, sum=path)
        torque = self.drive(middle)
        path = path + 0.5 * half * half * _STEP
        faster = replace(middle, q=q + half * _STEP, dq=dq + _STEP, sum=path)
        fall = (torque - self.drive(faster)) / _STEP
        return advance(self.plant, state, torque, h, fall[:, :, None] * np.eye(q.shape[1]))
