"""How far the torque of the bare arm is off, and for how long it stays so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

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

#: s: lengths of stretches over which residuals are averaged.
_STRETCHES = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
#: Stretches of one length that say something together.
_ENOUGH = 8
#: Hz: instants a second that are looked at.
_RATE = 100.0


@dataclass(frozen=True)
class ResidualNoise:
    """Residual torque of the arm without a payload, behind the filters.

    std : (n,) root mean square [N m or N], of joints in motion. correlation : s for
    which a residual agrees with itself: the mean of T seconds has the variance
    std^2 / (1 + T / correlation). inflation : factor on std by which 95 % intervals of masses
    hold zero 95 times in 100 where there is none. acceleration : (n,) largest of
    the motion [rad/s^2 or m/s^2]; beyond it nothing is known of the noise.
    """

    std: Array
    correlation: float
    inflation: float
    acceleration: Array

    @classmethod
    def of(
        cls,
        estimate: Estimate,
        measurements: Measurements,
        delay: float,
        prior: PayloadPrior,
    ) -> Self:
        """Measure the noise on a motion without a payload.

        Parameters
        ----------
        estimate : Estimate
            Of the arm, not made from these runs.
        measurements : Measurements
            Runs without a payload.
        delay : float
            Of the loop's filters [s].
        prior : PayloadPrior
            Of a payload, before it is measured.

        Returns
        -------
        ResidualNoise
            With the factor that makes intervals of masses wide enough.

        Raises
        ------
        InputError
            Where the runs are too short, or a joint never moves.
        """
        stretches = [
            stretch
            for run in measurements.runs()
            for stretch in _stretches(estimate, run, delay)
        ]
        longest = max((len(x.residual) for x in stretches), default=0)
        if longest < 2.0 * _STRETCHES[0] * _ENOUGH * _RATE:
            raise InputError(
                "the motion without a payload is too short",
                "give a run of ten seconds or more",
            )
        moving = np.concatenate([x.residual for x in stretches])
        n_moving = np.isfinite(moving).sum(axis=0)
        if not np.all(n_moving > _ENOUGH):
            raise InputError(
                "a joint never moves in the motion without a payload",
                "give a run that moves all joints",
            )
        squares = np.nanmean(moving**2, axis=0)
        noise = cls(
            std=np.sqrt(squares),
            correlation=_correlation(stretches, squares),
            inflation=1.0,
            acceleration=np.max([x.acceleration for x in stretches], axis=0),
        )
        return replace(noise, inflation=noise._inflation(stretches, prior))

    def _inflation(self, stretches: list[_Stretch], prior: PayloadPrior) -> float:
        """How many times too narrow the intervals of masses are that are estimated in
        stretches where there is none, at least one."""
        largest = 1.0
        for seconds in _STRETCHES:
            errors = [
                abs(error)
                for x in stretches
                for error in x.mass_errors(seconds, self, prior)
            ]
            if len(errors) >= _ENOUGH:
                ratio = float(np.quantile(errors, 0.95)) / NORMAL_95
                largest = max(largest, ratio)
        return largest


def _correlation(stretches: Sequence[_Stretch], squares: Array) -> float:
    """Seconds for which residuals agree with themselves, from how the mean squares (n,)
    of their means fall with the length."""
    correlation = 1.0 / _RATE
    for seconds in _STRETCHES:
        squared_means = np.concatenate([x.means(seconds) for x in stretches]) ** 2
        is_moving = np.isfinite(squared_means)
        if np.any(is_moving.sum(axis=0) < _ENOUGH):
            break
        share = np.mean(np.nanmean(squared_means, axis=0) / squares)
        if 0.0 < share < 1.0:
            correlation = max(correlation, seconds * share / (1.0 - share))
    return float(correlation)


@dataclass(frozen=True)
class _Stretch:
    """Residuals (N, n), NaN where a joint rests or turns round, the payload's columns
    (N, n, 10), and the largest acceleration (n,)."""

    residual: Array
    columns: Array
    acceleration: Array

    def _parts(self, seconds: float) -> list[slice]:
        count = round(seconds * _RATE)
        starts = range(0, len(self.residual) - count + 1, count)
        return [slice(start, start + count) for start in starts]

    def means(self, seconds: float) -> Array:
        """Mean residuals of parts of one length.

        Parameters
        ----------
        seconds : float
            Length of a part [s].

        Returns
        -------
        (parts, n) array
            [N m, N], NaN where a joint rests.
        """
        parts = [self.residual[part].mean(axis=0) for part in self._parts(seconds)]
        return np.reshape(parts, (-1, self.residual.shape[1]))

    def mass_errors(
        self,
        seconds: float,
        noise: ResidualNoise,
        prior: PayloadPrior,
    ) -> list[float]:
        """Masses that are estimated in parts of one length, where there is none.

        Parameters
        ----------
        seconds : float
            Length of a part [s].
        noise : ResidualNoise
            Of the residuals.
        prior : PayloadPrior
            Of a payload.

        Returns
        -------
        list of float
            Each over its standard deviation [-].
        """
        weight = (1.0 / seconds + 1.0 / noise.correlation) / _RATE
        errors = []
        for part in self._parts(seconds):
            residual = self.residual[part]
            is_known = np.isfinite(residual)
            white = np.where(is_known, residual / noise.std, 0.0).ravel()
            scaled = self.columns[part] * prior.scale
            rows = np.where(
                is_known[..., None],
                scaled / noise.std[:, None],
                0.0,
            )
            rows = rows.reshape(-1, SIZE)
            information = prior.information + weight * rows.T @ rows
            covariance = np.linalg.inv(information)
            mass = covariance[0] @ (weight * rows.T @ white)
            errors.append(float(mass / np.sqrt(covariance[0, 0])))
        return errors


def _stretches(
    estimate: Estimate,
    run: Measurements,
    delay: float,
) -> list[_Stretch]:
    """What a run shows behind the loop's filters, split where its clock has gaps."""
    period = 1.0 / _RATE
    parts = list[_Stretch]()
    half = max(round(delay / period), 2)
    gaps = np.flatnonzero(np.diff(run.t) > 2.0 * delay) + 1
    for rows in np.split(np.arange(len(run.t)), gaps):
        clock = np.arange(
            run.t[rows[0]],
            run.t[rows[-1]],
            period,
        )
        if len(clock) < 4 * half:
            continue
        q = interpolated(
            clock,
            run.t[rows],
            run.q[rows],
        )
        tau = interpolated(
            clock,
            run.t[rows],
            run.tau[rows],
        )
        position, velocity, acceleration = smooth(q, half, period)
        torque = smooth(tau, half, period)[0]
        motion = Motion(clock[half:-half], position, velocity, acceleration)
        residual = torque - estimate.torque(motion)
        turns = np.abs(velocity) < c.REST_SPEED + delay * np.abs(acceleration)
        columns = estimate.robot.regressor(position, velocity, acceleration)[..., -10:]
        gains = estimate.model.gains
        if gains is not None:
            columns = columns * np.array(gains)[:, None]
        largest = np.abs(acceleration).max(axis=0)
        parts.append(
            _Stretch(
                np.where(turns, np.nan, residual),
                columns,
                largest,
            )
        )
    return parts
