"""A log without torque, as one with: the torque that the identified law of its servos makes of it.

What judges models (comparison, diagnosis, report) then works as on any log. The drives leave the model,
which keeps links and friction; the damping kd, which holds viscous friction too, is the drives'. Errors
are in the units of torque that the scale gives; an error that drives and plant share is not seen.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.servo_loop import ServoLoop
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.simulated_motion import sampled_command
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.runs import stretches


def driven(estimate: Estimate, measurements: Measurements) -> tuple[Estimate, Measurements]:
    """The plant, and the log with the drives' torque; both as they are where torque was logged.

    Raises InputError for a log without torque where the model knows no servo.
    """
    if measurements.torque_logged:
        return (plant(estimate) if estimate.model.drives.any() else estimate), measurements
    if not estimate.model.drives.any():
        raise InputError(
            "this log holds no torque, and the model no servo that would stand for it",
            "identify from a log with commands, or name one with torque",
            measurements.names[0],
        )
    return plant(estimate), with_drive_torque(estimate.model, estimate.theta, measurements)


def with_drive_torque(model: Model, theta: Array, measurements: Measurements) -> Measurements:
    """The log with the torque (N, n) that the servos of a model and its parameters theta (p,) make of
    it [N m, N]."""
    loop, runs = ServoLoop(model, theta), []
    for run in measurements.runs():
        tau = np.array(run.tau)
        for part in stretches(run):
            inside = (run.t >= part.t[0]) & (run.t <= part.t[-1])
            rate = np.gradient(part.q, part.t, axis=0)
            told = sampled_command(part)
            faster = np.gradient(rate, part.t, axis=0)
            motion = Motion(part.t, part.q, rate, faster, command=told, sum=part.integrals[1])
            tau[inside] += loop.drive(motion)
        runs.append(replace(run, tau=tau, torque_logged=True))
    return runs[0] if len(runs) == 1 else concatenate(runs)


def plant(estimate: Estimate) -> Estimate:
    """The same without its drives."""
    keep = ~estimate.model.drives
    effects = tuple(e for e in estimate.model.effects if e.forward != "drive")
    known = estimate.uncertainty
    reference = estimate.model.reference
    own = replace(
        known,
        standard=tuple(i for i, kept in zip(known.standard, keep, strict=True) if kept),
        base=(),
        spread=known.spread[keep],
        gains=known.gains[keep],
    )
    model = replace(
        estimate.model,
        effects=effects,
        known={},
        reference=None if reference is None else reference[keep],
    )
    return replace(estimate, model=model, theta=estimate.theta[keep], uncertainty=own)
