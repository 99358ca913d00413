"""What lies between a torque and its log, an angle and its log: filters, delay, noise, steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Channel:
    """smooth : length of a moving average that looks both ways; lag : time constant of a causal
    low-pass; delay : of the torque log behind the positions [s]; rate : of the log [Hz];
    step : of the encoder [rad], None: continuous; speed_noise : of a logged velocity [rad/s], None:
    no velocity in the log."""

    rate: float = 500.0
    smooth: float = 0.0
    lag: float = 0.0
    delay: float = 0.0
    step: float | None = 1e-5
    speed_noise: float | None = None

    def torque(self, t: Array, tau: Array) -> Array:
        """(N, n) what the channel carries, on the same fine and even grid."""
        step = float(t[1] - t[0])
        if self.lag:
            tau = first_order(tau, step, self.lag)
        if self.smooth:
            tau = average(tau, round(self.smooth / step))
        if self.delay:
            late = t - self.delay
            tau = np.column_stack([np.interp(late, t, column) for column in tau.T])
        return tau

    def position(self, q: Array, unit: Array) -> Array:
        """(N, n) as the encoder counts; unit (n,) : metres of a prismatic joint for a radian."""
        if self.step is None:
            return q
        return np.asarray(np.round(q / (self.step * unit)) * (self.step * unit))


def first_order(x: Array, step: float, lag: float) -> Array:
    """y + lag dy/dt = x, from rest at the first sample."""
    from scipy.signal import lfilter

    decay = float(np.exp(-step / lag))
    half = 0.5 * (1.0 - decay)
    y, _ = lfilter([half, half], [1.0, -decay], x, axis=0, zi=(1.0 - half) * x[:1])
    return np.asarray(y)


def average(x: Array, length: int) -> Array:
    """Mean over ``length`` samples around each, its ends repeated."""
    half = max(length // 2, 1)
    padded = np.concatenate([np.repeat(x[:1], half + 1, axis=0), x, np.repeat(x[-1:], half, axis=0)])
    total = np.cumsum(padded - x.mean(axis=0), axis=0)
    width = 2 * half + 1
    return np.asarray((total[width:] - total[:-width]) / width + x.mean(axis=0))


@dataclass(frozen=True)
class SensorNoise:
    """level : over the arm's own; colour : of a first-order autoregression; tails : degrees of freedom
    of Student's distribution, None: normal."""

    level: float = 1.0
    colour: float = 0.3
    tails: float | None = None

    def draw(self, samples: int, std: Array, rng: np.random.Generator) -> Array:
        """(samples, n) of standard deviation ``level * std``."""
        from scipy.signal import lfilter

        size = (samples + 200, len(std))
        if self.tails is None:
            fresh = rng.normal(size=size)
        else:
            fresh = rng.standard_t(self.tails, size) * np.sqrt((self.tails - 2.0) / self.tails)
        coloured = lfilter([np.sqrt(1.0 - self.colour**2)], [1.0, -self.colour], fresh, axis=0)
        return np.asarray(self.level * std * coloured[200:])
