"""The residual torque of the arm without a payload: its size and correlation time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.online import constants as c
from sdp_vs_penalty.online.information import SIZE, PayloadPrior
from sdp_vs_penalty.online.smoothing import smooth
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.runs import interpolated

#: s: lengths of parts over which residuals are averaged.
_PART_LENGTHS_S = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
#: Fewest parts of one length for a mean square or a quantile.
_SMALLEST_NUMBER_OF_PARTS = 8
#: Hz: sampling rate of the residuals.
_RATE_HZ = 100.0


@dataclass(frozen=True)
class ResidualNoise:
    """Residual torque of the arm without a payload, behind the filters."""

    #: (n,) root mean square residual of joints in motion [N m or N].
    std: Array
    #: Correlation time of a residual [s]: the mean of T seconds has the variance std^2 /
    #: (1 + T / correlation).
    correlation: float
    #: Factor on std with which 95 % intervals of a mass hold zero 95 times in 100 where
    #: there is no payload.
    inflation: float
    #: (n,) largest acceleration of the motion [rad/s^2 or m/s^2]; beyond it nothing is
    #: known of the noise.
    acceleration: Array

    @classmethod
    def measure(
        cls,
        estimate: Estimate,
        measurements: Measurements,
        delay: float,
        prior: PayloadPrior,
    ) -> Self:
        """Measure the noise of a model's torque residual on a motion without a payload.

        Parameters
        ----------
        estimate : Estimate
            Model of the arm, identified from other runs.
        delay : float
            Delay of the loop's filters [s].

        Returns
        -------
        ResidualNoise
            With the factor that makes intervals of masses wide enough.

        Raises
        ------
        InputError
            If the runs are too short, or a joint moves for less than eight parts of 0.1
            s: its noise and correlation time would rest on nothing.
        """
        stretches = list[_Stretch]()
        for run in measurements.runs():
            stretches += _stretches(estimate, run, delay)
        shortest_part = _PART_LENGTHS_S[0]
        longest = max((len(x.residual) for x in stretches), default=0)
        if longest < 2.0 * shortest_part * _SMALLEST_NUMBER_OF_PARTS * _RATE_HZ:
            raise InputError(
                "the motion without a payload is too short",
                "give a run of ten seconds or more",
            )
        # NaN in the mean of a part: the joint rests or turns round within it.
        means = np.concatenate([x.means(shortest_part) for x in stretches])
        n_moving_parts = np.isfinite(means).sum(axis=0)
        if np.any(n_moving_parts < _SMALLEST_NUMBER_OF_PARTS):
            joints = np.flatnonzero(n_moving_parts < _SMALLEST_NUMBER_OF_PARTS) + 1
            raise InputError(
                f"{formatting.joints(joints.tolist())}: hardly any motion without a"
                " payload",
                "give a run in which each joint moves for several seconds",
            )
        residuals = np.concatenate([x.residual for x in stretches])
        squares = np.nanmean(residuals**2, axis=0)
        noise = cls(
            std=np.sqrt(squares),
            correlation=_correlation(stretches, squares),
            inflation=1.0,
            acceleration=np.max([x.acceleration for x in stretches], axis=0),
        )
        return replace(noise, inflation=noise._inflation(stretches, prior))

    def _inflation(self, stretches: list[_Stretch], prior: PayloadPrior) -> float:
        """Return the factor (at least 1) by which 95 % intervals of masses must be
        widened.

        There is no payload, so each estimated mass is an error. Errors over their
        standard deviation should have a 95 % quantile of 1.96; the factor is that
        quantile over 1.96. It is computed for parts of the motion of several lengths
        [s]; the largest counts.
        """
        largest = 1.0
        for seconds in _PART_LENGTHS_S:
            errors = [
                abs(error)
                for x in stretches
                for error in x.mass_errors(seconds, self, prior)
            ]
            if len(errors) >= _SMALLEST_NUMBER_OF_PARTS:
                ratio = float(np.quantile(errors, 0.95)) / NORMAL_95
                largest = max(largest, ratio)
        return largest


def _correlation(stretches: Sequence[_Stretch], squares: Array) -> float:
    """Return the correlation time tau [s] of the residuals, whose mean squares std^2
    are ``squares`` (n,) [N^2 m^2 or N^2].

    The mean of a residual over T seconds has the variance std^2 / (1 + T / tau). So
    share = variance of the mean / std^2 gives tau = T share / (1 - share). The longest
    tau over all lengths T counts.
    """
    correlation = 1.0 / _RATE_HZ
    for seconds in _PART_LENGTHS_S:
        squared_means = np.concatenate([x.means(seconds) for x in stretches]) ** 2
        is_moving = np.isfinite(squared_means)
        if np.any(is_moving.sum(axis=0) < _SMALLEST_NUMBER_OF_PARTS):
            break
        share = np.mean(np.nanmean(squared_means, axis=0) / squares)
        if 0.0 < share < 1.0:
            correlation = max(correlation, seconds * share / (1.0 - share))
    return float(correlation)


@dataclass(frozen=True)
class _Stretch:
    """Residuals of one run without a payload, with a payload's columns."""

    #: (N, n) residual torque [N m or N]; NaN where a joint rests or turns round.
    residual: Array
    #: (N, n, 10) columns of a payload's standard parameters.
    columns: Array
    #: (n,) largest acceleration [rad/s^2 or m/s^2].
    acceleration: Array

    def _parts(self, seconds: float) -> list[slice]:
        """Return the rows of consecutive parts that last ``seconds`` [s] each, as
        slices.

        The incomplete part at the end is left out.
        """
        count = round(seconds * _RATE_HZ)
        starts = range(0, len(self.residual) - count + 1, count)
        return [slice(start, start + count) for start in starts]

    def means(self, seconds: float) -> Array:
        """Return the mean residuals of parts of one length.

        Parameters
        ----------
        seconds : float
            Length of a part [s].

        Returns
        -------
        (parts, n) array
            Means [N m, N]; NaN where the joint rests or turns round within the part.
        """
        parts = [self.residual[part].mean(axis=0) for part in self._parts(seconds)]
        return np.reshape(parts, (-1, self.residual.shape[1]))

    def mass_errors(
        self, seconds: float, noise: ResidualNoise, prior: PayloadPrior
    ) -> list[float]:
        """Estimate the mass of a payload in each part of a motion without a payload.

        The true mass is zero, so each estimate is an error. With residuals e and
        payload columns Y over the noise's std, the estimate is x = (P + w Y^T Y)^-1 w
        Y^T e with the prior's information P and the weight w of a sample.

        Parameters
        ----------
        seconds : float
            Length of a part [s].
        prior : PayloadPrior
            Prior of a payload's parameters.

        Returns
        -------
        list of float
            Estimated mass over its standard deviation [-], one entry a part.
        """
        # Of one sample: the mean over a part has the variance std^2 / (1 + T / tau).
        weight = (1.0 / seconds + 1.0 / noise.correlation) / _RATE_HZ
        errors = []
        for part in self._parts(seconds):
            residual = self.residual[part]
            is_known = np.isfinite(residual)
            # e and Y over the noise's std; samples at rest (NaN) count as zero rows.
            e = np.where(is_known, residual / noise.std, 0.0).ravel()
            scaled = self.columns[part] * prior.scale
            Y = np.where(is_known[..., None], scaled / noise.std[:, None], 0.0)
            Y = Y.reshape(-1, SIZE)
            information = prior.information + weight * Y.T @ Y
            covariance = np.linalg.inv(information)
            mass = covariance[0] @ (weight * Y.T @ e)  # parameter 0 is the mass
            errors.append(float(mass / np.sqrt(covariance[0, 0])))
        return errors


