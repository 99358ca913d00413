"""Gains of channels, drives and loops as a model has them, with 95 % intervals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.regression.regression import Regression
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one

#: Half-width of the 95 % interval over the size from which a drive's torque is open.
OPEN_TORQUE = 0.2


@dataclass(frozen=True)
class GainInterval:
    """value ± half_width (95 %) in ``unit``; half_width is None where the value was
    given as exact, and infinite where the data do not determine it."""

    name: str
    value: float
    half_width: float | None
    unit: str

    @property
    def spread(self) -> str:
        """Half-width of the 95 % interval in words.

        "given" for an exact value; "not determined" if the interval contains zero,
        since then no motion of the log shows the gain.
        """
        if self.half_width is None:
            return "given"
        if not self.half_width < abs(self.value):
            return "not determined"
        return f"{self.half_width:.2g}"


def channel_gains(estimate: Estimate) -> list[GainInterval]:
    """Return the gains of the torque channels (reading over true torque).

    Parameters
    ----------
    estimate : Estimate
        Estimate from runs with torque.

    Returns
    -------
    list of GainInterval
        One a joint; empty if no known load determined them.
    """
    gains = estimate.report.gains
    if gains is None:
        return []
    pairs = zip(gains.gain, gains.std, strict=True)
    return [
        GainInterval(f"joint {j}", gain, NORMAL_95 * std, "")
        for j, (gain, std) in enumerate(pairs, start=1)
    ]


def loop_gains(estimate: Estimate) -> list[GainInterval]:
    """Return the gains of servo loops that were fitted to a logged torque.

    Parameters
    ----------
    estimate : Estimate
        Estimate from runs with torque and commands.

    Returns
    -------
    list of GainInterval
        In the order of the model's drives; empty without servo effects.
    """
    loop = estimate.report.loop
    return [
        GainInterval(name, gain.value, NORMAL_95 * gain.std, gain.unit)
        for name, gain in (loop.gains.items() if loop else ())
    ]


def drive_gains(estimate: Estimate) -> Iterator[GainInterval]:
    """Yield the gain of each servo loop with its 95 % interval.

    In these estimates the servo's control law (torque = gain times control error)
    replaces a torque sensor. Then all parameters are known up to one common scale,
    which the user fixes by one given gain (a member of ``model.known``) with a
    relative standard deviation ``scale_error`` (0: the user calls it exact).

    Interval's half-width: 1.96 std for an estimated gain, infinite if its drive is
    limited; 1.96 scale_error |value| for the given gain; None for the given gain if it
    is exact.

    Parameters
    ----------
    estimate : Estimate
        Estimate from runs without torque.

    Returns
    -------
    iterator of GainInterval
        One entry a servo gain, in the order of the model's parameters.
    """
    model = estimate.model
    servo = estimate.report.servo
    scale_error = servo.scale_error if servo else 0.0
    limited = limited_drives(estimate)
    parameters = zip(
        model.parameters,
        estimate.theta,
        estimate.uncertainty.std,
        model.drives,
        strict=True,
    )
    for parameter, value, std, is_servo_gain in parameters:
        if not is_servo_gain:
            continue
        half_width: float | None
        if parameter.name in model.known:
            half_width = NORMAL_95 * scale_error * float(value) if scale_error else None
        elif parameter.joint in limited:
            half_width = np.inf
        else:
            half_width = NORMAL_95 * float(std)
        yield GainInterval(parameter.name, float(value), half_width, parameter.unit)


def drive_torque_errors(
    model: Model, theta: Array, covariance: Array, regression: Regression
) -> list[float | None]:
    """Return how uncertain the servo gains of a model without logged torque leave the
    drives' torque, joint by joint.

    A servo's torque is a small difference of large terms (kp times the control error
    less kd times the velocity), so that gains within some per cent may leave it open.

    Parameters
    ----------
    theta, covariance : (p,), (p, p) arrays
        The model's parameters, and what the runs say of their errors.
    regression : Regression
        The training runs.

    Returns
    -------
    list of float or None
        The standard deviation of a joint's drive torque over that torque, root mean
        squares along the training motion; None if the gains have no covariance.
    """
    is_drive = model.drives
    # A gain that is given as exact has no deviation.
    is_given = np.array([p.name in model.known for p in model.parameters])
    errors: list[float | None] = []
    for factor in regression.per_joint:
        triangle = factor.triangle[:, :-1]
        of_drive = is_drive[factor.indices]
        open_gains = of_drive & ~is_given[factor.indices]
        gains = factor.indices[open_gains]
        columns = triangle[:, open_gains]
        variance = np.trace(columns @ covariance[np.ix_(gains, gains)] @ columns.T)
        loads = factor.indices[~of_drive]
        torque = triangle[:, ~of_drive] @ theta[loads]  # what the drive moves
        size = float(nonzero_or_one(np.linalg.norm(torque)))
        std = float(np.sqrt(max(variance, 0.0)))
        errors.append(std / size if np.isfinite(std) else None)
    return errors


def limited_drives(estimate: Estimate) -> tuple[int, ...]:
    """Return the joints (from 1) whose drive made less torque than its law demands.

    Empty for an estimate from runs with torque.
    """
    servo = estimate.report.servo
    return servo.limited if servo else ()


def open_torques(estimate: Estimate) -> dict[int, float]:
    """Return the joints (from 1) whose drive torque the gains leave open.

    Values are the half-widths of the 95 % interval over the torque's size; joints below
    OPEN_TORQUE (20 %) are left out. Empty for an estimate from runs with torque.
    """
    servo = estimate.report.servo
    half_widths = [
        np.inf if std is None else NORMAL_95 * std
        for std in (servo.torque_error if servo else ())
    ]
    return {
        joint: half_width
        for joint, half_width in enumerate(half_widths, start=1)
        if half_width > OPEN_TORQUE
    }
