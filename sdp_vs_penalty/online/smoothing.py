"""Causal smoothing of a stream with a delay that is stated exactly."""

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.online import constants as c
from sdp_vs_penalty.robot.arrays import Array


class SmoothingFilter:
    """Value, rate and acceleration of a stream by a cubic over a moving window.

    The window reaches ``delay`` to either side of the instant of its result (Savitzky,
    Golay, Anal. Chem. 1964): the result is that of ``delay`` seconds ago, at every
    frequency. Nothing is allocated after construction but views.
    """

    def __init__(self, channels: int, period: float, delay: float) -> None:
        """Allocate the ring buffer of samples and compute the kernel of the window.

        The window holds 2 half + 1 samples of ``channels`` signals, half = delay /
        period to either side of its middle, at least two; ``delay`` and ``period`` in
        s. Raises InputError for a delay above MAX_DELAY or below two samples.
        """
        half = round(delay / period)
        if not 0.0 < delay <= c.MAX_DELAY or half < 2:
            raise InputError(
                f"a filter's delay of {delay:g} s at {1.0 / period:g} Hz",
                f"choose two samples ({2.0 * period:g} s) to {c.MAX_DELAY:g} s",
            )
        self.delay = half * period
        self.length = 2 * half + 1
        self.kernel = smoothing_kernel(half, period)
        # Each sample is stored twice, so that every window is one contiguous view.
        self._samples = np.zeros((2 * self.length, channels))
        self._windows = [self._samples[k : k + self.length] for k in range(self.length)]
        self._next = 0
        self._count = 0

    def clear(self) -> None:
        """Forget all samples, as after a gap of the clock."""
        self._count = 0

    def push(self, sample: Array, out: Array) -> bool:
        """Add a sample, and write value, rate and acceleration of ``delay`` seconds
        ago.

        Parameters
        ----------
        sample : (channels,) array
            Newest value of each channel.
        out : (3, channels) array
            Receives value, rate [1/s] and acceleration [1/s^2].

        Returns
        -------
        bool
            False while the first window fills: ``out`` is not written then.
        """
        self._samples[self._next] = sample
        self._samples[self._next + self.length] = sample
        # The place of the oldest sample, where a full window begins.
        self._next = (self._next + 1) % self.length
        self._count = min(self._count + 1, self.length)
        if self._count < self.length:
            return False
        np.dot(self.kernel, self._windows[self._next], out=out)
        return True


def smoothing_kernel(half: int, period: float) -> Array:
    """Return the weights that give value, rate and acceleration in the middle of a
    window.

    They are those of a cubic polynomial fitted to the window of samples, ``period`` [s]
    apart, by least squares.

    Parameters
    ----------
    half : int
        Samples on either side of the middle.

    Returns
    -------
    (3, 2 half + 1) array
        Weights of the value, its rate [1/s] and its acceleration [1/s^2].
    """
    t = np.arange(-half, half + 1) * period
    # Rows: the polynomial's coefficients. Its second derivative is twice the third one.
    fit = np.linalg.pinv(np.vander(t, 4, increasing=True))
    return np.ascontiguousarray(fit[:3] * np.array([[1.0], [1.0], [2.0]]))


def smooth(samples: Array, half: int, period: float) -> tuple[Array, Array, Array]:
    """Smooth a whole log (N, channels) with the kernel of the stream: values, rates
    [1/s] and accelerations [1/s^2], each (N - 2 half, channels), of samples that are
    ``period`` [s] apart.

    Parameters
    ----------
    half : int
        Samples on either side of the middle.
    """
    windows = np.lib.stride_tricks.sliding_window_view(samples, 2 * half + 1, axis=0)
    value, rate, acceleration = smoothing_kernel(half, period)
    return windows @ value, windows @ rate, windows @ acceleration
