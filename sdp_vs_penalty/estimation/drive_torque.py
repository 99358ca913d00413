"""A log without torque, as one with: the torque that the identified law of its servos
makes of it.

The drives leave the model, which keeps links and friction; the damping kd, which holds
viscous friction too, is the drives'. An error that drives and plant share is not seen.

Instruments are the motion that a model makes of the command alone. In a closed loop the
noise of positions is in both sides of tau = Y theta; columns computed on the simulated
motion share the signal and not the noise: two-stage least squares with them are
consistent, and convex under the same constraints (Janot, Vandanjon, Gautier, IEEE
Trans. Control Systems Technology 2014).
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.forward import ServoLoop
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.motion import Command
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.robot.arrays import Array, Mask
from sdp_vs_penalty.signals.runs import Stretch, interpolated, split_at_gaps

#: Longest step of the simulation [s].
_STEP = 8e-3


def with_simulated_motion(
    measurements: Measurements, model: Model, theta: Array
) -> Measurements:
    """Attach the motion that a model's servo loop makes of each run's command.

    Returns
    -------
    Measurements
        The same runs with simulated positions "qsim" [rad, m] and their integral
        "isim".
    """
    loop = ServoLoop(model, theta)
    runs = []
    for run in measurements.runs():
        q = run.q.copy()
        path = np.zeros_like(run.q)
        for part, inside in _parts(run):
            q[inside], path[inside] = _simulated(part, loop)
        runs.append(replace(run, commanded={**run.commanded, "qsim": q, "isim": path}))
    return concatenate(runs)


def _parts(run: Measurements) -> Iterator[tuple[Stretch, Mask]]:
    """Yield the stretches of a run between gaps of its clock.

    Each comes with a mask (N,): which of the run's samples lie in it.
    """
    for part in split_at_gaps(run):
        yield part, (run.t >= part.t[0]) & (run.t <= part.t[-1])


def _simulated(part: Stretch, loop: ServoLoop) -> tuple[Array, Array]:
    """Simulate the servo loop along a stretch's logged command.

    Returns (N, n) positions [rad, m] at the stretch's samples, and their integral over
    time. The stretch is cut into windows of 0.5 s, simulated side by side. Each window
    starts 0.5 s early at a measured position: the noise of that position has faded when
    the window begins.
    """
    command = sampled_command(part)
    # A step h of at most _STEP [s]: several a sample, or one for several samples.
    steps_per_sample = max(1, int(np.ceil(part.dt / _STEP - 1e-9)))
    samples_per_step = max(1, int(_STEP / part.dt + 1e-9))
    h = part.dt * samples_per_step / steps_per_sample
    n_intervals = math.ceil((part.count - 1) / samples_per_step)
    n_instants = n_intervals * steps_per_sample + 1
    # Steps of a window, and how many steps earlier its simulation starts: 0.5 s.
    length = max(1, round(0.5 / h))
    first = np.arange(0, n_instants, length)
    start = np.maximum(first - length, 0)
    t = part.t[0] + h * start
    positions = interpolated(t, part.t, part.q)
    path = interpolated(t, part.t, part.integrals[1])
    state = loop.start(command, t, positions, path)
    q, integral = np.empty((2, len(first) * length, part.q.shape[1]))
    # All windows take step k together; a window is recorded once it has begun.
    for k in range(2 * length):
        instant = start + k
        is_recorded = (instant >= first) & (instant < first + length)
        q[instant[is_recorded]] = state.q[is_recorded]
        integral[instant[is_recorded]] = state.position_integral[is_recorded]
        state = loop.step(state, command, h)
    clock = part.t[0] + h * np.arange(len(q))
    return interpolated(part.t, clock, q), interpolated(part.t, clock, integral)


def sampled_command(part: Stretch) -> Command:
    """Return the logged command of a stretch on an even grid of time.

    Parameters
    ----------
    part : Stretch
        A stretch of a log with commands.

    Returns
    -------
    Command
        Position, velocity and integral over time; the acceleration is zero.
    """
    assert part.qcmd is not None
    clock = part.clock(np.arange(part.count))
    q = part.resampled(part.qcmd, 0, part.count)
    dq = np.gradient(q, part.dt, axis=0)
    total = part.resampled(part.integrals[0], 0, part.count)
    return Command(clock, q, dq, ddq=np.zeros_like(q), position_integral=total)


def driven(
    estimate: Estimate, measurements: Measurements
) -> tuple[Estimate, Measurements]:
    """Return a model and a log that can be compared by torque.

    A log with torque stays as it is. For a log without torque the model's servos make
    the drives' torque of it. The model is returned without its servos.

    Raises
    ------
    InputError
        For a log without torque if the model has no servos.
    """
    has_servos = bool(estimate.model.drives.any())
    arm = plant(estimate) if has_servos else estimate
    if measurements.torque_logged:
        return arm, measurements
    if not has_servos:
        what = (
            "this log holds no torque, and the model no servo that would stand for it"
        )
        remedy = "identify from a log with commands, or name one with torque"
        raise InputError(what, remedy, measurements.names[0])
    return arm, with_drive_torque(estimate.model, estimate.theta, measurements)


def with_drive_torque(
    model: Model, theta: Array, measurements: Measurements
) -> Measurements:
    """Add the torque that a model's servos make to a log without torque.

    Returns
    -------
    Measurements
        With tau (N, n) [N m or N].
    """
    loop = ServoLoop(model, theta)
    runs = []
    for run in measurements.runs():
        tau = np.array(run.tau)
        for part, inside in _parts(run):
            rate = np.gradient(part.q, part.t, axis=0)
            acceleration = np.gradient(rate, part.t, axis=0)
            command = sampled_command(part)
            motion = Motion(
                part.t,
                part.q,
                rate,
                acceleration,
                command=command,
                position_integral=part.integrals[1],
            )
            tau[inside] += loop.drive_torque(motion)
        runs.append(replace(run, tau=tau, torque_logged=True))
    return concatenate(runs)


def plant(estimate: Estimate) -> Estimate:
    """Return the estimate without its servos: links and friction."""
    return estimate.with_effects(lambda effect: effect.forward != "drive")