def _stretches(estimate: Estimate, run: Measurements, delay: float) -> list[_Stretch]:
    """Return residual torques and payload columns of the gap-free pieces of a run.

    residual = measured torque - torque of the arm's model, both smoothed as in the
    control loop, whose filter lags by ``delay`` [s]. Samples are _RATE_HZ apart.
    Residuals are NaN where a joint rests or turns round, since dry friction is unknown
    there. Pieces shorter than twice the filter's window are dropped.
    """
    period = 1.0 / _RATE_HZ
    pieces = list[_Stretch]()
    # Half the filter's window [samples]; a cubic needs at least two to either side.
    half = max(round(delay / period), 2)
    # The filter's window lasts twice its delay: it must not reach across a gap.
    gaps = np.flatnonzero(np.diff(run.t) > 2.0 * delay) + 1
    for rows in np.split(np.arange(len(run.t)), gaps):
        clock = np.arange(run.t[rows[0]], run.t[rows[-1]], period)
        if len(clock) < 4 * half:  # about two windows of 2 half + 1 samples
            continue
        q = interpolated(clock, run.t[rows], run.q[rows])
        tau = interpolated(clock, run.t[rows], run.tau[rows])
        position, velocity, acceleration = smooth(q, half, period)
        torque, _, _ = smooth(tau, half, period)
        # The filter gives no value for half a window at both ends.
        smoothed_clock = clock[half:-half]
        motion = Motion(smoothed_clock, position, velocity, acceleration)
        residual = torque - estimate.torque(motion)
        # At rest, or reversing within the filters' delay: friction has any value there.
        is_turning = np.abs(velocity) < c.REST_SPEED + delay * np.abs(acceleration)
        # A payload is rigidly held by the last link: it has that link's ten columns.
        columns = estimate.robot.regressor(position, velocity, acceleration)[..., -10:]
        channel_gains = estimate.model.gains  # reading over true torque, a joint
        if channel_gains is not None:
            columns = columns * np.array(channel_gains)[:, None]
        largest_acceleration = np.abs(acceleration).max(axis=0)
        pieces.append(
            _Stretch(
                residual=np.where(is_turning, np.nan, residual),
                columns=columns,
                acceleration=largest_acceleration,
            )
        )
    return pieces
