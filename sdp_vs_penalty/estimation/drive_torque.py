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

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.forward import ServoLoop
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.motion import Command
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.runs import Stretch, interpolated, split_at_gaps

#: Longest step of the simulation [s].
_STEP = 8e-3


def with_simulated_motion(
    measurements: Measurements,
    model: Model,
    theta: Array,
) -> Measurements:
    """The same runs with the positions "qsim" that the model's servo loop makes of
    their commands."""
    loop = ServoLoop(model, theta)
    runs = []
    for run in measurements.runs():
        q = run.q.copy()
        path = np.zeros_like(run.q)
        for part, inside in _parts(run):
            q[inside], path[inside] = _simulated(part, loop)
        runs.append(replace(run, commanded={**run.commanded, "qsim": q, "isim": path}))
    return concatenate(runs)


def _parts(run: Measurements) -> Iterator[tuple[Stretch, NDArray[np.bool_]]]:
    """The stretches of a run, each with the samples (N,) that lie in it."""
    for part in split_at_gaps(run):
        yield part, (run.t >= part.t[0]) & (run.t <= part.t[-1])


def _simulated(part: Stretch, loop: ServoLoop) -> tuple[Array, Array]:
    """(N, n) positions at the samples of a stretch, and their integral."""
    command = sampled_command(part)
    count = max(1, int(np.ceil(part.dt / _STEP - 1e-9)))
    skip = max(1, int(_STEP / part.dt + 1e-9))
    h = part.dt * skip / count
    total = (
        -(-(part.count - 1) // skip) * count + 1
    )  # instants from the start to beyond the end
    # Windows of half a second side by side, each of which runs as long again from a
    # measured position before it counts, until the noise of that is forgotten.
    long = early = max(1, round(0.5 / h))
    first = np.arange(0, total, long)
    start = np.maximum(first - early, 0)
    t = part.t[0] + h * start
    positions = interpolated(t, part.t, part.q)
    path = interpolated(t, part.t, part.integrals[1])
    state = loop.start(command, t, positions, path)
    q, sums = np.empty((2, len(first) * long, part.q.shape[1]))
    for k in range(early + long):
        on = (start + k >= first) & (start + k < first + long)
        q[start[on] + k], sums[start[on] + k] = state.q[on], state.position_integral[on]
        state = loop.step(state, command, h)
    clock = part.t[0] + h * np.arange(len(q))
    return interpolated(part.t, clock, q), interpolated(part.t, clock, sums)


def sampled_command(part: Stretch) -> Command:
    """The command of a stretch as it was logged, on the grid of its clock.

    Parameters
    ----------
    part : Stretch
        Of a log.

    Returns
    -------
    Command
        Positions over time.
    """
    assert part.qcmd is not None
    clock = part.clock(np.arange(part.count))
    q = part.resampled(part.qcmd, 0, part.count)
    dq = np.gradient(q, part.dt, axis=0)
    total = part.resampled(part.integrals[0], 0, part.count)
    return Command(clock, q, dq, np.zeros_like(q), total)


def driven(
    estimate: Estimate, measurements: Measurements
) -> tuple[Estimate, Measurements]:
    """The plant, and the log with the drives' torque; both as they are where torque was
    logged.

    Raises InputError for a log without torque where the model knows no servo.
    """
    if measurements.torque_logged:
        return (
            plant(estimate) if estimate.model.drives.any() else estimate
        ), measurements
    if not estimate.model.drives.any():
        what = (
            "this log holds no torque, and the model no servo that would stand for it"
        )
        remedy = "identify from a log with commands, or name one with torque"
        raise InputError(what, remedy, measurements.names[0])
    return plant(estimate), with_drive_torque(
        estimate.model,
        estimate.theta,
        measurements,
    )


def with_drive_torque(
    model: Model,
    theta: Array,
    measurements: Measurements,
) -> Measurements:
    """The log with the torque that the servos of a model make of it.

    Parameters
    ----------
    model : Model
        With servos.
    theta : (p,) array
        Its parameters.
    measurements : Measurements
        Without torque.

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
            tau[inside] += loop.drive(motion)
        runs.append(replace(run, tau=tau, torque_logged=True))
    return concatenate(runs)


def plant(estimate: Estimate) -> Estimate:
    """The same without its drives.

    Parameters
    ----------
    estimate : Estimate
        With or without drives.

    Returns
    -------
    Estimate
        Links and friction alone.
    """
    keep = ~estimate.model.drives
    known = estimate.uncertainty
    reference = estimate.model.reference
    standard = tuple(known.standard[k] for k in np.flatnonzero(keep))
    spread = known.spread[keep]
    gains = known.gain_response[keep]
    uncertainty = replace(
        known,
        standard=standard,
        base=(),
        spread=spread,
        gain_response=gains,
    )
    reference = None if reference is None else reference[keep]
    effects = estimate.model.without_drives.effects
    model = replace(
        estimate.model,
        effects=effects,
        known={},
        reference=reference,
    )
    return replace(
        estimate,
        model=model,
        theta=estimate.theta[keep],
        uncertainty=uncertainty,
    )
