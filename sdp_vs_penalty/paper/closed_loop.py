"""Identification by direct and inverse dynamics (DIDIM: Gautier, Janot, Vandanjon, IEEE T-CST
2013): no measured position enters.

    u        = K (c - q) - D dq                          loop and command c, known
    M(q) ddq = u - b(q, dq) - friction(dq)               the model under that loop: q_sim(theta)
    theta'   = argmin |Y(q_sim(theta)) theta' - tau|^2   again and again, from the nominal robot

The arm moves as designed: the command is the one under which the loop makes that motion.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.robot.arrays import Array

#: Natural frequency of the loop, critically damped [rad/s]; step of the simulation [s].
FREQUENCY, STEP = 30.0, 2e-3
#: Velocity over which dry friction turns round in the simulation [rad/s].
WIDTH = 0.01
#: Rounds at most; relative change of theta's torque that ends them; shares of a step that
#: are tried, the largest first.
ROUNDS, SETTLED, SHARES = 10, 1e-4, (1.0, 0.5, 0.25, 0.125)
#: A simulation farther off its command has left it [rad, m].
LEFT = 1.0


@dataclass(frozen=True)
class Loop:
    """A servo loop with its command, every STEP seconds."""

    #: (N,) instants [s].
    t: Array
    #: (N, n) command [rad, m].
    command: Array
    #: (n,) gain of the position error [N m/rad, N/m].
    gain: Array
    #: (n,) damping [N m s/rad, N s/m].
    damping: Array
    #: (2, n) position and velocity at the beginning.
    start: Array

    @classmethod
    def along(cls, motion: Motion, torque: Array, inertia: Array) -> Self:
        """Return the loop that makes a motion (N samples, STEP apart) with its torque
        (N, n): c = q + (tau + D dq) / K.

        Parameters
        ----------
        inertia : (n,) array
            Diagonal of the mass matrix for which the gains are set [kg m^2, kg].
        """
        gain = FREQUENCY**2 * inertia
        damping = 2.0 * FREQUENCY * inertia
        command = motion.q + (torque + damping * motion.dq) / gain
        start = np.array([motion.q[0], motion.dq[0]])
        return cls(motion.t, command, gain, damping, start)

    def follow(self, model: Model, theta: Array) -> Array:
        """Return the positions (N, n) of a model under the loop, NaN from where it leaves
        the command.

        By leapfrog; damping and friction act at a step's mean velocity, dry friction by
        its secant f / |dq|, so that no step is too long for a light link.
        """
        mass_and_bias = model.robot.mass_and_bias(theta[model.rigid_indices])
        viscous, dry, offset = (
            _of_joints(model, theta, name)
            for name in ("viscous_friction", "coulomb_friction", "torque_offset")
        )
        q, dq = self.start
        dq_ahead = dq  # the velocity half a step ahead
        out = np.full_like(self.command, np.nan)
        for k, command in enumerate(self.command):
            if not np.abs(q - command).max() < LEFT:  # nor is it NaN
                break
            out[k] = q
            h = STEP if k else 0.5 * STEP
            (mass,), (bias,) = mass_and_bias(q[None], dq[None])
            speed = np.maximum(np.abs(dq), 0.01 * WIDTH)
            slope = self.damping + viscous + dry * np.tanh(speed / WIDTH) / speed
            force = self.gain * (command - q) - bias - offset - slope * dq_ahead
            ddq = np.linalg.solve(mass + 0.5 * h * np.diag(slope), force)
            dq_ahead = dq_ahead + h * ddq
            q = q + STEP * dq_ahead
            dq = dq_ahead + 0.5 * STEP * ddq
        return out


def _of_joints(model: Model, theta: Array, effect: str) -> Array:
    """Return the parameter of an effect for each joint (n,); 0 where it has none."""
    values = np.zeros(model.robot.n)
    for parameter, value in zip(model.parameters, theta, strict=True):
        if parameter.effect == effect:
            values[parameter.joint - 1] = value
    return values


def simulated_rows(
    run: Measurements, loop: Loop, start: Task, task_of: Callable[[Measurements], Task]
) -> Task:
    """Return the task whose positions are simulated with the theta that they give, or as
    near to it as the model can be simulated.

    Parameters
    ----------
    run : Measurements
        Torque, and instants of the rows.
    start : Task
        Any task of the model; the nominal robot begins.
    task_of : callable
        Makes the task of a run behind the filters.
    """

    def rows(theta: Array) -> Task | None:
        q = loop.follow(start.model, theta)
        if not np.isfinite(q).all():
            return None
        columns = [np.interp(run.t, loop.t, joint) for joint in q.T]
        return task_of(replace(run, q=np.column_stack(columns)))

    theta = start.nominal
    task = rows(theta) or start
    for _ in range(ROUNDS):
        tried = [theta + share * (task.ols - theta) for share in SHARES]
        simulated = ((x, moved) for x in tried if (moved := rows(x)) is not None)
        found = next(simulated, None)
        if found is None:
            break
        theta, task = found
        change = np.linalg.norm(task.data.R @ (task.ols - theta))
        if change <= SETTLED * np.sqrt(task.data.tau_squared):
            break
    return task
