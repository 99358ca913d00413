"""The torque error that most drives show: friction that turns round over a short
travel, and a lag that the joints share.

Both are in nearly every log, and often make its largest errors. They tell neither the
joint at fault nor the cause, so that joints and causes are compared beyond them. The
lag of a joint is predicted from the other joints alone: a channel that is later than
the others keeps the part by which it is later.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.causes import Refit, States, travel_since_reversal
from sdp_vs_penalty.diagnosis.linear_fit import orthonormal
from sdp_vs_penalty.effects.effect import smooth_sign
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.signals.reversals import since_reversal

#: Travels over which friction turns round in usual gears [rad or m]: it approaches its
#: level as exp(-travel / length).
_TURNING_LENGTHS = (0.003, 0.01, 0.03)
#: Instants from a reversal [s], and the half width [s] of the triangles there: a late
#: velocity channel makes such errors.
_TURNING_INSTANTS = (-0.1, 0.0, 0.1)
_TURNING_WIDTH = 0.1


def turning_columns(states: States, joint: int) -> Array:
    """Return columns (M, 6) of friction that turns round over a short travel, for one
    joint (from 0).

    Returns
    -------
    (M, 6) array
        The direction times exp(-travel / length), with the travel since the last
        reversal, for three lengths. Then triangles around three instants near a
        reversal, times the direction after it.
    """
    q = states.q[:, joint]
    velocity = states.dq[:, joint]
    direction = smooth_sign(velocity)
    travel = travel_since_reversal(q, velocity, states.rows)
    since, direction_after = since_reversal(states.t, velocity, states.rows.segment)
    columns = [np.exp(-travel / length) * direction for length in _TURNING_LENGTHS]
    for instant in _TURNING_INSTANTS:
        distance = np.abs(since - instant)
        triangle = np.maximum(1.0 - distance / _TURNING_WIDTH, 0.0)
        columns.append(triangle * direction_after)
    return np.column_stack(columns)


def lag_columns(states: States, joint: int) -> Array:
    """Return columns (M, 2) of a lag: first and second derivative of the joint's
    torque by time [N m/s, N m/s^2 or N/s, N/s^2].

    A low-pass of time constant T makes tau - T dtau/dt + T^2 d^2tau/dt^2 of the torque
    tau, to second order. Noise of positions (encoder steps, a clock that jitters) is in
    the modelled torque and in its second derivative alike, so that the latter explains
    it as well: by a coefficient that follows from the filters, the same for all joints.
    """
    columns = [states.torque_rate[:, joint], states.torque_curvature[:, joint]]
    return np.column_stack(columns)


@dataclass(frozen=True)
class LagFit:
    """The least-squares problem of the lag of one joint."""

    #: (M, 2) columns of the lag, without what a refit of the model makes of them.
    columns: Array
    #: (2, 2) matrix of the normal equations of the lag's coefficients [s, s^2], without
    #: the joint's turning friction and over the mean square that is left of its error.
    gram: Array
    #: (2,) right side of these normal equations.
    pull: Array
    #: (M, k) orthonormal basis of the turning friction.
    turning: Array
    #: (M,) error of the joint without the turning friction.
    error: Array

    @classmethod
    def of_joint(cls, turning: Array, lag: Array, error: Array) -> LagFit:
        """Set up the fit of a lag (M, 2) to an error (M,) beside friction (M, k)."""
        basis = orthonormal(turning.copy())
        error_left = error - basis @ (basis.T @ error)
        lag_left = lag - basis @ (basis.T @ lag)
        mean_square = float(nonzero_or_one(np.mean(error_left**2)))
        return cls(
            columns=lag,
            gram=lag_left.T @ lag_left / mean_square,
            pull=lag_left.T @ error_left / mean_square,
            turning=basis,
            error=error_left,
        )

    def predicted(self, coefficients: Array) -> Array:
        """Return the error (M,) of a lag with these coefficients (2,) [s, s^2].

        It is scaled by 0 to 1, so that it fits this joint best: a joint need not have
        the lag that others have.
        """
        lag = self.columns @ coefficients
        lag_left = lag - self.turning @ (self.turning.T @ lag)
        energy = float(nonzero_or_one(lag_left @ lag_left))
        scale = np.clip(lag_left @ self.error / energy, 0.0, 1.0)
        return np.asarray(scale * lag)


def shared_lags(fits: list[LagFit]) -> list[Array]:
    """Return the error (M,) of each joint's lag, as the other joints show the lag.

    Returns
    -------
    list of (M,) array
        Zeros for an arm of one joint.
    """
    out = []
    for j, fit in enumerate(fits):
        others = [other for i, other in enumerate(fits) if i != j]
        gram = sum((other.gram for other in others), np.zeros((2, 2)))
        pull = sum((other.pull for other in others), np.zeros(2))
        # Columns of unit norm: s and s^2 differ by orders of magnitude.
        norms = nonzero_or_one(np.sqrt(np.diagonal(gram)))
        unit_gram = gram / np.outer(norms, norms)
        coefficients = np.linalg.pinv(unit_gram, rcond=1e-9) @ (pull / norms) / norms
        out.append(fit.predicted(coefficients))
    return out


@dataclass(frozen=True)
class UsualError:
    """The usual error of one joint, on the rows that count."""

    #: (M, 6) columns of friction that turns round over a short travel, without what a
    #: refit of the model makes of them.
    turning: Array
    #: (M,) error of the lag that the other joints show, over the joint's RMS error.
    lag: Array


def usual_errors(
    states: States, refit: Refit, keep: NDArray[np.bool_]
) -> list[UsualError]:
    """Return the usual error of every joint, one for each in order.

    Parameters
    ----------
    states
        Motion and torque of every row.
    refit
        The model's parameters, fitted to the rows that count.
    keep
        (all rows,) flags the M rows that count.
    """
    turning = []
    fits = []
    for joint in range(len(refit.scale)):
        scale = refit.scale[joint]
        friction = turning_columns(states, joint)[keep] / scale
        lag = lag_columns(states, joint)[keep] / scale
        turning.append(refit.without_model(friction, joint))
        fits.append(
            LagFit.of_joint(
                turning=turning[-1],
                lag=refit.without_model(lag, joint),
                error=refit.remainder[joint],
            )
        )
    return [
        UsualError(turning=friction, lag=lag)
        for friction, lag in zip(turning, shared_lags(fits), strict=True)
    ]
